"""Vertex sequences: loaded, refused, played."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from assets.io.sequence import SequenceBody, SequenceMotion, load_sequence
from pbd.engine import ti
from tests.data import data_path
from tests.refusals import refuses

FACES = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)


def frames(count: int = 3) -> np.ndarray:
    """A square that rises by 0.1 m a frame, far from the origin."""
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float32)
    return (
        square + np.float32([100, 0, 0]) + np.arange(count, dtype=np.float32)[:, None, None] * np.float32([0, 0.1, 0])
    )


def write(folder: Path, **changes: Any) -> Path:
    entries = {"vertices": frames(), "faces": FACES, "dt": np.float32(0.5)} | changes
    path = folder / "body.npz"
    np.savez(path, **{key: value for key, value in entries.items() if value is not None})
    return path


def test_it_plays_at_its_own_speed(tmp_path: Path) -> None:
    sequence = load_sequence(write(tmp_path))
    motion, body = SequenceMotion(sequence), SequenceBody(sequence)
    assert (motion.name, motion.duration, body.vertices.dtype) == ("body", 1.0, np.float64)
    for t, height in ((-1.0, 0.0), (0.0, 0.0), (0.25, 0.05), (0.5, 0.1), (1.0, 0.2), (9.0, 0.2)):
        pose = motion.pose(t)
        assert pose.dtype == np.float64
        np.testing.assert_allclose(pose - frames()[0], np.tile([0, height, 0], (4, 1)), atol=1e-7)


def test_the_body_is_written_in_its_frame(tmp_path: Path) -> None:
    body = SequenceBody(load_sequence(write(tmp_path)))
    origin = np.array([100.3, 0.7, -0.1])
    pose = frames()[0].astype(np.float64) + 1e-5  # lost if the origin came off after rounding: 100 m has 8e-6 m steps
    out, array = np.zeros((4, 3), dtype=np.float32), ti.ndarray(dtype=ti.math.vec3, shape=4)
    body.skin(pose, origin, out)
    body.skin(pose, origin, array)
    np.testing.assert_allclose(out, pose - origin, atol=1e-7)
    assert np.array_equal(array.to_numpy(), out)


def test_a_part_is_led_into_from_the_beginning(tmp_path: Path) -> None:
    """Clothes are made for the first frame: a later part is played from there, and says how long that takes."""
    sequence = load_sequence(write(tmp_path))
    length = (len(frames()) - 1) * sequence.dt
    whole = SequenceMotion(sequence)
    part = SequenceMotion(sequence, start=length / 2, end=0.9 * length, speed=0.5)
    assert whole.lead_in == 0.0
    assert (part.lead_in, part.duration) == pytest.approx((length, 1.8 * length))
    for t in (0.0, 0.3 * length, length):
        np.testing.assert_allclose(part.pose(2.0 * t), whole.pose(min(t, 0.9 * length)), atol=1e-12)
    refuses("start: a part after the end", SequenceMotion, sequence, start=length)


def test_one_frame_is_held(tmp_path: Path) -> None:
    motion = SequenceMotion(load_sequence(write(tmp_path, vertices=frames(1))))
    assert motion.duration == 0.0
    assert np.array_equal(motion.pose(3.0), frames(1)[0])


def spoiled(value: float) -> np.ndarray:
    vertices = frames()
    vertices[1, 2, 0] = value
    return vertices


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"faces": None}, "faces: a missing key (received ['dt', 'vertices'], expected vertices, faces and dt)"),
        ({"dt": None}, "dt: a missing key"),
        ({"vertices": frames()[0]}, "vertices: bad array (received 'float32 (4, 3)', expected floats, (frames, n, 3))"),
        ({"vertices": frames()[:0]}, "vertices: bad array"),
        ({"vertices": spoiled(np.nan)}, "vertices, frame 1, vertex 2: positions that are not finite"),
        ({"vertices": np.array([None, {}], dtype=object)}, "no arrays of numbers: Object arrays cannot be loaded"),
        ({"vertices": frames() * np.float32(85) - np.float32([8500, 0, 0])}, "looks like centimetres"),
        ({"faces": FACES.astype(float)}, "faces: bad array"),
        ({"faces": FACES + 1}, "face 1: a face with a vertex that does not exist (received [1, 3, 4]"),
        ({"faces": FACES - 1}, "face 0: a face with a vertex that does not exist"),
        ({"dt": 0.0}, "dt: bad array (received 0.0, expected one number above 0)"),
        ({"dt": np.array([0.1, 0.2])}, "dt: bad array"),
        ({"dt": "fast"}, "dt: bad array"),
    ],
)
def test_refused(changes: dict[str, Any], message: str, tmp_path: Path) -> None:
    assert "body.npz" in refuses(re.escape(message), load_sequence, write(tmp_path, **changes))


@pytest.mark.parametrize("share", [0.0, 0.2, 0.9])
def test_a_truncated_file_is_refused(share: float, tmp_path: Path) -> None:
    path = write(tmp_path)
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    refuses(r"body\.npz", load_sequence, path)


def test_other_files_are_refused(tmp_path: Path) -> None:
    refuses(r"absent\.npz: cannot be read", load_sequence, tmp_path / "absent.npz")
    np.save(tmp_path / "one.npy", frames())
    refuses(r"one\.npy: a single array", load_sequence, tmp_path / "one.npy")


def test_the_dancer() -> None:
    sequence = load_sequence(data_path("sequences/cipc_body_rumba_dancing.npz"))
    assert (sequence.vertices.shape, sequence.faces.shape) == ((121, 12811, 3), (25472, 3))
    motion = SequenceMotion(sequence)
    assert motion.duration == pytest.approx(4.8)
    step = np.linalg.norm(motion.pose(2.04) - motion.pose(2.0), axis=1)
    assert 0.001 < step.max() < 2.1 * 0.04
