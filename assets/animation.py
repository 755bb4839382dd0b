"""Clips in files of their own: a skeleton that moves, without a mesh, put on a character by the names of its joints."""

from __future__ import annotations

from collections.abc import Container, Sequence

import numpy as np
from numpy.typing import NDArray

from assets.character import Animation, Character, Clip
from assets.motion import uppermost_joints
from assets.transform import decompose, local_matrices
from pbd.errors import InputError

__all__ = ["clip_on"]

Floats = NDArray[np.float64]

# Of a joint from its parent: further than this from where it lies in the bind pose it is another skeleton's; and if it
# moves by as much, the clip means it [m].
_MAX_GAP = 0.01
_MAX_SCALE = 2.0  # of joints over those of the bind pose, or the other way round: more comes from another unit [-]
_STILL = 1e-4  # a joint whose local transform changes by less does not move [m, -]
_LISTED = 12  # names in a message


def clip_on(character: Character, animation: Animation, name: str) -> Clip:
    """A clip of an animation for the joints of a character that have the same names.

    Joints go in the world where they go in the file; the unit of its skeleton makes no difference. A joint that the
    file lacks stays as in the bind pose against its parent.

    Raises:
        InputError: no such clip; two joints of one name; no joint with skin in common; joints with skin that the file
            lacks, where it moves others that the character lacks; joints that lie elsewhere than in the bind pose.
    """
    if name not in animation.clips:
        expected = "one of " + ", ".join(sorted(animation.clips))
        raise InputError("no such clip", file=animation.file, key="clip", received=name, expected=expected)
    clip = animation.clips[name]
    partner = _partners(character, animation, clip)
    world = local_matrices(clip.translation, clip.rotation, clip.scale)
    for joint, parent in enumerate(animation.joint_parents):
        world[:, joint] = (animation.root_transform if parent < 0 else world[:, parent]) @ world[:, joint]
    unit = _unit(character, partner, world)
    world[..., :3, :3] /= unit
    _check_bones(character, animation, partner, world)
    rest = local_matrices(*character.rest_local)
    placed = np.tile(character.root_transform, (clip.frame_count, character.joint_count, 1, 1))
    parts = [np.tile(part, (clip.frame_count, 1, 1)) for part in character.rest_local]
    for joint, parent in enumerate(character.joint_parents):
        above = placed[:, parent] if parent >= 0 else character.root_transform[None]
        own = partner.get(joint)
        if own is None:
            placed[:, joint] = above @ rest[joint]
            continue
        placed[:, joint] = world[:, own]
        if unit == 1.0 and parent >= 0 and partner.get(int(parent)) == animation.joint_parents[own]:
            local = (clip.translation[:, own], clip.rotation[:, own], clip.scale[:, own])
        else:
            key = f"{animation.file}, clip {name}, joint {character.joint_names[joint]}"
            local = decompose(_inverse(above, key) @ world[:, own], key)
        for part, values in zip(parts, local, strict=True):
            part[:, joint] = values
    return Clip(name, clip.rate, *parts)


def _partners(character: Character, animation: Animation, clip: Clip) -> dict[int, int]:
    """Joint of the animation of the same name, for the joints of the character that have one."""
    names = animation.joint_names
    partner = {joint: names.index(name) for joint, name in enumerate(character.joint_names) if name in names}
    used = set(partner.values())
    twice = [names[own] for own in used if names.count(names[own]) > 1]
    if twice:
        raise InputError("two joints of one name", file=animation.file, key="joints", received=twice[0])
    # Joints without a partner may not have the same parent in both: they are likely the same by another name. An
    # ancestor of all common joints is no such partner.
    changes = [np.ptp(part, axis=0).max(axis=1) > _STILL for part in (clip.translation, clip.rotation, clip.scale)]
    carries = {joint for own in used for joint in _ancestors(animation.joint_parents, own)}
    spare: dict[int, int | None] = {}
    for own in np.flatnonzero(np.any(changes, axis=0)).tolist():
        anchor = _first(_ancestors(animation.joint_parents, own), used)
        if own not in used and (anchor is not None or own not in carries):
            spare[own] = anchor
    skinned = np.unique(character.joint_indices[character.joint_weights > 0.0]).tolist()
    missing = [joint for joint in skinned if joint not in partner]
    anchors = [_first(_ancestors(character.joint_parents, joint), partner) for joint in missing]
    here = {None if joint is None else partner[joint] for joint in anchors}
    if len(missing) == len(skinned) or not here.isdisjoint(spare.values()):
        raise InputError(
            f"clips of another skeleton than {character.name}: names of joints differ",
            file=animation.file,
            key="joints",
            received=_listed([names[own] for own in spare] or names),
            expected=_listed([character.joint_names[joint] for joint in missing]),
        )
    return partner


def _unit(character: Character, partner: dict[int, int], world: Floats) -> float:
    """Scale of the animation's joints over those of the bind pose, or 1 where a clip may mean the difference.

    Args:
        character: the character.
        partner: joint of the animation for each joint of the character that has one.
        world: transforms of the animation's joints in the world, shape (f, joints, 4, 4).
    """
    ours, theirs = list(partner), list(partner.values())
    bind = np.linalg.det(character.joint_transforms(*character.rest_local)[ours])
    scale = float(np.median(np.cbrt(np.abs(np.linalg.det(world[:, theirs]) / bind))))
    return 1.0 if 1.0 / _MAX_SCALE < scale < _MAX_SCALE or not 1e-6 < scale < 1e6 else scale


def _check_bones(character: Character, animation: Animation, partner: dict[int, int], world: Floats) -> None:
    """From the hips down to the ends, joints lie as far from one another as in the bind pose.

    Where the hips lie is the clip's own matter, and so is a joint that moves against its parent.
    """
    bind = character.joint_transforms(*character.rest_local)
    scales = np.cbrt(np.abs(np.linalg.det(bind)))
    tops = set(uppermost_joints(character).tolist())
    for joint, own in partner.items():
        key, upwards = f"joint {character.joint_names[joint]}", _ancestors(character.joint_parents, joint)
        anchor = _first(upwards, partner)
        if anchor is None or tops.isdisjoint([anchor, *_ancestors(character.joint_parents, anchor)]):
            continue
        there = (_inverse(world[:, partner[anchor]], f"{animation.file}, {key}") @ world[:, own])[:, :3, 3]
        here = (np.linalg.inv(bind[anchor]) @ bind[joint])[:3, 3]
        gap = scales[anchor] * float(np.linalg.norm(np.median(there, axis=0) - here))
        if gap > _MAX_GAP and scales[anchor] * np.ptp(there, axis=0).max() < _MAX_GAP:
            raise InputError(
                f"clips of another skeleton than {character.name}: a joint lies elsewhere",
                file=animation.file,
                key=key,
                received=f"{gap:.3g} m from where it is against {character.joint_names[anchor]} in the bind pose",
                expected=f"at most {_MAX_GAP} m",
            )


def _ancestors(parents: NDArray[np.int32], joint: int) -> list[int]:
    """Joints above a joint, the nearest first."""
    chain: list[int] = []
    while (joint := int(parents[joint])) >= 0:
        chain.append(joint)
    return chain


def _first(joints: Sequence[int], known: Container[int]) -> int | None:
    """The first joint that is among the known ones."""
    return next((joint for joint in joints if joint in known), None)


def _listed(names: Sequence[str]) -> str:
    """Names in a message, at most a dozen."""
    more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    return ", ".join(names[:_LISTED]) + more


def _inverse(matrices: Floats, key: str) -> Floats:
    """Inverse transforms, shape (f, 4, 4); one that flattens space is refused."""
    if (np.abs(np.linalg.det(matrices)) < 1e-15).any():
        raise InputError("a transform that flattens space", key=key)
    return np.linalg.inv(matrices).astype(np.float64)
