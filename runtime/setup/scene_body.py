"""Loads the body of a scene and the motions that a scene names."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from assets.animation import clip_on
from assets.character import Animation, Character, Clip, with_clips
from assets.io.body_settings import MotionSettings
from assets.io.bvh import read_bvh
from assets.io.file_cache import kept_while_unchanged
from assets.io.retarget import load_joint_table, retargeted
from assets.io.scene import Scene
from assets.io.sequence import Sequence, SequenceMotion, load_sequence
from assets.loading import load_animation, load_character
from assets.motion import ClipMotion, Motion, part_of
from pbd import InputError

__all__ = ["body_of", "load_body", "motion_of"]


@kept_while_unchanged
def load_body(file: Path | str) -> Character:
    """A character, loaded once: calls with the same path return the same object until the file changes.

    Raises:
        InputError: as :func:`assets.loading.load_character`.
    """
    return load_character(file)


@kept_while_unchanged
def captured_clip(body: Character, file: Path, joints: Path | None) -> Clip:
    """A captured motion on a character, made once until a file changes.

    Args:
        body: the character.
        file: the .bvh file.
        joints: table of joints, see :func:`assets.io.retarget.load_joint_table`; None goes by names.

    Raises:
        InputError: as :func:`assets.io.bvh.read_bvh` and :func:`assets.io.retarget.retargeted`.
    """
    return retargeted(body, read_bvh(file), None if joints is None else load_joint_table(joints))


@kept_while_unchanged
def separate_animation(file: Path | str, joint_names: tuple[str, ...]) -> Animation | None:
    """The animation of a file without a skinned mesh, loaded once; None for every other file.

    Raises:
        InputError: as :func:`assets.loading.load_animation`.
    """
    return None if str(file).startswith("builtin:") else load_animation(file, joint_names)


def clip_of(body: Character, motion: MotionSettings) -> Clip:
    """The whole clip that a motion is a part of, on this body.

    Raises:
        InputError: no such clip (those that exist are listed), a file with another skeleton, or a captured motion whose
            joints are not found.
    """
    if motion.clip is None:
        return captured_clip(body, Path(motion.file), motion.joints)
    animation = separate_animation(motion.file, body.joint_names)
    if animation is not None:
        return clip_on(body, animation, motion.clip)
    other = load_body(motion.file)
    if motion.clip not in other.clips:
        known = "one of " + ", ".join(sorted(other.clips)) if other.clips else "a file with clips"
        raise InputError("no such clip", key="clip", received=motion.clip, expected=known)
    if other is body:
        return body.clip(motion.clip)
    # Without its own clips, which have the same names where it was loaded before its file changed.
    return with_clips(replace(body, clips={}), other).clip(motion.clip)


def motion_of(body: Character | Sequence, motion: MotionSettings) -> Motion:
    """A clip of any file on this body, with a lead-in from the bind pose; or a part of a vertex sequence of this body.

    Raises:
        InputError: as :func:`clip_of`, a sequence of another surface, or a part after the end.
    """
    if isinstance(body, Sequence) != motion.is_sequence:
        expected = (
            "a vertex sequence (.npz, .mdd, .pc2, USD)" if isinstance(body, Sequence) else "a clip or a .bvh file"
        )
        raise InputError("a motion of another kind of body", key="file", received=str(motion.file), expected=expected)
    try:
        if isinstance(body, Sequence):
            sequence = load_sequence(motion.file, motion.rate)
            if not np.array_equal(sequence.faces, body.faces):
                received, expected = f"{len(sequence.faces)} faces", "the faces of the scene's body"
                raise InputError("a sequence of another surface", key="faces", received=received, expected=expected)
            made: Motion = SequenceMotion(sequence, motion.start, motion.end, motion.speed)
        else:
            made = ClipMotion(body, part_of(clip_of(body, motion), motion.start, motion.end), speed=motion.speed)
    except InputError as error:
        if error.file is not None:
            raise
        raise InputError(
            error.problem, file=motion.file, key=error.key, received=error.received, expected=error.expected
        ) from error
    made.name = motion.name
    return made


def body_of(scene: Scene) -> Character | Sequence:
    """The body of a scene.

    Raises:
        InputError: the scene has none, or it cannot be loaded.
    """
    character = scene.character
    if character is None:
        raise InputError("no body", key="character", expected="a [character] with file or sequence")
    if character.file is not None:
        return load_body(character.file)
    return load_sequence(str(character.sequence), character.rate)
