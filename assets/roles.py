"""Roles of a character's joints (hips, left thigh, ...), found by their names and their places in the tree."""

from __future__ import annotations

import re
from collections.abc import Iterator

from assets.character import Character
from pbd.errors import InputError

__all__ = ["find_roles", "upwards"]

# Usual names of the joints of a limb, without side and punctuation.
_LIMBS = {
    "upleg": ("upleg", "thigh", "upperleg"),
    "leg": ("leg", "calf", "shin", "lowerleg"),
    "foot": ("foot", "ankle"),
    "toe": ("toebase", "toe", "toes", "ball"),
    "arm": ("arm", "upperarm"),
    "forearm": ("forearm", "lowerarm"),
    "hand": ("hand", "wrist"),
}
_CENTRE = {"hips": ("hips", "pelvis"), "head": ("head",)}
_OPTIONAL = {"toe"}


def find_roles(character: Character) -> dict:
    """Find the joint of every role.

    Args:
        character: its joints have usual names.

    Returns:
        joints by role: (part, side) for limbs, where side is 0 left or 1 right; "hips"; "head"; and for "spine" and
        "neck" lists of joints from below upwards.

    Raises:
        InputError: a role that no joint has, or joints that do not hang together as a figure's do.
    """
    roles: dict = {}
    for joint, name in enumerate(character.joint_names):
        side, part = _side_and_part(name)
        for role, names in (_CENTRE if side is None else _LIMBS).items():
            if part in names:
                roles.setdefault(role if side is None else (role, side), joint)
    wanted = {role: role for role in _CENTRE}
    wanted |= {(role, k): f"{side} {role}" for role in _LIMBS for k, side in enumerate(("left", "right"))}
    missing = [name for role, name in wanted.items() if role not in roles and role[0] not in _OPTIONAL]
    key = f"character {character.name}"
    if missing:
        raise InputError(
            f"no joint is named as {', '.join(missing)}",
            key=key,
            received=list(character.joint_names),
            expected="usual names, such as Hips, LeftUpLeg, LeftLeg, LeftArm, or pelvis, thigh_l, calf_l, upperarm_l",
        )
    # The chest is where both arms meet.
    above_arms = set(upwards(character, roles["arm", 1]))
    chest = next((joint for joint in upwards(character, roles["arm", 0]) if joint in above_arms), -1)
    roles["spine"] = _between(character, roles["hips"], chest)
    roles["neck"] = _between(character, chest, roles["head"])[:-1]
    chains = [("leg", "upleg"), ("foot", "leg"), ("forearm", "arm"), ("hand", "forearm")]
    loose = [f"{a} below {b}" for a, b in chains for s in (0, 1) if roles[b, s] not in upwards(character, roles[a, s])]
    loose += ["legs below the hips" for s in (0, 1) if roles["hips"] not in upwards(character, roles["upleg", s])]
    loose += [] if roles["spine"] else ["arms on a spine above the hips"]
    if loose:
        raise InputError("a tree of joints that is no figure", key=key, expected=", ".join(dict.fromkeys(loose)))
    return roles


def _between(character: Character, low: int, high: int) -> list[int]:
    """Joints above `low` on the way up to and with `high`; none if `low` is no descendant of `high`."""
    chain = list(upwards(character, high))
    return chain[: chain.index(low)][::-1] if low in chain else []


def upwards(character: Character, joint: int) -> Iterator[int]:
    """Yield the joint and its ancestors, up to the root."""
    while joint >= 0:
        yield joint
        joint = int(character.joint_parents[joint])


def _side_and_part(name: str) -> tuple[int | None, str]:
    """Side (0 left, 1 right, None) and the rest of a joint's name in small letters without punctuation."""
    name = re.sub(r"^(.*:|DEF-|ORG-|Bip\d+[ _])", "", name)
    side = None
    patterns = (
        r"^(left|right)(.*)$",
        r"^([lr])[ _.\-](.*)$",
        r"^(?-i:([LR])(?=[A-Z])(.*))$",
        r"^(.*?)[ _.\-](left|right|l|r)$",
    )
    for k, pattern in enumerate(patterns):
        match = re.match(pattern, name, re.IGNORECASE)
        if match:
            word, name = match.groups() if k < 3 else match.groups()[::-1]
            side = 0 if word.lower().startswith("l") else 1
            break
    return side, re.sub(r"[^a-z]", "", name.lower())
