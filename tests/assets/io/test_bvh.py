"""Captured motion: positions out of BVH files, and what is refused with the line named."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from assets.io.bvh import read_bvh
from pbd.errors import InputError
from tests.data import data_path
from tests.refusals import refuses

ARM = """HIERARCHY
ROOT Hips
{
  OFFSET 0 1 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Left Arm
  {
    OFFSET 2 0 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    JOINT Hand
    {
      OFFSET 1 0 0
      End Site
      {
        OFFSET 0.5 0 0
      }
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.05
0 1 0 0 0 0 0 0 0
5 6 7 90 0 0 0 0 90
"""


def write(folder: Path, text: str) -> Path:
    (folder / "arm.bvh").write_text(text)
    return folder / "arm.bvh"


def test_joints_go_where_offsets_and_rotations_put_them(tmp_path: Path) -> None:
    motion = read_bvh(write(tmp_path, ARM))
    assert motion.joint_names == ("Hips", "Left Arm", "Hand")
    assert motion.joint_parents.tolist() == [-1, 0, 1]
    assert motion.rate == pytest.approx(20.0)
    np.testing.assert_allclose(motion.positions[0], [[0, 1, 0], [2, 1, 0], [3, 1, 0]], atol=1e-12)
    np.testing.assert_array_equal(motion.zero_pose, [[0, 1, 0], [2, 1, 0], [3, 1, 0]])
    # Turned by 90 degrees about z, x points up; the arm's own turn about y makes its x point along -z.
    np.testing.assert_allclose(motion.positions[1], [[5, 6, 7], [5, 8, 7], [5, 8, 6]], atol=1e-12)


def test_the_first_channel_is_the_outermost(tmp_path: Path) -> None:
    motion = read_bvh(write(tmp_path, ARM.replace("5 6 7 90 0 0 0 0 90", "0 0 0 90 90 0 0 0 0")))
    # Rz Rx: x is turned about z alone, z is turned about x first, to -y, and then about z to x.
    np.testing.assert_allclose(motion.positions[1, 1], [0, 2, 0], atol=1e-12)
    text = ARM.replace("OFFSET 2 0 0", "OFFSET 0 0 2").replace("5 6 7 90 0 0 0 0 90", "0 0 0 90 90 0 0 0 0")
    np.testing.assert_allclose(read_bvh(write(tmp_path, text)).positions[1, 1], [2, 0, 0], atol=1e-12)


@pytest.mark.parametrize(
    "text",
    [
        ARM.replace("Xposition", "XPOSITION").replace("Frame Time", "frame time").replace("\n", "\r\n"),
        *(ARM + rest for rest in ("9 9 9 0 0 0 0 0 0\n", "9 9 9 0 0 0 0 0 0\n9 9\n", "# exported\n" * 5)),
    ],
)
def test_line_ends_case_and_lines_after_the_announced_frames_do_not_matter(tmp_path: Path, text: str) -> None:
    plain, found = (read_bvh(write(tmp_path, one)) for one in (ARM, text))
    np.testing.assert_array_equal(found.positions, plain.positions)


REFUSED = {
    "empty": ("HIERARCHY", None, "line 1: not a BVH file (received 'an empty file'"),
    "another file": ("HIERARCHY", "FBX", "line 1: not a BVH file (received 'FBX'"),
    "no motion": ("MOTION", "", "line 21: a line that does not belong here (received 'Frames: 2'"),
    "an open brace": ("}\nMOTION", "MOTION", "line 19: a line that does not belong here (received 'MOTION'"),
    "twice": ("JOINT Hand", "JOINT Hips", "line 10: a joint without a name of its own"),
    "nameless": ("JOINT Hand", "JOINT", "line 10: a joint without a name of its own"),
    "second root": ("MOTION", "JOINT Other\nMOTION", "line 20: a line that does not belong here"),
    "short offset": ("OFFSET 2 0 0", "OFFSET 2 0", "line 8: a line that does not belong here (received 'OFFSET 2 0'"),
    "bad offset": ("OFFSET 2 0 0", "OFFSET 2 x 0", "line 8: could not convert string to float: 'x'"),
    "endless offset": ("OFFSET 2 0 0", "OFFSET 2 inf 0", "line 8: a number that is not finite"),
    "channels": ("CHANNELS 3", "CHANNELS 4", "line 9: channels that are not as many as announced"),
    "many channels": ("CHANNELS 3", "CHANNELS 999999999999", "line 9: channels that are not as many as announced"),
    "a channel twice": ("CHANNELS 3 Zrotation", "CHANNELS 3 Yrotation", "line 9: channels"),
    "unknown channel": ("CHANNELS 3 Zrotation", "CHANNELS 3 Wrotation", "line 9: channels"),
    "no frames": ("Frames: 2", "Frames: 0", "line 21: bad line (received 'Frames: 0'"),
    "half a frame": ("Frames: 2", "Frames: 1.5", "MOTION: bad head of the motion (received [1.5, 0.05]"),
    "gigantic": ("Frames: 2", "Frames: 99999999999999", "MOTION: bad head of the motion"),
    "no time": ("Frame Time: 0.05", "Frame Time: nan", "line 22: bad line"),
    "truncated": ("5 6 7 90 0 0 0 0 90\n", "", "Frames: a truncated file, or one with more frames than it says"),
    "many more frames": (
        "5 6 7 90", "0 1 0 0 0 0 0 0 0\n" * 6 + "5 6 7 90",
        "Frames: a truncated file, or one with more frames than it says (received '8 lines of numbers', expected 2)",
    ),
    "a short line": ("5 6 7 90", "5 6 7", "line 24: a frame that has not a number for each channel (received '5 6 7 0"),
    "a word": ("5 6 7 90", "5 6 7 x", "line 24: could not convert string to float: 'x'"),
    "not a number": ("5 6 7 90", "5 6 7 nan", "line 24: a number that is not finite"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_refused(tmp_path: Path, case: str) -> None:
    old, new, message = REFUSED[case]
    assert ARM.count(old) >= 1
    text = "" if new is None else ARM.replace(old, new, 1)
    assert "arm.bvh" in refuses(re.escape(message), read_bvh, write(tmp_path, text))


def test_other_files_are_refused(tmp_path: Path) -> None:
    refuses(r"absent\.bvh: cannot be read", read_bvh, tmp_path / "absent.bvh")
    (tmp_path / "arm.bvh").write_bytes(bytes(range(256)) * 50)
    refuses(r"arm\.bvh: line 1: not a BVH file", read_bvh, tmp_path / "arm.bvh")


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(place=st.floats(0, 1, exclude_max=True), value=st.text("x{}9-\n ", max_size=6))
def test_a_damaged_file_loads_or_is_refused(tmp_path: Path, place: float, value: str) -> None:
    start = int(place * len(ARM))
    try:
        motion = read_bvh(write(tmp_path, ARM[:start] + value + ARM[start + len(value) :]))
    except InputError as error:
        assert "arm.bvh" in str(error)
    else:
        assert np.isfinite(motion.positions).all()


@pytest.mark.parametrize(
    ("name", "frame_count", "joint_count", "rate"),
    [
        ("bandai_walk_normal_001_NC", 195, 22, 30.0),
        ("cmu_01_01_jumps_turn", 2752, 31, 120.0),
        ("cmu_jumping_jacks", 125, 31, 30.0),
        ("rokoko_dance", 1007, 60, 100.0),
    ],
)
def test_captures(name: str, frame_count: int, joint_count: int, rate: float) -> None:
    motion = read_bvh(data_path(f"mocap/{name}.bvh"))
    assert motion.positions.shape == (frame_count, joint_count, 3)
    assert motion.rate == pytest.approx(rate, rel=1e-3)
