"""Tables of a scene file about the body and its motions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from assets.character import CHARACTER_SUFFIXES, SEQUENCE_SUFFIXES, USD_SUFFIXES
from assets.io.settings import entry, file_path, number, table, text
from pbd import InputError

__all__ = ["CHARACTER_FILE", "CharacterSettings", "MotionSettings"]

CHARACTER_FILE = file_path(*CHARACTER_SUFFIXES, builtins=["builtin:mannequin"])
_SEQUENCE_FILE = file_path(*SEQUENCE_SUFFIXES)
_MOTION_FILE = file_path(
    *dict.fromkeys([*CHARACTER_SUFFIXES, ".bvh", *SEQUENCE_SUFFIXES]), builtins=["builtin:mannequin"]
)


@dataclass(frozen=True, kw_only=True)
class MotionSettings:
    """One clip of a character's file, a captured motion, or a vertex sequence, or a part of it.

    Attributes:
        file: path of a glTF or USD file, of a captured motion (.bvh) or of a vertex sequence, or "builtin:mannequin".
        clip: name of the clip; None for a captured motion or a vertex sequence.
        start, end: part of it that is meant [s]; None ends where it ends.
        speed: its seconds per second [-].
        joints: path of a .csv file of the joints that a captured motion moves, see
            :func:`assets.io.retarget.load_joint_table`; None goes by their names.
        rate: frames a second of a .pc2 file, which does not know them [Hz].
        label: what it is called; None takes the clip's name. Many files call their only clip the same.
    """

    file: Path | str = entry(_MOTION_FILE)
    clip: str | None = entry(text(), None)
    start: float = entry(number(at_least=0, unit="s"), 0.0)
    end: float | None = entry(number(above=0, unit="s"), None)
    speed: float = entry(number(above=0), 1.0)
    joints: Path | None = entry(file_path(".csv"), None)
    rate: float | None = entry(number(above=0, unit="Hz"), None)
    label: str | None = entry(text(), None)

    def __post_init__(self) -> None:
        suffix = _suffix(self.file)
        clipless = {".bvh": "a captured motion", **dict.fromkeys(SEQUENCE_SUFFIXES, "a vertex sequence")}
        if suffix not in USD_SUFFIXES and (suffix in clipless) != (self.clip is None):
            expected = f"none: {clipless[suffix]} has no clips" if suffix in clipless else "name of a clip"
            raise InputError("bad clip", key="clip", received=self.clip, expected=expected)
        if self.end is not None and self.end <= self.start:
            expected = f"after the start, {self.start:g} [s]"
            raise InputError("a part that ends before it starts", key="end", received=self.end, expected=expected)
        if self.joints is not None and suffix != ".bvh":
            expected = "none: only a captured motion (.bvh) is put on other joints"
            raise InputError("bad joints", key="joints", received=str(self.joints), expected=expected)
        _check_rate(self.rate, self.file)

    @property
    def is_sequence(self) -> bool:
        """Whether it is a vertex sequence, and no motion of a character."""
        return self.clip is None and _suffix(self.file) != ".bvh"

    @property
    def name(self) -> str:
        """Name for figures and files: label or clip, with the part and the speed where they are not the whole and 1."""
        words = [self.label or self.clip or Path(self.file).stem]
        if self.start or self.end is not None:
            words.append(f"{self.start:g}-{'' if self.end is None else f'{self.end:g}'} s")
        if self.speed != 1.0:
            words.append(f"x {self.speed:g}")
        return " ".join(words)

    def overlaps(self, other: MotionSettings) -> bool:
        """Whether both are parts of one clip that have time in common, at any speeds."""
        ends = [math.inf if end is None else end for end in (self.end, other.end)]
        same = (self.file, self.clip) == (other.file, other.clip)
        return same and self.start < ends[1] and other.start < ends[0]


@dataclass(frozen=True, kw_only=True)
class CharacterSettings:
    """The body and its motion: a skinned character, or a sequence of vertex positions.

    Attributes:
        file: path of a glTF or USD file, or "builtin:mannequin".
        sequence: path of a vertex sequence instead.
        clip: name of the clip to play; None for the file's first.
        motion: a motion of another file to play instead of a clip.
        rate: frames a second of a .pc2 sequence, which does not know them [Hz].
    """

    file: Path | str | None = entry(CHARACTER_FILE, None)
    sequence: Path | None = entry(_SEQUENCE_FILE, None)
    clip: str | None = entry(text(), None)
    motion: MotionSettings | None = entry(table(MotionSettings), None)
    rate: float | None = entry(number(above=0, unit="Hz"), None)

    def __post_init__(self) -> None:
        if self.motion is not None and self.clip is not None:
            raise InputError("two motions", key="clip", received=self.clip, expected="clip or motion, not both")
        _check_rate(self.rate, self.sequence or "")


def _suffix(file: Path | str) -> str:
    return "" if str(file).startswith("builtin:") else Path(file).suffix.lower()


def _check_rate(rate: float | None, file: Path | str) -> None:
    """A .pc2 file needs a rate, and only that."""
    if (rate is None) == (_suffix(file) == ".pc2"):
        expected = "frames a second: a .pc2 file does not know them" if rate is None else "none: the file knows it"
        raise InputError("bad rate", key="rate", received=rate, expected=expected)
