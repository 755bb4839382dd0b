"""What plates and membranes must do: lateral buckling by Ritz's method, the round membrane under load."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.polynomial import legendre
from scipy.integrate import solve_ivp
from scipy.linalg import eigh
from scipy.optimize import brentq

__all__ = ["hencky_rise", "lateral_gamma"]


def _products(degree_x: int, degree_y: int, clamp: int, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, ...]:
    """Functions x^clamp P_i(2x - 1) P_j(y) and their derivatives f, f_x, f_y, f_xx, f_xy, f_yy: shape (m, points)."""
    rise = np.polynomial.Polynomial([0.0] * clamp + [1.0])
    along = [rise * legendre.Legendre.basis(i, domain=[0, 1]).convert(kind=np.polynomial.Polynomial)
             for i in range(degree_x + 1)]  # fmt: skip
    across = [legendre.Legendre.basis(j).convert(kind=np.polynomial.Polynomial) for j in range(degree_y + 1)]
    orders = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
    return tuple(
        np.array([(f.deriv(a)(x) if a else f(x)) * (g.deriv(b)(y) if b else g(y)) for f in along for g in across])
        for a, b in orders
    )


@cache
def lateral_gamma(width: float, poisson: float, plane_poisson: float | None = None) -> float:
    """Gamma = rho_A g L^3 / B at which a strip clamped on its edge tips over sideways, B = D (1 - nu^2).

    Least of the potential energy: plate bending (D, nu) plus the work of the plane stresses of the strip's own weight
    over the slopes. Both the plane displacements and the deflection are products of polynomials that hold the clamp.

    Args:
        width: height of the strip over its length.
        poisson: of bending; may be negative.
        plane_poisson: of the membrane; None for the same.
    """
    nu_plane = poisson if plane_poisson is None else plane_poisson
    points, weights = np.polynomial.legendre.leggauss(40)
    x, y = (part.ravel() for part in np.meshgrid(0.5 * (points + 1.0), points, indexing="ij"))
    weight = np.outer(0.5 * weights, 0.5 * width * weights).ravel()
    to_y = 2.0 / width  # d/dy in parts of L, for y in -1..1

    # Plane stress under the weight, E h = rho_A g L = 1.
    f, fx, fy, *_ = _products(12, 7, 1, x, y)
    fy = to_y * fy
    count = len(f)
    e_xx = np.concatenate([fx, np.zeros_like(fx)])
    e_yy = np.concatenate([np.zeros_like(fy), fy])
    g_xy = np.concatenate([fy, fx])
    c11 = 1.0 / (1.0 - nu_plane**2)

    def stress(u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        along, across = u @ e_xx, u @ e_yy
        shear = 0.5 / (1.0 + nu_plane) * (u @ g_xy)
        return c11 * (along + nu_plane * across), c11 * (nu_plane * along + across), shear

    unit = np.eye(2 * count)
    s_xx, s_yy, s_xy = stress(unit)
    stiffness = (s_xx * weight) @ e_xx.T + (s_yy * weight) @ e_yy.T + (s_xy * weight) @ g_xy.T
    load = np.concatenate([np.zeros(count), -(f * weight).sum(axis=1)])
    n_xx, n_yy, n_xy = stress(np.linalg.lstsq(stiffness, load, rcond=1e-13)[0])

    _, wx, wy, wxx, wxy, wyy = _products(9, 6, 2, x, y)
    wy, wxy, wyy = to_y * wy, to_y * wxy, to_y**2 * wyy
    bending = ((wxx * weight) @ wxx.T + (wyy * weight) @ wyy.T + poisson * ((wxx * weight) @ wyy.T
               + (wyy * weight) @ wxx.T) + 2.0 * (1.0 - poisson) * (wxy * weight) @ wxy.T)  # fmt: skip
    slopes = (wx * n_xx * weight) @ wx.T + (wy * n_yy * weight) @ wy.T
    cross = (wx * n_xy * weight) @ wy.T
    geometric = slopes + cross + cross.T
    # The largest part of the load that stiffness can take: -geometric w = (1/Gamma) bending w.
    share = eigh(-geometric, bending, eigvals_only=True)[-1]
    return float(1.0 / share / (1.0 - poisson**2))


@cache
def hencky_rise(poisson: float) -> float:
    """Rise of a round clamped membrane over a (q a / (E h))^(1/3), small slopes (Hencky 1915).

    Foeppl's equations with axial symmetry, q = a = E h = 1: N w' = -r/2 and r N'' + 3 N' = -w'^2 / (2 r), N the radial
    tension; no displacement at the rim: r N' + (1 - nu) N = 0 there. Shot from the centre, where N' = 0. A solution for
    one tension at the centre gives all others by stretching r.
    """

    def rates(r: float, s: np.ndarray) -> list[float]:
        slope = -0.5 * r / s[0]
        return [s[1], (-3.0 * s[1] - 0.5 * slope * slope / r) / r, slope]

    def rim(centre: float) -> np.ndarray:
        start = 1e-4  # N = N0 - r^2 / (64 N0^2) + ...
        begin = [centre - start**2 / (64 * centre**2), -start / (32 * centre**2), -(start**2) / (4 * centre)]
        return solve_ivp(rates, (start, 1.0), begin, method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1]

    condition = lambda centre: (lambda s: s[1] + (1.0 - poisson) * s[0])(rim(centre))  # noqa: E731
    return float(-rim(brentq(condition, 0.33, 2.0, xtol=1e-13))[2])
