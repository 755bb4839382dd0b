"""A character as a figure that is posed by the places of its feet and the angles of its trunk and arms.

The joints are found by their usual names, and every rotation is meant in the frame of the bind pose: X to the figure's
left, Y up, Z ahead. So it does not matter how the axes of a file's joints are turned.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from assets.character import Character, Clip
from assets.roles import find_roles, upwards
from assets.transform import decompose, local_matrices, quaternions, slerp

__all__ = ["Curves", "Figure", "rot_x", "rot_y", "rot_z", "smoothstep"]

Floats = NDArray[np.float64]

# Near its full length a small move of the hip bends a leg's knee a lot. So the hips stay within the first share of the
# length. Smoothing their height may still take them beyond it: from the second share on a leg follows less and less,
# and it never comes to the third.
_MAX_REACH, _SOFT_REACH, _FULL_REACH = 0.993, 0.98, 0.998


@dataclass(eq=False)
class Curves:
    """How a figure is held over time. Sides are 0 left, 1 right; F is the number of frames.

    Attributes:
        hips: from their place in the bind pose [m], shape (F, 3), in the figure's frame at the start.
        heading: turn of the whole figure to its left [rad], shape (F,).
        pelvis: pitch forwards, turn to the left, roll to the right, on top of the heading [rad], shape (F, 3).
        trunk: the same for the chest against the pelvis [rad], shape (F, 3).
        feet: place of the flat foot from the floor below the hips in the bind pose [m], shape (2, F, 3); y is the lift.
        foot_turn: turn of the foot to the left [rad], shape (2, F).
        foot_pitch: heel up, on the ball, or if negative toes up, on the heel [rad], shape (2, F).
        toe_bend: toes bent up against the foot [rad], shape (2, F).
        arms: flexion forwards, abduction from straight down, bend of the elbow [rad], shape (2, F, 3).
    """

    hips: Floats
    heading: Floats
    pelvis: Floats
    trunk: Floats
    feet: Floats
    foot_turn: Floats
    foot_pitch: Floats
    toe_bend: Floats
    arms: Floats


class Figure:
    """The measures of a character that :class:`Curves` need, and the way from curves to a clip.

    Attributes:
        leg_length: hip to ankle along the bones [m].
        ankles: flat feet in the bind pose, below the hips' joint, y = 0, shape (2, 3).
        hip_joints: tops of the legs from the hips' joint, shape (2, 3).
        reach: longest distance from hip to ankle [m], shape (2,).

    Raises:
        InputError: a joint that is needed is not found by its name, or hangs elsewhere in the tree.
    """

    def __init__(self, character: Character) -> None:
        self.character = character
        self._roles = find_roles(character)
        transforms = character.joint_transforms(*character.rest_local)
        _, rotation, _ = decompose(transforms, f"character {character.name}")
        self._bind_rotation = local_matrices(np.zeros(3), rotation, np.ones(3))[:, :3, :3]
        self._bind_linear = transforms[:, :3, :3]
        places = transforms[:, :3, 3]
        hips = places[self._roles["hips"]]
        left = places[self._roles["upleg", 0]] - places[self._roles["upleg", 1]]
        facing = np.arctan2(-left[2], left[0])  # Z ahead if the left leg is at +X
        self._frame = rot_y(np.array(facing))
        floor = character.vertices[:, 1].min()
        self._origin = np.array([hips[0], floor, hips[2]])
        self._bind = (places - self._origin) @ self._frame  # rows: frame^T @ place
        self.ankles = np.stack([self._bind[self._roles["foot", side]] for side in (0, 1)])
        self._ankle_height = self.ankles[:, 1].copy()
        self.ankles[:, 1] = 0.0
        self.hip_joints = np.stack([self._bind[self._roles["upleg", side]] for side in (0, 1)])
        self._hips = self._bind[self._roles["hips"]]
        self.hip_joints = self.hip_joints - self._hips
        self._legs = [self._leg(side) for side in (0, 1)]
        self.reach = np.array([_MAX_REACH * (leg.thigh_length + leg.shin_length) for leg in self._legs])
        self.leg_length = float(self.reach.mean() / _MAX_REACH)
        self._heel, self._ball = self._soles()

    def ankle_places(self, curves: Curves) -> Floats:
        """Where the ankles must be [m], shape (2, F, 3)."""
        places = np.zeros_like(curves.feet)
        for side in (0, 1):
            pitch = curves.foot_pitch[side]
            pivot = np.where(pitch[:, None] > 0.0, self._ball[side], self._heel[side])
            turned = np.einsum("fij,fj->fi", rot_x(pitch), pivot)
            offset = np.einsum("fij,fj->fi", rot_y(curves.foot_turn[side]), pivot - turned)
            places[side] = curves.feet[side] + offset + [0.0, self._ankle_height[side], 0.0]
        return places

    def highest_hips(self, curves: Curves) -> Floats:
        """How far up from the bind pose the hips can be with both feet where they are [m], shape (2, F)."""
        ankles = self.ankle_places(curves)
        turn = rot_y(curves.heading) @ _euler(curves.pelvis)
        limits = np.zeros(ankles.shape[:2])
        for side in (0, 1):
            offset = turn @ self.hip_joints[side]
            top = self._hips + curves.hips + offset
            flat = np.linalg.norm((ankles[side] - top)[:, [0, 2]], axis=1)
            height = np.sqrt(np.maximum(self.reach[side] ** 2 - flat**2, 0.0))
            limits[side] = ankles[side][:, 1] + height - self._hips[1] - offset[:, 1]
        return limits

    def clip(self, curves: Curves, name: str, rate: float, *, blend: float = 0.0) -> Clip:
        """The clip that holds the figure so.

        Args:
            curves: how.
            name: of the clip.
            rate: frames per second [Hz].
            blend: time over which the bind pose goes over into the curves [s].
        """
        turns, places = self._turns(curves)
        character, frames = self.character, len(places)
        rest_translation, rest_rotation, rest_scale = character.rest_local
        translation = np.tile(rest_translation, (frames, 1, 1))
        rotation = np.zeros((frames, character.joint_count, 4))
        top = character.root_transform
        top_rotation = local_matrices(np.zeros(3), decompose(top)[1], np.ones(3))[:3, :3]
        # From the figure's frame to the world, then from the world to each parent.
        turns = self._frame @ turns @ self._frame.T
        places = places @ self._frame.T + self._origin
        world = turns @ self._bind_rotation
        linear = turns @ self._bind_linear
        carried = list(upwards(character, self._roles["hips"]))
        for joint, parent in enumerate(character.joint_parents):
            above = top_rotation if parent < 0 else world[:, parent]
            rotation[:, joint] = quaternions(np.swapaxes(above, -1, -2) @ world[:, joint])
            if joint in carried:  # all others keep their distance from the parent
                base = top[:3, 3] if parent < 0 else places[:, parent]
                inverse = np.linalg.inv(top[:3, :3] if parent < 0 else linear[:, parent])
                translation[:, joint] = (inverse @ (places[:, joint] - base)[..., None])[..., 0]
        share = smoothstep(np.arange(frames) / (rate * blend)) if blend > 0.0 else np.ones(frames)
        rotation = slerp(np.broadcast_to(rest_rotation, rotation.shape), rotation, share[:, None])
        translation = rest_translation + share[:, None, None] * (translation - rest_translation)
        return Clip(name, rate, translation, rotation, np.tile(rest_scale, (frames, 1, 1)))

    def _turns(self, curves: Curves) -> tuple[Floats, Floats]:
        """Rotation of every joint against the bind pose, shape (F, joints, 3, 3), and their places (F, joints, 3)."""
        roles, bind, parents = self._roles, self._bind, self.character.joint_parents
        frames = len(curves.heading)
        assigned = self._upper_body(curves)
        ankles = self.ankle_places(curves)
        turns = np.broadcast_to(np.eye(3), (frames, len(parents), 3, 3)).copy()
        places = np.broadcast_to(bind, (frames, len(parents), 3)).copy()
        uplegs = {roles["upleg", side]: side for side in (0, 1)}
        # Joints above the hips in the tree go along on the floor.
        ground = curves.hips * [1.0, 0.0, 1.0]
        for joint in list(upwards(self.character, roles["hips"]))[1:]:
            turns[:, joint] = rot_y(curves.heading)
            places[:, joint] = turns[:, joint] @ bind[joint] + ground
        for joint, parent in enumerate(parents):
            if joint == roles["hips"]:
                places[:, joint] = self._hips + curves.hips
            elif parent >= 0 and not self._under(roles["hips"], joint):
                places[:, joint] = places[:, parent] + turns[:, parent] @ (bind[joint] - bind[parent])
                turns[:, joint] = turns[:, parent]
            if joint in uplegs:
                side = uplegs[joint]
                ahead = curves.heading + curves.pelvis[:, 1]
                knee_turn = ahead + 0.5 * (curves.foot_turn[side] - ahead)
                thigh, shin = self._legs[side].solve(ankles[side] - places[:, joint], knee_turn)
                assigned[joint], assigned[roles["leg", side]] = thigh, shin
                foot = rot_y(curves.foot_turn[side]) @ rot_x(curves.foot_pitch[side])
                assigned[roles["foot", side]] = foot
                if ("toe", side) in roles:
                    assigned[roles["toe", side]] = foot @ rot_x(-curves.toe_bend[side])
            if joint in assigned:
                turns[:, joint] = assigned[joint]
        return turns, places

    def _upper_body(self, curves: Curves) -> dict[int, Floats]:
        """Rotations of hips, spine, neck, head and arms by joint, each shape (F, 3, 3)."""
        roles = self._roles
        pelvis = rot_y(curves.heading) @ _euler(curves.pelvis)
        assigned = {roles["hips"]: pelvis}
        spine, neck = roles["spine"], [*roles["neck"], roles["head"]]
        for k, joint in enumerate(spine):
            assigned[joint] = pelvis @ _euler(curves.trunk * ((k + 1) / len(spine)))
        chest = assigned[spine[-1]]
        # The head keeps level and looks ahead, though not all the way.
        for k, joint in enumerate(neck):
            assigned[joint] = chest @ _euler(-0.7 * (curves.trunk + curves.pelvis) * ((k + 1) / len(neck)))
        for side, outward in ((0, 1.0), (1, -1.0)):
            arm, forearm, hand = (roles[part, side] for part in ("arm", "forearm", "hand"))
            flexion, abduction, elbow = curves.arms[side].T
            upper = _unit(self._bind[forearm] - self._bind[arm])
            lower = _unit(self._bind[hand] - self._bind[forearm])
            swing = rot_x(-flexion) @ rot_z(outward * abduction)
            down = -swing[:, :, 1]
            bend = swing @ _unit(np.array([-0.2 * outward, 0.0, 1.0]))
            turn = _shortest(np.broadcast_to(upper, down.shape), down)
            goal = np.cos(elbow)[:, None] * down + np.sin(elbow)[:, None] * bend
            assigned[arm] = chest @ turn
            assigned[forearm] = chest @ _shortest(turn @ lower, goal) @ turn
        return assigned

    def _leg(self, side: int) -> _Leg:
        hip, knee, ankle = (self._bind[self._roles[part, side]] for part in ("upleg", "leg", "foot"))
        return _Leg(knee - hip, ankle - knee)

    def _soles(self) -> tuple[Floats, Floats]:
        """Points under heel and ball, from the ankle, shape (2, 3) each, found from the skin of the feet."""
        character, heels, balls = self.character, [], []
        for side in (0, 1):
            joints = [joint for joint in range(character.joint_count) if self._under(joint, self._roles["foot", side])]
            weight = np.where(np.isin(character.joint_indices, joints), character.joint_weights, 0.0).sum(axis=1)
            ankle = self._bind[self._roles["foot", side]]
            skin = (character.vertices[weight > 0.5] - self._origin) @ self._frame - ankle
            if not len(skin):
                skin = np.array([[0.0, 0.0, -0.05], [0.0, 0.0, 0.17]]) * self.leg_length / 0.8
            back, front = skin[:, 2].min(), skin[:, 2].max()
            toe = self._roles.get(("toe", side))
            ahead = self._bind[toe][2] - ankle[2] if toe is not None else back + 0.72 * (front - back)
            heels.append([0.0, -self._ankle_height[side], back + 0.1 * (front - back)])
            balls.append([0.0, -self._ankle_height[side], min(ahead, front)])
        return np.array(heels), np.array(balls)

    def _under(self, joint: int, ancestor: int) -> bool:
        return ancestor in upwards(self.character, joint)


class _Leg:
    """Thigh and shin that bend about one axis: the way from a place of the ankle to their rotations."""

    def __init__(self, thigh: Floats, shin: Floats) -> None:
        along = _unit(thigh + shin)
        self._axis = _unit(np.array([1.0, 0.0, 0.0]) - along[0] * along)
        # Components of the bones along the hinge cancel out: the bones are solved for in the plane across it.
        flat_thigh, flat_shin = (bone - (bone @ self._axis) * self._axis for bone in (thigh, shin))
        self.thigh_length, self.shin_length = float(np.linalg.norm(flat_thigh)), float(np.linalg.norm(flat_shin))
        self._thigh_frame = _hinge_frame(_unit(flat_thigh), self._axis)
        self._shin_frame = _hinge_frame(_unit(flat_shin), self._axis)

    def solve(self, ankle: Floats, turn: Floats) -> tuple[Floats, Floats]:
        """Rotations of thigh and shin against the bind pose, shape (F, 3, 3).

        Args:
            ankle: from the hip [m], shape (F, 3).
            turn: of the knee to the left [rad], shape (F,).
        """
        a, b = self.thigh_length, self.shin_length
        length = np.linalg.norm(ankle, axis=1)
        along = ankle / length[:, None]
        excess = np.maximum(length / (a + b) - _SOFT_REACH, 0.0) / (_FULL_REACH - _SOFT_REACH)
        length = np.where(excess > 0.0, (a + b) * (_FULL_REACH - (_FULL_REACH - _SOFT_REACH) * np.exp(-excess)), length)
        length = np.maximum(length, abs(a - b) + 0.06 * (a + b))
        side = rot_y(turn)[:, :, 0]
        axis = _unit(side - (side * along).sum(axis=1, keepdims=True) * along)
        ahead = np.cross(along, axis)
        cosine = (a**2 + length**2 - b**2) / (2.0 * a * length)
        sine = np.sqrt(1.0 - np.clip(cosine, -1.0, 1.0) ** 2)
        thigh = cosine[:, None] * along + sine[:, None] * ahead
        shin = (length[:, None] * along - a * thigh) / b
        return (
            _hinge_frame(thigh, axis) @ np.swapaxes(self._thigh_frame, -1, -2),
            _hinge_frame(shin, axis) @ np.swapaxes(self._shin_frame, -1, -2),
        )


def smoothstep(t: Floats) -> Floats:
    """From 0 at t <= 0 to 1 at t >= 1 without a corner."""
    t = np.clip(t, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def rot_x(angle: Floats) -> Floats:
    """Rotations about X [-], shape (..., 3, 3), of angles [rad], shape (...)."""
    return _about(angle, 0)


def rot_y(angle: Floats) -> Floats:
    """Rotations about Y, see :func:`rot_x`."""
    return _about(angle, 1)


def rot_z(angle: Floats) -> Floats:
    """Rotations about Z, see :func:`rot_x`."""
    return _about(angle, 2)


def _about(angle: Floats, axis: int) -> Floats:
    angle = np.asarray(angle, dtype=np.float64)
    u, v = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.zeros((*angle.shape, 3, 3))
    matrix[..., axis, axis] = 1.0
    matrix[..., u, u] = matrix[..., v, v] = np.cos(angle)
    matrix[..., v, u] = np.sin(angle)
    matrix[..., u, v] = -np.sin(angle)
    return matrix


def _euler(angles: Floats) -> Floats:
    """Turn, then pitch, then roll: rotations of (pitch, turn, roll to the right)."""
    return rot_y(angles[:, 1]) @ rot_x(angles[:, 0]) @ rot_z(-angles[:, 2])


def _unit(vector: Floats) -> Floats:
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)


def _hinge_frame(bone: Floats, axis: Floats) -> Floats:
    return np.stack([bone, axis, np.cross(bone, axis)], axis=-1)


def _shortest(start: Floats, end: Floats) -> Floats:
    """The rotations about the axis across both that turn unit vectors into others, shape (F, 3, 3)."""
    cross, cosine = np.cross(start, end), (start * end).sum(axis=-1)
    skew = np.zeros((*cosine.shape, 3, 3))
    skew[..., 0, 1], skew[..., 0, 2], skew[..., 1, 2] = -cross[..., 2], cross[..., 1], -cross[..., 0]
    skew = skew - np.swapaxes(skew, -1, -2)
    return np.eye(3) + skew + skew @ skew / np.maximum(1.0 + cosine, 1e-3)[..., None, None]
