"""With what a wrinkle database is played: its body, motions, wind and colliders."""

from __future__ import annotations

from collections.abc import Sequence as Items
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from assets.character import Character
from assets.io.body_settings import MotionSettings
from assets.io.scene import Scene
from assets.io.sequence import Sequence, SequenceMotion, is_sequence, load_sequence
from assets.motion import ClipMotion, Motion
from pbd import InputError
from pbd.wind import CALM, Wind
from runtime.setup.garment_mesh import pattern_of
from runtime.setup.garment_setup import colliders_of, scene_of
from runtime.setup.scene_body import body_of, load_body, motion_of
from wrinkles.database import WrinkleDatabase
from wrinkles.database_file import read_database

__all__ = ["PlaybackInputs", "motions_of", "open_database", "playback_inputs"]


@dataclass(frozen=True)
class PlaybackInputs:
    """The inputs with which a database is played.

    Attributes:
        body: the character or vertex sequence.
        motions: motions of the body, played one after the other.
        wind: see :mod:`pbd.wind`.
        primitives: colliders besides the body.
        pattern: place of each corner of each coarse face in the flat pattern, for pictures [m], shape (m, 3, 2); None
            where it is unknown.
        wrinkles: play what was learned even where plain cloth is the better choice.
    """

    body: Character | Sequence
    motions: tuple[Motion, ...]
    wind: Wind = Wind(CALM)
    primitives: tuple = ()
    pattern: np.ndarray | None = None
    wrinkles: bool = False


def playback_inputs(
    database: WrinkleDatabase, character: Path | None = None, *, clip: str | None = None
) -> PlaybackInputs:
    """The body and the motions with which a database is played.

    Args:
        database: the database; without ``character`` the scene stored in it names body and motions.
        character: a file with another source of the body and its clips: a character, or a vertex sequence.
        clip: name of a clip; None takes the held-out clips, or the first one if none is held out.

    Raises:
        InputError: the body is not the database's, the clip does not exist, or a file cannot be loaded.
    """
    if character is None:
        scene = scene_of(database)
        body = body_of(scene)
        database.require_body(body)
        motions = motions_of(body, clip, database.held_out, scene)
        return PlaybackInputs(body, motions, scene.wind.air(), colliders_of(scene), pattern_of(scene))
    body = load_sequence(character) if is_sequence(character) else load_body(character)
    database.require_body(body)
    return PlaybackInputs(body, motions_of(body, clip, database.held_out, None))


def open_database(
    path: Path,
    *,
    character: Path | None = None,
    clip: str | None = None,
    fabric: str | None = None,
    wrinkles: bool = False,
) -> tuple[WrinkleDatabase, PlaybackInputs]:
    """Read a database and the inputs with which it is played.

    Args:
        path: the database.
        character, clip: see :func:`playback_inputs`.
        fabric: name of a fabric of the database; None takes the garment's own.
        wrinkles: see :class:`PlaybackInputs`.

    Raises:
        InputError: the file is no database, it has no such fabric, or as :func:`playback_inputs`.
    """
    database = read_database(path)
    if fabric is not None:
        database = database.in_fabric(fabric)
    return database, replace(playback_inputs(database, character, clip=clip), wrinkles=wrinkles)


def motions_of(
    body: Character | Sequence, clip: str | None, held_out: Items[str], scene: Scene | None
) -> tuple[Motion, ...]:
    """The motions that are played: those held out, or one of another name.

    Args:
        body: that moves.
        clip: name of a clip; None takes the held-out clips, or the first one if none is held out.
        held_out: names of the clips that nothing is learned from.
        scene: that names clips of other files; None knows those of the body alone.

    Raises:
        InputError: the clip does not exist, or a file cannot be loaded.
    """
    character = scene.character if scene is not None else None
    own = (character.motion,) if character is not None and character.motion is not None else ()
    if isinstance(body, Sequence):
        if clip is not None:
            raise InputError("a vertex sequence has no clips", key="--clip", received=clip, expected="none")
        parts = scene.training.held_out or own if scene is not None else ()
        return tuple(motion_of(body, part) for part in parts) or (SequenceMotion(body),)
    known: dict[str, MotionSettings | None] = {}
    if scene is not None:
        known |= {motion.name: motion for motion in (*own, *scene.training.held_out, *scene.training.clips)}
    known |= {name: None for name in body.clips if name not in known}  # the body's own file
    if clip is not None:
        names = [clip]
    else:
        first = character.clip if character is not None else None
        names = [name for name in held_out if name in known] or [first or next(iter(known), "")]
    for name in names:
        if name not in known:
            expected = "one of " + ", ".join(sorted(known)) if known else "a character with clips"
            raise InputError("no such clip", key="--clip", received=name, expected=expected)
    return tuple(
        ClipMotion(body, body.clip(name)) if (settings := known[name]) is None else motion_of(body, settings)
        for name in names
    )
