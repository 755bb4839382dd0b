"""A virtual fabric laboratory: tension, shear, bending and friction as the Kawabata system measures them.

Samples are held by clamps and measured without weight; a load cell
(:meth:`precompute.validation.trial.Trial.pull`) reads force and moment. Every instrument gives a curve of load
against deformation for any solver.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pbd import Colliders, Fabric, Plane
from precompute.experiment.measures import FRAME_RATE, GRAVITY
from precompute.experiment.sheets import level
from precompute.validation.trial import Trial, TrialSetting, strip

__all__ = [
    "DIRECTIONS", "LoadCurve", "bending_curve", "compression_curve", "friction_coefficient", "shear_curve",
    "tension_curve",
]  # fmt: skip

DIRECTIONS = {"warp": 0.0, "bias": 0.25 * math.pi, "weft": 0.5 * math.pi}  # of the sample to the warp [rad]
FLAT = 1e-2  # bending stiffness that keeps a sheared sample flat, as its tension does in the instrument [N m]
SETTLING_S = 0.2  # time over which clamped cloth is damped [s]


@dataclass(frozen=True)
class LoadCurve:
    """What an instrument drew.

    Attributes:
        deformation: strain [-], shear angle [rad] or curvature [1/m], shape (k,).
        load: tension or shear force per width [N/m], or moment per width [N], shape (k,).
        cost_ms: processor time of a frame, median [ms].
    """

    deformation: np.ndarray
    load: np.ndarray
    cost_ms: float


def tension_curve(setting: TrialSetting, fabric: Fabric, angle: float, strains: Sequence[float]) -> LoadCurve:
    """A strip of 20 by 4 cm pulled by one vertex at each end; strain in its middle half.

    With one vertex a side the strip bears a pull and nothing else, at any angle of its warp.

    Args:
        setting: solver and resolution.
        fabric: SI values.
        angle: of the strip to the warp [rad].
        strains: of the distance of the two vertices.
    """
    length, width = 0.2, 0.04
    specimen = strip(length, width, setting.edges, clamp=0)
    x, y = specimen.flat.T
    ends = np.array([int(np.argmin(np.hypot(x - at, y))) for at in (0.0, length)])
    middle = np.abs(x - 0.5 * length) < 0.25 * length + 1e-9
    design = np.stack([x, y, np.ones_like(x)], axis=1)[middle]
    start = level(specimen.flat)
    found, loads, costs = [], [], []
    for strain in strains:
        trial = Trial(specimen, start * [1.0 + strain, 1.0, 1.0], fabric, ends, setting, (0.0, 0.0, 0.0), warp=angle)
        trial.settle(SETTLING_S, limit=60.0, still=1e-3 * strain)
        moved = (trial.world() - start)[middle, 0]
        weight = np.sqrt(trial.model.mesh.vertex_areas[middle])  # a vertex on a side stands for half as much
        found.append(np.linalg.lstsq(weight[:, None] * design, weight * moved, rcond=None)[0][0])
        # The nearer end holds still, the farther one is read.
        loads.append(-trial.pull(ends[ends == ends.max()])[0][0] / width)
        costs.append(trial.cost_ms)
    return LoadCurve(np.array(found), np.abs(loads), float(np.median(costs)))


def shear_curve(setting: TrialSetting, fabric: Fabric, angle: float, shears: Sequence[float]) -> LoadCurve:
    """Cloth 5 cm high between two clamps, one moved along the other; two widths, so that free sides cancel.

    Args:
        setting: ``edges`` lie along the height.
        fabric: SI values.
        angle: of the height to the warp [rad].
        shears: ways of the clamp over the height.
    """
    height, widths = 0.05, (0.1, 0.2)
    fabric = replace(fabric, bend_warp=FLAT, bend_weft=FLAT)
    edges = max(4, setting.edges // 2)
    loads, costs = np.zeros((2, len(shears))), []
    for row, width in enumerate(widths):
        specimen = strip(height, width, edges, clamp=0)
        x = specimen.flat[:, 0]
        clamps = (x < 1e-9) | (x > height - 1e-9)
        for column, shear in enumerate(shears):
            start = level(specimen.flat)
            start[:, 2] += shear * x
            trial = Trial(specimen, start, fabric, clamps, setting, (0.0, 0.0, 0.0), warp=angle)
            trial.settle(SETTLING_S, limit=60.0, still=1e-3 * shear)
            loads[row, column] = abs(trial.pull(np.flatnonzero(x > height - 1e-9))[0][2])
            costs.append(trial.cost_ms)
    return LoadCurve(np.array(shears), (loads[1] - loads[0]) / (widths[1] - widths[0]), float(np.median(costs)))


def bending_curve(setting: TrialSetting, fabric: Fabric, angle: float, curvatures: Sequence[float]) -> LoadCurve:
    """A strip of 2 cm between two clamps that lie on an arc; the moment that the far clamp must bear.

    Args:
        setting: solver and resolution.
        fabric: SI values.
        angle: of the strip to the warp [rad].
        curvatures: of the arc [1/m].
    """
    length, width = 0.02, 0.004
    specimen = strip(length, width, setting.edges, clamp=1)
    edge = specimen.edge
    x, y = specimen.flat.T
    far = x > length - 1.5 * edge  # the last row of faces is clamped too
    free = length - edge
    clamps = (x < 1e-9) | far
    loads, costs = [], []
    for curvature in curvatures:
        s = np.clip(x, 0.0, free)
        turn = curvature * s
        beyond = x - s  # faces in the clamps are flat
        along = np.sin(turn) / curvature + beyond * np.cos(turn)
        down = (1.0 - np.cos(turn)) / curvature + beyond * np.sin(turn)
        trial = Trial(
            specimen, np.stack([along, -down, -y], axis=1), fabric, clamps, setting, (0.0, 0.0, 0.0), warp=angle
        )
        trial.settle(SETTLING_S, limit=60.0, still=1e-4)
        force, moment = trial.pull(np.flatnonzero(far))
        # The mean over the strip: the clamps' own moment, and that of their side force at mid-length.
        middle = trial.world()[np.abs(x - 0.5 * free) < edge].mean(axis=0)
        loads.append(abs((moment - np.cross(middle, force))[2]) / width)
        costs.append(trial.cost_ms)
    return LoadCurve(np.array(curvatures), np.array(loads), float(np.median(costs)))


def compression_curve(setting: TrialSetting, fabric: Fabric, pressures: Sequence[float]) -> LoadCurve:
    """A sheet pressed onto a level plate by its own weight, as many times g as it takes: its height over the plate.

    So pressure is known for every solver.

    Args:
        setting: solver and resolution.
        fabric: SI values.
        pressures: above 0 [Pa].

    Returns:
        Pressures as load [Pa] and thickness as deformation [m].
    """
    specimen = strip(0.05, 0.05, max(4, setting.edges // 4), clamp=0)
    plate = Colliders([Plane((0.0, 0.0, 0.0))])
    found, costs = [], []
    for pressure in pressures:
        gravity = (0.0, -pressure / fabric.areal_density, 0.0)
        start = level(specimen.flat) + [0.0, fabric.thickness, 0.0]
        trial = Trial(specimen, start, fabric, np.zeros(0, int), setting, gravity, colliders=plate)
        trial.settle(0.05, limit=20.0, still=1e-6)
        found.append(float(trial.model.mass @ trial.world()[:, 1] / trial.model.mass.sum()))
        costs.append(trial.cost_ms)
    return LoadCurve(np.array(found), np.array(pressures, float), float(np.median(costs)))


def friction_coefficient(setting: TrialSetting, fabric: Fabric) -> tuple[float, float]:
    """A sheet thrown along a level plate at 1 m/s: how fast it slows down over g; cost of a frame [ms]."""
    specimen = strip(0.1, 0.1, setting.edges, clamp=0)
    plate = Colliders([Plane((0.0, 0.0, 0.0))])
    start = level(specimen.flat) + [0.0, fabric.thickness, 0.0]
    trial = Trial(specimen, start, fabric, np.zeros(0, int), setting, colliders=plate)
    for _ in range(6):  # it comes to lie
        trial.frame()
    trial.state.velocity[:] = [1.0, 0.0, 0.0]
    frames = max(2, round(0.5 * FRAME_RATE / (GRAVITY * max(fabric.friction, 0.02))))
    for _ in range(frames):
        trial.frame()
    speed = float(trial.model.mass @ trial.state.velocity[:, 0].astype(float) / trial.model.mass.sum())
    return (1.0 - speed) / (GRAVITY * frames / FRAME_RATE), trial.cost_ms
