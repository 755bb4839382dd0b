"""What all float64 solvers share: the call, the frame cut into substeps, held vertices, air, contact, failure."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pbd.arrays import floats, numbers
from pbd.contact.colliders import Colliders
from pbd.errors import InputError
from pbd.model import Model
from pbd.models.elements import Sum
from pbd.models.friction import FrictionElements
from pbd.models.newton import StepError
from pbd.models.obstacles import Obstacles
from pbd.state import State
from pbd.xpbd.solver import AIR_DENSITY, Solver
from pbd.xpbd.state_summary import StateSummary

__all__ = ["ClothSolver", "Options"]

ROUNDED = 2.5e-7  # what float32 loses within 2 m of an origin, should that move [m]
MAX_SPEED = 1000.0  # a faster vertex has been thrown, not moved [m/s]


@dataclass(frozen=True)
class Options:
    """Options of the float64 solvers; each reads those that concern it.

    Attributes:
        substep: longest substep [s]; None takes the solver's own (explicit ones ask the mesh for the longest stable).
        gravity: [m/s2].
        iterations: passes or Newton steps a substep; None takes the solver's own.
        tolerance: last move of a vertex with which Newton's method is content, over the mean edge [-].
        bend_poisson: Poisson ratio of bending, for models that have one [-].
    """

    substep: float | None = None
    gravity: tuple[float, float, float] = (0.0, -9.81, 0.0)
    iterations: int | None = None
    tolerance: float = 1e-7
    bend_poisson: float = 0.0

    def __post_init__(self) -> None:
        problems = []
        for name, value in (("substep", self.substep), ("iterations", self.iterations), ("tolerance", self.tolerance)):
            if value is not None and not (np.isfinite(value) and value > 0):
                problems.append(InputError("bad option", key=name, received=value, expected="a finite number above 0"))
        try:
            floats(self.gravity, "gravity", (3,), "bad gravity", unit=" [m/s2]")
        except InputError as error:
            problems.append(error)
        if not -1.0 < self.bend_poisson < 1.0:
            expected = "between -1 and 1"
            problems.append(InputError("bad ratio", key="bend_poisson", received=self.bend_poisson, expected=expected))
        if problems:
            raise InputError.join(problems)


class ClothSolver(ABC):
    """Steps the garment of one model; takes the place of :class:`pbd.Solver`.

    It keeps float64 positions and velocities of its own. As long as the state holds what was last written to it, the
    next step goes on from those; what was changed, or another state, is taken over.

    Args:
        model: the garment. Tethers and ``compression_compliance_scale`` belong to the default solver and are
            left out.
        energy: the cloth's.
        options: see :class:`Options`.
        name: in messages.

    Attributes:
        position, velocity: after the last step, world [m], [m/s], float64, shape (n, 3).
        energy: the cloth's.
    """

    substep = 1.0 / 240.0  # [s]

    def __init__(self, model: Model, energy: Sum, options: Options, name: str) -> None:
        self.model, self.energy, self.options, self.name = model, energy, options, name
        self.free = np.flatnonzero(model.inverse_mass > 0.0)
        self.mass = model.mass[:, None]
        self.gravity = np.array(options.gravity, float)
        self.edge = float(model.mesh.edge_lengths()[1].mean())
        self.position, self.velocity = np.zeros((2, model.vertex_count, 3))
        self._friction = [part for part in energy.parts if isinstance(part, FrictionElements)]
        self._drag = 0.5 * AIR_DENSITY * model.fabric.air_drag * model.mesh.vertex_areas / model.mass
        self._written: tuple[np.ndarray, np.ndarray] | None = None
        self._last_h = 0.0
        self._summary = StateSummary()
        if options.substep is not None:
            self.substep = options.substep

    def step(
        self,
        state: State,
        colliders: Colliders,
        dt: float,
        targets: np.ndarray | None = None,
        wind: tuple[float, float, float] | np.ndarray = (0.0, 0.0, 0.0),
    ) -> None:
        """Advance the state in place; the arguments are those of :meth:`pbd.Solver.step`.

        Raises:
            InputError: dt below zero or not finite, a state of another model or not finite, bad targets or wind, or
                a body.
            StepError: the step came to no valid end; the state is as it was.
        """
        self._check(state, dt, targets, wind)
        if dt == 0:
            return
        self._take(state)
        substeps = max(1, int(np.ceil(dt / self.substep - 1e-6)))
        h = dt / substeps
        if abs(h - self._last_h) > 1e-9 * h:
            self.forget()
        self._last_h = h
        rows = Obstacles.of_frame(colliders, state.origin)
        held = self.model.held
        first, last = self.position[held], self.position[held] if targets is None else np.asarray(targets, float)
        x, v = self.position.copy(), self.velocity.copy()
        for part in self._friction:
            part.plastic = getattr(state, part.stored).reshape(len(self.model.mesh.faces), -1)[part.faces].astype(float)
        for s in range(1, substeps + 1):
            obstacles = Obstacles(rows, (s - 1) / substeps, s / substeps, self.model.fabric.thickness)
            target = first + s / substeps * (last - first)
            try:
                x, v = self.advance(x, v, h, target, obstacles, np.asarray(wind, float))
                self._check_result(x, v)
                self._slip(x)
            except StepError as error:
                self._written = None
                raise StepError(f"{error.problem} (substep {s} of {substeps})", self.name) from error
        self.position, self.velocity = x, v
        state.position[:, :3] = x - state.origin
        state.velocity[:] = v
        for part in self._friction:
            getattr(state, part.stored).reshape(len(self.model.mesh.faces), -1)[part.faces] = part.plastic
        self._written = state.world(), state.velocity.copy()

    @abstractmethod
    def advance(
        self,
        x: np.ndarray,
        v: np.ndarray,
        h: float,
        target: np.ndarray,
        obstacles: Obstacles,
        wind: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities after a substep.

        Args:
            x, v: at its start, world [m], [m/s], shape (n, 3).
            h: its length [s].
            target: held vertices at its end [m], shape (p, 3).
            obstacles: at its start and end.
            wind: velocity of the air [m/s], shape (3,).

        Raises:
            StepError: it came to no valid end.
        """

    def _slip(self, x: np.ndarray) -> None:
        """Elements of internal friction follow the cloth."""
        if self._friction:
            points = self.energy.completed(x)
            for part in self._friction:
                part.slip(points)

    def forget(self) -> None:
        """Drop what was kept from earlier substeps: the state, or the length of a substep, has changed."""
        return

    def external(self, x: np.ndarray, v: np.ndarray, h: float, wind: np.ndarray) -> np.ndarray:
        """Acceleration by gravity and air over a substep [m/s2], shape (n, 3).

        Air acts along the surface's normal and is bounded at any step, as in
        :func:`pbd.xpbd.constraints.drag_velocity`: first order in h.
        """
        corners = x[self.model.mesh.faces]
        face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        around = self.model.mesh.faces.ravel()
        normal = np.stack([np.bincount(around, np.repeat(face[:, c], 3), len(x)) for c in range(3)], axis=1)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-20)
        along = np.einsum("ni,ni->n", v - wind, normal)
        slowing = self._drag * np.abs(along)
        return self.gravity - normal * (along * slowing / (1.0 + h * slowing))[:, None]

    def correct(
        self, x: np.ndarray, v: np.ndarray, start: np.ndarray, h: float, obstacles: Obstacles
    ) -> tuple[np.ndarray, np.ndarray]:
        """Contact by position, for solvers without forces of contact."""
        moved = obstacles.correction(x, start, self.free, self.model.fabric.friction, h)
        return x + moved, v + moved / h

    def _take(self, state: State) -> None:
        """Positions and velocities from the state, where they are not what was written to it."""
        place, velocity = self._written or (None, None)
        if place is None or np.abs(state.world() - place).max() > ROUNDED:
            self.position = state.world()
            self.forget()
        if velocity is None or np.any(state.velocity != velocity):
            self.velocity = state.velocity.astype(float)
            self.forget()

    def _check(self, state: State, dt: float, targets: np.ndarray | None, wind: Sequence[float] | np.ndarray) -> None:
        count, held = self.model.vertex_count, len(self.model.held)
        if floats(dt, "dt", (), "bad time step", unit=" [s]") < 0:
            raise InputError("bad time step", key="dt", received=dt, expected="a finite number, at least 0 [s]")
        for name, width in (("position", 4), ("velocity", 3)):
            numbers(getattr(state, name), f"state.{name}", (count, width), "state of another model")
        for name in {part.stored for part in self._friction}:
            faces, found = len(self.model.mesh.faces), len(getattr(state, name))
            if found != faces:
                raise InputError("state of another model", key=f"state.{name}", received=found, expected=str(faces))
        if not (np.isfinite(state.position).all() and np.isfinite(state.velocity).all()):
            raise InputError("state is not finite", key="state", expected="finite positions and velocities")
        if targets is not None:
            floats(targets, "targets", (held, 3), "bad targets", unit=" [m]")
        floats(wind, "wind", (3,), "bad wind", unit=" [m/s]")

    def _check_result(self, x: np.ndarray, v: np.ndarray) -> None:
        if not (np.isfinite(x).all() and np.isfinite(v).all()):
            raise StepError("positions or velocities are not finite")
        fastest = float(np.linalg.norm(v[self.free], axis=1).max(initial=0.0))
        if fastest > MAX_SPEED:
            raise StepError(f"unstable: a vertex at {fastest:.3g} m/s")

    follow = Solver.follow
