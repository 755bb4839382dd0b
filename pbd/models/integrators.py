"""Integrators that run any energy of cloth: three explicit or split, three implicit, one without time."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh

from pbd.model import Model
from pbd.models.elements import Sum
from pbd.models.linear import Cholesky, FreeOrder, NotPositiveDefinite
from pbd.models.newton import StepError, minimise
from pbd.models.obstacles import ContactForces, Cushion, Obstacles
from pbd.models.stepping import ClothSolver, Options

__all__ = [
    "BDF2",
    "ExplicitSolver",
    "ImplicitEuler",
    "Midpoint",
    "NewtonSolver",
    "QuasiStatic",
    "SymplecticEuler",
    "Verlet",
    "highest",
]

STABLE = 0.7  # part of the limit 2/omega that an explicit step takes: cloth stiffens as it stretches
CONTACT_STIFFNESS = 30.0  # r over the mean stiffness that a vertex feels
SETTLED = 1e-4  # contact has settled when no force changes by more than this part of the largest
MIN_CONTACT_SHARE = 0.1  # of Newton's tolerance: a contact that a smaller motion would make is none [-]
SETTLINGS = 100  # rounds of contact at most


def highest(model: Model, energy: Sum) -> float:
    """The cloth's highest angular frequency at the mesh's start positions [1/s].

    Raises:
        StepError: it is not found.
    """
    root = np.where(model.inverse_mass > 0.0, 1.0 / np.sqrt(model.mass), 0.0)[:, None]
    stiffness = energy.hessian(model.mesh.vertices, positive=True)

    def scaled(column: np.ndarray) -> np.ndarray:
        moved = energy.completed(root * column.reshape(-1, 3))  # hidden points follow linearly
        return (root * (stiffness @ moved.ravel()).reshape(-1, 3)[: len(root)]).ravel()

    operator = LinearOperator((3 * len(root), 3 * len(root)), scaled, dtype=float)
    start = np.random.default_rng(0).normal(size=3 * len(root))
    try:
        (value,) = eigsh(operator, 1, which="LA", v0=start, return_eigenvectors=False, tol=1e-3)
    except ArpackError as error:
        raise StepError(f"highest frequency not found: {error}") from error
    return float(np.sqrt(max(value, 0.0)))


class ExplicitSolver(ClothSolver):
    """Forces at known positions only: stable below dt = 2/omega, where omega is the cloth's highest frequency.

    Args:
        model, energy, options, name: see :class:`ClothSolver`. Without a substep of the user's the mesh's own limit
            gives it.
    """

    def __init__(self, model: Model, energy: Sum, options: Options, name: str) -> None:
        super().__init__(model, energy, options, name)
        if options.substep is None:
            self.substep = STABLE * 2.0 / highest(model, energy)
        self._accelerations: np.ndarray | None = None

    def forget(self) -> None:
        self._accelerations = None

    def acceleration(self, x: np.ndarray, v: np.ndarray, h: float, wind: np.ndarray) -> np.ndarray:
        """[m/s2], shape (n, 3); zero at held vertices."""
        acceleration = np.zeros_like(x)
        force = self.external(x, v, h, wind) - self.energy.gradient(x) / self.mass
        acceleration[self.free] = force[self.free]
        return acceleration

    def finish(
        self, x: np.ndarray, v: np.ndarray, start: np.ndarray, h: float, target: np.ndarray, obstacles: Obstacles
    ) -> tuple[np.ndarray, np.ndarray]:
        """Held vertices and contact."""
        held = self.model.held
        x[held], v[held] = target, (target - start[held]) / h
        return self.correct(x, v, start, h, obstacles)


class SymplecticEuler(ExplicitSolver):
    """v' = v + h a(x), x' = x + h v': first order, keeps energy within bounds."""

    def advance(
        self, x: np.ndarray, v: np.ndarray, h: float, target: np.ndarray, obstacles: Obstacles, wind: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        faster = v + h * self.acceleration(x, v, h, wind)
        return self.finish(x + h * faster, faster, x, h, target, obstacles)


class Verlet(ExplicitSolver):
    """Velocity Verlet: v and x by half a step each way, second order."""

    def advance(
        self, x: np.ndarray, v: np.ndarray, h: float, target: np.ndarray, obstacles: Obstacles, wind: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        now = self.acceleration(x, v, h, wind) if self._accelerations is None else self._accelerations
        half = v + 0.5 * h * now
        there, half = self.finish(x + h * half, half, x, h, target, obstacles)
        self._accelerations = self.acceleration(there, half, h, wind)
        return there, half + 0.5 * h * self._accelerations


class _Motion:
    """What an implicit step minimises: |x - x~|^2_M/(2 s^2) + E(x) + contact; without time, E(x) - f.x + contact."""

    def __init__(
        self, energy: Sum, mass: np.ndarray, aim: np.ndarray, inverse_square: float, contact: ContactForces | None
    ) -> None:
        self.cloth, self.contact = energy, contact
        self.weight, self.aim = mass * inverse_square, aim
        self._diagonal = diags(np.repeat(self.weight[:, 0], 3))

    def energy(self, x: np.ndarray) -> float:
        value = 0.5 * float((self.weight * (x - self.aim) ** 2).sum()) + self.cloth.energy(x)
        return value if self.contact is None else value + self.contact.energy(x)

    def gradient(self, x: np.ndarray) -> np.ndarray:
        gradient = self.weight * (x - self.aim) + self.cloth.gradient(x)
        return gradient if self.contact is None else gradient + self.contact.gradient(x)

    def hessian(self, x: np.ndarray, positive: bool = False) -> csr_matrix:
        hessian = self.cloth.hessian(x, positive) + self._diagonal
        return hessian if self.contact is None else hessian + self.contact.hessian(x)


class _Weighed(_Motion):
    """The same without inertia, under weight."""

    def __init__(self, energy: Sum, weight: np.ndarray, contact: ContactForces | None) -> None:
        super().__init__(energy, np.zeros_like(weight[:, :1]), np.zeros_like(weight), 1.0, contact)
        self.force = weight

    def energy(self, x: np.ndarray) -> float:
        return super().energy(x) - float((self.force * x).sum())

    def gradient(self, x: np.ndarray) -> np.ndarray:
        return super().gradient(x) - self.force


class NewtonSolver(ClothSolver):
    """Shared by all that solve for the positions at a substep's end."""

    default_iterations = 100

    def __init__(self, model: Model, energy: Sum, options: Options, name: str) -> None:
        super().__init__(model, energy, options, name)
        self.hidden = np.arange(model.vertex_count, energy.point_count)
        self.order = FreeOrder(energy.parts, np.concatenate([self.free, self.hidden]))
        self.iterations = options.iterations or self.default_iterations
        self._touching: tuple[np.ndarray, np.ndarray] | None = None

    def forget(self) -> None:
        self._touching = None

    def solved(
        self, x: np.ndarray, start: np.ndarray, aim: np.ndarray, s: float, h: float, obstacles: Obstacles | None
    ) -> np.ndarray:
        """Positions that minimise the motion's objective, with contact settled.

        Args:
            x: where to begin; held vertices are where they belong [m], shape (n, 3).
            start: positions at the substep's start [m], shape (n, 3).
            aim: x~ [m]; the weight of the vertices [N] where s is infinite.
            s: step of the formula [s].
            h: substep [s].
            obstacles: None leaves contact out.

        Raises:
            StepError: no minimum, or contact does not settle.
        """
        inverse_square, still = 1.0 / s**2, np.isinf(s)
        count, none = len(x), np.zeros((len(self.hidden), 3))
        mass, aim = np.concatenate([self.mass, none[:, :1]]), np.concatenate([aim, none])
        x, contact = self.energy.completed(x), None
        if obstacles is not None and len(obstacles.kinds):
            start = self.energy.completed(start)
            diagonal = self.energy.hessian(start).diagonal().reshape(-1, 3).mean(axis=1)
            stiffness = CONTACT_STIFFNESS * (mass[:, 0] * inverse_square + np.maximum(diagonal, 0.0))
            contact = ContactForces(
                obstacles, start, self.free, stiffness, self.model.fabric.friction, h, self._touching, self._cushion()
            )
        objective = (
            _Weighed(self.energy, aim, contact) if still else _Motion(self.energy, mass, aim, inverse_square, contact)
        )
        content = np.full(len(x), self.options.tolerance * self.edge)
        tolerance, least = content, MIN_CONTACT_SHARE * self.options.tolerance * self.edge
        for _ in range(SETTLINGS):
            x = minimise(objective, x, self.order, tolerance, self.iterations)
            if contact is None:
                return x[:count]
            error = contact.update(x, least)
            # Positions must be as sharp as the forces that they make.
            tolerance = np.minimum(content, 0.1 * SETTLED * contact.reach(least))
            if error <= SETTLED:
                self._touching = contact.memory
                return x[:count]
        raise StepError(f"contact does not settle in {SETTLINGS} rounds")

    def _cushion(self) -> Cushion | None:
        """Of a fabric whose thickness gives."""
        fabric = self.model.fabric
        if fabric.compression == 0.0:
            return None
        area = np.zeros((len(self.mass) + len(self.hidden), 1))
        area[: len(self.mass), 0] = self.model.mesh.vertex_areas
        return Cushion(fabric.compression, fabric.thickness, area)


class ImplicitEuler(NewtonSolver):
    """x' = x + h v', v' = v + h a(x'): first order, stable, loses energy (1/sqrt(1 + z^2) a step, z = omega h)."""

    def advance(
        self, x: np.ndarray, v: np.ndarray, h: float, target: np.ndarray, obstacles: Obstacles, wind: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        aim = x + h * v + h**2 * self.external(x, v, h, wind)
        there = self.solved(_put(x + h * v, self.model.held, target), x, aim, h, h, obstacles)
        return there, (there - x) / h


class BDF2(NewtonSolver):
    """Second backward difference: x' = (4 x - x_-1)/3 + 2h/3 v', the same for v. Second order, stable, loses little.

    The first substep is implicit Euler's.
    """

    def __init__(self, model: Model, energy: Sum, options: Options, name: str) -> None:
        super().__init__(model, energy, options, name)
        self._last: tuple[np.ndarray, np.ndarray] | None = None

    def forget(self) -> None:
        super().forget()
        self._last = None

    def advance(
        self, x: np.ndarray, v: np.ndarray, h: float, target: np.ndarray, obstacles: Obstacles, wind: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        base, speed, s = x, v, h
        if self._last is not None:
            base, speed, s = (4.0 * x - self._last[0]) / 3.0, (4.0 * v - self._last[1]) / 3.0, 2.0 * h / 3.0
        aim = base + s * speed + s**2 * self.external(x, v, h, wind)
        there = self.solved(_put(x + h * v, self.model.held, target), x, aim, s, h, obstacles)
        self._last = x, v
        return there, (there - base) / s


class Midpoint(NewtonSolver):
    """Implicit midpoint rule: half a step of implicit Euler, then as far again. Second order, loses nothing.

    Contact is put right by position at the end of the substep.
    """

    def advance(
        self, x: np.ndarray, v: np.ndarray, h: float, target: np.ndarray, obstacles: Obstacles, wind: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        s, held = 0.5 * h, self.model.held
        aim = x + s * v + s**2 * self.external(x, v, h, wind)
        middle = self.solved(_put(x + s * v, held, 0.5 * (x[held] + target)), x, aim, s, h, None)
        there, speed = 2.0 * middle - x, 2.0 * (middle - x) / s - v
        speed[held] = (target - x[held]) / h
        return self.correct(there, speed, x, h, obstacles)


class QuasiStatic(NewtonSolver):
    """Equilibrium under gravity and contact, by Newton's method with a line search. Time does not count.

    A step moves held vertices and obstacles and finds the equilibrium that lies downhill. Wind is left out.

    Attributes:
        stable: whether the last equilibrium is a strict minimum. One that is not, such as a strip past its buckling
            load that is still straight, is an answer but not what cloth would do.
    """

    substep = np.inf
    default_iterations = 500

    def __init__(self, model: Model, energy: Sum, options: Options, name: str) -> None:
        super().__init__(model, energy, options, name)
        self.stable = True

    def advance(
        self, x: np.ndarray, v: np.ndarray, h: float, target: np.ndarray, obstacles: Obstacles, wind: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        weight = self.mass * self.gravity
        there = self.solved(_put(x.copy(), self.model.held, target), x, weight, np.inf, np.inf, obstacles)
        try:
            Cholesky(self.energy.hessian(there), self.order)
            self.stable = True
        except NotPositiveDefinite:
            self.stable = False
        return there, np.zeros_like(v)


def _put(x: np.ndarray, held: np.ndarray, target: np.ndarray) -> np.ndarray:
    """``x`` with held vertices on their targets."""
    x[held] = target
    return x
