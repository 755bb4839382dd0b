"""Other engines as methods of a comparison: by their packages' names, on scenes without colliders and moved clamps."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from pbd import InputError, Model
from precompute.method_comparison.engines import ENGINES
from precompute.solver_scenes import SolverScene

__all__ = ["BASELINES", "start_baseline"]

BLENDER = 160.0  # its stiffness for E h = 1e5 N/m at 64 by 64; it has no unit that would give it for another fabric
SPRING = 0.75  # stiffness of an edge over E h, as in the square lattice of natural lengths


@dataclass(frozen=True)
class _Baseline:
    """An engine.

    Attributes:
        engine: key of :data:`precompute.method_comparison.engines.ENGINES`.
        options: of its start, from E h [N/m], substeps and passes.
    """

    engine: str
    options: Callable[[float, int, int], Mapping[str, Any]]


BASELINES = MappingProxyType({
    "newton": _Baseline("Newton XPBD", lambda modulus, n, k: {"substeps": n, "stiffness": SPRING * modulus}),
    "pypbd": _Baseline("PositionBasedDynamics", lambda modulus, n, k: {"substeps": n}),
    "bpy": _Baseline("Blender", lambda modulus, n, k: {"steps": n, "stiffness": BLENDER}),
    "mujoco": _Baseline("MuJoCo, elastic", lambda modulus, n, k: {"young": modulus / 1e-3, "iterations": k}),
    "pybullet": _Baseline("PyBullet", lambda modulus, n, k: {"substeps": n, "stiffness": SPRING * modulus}),
})  # fmt: skip


def start_baseline(
    name: str, model: Model, substeps: int | None, passes: int | None
) -> tuple[Callable[[], None], Callable[[], np.ndarray]]:
    """An engine on a scene: functions that advance it by a frame of 1/60 s and give its vertices [m], shape (n, 3).

    Bending and air are left out; `mujoco` takes one step a frame and reads passes, the others read substeps.

    Raises:
        InputError: the engine is not installed.
    """
    baseline = BASELINES[name]
    engine = ENGINES[baseline.engine]
    if importlib.util.find_spec(engine.module) is None:
        raise InputError("not installed", key="--methods", received=name, expected="pip install 'gube[rivals]'")
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    fabric = model.fabric
    modulus = float(np.sqrt(fabric.stretch_warp * fabric.stretch_weft))
    scene = SolverScene(name, model, np.array([0.0, 0.0, 1.0]))
    return engine.start(scene, **baseline.options(modulus, substeps or 20, passes or 100))
