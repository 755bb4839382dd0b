"""Baked animations: glTF binary with a morph target a frame, point caches and OBJ sequences.

Arrays are in the glTF convention, which is the project's own: metres, Y up, counter-clockwise faces outside.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pbd.errors import InputError
from pbd.storage import replacing
from wrinkles.metrics import vertex_normals

__all__ = ["bake_glb", "bake_obj", "bake_pc2"]

_UNSIGNED_INT, _FLOAT, _SHORT = 5125, 5126, 5122
_VERTEX_BUFFER, _INDEX_BUFFER = 34962, 34963
_SHORT_MAX = 32767
# A base normal is stored a little shorter than 1 (glTF's validator allows 0.67 %), so that even the opposite normal
# can be reached by a delta within -1..1: see _normal_deltas.
_BASE_NORMAL_LENGTH = 0.995


@dataclass(frozen=True)
class _Track:
    """One animated mesh: positions float32 [m] (f, n, 3), unit normals float32 (f, n, 3)."""

    name: str
    faces: np.ndarray
    frames: np.ndarray
    rate_hz: float
    normals: np.ndarray
    color: tuple[float, float, float, float]
    double_sided: bool


def bake_glb(
    path: str | os.PathLike[str],
    garment_faces: np.ndarray,
    garment_frames: np.ndarray,
    rate_hz: float,
    *,
    normals: np.ndarray | None = None,
    body_faces: np.ndarray | None = None,
    body_frames: np.ndarray | None = None,
    body_rate_hz: float | None = None,
) -> None:
    """Write an animated glTF 2.0 binary: garment, and body where given, as meshes with a morph target a frame.

    The mesh itself is the first frame; the weight of the target of frame k rises from 0 to 1 between the key times of
    frames k - 1 and k and falls again until that of frame k + 1, so a player at any rate sees linear interpolation.
    The mean of a mesh's vertices moves as its node's translation; what is left is stored as 16-bit deltas
    (KHR_mesh_quantization): 16 bytes a vertex and frame. Positions are exact to 0.02 mm while no vertex moves by more
    than 1 m against that mean, and to 1 / 32767 of that movement beyond; normals to 0.02 degrees in the mean, and to
    0.5 degrees where one turns right round.

    Args:
        path: file to write; it is never half-written.
        garment_faces: vertex indices, shape (m, 3).
        garment_frames: [m], shape (f, n, 3), world coordinates.
        rate_hz: frames a second of the garment.
        normals: unit normals, shape (f, n, 3); area-weighted ones are made where absent.
        body_faces: vertex indices of the body, shape (k, 3).
        body_frames: [m], shape (g, b, 3), world coordinates; starts with the garment's first frame.
        body_rate_hz: frames a second of the body, where it differs from the garment's.

    Raises:
        InputError: shapes do not match, a vertex is not finite, or a rate is not positive.
    """
    tracks = [_track("garment", garment_faces, garment_frames, rate_hz, normals, (0.09, 0.21, 0.45, 1.0), True)]
    if (body_faces is None) != (body_frames is None):
        raise InputError(
            "a body needs both faces and frames", key="body_faces" if body_faces is None else "body_frames"
        )
    if body_faces is not None and body_frames is not None:
        body_rate_hz = rate_hz if body_rate_hz is None else body_rate_hz
        tracks.append(_track("body", body_faces, body_frames, body_rate_hz, None, (0.56, 0.34, 0.25, 1.0), False))
    file = _GlbFile()
    for track in tracks:
        file.add(track)
    _write(path, file.finish())


def bake_pc2(path: str | os.PathLike[str], faces: np.ndarray, frames: np.ndarray) -> None:
    """Write a point cache (PC2, float32) and, beside it with the ending ``.obj``, the mesh that it moves.

    The cache holds one sample for each frame of the scene that plays it; it has no rate of its own.

    Args:
        path: the ``.pc2`` file.
        faces: vertex indices, shape (m, 3).
        frames: [m], shape (f, n, 3).

    Raises:
        InputError: shapes do not match or a vertex is not finite.
    """
    path = Path(path)
    faces, frames = _checked(faces, frames, "frames")
    header = np.zeros((), dtype=[("sign", "S12"), ("version", "<i4"), ("points", "<i4"), ("start", "<f4"),
                                 ("rate", "<f4"), ("samples", "<i4")])  # fmt: skip
    header["sign"], header["version"], header["rate"] = b"POINTCACHE2", 1, 1.0
    header["points"], header["samples"] = frames.shape[1], len(frames)
    _write(path.with_suffix(".obj"), _obj(faces, frames[0]))
    _write(path, header.tobytes() + frames.astype("<f4").tobytes())


def bake_obj(path: str | os.PathLike[str], faces: np.ndarray, frames: np.ndarray) -> list[Path]:
    """Write one OBJ a frame: ``dress.obj`` gives ``dress_0000.obj``, ``dress_0001.obj`` and so on.

    Args:
        path: name that the files' names are made from.
        faces: vertex indices, shape (m, 3).
        frames: [m], shape (f, n, 3).

    Returns:
        the files written, in order.

    Raises:
        InputError: shapes do not match or a vertex is not finite.
    """
    path = Path(path)
    faces, frames = _checked(faces, frames, "frames")
    files = [path.with_name(f"{path.stem}_{index:04d}.obj") for index in range(len(frames))]
    for file, vertices in zip(files, frames, strict=True):
        _write(file, _obj(faces, vertices))
    return files


def _write(path: str | os.PathLike[str], content: bytes) -> None:
    with replacing(Path(path)) as beside:
        beside.write_bytes(content)


def _obj(faces: np.ndarray, vertices: np.ndarray) -> bytes:
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    return ("\n".join(lines) + "\n").encode()


def _checked(faces: np.ndarray, frames: np.ndarray, key: str) -> tuple[np.ndarray, np.ndarray]:
    """Faces and frames as arrays that can be written."""
    faces, frames = np.asarray(faces), np.asarray(frames)
    faces_key = key.replace("frames", "faces")
    if frames.ndim != 3 or frames.shape[2] != 3 or frames.size == 0:
        raise InputError("not a sequence of vertices", key=key, received=frames.shape, expected="shape (f, n, 3)")
    if not np.isfinite(frames).all():
        raise InputError("a vertex is not finite", key=key)
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.size == 0:
        raise InputError("not faces", key=faces_key, received=faces.shape, expected="shape (m, 3)")
    if faces.min() < 0 or faces.max() >= frames.shape[1]:
        raise InputError(
            "faces do not fit the vertices",
            key=faces_key,
            received=f"indices {faces.min()} to {faces.max()}",
            expected=f"indices 0 to {frames.shape[1] - 1}",
        )
    return faces, frames


def _track(
    name: str,
    faces: np.ndarray,
    frames: np.ndarray,
    rate_hz: float,
    normals: np.ndarray | None,
    color: tuple[float, float, float, float],
    double_sided: bool,
) -> _Track:
    faces, frames = _checked(faces, frames, f"{name}_frames")
    if not (np.isfinite(rate_hz) and rate_hz > 0.0):
        raise InputError("a rate must be positive", key="rate_hz", received=rate_hz, expected="frames a second")
    if normals is None:
        normals = vertex_normals(frames, faces)
    normals = np.asarray(normals, dtype=np.float32)
    if normals.shape != frames.shape:
        raise InputError(
            "normals do not match the frames", key="normals", received=normals.shape, expected=str(frames.shape)
        )
    length = np.linalg.norm(normals, axis=2, keepdims=True)  # glTF wants a unit normal at lone vertices too
    normals = np.where(length > 0.5, normals, np.array([0.0, 1.0, 0.0], np.float32))
    return _Track(name, faces, frames, rate_hz, normals, color, double_sided)


def _normal_deltas(base: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """What is added to the base normals to point along others, within -1..1 and shape (f, n, 3).

    The difference of two unit vectors can reach 2, and 16-bit deltas cannot. Normals are normalised after morphing,
    so only the sum's direction counts: the other normal is shortened until the difference fits.
    """
    with np.errstate(divide="ignore"):
        longest = ((1.0 + base * np.sign(normals)) / np.abs(normals)).min(axis=2, keepdims=True)
    return np.minimum(longest, 1.0) * normals - base


class _GlbFile:
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

    def add(self, track: _Track) -> None:
        """One node with one mesh, moved by a translation and by morph weights."""
        gl, document = self._gl, self._document
        # The mean carries the travel; float64 until the small rest is left.
        middle = track.frames.mean(axis=1, dtype=np.float64)
        local = track.frames - middle[:, None, :]
        delta = local[1:] - local[0]
        scale = max(1.0, float(np.abs(delta).max(initial=0.0)))
        base_normals = _BASE_NORMAL_LENGTH * track.normals[0]
        positions = _to_short(delta / scale)
        normals = _to_short(_normal_deltas(base_normals, track.normals[1:]))
        primitive = gl.Primitive(
            attributes=gl.Attributes(
                POSITION=self._vertices((local[0] / scale).astype(np.float32), bounds=True),
                NORMAL=self._vertices(base_normals),
            ),
            indices=self._accessor(track.faces.astype("<u4").ravel(), "SCALAR", _UNSIGNED_INT, target=_INDEX_BUFFER),
            material=len(document.materials),
            targets=[
                {"POSITION": self._vertices(positions[k], bounds=True), "NORMAL": self._vertices(normals[k])}
                for k in range(len(positions))
            ],
        )
        document.materials.append(
            gl.Material(
                name=track.name,
                doubleSided=track.double_sided,
                pbrMetallicRoughness=gl.PbrMetallicRoughness(
                    baseColorFactor=list(track.color), metallicFactor=0.0, roughnessFactor=0.85
                ),
            )
        )
        names = [f"frame {k}" for k in range(1, len(track.frames))]
        document.meshes.append(
            gl.Mesh(name=track.name, primitives=[primitive], weights=[0.0] * len(names), extras={"targetNames": names})
        )
        node = len(document.nodes)
        document.nodes.append(
            gl.Node(name=track.name, mesh=node, translation=middle[0].tolist(), scale=[scale, scale, scale])
        )
        document.scenes[0].nodes.append(node)
        self._animate(node, track, middle)

    def _animate(self, node: int, track: _Track, middle: np.ndarray) -> None:
        count = len(track.frames)
        if count < 2:
            return
        times = self._accessor((np.arange(count) / track.rate_hz).astype(np.float32), "SCALAR", _FLOAT, bounds=True)
        weights = np.eye(count, dtype=np.float32)[:, 1:]
        self._channel(node, "weights", times, self._accessor(weights.ravel(), "SCALAR", _FLOAT))
        self._channel(node, "translation", times, self._accessor(middle.astype(np.float32), "VEC3", _FLOAT))

    def _channel(self, node: int, path: str, times: int, values: int) -> None:
        gl, animation = self._gl, self._document.animations[0]
        target = gl.AnimationChannelTarget(node=node, path=path)
        animation.channels.append(gl.AnimationChannel(sampler=len(animation.samplers), target=target))
        animation.samplers.append(gl.AnimationSampler(input=times, output=values, interpolation="LINEAR"))

    def _vertices(self, values: np.ndarray, bounds: bool = False) -> int:
        """An accessor for a vertex attribute, shape (n, 3), float32 or int16 (normalised, padded to 8 bytes)."""
        kind = _SHORT if values.dtype == np.int16 else _FLOAT
        return self._accessor(values, "VEC3", kind, target=_VERTEX_BUFFER, bounds=bounds)

    def _accessor(
        self, values: np.ndarray, shape: str, kind: int, target: int | None = None, bounds: bool = False
    ) -> int:
        gl, document = self._gl, self._document
        short = kind == _SHORT
        stored = np.pad(values, ((0, 0), (0, 1))) if short else values  # rows must start at multiples of 4 bytes
        data = np.ascontiguousarray(stored, dtype=stored.dtype.newbyteorder("<")).tobytes()
        document.bufferViews.append(
            gl.BufferView(
                buffer=0, byteOffset=self._length, byteLength=len(data), target=target, byteStride=8 if short else None
            )
        )
        self._chunks.append(data)
        self._length += len(data)
        columns = values.reshape(len(values), -1)
        document.accessors.append(
            gl.Accessor(
                bufferView=len(document.bufferViews) - 1,
                byteOffset=0,
                componentType=kind,
                normalized=short,
                count=len(values),
                type=shape,
                min=columns.min(axis=0).tolist() if bounds else None,
                max=columns.max(axis=0).tolist() if bounds else None,
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


def _to_short(values: np.ndarray) -> np.ndarray:
    """Values in -1..1 as normalised 16-bit integers; glTF decodes them as max(q / 32767, -1)."""
    return np.round(np.clip(values, -1.0, 1.0) * _SHORT_MAX).astype(np.int16)
