"""Point caches of other programs: written here by the formats' own words, loaded, refused."""

import re
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from assets.io.sequence import is_sequence, load_sequence
from pbd.errors import InputError
from tests.refusals import refuses

QUAD = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n"


def frames(count: int = 3) -> np.ndarray:
    """A square that rises by 0.1 m a frame."""
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
    return square + np.arange(count, dtype=np.float32)[:, None, None] * np.float32([0, 0.1, 0])


def pc2(
    samples: int = 3, points: int = 4, step: float = 1.0, version: int = 1, vertices: np.ndarray | None = None
) -> bytes:
    header = struct.pack("<12siiffi", b"POINTCACHE2\0", version, points, 0.0, step, samples)
    return header + (frames() if vertices is None else vertices).astype("<f4").tobytes()


def mdd(
    count: int = 3, points: int = 4, times: tuple[float, ...] = (0.0, 0.04, 0.08), vertices: np.ndarray | None = None
) -> bytes:
    body = np.array(times, ">f4").tobytes() + (frames() if vertices is None else vertices).astype(">f4").tobytes()
    return struct.pack(">ii", count, points) + body


def write(folder: Path, name: str, data: bytes, mesh: str | None = QUAD) -> Path:
    if mesh is not None:
        (folder / name).with_suffix(".obj").write_text(mesh)
    (folder / name).write_bytes(data)
    return folder / name


@pytest.mark.parametrize(("name", "data", "rate"), [("a.pc2", pc2(step=2.0), 50.0), ("a.mdd", mdd(), None)])
def test_a_cache_is_a_vertex_sequence(tmp_path: Path, name: str, data: bytes, rate: float | None) -> None:
    path = write(tmp_path, name, data)
    assert is_sequence(path)
    sequence = load_sequence(path, rate)
    assert np.array_equal(sequence.vertices, frames())
    assert sequence.dt == pytest.approx(0.04)
    assert sequence.faces.shape == (2, 3) and set(sequence.faces.ravel()) == {0, 1, 2, 3}


def test_a_single_frame_is_read(tmp_path: Path) -> None:
    sequence = load_sequence(write(tmp_path, "a.mdd", mdd(1, 4, (0.0,), frames(1))))
    assert sequence.vertices.shape == (1, 4, 3)


def spoiled() -> np.ndarray:
    vertices = frames()
    vertices[2, 1, 0] = np.nan
    return vertices


SHIFTED = QUAD.replace("v 1 1 0", "v 5 5 0").replace("v 0 1 0", "v 0 5 0").replace("v 1 0 0", "v 5 0 0")
REFUSED: dict[str, tuple[str, bytes, str | None, float | None, str]] = {
    "no rate": ("a.pc2", pc2(), QUAD, None, "rate: bad rate (expected frames a second"),
    "a rate too many": ("a.mdd", mdd(), QUAD, 25.0, "rate: bad rate (received 25.0, expected none"),
    "no mesh": ("a.mdd", mdd(), None, None, "no mesh beside"),
    "another mesh": ("a.mdd", mdd(), QUAD.replace("f", "v 2 2 2\nf"), None, "vertices: another mesh"),
    "no faces": ("a.mdd", mdd(), QUAD[: QUAD.index("f")], None, "without faces"),
    "another scale": ("a.mdd", mdd(), SHIFTED, None, "other edges than the point cache beside"),
    "Z up": ("a.mdd", mdd(vertices=frames()[..., [0, 2, 1]] * np.float32([1, -1, 1])), QUAD, None,
             "another axis up than the mesh beside (received 'frame 0 is like the mesh turned by -90 degrees about X'"),
    "bad sign": ("a.pc2", b"POINTCACHE3\0" + pc2()[12:], QUAD, 25.0, "not a PC2 file"),
    "bad version": ("a.pc2", pc2(version=2), QUAD, 25.0, "version: an unknown version (received 2, expected 1)"),
    "bad step": ("a.pc2", pc2(step=np.nan), QUAD, 25.0, "sample rate: bad sample rate (received nan"),
    "short header": ("a.pc2", pc2()[:20], QUAD, 25.0, "not a PC2 file (received \"20 bytes"),
    "short mdd": ("a.mdd", mdd()[:7], QUAD, None, "a truncated file (received '7 bytes'"),
    "gigantic": ("a.mdd", mdd(2**31 - 1, 2**31 - 1), QUAD, None, "2147483647 frames of 2147483647 points: a truncated"),
    "negative": ("a.mdd", mdd(-1), QUAD, None, "counts: no points (received '-1 frames of 4 points'"),
    "truncated": ("a.pc2", pc2()[:-1], QUAD, 25.0, "a truncated file, or one of another format (received '175 bytes'"),
    "too long": ("a.mdd", mdd() + b"\0", QUAD, None, "(received '165 bytes', expected 164 bytes)"),
    "not finite": ("a.mdd", mdd(vertices=spoiled()), QUAD, None, "vertices, frame 2, vertex 1: positions that are not"),
    "uneven": ("a.mdd", mdd(times=(0.0, 0.04, 0.1)), QUAD, None, "times: times that are not uniform"),
    "standing still": ("a.mdd", mdd(times=(0.0, 0.0, 0.0)), QUAD, None, "times: times that are not uniform"),
    "centimetres": ("a.mdd", mdd(vertices=100 * frames()), QUAD.replace("1", "100").replace("f 100", "f 1"), None,
                    "looks like centimetres"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_refused(tmp_path: Path, case: str) -> None:
    name, data, mesh, rate, message = REFUSED[case]
    assert f"{tmp_path.name}/a." in refuses(re.escape(message), load_sequence, write(tmp_path, name, data, mesh), rate)


@pytest.mark.parametrize("name", ["absent.pc2", "absent.mdd"])
def test_a_missing_file_is_refused(tmp_path: Path, name: str) -> None:
    refuses(rf"{name}: cannot be read", load_sequence, tmp_path / name, 25.0 if name.endswith("pc2") else None)


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(make=st.sampled_from([pc2, mdd]), place=st.integers(0, 40), value=st.binary(min_size=1, max_size=4))
def test_a_damaged_file_loads_or_is_refused(
    tmp_path: Path, make: Callable[[], bytes], place: int, value: bytes
) -> None:
    data = bytearray(make())
    data[place : place + len(value)] = value
    name = "a.pc2" if make is pc2 else "a.mdd"
    try:
        load_sequence(write(tmp_path, name, bytes(data)), 25.0 if make is pc2 else None)
    except InputError as error:
        assert "a." in str(error)
