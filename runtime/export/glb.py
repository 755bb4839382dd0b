"""A glTF 2.0 binary file with meshes that move: by morph targets, one a frame, or by joints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from assets.character import Character
from assets.texture import split
from assets.transform import decompose, quaternions
from pbd.errors import InputError
from wrinkles.mesh_measures import vertex_normals

__all__ = ["BYTES_A_VERTEX", "Color", "GlbFile", "Track", "unit_normals"]

Color = tuple[float, float, float, float]

BYTES_A_VERTEX = 12  # that a .glb takes for a morph target: three 16-bit positions and three 8-bit normals, padded

_BYTE, _UNSIGNED_BYTE, _SHORT, _UNSIGNED_SHORT, _UNSIGNED_INT, _FLOAT = 5120, 5121, 5122, 5123, 5125, 5126
_VERTEX_BUFFER, _INDEX_BUFFER = 34962, 34963
_COMPONENTS = {
    np.dtype(np.int8): _BYTE,
    np.dtype(np.uint8): _UNSIGNED_BYTE,
    np.dtype(np.int16): _SHORT,
    np.dtype(np.uint16): _UNSIGNED_SHORT,
    np.dtype(np.uint32): _UNSIGNED_INT,
    np.dtype(np.float32): _FLOAT,
}
_WIDTHS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
# A base normal is stored a little shorter than 1 (glTF's validator allows 0.67 %), so that even the opposite normal
# can be reached by a delta within -1..1: see _normal_deltas.
_BASE_NORMAL_LENGTH = 0.995


@dataclass(frozen=True)
class Track:
    """One animated mesh: positions float32 [m] (f, n, 3), unit normals float32 (f, n, 3).

    Its texture coordinates are those of each face corner, v upwards, shape (m, 3, 2), NaN at faces without; None
    without any.
    """

    name: str
    faces: np.ndarray
    frames: np.ndarray
    rate_hz: float
    normals: np.ndarray
    color: Color
    double_sided: bool
    texture: np.ndarray | None = None


class GlbFile:
    """A glTF document and its binary buffer while they grow."""

    def __init__(self) -> None:
        import pygltflib as gl

        self._gl: Any = gl
        self._document: Any = gl.GLTF2(
            asset=gl.Asset(version="2.0", generator="gube"),
            scene=0,
            scenes=[gl.Scene(nodes=[])],
            animations=[gl.Animation(name="baked", channels=[], samplers=[])],
            extensionsUsed=["KHR_mesh_quantization"],
            extensionsRequired=["KHR_mesh_quantization"],
        )
        self._chunks: list[bytes] = []
        self._length = 0

    def add(self, track: Track) -> None:
        """One node with one mesh, moved by a translation and by morph weights."""
        gl, document = self._gl, self._document
        middle, rotation, local, normals = _without_rigid_motion(track.frames, track.normals)
        source, faces, texture = self._corners(track.faces, track.texture, local.shape[1])
        local, normals = local[:, source], normals[:, source]
        delta = local - local[0]
        scale = max(1.0, float(np.abs(delta).max(initial=0.0)))
        # Blender lights a mesh by its base normals, which it turns with the faces, and reads no others.
        base_normals = (_BASE_NORMAL_LENGTH * normals[0]).astype(np.float32)
        positions = _quantized(delta / scale, np.int16)
        normals = _quantized(_normal_deltas(base_normals, normals), np.int8)
        attributes = gl.Attributes(
            POSITION=self._vertices((local[0] / scale).astype(np.float32), bounds=True),
            NORMAL=self._vertices(base_normals),
            TEXCOORD_0=texture,
        )
        targets = [
            {"POSITION": self._vertices(positions[k], bounds=True), "NORMAL": self._vertices(normals[k])}
            for k in range(len(positions))
        ]
        mesh = self._mesh(track.name, faces, attributes, track.color, track.double_sided, targets)
        weights = np.eye(len(targets), dtype=np.float32)
        mesh.weights = weights[0].tolist()
        mesh.extras = {"targetNames": [f"frame {k}" for k in range(len(targets))]}
        placed = {"translation": middle[0].tolist(), "scale": [scale, scale, scale]}
        node = self._node(gl.Node(name=track.name, mesh=len(document.meshes) - 1, **placed))
        document.scenes[0].nodes.append(node)
        if len(targets) > 1:
            times = self._times(len(targets), track.rate_hz)
            self._channel(node, "weights", times, weights.ravel())
            self._channel(node, "translation", times, middle.astype(np.float32))
            self._channel(node, "rotation", times, rotation.astype(np.float32))

    def add_character(self, body: Character, poses: np.ndarray, rate_hz: float, color: Color) -> None:
        """A skinned mesh and its joints, each of which moves by itself.

        A skinning matrix is the joint's place times its inverse bind matrix. Any bind place will do: joints stand
        upright where the character has them. They are children of one node and not of each other, so that scaled joints
        need no shear; from key to key a joint goes straight, as the garment's vertices do.
        """
        gl, document = self._gl, self._document
        poses = np.asarray(poses, np.float64)
        if poses.shape[1:] != (body.joint_count, 3, 4) or not np.isfinite(poses).all():
            expected = f"finite matrices of shape (f, {body.joint_count}, 3, 4)"
            raise InputError("not poses of this character", key="poses", received=poses.shape, expected=expected)
        places = np.linalg.inv(body.inverse_bind)[:, :3, 3]
        moved = np.zeros((*poses.shape[:2], 4, 4))
        moved[..., :3, :3], moved[..., 3, 3] = poses[..., :3], 1.0
        moved[..., :3, 3] = np.einsum("fjab,jb->fja", poses[..., :3], places) + poses[..., 3]
        translation, rotation, scale = decompose(moved, "poses")
        rotation = _without_jumps(rotation)
        first = len(document.nodes)
        joints = [
            self._node(
                gl.Node(
                    name=name,
                    translation=translation[0, j].tolist(),
                    rotation=rotation[0, j].tolist(),
                    scale=scale[0, j].tolist(),
                )
            )
            for j, name in enumerate(body.joint_names)
        ]
        skeleton = self._node(gl.Node(name="skeleton", children=joints))
        inverse_bind = np.tile(np.eye(4), (len(joints), 1, 1))
        inverse_bind[:, :3, 3] = -places
        by_column = np.swapaxes(inverse_bind, 1, 2).reshape(-1, 16).astype(np.float32)
        document.skins.append(
            gl.Skin(name="body", joints=joints, skeleton=skeleton, inverseBindMatrices=self._accessor(by_column))
        )
        kind = np.uint8 if len(joints) <= 256 else np.uint16
        vertices = body.vertices.astype(np.float32)
        used = np.where(body.joint_weights > 0.0, body.joint_indices, 0)  # as the format asks
        source, faces, texture = self._corners(body.faces, body.texture, len(vertices))
        attributes = gl.Attributes(
            POSITION=self._vertices(vertices[source], bounds=True),
            NORMAL=self._vertices(unit_normals(vertex_normals(vertices[None], body.faces))[0][source]),
            TEXCOORD_0=texture,
            JOINTS_0=self._vertices(used.astype(kind)[source], normalized=False),
            WEIGHTS_0=self._vertices(body.joint_weights.astype(np.float32)[source]),
        )
        self._mesh("body", faces, attributes, color, False)
        node = self._node(gl.Node(name="body", mesh=len(document.meshes) - 1, skin=len(document.skins) - 1))
        document.scenes[0].nodes += [node, skeleton]
        if len(poses) < 2:
            return
        times = self._times(len(poses), rate_hz)
        for j in range(len(joints)):
            self._channel(first + j, "translation", times, translation[:, j].astype(np.float32))
            self._channel(first + j, "rotation", times, rotation[:, j].astype(np.float32))
            if np.abs(scale[:, j] - scale[0, j]).max() > 1e-6:
                self._channel(first + j, "scale", times, scale[:, j].astype(np.float32))

    def _corners(
        self, faces: np.ndarray, texture: np.ndarray | None, vertex_count: int
    ) -> tuple[np.ndarray | slice, np.ndarray, int | None]:
        """Vertices to write, which a seam of the texture splits, faces, and an accessor for texture coordinates.

        The format counts v downwards.
        """
        if texture is None:
            return slice(None), faces, None
        source, faces, places = split(faces, texture, vertex_count)
        return source, faces, self._vertices((places * [1.0, -1.0] + [0.0, 1.0]).astype(np.float32))

    def _node(self, node: Any) -> int:
        self._document.nodes.append(node)
        return len(self._document.nodes) - 1

    def _mesh(
        self,
        name: str,
        faces: np.ndarray,
        attributes: Any,
        color: Color,
        double_sided: bool,
        targets: list[dict[str, int]] | None = None,
    ) -> Any:
        gl, document = self._gl, self._document
        primitive = gl.Primitive(
            attributes=attributes,
            indices=self._accessor(faces.astype(np.uint32).reshape(-1, 1), target=_INDEX_BUFFER),
            material=len(document.materials),
            targets=targets or [],
        )
        look = gl.PbrMetallicRoughness(baseColorFactor=list(color), metallicFactor=0.0, roughnessFactor=0.85)
        document.materials.append(gl.Material(name=name, doubleSided=double_sided, pbrMetallicRoughness=look))
        document.meshes.append(gl.Mesh(name=name, primitives=[primitive]))
        return document.meshes[-1]

    def _times(self, count: int, rate_hz: float) -> int:
        """An accessor for the key times of so many frames."""
        return self._accessor((np.arange(count) / rate_hz).astype(np.float32)[:, None], bounds=True)

    def _channel(self, node: int, path: str, times: int, values: np.ndarray) -> None:
        gl, animation = self._gl, self._document.animations[0]
        output = self._accessor(values.reshape(-1, 1) if path == "weights" else values)
        target = gl.AnimationChannelTarget(node=node, path=path)
        animation.channels.append(gl.AnimationChannel(sampler=len(animation.samplers), target=target))
        animation.samplers.append(gl.AnimationSampler(input=times, output=output, interpolation="LINEAR"))

    def _vertices(self, values: np.ndarray, bounds: bool = False, normalized: bool = True) -> int:
        """An accessor for a vertex attribute, shape (n, k), whose integers are shares of their largest or not."""
        whole = values.dtype != np.float32
        return self._accessor(values, _VERTEX_BUFFER, bounds, normalized and whole, padded=True)

    def _accessor(
        self,
        values: np.ndarray,
        target: int | None = None,
        bounds: bool = False,
        normalized: bool = False,
        padded: bool = False,
    ) -> int:
        """An accessor for numbers, shape (count, width); ``padded`` rows start at multiples of 4 bytes."""
        gl, document = self._gl, self._document
        count, width = values.shape
        row = width * values.itemsize
        data = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<")).view(np.uint8).reshape(count, row)
        if padded and row % 4:
            data = np.pad(data, ((0, 0), (0, -row % 4)))
        content = data.tobytes()
        stride = data.shape[1] if padded else None
        document.bufferViews.append(
            gl.BufferView(buffer=0, byteOffset=self._length, byteLength=len(content), target=target, byteStride=stride)
        )
        self._chunks.append(content)
        self._length += len(content)
        document.accessors.append(
            gl.Accessor(
                bufferView=len(document.bufferViews) - 1,
                byteOffset=0,
                componentType=_COMPONENTS[values.dtype],
                normalized=normalized,
                count=count,
                type=_WIDTHS[width],
                min=values.min(axis=0).tolist() if bounds else None,
                max=values.max(axis=0).tolist() if bounds else None,
            )
        )
        return len(document.accessors) - 1

    def finish(self) -> bytes:
        """The file's bytes."""
        document = self._document
        if not document.animations[0].channels:
            document.animations = []
        document.buffers.append(self._gl.Buffer(byteLength=self._length))
        document.set_binary_blob(b"".join(self._chunks))
        return b"".join(document.save_to_bytes())


def _quantized(values: np.ndarray, kind: type[np.signedinteger]) -> np.ndarray:
    """Values in -1..1 as normalised integers q; glTF decodes them as max(q / 127, -1), or 32767 for 16 bits."""
    largest = np.iinfo(kind).max
    return np.round(np.clip(values, -1.0, 1.0) * largest).astype(kind)


def unit_normals(normals: np.ndarray) -> np.ndarray:
    """Normals, shape (..., 3), with one at lone vertices too, which glTF asks for."""
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.where(length > 0.5, normals, np.array([0.0, 1.0, 0.0], np.float32)).astype(np.float32)


def _without_rigid_motion(
    frames: np.ndarray, normals: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A mesh's travel and turn as a whole, and what is left.

    The turn of a frame is the rotation that brings the first frame nearest to it in the sense of least squares
    (Kabsch 1976).

    Returns:
        mean of the vertices [m], float64, shape (f, 3); turn since the first frame, quaternions (f, 4); vertices about
        the mean, turned back [m], float64, shape (f, n, 3), and normals turned back, shape (f, n, 3).
    """
    middle = frames.mean(axis=1, dtype=np.float64)  # float64 until the small rest is left
    local = frames - middle[:, None, :]
    u, _, vt = np.linalg.svd(np.einsum("na,fnb->fab", local[0], local))
    vt[:, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    turned = u @ vt  # a row vector times it is turned as the frame is
    back = np.swapaxes(turned, 1, 2)
    return middle, _without_jumps(quaternions(back)), local @ back, normals @ back


def _without_jumps(rotation: np.ndarray) -> np.ndarray:
    """Quaternions over time, shape (f, ..., 4), each on the side of the one before it: q and -q are one rotation."""
    against = np.einsum("...a,...a->...", rotation[1:], rotation[:-1]) < 0.0
    signs = np.where(np.cumsum(against, axis=0) % 2 == 1, -1.0, 1.0)
    return np.concatenate([rotation[:1], rotation[1:] * signs[..., None]])


def _normal_deltas(base: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """What is added to the base normals to point along others, within -1..1 and shape (f, n, 3).

    The difference of two unit vectors can reach 2, and normalised integers cannot. Normals are normalised after
    morphing, so only the sum's direction counts: the other normal is shortened until the difference fits.
    """
    with np.errstate(divide="ignore"):
        longest = ((1.0 + base * np.sign(normals)) / np.abs(normals)).min(axis=2, keepdims=True)
    return np.minimum(longest, 1.0) * normals - base
