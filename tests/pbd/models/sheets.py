"""The sheet on which energies and their matrices are tested."""

from __future__ import annotations

from pbd import Fabric, Model
from tests.pbd.meshes import cloth, free_model, grid

__all__ = ["FABRIC", "sheet"]

FABRIC = Fabric(stretch_warp=900.0, stretch_weft=500.0, poisson=0.3, shear=200.0, bend_warp=3e-3, bend_weft=1e-3)


def sheet(kind: str = "alternating", across: int = 3) -> Model:
    """Four by ``across`` squares of 5 cm, cut in two as :func:`grid` says."""
    return free_model(cloth(*grid(4, across, 0.05, kind)), FABRIC)
