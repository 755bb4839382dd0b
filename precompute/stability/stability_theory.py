"""What theory says of the maps: the longest explicit step, and the stretch that position-based passes leave."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pbd import Colliders, Fabric, SolverOptions, State, build_model
from pbd.models import Options, StepError, make_solver
from precompute.experiment.measures import GRAVITY
from precompute.stability.stability_maps import DENSITY, EDGES, STIFFNESS, StabilityMap, lattice_model

__all__ = ["StabilityCurve", "ExplicitLimit", "explicit_limit", "explicit_limits", "theory_of"]

# dt = factor d sqrt(rho_A/(E h)) is 2/omega of a lattice of springs (`physics.md`).
MEMBRANE = {"triangles": 0.816, "squares": 0.943}
SPRINGS = {"triangles": "springs-triangle/symplectic-euler", "squares": "springs-square/symplectic-euler"}
LAW_STRETCH = 0.1  # mean stretch at which the law is drawn [-]
XPBD_PASSES = 10  # of XPBD in a step
LIMIT_STEPS = 200  # of a run that looks for a limit
BISECTIONS = 8  # bisections: to 0.3 %
START_SPEED = 1e-6  # speed that it starts with [m/s]


class StabilityCurve(NamedTuple):
    """A line of theory over a map, x and y."""

    label: str
    x: np.ndarray
    y: np.ndarray


class ExplicitLimit(NamedTuple):
    """The longest stable step of a lattice of springs under symplectic Euler.

    Attributes:
        lattice: "triangles" or "squares".
        theory, found: [s].
    """

    lattice: str
    theory: float
    found: float

    @property
    def error_percent(self) -> float:
        return 100.0 * abs(self.found / self.theory - 1.0)


def membrane_limit(lattice: str, edge: float, stiffness: float) -> float:
    """2/omega of a lattice of springs [s]; edge [m], stiffness E h [N/m]."""
    return MEMBRANE[lattice] * edge * math.sqrt(DENSITY / stiffness)


def bending_limit(edge: float, bend: float) -> float:
    """2/omega of bending, d^2/4 sqrt(rho_A/B) [s]; edge [m], B [N m]."""
    return 0.25 * edge**2 * math.sqrt(DENSITY / bend)


def explicit_limits() -> list[ExplicitLimit]:
    """The limit of both lattices."""
    return [explicit_limit(lattice) for lattice in MEMBRANE]


def explicit_limit(lattice: str) -> ExplicitLimit:
    """The limit of a lattice, "triangles" or "squares", by bisection on a sheet with a little noise.

    Its border is held: theory is about lattices without end, and the light vertices of a free border give way before
    it (4 % for triangles, 10 % for squares).
    """
    fabric = Fabric(DENSITY, STIFFNESS, STIFFNESS, 1 / 3, 0.375 * STIFFNESS, 0.0, 0.0, air_drag=0.0)
    sheet, index = lattice_model(1.0, 1.0, EDGES, lattice, fabric)
    border = np.concatenate([index[0], index[-1], index[:, 0], index[:, -1]])
    model = build_model(sheet.mesh, fabric, border, options=sheet.options, bend_factor=sheet.bend_factor)
    theory = membrane_limit(lattice, 1.0 / EDGES, STIFFNESS)
    start = State.at_rest(model)
    start.velocity[:, :2] = START_SPEED * np.random.default_rng(0).normal(size=(model.vertex_count, 2))
    start.velocity[model.held] = 0.0

    def stays(dt: float) -> bool:
        solver = make_solver(SPRINGS[lattice], model, Options(dt, (0.0, 0.0, 0.0)))
        state = start.copy()
        try:
            solver.step(state, Colliders(), LIMIT_STEPS * dt)
        except StepError:
            return False
        return bool(np.abs(state.velocity).max() < 1e3 * START_SPEED)

    low, high = 0.7 * theory, 1.4 * theory
    for _ in range(BISECTIONS):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if stays(middle) else (low, middle)
    return ExplicitLimit(lattice, theory, math.sqrt(low * high))


def theory_of(one: StabilityMap, method: str) -> list[StabilityCurve]:
    """Lines over a map of a method; none where nothing is known."""
    lattice = next((lattice for lattice, name in SPRINGS.items() if name == method), None)
    if lattice is not None:
        return _explicit_curves(one, lattice)
    return _stretch_curves(one, method) if method in ("default", "xpbd") else []


def _explicit_curves(one: StabilityMap, lattice: str) -> list[StabilityCurve]:
    space = np.geomspace if one.x.log else np.linspace
    x, words = space(one.x.values[0], one.x.values[-1], 200), "explicit limit 2/omega"
    if one.name in ("stiffness", "resolution"):
        at = [(1.0 / EDGES, value) if one.name == "stiffness" else (1.0 / value, STIFFNESS) for value in x]
        return [StabilityCurve(words, x, np.array([membrane_limit(lattice, *both) for both in at]))]
    if one.name == "bending":
        edge = 0.3 / EDGES
        membrane = np.full_like(x, membrane_limit(lattice, edge, STIFFNESS))
        bending = np.array([bending_limit(edge, value) for value in x])
        return [StabilityCurve(f"{words}, membrane", x, membrane), StabilityCurve(f"{words}, bending", x, bending)]
    return []


def _stretch_curves(one: StabilityMap, method: str) -> list[StabilityCurve]:
    """Where g h^2 N^2/(2 n L) is ``LAW_STRETCH``: h a substep, n passes in it, N edges along L."""
    label = f"XPBD stretch law, {LAW_STRETCH:.0%}"
    if one.name == "resolution":
        y = np.array(one.y.values)  # a step between these may be split better or worse
        split = np.ceil(y / SolverOptions().substep - 1e-6) if method == "default" else np.ones_like(y)
        passes = 1 if method == "default" else XPBD_PASSES
        return [StabilityCurve(label, np.sqrt(2.0 * passes * LAW_STRETCH / GRAVITY) / (y / split), y)]
    if one.name == "mass":
        # The mean over N edges of the weight below each, the lowest row being x times as heavy.
        x = np.geomspace(one.x.values[0], one.x.values[-1], 200)
        rows = EDGES / math.sqrt(0.75)
        once = GRAVITY / 60.0**2 * rows * (0.5 * rows + x)  # with one pass a frame
        return [StabilityCurve(label, x, np.sqrt(once / LAW_STRETCH) if method == "default" else once / LAW_STRETCH)]
    return []
