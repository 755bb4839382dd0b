"""BVH motion capture: a skeleton's joints over time, as positions.

The format names neither units nor an up axis nor a pose to start from; the rotations of a file mean nothing without its
own zero pose. So the reader gives positions, in the file's own units and axes.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from assets.text import read_text
from pbd.errors import InputError

__all__ = ["Bvh", "read_bvh"]

Floats = NDArray[np.float64]

_MAX_NUMBERS = 2**28  # in a file: more is a damaged one
_SPARE_LINES = 5  # after the announced frames: some programs write a frame more than they announce, or a remark
_CHANNEL = re.compile(r"([XYZ])(position|rotation)", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class Bvh:
    """Joints over time.

    Attributes:
        file: the file that they come from.
        joint_names: one name per joint, all different.
        joint_parents: index of the parent, -1 at a root, parents first, shape (joints,), int32.
        positions: of the joints in the file's units, shape (frames, joints, 3), float64.
        zero_pose: the same without any rotation, by the joints' offsets alone, shape (joints, 3), float64.
        rate: frames a second [Hz].
    """

    file: Path
    joint_names: tuple[str, ...]
    joint_parents: NDArray[np.int32]
    positions: Floats
    zero_pose: Floats
    rate: float


@dataclass
class _Joint:
    name: str
    parent: int
    offset: Floats
    channels: list[tuple[str, str]] = field(default_factory=list)


def read_bvh(path: Path) -> Bvh:
    """Read a BVH file.

    A position channel replaces the joint's offset along its axis. Rotations are applied in the order of the channels,
    the first one outermost. The announced frames are read; a few lines after them are passed over.

    Raises:
        InputError: the file cannot be read, a line cannot be understood, two joints share a name, there are fewer
            frames than announced or many more, the numbers of a frame are not as many as the channels or not finite;
            the message names the line.
    """
    text = read_text(path, "a .bvh file", strict=False)
    lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), start=1) if line.strip()]
    if not lines or lines[0][1].upper() != "HIERARCHY":
        received = lines[0][1][:40] if lines else "an empty file"
        raise InputError("not a BVH file", file=path, key="line 1", received=received, expected="HIERARCHY")
    joints, end = _hierarchy(path, lines)
    values, rate = _motion(path, lines[end:], sum(len(joint.channels) for joint in joints))
    parents = np.array([joint.parent for joint in joints], np.int32)
    zero_pose = np.array([joint.offset for joint in joints])
    for joint, parent in enumerate(parents):
        zero_pose[joint] += zero_pose[parent] if parent >= 0 else 0.0
    return Bvh(path, tuple(joint.name for joint in joints), parents, _positions(joints, values), zero_pose, rate)


def _hierarchy(path: Path, lines: list[tuple[int, str]]) -> tuple[list[_Joint], int]:
    """The joints, and the index of the line after the hierarchy."""
    joints: list[_Joint] = []
    stack: list[int] = []  # joints whose braces are open; -1 for an end site
    opening: int | None = None  # what the next brace opens
    for index in range(1, len(lines)):
        number, line = lines[index]
        words = line.split()
        keyword = words[0].upper()
        try:
            if keyword == "MOTION" and not stack and joints:
                return joints, index + 1
            if keyword == "ROOT" and not stack or keyword == "JOINT" and stack and stack[-1] >= 0:
                name = " ".join(words[1:])
                if not name or any(joint.name == name for joint in joints):
                    raise ValueError("a joint without a name of its own")
                opening = len(joints)
                joints.append(_Joint(name, stack[-1] if stack else -1, np.zeros(3)))
            elif keyword == "END" and stack:
                opening = -1
            elif keyword == "{" and opening is not None:
                stack.append(opening)
                opening = None
            elif keyword == "}" and stack:
                stack.pop()
            elif keyword == "OFFSET" and stack and len(words) == 4:
                if stack[-1] >= 0:
                    joints[stack[-1]].offset = _finite(words[1:])
            elif keyword == "CHANNELS" and stack and stack[-1] >= 0:
                joints[stack[-1]].channels = _channels(words)
            else:
                raise ValueError("a line that does not belong here")
        except ValueError as error:
            raise InputError(str(error), file=path, key=f"line {number}", received=line[:60]) from error
    raise InputError("a file without its motion", file=path, key="MOTION", expected="a whole .bvh file")


def _finite(words: list[str]) -> Floats:
    numbers = np.array([float(word) for word in words])
    if not np.isfinite(numbers).all():
        raise ValueError("a number that is not finite")
    return numbers


def _channels(words: list[str]) -> list[tuple[str, str]]:
    """Axis and kind of each channel; a joint has each of them once at most."""
    found = [_CHANNEL.fullmatch(word) for word in words[2:]]
    channels = [(match[1].upper(), match[2].lower()) for match in found if match]
    if len(words) < 2 or words[1] != str(len(channels)) or len(set(channels)) != len(words) - 2:
        raise ValueError("channels that are not as many as announced, unknown or listed twice")
    return channels


def _motion(path: Path, lines: list[tuple[int, str]], width: int) -> tuple[Floats, float]:
    """Values of all channels, shape (frames, width), and the rate of the frames [Hz]."""
    heads = []
    for wanted, (number, line) in zip(("Frames:", "Frame Time:"), lines[:2], strict=False):
        try:
            if not line.lower().startswith(wanted.lower()):
                raise ValueError
            heads.append(float(line.partition(":")[2]))
            if not 0.0 < heads[-1] < np.inf:
                raise ValueError
        except ValueError as error:
            expected = f"'{wanted}' and a number above 0"
            raise InputError(
                "bad line", file=path, key=f"line {number}", received=line[:60], expected=expected
            ) from error
    if len(heads) < 2 or heads[0] != int(heads[0]) or heads[0] * width > _MAX_NUMBERS:
        expected = f"'Frames:' and 'Frame Time:', at most {_MAX_NUMBERS // max(width, 1)} frames"
        raise InputError("bad head of the motion", file=path, key="MOTION", received=heads, expected=expected)
    count, rows = int(heads[0]), lines[2:]
    if not count <= len(rows) <= count + _SPARE_LINES:
        raise InputError(
            "a truncated file, or one with more frames than it says",
            file=path,
            key="Frames",
            received=f"{len(rows)} lines of numbers",
            expected=f"{count}",
        )
    values = np.zeros((count, width))
    for frame, (number, line) in enumerate(rows[:count]):
        words = line.split()
        try:
            if len(words) != width:
                raise ValueError("a frame that has not a number for each channel")
            values[frame] = _finite(words)
        except ValueError as error:
            key, expected = f"line {number}", f"{width} finite numbers"
            raise InputError(str(error), file=path, key=key, received=line[:60], expected=expected) from error
    return values, 1.0 / heads[1]


def _positions(joints: list[_Joint], values: Floats) -> Floats:
    """Positions of all joints by forward kinematics, shape (frames, joints, 3)."""
    count = len(values)
    positions = np.zeros((count, len(joints), 3))
    turned: list[Rotation] = []
    place = 0
    for index, joint in enumerate(joints):
        local = np.tile(joint.offset, (count, 1))
        axes, angles = "", []
        for axis, kind in joint.channels:
            if kind == "position":
                local[:, "XYZ".index(axis)] = values[:, place]
            else:
                axes += axis
                angles.append(values[:, place])
            place += 1
        rotation = Rotation.identity(count)
        if axes:
            rotation = Rotation.from_euler(axes, np.stack(angles, axis=1), degrees=True)
        if joint.parent >= 0:
            local = positions[:, joint.parent] + turned[joint.parent].apply(local)
            rotation = turned[joint.parent] * rotation
        positions[:, index] = local
        turned.append(rotation)
    return positions
