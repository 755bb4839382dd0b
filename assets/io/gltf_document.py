"""The contents of a glTF 2.0 file: checked access to the meshes, nodes and numbers in it.

Every length, index and number that is used is checked first, so that a truncated or damaged file ends in a message that
names the element.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from assets.transform import local_matrices
from pbd.errors import InputError

__all__ = ["Document", "Primitive"]

Floats = NDArray[np.float64]
Parts = tuple[Floats, Floats, Floats]

_COMPONENTS = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
_INDICES = (5121, 5123, 5125)  # the unsigned ones
_MAX_COUNT = 2**26  # of sparse numbers: more is a damaged file
_MAX_WEIGHT = 1e6  # of a morph target [-]
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_TRIANGLE_LIST = 4


@dataclass(frozen=True)
class Primitive:
    """Triangles of one primitive, in the mesh's own space.

    Attributes:
        key: its name in messages.
        vertices: [m], shape (n, 3), float64.
        faces: shape (m, 3), int32.
        texture: first texture coordinates, origin at the upper left, shape (n, 2), float64; None if there are none.
        attributes: accessor index by attribute name.
    """

    key: str
    vertices: Floats
    faces: NDArray[np.int32]
    texture: Floats | None
    attributes: dict[str, Any]

    def placed(self, matrix: Floats) -> tuple[Floats, NDArray[np.int32], Floats | None]:
        """Vertices moved by a transform, shape (4, 4), faces, turned where it mirrors them (glTF 2.0, 3.7.4), and the
        texture coordinates of their corners, v upwards, shape (m, 3, 2), None if there are none.
        """
        mirrored = np.linalg.det(matrix[:3, :3]) < 0.0
        faces = self.faces[:, ::-1] if mirrored else self.faces
        texture = None if self.texture is None else (self.texture * [1.0, -1.0] + [0.0, 1.0])[faces]
        return self.vertices @ matrix[:3, :3].T + matrix[:3, 3], faces, texture


@dataclass(frozen=True)
class Document:
    """A parsed file with its binary data.

    Attributes:
        path: the file.
        json: contents of the JSON.
        buffers: bytes of each buffer.
        parents: parent of each node, -1 at a root.
    """

    path: Path
    json: dict[str, Any]
    buffers: tuple[bytes, ...]
    parents: tuple[int, ...]

    def error(self, problem: str, key: str, received: Any = None, *, expected: str | None = None) -> InputError:
        """An error about this file."""
        return InputError(problem, file=self.path, key=key, received=received, expected=expected)

    def entry(self, kind: str, index: Any, key: str) -> dict[str, Any]:
        """One element of a list of the file, for instance of its "accessors".

        Args:
            kind: name of the list.
            index: number in the list, as the file gives it.
            key: element that refers to it, for the message.

        Raises:
            InputError: no such element.
        """
        entries = self.json.get(kind, [])
        if not isinstance(index, int) or not 0 <= index < len(entries):
            raise self.error(f"one of the {kind} that does not exist", key=key, received=index)
        return entries[index]

    def whole(self, entry: dict[str, Any], name: str, key: str, default: int | None = None) -> int:
        """A number of an element: whole, not negative.

        Raises:
            InputError: it is missing, without a default, or negative.
        """
        value = entry.get(name, default)
        if value is None or value < 0:
            raise self.error(f"bad {name}", key=key, received=value, expected="a whole number, not negative")
        return value

    def node_name(self, node: int) -> str:
        """The node's name, or its number where it has none."""
        return self.entry("nodes", node, f"node {node}").get("name") or f"node {node}"

    def chain(self, node: int) -> tuple[int, ...]:
        """Nodes from the root down to this one.

        Raises:
            InputError: a node that is its own ancestor.
        """
        chain = [node]
        while self.parents[chain[-1]] >= 0:
            chain.append(self.parents[chain[-1]])
            if len(chain) > len(self.parents):
                raise self.error("nodes that are their own ancestors", key=f"node {self.node_name(node)}")
        return tuple(reversed(chain))

    def mesh_nodes(self) -> list[int]:
        """Nodes of the scene that show a mesh, in the order of the file."""
        nodes = self.json.get("nodes", [])
        roots = set(range(len(nodes)))
        if self.json.get("scenes"):
            roots = set(self.entry("scenes", self.json.get("scene", 0), "scene").get("nodes", []))
        return [i for i in range(len(nodes)) if "mesh" in nodes[i] and self.chain(i)[0] in roots]

    def local_transform(self, node: int) -> Parts | Floats:
        """Translation [m] (3), rotation (4) and scale (3) of a node, or its matrix (4, 4) where the file gives that.

        Raises:
            InputError: numbers that are missing or not finite, or a rotation that is no unit quaternion.
        """
        entry, key = self.entry("nodes", node, f"node {node}"), f"node {self.node_name(node)}"
        values = {}
        for name, width in {"matrix": 16, "translation": 3, "rotation": 4, "scale": 3}.items():
            raw = entry.get(name)
            if raw is None:
                continue
            numbers = [float(x) for x in raw if isinstance(x, (int, float))] if isinstance(raw, list) else []
            values[name] = np.array(numbers)
            if len(numbers) != width or not np.isfinite(values[name]).all():
                raise self.error(f"bad {name}", key=key, received=raw, expected=f"{width} numbers")
        if "matrix" in values:
            return values["matrix"].reshape(4, 4).T
        rotation = values.get("rotation", np.array([0.0, 0.0, 0.0, 1.0]))
        length = np.linalg.norm(rotation)
        if abs(length - 1.0) > 1e-2:
            raise self.error("a rotation that is no unit quaternion", key=key, received=rotation.tolist())
        return values.get("translation", np.zeros(3)), rotation / length, values.get("scale", np.ones(3))

    def local_matrix(self, node: int) -> Floats:
        """Transform of a node against its parent, shape (4, 4)."""
        parts = self.local_transform(node)
        return local_matrices(*parts) if isinstance(parts, tuple) else parts

    def world_matrix(self, node: int) -> Floats:
        """Transform of a node against the scene, shape (4, 4)."""
        matrix = np.eye(4)
        for step in self.chain(node):
            matrix = matrix @ self.local_matrix(step)
        return matrix

    def accessor(self, index: Any, key: str) -> NDArray[Any]:
        """Numbers of an accessor, shape (count, width); normalised integers as float64.

        Raises:
            InputError: it does not exist or lies outside its buffer; ``key`` names its use.
        """
        entry = self.entry("accessors", index, key)
        key = f"{key}, accessor {index}"
        if entry.get("componentType") not in _COMPONENTS or entry.get("type") not in _WIDTHS:
            raise self.error("numbers of an unknown kind", key=key, received=entry.get("type"))
        kind, width = np.dtype(_COMPONENTS[entry["componentType"]]), _WIDTHS[entry["type"]]
        count, sparse = self.whole(entry, "count", key), entry.get("sparse")
        if sparse is None or "bufferView" in entry:
            data = self._numbers(entry, kind, width, count, key)
        elif 0 < count <= _MAX_COUNT:
            data = np.zeros((count, width), kind)
        else:
            raise self.error("sparse numbers that are too many or none", key, count, expected=f"at most {_MAX_COUNT}")
        if sparse is not None:
            self._replace(data, sparse, key)
        if entry.get("normalized") and kind.kind in "iu":
            return np.maximum(data.astype(np.float64) / np.iinfo(kind).max, -1.0)
        return data

    def _numbers(self, entry: dict[str, Any], kind: np.dtype[Any], width: int, count: int, key: str) -> NDArray[Any]:
        """Numbers in the part of a buffer that an element names, shape (count, width)."""
        view = self.entry("bufferViews", entry.get("bufferView"), key)
        begin, start = self.whole(view, "byteOffset", key, 0), self.whole(entry, "byteOffset", key, 0)
        stride = self.whole(view, "byteStride", key, kind.itemsize * width)
        needed = start + (count - 1) * stride + kind.itemsize * width
        buffer = self.whole(view, "buffer", key)
        length = len(self.buffers[buffer]) if buffer < len(self.buffers) else 0
        if count < 1 or stride < kind.itemsize * width or needed > length - begin:
            raise self.error(
                "numbers outside their buffer: the file is truncated or damaged", key=key, received=f"{count} elements"
            )
        return np.ndarray((count, width), kind, self.buffers[buffer], begin + start, (stride, kind.itemsize)).copy()

    def _replace(self, data: NDArray[Any], sparse: dict[str, Any], key: str) -> None:
        """Put the numbers of a sparse accessor in their rows of ``data``, shape (count, width)."""
        places = sparse.get("indices", {})
        kind = places.get("componentType")
        if kind not in _INDICES:
            raise self.error("sparse numbers without indices", key, kind, expected=f"one of the types {_INDICES}")
        count = self.whole(sparse, "count", key)
        rows = self._numbers(places, np.dtype(_COMPONENTS[kind]), 1, count, f"{key}, indices")[:, 0]
        if rows.max() >= len(data):
            raise self.error("sparse numbers at an index that does not exist", key, int(rows.max()))
        data[rows] = self._numbers(sparse.get("values", {}), data.dtype, data.shape[1], count, f"{key}, values")

    def integers(self, index: Any, key: str) -> NDArray[np.int64]:
        """Numbers of an accessor that count or index something, shape (count, width).

        Raises:
            InputError: as :meth:`accessor`, or numbers that are no unsigned integers.
        """
        values = self.accessor(index, key)
        if values.dtype.kind != "u":
            raise self.error("indices that are no unsigned integers", key=key, received=str(values.dtype))
        return values.astype(np.int64)

    def primitives(self, node: int) -> list[Primitive]:
        """Triangles of the mesh that a node shows, in the mesh's own space, with its morph targets' default weights.

        Raises:
            InputError: anything else than triangles, positions that are not finite, a face with a bad index, or weights
                that do not fit the morph targets.
        """
        number = self.entry("nodes", node, f"node {node}").get("mesh")
        mesh = self.entry("meshes", number, f"node {self.node_name(node)}")
        found, weights = [], self.json["nodes"][node].get("weights", mesh.get("weights", []))
        if not mesh.get("primitives"):
            raise self.error("a mesh without triangles", key=f"mesh {mesh.get('name') or number}")
        for index, entry in enumerate(mesh["primitives"]):
            key = f"mesh {mesh.get('name') or number}, primitive {index}"
            if entry.get("mode", _TRIANGLE_LIST) != _TRIANGLE_LIST:
                raise self.error("not a list of triangles", key=key, received=entry["mode"], expected="mode 4")
            found.append(self._primitive(key, entry, weights))
        return found

    def _primitive(self, key: str, entry: dict[str, Any], weights: list[float]) -> Primitive:
        indices, attributes, targets = entry.get("indices"), entry.get("attributes", {}), entry.get("targets", [])
        vertices = self.accessor(attributes.get("POSITION"), f"{key}, POSITION").astype(np.float64)
        if any(weights):
            vertices += self._morph(vertices.shape, targets, weights, key)
        bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
        if vertices.shape[1] != 3 or bad.size:
            where = f"{key}, vertex {bad[0]}" if bad.size else key
            raise self.error("positions that are not three finite numbers", key=where)
        if indices is None:
            corners = np.arange(len(vertices))
        else:
            corners = self.integers(indices, f"{key}, indices").ravel()
        if len(corners) % 3:
            raise self.error("corners that make no triangles", key=key, received=len(corners), expected="3 a triangle")
        faces = corners.reshape(-1, 3)
        bad = np.flatnonzero((faces >= len(vertices)).any(axis=1))
        if bad.size:
            raise self.error(
                "a face with a vertex that does not exist",
                key=f"{key}, face {bad[0]}",
                received=faces[bad[0]].tolist(),
                expected=f"0 to {len(vertices) - 1}",
            )
        texture = None
        if "TEXCOORD_0" in attributes:
            texture = self.accessor(attributes["TEXCOORD_0"], f"{key}, TEXCOORD_0").astype(np.float64)
            if texture.shape != (len(vertices), 2) or not np.isfinite(texture).all():
                raise self.error("texture coordinates that are not two finite numbers a vertex", key=key)
        return Primitive(key, vertices, faces.astype(np.int32), texture, attributes)

    def _morph(self, shape: tuple[int, ...], targets: list[dict[str, Any]], weights: list[float], key: str) -> Floats:
        """How far morph targets move the vertices at given weights, of a given shape."""
        if len(weights) != len(targets) or not all(abs(weight) <= _MAX_WEIGHT for weight in weights):
            expected = f"{len(targets)} numbers up to {_MAX_WEIGHT:g}, one for each morph target"
            raise self.error("bad weights", f"{key}, targets", weights, expected=expected)
        moved = np.zeros(shape)
        for number, (target, weight) in enumerate(zip(targets, weights, strict=True)):
            if weight and "POSITION" in target:
                where = f"{key}, target {number}, POSITION"
                moves = self.accessor(target["POSITION"], where).astype(np.float64)
                if moves.shape != shape or not np.isfinite(moves).all():
                    raise self.error(
                        "not three finite numbers for each vertex", where, moves.shape, expected=str(shape)
                    )
                moved += weight * moves
        return moved
