"""Point caches of other programs: the vertices of a mesh over time, in PC2 or MDD files with the mesh beside.

Both formats hold positions alone. The faces are those of the .obj file of the same name, whose vertices come in the
same order; lengths are metres, Y is up.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from assets.io.obj import ObjMesh, read_obj
from pbd.errors import InputError
from pbd.mesh import edges_of

__all__ = ["mesh_beside", "read_mdd", "read_pc2"]

_PC2_HEADER = np.dtype([("sign", "S12"), ("version", "<i4"), ("points", "<i4"), ("start", "<f4"), ("step", "<f4"),
                        ("samples", "<i4")])  # fmt: skip
# Median edge of the cache's first frame over that of the mesh beside: further off, they are not of one mesh.
_EDGE_RATIOS = (0.67, 1.5)
# A frame that is so much nearer to the mesh once its up axis is turned is of another up axis [-].
_MUCH_NEARER = 0.5
_MAX_UNEVEN = 0.05  # by which the steps of an MDD file may differ from their mean, in shares of it


def read_pc2(path: Path, rate_hz: float) -> tuple[NDArray[np.float32], float]:
    """Read a PC2 file, which counts in frames and does not know how many of them a second has.

    Args:
        path: the file.
        rate_hz: frames a second.

    Returns:
        vertices [m], shape (samples, n, 3), and the time from sample to sample [s].

    Raises:
        InputError: the file cannot be read, is no PC2 file, or its size disagrees with its counts.
    """
    data = _bytes(path, "a PC2 file")
    if len(data) < _PC2_HEADER.itemsize or not data.startswith(b"POINTCACHE2\0"):
        received = f"{len(data)} bytes that begin with {data[:12]!r}"
        raise InputError("not a PC2 file", file=path, received=received, expected=r"a header with b'POINTCACHE2\0'")
    header = np.frombuffer(data, _PC2_HEADER, 1)[0]
    step = float(header["step"])
    if header["version"] != 1:
        raise InputError("an unknown version", file=path, key="version", received=int(header["version"]), expected="1")
    if not 0.0 < step < np.inf:
        raise InputError("bad sample rate", file=path, key="sample rate", received=step, expected="frames, above 0")
    count, points = int(header["samples"]), int(header["points"])
    _check_size(path, count, points, len(data), _PC2_HEADER.itemsize)
    vertices = np.frombuffer(data, "<f4", offset=_PC2_HEADER.itemsize).reshape(count, points, 3)
    return vertices.astype(np.float32), step / rate_hz


def read_mdd(path: Path) -> tuple[NDArray[np.float32], float]:
    """Read an MDD file.

    Returns:
        vertices [m], shape (frames, n, 3), and the time from frame to frame [s].

    Raises:
        InputError: the file cannot be read, its size disagrees with its counts, or its times are not uniform.
    """
    data = _bytes(path, "an MDD file")
    if len(data) < 8:
        raise InputError("a truncated file", file=path, received=f"{len(data)} bytes", expected="an MDD file")
    count, points = (int(number) for number in np.frombuffer(data, ">i4", 2))
    _check_size(path, count, points, len(data), 8, 4)
    times = np.frombuffer(data, ">f4", count, 8).astype(np.float64)
    vertices = np.frombuffer(data, ">f4", offset=8 + 4 * count).reshape(count, points, 3)
    step = (times[-1] - times[0]) / (count - 1) if count > 1 else 1.0  # of a single frame any will do
    steps = np.diff(times)
    if not np.isfinite(times).all() or step <= 0.0 or (np.abs(steps - step) > _MAX_UNEVEN * step).any():
        raise InputError(
            "times that are not uniform",
            file=path,
            key="times",
            received=f"steps of {steps.min():g} to {steps.max():g}" if count > 1 else times.tolist(),
            expected="steps of one length [s]",
        )
    return vertices.astype(np.float32), step


def mesh_beside(path: Path, first: NDArray[np.float32]) -> ObjMesh:
    """The .obj file beside a point cache.

    Args:
        path: the point cache.
        first: its first frame [m], shape (n, 3).

    Raises:
        InputError: there is no such file, it cannot be read, it is not the mesh of the cache, or one of both has
            another axis up.
    """
    beside = path.with_suffix(".obj")
    if not beside.is_file():
        expected = f"the mesh of the cache at {beside}: it holds no faces of its own"
        raise InputError("no mesh beside", file=path, expected=expected)
    mesh = read_obj(beside)
    if len(mesh.vertices) != len(first):
        raise InputError(
            "another mesh than that of the point cache beside",
            file=beside,
            key="vertices",
            received=len(mesh.vertices),
            expected=f"{len(first)}, as in {path.name}",
        )
    if not len(mesh.faces):
        raise InputError("a mesh without faces", file=beside, expected=f"the mesh of {path.name}")
    a, b = edges_of(mesh.faces)[0].T
    with np.errstate(invalid="ignore"):  # values that are not finite are named later
        lengths = [float(np.median(np.linalg.norm(x[a] - x[b], axis=1))) for x in (first.astype(float), mesh.vertices)]
    ratio = lengths[0] / max(lengths[1], 1e-12)
    if np.isfinite(ratio) and not _EDGE_RATIOS[0] <= ratio <= _EDGE_RATIOS[1]:
        raise InputError(
            "a mesh with other edges than the point cache beside: another order of vertices, or another unit",
            file=beside,
            key="median edge in the cache over that in the mesh",
            received=f"{ratio:.3g}",
            expected=f"{_EDGE_RATIOS[0]} to {_EDGE_RATIOS[1]}",
        )
    if turn := _other_up(first.astype(float), mesh.vertices):
        raise InputError(
            "a point cache with another axis up than the mesh beside",
            file=path,
            received=f"frame 0 is like the mesh turned by {turn} degrees about X",
            expected="both with Y up",
        )
    return mesh


def _other_up(first: NDArray[np.float64], mesh: NDArray[np.float64]) -> int | None:
    """By how much a frame must be turned about X to be like the mesh [degrees]; None if it is as near as it stands."""
    x, y, z = (first - first.mean(axis=0)).T
    ways = {0: (x, y, z), 90: (x, -z, y), -90: (x, z, -y)}
    apart = {angle: float(np.linalg.norm(np.transpose(way) - mesh + mesh.mean(axis=0))) for angle, way in ways.items()}
    nearest = min(apart, key=lambda angle: apart[angle])
    return nearest if apart[nearest] < _MUCH_NEARER * apart[0] else None


def _bytes(path: Path, expected: str) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        problem = f"cannot be read: {(error.strerror or str(error)).lower()}"
        raise InputError(problem, file=path, expected=expected) from error


def _check_size(path: Path, count: int, points: int, length: int, header: int, bytes_a_frame: int = 0) -> None:
    """The counts are positive and the file is as long as they say."""
    if count < 1 or points < 1:
        received, expected = f"{count} frames of {points} points", "at least one of each"
        raise InputError("no points", file=path, key="counts", received=received, expected=expected)
    expected_length = header + count * (bytes_a_frame + 12 * points)
    if length != expected_length:
        raise InputError(
            "a truncated file, or one of another format",
            file=path,
            key=f"{count} frames of {points} points",
            received=f"{length} bytes",
            expected=f"{expected_length} bytes",
        )
