"""A specimen of cloth in a physics test: mesh, solver, damped motion to rest, load cells."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from scipy.spatial import cKDTree

from pbd import ClothMesh, Colliders, Fabric, Model, SolverOptions, State, build_model
from pbd.models import AnySolver, Options, make_solver
from pbd.models.integrators import ExplicitSolver, NewtonSolver, QuasiStatic, SymplecticEuler
from precompute.experiment.measures import FRAME_RATE, GRAVITY, TimedSteps, typical_ms
from precompute.experiment.sheets import hinge_factor, level, triangulated, untethered

__all__ = [
    "FABRIC",
    "Curve",
    "TrialResult",
    "Specimen",
    "TrialSetting",
    "Trial",
    "disc",
    "strip",
]

EQUILIBRIA = 5  # frames that a solver without time is given to settle
FABRIC = Fabric(air_drag=0.0)  # of every test that says nothing else
RELEASE_S = 1e-6  # step in which a load cell sees the released cloth gain momentum [s]
CLEARANCE = 0.6  # lattice points stand this far from the border, and from given points [edges]


@dataclass(frozen=True)
class TrialSetting:
    """Solver and resolution of a test.

    Attributes:
        solver: name in :data:`pbd.models.SOLVERS`.
        substeps: of a frame of 1/60 s; the default solver's own if not given. See :attr:`fixed`.
        edges: along the length.
    """

    solver: str = "default"
    substeps: int = round(1.0 / (FRAME_RATE * SolverOptions().substep))
    edges: int = 20

    @property
    def timeless(self) -> bool:
        """Whether a step is an equilibrium."""
        return self.solver.endswith("quasi-static")

    @property
    def fixed(self) -> bool:
        """Whether substeps mean nothing to it: an equilibrium, or steps as long as is stable."""
        return self.timeless or self.solver.endswith(("verlet", "symplectic-euler"))

    @property
    def bend_poisson(self) -> float | None:
        """Poisson's ratio of bending that the solver has of its own, None where its hinges' mesh decides."""
        return 0.0 if self.solver.startswith("fem") and "+" not in self.solver else None

    def solver_for(self, model: Model, gravity: tuple[float, float, float]) -> AnySolver:
        """The solver for a model; raises :class:`pbd.InputError` where it cannot take the mesh."""
        substep = None if self.fixed and not self.timeless else 1.0 / (FRAME_RATE * self.substeps)
        return make_solver(self.solver, model, Options(substep, gravity))


@dataclass(frozen=True)
class Curve:
    """A measured curve and its reference, each x and y."""

    x_label: str
    y_label: str
    reference: tuple[np.ndarray, np.ndarray]
    measured: tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class TrialResult:
    """The result of one run of a test.

    Attributes:
        reference, measured: in the test's unit.
        error: compared with the gates: relative, or absolute in the test's unit.
        cost_ms: processor time of a frame of 1/60 s, median [ms].
        curve: for the picture.
        realtime_error: compared with the gate of the default solver, where that is another error.
        missing: why nothing could be measured, at any setting; empty where something was.
        figures: more figures by name, with their unit.
        picture: of the result beside its reference, uint8, shape (height, width, 3).
    """

    reference: float
    measured: float
    error: float
    cost_ms: float
    curve: Curve | None = None
    realtime_error: float | None = None
    missing: str = ""
    figures: Mapping[str, float] = field(default_factory=dict)
    picture: np.ndarray | None = None

    @classmethod
    def relative(cls, reference: float, measured: float, cost_ms: float, curve: Curve | None = None) -> TrialResult:
        return cls(reference, measured, abs(measured / reference - 1.0), cost_ms, curve)

    @classmethod
    def lost(cls, missing: str = "") -> TrialResult:
        """Of a run in which a step failed, or, with a reason, of what cannot be measured."""
        return cls(math.nan, math.nan, math.nan, math.nan, missing=missing)


@dataclass(frozen=True)
class Specimen:
    """A flat piece of cloth: places along and across it [m], shape (n, 2), and faces."""

    flat: np.ndarray
    faces: np.ndarray
    edge: float


def strip(length: float, width: float, edges: int, clamp: int = 1, *, angle: float = 0.0) -> Specimen:
    """A strip from x = 0 to ``length``, middle at y = 0, with ``clamp`` rows of edges before its start.

    Args:
        length, width: [m].
        edges: along the length.
        clamp: rows of edges to be held before x = 0.
        angle: of the mesh against the strip [rad].
    """
    edge = length / edges
    across = max(2, round(width / edge))
    y = np.linspace(-0.5 * width, 0.5 * width, across + 1)
    x = edge * np.arange(-clamp, edges + 1)
    sides = [np.stack([np.full_like(y, at), y], axis=1) for at in (x[0], 0.0, length)]
    sides += [np.stack([x, np.full_like(x, at)], axis=1) for at in (y[0], y[-1])]
    inside = lambda p: np.minimum(np.minimum(p[:, 0] - x[0], length - p[:, 0]), 0.5 * width - np.abs(p[:, 1]))  # noqa: E731
    return _filled(np.concatenate(sides), inside, edge, angle)


def disc(radius: float, clamp: float, edges: int) -> Specimen:
    """A disc about the origin with ``edges`` along its radius and a ring of vertices at ``clamp`` [m]."""
    edge = radius / edges
    rings = []
    for size in (radius, clamp):
        turn = 2.0 * math.pi * np.arange(max(6, round(2.0 * math.pi * size / edge)))
        turn = turn / len(turn)
        rings.append(size * np.stack([np.cos(turn), np.sin(turn)], axis=1))
    return _filled(np.concatenate(rings), lambda p: radius - np.linalg.norm(p, axis=1), edge, 0.0)


def _filled(given: np.ndarray, inside: Callable[[np.ndarray], np.ndarray], edge: float, angle: float) -> Specimen:
    """Equilateral triangles within a border whose points are given; Delaunay where the two meet."""
    reach = int(2.0 * np.abs(given).max() / edge) + 2
    i, j = np.meshgrid(np.arange(-reach, reach + 1), np.arange(-reach, reach + 1), indexing="ij")
    lattice = edge * np.stack([math.sqrt(0.75) * i, j + 0.5 * (i % 2)], axis=-1).reshape(-1, 2)
    cosine, sine = math.cos(angle), math.sin(angle)
    lattice = lattice @ np.array([[cosine, sine], [-sine, cosine]])
    given = given[np.unique(np.round(given / edge, 6), axis=0, return_index=True)[1]]
    clear = (inside(lattice) > CLEARANCE * edge) & (cKDTree(given).query(lattice)[0] > CLEARANCE * edge)
    flat = np.concatenate([given, lattice[clear]])
    faces, twice_area = triangulated(flat)
    whole = (twice_area > 1e-3 * edge**2) & (inside(flat[faces].mean(axis=1)) > 0.0)
    return Specimen(flat, faces[whole].astype(np.int32), edge)


@cache
def _bend_factor(angle: float) -> float:
    """Hinge factor of this kind of mesh, measured once on a large sheet."""
    sheet = strip(1.0, 1.0, 30, 0, angle=angle)
    return hinge_factor(sheet.flat, sheet.faces, level(sheet.flat))


@dataclass
class Trial:
    """A specimen of cloth with a solver, in the middle of a test. Without tethers, which are no part of its physics.

    Attributes:
        specimen: the cloth.
        vertices: where it starts [m], shape (n, 3).
        fabric: SI values.
        held: vertices moved from outside, bool or int.
        setting: solver, substeps, edges.
        gravity: [m/s2].
        warp: direction of the warp against the specimen's x [rad].
        colliders: what it touches.
        mesh_angle: as the specimen was made with [rad].
    """

    specimen: Specimen
    vertices: np.ndarray
    fabric: Fabric
    held: np.ndarray
    setting: TrialSetting
    gravity: tuple[float, float, float] = (0.0, -GRAVITY, 0.0)
    warp: float = 0.0
    colliders: Colliders = field(default_factory=Colliders)
    mesh_angle: float = 0.0

    def __post_init__(self) -> None:
        cosine, sine = math.cos(self.warp), math.sin(self.warp)
        pattern = self.specimen.flat @ np.array([[cosine, -sine], [sine, cosine]])
        mesh = ClothMesh.from_pattern(self.vertices, self.specimen.faces, pattern[self.specimen.faces])
        held = np.flatnonzero(self.held) if np.asarray(self.held).dtype == bool else np.asarray(self.held, int)
        self.model = untethered(mesh, self.fabric, held, bend_factor=_bend_factor(self.mesh_angle))
        self.solver = self.setting.solver_for(self.model, self.gravity)
        self.state = State.at_rest(self.model)
        self._steps = TimedSteps(self.solver.step, ())

    def frame(self, targets: np.ndarray | None = None, *, dt: float = 1.0 / FRAME_RATE) -> None:
        """One frame; ``targets``: where the held vertices go [m]."""
        self._steps(self.state, self.colliders, dt, targets)

    def lay(self, places: np.ndarray) -> None:
        """Put the cloth to places [m], shape (n, 3), at rest, and let it come from there to its equilibrium in a frame.

        Held vertices stay there.
        """
        self.state.position[:, :3] = places - self.state.origin
        self.state.velocity[:] = 0.0
        self.frame(places[self.model.held])

    def settle(self, scale: float, limit: float = 40.0, *, still: float = 1e-5) -> None:
        """Run with damping until nothing moves.

        Args:
            scale: a typical time of its motion [s]; speed falls by e^2 in it.
            limit: how many of them at most.
            still: ends where no vertex would go further than this part of the cloth's size in ``scale``.
        """
        size = np.ptp(self.vertices, axis=0).max()
        keep = np.float32(math.exp(-2.0 / (FRAME_RATE * scale)))
        # A quasi-static solver arrives after a frame or two; a sheet that buckles never stops changing its equilibrium.
        frames = EQUILIBRIA if self.setting.timeless else max(10, math.ceil(limit * scale * FRAME_RATE))
        for _ in range(frames):
            last = self.state.position.copy()
            self.frame()
            if self.setting.timeless and np.abs(self.state.position - last).max() < still * size:
                return
            self.state.velocity *= keep
            speed = float(np.abs(self.state.velocity).max())
            if not speed < 1e6:
                return
            if speed * scale < still * size and len(self._steps.times) > 5:
                return

    @property
    def cost_ms(self) -> float:
        """Processor time of a frame, median [ms]."""
        return typical_ms(self._steps.times[1:])

    def world(self) -> np.ndarray:
        """[m], shape (n, 3)."""
        return self.state.world()

    def pull(self, released: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A load cell: the force [N] and moment about the origin [N m] of the clamps on cloth at rest, each shape (3,).

        Some held vertices are released for a microsecond; the momentum that all the cloth gains in it came from the
        clamps that are left. The released clamp bore the opposite.

        Args:
            released: vertices, int.
        """
        held = np.setdiff1d(self.model.held, released)
        if isinstance(self.solver, QuasiStatic):  # it knows the forces themselves
            force = self.solver.energy.gradient(self.solver.position)[held]
            return force.sum(axis=0), np.cross(self.solver.position[held], force).sum(axis=0)
        model = build_model(
            self.model.mesh, self.fabric, held, options=self.model.options, bend_factor=self.model.bend_factor
        )
        state = self.state.copy()
        state.position[:, 3] = model.inverse_mass
        state.velocity[:] = 0.0
        solver = make_solver(self.setting.solver, model, Options(RELEASE_S, (0.0, 0.0, 0.0)))
        if isinstance(solver, (ExplicitSolver, NewtonSolver)):  # an integrator's own errors are no forces
            solver = SymplecticEuler(model, solver.energy, solver.options, solver.name)
        solver.step(state, Colliders(), RELEASE_S)
        gained = model.mass[:, None] * state.velocity.astype(float) / RELEASE_S
        gained[held] = 0.0
        return gained.sum(axis=0), np.cross(self.world(), gained).sum(axis=0)
