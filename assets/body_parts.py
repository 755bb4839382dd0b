"""Parts of a body that joints are named after: which joint of a skeleton is the left knee."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pbd.errors import InputError

__all__ = ["LIMBS", "PARTS", "common_ancestor", "find_parts"]

# Limbs from the trunk outwards; the toes may be missing.
LIMBS = {
    "arm": ("upper arm", "lower arm", "hand"),
    "leg": ("upper leg", "lower leg", "foot", "toes"),
}
PARTS = tuple(f"{side} {part}" for side in ("left", "right") for parts in LIMBS.values() for part in parts)

# Names of parts in usual skeletons, without side, separators and numbers; those that say more come first.
_NAMES = {
    "upper arm": ("upperarm", "uparm", "arm", "shoulder"),  # where another word is used, "shoulder" is the collar bone
    "lower arm": ("forearm", "lowerarm", "lowarm", "elbow"),
    "hand": ("hand", "wrist"),
    "upper leg": ("upleg", "upperleg", "thigh", "femur", "hip"),
    "lower leg": ("lowerleg", "lowleg", "calf", "shin", "knee", "leg"),
    "foot": ("foot", "ankle"),
    "toes": ("toebase", "toes", "toe", "ball"),
}
_SIDES = {"l": "left", "left": "left", "r": "right", "right": "right"}
_NOISE = {"bip", "def", "mixamorig", "j", "b"}  # what rigs put before every name


def find_parts(names: Sequence[str]) -> dict[str, int]:
    """Joints by the part of the body that their name says, for those of ``PARTS`` that a name says.

    A skeleton has one word for a part on both sides; of several the one counts that says most. Of equal names the first
    joint counts.

    Args:
        names: of all joints, parents first.
    """
    found: dict[str, int] = {}
    sides_and_words = [_side_and_word(name) for name in names]
    for part, words in _NAMES.items():
        used = [word for word in words if ("left", word) in sides_and_words or ("right", word) in sides_and_words]
        for side in ("left", "right"):
            if used and (side, used[0]) in sides_and_words:
                found[f"{side} {part}"] = sides_and_words.index((side, used[0]))
    return found


def _side_and_word(name: str) -> tuple[str | None, str]:
    """Side of a joint and the rest of its name: "mixamorig:LeftUpLeg" gives "left" and "upleg"."""
    words = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name.rpartition(":")[2])
    words = [word.lower() for word in words if word.lower() not in _NOISE]
    sides = [_SIDES[word] for word in words if word in _SIDES]
    return sides[0] if len(sides) == 1 else None, "".join(word for word in words if word not in _SIDES)


def common_ancestor(parents: NDArray[np.int32], joints: Sequence[int]) -> int:
    """The lowest joint that is each of some joints or an ancestor of it.

    Raises:
        InputError: they have different roots.
    """
    chains = []
    for joint in joints:
        chain = [joint]
        while parents[chain[-1]] >= 0:
            chain.append(int(parents[chain[-1]]))
        chains.append(chain[::-1])
    common = [steps[0] for steps in zip(*chains, strict=False) if len(set(steps)) == 1]
    if not common:
        raise InputError("joints that hang on different roots", key="joints", received=list(joints))
    return common[-1]
