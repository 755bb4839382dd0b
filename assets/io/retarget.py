"""Motion capture on a character of its own: joint positions of a BVH file become a clip of the character's skeleton.

Only the directions from joint to joint count. Each bone of arms and legs points where the captured one points.
The trunk is turned by two lines: from hip to hip (pelvis) or from shoulder to shoulder (chest), and from the joint that
carries all to the middle of the shoulders. Bones keep the character's own lengths. Units, zero pose and the bones in
between do not matter. Positions say nothing about twist: hands, neck and head stay as they are against forearms and
chest.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from assets.body_parts import LIMBS, PARTS, common_ancestor, find_parts
from assets.character import Character, Clip
from assets.io.bvh import Bvh
from assets.skinning import skin_vertices
from assets.text import read_words
from assets.transform import decompose
from pbd.errors import InputError

__all__ = ["load_joint_table", "retargeted"]

Floats = NDArray[np.float64]

# A first frame is a pose that was put before the motion where a joint leaves it faster than this [m/s], and faster than
# ever after by this factor.
_MAX_SPEED, _SPEED_RATIO = 20.0, 3.0
# A trunk or a leg points along an axis where the cosine between them is more than this [-]. An axis is up if this share
# of them points along it; if the zero pose stands along it, too, the smaller share is enough [-].
_ALONG, _NEARLY_ALL, _MANY = 0.8, 0.9, 0.4
_TRUNK_ENDS = ("left upper arm", "right upper arm", "left upper leg", "right upper leg")
# The skin's lowest point stands on the floor at this percentile of about so many frames [%].
_FLOOR_SHARE, _FLOOR_FRAMES = 5.0, 60


def load_joint_table(path: Path) -> dict[str, tuple[str, str]]:
    """Read a table of joints: a .csv file with the columns ``part``, ``joint``, ``bvh``.

    Returns:
        for each part of the body that is listed (see :data:`assets.body_parts.PARTS`) the names of its joint in the
        character and in the BVH file; "" where the name itself says it.

    Raises:
        InputError: the file cannot be read, or has other columns, an unknown part or one twice.
    """
    table: dict[str, tuple[str, str]] = {}
    for number, row in read_words(path, ("part", "joint", "bvh")):
        values = [value.strip() for value in row]
        if len(values) != 3 or values[0] not in PARTS or values[0] in table:
            expected = "one of " + ", ".join(part for part in PARTS if part not in table) + ", and two names"
            raise InputError("bad row", file=path, key=f"line {number}", received=values, expected=expected)
        table[values[0]] = (values[1], values[2])
    return table


def retargeted(character: Character, motion: Bvh, table: dict[str, tuple[str, str]] | None = None) -> Clip:
    """A clip that moves a character as a captured motion goes.

    The motion is turned if it stands along another axis than Y, scaled by the length of the legs, begins above the
    origin, and is lifted or lowered so that the skin stands as high as in the bind pose. A first frame that only holds
    a pose of another kind, from which a joint would jump, is left out.

    Args:
        character: the character, Y up.
        motion: the captured motion, in any unit.
        table: joints of the parts of the body that their names do not say, as :func:`load_joint_table` returns it.

    Raises:
        InputError: an arm or a leg that is found in one of both skeletons only or in none, a joint that does not exist,
            bones without length, or a motion that lies, although its zero pose stands along Y.
    """
    ours, theirs = _matched(character, motion, table or {})
    motion = _upright(motion, theirs)
    bind = character.joint_transforms(*character.rest_local)
    ours["trunk"] = common_ancestor(character.joint_parents, [ours[part] for part in _TRUNK_ENDS])
    theirs["trunk"] = common_ancestor(motion.joint_parents, [theirs[part] for part in _TRUNK_ENDS])
    rest = {part: bind[joint, :3, 3] for part, joint in ours.items()}
    goal = {part: motion.positions[:, joint] for part, joint in theirs.items()}
    scale = _leg_length(rest) / max(_leg_length(goal), 1e-30)
    if not 1e-9 < scale < 1e9:
        received, expected = _leg_length(goal), "hips, knees and ankles that lie apart"
        raise InputError("legs without length", file=motion.file, received=received, expected=expected)
    goal = {part: scale * places for part, places in goal.items()}
    first = _first_frame(goal, motion.rate)
    goal = {part: places[first:] for part, places in goal.items()}
    turned = _turns(character, ours, rest, goal, motion)
    positions = _positions(character, bind, turned, ours, rest, goal)
    world = np.tile(bind, (len(positions), 1, 1, 1))
    world[:, :, :3, :3] = turned @ bind[:, :3, :3]
    world[:, :, :3, 3] = positions
    world[:, :, 1, 3] += _lift(character, world)
    above = world[:, character.joint_parents]
    above[:, character.joint_parents < 0] = character.root_transform
    local = np.linalg.inv(above) @ world
    return Clip(motion.file.stem, motion.rate, *decompose(local, f"{motion.file}, on {character.name}"))


def _matched(
    character: Character, motion: Bvh, table: dict[str, tuple[str, str]]
) -> tuple[dict[str, int], dict[str, int]]:
    """Joints of the parts of the body in the character and in the motion, for the parts that both have."""
    found = []
    for column, (owner, names) in enumerate(
        ((f"character {character.name}", character.joint_names), (str(motion.file), motion.joint_names))
    ):
        parts = find_parts(names)
        for part, row in table.items():
            if row[column] and row[column] not in names:
                expected = "one of " + ", ".join(names)
                raise InputError("no such joint", file=owner, key=part, received=row[column], expected=expected)
            if row[column]:
                parts[part] = names.index(row[column])
        missing = [part for part in PARTS if part not in parts and not part.endswith("toes")]
        if missing:
            raise InputError(
                "joints whose names do not say which parts of the body they are",
                file=owner,
                key=", ".join(missing),
                received=list(names),
                expected="a table of joints that names them: a .csv file with the columns part,joint,bvh",
            )
        _check_chains(owner, parts, character.joint_parents if column == 0 else motion.joint_parents)
        found.append(parts)
    ours, theirs = found
    both = [part for part in PARTS if part in ours and part in theirs]
    return {part: ours[part] for part in both}, {part: theirs[part] for part in both}


def _check_chains(owner: str, parts: dict[str, int], parents: NDArray[np.int32]) -> None:
    """Each part of a limb is a child of the one before it."""
    for side in ("left", "right"):
        for limb in LIMBS.values():
            chain = [f"{side} {part}" for part in limb if f"{side} {part}" in parts]
            for upper, lower in zip(chain[:-1], chain[1:], strict=True):
                joint = int(parents[parts[lower]])
                while joint >= 0 and joint != parts[upper]:
                    joint = int(parents[joint])
                if joint < 0:
                    expected = f"a {lower} that hangs on the {upper}"
                    raise InputError("joints that are no limb", file=owner, key=lower, expected=expected)


def _upright(motion: Bvh, theirs: dict[str, int]) -> Bvh:
    """The motion with Y up: turned where the body stands along another axis, else as it is.

    Raises:
        InputError: the body stands along another axis in nearly all frames, but along Y in the zero pose.
    """
    shares, zero_pose = _standing(motion.positions, theirs), _standing(motion.zero_pose[None], theirs)
    axis = int(shares.argmax())
    if axis == 1 or shares[axis] < (_MANY if zero_pose[axis] == 1.0 else _NEARLY_ALL):
        return motion
    name = ("X", "Y", "Z", "-X", "-Y", "-Z")[axis]
    if zero_pose[1] == 1.0:
        raise InputError(
            f"a body that lies, or a motion with {name} up whose zero pose has Y up",
            file=motion.file,
            key="up axis",
            received=f"{name} in {100.0 * shares[axis]:.0f} % of the frames, Y in the zero pose",
            expected="Y up in both: export it again with Y up",
        )
    up = np.eye(3)[axis % 3] * (1.0 if axis < 3 else -1.0)
    turn = _shortest_turn(up[None], np.eye(3)[None, 1])[0]
    return replace(motion, positions=motion.positions @ turn.T, zero_pose=motion.zero_pose @ turn.T)


def _standing(positions: Floats, parts: dict[str, int]) -> Floats:
    """Share of trunks and straight legs that point up along X, Y, Z, -X, -Y and -Z, shape (6,).

    Both point along one axis if the body stands or lies, the trunk alone if it sits or crawls.

    Args:
        positions: of the joints, shape (f, joints, 3).
        parts: joint of each part of the body.
    """
    middle = {
        part: (positions[:, parts[f"left {part}"]] + positions[:, parts[f"right {part}"]]) / 2.0
        for part in ("upper arm", "upper leg", "foot")
    }
    lines = _unit(np.concatenate([middle["upper arm"] - middle["upper leg"], middle["upper leg"] - middle["foot"]]))
    return (np.concatenate([lines, -lines], axis=1) > _ALONG).mean(axis=0)


def _leg_length(places: dict[str, Floats]) -> float:
    """From hip to ankle, mean of both legs and median over time."""
    total = 0.0
    for side in ("left", "right"):
        for upper, lower in (("upper leg", "lower leg"), ("lower leg", "foot")):
            bone = places[f"{side} {lower}"] - places[f"{side} {upper}"]
            total += float(np.median(np.linalg.norm(bone, axis=-1)))
    return total / 2.0


def _first_frame(goal: dict[str, Floats], rate: float) -> int:
    """0, or 1 where the first frame is a pose that was put before the motion."""
    places = np.stack(list(goal.values()), axis=1)
    if len(places) < 3:
        return 0
    speeds = np.linalg.norm(np.diff(places, axis=0), axis=2).max(axis=1) * rate
    return int(speeds[0] > _MAX_SPEED and speeds[0] > _SPEED_RATIO * speeds[1:].max())


def _turns(
    character: Character, ours: dict[str, int], rest: dict[str, Floats], goal: dict[str, Floats], motion: Bvh
) -> Floats:
    """Rotation of each joint since the bind pose, about the world's axes, shape (f, joints, 3, 3)."""
    parents = character.joint_parents
    chest = common_ancestor(parents, [ours["left upper arm"], ours["right upper arm"]])
    trunk = [chest]
    while trunk[-1] != ours["trunk"]:
        trunk.append(int(parents[trunk[-1]]))
    pelvis_turn, chest_turn = (_frame(goal, limb) @ _frame(rest, limb).T for limb in ("leg", "arm"))
    spine = dict(zip(trunk[::-1], _between(pelvis_turn, chest_turn, len(trunk)), strict=True))
    aims = {
        ours[f"{side} {part}"]: (f"{side} {part}", f"{side} {following}")
        for side in ("left", "right")
        for limb in LIMBS.values()
        for part, following in zip(limb[:-1], limb[1:], strict=True)
        if f"{side} {following}" in ours
    }
    count = len(pelvis_turn)
    turned = np.tile(np.eye(3), (count, character.joint_count, 1, 1))
    for joint, parent in enumerate(parents):
        if joint in spine:
            turned[:, joint] = spine[joint]
            continue
        if parent >= 0:
            turned[:, joint] = turned[:, parent]
        if joint in aims:
            start, end = aims[joint]
            bone, wanted = rest[end] - rest[start], goal[end] - goal[start]
            if np.linalg.norm(wanted, axis=1).min() < 1e-6 or np.linalg.norm(bone) < 1e-6:
                problem = "two joints at one place"
                raise InputError(problem, file=motion.file, key=f"{start} and {end}", expected="a bone with a length")
            turned[:, joint] = _shortest_turn(turned[:, joint] @ bone, wanted) @ turned[:, joint]
    return turned


def _frame(places: dict[str, Floats], limb: str) -> Floats:
    """Axes of the trunk where arms or legs begin: right to left, up along the trunk, forward; shape (..., 3, 3)."""
    shoulders = (places["left upper arm"] + places["right upper arm"]) / 2.0
    across = _unit(places[f"left upper {limb}"] - places[f"right upper {limb}"])
    forward = _unit(np.cross(across, shoulders - places["trunk"]))
    return np.stack([across, np.cross(forward, across), forward], axis=-1)


def _between(start: Floats, end: Floats, count: int) -> list[Floats]:
    """Rotations over time, (f, 3, 3), in equal steps from one to another, both included; the end alone for one."""
    if count == 1:
        return [end]
    step = Rotation.from_matrix(np.swapaxes(start, 1, 2) @ end).as_rotvec()
    return [start @ Rotation.from_rotvec(share * step).as_matrix() for share in np.linspace(0.0, 1.0, count)]


def _shortest_turn(start: Floats, end: Floats) -> Floats:
    """The rotation about the axis across both that turns one direction into another, shape (f, 3, 3)."""
    start, end = _unit(start), _unit(end)
    axis = np.cross(start, end)
    sine, cosine = np.linalg.norm(axis, axis=1, keepdims=True), np.einsum("fa,fa->f", start, end)[:, None]
    # Where they are opposite any axis across will do.
    across = np.cross(start, np.eye(3)[np.argmin(np.abs(start), axis=1)])
    axis = np.where(sine > 1e-9, axis / np.maximum(sine, 1e-12), _unit(across))
    return Rotation.from_rotvec(axis * np.arctan2(sine, cosine)).as_matrix()


def _unit(vectors: Floats) -> Floats:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def _positions(
    character: Character,
    bind: Floats,
    turned: Floats,
    ours: dict[str, int],
    rest: dict[str, Floats],
    goal: dict[str, Floats],
) -> Floats:
    """Joints in the world [m], shape (f, joints, 3): the middle of the hips goes where the captured one goes."""
    places = np.tile(bind[:, :3, 3], (len(turned), 1, 1))
    for joint, parent in enumerate(character.joint_parents):
        if parent >= 0:
            bone = bind[joint, :3, 3] - bind[parent, :3, 3]
            places[:, joint] = places[:, parent] + turned[:, parent] @ bone
    hips = ("left upper leg", "right upper leg")
    wanted = sum(goal[part] for part in hips) / 2.0 - sum(places[:, ours[part]] for part in hips) / 2.0
    moved = places + wanted[:, None]
    start = np.mean([moved[0, ours[part]] for part in hips], axis=0)
    return moved - [start[0], 0.0, start[2]]


def _lift(character: Character, world: Floats) -> float:
    """Height by which the skin's lowest points must rise so that it stands where it stands in the bind pose [m].

    Args:
        character: the skinned mesh.
        world: transforms of its joints in the world, shape (f, joints, 4, 4).
    """
    frames = world[:: max(1, len(world) // _FLOOR_FRAMES)]
    lowest = [skin_vertices(character, (joints @ character.inverse_bind)[:, :3])[:, 1].min() for joints in frames]
    return float(character.vertices[:, 1].min() - np.percentile(lowest, _FLOOR_SHARE))
