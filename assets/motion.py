"""Motions: poses of a body over time, starting from the pose that its clothes were made in."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from assets.character import Character, Clip
from assets.transform import decompose, slerp
from pbd.arrays import floats
from pbd.errors import InputError

__all__ = ["ClipMotion", "Motion", "part_of", "uppermost_joints"]

Floats = NDArray[np.float64]

# Distance of a joint between the end and the start of a clip that may be played in a loop [m].
_MAX_LOOP_GAP = 0.05


class Motion(Protocol):
    """Poses over time.

    Attributes:
        name: name for messages and figures.
        duration: time from start to end [s].
        lead_in: time at the start that only leads to the motion that is meant: nothing is learned from it or judged
            in it [s].
    """

    name: str
    lead_in: float

    @property
    def duration(self) -> float:
        """Time from start to end [s]."""
        ...

    def pose(self, t: float) -> Floats:
        """The pose at a time [s], clamped to the ends; the body's ``skin`` takes it."""
        ...


class ClipMotion:
    """A clip of a character, led into from the bind pose.

    During the blend the body stands where the clip starts: the bind pose is moved level over the ground and turned
    about the vertical until its hips stand and head as in the clip's first frame, so that it neither travels nor spins.
    From there every joint turns (slerp) and moves (lerp) to its place in the first frame, eased in and out by
    ``3 s^2 - 2 s^3``. Then the clip plays, with slerp between its frames.

    Args:
        character: the character that moves.
        clip: one of its clips, or the name of one.
        blend: time from the bind pose to the clip's first frame [s]; 0 starts in the clip.
        speed: clip seconds per second [-].
        loop: whether the clip starts again at its end; it must then end as it starts.

    Attributes:
        name: the clip's name.
        duration: blend and one pass of the clip [s].
        lead_in: 0; the blend can be learned from.
        blend: as given [s].

    Raises:
        InputError: no clip of that name, a negative blend, a speed that is not positive, or ``loop`` for a clip that
            does not close.
    """

    def __init__(
        self, character: Character, clip: Clip | str, blend: float = 1.0, speed: float = 1.0, loop: bool = False
    ) -> None:
        if isinstance(clip, str):
            clip = character.clip(clip)
        key = f"clip {clip.name}"
        if not 0.0 <= blend < np.inf:
            raise InputError("bad blend", key=key, received=blend, expected="0 or more seconds")
        if not 0.0 < speed < np.inf:
            raise InputError("bad speed", key=key, received=speed, expected="more than 0")
        self.name = clip.name
        self.duration = blend + clip.duration / speed
        self.lead_in = 0.0
        self._character, self._rate = character, clip.rate
        self.blend, self._speed, self._loop = blend, speed, loop
        # One array for all three, so that a frame is one row: columns 0-2, 3-6 and 7-9.
        self._frames = np.concatenate([clip.translation, clip.rotation, clip.scale], axis=2)
        if loop:
            self._check_loop(key)
        self._lead_in()

    def pose(self, t: float) -> Floats:
        """Skinning matrices at a time [s], shape (joints, 3, 4); held before 0 and, without ``loop``, after the end."""
        floats(t, "t", (), unit=" [s]")
        if t < self.blend:
            s = max(t, 0.0) / self.blend
            return _between(self._loose, self._start, self._end, s * s * (3.0 - 2.0 * s))
        last = len(self._frames) - 1
        place = (t - self.blend) * self._speed * self._rate
        place = place % last if self._loop and last else min(place, last)
        frame = min(int(place), max(last - 1, 0))
        return _between(self._character, self._frames[frame], self._frames[min(frame + 1, last)], place - frame)

    def _check_loop(self, key: str) -> None:
        first, last = (self._joint_transforms(frame)[:, :3, 3] for frame in self._frames[[0, -1]])
        jump = np.linalg.norm(last - first, axis=1)
        if jump.max() > _MAX_LOOP_GAP:
            joint = self._character.joint_names[int(jump.argmax())]
            raise InputError(
                "a clip that does not end as it starts cannot be played in a loop",
                key=f"{key}, joint {joint}",
                received=f"{jump.max():.3g} m apart",
                expected=f"at most {_MAX_LOOP_GAP} m",
            )

    def _joint_transforms(self, frame: Floats) -> Floats:
        return self._character.joint_transforms(frame[:, :3], frame[:, 3:7], frame[:, 7:])

    def _lead_in(self) -> None:
        """Prepare the blend: the skeleton with its hips cut loose, and its local transforms at start and end.

        Cut loose from the joints above them, the hips move straight from one place to the other, however a root on
        the floor moves.
        """
        character, first = self._character, self._frames[0]
        bind, target = character.joint_transforms(*character.rest_local), self._joint_transforms(first)
        tops = uppermost_joints(character)
        parents = character.joint_parents.copy()
        parents[tops] = -1
        roots = parents < 0
        to_root = np.linalg.inv(character.root_transform)
        place = _level_placement(bind[tops[0]], target[tops[0]])

        def loose(frame: Floats, world: Floats) -> Floats:
            """Local transforms of a frame in which the new roots stand in the world as the old joints did."""
            frame = frame.copy()
            frame[roots] = np.concatenate(decompose(to_root @ world[roots], f"clip {self.name}, frame 0"), axis=1)
            return frame

        stored = np.concatenate(character.rest_local, axis=1)
        rest = loose(stored, bind)
        self._start, self._end = loose(stored, place @ bind), loose(first, target)
        rest_local = (rest[:, :3], rest[:, 3:7], rest[:, 7:])
        self._loose = replace(character, joint_parents=parents, rest_local=rest_local, clips={})


def part_of(clip: Clip, start: float, end: float | None) -> Clip:
    """The frames of a clip from ``start`` to ``end`` [s]; None ends where it ends.

    Raises:
        InputError: fewer than two frames are left.
    """
    first = int(np.ceil(start * clip.rate - 1e-6))
    frames = slice(first, None if end is None else int(end * clip.rate + 1e-6) + 1)
    if (start or end is not None) and len(clip.translation[frames]) < 2:
        received, expected = [start, end], f"two frames between 0 and {clip.duration:g} [s]"
        raise InputError("no such part", key=f"clip {clip.name}", received=received, expected=expected)
    parts = {name: getattr(clip, name)[frames] for name in ("translation", "rotation", "scale")}
    return replace(clip, **parts)


def _between(character: Character, start: Floats, end: Floats, share: float) -> Floats:
    """Pose between two frames of local transforms, shape (joints, 10)."""
    mixed = (1.0 - share) * start + share * end
    return character.pose_from_local(mixed[:, :3], slerp(start[:, 3:7], end[:, 3:7], share), mixed[:, 7:])


def uppermost_joints(character: Character) -> NDArray[np.intp]:
    """The uppermost joints that carry skin, the one with the most first.

    A joint carries skin from a thousandth of it: the roots of some skeletons stand on the floor with a few stray
    vertices.
    """
    carried = np.zeros(character.joint_count)
    np.add.at(carried, character.joint_indices.ravel(), character.joint_weights.ravel().astype(np.float64))
    carries = carried >= min(0.001 * carried.sum(), carried.max())
    below = np.zeros(character.joint_count, dtype=bool)  # lies below a joint that carries skin
    for joint, parent in enumerate(character.joint_parents):
        below[joint] = parent >= 0 and (below[parent] or carries[parent])
    tops = np.flatnonzero(~below & carries)
    return tops[np.argsort(-carried[tops], kind="stable")]


def _level_placement(bind: Floats, target: Floats) -> Floats:
    """A turn about the vertical and a level shift, shape (4, 4), that bring the bind pose's hips to the target's.

    The turn is the twist about Y of the rotation from one to the other (swing-twist decomposition).
    """
    _, rotation, _ = decompose(target @ np.linalg.inv(bind))
    y, w = rotation[1], rotation[3]
    length = np.hypot(y, w)
    sine, cosine = (2.0 * y * w / length**2, (w * w - y * y) / length**2) if length > 1e-6 else (0.0, 1.0)
    place = np.eye(4)
    place[0, 0] = place[2, 2] = cosine
    place[0, 2], place[2, 0] = sine, -sine
    shift = target[:3, 3] - place[:3, :3] @ bind[:3, 3]
    place[[0, 2], 3] = shift[[0, 2]]
    return place
