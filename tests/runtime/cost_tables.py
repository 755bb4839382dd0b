"""A front that was not measured, and how a garment is seen by a camera before it."""

from __future__ import annotations

import numpy as np

from assets.io.scene import CameraSettings
from runtime.detail.cost_table import CostTable, Setting
from runtime.detail.planner import ViewSize, sight_of
from runtime.play.level_of_detail import LevelOfDetail

__all__ = ["made_front", "seen"]


def made_front(count: int = 60, seed: int = 0) -> CostTable:
    """Costs over more than a decade, errors that fall with them, with scatter."""
    rng = np.random.default_rng(seed)
    settings = [Setting(LevelOfDetail(1, 12, 48, 1), 1.0, 1.0, (0.0, 0.0))]
    for k in range(1, count):
        every = int(rng.choice([1, 2, 4]))
        cost = 10.0 ** -(1.4 * k / count)
        error = 0.03 * (k / count) ** 2 * 10.0 ** rng.uniform(-0.3, 0.3)
        detail = LevelOfDetail(every, 1 + k % 12, 48 * (k % 2), k % 3)
        settings.append(Setting(detail, cost, (0.9 * every if every > 1 else 1.0) * cost, (error, 1.5 * error)))
    return CostTable("cloak", "made up", "none", 0.8, (0.5, 2.0), tuple(settings))


def seen(distance: float, speed: float = 1.0, size: float = 0.8) -> ViewSize:
    """A garment of that size [m] on the axis of one camera, at a distance [m]."""
    return sight_of([CameraSettings(position=(0.0, 0.0, distance), target=(0.0, 0.0, 0.0))], (0, 0, 0), size, speed)
