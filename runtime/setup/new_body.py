"""Guesses about a character for a new scene file: its unit, its axes, and which of its clips are for what."""

from __future__ import annotations

from collections.abc import Sequence as Items
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from assets.character import Character, Clip
from assets.io.body_settings import MotionSettings
from assets.io.converted import write_character
from assets.io.gltf_character import bind_vertices
from assets.io.sequence import Sequence, load_sequence
from assets.loading import load_character
from assets.placement import AS_STORED, FilePlacement, body_placement
from assets.procedural.exploration import exploration_clip
from pbd import InputError

__all__ = ["BodyGuess", "MotionGuess", "guess_body", "guess_motions"]

STILL = 0.05  # a clip in which no joint comes this far is a pose [m]
BESIDE = 0.2  # from a joint to a point that shows its turning [m]
MIN_CLIP = 0.5  # [s]
CLIP_SECONDS = 30.0  # of clips that are learned from, together [s]
MAX_CLIPS = 8  # that are learned from; each begins with a second of lead-in
PART_SECONDS = 15.0  # of one clip that are learned from, at most [s]
PROCEDURAL_SECONDS = 40.0  # that are learned from as well [s]
HELD_OUT_SHARE = 0.3  # of the only clip [-]
MIN_CUT = 3.0  # a shorter clip is not cut in two [s]
MIN_HELD_OUT = 1.1  # of a clip that `gube compare` can judge by: most of its frames after the cloth has settled [s]


@dataclass(frozen=True)
class BodyGuess:
    """A body, loaded, with the file that a scene names for it.

    Attributes:
        body: the character or the vertex sequence.
        file: what the scene names: the file itself, one that was written beside the scene, or a built-in body.
        placement: unit and axes of the file that was given.
    """

    body: Character | Sequence
    file: Path | str
    placement: FilePlacement

    @property
    def vertices(self) -> np.ndarray:
        """In the pose that clothes are made for [m], shape (n, 3)."""
        return self.body.vertices if isinstance(self.body, Character) else self.body.vertices[0].astype(float)


@dataclass(frozen=True)
class MotionGuess:
    """The motions of a scene.

    Attributes:
        clips: to learn from.
        held_out: that is played and judged, and from which nothing is learned.
        procedural_seconds: of motion made for the body to learn from as well [s].
        left_out: names of clips that are neither, and why.
    """

    clips: tuple[MotionSettings, ...]
    held_out: MotionSettings
    procedural_seconds: float
    left_out: tuple[tuple[str, str], ...]


def guess_body(path: str, folder: Path) -> BodyGuess:
    """Load a body; one of another unit or other axes is written once more, beside the scene.

    Args:
        path: a character (.glb, .gltf), "builtin:mannequin", or a vertex sequence (.npz).
        folder: of the scene.

    Raises:
        InputError: as the loaders; a size that no unit makes a body's; or faces that point inwards.
    """
    if path.startswith("builtin:"):
        return BodyGuess(load_character(path), path, AS_STORED)
    file = Path(path).absolute()
    if file.suffix.lower() == ".npz":
        return _right_side_out(BodyGuess(load_sequence(file), file, AS_STORED))
    if file.suffix.lower() not in (".glb", ".gltf"):
        expected = "a character with skin and clips (.glb, .gltf), a vertex sequence (.npz), or builtin:mannequin"
        raise InputError("no animated character", file=path, received=file.suffix, expected=expected)
    placement = body_placement(vertices := bind_vertices(file))
    if placement is None:
        size = ", ".join(f"{length:.4g}" for length in np.ptp(vertices, axis=0))
        expected = "a body of 0.7 to 2.6 m in metres, centimetres, inches, decimetres or millimetres"
        raise InputError("not the size of a body", file=path, key="bounding box", received=size, expected=expected)
    if placement == AS_STORED:
        return _right_side_out(BodyGuess(load_character(file), file, placement))
    target = folder / f"{file.stem}_metres.glb"
    write_character(file, target, placement.matrix)
    return _right_side_out(BodyGuess(load_character(target), target, placement))


def _right_side_out(guess: BodyGuess) -> BodyGuess:
    """The guess, refused if the body's faces point inwards, also those of an open body, which the loaders let pass."""
    corners = guess.vertices[guess.body.faces] - guess.vertices.mean(axis=0)
    if np.einsum("mi,mi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) < 0.0:
        raise InputError("a body that is inside out", file=guess.file, key="faces", expected="normals that point out")
    return guess


def guess_motions(guess: BodyGuess) -> MotionGuess:
    """Which clips of a body are learned from, and which one is held out.

    Raises:
        InputError: the character has no clip that moves.
    """
    body, file = guess.body, guess.file
    if isinstance(body, Sequence):
        length = (len(body.vertices) - 1) * body.dt
        whole = MotionSettings(file=file)
        parts = _cut(whole, length)
        slow, fast = replace(parts[0], speed=0.7), replace(parts[0], speed=1.4)
        return MotionGuess((parts[0], slow, fast), parts[1], 0.0, ())
    moving, left_out = [], []
    for clip in body.clips.values():
        if clip.duration < MIN_CLIP or _reach(body, clip) < STILL:
            left_out.append((clip.name, "a pose" if clip.duration >= MIN_CLIP else f"shorter than {MIN_CLIP:g} s"))
        else:
            moving.append(clip)
    if not moving:
        received = [clip.name for clip in body.clips.values()] or "none"
        expected = f"at least one clip of {MIN_CLIP:g} s or more"
        raise InputError("no clip that moves", file=file, key="animations", received=received, expected=expected)
    seconds = PROCEDURAL_SECONDS if _is_figure(body) else 0.0
    shown = _shown(moving)
    settings = {clip.name: MotionSettings(file=file, clip=clip.name) for clip in moving}
    others = sorted((clip for clip in moving if clip is not shown), key=lambda clip: -_speed(body, clip))
    taken: list[MotionSettings] = []
    for clip in others:
        if len(taken) >= MAX_CLIPS or sum(_seconds(one, body) for one in taken) >= CLIP_SECONDS:
            left_out.append((clip.name, "enough others to learn from"))
        else:
            part = settings[clip.name]
            taken.append(replace(part, end=PART_SECONDS) if clip.duration > PART_SECONDS else part)
    held_out = settings[shown.name]
    if not taken and (shown.duration >= MIN_CUT or not seconds):
        first, held_out = _cut(held_out, shown.duration)
        taken.append(first)
    return MotionGuess(tuple(taken), held_out, seconds, tuple(left_out))


def _shown(clips: Items[Clip]) -> Clip:
    """The clip to hold out, of those that last long enough: a walk, the shortest of at least 3 s, or the longest."""
    clips = [clip for clip in clips if clip.duration >= MIN_HELD_OUT] or clips
    walks = [clip for clip in clips if "walk" in clip.name.lower()]
    if walks:
        return max(walks, key=lambda clip: clip.duration)
    long = [clip for clip in clips if clip.duration >= MIN_CUT]
    return min(long, key=lambda clip: clip.duration) if long else max(clips, key=lambda clip: clip.duration)


def _cut(motion: MotionSettings, length: float) -> tuple[MotionSettings, MotionSettings]:
    """The beginning of a motion, to learn from, and its end, to hold out."""
    share = HELD_OUT_SHARE if length < MIN_CUT else max(HELD_OUT_SHARE, MIN_HELD_OUT / length)
    place = round((1.0 - share) * length, 2)
    return replace(motion, end=place), replace(motion, start=place)


def _seconds(motion: MotionSettings, body: Character) -> float:
    assert motion.clip is not None
    return body.clip(motion.clip).duration if motion.end is None else motion.end - motion.start


def _places(body: Character, clip: Clip) -> np.ndarray:
    """Joints, and a point beside each that turns with it, at about ten moments a second: world [m], shape (f, j, 3)."""
    frames = range(0, clip.frame_count, max(1, round(clip.rate / 10.0)))
    local = (clip.translation, clip.rotation, clip.scale)
    joints = np.array([body.joint_transforms(*(part[frame] for part in local))[:, :3] for frame in frames])
    directions = joints[..., 0] + joints[..., 1]
    lengths = np.maximum(np.linalg.norm(directions, axis=2, keepdims=True), 1e-9)
    return np.concatenate([joints[..., 3], joints[..., 3] + BESIDE * directions / lengths], axis=1)


def _reach(body: Character, clip: Clip) -> float:
    """The longest way of any point along an axis [m]."""
    return float(np.ptp(_places(body, clip), axis=0).max())


def _speed(body: Character, clip: Clip) -> float:
    """Mean speed of all points [m/s]."""
    steps = np.linalg.norm(np.diff(_places(body, clip), axis=0), axis=2)
    return float(steps.mean(axis=1).sum() / clip.duration) if len(steps) else 0.0


def _is_figure(body: Character) -> bool:
    """Whether procedural motion can be made for a body."""
    try:
        exploration_clip(body, 0, 2.0)
    except InputError:
        return False
    return True
