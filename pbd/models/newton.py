"""Newton's method with a line search."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from scipy.sparse import csr_matrix

from pbd.models.linear import Cholesky, FreeOrder, NotPositiveDefinite

__all__ = ["Objective", "StepError", "minimise"]

# The line search accepts a step with this share of the decrease that the slope predicts [-].
MIN_DECREASE_SHARE = 1e-4
MIN_STEP_LENGTH = 1e-10  # at which it gives up [-]
MIN_DECREASE = 1e-17  # over the value; a smaller one counts as none, also if soft modes still move [-]
ROUNDING = 1e-13  # part of the value that rounding may add
# Within this share of the value the slope judges a step, since the value is a difference of larger ones [-].
NEAR_SHARE = 1e-9


class StepError(RuntimeError):
    """A step that came to no valid end. The state is as it was before the step.

    Args:
        problem: what went wrong.
        solver: name of the solver.
    """

    def __init__(self, problem: str, solver: str = "") -> None:
        self.problem, self.solver = problem, solver
        super().__init__(f"{solver}: {problem}" if solver else problem)


class Objective(Protocol):
    """The function that is minimised; see :class:`pbd.models.elements.Energy`."""

    def energy(self, x: np.ndarray) -> float:
        """Value [J] at positions [m], float64, shape (n, 3)."""
        ...

    def gradient(self, x: np.ndarray) -> np.ndarray:
        """[N], shape (n, 3)."""
        ...

    def hessian(self, x: np.ndarray, positive: bool = False) -> csr_matrix:
        """[N/m], shape (3 n, 3 n); ``positive`` asks for a positive semidefinite neighbour of it."""
        ...


def minimise(
    objective: Objective, x: np.ndarray, order: FreeOrder, tolerance: float | np.ndarray, iterations: int
) -> np.ndarray:
    """A minimum over the free vertices, from ``x`` downhill.

    Each step solves with the exact Hessian or, where that is not positive definite, with its positive neighbour.

    Args:
        objective: energy with two derivatives.
        x: start [m], shape (n, 3).
        order: free unknowns.
        tolerance: largest move of a vertex in the last step [m], of all or of each, shape (n,).
        iterations: at most.

    Raises:
        StepError: not finite, no descent, line search stuck, linear solve failed or too many iterations.
    """
    unknowns = order.unknowns
    value = objective.energy(x)
    for _ in range(iterations):
        gradient = objective.gradient(x)
        if not (np.isfinite(gradient).all() and np.isfinite(value)):
            raise StepError("forces are not finite")
        move = -_newton_direction(objective, x, order, gradient)
        slope = float(gradient.ravel()[unknowns] @ move.ravel()[unknowns])
        largest = np.abs(move).max(initial=0.0)
        if np.all(np.abs(move).max(axis=1) <= tolerance) or abs(slope) <= MIN_DECREASE * abs(value):
            return x + move
        if not slope < 0.0:
            raise StepError(f"no descent: slope {slope:.3g} J")
        length = 1.0
        while True:
            tried = x + length * move
            tried_value = objective.energy(tried)
            if tried_value <= value + MIN_DECREASE_SHARE * length * slope + ROUNDING * abs(value):
                break
            if tried_value <= value + NEAR_SHARE * abs(
                value
            ):  # the approximate condition of Hager and Zhang (2005), 4.1
                ahead = float(objective.gradient(tried).ravel()[unknowns] @ move.ravel()[unknowns])
                if abs(ahead) <= (1.0 - 2.0 * MIN_DECREASE_SHARE) * abs(slope):
                    break
            length *= 0.5
            if length < MIN_STEP_LENGTH:
                raise StepError(f"line search stuck: next move {largest:.3g} m")
        x, value = tried, tried_value
    raise StepError(f"no minimum in {iterations} Newton iterations: last move {largest:.3g} m")


def _newton_direction(objective: Objective, x: np.ndarray, order: FreeOrder, gradient: np.ndarray) -> np.ndarray:
    try:
        return Cholesky(objective.hessian(x), order).solve(gradient)
    except NotPositiveDefinite:
        pass
    try:
        return Cholesky(objective.hessian(x, positive=True), order).solve(gradient)
    except (NotPositiveDefinite, np.linalg.LinAlgError) as error:
        raise StepError(f"linear solve failed: {error}") from error
