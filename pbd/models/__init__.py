"""Every model of cloth beside the default solver's: energies, integrators and position-based methods, in float64."""

from pbd.models.newton import StepError
from pbd.models.registry import SOLVERS, AnySolver, cloth_energy, make_solver
from pbd.models.stepping import ClothSolver, Options

__all__ = ["SOLVERS", "AnySolver", "ClothSolver", "Options", "StepError", "cloth_energy", "make_solver"]
