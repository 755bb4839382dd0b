"""Drape of a disc held at its centre: the n-fold developable cone under gravity (Cerda, Mahadevan and Pasini 2004).

The cloth bends only along the radii: x = r u(s), u a closed curve of length 2 pi on the unit sphere. Its energy over
B ln(R/R*) is 1/2 the integral of k^2 plus G times the integral of u_z, with k the curve's curvature along the sphere,
G = (R/l_g)^3 / (3 ln(R/R*)) and R* the radius of the clamp.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import simpson, solve_bvp

__all__ = ["Cone", "cone_load", "fold_count", "least_energy_cone", "n_fold_cone"]

EASY = 0.05  # G at which a small wave is a good guess [-]
FIRST_FACTOR, LEAST_FACTOR = 1.6, 1.01  # of G, from one solution to the next
OFF_AXIS = 0.02  # a curve nearer to the axis than this touches it [-]


@dataclass(frozen=True)
class Cone:
    """The n-fold cone of least energy.

    Attributes:
        folds: n.
        load: G.
        energy: over B ln(R/R*) [-].
        curve: unit vectors u over half a fold, shape (k, 3).
        drop: mean of -u_z.
    """

    folds: int
    load: float
    energy: float
    curve: np.ndarray
    drop: float

    @property
    def free(self) -> bool:
        """Whether every half fold stays in its own wedge of pi/n, off the axis: then no part touches another."""
        half = math.pi / self.folds
        x, y = self.curve[:, 0], self.curve[:, 1]
        inside = min(y.min(), (x * math.sin(half) - y * math.cos(half)).min()) > -1e-6
        return bool(inside and np.hypot(x, y).min() > OFF_AXIS)


def cone_load(radius: float, clamp: float, gravity_length: float) -> float:
    """G of a disc, all lengths in [m]."""
    return (radius / gravity_length) ** 3 / (3.0 * math.log(radius / clamp))


def fold_count(radius_over_length: float, radius_over_clamp: float) -> float:
    """The scaling law of the number of folds: (R/l_g)^(3/4) / ln(R/R*)^(1/4)."""
    return radius_over_length**0.75 / math.log(radius_over_clamp) ** 0.25


def n_fold_cone(folds: int, load: float) -> Cone:
    """The n-fold cone at a load G, followed from small loads on.

    Between a ridge and a valley, both level, the curve goes pi/n around. With t its tangent and m = u x t, the least
    energy obeys k'' = k (c - k^2/2 + G u_z) - G m_z; c holds the length.

    Raises:
        RuntimeError: no solution was found.
    """
    half = math.pi / folds
    # Small waves: u_z = a cos(n s) - d, d = a sqrt((n^2 - 1)/2), a by the balance of bending and weight.
    done, wave = min(EASY, load), folds**2 - 1.0
    size = 2.0 * done * math.sqrt(0.5 * wave) / wave**2
    s = np.linspace(0.0, half, 31)
    turn, rate = np.cos(folds * s), folds * np.sin(folds * s)
    guess = np.stack([
        -size * wave * turn, size * wave * rate, np.cos(s), np.sin(s), size * turn - size * math.sqrt(0.5 * wave),
        -np.sin(s), np.cos(s), -size * rate,
    ])  # fmt: skip
    level, factor, solved = np.array([-wave]), FIRST_FACTOR, False
    while not solved or done < load:
        stage = min(load, done * factor) if solved else done
        found = _solve(stage, half, s, guess, level)
        if found.success:
            s, guess, level = found.x, found.y, found.p
            done, solved, factor = stage, True, min(FIRST_FACTOR, factor**1.5)
        elif not solved or factor < LEAST_FACTOR:
            raise RuntimeError(f"no {folds}-fold cone at G = {stage:.4g}: {found.message}")
        else:
            factor **= 0.5
    k, u = guess[0], guess[2:5].T
    total = lambda f: 2.0 * folds * float(simpson(f, x=s))  # noqa: E731
    drop = -total(u[:, 2]) / (2.0 * math.pi)
    return Cone(folds, load, 0.5 * total(k * k) - 2.0 * math.pi * load * drop, u, drop)


def _solve(load: float, half: float, s: np.ndarray, guess: np.ndarray, level: np.ndarray) -> Any:
    """Scipy's answer for k, k', u and t along half a fold, and c."""

    def rates(_: np.ndarray, y: np.ndarray, p: np.ndarray) -> np.ndarray:
        k, u, t = y[0], y[2:5], y[5:8]
        m = np.stack([u[1] * t[2] - u[2] * t[1], u[2] * t[0] - u[0] * t[2], u[0] * t[1] - u[1] * t[0]])
        bent = k * (p[0] - 0.5 * k * k + load * u[2]) - load * m[2]
        return np.concatenate([y[1:2], bent[None], t, k * m - u])

    def ends(a: np.ndarray, b: np.ndarray, _: np.ndarray) -> np.ndarray:
        start = [a[1], a[3], a[2] ** 2 + a[4] ** 2 - 1.0, a[5], a[6] - 1.0, a[7]]
        return np.array([*start, b[1], b[7], b[3] * math.cos(half) - b[2] * math.sin(half)])

    return solve_bvp(rates, ends, s, guess, p=level, tol=1e-5, max_nodes=3_000)


def least_energy_cone(load: float) -> Cone:
    """The cone that does not touch itself and whose number of folds has the least energy at G.

    Few folds under a great load would hang through the axis or through each other; from the first number that does not,
    the energy falls to its least and rises again.
    """
    best, folds = None, max(2, int(1.1 * load**0.25))
    while True:
        try:
            cone = n_fold_cone(folds, load)
        except RuntimeError:  # so few folds that they hang straight down
            cone = None
        if cone is not None and cone.free:
            if best is not None and cone.energy >= best.energy:
                return best
            best = cone
        folds += 1
