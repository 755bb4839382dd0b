"""Rows of the validation table about stretch: cloth that hangs and sags."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.optimize import brentq

from precompute.experiment.measures import FRAME_RATE, GRAVITY
from precompute.experiment.sheets import level
from precompute.validation.plate_references import hencky_rise
from precompute.validation.strip_references import elastic_catenary, hanging_stretch
from precompute.validation.trial import FABRIC, Curve, Trial, TrialResult, TrialSetting, disc, strip
from precompute.validation.validation_row import Parameter, Row

__all__ = ["ROPE", "ROWS"]

# It hardly bends: a rope that did not bend at all would have no equilibrium but a taut one.
ROPE = replace(FABRIC, poisson=0.0, bend_warp=1e-8, bend_weft=1e-8)


def _hanging_strip(setting: TrialSetting, edges: int) -> TrialResult:
    """In real time the gate is the law of one pass: stretch of g h^2 N^2/(2 L) on top of the elastic one."""
    setting = replace(setting, edges=int(edges))
    length = 1.0
    specimen = strip(length, 2.0 * length / setting.edges, setting.edges, clamp=0)
    x = specimen.flat[:, 0]
    start = np.stack([specimen.flat[:, 1], -x, np.zeros_like(x)], axis=1)
    weight = ROPE.areal_density * GRAVITY * length
    exact = hanging_stretch(weight, ROPE.stretch_warp)
    trial = Trial(specimen, start * [1.0, 1.0 + exact, 1.0], ROPE, x < 1e-9, setting)
    trial.settle(math.sqrt(length / GRAVITY), still=1e-6)
    depth = start[:, 1] - trial.world()[:, 1]
    found = float(depth[x > length - 1e-9].mean() / length)
    law = GRAVITY * length / 2.0 * (setting.edges / length / (FRAME_RATE * setting.substeps)) ** 2
    s = np.linspace(0.0, 1.0, 50)
    curve = Curve("s / L", "moved down / L", (s, weight / ROPE.stretch_warp * (s - 0.5 * s**2)), (x, depth))
    beyond = max(0.0, found - exact - law) / exact
    return replace(TrialResult.relative(exact, found, trial.cost_ms, curve), realtime_error=beyond)


def _catenary(setting: TrialSetting, span: float) -> TrialResult:
    length = 1.0
    specimen = strip(length, 0.2 * length, setting.edges, clamp=0)
    x, y = specimen.flat.T
    weight = ROPE.areal_density * GRAVITY * length
    sag, curve_x, curve_y = elastic_catenary(span, weight, ROPE.stretch_warp)
    at = x / length - 0.5
    start = np.stack([*_parabola(min(span, 1.0), at) * [[max(span, 1.0)], [1.0]], -y], axis=1)
    trial = Trial(specimen, start, ROPE, (x < 1e-9) | (x > length - 1e-9), setting)
    trial.settle(math.sqrt(length / GRAVITY), still=1e-6)
    places = trial.world()
    # Over the width by area: the rows at the sides do not weigh quite their share and sag less or more.
    middle, weights = np.abs(at) < 0.15, np.sqrt(trial.model.mesh.vertex_areas)
    even = np.polynomial.Polynomial.fit(places[middle, 0] ** 2, places[middle, 1], 2, w=weights[middle])
    lowest = float(even(0.0))
    curve = Curve("x / L", "y / L", (curve_x, curve_y - curve_y[0]), (places[:, 0], places[:, 1]))
    return TrialResult.relative(sag, -lowest, trial.cost_ms, curve)


def _parabola(span: float, at: np.ndarray) -> np.ndarray:
    """Places over L on a parabola as long as the strip, by the way along it over L from its middle, shape (2, n)."""
    x = np.linspace(-0.5 * span, 0.5 * span, 2001)
    way = lambda bend: 0.5 * x * np.sqrt(1.0 + (bend * x) ** 2) + np.arcsinh(bend * x) / (2.0 * bend)  # noqa: E731
    bend = brentq(lambda bend: way(bend)[-1] - 0.5, 1e-6, 1e3) if span < 1.0 else 1e-6
    found = np.interp(at, way(bend), x)
    return np.stack([found, 0.5 * bend * (found**2 - 0.25 * span**2)])


def _hencky(setting: TrialSetting, poisson: float) -> TrialResult:
    radius = 0.2
    stretch = FABRIC.stretch_warp
    fabric = replace(ROPE, poisson=poisson, shear=stretch / (2.0 * (1.0 + poisson)))
    specimen = disc(radius, 0.5 * radius, setting.edges // 2)
    reach = np.linalg.norm(specimen.flat, axis=1)
    # From a shallow dish: a flat membrane bears no load.
    start = level(specimen.flat)
    start[:, 1] = 0.02 * (reach**2 / radius - radius)
    trial = Trial(specimen, start, fabric, reach > radius - 1e-9, setting)
    trial.settle(math.sqrt(radius / GRAVITY), still=1e-6)
    depth = -trial.world()[:, 1]
    inner = reach < 0.25 * radius
    top = np.polynomial.Polynomial.fit(reach[inner] ** 2, depth[inner], 1)(0.0)
    size = radius * (fabric.areal_density * GRAVITY * radius / stretch) ** (1.0 / 3.0)
    exact = hencky_rise(poisson) * size
    curve = Curve("r / a", "sag / a", (np.array([0.0, 1.0]), np.array([exact / radius, 0.0])),
                  (reach / radius, depth / radius))  # fmt: skip
    return TrialResult.relative(exact, float(top), trial.cost_ms, curve)


ROWS = (
    Row("hanging_strip", "strip under its own weight: stretch of its tip over L; in real time what lies beyond the law "
        "of one pass", _hanging_strip, 0.01, 0.01, {"edges": Parameter("edges along the strip", 20.0, 5.0, 400.0)},
        tuple({"edges": float(n)} for n in (10, 20, 50, 100, 200))),
    Row("catenary", "strip hung by both ends: sag over L; a span of 1 or more is taut", _catenary, 0.002, 0.01,
        {"span": Parameter("distance of the ends over L", 0.8, 0.1, 1.1)},
        tuple({"span": a} for a in (0.5, 0.8, 1.0, 1.001))),
    Row("hencky", "round clamped membrane under its own weight: sag [m]", _hencky, 0.01, 0.03,
        {"poisson": Parameter("Poisson's ratio", 0.3, 0.0, 0.49)}),
)  # fmt: skip
