"""Bodies that are given as vertex positions over time."""

from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from assets.body_checks import check_right_side_out
from assets.character import SEQUENCE_SUFFIXES, USD_SUFFIXES
from assets.io.point_cache import mesh_beside, read_mdd, read_pc2
from assets.weld import check_unit
from pbd.attachment import smooth_normals
from pbd.engine import ensure_initialized, ti
from pbd.errors import InputError
from pbd.storage import BROKEN_NPZ
from pbd.taichi_internals import Launch

__all__ = ["Sequence", "SequenceBody", "SequenceMotion", "is_sequence", "load_sequence"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sequence:
    """A surface whose vertices are known at uniform times.

    Attributes:
        name: name for messages and figures.
        vertices: world positions [m], shape (frames, n, 3), float32.
        faces: shape (m, 3), int32.
        dt: time from frame to frame [s].
        inset: how far each vertex is drawn in along its normal [m], float32, shape (n,); None for a body as it is.
        texture: texture coordinates of each face corner, v upwards, shape (m, 3, 2), float64, NaN at faces without;
            None without any.
    """

    name: str
    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    dt: float
    inset: NDArray[np.float32] | None = None
    texture: Floats | None = None

    def drawn(self, vertices: np.ndarray) -> np.ndarray:
        """The vertices of a frame [m], shape (n, 3), drawn in by the inset."""
        if self.inset is None:
            return vertices
        return vertices - self.inset[:, None] * smooth_normals(vertices, self.faces)


def is_sequence(path: str | PathLike[str]) -> bool:
    """Whether a file holds a vertex sequence and no character: by its ending, a USD file by having no skeleton.

    Raises:
        InputError: a USD file that cannot be read.
    """
    path = Path(path)
    if path.suffix.lower() in USD_SUFFIXES:
        from assets.io.usd import has_skeleton  # needs usd-core, which other files do not

        return not has_skeleton(path)
    return path.suffix.lower() in SEQUENCE_SUFFIXES


def load_sequence(path: str | PathLike[str], rate_hz: float | None = None) -> Sequence:
    """Load a vertex sequence.

    Kinds of files: .npz with ``vertices``, ``faces`` and ``dt`` (see :class:`Sequence`); .mdd or .pc2 with the mesh
    beside as .obj; .usd, .usda, .usdc or .usdz with one mesh that moves.

    Args:
        path: the file.
        rate_hz: frames a second of a .pc2 file, which does not know them; None for any other.

    Raises:
        InputError: the file cannot be read or is truncated; a key is missing, holds objects, or has another shape;
            positions that are not finite; a face with a bad index; a size that cannot be metres, or a unit that the
            file does not say; faces of a closed body that point inwards; a rate that is missing or not asked for.
    """
    path = Path(path)
    suffix, texture = path.suffix.lower(), None
    if (rate_hz is not None) != (suffix == ".pc2"):
        expected = "none: the file knows it" if rate_hz else "frames a second: a .pc2 file does not know them"
        raise InputError("bad rate", file=path, key="rate", received=rate_hz, expected=expected)
    if suffix in USD_SUFFIXES:
        from assets.io.usd import read_point_cache  # needs usd-core, which other files do not

        vertices, faces, texture, dt = read_point_cache(path)
    elif suffix in (".mdd", ".pc2"):
        vertices, dt = read_mdd(path) if rate_hz is None else read_pc2(path, rate_hz)
        mesh = mesh_beside(path, vertices[0])
        faces, texture = mesh.faces, mesh.texture
    else:
        arrays = _read_arrays(path)
        vertices, faces, dt = arrays["vertices"], arrays["faces"], arrays["dt"]
        _check(path, "vertices", vertices, "f", vertices.ndim == 3 and vertices.shape[2] == 3 and vertices.size > 0)
        _check(path, "faces", faces, "iu", faces.ndim == 2 and faces.shape[1] == 3 and faces.size > 0)
        _check(path, "dt", dt, "fiu", dt.ndim == 0 and dt.dtype.kind in "fiu" and 0.0 < float(dt) < np.inf)
    _check_values(path, vertices, faces)
    check_unit(vertices[0], path)
    check_right_side_out(vertices[0].astype(float), faces, path)
    vertices, faces = vertices.astype(np.float32, copy=False), faces.astype(np.int32)
    return Sequence(path.stem, vertices, faces, float(dt), texture=texture)


def _check_values(path: Path, vertices: NDArray[Any], faces: NDArray[Any]) -> None:
    """All positions are finite, and faces name vertices that exist."""
    bad = np.argwhere(~np.isfinite(vertices).all(axis=2))
    if bad.size:
        frame, vertex = bad[0]
        raise InputError(
            "positions that are not finite",
            file=path,
            key=f"vertices, frame {frame}, vertex {vertex}",
            received=vertices[frame, vertex].tolist(),
        )
    count = vertices.shape[1]
    bad = np.flatnonzero(((faces < 0) | (faces >= count)).any(axis=1))
    if bad.size:
        raise InputError(
            "a face with a vertex that does not exist",
            file=path,
            key=f"face {bad[0]}",
            received=faces[bad[0]].tolist(),
            expected=f"0 to {count - 1}",
        )


class SequenceBody:
    """The surface of a sequence; its pose is the vertices themselves.

    Attributes:
        vertices: of the first frame [m], shape (n, 3), float64.
        faces: shape (m, 3), int32.
        pose_shape: shape of a pose: (n, 3).
    """

    def __init__(self, sequence: Sequence) -> None:
        ensure_initialized()
        self.vertices = sequence.vertices[0].astype(np.float64)
        self.faces, self.pose_shape = sequence.faces, self.vertices.shape
        self._drawn, self._local = sequence.drawn, np.zeros_like(sequence.vertices[0])
        self._copy = Launch(_copy)

    def skin(self, pose: Floats, origin: Floats, out: Any) -> None:
        """Write the vertices as they are drawn, world minus origin [m].

        Args:
            pose: vertices in the world [m], shape (n, 3), float64.
            origin: [m], shape (3,), float64; taken off before rounding to float32.
            out: float32, shape (n, 3); a Taichi array of n three-vectors, or a numpy array.
        """
        np.subtract(self._drawn(pose), origin, out=self._local, casting="same_kind")
        self._copy(self._local, out)


class SequenceMotion:
    """A sequence with straight lines between its frames, played from its beginning to an end.

    Clothes are made for its first frame: where a later part is meant, the frames before it lead to it.

    Args:
        sequence: the sequence to play.
        start, end: part that is meant [s]; None ends where the sequence ends.
        speed: its seconds per second [-].

    Attributes:
        name: the sequence's name.
        duration: from the first frame to the end [s].
        lead_in: from the first frame to the part that is meant [s].

    Raises:
        InputError: a part that begins after the sequence's end.
    """

    def __init__(self, sequence: Sequence, start: float = 0.0, end: float | None = None, speed: float = 1.0) -> None:
        length = (len(sequence.vertices) - 1) * sequence.dt
        if start > 0.0 and start >= length:
            received, expected = start, f"below {length:g} [s]"
            raise InputError("a part after the end", key="start", received=received, expected=expected)
        self.name = sequence.name
        self.duration = (length if end is None else min(end, length)) / speed
        self.lead_in = start / speed
        self._sequence, self._speed = sequence, speed

    def pose(self, t: float) -> Floats:
        """Vertices in the world at a time [s], clamped to the ends: [m], shape (n, 3), float64."""
        frames = self._sequence.vertices
        last = len(frames) - 1
        place = min(max(min(t, self.duration) * self._speed / self._sequence.dt, 0.0), last)
        frame = min(int(place), max(last - 1, 0))
        first = frames[frame].astype(np.float64)
        return first + (place - frame) * (frames[min(frame + 1, last)] - first)


@ti.kernel
def _copy(source: ti.types.ndarray(dtype=ti.math.vec3, ndim=1), out: ti.types.ndarray(dtype=ti.math.vec3, ndim=1)):
    ti.loop_config(serialize=True)
    for vertex in range(source.shape[0]):
        out[vertex] = source[vertex]


def _read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    try:
        file = np.load(path, allow_pickle=False)
        if not isinstance(file, np.lib.npyio.NpzFile):
            raise InputError("a single array", file=path, expected="an .npz file")
        with file:
            missing = [key for key in ("vertices", "faces", "dt") if key not in file]
            if missing:
                raise InputError(
                    "a missing key", file=path, key=missing[0], received=sorted(file), expected="vertices, faces and dt"
                )
            return {key: file[key] for key in ("vertices", "faces", "dt")}
    except OSError as error:
        problem = error.strerror or str(error)
        raise InputError("cannot be read", file=path, received=problem, expected="an .npz file") from error
    except InputError:
        raise
    except BROKEN_NPZ as error:
        what = str(error).partition(". ")[0].partition(":")[0]  # without numpy's advice
        raise InputError(
            f"truncated, damaged or no arrays of numbers: {what}",
            file=path,
            expected="an .npz file with vertices, faces and dt",
        ) from error


def _check(path: Path, key: str, array: NDArray[Any], kinds: str, holds: bool) -> None:
    wanted = {"vertices": "floats, (frames, n, 3)", "faces": "integers, (m, 3)", "dt": "one number above 0"}
    if array.dtype.kind not in kinds or not holds:
        received = float(array) if array.ndim == 0 and array.dtype.kind in "fiu" else f"{array.dtype} {array.shape}"
        raise InputError("bad array", file=path, key=key, received=received, expected=wanted[key])
