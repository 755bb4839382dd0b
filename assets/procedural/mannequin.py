"""The built-in character: a shop-window mannequin of 1.70 m that walks, turns, twirls and sways."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from assets.character import Character, Clip
from assets.procedural.figure import Figure
from assets.procedural.gait import FRAME_RATE, Plan, Spin, curves_of, smooth

__all__ = ["DATA", "JOINTS", "builtin_mannequin"]

DATA = Path(__file__).resolve().parents[1] / "data"

# Joint: (parent, position [m]) in the bind pose: an A-pose, face towards +Z, soles on y = 0. Left is +X.
_CENTRE = {
    "Hips": (None, (0.0, 0.95, -0.005)),
    "Spine": ("Hips", (0.0, 1.04, -0.01)),
    "Spine1": ("Spine", (0.0, 1.15, -0.015)),
    "Spine2": ("Spine1", (0.0, 1.26, -0.02)),
    "Neck": ("Spine2", (0.0, 1.425, -0.025)),
    "Head": ("Neck", (0.0, 1.515, -0.005)),
}
_SIDE = {
    "Shoulder": ("Spine2", (0.03, 1.385, -0.015)),
    "Arm": ("Shoulder", (0.158, 1.352, -0.024)),
    "ForeArm": ("Arm", (0.362, 1.163, -0.030)),
    "Hand": ("ForeArm", (0.533, 0.993, -0.003)),
    "UpLeg": ("Hips", (0.088, 0.890, -0.005)),
    "Leg": ("UpLeg", (0.108, 0.478, 0.006)),
    "Foot": ("Leg", (0.120, 0.082, -0.030)),
    "ToeBase": ("Foot", (0.126, 0.022, 0.088)),
}
JOINTS: dict[str, tuple[str | None, tuple[float, float, float]]] = dict(_CENTRE)
for _side, _sign in (("Left", 1.0), ("Right", -1.0)):
    for _name, (_parent, (_x, _y, _z)) in _SIDE.items():
        JOINTS[_side + _name] = (_parent if _parent in _CENTRE else _side + _parent, (_sign * _x, _y, _z))


@cache
def builtin_mannequin() -> Character:
    """A closed, skinned mannequin in an A-pose that faces +Z, soles on y = 0, with its clips.

    Clips: `walk` at 1.2 m/s, `slow_walk` at 0.6 m/s, `turn` (steps round on the spot, both ways), `twirl` (spins on the
    balls of the feet and stops) and `sway` (hips and trunk over feet that stand). All start standing.
    """
    with np.load(DATA / "mannequin.npz", allow_pickle=False) as data:
        vertices = data["vertices"].astype(np.float64)
        faces = data["faces"].astype(np.int32)
        indices = data["joint_indices"].astype(np.int32)
        weights = (data["joint_weights"].astype(np.float64) / 65535.0).astype(np.float32)
    names = list(JOINTS)
    places = np.array([place for _, place in JOINTS.values()])
    parents = np.array([-1 if parent is None else names.index(parent) for parent, _ in JOINTS.values()], dtype=np.int32)
    offsets = places - np.where(parents[:, None] < 0, 0.0, places[parents])
    inverse_bind = np.tile(np.eye(4), (len(names), 1, 1))
    inverse_bind[:, :3, 3] = -places
    rotation = np.tile([0.0, 0.0, 0.0, 1.0], (len(names), 1))
    still = Character(
        name="mannequin",
        vertices=vertices,
        faces=faces,
        joint_names=tuple(names),
        joint_parents=parents,
        joint_indices=indices,
        joint_weights=weights,
        rest_local=(offsets, rotation, np.ones((len(names), 3))),
        inverse_bind=inverse_bind,
        root_transform=np.eye(4),
    )
    figure = Figure(still)
    still.clips.update({name: _clip(figure, name, plan) for name, plan in _plans().items()})
    return still


def _clip(figure: Figure, name: str, plan: Plan) -> Clip:
    return figure.clip(curves_of(figure, plan), name, FRAME_RATE)


def _plans() -> dict[str, Plan]:
    return {
        "walk": _walk(1.2, 8.0),
        "slow_walk": _walk(0.6, 8.0),
        "turn": _turn(),
        "twirl": _twirl(),
        "sway": _sway(),
    }


def _walk(speed: float, duration: float) -> Plan:
    plan = Plan.standing(duration)
    plan.speed[:] = smooth(np.where(plan.times > 0.7, speed, 0.0), 0.2)
    return plan


def _turn() -> Plan:
    """Once round to the left in 3 s, a pause, and back."""
    plan = Plan.standing(8.0)
    t = plan.times
    rate = 2.0 * np.pi / 3.0
    plan.yaw_rate[:] = smooth(rate * ((t > 0.6) & (t < 3.6)) - rate * ((t > 4.4) & (t < 7.4)), 0.1)
    return plan


def _twirl() -> Plan:
    """One and a half turns on the balls of the feet to the left, a sudden stop, and back."""
    plan = Plan.standing(6.0)
    t = plan.times
    rate = 3.0 * np.pi / 1.5
    plan.yaw_rate[:] = smooth(rate * ((t > 0.8) & (t < 2.3)) - rate * ((t > 3.5) & (t < 5.0)), 0.08)
    plan.spins += [Spin(0.55, 2.6), Spin(3.25, 5.3)]
    spinning = smooth(((t > 0.7) & (t < 2.2) | (t > 3.4) & (t < 4.9)).astype(float), 0.15)
    plan.arms[:, :, 1] += np.radians(32.0) * spinning
    plan.arms[:, :, 0] += np.radians(12.0) * spinning
    plan.arms[:, :, 2] += np.radians(20.0) * spinning
    return plan


def _sway() -> Plan:
    """The hips swing from side to side and turn, the shoulders stay behind."""
    plan = Plan.standing(8.0)
    t = plan.times
    strength = smooth((t > 0.8).astype(float), 0.25)
    beat, twist = np.sin(2.0 * np.pi * 0.55 * t), np.sin(2.0 * np.pi * 0.8 * t + 0.6)
    plan.shift[:, 0] = 0.07 * strength * beat
    plan.pelvis[:, 2] = 0.13 * strength * beat
    plan.trunk[:, 2] = -0.20 * strength * beat
    plan.pelvis[:, 1] = 0.40 * strength * twist
    plan.trunk[:, 1] = -0.55 * strength * twist
    plan.squat[:] = strength * (0.03 + 0.02 * np.cos(2.0 * np.pi * 1.1 * t))
    plan.arms[:, :, 0] += np.radians(15.0) * strength[None] * np.stack([twist, -twist])
    plan.arms[:, :, 1] += np.radians(14.0) * strength
    plan.arms[:, :, 2] += np.radians(25.0) * strength
    return plan
