"""What tests of models share: a sheet, finite differences, and integrators of one energy."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pbd import Fabric, Model
from pbd.models import ClothSolver, Options, cloth_energy
from pbd.models.integrators import BDF2, ImplicitEuler, Midpoint, SymplecticEuler, Verlet
from tests.pbd.meshes import cloth, free_model, grid

__all__ = ["FABRIC", "INTEGRATORS", "differences", "integrated", "sheet"]

FABRIC = Fabric(stretch_warp=900.0, stretch_weft=500.0, poisson=0.3, shear=200.0, bend_warp=3e-3, bend_weft=1e-3)
INTEGRATORS = {
    "symplectic-euler": SymplecticEuler,
    "verlet": Verlet,
    "midpoint": Midpoint,
    "implicit-euler": ImplicitEuler,
    "bdf2": BDF2,
}


def sheet(kind: str = "alternating", across: int = 3) -> Model:
    """Four by ``across`` squares of 5 cm, cut in two as :func:`grid` says."""
    return free_model(cloth(*grid(4, across, 0.05, kind)), FABRIC)


def integrated(name: str, model: Model, options: Options | None = None) -> ClothSolver:
    """A key of ``INTEGRATORS`` with the energy that all are tested with: finite elements and their own plate."""
    return INTEGRATORS[name](model, cloth_energy(model, "fem-stvk", "morley"), options or Options(), name)


def differences(function: Callable, x: np.ndarray, step: float) -> np.ndarray:
    """Central differences of fourth order, shape (n, 3, ...)."""
    rows = []
    for place in range(x.size):
        move = np.zeros(x.size)
        move[place] = step
        move = move.reshape(x.shape)
        near = (function(x + move) - function(x - move)) / (2 * step)
        far = (function(x + 2 * move) - function(x - 2 * move)) / (4 * step)
        rows.append((4 * near - far) / 3)
    return np.array(rows)
