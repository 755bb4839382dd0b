"""Skinned characters out of glTF documents: skeleton, bind pose, weights and clips."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from assets.character import Animation, Character, Clip
from assets.io.gltf import read_document
from assets.io.gltf_document import Document, Primitive
from assets.io.skin import MAX_SAMPLES, best_influences, merge_pieces
from assets.transform import decompose, slerp
from assets.weld import check_unit

__all__ = ["bind_vertices", "read_animation", "read_character"]

Floats = NDArray[np.float64]

_TOLERANCE = 1e-3  # differences below this are rounding: [m] between bind poses, [-] between weights
_MIN_CURVE_RATE = 60.0  # at least this many samples per second for curved interpolation [Hz]
_ANIMATED_WIDTHS = {"translation": 3, "rotation": 4, "scale": 3}


def read_character(path: Path, name: str | None) -> Character:
    """Read the character of a file.

    Args:
        path: a .glb or .gltf file.
        name: name for messages; None takes the file's name without its suffix.

    Raises:
        InputError: as :func:`assets.loading.load_character`.
    """
    document = read_document(path)
    (vertices, faces, weights, texture), kept, parents, root, bind = _skinned_mesh(document)
    check_unit(vertices, path)
    joint_indices, joint_weights = best_influences(weights)
    to_parent = np.linalg.inv(np.where((parents < 0)[:, None, None], root, bind[parents]))
    return Character(
        name=name or path.stem,
        vertices=vertices,
        faces=faces,
        joint_names=tuple(document.node_name(node) for node in kept),
        joint_parents=parents,
        joint_indices=joint_indices,
        joint_weights=joint_weights,
        rest_local=decompose(to_parent @ bind, f"{path}, bind pose"),
        inverse_bind=np.linalg.inv(bind).astype(np.float64),
        root_transform=root,
        clips=_clips(document, kept),
        texture=texture,
    )


def bind_vertices(path: Path) -> Floats:
    """Vertices of a file's character in its bind pose, in the file's unit, shape (n, 3).

    Args:
        path: a .glb or .gltf file.

    Raises:
        InputError: the file cannot be read, or has no skin or no weights.
    """
    return _skinned_mesh(read_document(path))[0][0]


def read_animation(path: Path, joint_names: Collection[str]) -> Animation | None:
    """The animation of a file without a skinned mesh; None if it has such a mesh or nothing moves.

    Args:
        path: a .glb or .gltf file.
        joint_names: of nodes that are joints even if they do not move.

    Raises:
        InputError: the file cannot be read or is damaged.
    """
    document = read_document(path)
    moving = _animated(document)
    if not moving or any("skin" in document.json["nodes"][node] for node in document.mesh_nodes()):
        return None
    nodes = range(len(document.parents))
    joints = [node for node in nodes if node in moving or document.json["nodes"][node].get("name") in joint_names]
    kept = list(dict.fromkeys(node for joint in joints for node in document.chain(joint)))
    place = {node: index for index, node in enumerate(kept)}
    parents = np.array([place.get(document.parents[node], -1) for node in kept], np.int32)
    names = tuple(document.node_name(node) for node in kept)
    return Animation(path, names, parents, np.eye(4), _clips(document, kept))


def _skinned_mesh(document: Document) -> tuple[Any, list[int], NDArray[np.int32], Floats, Floats]:
    """All skinned meshes as one, see :func:`merge_pieces`, and the skeleton: joints (nodes), parents, root, bind."""
    shown = document.mesh_nodes()
    skinned = [node for node in shown if "skin" in document.json["nodes"][node]]
    if not shown and _animated(document):
        raise document.error("only an animation, without a mesh", "meshes", expected="a character: a mesh with a skin")
    if not skinned:
        raise document.error("no skin: nothing ties the mesh to joints", "nodes", f"{len(shown)} meshes without a skin")
    joints = {node: _skin_joints(document, node) for node in skinned}
    kept, parents, root = _skeleton(document, [joint for some in joints.values() for joint in some])
    place = {node: index for index, node in enumerate(kept)}
    bind, mesh_to_world = _bind_pose(document, joints, kept, parents, root)
    pieces = []
    for node in skinned:
        columns = np.array([place[joint] for joint in joints[node]])
        for primitive in document.primitives(node):
            weights = _weights(document, primitive, columns, len(kept))
            vertices, faces, texture = primitive.placed(mesh_to_world[node])
            pieces.append((vertices, faces, weights, texture))
    return merge_pieces(pieces), kept, parents, root, bind


def _skin_joints(document: Document, node: int) -> list[int]:
    """Nodes that are joints of the skin of a mesh node."""
    number = document.json["nodes"][node]["skin"]
    key = f"skin {number}"
    joints = document.entry("skins", number, f"node {document.node_name(node)}").get("joints", [])
    for joint in joints:
        document.entry("nodes", joint, key)
    if not joints or len(set(joints)) != len(joints):
        raise document.error("joints that are missing or listed twice", key, f"{len(joints)} joints")
    return joints


def _skeleton(document: Document, joints: list[int]) -> tuple[list[int], NDArray[np.int32], Floats]:
    """Nodes that become joints (parents first), their parents, and the constant transform above them.

    Nodes between two joints become joints that carry no weight, and so do animated nodes above the joints; what stands
    above all of them and never moves is the root transform.
    """
    chains = [document.chain(joint) for joint in dict.fromkeys(joints)]
    moving = set(joints) | _animated(document)
    above = 0
    while all(len(c) > above and c[above] == chains[0][above] and c[above] not in moving for c in chains):
        above += 1
    root = np.eye(4)
    for node in chains[0][:above]:
        root = root @ document.local_matrix(node)
    kept = list(dict.fromkeys(node for chain in chains for node in chain[above:]))
    place = {node: index for index, node in enumerate(kept)}
    parents = np.array([place.get(document.parents[node], -1) for node in kept], dtype=np.int32)
    return kept, parents, root


def _animated(document: Document) -> set[int]:
    """Nodes that an animation moves."""
    targets = [
        channel.get("target", {})
        for animation in document.json.get("animations", [])
        for channel in animation.get("channels", [])
    ]
    nodes = range(len(document.parents))
    return {one["node"] for one in targets if one.get("node") in nodes and one.get("path") in _ANIMATED_WIDTHS}


def _bind_pose(
    document: Document, joints: dict[int, list[int]], kept: list[int], parents: NDArray[np.int32], root: Floats
) -> tuple[Floats, dict[int, Floats]]:
    """Joints of the bind pose in the world, shape (joints, 4, 4), and by mesh node its space in that world.

    A skin ties a joint's bind pose to its mesh's own space. Where the nodes rest in the bind pose, they say where that
    space lies in the world; where they rest otherwise, the mesh's node does.
    """
    place = {node: index for index, node in enumerate(kept)}
    bind: dict[int, Floats] = {}
    mesh_to_world = {}
    for node, own in joints.items():
        inverse = _inverse_bind(document, node, len(own))
        implied = np.array([document.world_matrix(joint) for joint in own]) @ inverse
        rests_in_bind_pose = np.abs(implied - implied[0]).max() < _TOLERANCE
        space = implied.mean(axis=0) if rests_in_bind_pose else document.world_matrix(node)
        mesh_to_world[node] = space
        for joint, matrix in zip(own, space @ np.linalg.inv(inverse), strict=True):
            if joint in bind and np.abs(bind[joint] - matrix).max() > _TOLERANCE:
                raise document.error("two skins with different bind poses", f"joint {document.node_name(joint)}")
            bind[joint] = matrix
    for node in kept:  # parents come first
        if node not in bind:
            parent = parents[place[node]]
            bind[node] = (root if parent < 0 else bind[kept[parent]]) @ document.local_matrix(node)
    return np.array([bind[node] for node in kept]), mesh_to_world


def _inverse_bind(document: Document, node: int, count: int) -> Floats:
    number = document.json["nodes"][node]["skin"]
    accessor = document.json["skins"][number].get("inverseBindMatrices")
    if accessor is None:
        return np.tile(np.eye(4), (count, 1, 1))
    key = f"skin {number}, inverseBindMatrices"
    values = document.accessor(accessor, key).astype(np.float64)
    if values.shape != (count, 16):
        raise document.error("not a matrix for each joint", key, values.shape, expected=f"({count}, 16)")
    inverse = values.reshape(-1, 4, 4).swapaxes(1, 2)
    bad = np.flatnonzero(
        ~np.isfinite(inverse).all(axis=(1, 2)) | (np.abs(inverse[:, 3] - [0, 0, 0, 1]).max(1) > _TOLERANCE)
    )
    if bad.size or np.abs(np.linalg.det(inverse)).min() < 1e-12:
        where = bad[0] if bad.size else np.abs(np.linalg.det(inverse)).argmin()
        raise document.error("a matrix that places no joint", f"{key}, joint {where}")
    return inverse


def _weights(document: Document, primitive: Primitive, columns: NDArray[np.intp], width: int) -> NDArray[np.float32]:
    """Weight of every joint on every vertex, shape (vertices, width), rows sum to 1; ``columns`` places the joints."""
    dense = np.zeros((len(primitive.vertices), width), dtype=np.float32)
    sets = 0
    while f"JOINTS_{sets}" in primitive.attributes or f"WEIGHTS_{sets}" in primitive.attributes:
        key = f"{primitive.key}, JOINTS_{sets} and WEIGHTS_{sets}"
        missing = [name for name in (f"JOINTS_{sets}", f"WEIGHTS_{sets}") if name not in primitive.attributes]
        if missing:
            raise document.error(
                f"a skin without {missing[0]}", key, sorted(primitive.attributes), expected="both or neither"
            )
        joints = document.integers(primitive.attributes.get(f"JOINTS_{sets}"), key)
        weights = document.accessor(primitive.attributes.get(f"WEIGHTS_{sets}"), key).astype(np.float64)
        if not joints.shape == weights.shape == (len(dense), 4):
            raise document.error("not four joints and weights a vertex", key, (joints.shape, weights.shape))
        bad = np.flatnonzero((~np.isfinite(weights) | (weights < 0.0)).any(axis=1))
        if bad.size:
            vertex = f"{key}, vertex {bad[0]}"
            raise document.error("bad weights", vertex, weights[bad[0]].tolist(), expected="finite, not negative")
        used = weights > 0.0
        bad = np.flatnonzero((used & (joints >= len(columns))).any(axis=1))
        if bad.size:
            vertex = f"{key}, vertex {bad[0]}"
            raise document.error(
                "a joint that does not exist", vertex, joints[bad[0]].tolist(), expected=f"below {len(columns)}"
            )
        rows, entries = np.nonzero(used)
        np.add.at(dense, (rows, columns[joints[rows, entries]]), weights[rows, entries])
        sets += 1
    if not sets:
        raise document.error("a skin without weights", primitive.key, expected="JOINTS_0 and WEIGHTS_0")
    total = dense.sum(axis=1, keepdims=True)
    bad = np.flatnonzero(total[:, 0] < _TOLERANCE)
    if bad.size:
        raise document.error("a skin without weights: they sum to zero", f"{primitive.key}, vertex {bad[0]}")
    return dense / total


def _clips(document: Document, kept: list[int]) -> dict[str, Clip]:
    """All animations that move a joint, by name, in the order of the file."""
    rest = []
    for node in kept:
        parts = document.local_transform(node)
        rest.append(parts if isinstance(parts, tuple) else decompose(parts, f"{document.path}, node {node}"))
    clips: dict[str, Clip] = {}
    for number, animation in enumerate(document.json.get("animations", [])):
        name = str(animation.get("name") or f"clip {number}")
        if name in clips:
            raise document.error("two clips of one name", f"animation {number}", name)
        clip = _clip(document, animation, name, kept, rest)
        if clip is not None:
            clips[name] = clip
    return clips


def _clip(
    document: Document, animation: dict[str, Any], name: str, kept: list[int], rest: list[tuple[Floats, ...]]
) -> Clip | None:
    """An animation sampled at its own key rate; None if it moves no joint."""
    place = {node: index for index, node in enumerate(kept)}
    curves: dict[tuple[int, str], tuple[Floats, Floats, str]] = {}
    for number, channel in enumerate(animation.get("channels", [])):
        target = channel.get("target", {})
        if target.get("node") in place and target.get("path") in _ANIMATED_WIDTHS:
            key = f"clip {name}, channel {number} ({target['path']} of {document.node_name(target['node'])})"
            curves[place[target["node"]], target["path"]] = _curve(document, animation, channel, key)
    if not curves:
        return None
    times, rate = _sample_times(document, list(curves.values()), f"clip {name}", len(kept))
    values = {
        path: np.tile(np.array([parts[part] for parts in rest]), (len(times), 1, 1))
        for part, path in enumerate(_ANIMATED_WIDTHS)
    }
    for (joint, path), curve in curves.items():
        values[path][:, joint] = _sample(*curve, times, path == "rotation")
    return Clip(name, rate, values["translation"], values["rotation"], values["scale"])


def _curve(
    document: Document, animation: dict[str, Any], channel: dict[str, Any], key: str
) -> tuple[Floats, Floats, str]:
    """Key times [s] (k), values (k, width) or, for a cubic spline, (k, 3, width), and the kind of interpolation."""
    samplers, number = animation.get("samplers", []), channel.get("sampler")
    if not isinstance(number, int) or not 0 <= number < len(samplers):
        raise document.error("a sampler that does not exist", key, number)
    kind = samplers[number].get("interpolation", "LINEAR")
    if kind not in ("LINEAR", "STEP", "CUBICSPLINE"):
        raise document.error("an unknown interpolation", key, kind, expected="LINEAR, STEP or CUBICSPLINE")
    times = document.accessor(samplers[number].get("input"), f"{key}, times")[:, 0].astype(np.float64)
    values = document.accessor(samplers[number].get("output"), f"{key}, values").astype(np.float64)
    width, rows = _ANIMATED_WIDTHS[channel["target"]["path"]], len(times) * (3 if kind == "CUBICSPLINE" else 1)
    if values.shape != (rows, width):
        raise document.error("not a value for each time", key, values.shape, expected=f"({rows}, {width})")
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if bad.size:
        raise document.error("values that are not finite", f"{key}, key {bad[0]}", values[bad[0]].tolist())
    if not np.isfinite(times).all() or (np.diff(times) <= 0.0).any():
        raise document.error("times that do not grow", key)
    values = values.reshape(len(times), 3, width) if kind == "CUBICSPLINE" else values
    if width == 4:
        keys = values[:, 1] if kind == "CUBICSPLINE" else values
        if np.linalg.norm(keys, axis=1).min() < 0.5:
            raise document.error("a rotation that is no unit quaternion", key)
    return times, values, kind


def _sample_times(
    document: Document, curves: list[tuple[Floats, Floats, str]], key: str, joint_count: int
) -> tuple[Floats, float]:
    """Uniform times from the first to the last key, at the rate of the keys [Hz]."""
    times = np.unique(np.concatenate([curve[0] for curve in curves]))
    gaps = np.diff(times)
    gaps = gaps[gaps > 1e-3]  # channels round the same time differently
    if not gaps.size:
        return times[:1], 30.0  # a single pose; any rate will do
    # The median of the short gaps is the frame time also where keys were left out, and is robust to rounding.
    frame = float(np.median(gaps[gaps < 1.5 * gaps.min()]))
    if any(curve[2] == "CUBICSPLINE" for curve in curves):
        frame = min(frame, 1.0 / _MIN_CURVE_RATE)
    span = times[-1] - times[0]
    count = max(round(span / frame), 1) + 1
    if count * joint_count > MAX_SAMPLES:
        raise document.error("a clip too long to sample", key, f"{count} frames of {joint_count} joints")
    return np.linspace(times[0], times[-1], count), (count - 1) / span


def _sample(times: Floats, values: Floats, kind: str, at: Floats, is_rotation: bool) -> Floats:
    """Values of a curve at given times, shape (len(at), width), held beyond its ends (glTF 2.0, appendix C)."""
    if len(times) == 1:
        keys = np.repeat(values[:, 1] if kind == "CUBICSPLINE" else values, len(at), axis=0)
        return keys / np.linalg.norm(keys, axis=1, keepdims=True) if is_rotation else keys
    if kind == "STEP":
        # A sample that rounding puts just before its key still shows that key.
        result = values[np.clip(np.searchsorted(times, at + 1e-5, side="right") - 1, 0, len(times) - 1)]
    else:
        left = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
        step = times[left + 1] - times[left]
        share = np.clip((at - times[left]) / step, 0.0, 1.0)[:, None]
        if kind == "LINEAR" and is_rotation:
            keys = values / np.linalg.norm(values, axis=1, keepdims=True)
            return slerp(keys[left], keys[left + 1], share[:, 0])
        if kind == "LINEAR":
            result = (1.0 - share) * values[left] + share * values[left + 1]
        else:
            square, cube = share**2, share**3
            result = (
                (2.0 * cube - 3.0 * square + 1.0) * values[left, 1]
                + step[:, None] * (cube - 2.0 * square + share) * values[left, 2]
                + (3.0 * square - 2.0 * cube) * values[left + 1, 1]
                + step[:, None] * (cube - square) * values[left + 1, 0]
            )
    return result / np.linalg.norm(result, axis=1, keepdims=True) if is_rotation else result
