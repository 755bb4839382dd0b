"""Rows of the validation table about bending: strips of 20 cm that sag, tip over, and slip on the floor."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

from pbd import ClothMesh, Colliders, Fabric, Plane, build_model
from precompute.experiment.measures import FRAME_RATE, GRAVITY
from precompute.experiment.sheets import level
from precompute.validation.plate_references import lateral_gamma
from precompute.validation.strip_references import (
    cantilever,
    cantilever_gamma,
    first_slip,
    pressed_strip,
    tall_column,
    upright_gamma,
)
from precompute.validation.trial import FABRIC, Curve, Trial, TrialResult, TrialSetting, strip
from precompute.validation.validation_row import Parameter, Row

__all__ = ["ROWS", "hinge_poisson"]

LENGTH, WIDTH = 0.2, 0.04  # of a strip [m]
SIDE_LOAD = 2e-4  # side load of a strip that is to tip over, over its weight [-]
NEAR_CRITICAL = 0.85  # of the critical Gamma, where its last estimate is made
FIRST_BEND = math.radians(5.0)  # of the end of a strip that is going to slip
HIGHEST = 0.1  # tip displacement over the length beyond which a strip has tipped over [-]


def _fabric(gamma: float) -> Fabric:
    bend = FABRIC.areal_density * GRAVITY * LENGTH**3 / gamma
    return replace(FABRIC, bend_warp=bend, bend_weft=bend)


def _sagged(setting: TrialSetting, gamma: float, angle: float = 0.0) -> tuple[Trial, float]:
    specimen = strip(LENGTH, WIDTH, setting.edges, angle=angle)
    trial = Trial(specimen, level(specimen.flat), _fabric(gamma), specimen.flat[:, 0] < 1e-9, setting, mesh_angle=angle)
    trial.settle(math.sqrt(LENGTH / GRAVITY))
    tip = trial.world()[specimen.flat[:, 0] > LENGTH - 1e-9].mean(axis=0)
    return trial, float(-tip[1] / tip[0])


def _cantilever(setting: TrialSetting, gamma: float) -> TrialResult:
    trial, slope = _sagged(setting, gamma)
    exact = cantilever(gamma)
    middle = np.argsort(trial.specimen.flat[:, 0])
    places = trial.world()[middle] / LENGTH
    curve = Curve("x / L", "y / L", (exact.x, exact.y), (places[:, 0], places[:, 1]))
    return TrialResult.relative(exact.height_over_width, slope, trial.cost_ms, curve)


def _bending_direction(setting: TrialSetting, angle_deg: float, gamma: float) -> TrialResult:
    trial, slope = _sagged(setting, gamma, math.radians(angle_deg))
    found = gamma / cantilever_gamma(slope) if 0.0 < slope < 30.0 else math.nan
    return TrialResult.relative(1.0, found, trial.cost_ms)


def critical_gamma(deflect: Callable[[float], float], start: float) -> tuple[float, list[tuple[float, float]]]:
    """Gamma at which a strip tips over, by Southwell's plot: Gamma over the deflection falls to zero along a line.

    Args:
        deflect: tip displacement over the length under a small side load, for a Gamma.
        start: a Gamma to begin with.

    Returns:
        The critical Gamma, NaN if none was found, and the points measured (Gamma, deflection).
    """
    points: list[tuple[float, float]] = []
    gamma, tipped = start, math.inf
    for _ in range(16):
        found = deflect(gamma)
        if not 0.0 < found < HIGHEST:
            tipped = gamma
            gamma *= 0.5 if not points else (points[-1][0] / gamma) ** 0.5
            continue
        points = sorted([*points, (gamma, found)])
        following = 1.7 * gamma
        if len(points) > 1:
            (a, at_a), (b, at_b) = points[-2:]
            slope = (b / at_b - a / at_a) / (b - a)
            critical = b - b / at_b / slope if slope < 0.0 else math.inf
            if b > NEAR_CRITICAL * critical:
                return critical, points
            following = min(1.7 * b, (NEAR_CRITICAL + 0.05) * critical)
        gamma = min(following, 0.5 * (points[-1][0] + tipped))
    return math.nan, points


def _tips_over(
    setting: TrialSetting, width: float, place: Callable[[np.ndarray], np.ndarray], side: tuple[float, float, float],
) -> tuple[float, list[tuple[float, float]], float]:  # fmt: skip
    """Critical Gamma, points, and cost of a frame; ``place`` puts the strip into space, ``side`` points to its face."""
    costs = []
    specimen = strip(LENGTH, width, setting.edges)
    start, tip = place(specimen.flat), specimen.flat[:, 0] > LENGTH - 1e-9
    gravity = (SIDE_LOAD * GRAVITY * side[0], -GRAVITY, SIDE_LOAD * GRAVITY * side[2])
    scale = math.sqrt(LENGTH / GRAVITY)
    keep = np.float32(math.exp(-2.0 / (FRAME_RATE * scale)))

    def deflect(gamma: float) -> float:
        trial = Trial(specimen, start, _fabric(gamma), specimen.flat[:, 0] < 1e-9, setting, gravity)
        last = 0.0
        for _ in range(30):  # near the critical load it is slow
            for _ in range(math.ceil(scale * FRAME_RATE)):
                trial.frame()
                trial.state.velocity *= keep
            found = float(((trial.world() - start)[tip] @ np.array(side)).mean() / LENGTH)
            if abs(found - last) < 1e-3 * abs(found) or not abs(found) < HIGHEST:
                break
            last = found
        costs.append(trial.cost_ms)
        return found

    critical, points = critical_gamma(deflect, 4.0)
    return critical, points, float(np.median(costs))


def _upright(setting: TrialSetting) -> TrialResult:
    place = lambda flat: np.stack([np.zeros(len(flat)), flat[:, 0], flat[:, 1]], axis=1)  # noqa: E731
    critical, points, cost = _tips_over(setting, WIDTH, place, (1.0, 0.0, 0.0))
    gammas = np.linspace(0.2, 7.5, 60)
    curve = Curve(
        "Gamma", "tip displacement / (side load L)",
        (gammas, np.array([tall_column(float(g), 1.0) for g in gammas])),
        (np.array([p[0] for p in points]), np.array([p[1] for p in points]) / SIDE_LOAD),
    )  # fmt: skip
    return TrialResult.relative(upright_gamma(), critical, cost, curve)


@cache
def hinge_poisson() -> float:
    """Poisson's ratio that the hinges of this kind of mesh bend with: energies of a bowl and a cylinder compared."""
    sheet = strip(1.0, 1.0, 24, 0)
    mesh = ClothMesh.from_pattern(level(sheet.flat), sheet.faces, sheet.flat[sheet.faces])
    model = build_model(mesh, FABRIC, bend_factor=1 / 3)
    along, across = (0.5 * sheet.flat**2).T

    def energy(height: np.ndarray) -> float:
        bent = (model.hinge_data[:, 0] * height[model.hinges]).sum(axis=1)
        return float((bent**2 / model.hinge_data[:, 1, 1]).sum())

    return (energy(along + across) - energy(along) - energy(across)) / (energy(along) + energy(across))


def _lateral(setting: TrialSetting, width_over_L: float) -> TrialResult:  # noqa: N803 (the table's own name)
    place = lambda flat: np.stack([flat[:, 0], flat[:, 1], np.zeros(len(flat))], axis=1)  # noqa: E731
    critical, _, cost = _tips_over(setting, width_over_L * LENGTH, place, (0.0, 0.0, 1.0))
    own = setting.bend_poisson
    exact = lateral_gamma(width_over_L, hinge_poisson() if own is None else own, FABRIC.poisson)
    return TrialResult.relative(exact, critical, cost)


def _stick_slip(setting: TrialSetting, mu: float) -> TrialResult:
    """The clamp comes down slowly, until the end has moved by a hundredth of the length. Starts a little bent."""
    specimen = strip(LENGTH, WIDTH, setting.edges)
    along = specimen.flat[:, 0]
    bent = LENGTH * pressed_strip(FIRST_BEND)
    s = np.linspace(0.0, LENGTH, len(bent))
    side, height = (np.interp(along, s, part) for part in bent.T)
    start = np.stack([side, height - np.minimum(along, 0.0), specimen.flat[:, 1]], axis=1)
    begin = 1.0 - bent[0, 1] / LENGTH
    fabric = replace(_fabric(40.0), friction=mu, thickness=1e-3)
    floor = Colliders([Plane((0.0, -fabric.thickness, 0.0))])
    held, tip = along < 1e-9, along > LENGTH - 1e-9
    trial = Trial(specimen, start, fabric, held, setting, (0.0, 0.0, 0.0), colliders=floor)
    scale = LENGTH**2 * math.sqrt(fabric.areal_density / fabric.bend_warp)  # a typical time of bending [s]
    exact = first_slip(mu)
    assert exact is not None, "the parameter's range ends before"
    keep = np.float32(math.exp(-2.0 / (FRAME_RATE * scale)))
    targets = start[trial.model.held]
    frames = 200 if setting.timeless else math.ceil(20.0 * scale * FRAME_RATE)
    for frame in range(2 * frames):  # to twice what it should take
        lowering = begin + (exact.lowering - begin) * frame / frames
        trial.frame(targets - [0.0, (lowering - begin) * LENGTH, 0.0])
        trial.state.velocity *= keep
        if not np.abs(trial.world()[tip, 0]).max() < 1e-2 * LENGTH:
            return TrialResult.relative(exact.lowering, lowering, trial.cost_ms)
    return TrialResult.relative(exact.lowering, math.nan, trial.cost_ms)


GAMMA = Parameter("rho_A g L^3 / B", 10.0, 1e-3, 1e3)
ROWS = (
    Row("cantilever", "strip clamped level: height over width of its tip", _cantilever, 0.02, 0.05,
        {"gamma": GAMMA}, tuple({"gamma": g} for g in (0.1, 1.0, 3.0, 10.0, 30.0, 100.0))),
    Row("bending_direction", "bending stiffness of a strip at an angle to its mesh, over the fabric's own",
        _bending_direction, 0.05, 0.2,
        {"angle_deg": Parameter("strip against mesh [deg]", 0.0, 0.0, 180.0), "gamma": replace(GAMMA, default=3.0)},
        tuple({"angle_deg": a} for a in (0.0, 22.5, 45.0, 90.0))),
    Row("upright_buckling", "strip clamped upright: Gamma at which it tips over", _upright, 0.03, 0.1),
    Row("lateral_buckling", "strip clamped on edge: rho_A g L^3 / B at which it tips over, at the bending's own "
        "Poisson ratio", _lateral, 0.03, 0.1, {"width_over_L": Parameter("width over length", 0.2, 0.05, 1.0)},
        tuple({"width_over_L": w} for w in (0.1, 0.2, 0.5))),
    Row("stick_slip", "strip pressed on the floor: lowering over L at which its end slips", _stick_slip, 0.02, 0.05,
        {"mu": Parameter("coefficient of friction", 0.15, 0.02, 0.36)},
        tuple({"mu": m} for m in (0.05, 0.15, 0.25, 0.35))),
)  # fmt: skip
