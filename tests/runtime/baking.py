"""Frames to bake: a sheet that waves, bodies beside it, and what tests measure on them."""

from __future__ import annotations

import math

import numpy as np

from assets.character import Character
from assets.io.sequence import Sequence
from assets.motion import ClipMotion
from assets.procedural.mannequin import builtin_mannequin

__all__ = ["angles_deg", "sheet_sequence", "walking_mannequin", "waving_sheet"]


def waving_sheet(frame_count: int = 12, side: int = 9, turn_deg: float = 20.0) -> tuple[np.ndarray, np.ndarray]:
    """A sheet that waves, turns by ``turn_deg`` a frame and travels: faces (m, 3), frames float32 (f, n, 3)."""
    u, v = (axis.ravel() for axis in np.meshgrid(np.linspace(-0.3, 0.3, side), np.linspace(0.4, 1.0, side)))
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    faces = np.concatenate(
        [np.stack([corner, corner + 1, corner + side], 1), np.stack([corner + 1, corner + side + 1, corner + side], 1)]
    )
    frames = np.zeros((frame_count, side * side, 3), np.float32)
    for k in range(frame_count):
        angle = math.radians(turn_deg) * k
        depth = 0.05 * np.sin(20 * u + 0.7 * k)
        frames[k, :, 0] = u * math.cos(angle) + depth * math.sin(angle) + 0.8 * k
        frames[k, :, 1] = v
        frames[k, :, 2] = -u * math.sin(angle) + depth * math.cos(angle) - 0.3 * k
    return faces, frames


def sheet_sequence(count: int = 12) -> tuple[np.ndarray, np.ndarray, Sequence]:
    """The waving sheet, and another that is its body."""
    faces, frames = waving_sheet(count)
    return faces, frames, Sequence("sheet", frames[:, :, ::-1].copy(), faces.astype(np.int32), 1 / 30)


def walking_mannequin(count: int = 12) -> tuple[Character, np.ndarray]:
    body = builtin_mannequin()
    motion = ClipMotion(body, body.clip("walk"))
    return body, np.array([motion.pose(1.5 + k / 30.0) for k in range(count)])


def angles_deg(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.degrees(2.0 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=-1) / 2.0, 0.0, 1.0)))
