"""Baked animations: glTF binary with a morph target a frame, USD, point caches and OBJ sequences.

Arrays are in the glTF convention, which is the project's own: metres, Y up, counter-clockwise faces outside.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from assets.character import Character
from assets.io.obj import face_lines
from assets.io.sequence import Sequence
from assets.texture import checked
from pbd.arrays import floats, integers, numbers
from pbd.errors import InputError
from pbd.storage import replacing
from runtime.export.glb import Color, GlbFile, Track, unit_normals
from runtime.export.usd_animation import UsdFile
from wrinkles.mesh_measures import vertex_normals

__all__ = ["bake_glb", "bake_mdd", "bake_obj", "bake_pc2", "bake_usd"]

_GARMENT_COLORS = (0.09, 0.21, 0.45, 1.0), (0.62, 0.58, 0.5, 1.0), (0.3, 0.05, 0.06, 1.0), (0.06, 0.2, 0.12, 1.0)
_BODY_COLOR = (0.56, 0.34, 0.25, 1.0)


def bake_glb(
    path: str | os.PathLike[str],
    garment_faces: np.ndarray,
    garment_frames: np.ndarray,
    rate_hz: float,
    *,
    normals: np.ndarray | None = None,
    body: Character | Sequence | None = None,
    poses: np.ndarray | None = None,
    garments: Mapping[str, np.ndarray] | None = None,
    texture: np.ndarray | None = None,
) -> None:
    """Write an animated glTF 2.0 binary: the garment as a mesh with a morph target a frame, and its body.

    The garment's travel and turn as a whole are its node's. The weight of the target of frame k rises from 0 to 1
    between the key times of frames k - 1 and k and falls again until that of frame k + 1, so a player at any rate sees
    linear interpolation of what is left. It is stored as 16-bit deltas of positions and 8-bit deltas of
    normals from the first frame (KHR_mesh_quantization): 12 bytes a vertex and frame. Positions are exact to 0.03 mm
    while no vertex moves by more than 1 m against the whole, and to 1 / 32767 of that movement beyond; normals to a
    quarter of a degree in the mean, less exactly where one has turned by more than 90 degrees since the first frame.

    A character is stored as a skinned mesh whose joints move: some hundred bytes a joint and frame. A vertex sequence
    is stored as the garment is.

    Args:
        path: file to write; it is never half-written.
        garment_faces: vertex indices, shape (m, 3).
        garment_frames: [m], shape (f, n, 3), world coordinates.
        rate_hz: frames a second.
        normals: unit normals, shape (f, n, 3); area-weighted ones are made where absent.
        body: what wears the garment.
        poses: of the body, one for each frame of the garment: skinning matrices (f, joints, 3, 4) of a character,
            vertices (f, b, 3) of a vertex sequence.
        garments: vertices of each garment of an outfit by its name, int, shapes (k,): each is a mesh with a material of
            its own. None writes one mesh, "garment".
        texture: texture coordinates of each corner of the garment's faces, v upwards, shape (m, 3, 2), NaN at faces
            without; a vertex with several is written as several. None writes none.

    Raises:
        InputError: shapes do not match, a value is not finite, a joint shears, or a rate is not positive.
    """
    tracks = _garment_tracks(garment_faces, garment_frames, rate_hz, normals, garments, texture)
    _check_poses(body, poses, len(tracks[0].frames))
    file = GlbFile()
    for track in tracks:
        file.add(track)
    if body is not None and poses is not None:
        if isinstance(body, Character):
            file.add_character(body, poses, rate_hz, _BODY_COLOR)
        else:
            drawn = np.stack([body.drawn(pose) for pose in poses])
            file.add(_track("body", body.faces, drawn, rate_hz, None, _BODY_COLOR, False, body.texture))
    _write(path, file.finish())


def bake_usd(
    path: str | os.PathLike[str],
    garment_faces: np.ndarray,
    garment_frames: np.ndarray,
    rate_hz: float,
    *,
    normals: np.ndarray | None = None,
    body: Character | Sequence | None = None,
    poses: np.ndarray | None = None,
    garments: Mapping[str, np.ndarray] | None = None,
    texture: np.ndarray | None = None,
) -> None:
    """Write a binary USD file (.usdc): the garment as a mesh with time samples, and its body.

    Frame k is the time code k; units are metres, Y is up. Positions and normals are float32: 24 bytes a vertex and
    frame, linear between frames. A character is stored as a skinned mesh with its skeleton and one animation (UsdSkel),
    a vertex sequence as the garment is. Each mesh has a material (UsdPreviewSurface).

    Args:
        path: file to write; it is never half-written.
        garment_faces: vertex indices, shape (m, 3).
        garment_frames: [m], shape (f, n, 3), world coordinates.
        rate_hz: frames a second.
        normals: unit normals, shape (f, n, 3); area-weighted ones are made where absent.
        body: what wears the garment.
        poses: of the body, one for each frame of the garment, as :func:`bake_glb` takes them.
        garments, texture: as :func:`bake_glb` takes them. Texture coordinates are the primvar ``st``.

    Raises:
        InputError: shapes do not match, a value is not finite, a joint shears, or a rate is not positive.
    """
    tracks = _garment_tracks(garment_faces, garment_frames, rate_hz, normals, garments, texture)
    _check_poses(body, poses, len(tracks[0].frames))
    file = UsdFile(rate_hz, len(tracks[0].frames))
    for track in tracks:
        file.add(track)
    if body is not None and poses is not None:
        if isinstance(body, Character):
            file.add_character(body, poses, _BODY_COLOR)
        else:
            drawn = np.stack([body.drawn(pose) for pose in poses])
            file.add(_track("body", body.faces, drawn, rate_hz, None, _BODY_COLOR, False, body.texture))
    file.write(Path(path))


def bake_pc2(
    path: str | os.PathLike[str], faces: np.ndarray, frames: np.ndarray, texture: np.ndarray | None = None
) -> None:
    """Write a point cache (PC2, float32) and, beside it with the ending ``.obj``, the mesh that it moves.

    The cache holds one sample for each frame of the scene that plays it; it has no rate of its own.

    Args:
        path: the ``.pc2`` file.
        faces: vertex indices, shape (m, 3).
        frames: [m], shape (f, n, 3).
        texture: as :func:`bake_glb` takes it, for the mesh.

    Raises:
        InputError: shapes do not match or a vertex is not finite.
    """
    path = Path(path)
    faces, frames = _checked(faces, frames, "frames")
    header = np.zeros((), dtype=[("sign", "S12"), ("version", "<i4"), ("points", "<i4"), ("start", "<f4"),
                                 ("rate", "<f4"), ("samples", "<i4")])  # fmt: skip
    header["sign"], header["version"], header["rate"] = b"POINTCACHE2", 1, 1.0
    header["points"], header["samples"] = frames.shape[1], len(frames)
    _write(path.with_suffix(".obj"), _obj(_face_lines(faces, texture), frames[0]))
    _write(path, header.tobytes() + frames.astype("<f4").tobytes())


def bake_mdd(
    path: str | os.PathLike[str],
    faces: np.ndarray,
    frames: np.ndarray,
    rate_hz: float,
    texture: np.ndarray | None = None,
) -> None:
    """Write a point cache (MDD, float32) and, beside it with the ending ``.obj``, the mesh that it moves.

    The file is big-endian: number of frames and of points (int32), the time of each frame [s], then the points frame
    by frame [m].

    Args:
        path: the ``.mdd`` file.
        faces: vertex indices, shape (m, 3).
        frames: [m], shape (f, n, 3).
        rate_hz: frames a second.
        texture: as :func:`bake_glb` takes it, for the mesh.

    Raises:
        InputError: shapes do not match, a vertex is not finite, or a rate is not positive.
    """
    path = Path(path)
    faces, frames = _checked(faces, frames, "frames")
    _check_rate(rate_hz)
    header = np.array(frames.shape[:2], ">i4").tobytes() + (np.arange(len(frames)) / rate_hz).astype(">f4").tobytes()
    _write(path.with_suffix(".obj"), _obj(_face_lines(faces, texture), frames[0]))
    _write(path, header + frames.astype(">f4").tobytes())


def bake_obj(
    path: str | os.PathLike[str], faces: np.ndarray, frames: np.ndarray, texture: np.ndarray | None = None
) -> list[Path]:
    """Write one OBJ a frame: ``dress.obj`` gives ``dress_0000.obj`` for the first, ``dress_0001.obj`` for the next.

    Args:
        path: name that the files' names are made from.
        faces: vertex indices, shape (m, 3).
        frames: [m], shape (f, n, 3).
        texture: as :func:`bake_glb` takes it.

    Returns:
        the files written, in order.

    Raises:
        InputError: shapes do not match or a vertex is not finite.
    """
    path = Path(path)
    faces, frames = _checked(faces, frames, "frames")
    files = [path.with_name(f"{path.stem}_{index:04d}.obj") for index in range(len(frames))]
    lines = _face_lines(faces, texture)
    for file, vertices in zip(files, frames, strict=True):
        _write(file, _obj(lines, vertices))
    return files


def _write(path: str | os.PathLike[str], content: bytes) -> None:
    with replacing(Path(path)) as beside:
        beside.write_bytes(content)


def _obj(faces: bytes, vertices: np.ndarray) -> bytes:
    return b"".join(b"v %.6f %.6f %.6f\n" % tuple(vertex) for vertex in vertices.tolist()) + faces


def _face_lines(faces: np.ndarray, texture: np.ndarray | None) -> bytes:
    return ("\n".join(face_lines(faces, _checked_texture(texture, faces))) + "\n").encode()


def _checked_texture(texture: np.ndarray | None, faces: np.ndarray) -> np.ndarray | None:
    """Texture coordinates as they are written: None where no face has any."""
    if texture is None:
        return None
    texture = checked(texture, len(faces))
    return None if np.isnan(texture).all() else texture


def _check_poses(body: Character | Sequence | None, poses: np.ndarray | None, frame_count: int) -> None:
    """Body and poses come together, one pose for each frame."""
    if (body is None) != (poses is None):
        raise InputError("a body needs poses, and poses a body", key="body" if body is None else "poses")
    if body is not None and poses is not None:
        one = (body.joint_count, 3, 4) if isinstance(body, Character) else body.vertices.shape[1:]
        poses = numbers(poses, "poses", ("f", *one), "not poses of this body")
        if len(poses) != frame_count:
            expected = f"{frame_count}, one for each frame of the garment"
            raise InputError("poses do not match the frames", key="poses", received=len(poses), expected=expected)


def _check_rate(rate_hz: float) -> None:
    if floats(rate_hz, "rate_hz", (), "a rate must be positive") <= 0.0:
        raise InputError("a rate must be positive", key="rate_hz", received=rate_hz, expected="frames a second")


def _checked(faces: np.ndarray, frames: np.ndarray, key: str) -> tuple[np.ndarray, np.ndarray]:
    """Faces and frames as arrays that can be written."""
    faces_key = key.replace("frames", "faces")
    frames = floats(frames, key, ("f", "n", 3), unit=" [m]")
    faces = integers(faces, faces_key, ("m", 3), frames.shape[1], outside="faces do not fit the vertices")
    for name, array in ((key, frames), (faces_key, faces)):
        if array.size == 0:
            raise InputError("an empty array", key=name, received=array.shape, expected="at least one row")
    return faces, frames


def _garment_tracks(
    faces: np.ndarray,
    frames: np.ndarray,
    rate_hz: float,
    normals: np.ndarray | None,
    garments: Mapping[str, np.ndarray] | None,
    texture: np.ndarray | None,
) -> list[Track]:
    """One mesh, or that of each garment of an outfit; arguments as for :func:`bake_glb`."""
    whole = _track("garment", faces, frames, rate_hz, normals, _GARMENT_COLORS[0], True, texture)
    if garments is None:
        return [whole]
    tracks = []
    for number, (name, vertices) in enumerate(garments.items()):
        key, outside = f"garments, {name}", "a vertex that the frames do not have"
        vertices = integers(vertices, key, ("k",), whole.frames.shape[1], outside=outside)
        own_number = np.full(whole.frames.shape[1], -1, np.int32)
        own_number[vertices] = np.arange(len(vertices))
        own_faces = own_number[whole.faces]
        own = (own_faces >= 0).all(axis=1)
        tracks.append(
            replace(
                whole,
                name=name if name != "body" else "body_garment",
                faces=own_faces[own],
                frames=whole.frames[:, vertices],
                normals=whole.normals[:, vertices],
                color=_GARMENT_COLORS[number % len(_GARMENT_COLORS)],
                texture=None if whole.texture is None else _checked_texture(whole.texture[own], own_faces[own]),
            )
        )
    return tracks


def _track(
    name: str,
    faces: np.ndarray,
    frames: np.ndarray,
    rate_hz: float,
    normals: np.ndarray | None,
    color: Color,
    double_sided: bool,
    texture: np.ndarray | None,
) -> Track:
    faces, frames = _checked(faces, frames, f"{name}_frames")
    _check_rate(rate_hz)
    if normals is None:
        normals = vertex_normals(frames, faces)
    normals = floats(normals, "normals", frames.shape, "normals do not match the frames").astype(np.float32)
    texture = _checked_texture(texture, faces)
    return Track(name, faces, frames, rate_hz, unit_normals(normals), color, double_sided, texture)
