"""What strips, ropes and chains must do, from their differential equations.

Lengths are parts of the strip's length L; Gamma = rho_A g L^3 / B, B bending stiffness per width. Nothing stretches
unless it says so. Solved with scipy to eight digits or more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, fsolve
from scipy.special import jn_zeros, jv

__all__ = [
    "Deflection",
    "FirstSlip",
    "cantilever",
    "cantilever_gamma",
    "capstan_ratio",
    "cusick_estimate",
    "elastic_catenary",
    "first_slip",
    "hanging_stretch",
    "off_axis",
    "pressed_strip",
    "swing_period",
    "tall_column",
    "upright_gamma",
]

BUCKLING = 20.19  # N L^2/B of a strip clamped at one end, held in place at the other: tan k = k, k^2
EXACT = {"rtol": 1e-10, "atol": 1e-12}


@dataclass(frozen=True)
class Deflection:
    """A bent strip, from the clamp to its free end.

    Attributes:
        x, y: along the clamp's direction and upwards, parts of L, shape (201,).
        tip_angle: below the clamp's direction [rad].
    """

    x: np.ndarray
    y: np.ndarray
    tip_angle: float

    @property
    def height_over_width(self) -> float:
        """Drop of the tip over its distance from the clamp [-]."""
        return float(-self.y[-1] / self.x[-1])


def _from_tip(force: float, tip: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Psi'' = Gamma t sin psi from the free end (t = 0), psi the angle to the vertical; x and y from there."""

    def rates(t: float, s: np.ndarray) -> list[float]:
        return [s[1], force * t * math.sin(s[0]), math.sin(s[0]), math.cos(s[0])]

    found = solve_ivp(rates, (0.0, 1.0), [tip, 0.0, 0.0, 0.0], t_eval=np.linspace(0, 1, 201), method="DOP853", **EXACT)
    return found.y[2], found.y[3], float(found.y[0, -1])


@cache
def cantilever(gamma: float) -> Deflection:
    """Strip clamped level under its own weight: theta'' = -Gamma (1 - s) cos theta, theta(0) = 0, theta'(1) = 0.

    Shot from the free end by the logarithm of its angle to the vertical, which is tiny where Gamma is large.
    """
    # Between these angles of the tip the angle at the clamp passes a right angle once.
    low = math.log(0.5 * math.pi) - 2.0 / 3.0 * math.sqrt(gamma) - 3.0
    tip = math.exp(
        brentq(lambda log: _from_tip(gamma, math.exp(log))[2] - 0.5 * math.pi, low, math.log(0.5 * math.pi), xtol=1e-13)
    )
    along, down, _ = _from_tip(gamma, tip)
    x, y = along[-1] - along[::-1], down[::-1] - down[-1]
    return Deflection(x, y, 0.5 * math.pi - tip)


def cantilever_gamma(height_over_width: float) -> float:
    """The Gamma whose strip hangs with this height over width of its tip; inverse of :func:`cantilever`."""
    slope = max(height_over_width, 1e-9)
    log = brentq(lambda g: cantilever(math.exp(g)).height_over_width - slope, math.log(slope), math.log(4e3), xtol=1e-9)
    return math.exp(log)


@cache
def upright_gamma() -> float:
    """Gamma at which a strip clamped upright gives way (Greenhill 1881): J_-1/3(2/3 sqrt Gamma) = 0."""
    return float(brentq(lambda gamma: jv(-1.0 / 3.0, 2.0 / 3.0 * math.sqrt(gamma)), 7.0, 9.0, xtol=1e-13))


@cache
def tall_column(gamma: float, side: float) -> float:
    """Side displacement of the tip of a strip clamped upright, small, under a side load of ``side`` times its weight.

    theta'' + Gamma (1 - s) (theta + side) = 0, theta(0) = 0, theta'(1) = 0; below the Gamma of :func:`upright_gamma`.
    """

    def rates(s: float, y: np.ndarray) -> list[float]:
        return [y[1], -gamma * (1.0 - s) * (y[0] + side), y[0]]

    ends = []
    for slope in (0.0, 1.0):  # linear: two shots are enough
        found = solve_ivp(rates, (0.0, 1.0), [0.0, slope, 0.0], method="DOP853", **EXACT).y[:, -1]
        ends.append(found)
    share = -ends[0][1] / (ends[1][1] - ends[0][1])
    return float(ends[0][2] + share * (ends[1][2] - ends[0][2]))


@cache
def swing_period() -> float:
    """T sqrt(g/L) of the first swing of a hanging strip that does not bend: 4 pi over the first zero of J_0."""
    return float(4.0 * math.pi / jn_zeros(0, 1)[0])


def hanging_stretch(weight: float, stiffness: float) -> float:
    """Tip stretch over L of a hanging strip: rho_A g L / (2 E h), weight rho_A g L [N/m], stiffness E h [N/m]."""
    return weight / (2.0 * stiffness)


def elastic_catenary(span: float, weight: float, stiffness: float = math.inf) -> tuple[float, np.ndarray, np.ndarray]:
    """A strip hung by its two ends at one height; Hooke's law in the engineering strain.

    x(s) = H s / EA + (H/w) asinh(w s / H), y(s) = w s^2 / (2 EA) + (H/w) sqrt(1 + (w s/H)^2) from the lowest point
    (Irvine 1981). A finite stiffness may have the span longer than the strip.

    Args:
        span: distance of the ends over L.
        weight: rho_A g L [N/m].
        stiffness: E h [N/m].

    Returns:
        Sag over L, and the curve x, y over L from the middle's lowest point, shape (201,).
    """

    def half(pull: float, s: np.ndarray | float) -> np.ndarray:
        return pull * s / stiffness + pull / weight * np.arcsinh(weight * s / pull)

    high = math.log(weight * 1e6 + (0.0 if math.isinf(stiffness) else stiffness * span))
    log = brentq(lambda h: float(half(math.exp(h), 0.5)) - 0.5 * span, math.log(weight * 1e-6), high, xtol=1e-14)
    pull = math.exp(log)
    s = np.linspace(-0.5, 0.5, 201)
    y = weight * s**2 / (2.0 * stiffness) + pull / weight * (np.sqrt(1.0 + (weight * s / pull) ** 2) - 1.0)
    return float(y[0]), half(pull, s), y


def capstan_ratio(friction: float, wrap: float) -> float:
    """Tension ratio of a weightless belt that slides over a cylinder: exp(mu phi), phi the angle of wrap [rad]."""
    return math.exp(friction * wrap)


def off_axis(
    stretch_warp: float, stretch_weft: float, shear: float, poisson: float, angle: float
) -> tuple[float, float]:
    """Young's modulus times thickness [N/m] and Poisson's ratio of a strip cut at an angle [rad] to the warp.

    Plane-stress transformation of 1/E1, 1/E2, 1/G and nu12/E1.
    """
    c2, s2 = math.cos(angle) ** 2, math.sin(angle) ** 2
    compliance = c2**2 / stretch_warp + s2**2 / stretch_weft + (1.0 / shear - 2.0 * poisson / stretch_warp) * c2 * s2
    crosswise = poisson / stretch_warp * (c2**2 + s2**2) - (1 / stretch_warp + 1 / stretch_weft - 1 / shear) * c2 * s2
    return 1.0 / compliance, crosswise / compliance


@dataclass(frozen=True)
class FirstSlip:
    """A weightless strip pressed on the floor, at the moment its end slips.

    Attributes:
        lowering: of the clamp, over L.
        tip_angle: of the end to the vertical [rad].
        pressure: N L^2 / B of the floor on the end [-].
    """

    lowering: float
    tip_angle: float
    pressure: float


def _pressed(tip: float, guess: tuple[float, float]) -> tuple[float, float, np.ndarray]:
    """Normal force and side force on a strip whose end, under the clamp, makes an angle to the vertical; its shape.

    phi'' = -(N sin phi - F cos phi) from the end (phi' = 0) to the clamp (phi = 0), the end staying under the clamp.
    The shape: phi, phi', way to the side and way up at 101 points from the end on, shape (4, 101).
    """

    def shape(forces: tuple[float, float]) -> np.ndarray:
        def rates(_: float, s: np.ndarray) -> list[float]:
            sine, cosine = math.sin(s[0]), math.cos(s[0])
            return [s[1], -(forces[0] * sine - forces[1] * cosine), sine, cosine]

        start, points = [tip, 0.0, 0.0, 0.0], np.linspace(0.0, 1.0, 101)
        return solve_ivp(rates, (0.0, 1.0), start, t_eval=points, method="DOP853", **EXACT).y

    normal, side = fsolve(lambda forces: shape(forces)[[0, 2], -1] / tip, guess, xtol=1e-12)
    return float(normal), float(side), shape((normal, side))


@cache
def pressed_strip(tip: float) -> np.ndarray:
    """A weightless strip pressed on the floor under its clamp whose end makes a small angle [rad] to the vertical.

    Returns:
        Way to the side and height over L, from the clamp to the end, shape (101, 2).
    """
    _, _, shape = _pressed(tip, (BUCKLING, 0.0))
    return np.stack([shape[2], shape[3]], axis=1)[::-1]


@cache
def first_slip(friction: float) -> FirstSlip | None:
    """Weightless strip clamped vertically above a level floor, clamp lowered until side force is mu times normal force.

    Followed from the buckling load on, up to where the end lies flat on the floor; None if it does not slip before.
    """
    tip, forces = math.radians(0.5), (BUCKLING, 0.0)
    while tip < math.radians(95.0):
        last, known = tip, forces
        tip = last + math.radians(5.0)
        normal, side, _ = _pressed(tip, known)
        forces = (normal, side)
        if side > friction * normal:
            return _slipping(friction, (last, tip), known)
    return None


def _slipping(friction: float, between: tuple[float, float], guess: tuple[float, float]) -> FirstSlip:
    """The slip between two angles of the end."""

    def excess(tip: float) -> float:
        normal, side, _ = _pressed(tip, guess)
        return side / normal - friction

    tip = float(brentq(excess, *between, xtol=1e-11))
    normal, _, shape = _pressed(tip, guess)
    return FirstSlip(float(1.0 - shape[3, -1]), tip, normal)


def cusick_estimate(gravity_length: float, disc: float = 0.15, *, pedestal: float = 0.09) -> float:
    """Drape coefficient if the overhang bent as separate radial strips [-]: shadow over the ring's area.

    Args:
        gravity_length: l_g = (B / (rho_A g))^(1/3) [m].
        disc, pedestal: radii [m].
    """
    overhang = disc - pedestal
    reach = pedestal + overhang * float(cantilever((overhang / gravity_length) ** 3).x[-1])
    return (reach**2 - pedestal**2) / (disc**2 - pedestal**2)
