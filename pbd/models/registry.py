"""Every solver by name: ``membrane/integrator``, ``membrane+bending/integrator``, or a method that is both."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from pbd.contact.colliders import Colliders
from pbd.errors import InputError
from pbd.model import Model
from pbd.models.descent import ProjectiveDynamics, VertexBlockDescent
from pbd.models.elements import ElementEnergy, QuadraticElements, Sum
from pbd.models.friction import friction_elements
from pbd.models.integrators import BDF2, ImplicitEuler, Midpoint, QuasiStatic, SymplecticEuler, Verlet
from pbd.models.membrane import Membrane, condition_membrane, continuum_membrane
from pbd.models.plate import angle_bending, isometric_bending, morley_bending
from pbd.models.position_based import PBD, XPBD, StrainBased
from pbd.models.springs import square_springs, triangle_springs
from pbd.models.stepping import Options
from pbd.state import State
from pbd.xpbd.solver import Solver, SolverOptions

__all__ = ["SOLVERS", "AnySolver", "cloth_energy", "make_solver"]

STITCH = 10.0  # stiffness of a stitch over the cloth's E h [-]


class AnySolver(Protocol):
    """The methods that all solvers have."""

    def step(
        self,
        state: State,
        colliders: Colliders,
        dt: float,
        targets: np.ndarray | None = None,
        wind: tuple[float, float, float] | np.ndarray = (0.0, 0.0, 0.0),
    ) -> None:
        """Advance the state in place, see :meth:`pbd.Solver.step`."""
        ...

    def follow(self, state: State, colliders: Colliders) -> np.ndarray:
        """Move the origin to the garment, see :meth:`pbd.Solver.follow`."""
        ...


MEMBRANES: dict[str, Callable[[Model], ElementEnergy]] = {
    "springs-triangle": lambda model: triangle_springs(model.mesh, model.fabric),
    "springs-square": lambda model: square_springs(model.mesh, model.fabric),
    "baraff-witkin": lambda model: condition_membrane(model.mesh, model.fabric),
    "fem-corotational": lambda model: continuum_membrane(model.mesh, model.fabric, "corotational"),
    "fem-stvk": lambda model: continuum_membrane(model.mesh, model.fabric, "stvk"),
}
BENDINGS: dict[str, Callable[[Model, float], list[ElementEnergy]]] = {
    "isometric": lambda model, poisson: [isometric_bending(model)],
    "hinges": lambda model, poisson: angle_bending(model),
    "morley": morley_bending,
}
# Method, membrane and bending of the energy that it minimises, or would: what a row of `gube validate`, the chart of
# `gube compare`, a map of `gube stability` or a scene of `gube bench failures` compares.
METHODS = {
    "springs-triangle/symplectic-euler": (SymplecticEuler, "springs-triangle", "hinges"),
    "springs-square/symplectic-euler": (SymplecticEuler, "springs-square", "hinges"),
    "springs-triangle/implicit-euler": (ImplicitEuler, "springs-triangle", "hinges"),
    "baraff-witkin/implicit-euler": (ImplicitEuler, "baraff-witkin", "hinges"),
    "fem-corotational/quasi-static": (QuasiStatic, "fem-corotational", "morley"),
    "fem-stvk/quasi-static": (QuasiStatic, "fem-stvk", "morley"),
    "fem-stvk/implicit-euler": (ImplicitEuler, "fem-stvk", "morley"),
    "fem-stvk/midpoint": (Midpoint, "fem-stvk", "morley"),
    "fem-stvk/verlet": (Verlet, "fem-stvk", "morley"),
    "fem-stvk+isometric/verlet": (Verlet, "fem-stvk", "isometric"),
    "fem-stvk+isometric/bdf2": (BDF2, "fem-stvk", "isometric"),
    "pbd": (PBD, "springs-triangle", "hinges"),
    "xpbd": (XPBD, "springs-triangle", "hinges"),
    "strain-based": (StrainBased, "baraff-witkin", "hinges"),
    "vertex-block-descent": (VertexBlockDescent, "fem-stvk", "isometric"),
    "projective-dynamics": (ProjectiveDynamics, "fem-corotational", "isometric"),
}


def cloth_energy(model: Model, membrane: str, bending: str, bend_poisson: float = 0.0) -> Sum:
    """Energy of a garment.

    Args:
        model: the garment.
        membrane: a key of ``MEMBRANES``.
        bending: a key of ``BENDINGS``.
        bend_poisson: Poisson ratio of the bending ``morley`` [-].

    Raises:
        InputError: a mesh on which the membrane does not exist, or a fabric that rubs and elements that do not.
    """
    sheet = MEMBRANES[membrane](model)
    parts = [sheet, *BENDINGS[bending](model, bend_poisson), *_stitches(model)]
    if model.plastic_count or model.plastic_shear_count:
        if not (isinstance(sheet, Membrane) and bending == "morley"):
            expected = "hysteresis of 0, the default solver, or a finite-element membrane with its own plate"
            raise InputError("no internal friction", key="solver", received=f"{membrane}+{bending}", expected=expected)
        parts += friction_elements(model, sheet)
    return Sum(parts, model.vertex_count)


def _stitches(model: Model) -> list[ElementEnergy]:
    """Each stitch as a spring without length between a vertex and its point on an edge."""
    mesh, weights = model.mesh, model.mesh.stitch_weights
    if not len(mesh.stitches):
        return []
    row = np.stack([np.ones(len(weights)), weights - 1.0, -weights], axis=1)
    stiffness = STITCH * max(model.fabric.stretch_warp, model.fabric.stretch_weft)
    return [QuadraticElements(mesh.stitches, model.vertex_count, stiffness * row[:, :, None] * row[:, None])]


Factory = Callable[[Model, Options], AnySolver]


def _factory(name: str, solver: Callable[..., AnySolver], membrane: str, bending: str) -> Factory:
    return lambda model, options: solver(
        model, cloth_energy(model, membrane, bending, options.bend_poisson), options, name
    )


def _default(model: Model, options: Options) -> Solver:
    if options.substep is None:
        return Solver(model, SolverOptions(gravity=options.gravity))
    return Solver(model, SolverOptions(substep=options.substep, gravity=options.gravity))


SOLVERS: dict[str, Factory] = {"default": _default} | {name: _factory(name, *parts) for name, parts in METHODS.items()}


def make_solver(name: str, model: Model, options: Options | None = None) -> AnySolver:
    """A solver of ``SOLVERS`` for a garment.

    Raises:
        InputError: no such solver, or a mesh or options that it cannot take.
    """
    if name not in SOLVERS:
        raise InputError("no such solver", key="solver", received=name, expected=", ".join(SOLVERS))
    return SOLVERS[name](model, options or Options())
