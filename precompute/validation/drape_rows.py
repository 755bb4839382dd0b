"""Rows of the validation table about drape: discs held in their middle."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np

from pbd import Fabric
from precompute.experiment.measures import GRAVITY
from precompute.experiment.sheets import level
from precompute.validation.drape_model import cone_load, least_energy_cone
from precompute.validation.strip_references import cusick_estimate
from precompute.validation.trial import FABRIC, Curve, Trial, TrialResult, TrialSetting, disc
from precompute.validation.validation_row import Parameter, Row

__all__ = ["PEDESTAL", "ROWS", "cusick_drape", "drape", "drape_coefficient", "fold_number"]

DISC, PEDESTAL = 0.15, 0.09  # radii in Cusick's drape meter [m]
STARTS = (4, 5, 6, 7, 8)  # folds


def _fabric(gravity_length: float) -> Fabric:
    bend = FABRIC.areal_density * GRAVITY * gravity_length**3
    return replace(FABRIC, bend_warp=bend, bend_weft=bend)


def _draped(setting: TrialSetting, fabric: Fabric, radius: float, clamp: float, folds: int) -> Trial:
    """A disc let go from a shallow wave of a number of folds. ``setting.edges`` lie along its diameter."""
    specimen = disc(radius, clamp, setting.edges // 2)
    reach, turn = np.linalg.norm(specimen.flat, axis=1), np.arctan2(specimen.flat[:, 1], specimen.flat[:, 0])
    over = np.maximum(reach - clamp, 0.0)
    # A cone whose slope waves around a mean that keeps its rim long enough.
    slope = 0.3 * np.cos(folds * turn) - 0.15
    start = level(specimen.flat) * ((clamp + over * np.cos(slope)) / np.maximum(reach, clamp))[:, None]
    inner = reach < clamp + 1e-9
    start[inner] = level(specimen.flat)[inner]
    start[:, 1] = over * np.sin(slope)
    trial = Trial(specimen, start, fabric, inner, setting)
    trial.settle(math.sqrt(radius / GRAVITY), limit=60.0, still=1e-4)
    return trial


def _rim(trial: Trial) -> np.ndarray:
    """Places of the rim in order around it [m], shape (k, 3)."""
    flat = trial.specimen.flat
    rim = np.flatnonzero(np.linalg.norm(flat, axis=1) > np.linalg.norm(flat, axis=1).max() - 1e-9)
    return trial.world()[rim[np.argsort(np.arctan2(flat[rim, 1], flat[rim, 0]))]]


def fold_number(trial: Trial) -> int:
    """Folds of a draped disc: the strongest wave of its rim's height."""
    height = _rim(trial)[:, 1]
    return int(np.argmax(np.abs(np.fft.rfft(height - height.mean()))))


def _energy(trial: Trial) -> float:
    """Bending energy and weight [J]."""
    model, places = trial.model, trial.world()
    bent = np.einsum("hk,hki->hi", model.hinge_data[:, 0].astype(float), places[model.hinges])
    bending = 0.5 * float(((bent**2).sum(axis=1) / model.hinge_data[:, 1, 1]).sum())
    return bending + GRAVITY * float(model.mass @ places[:, 1])


def _disc_folds(setting: TrialSetting, radius_over_length: float, radius_over_clamp: float) -> TrialResult:
    """Drapes from starts with 2 to n + 3 folds; the folds of the one with the least energy."""
    length = 0.02  # l_g of the fabric [m]
    radius = radius_over_length * length
    clamp = radius / radius_over_clamp
    cone = least_energy_cone(cone_load(radius, clamp, length))
    ended = [_draped(setting, _fabric(length), radius, clamp, n) for n in range(2, cone.folds + 4)]
    best = min(ended, key=_energy)
    rim = _rim(best)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(cone.curve, axis=0), axis=1))])
    half = np.interp(np.linspace(0.0, along[-1], 40), along, cone.curve[:, 2])
    wave = np.tile(np.concatenate([half, half[::-1]]), cone.folds)
    curve = Curve("around the rim", "height / R", (np.linspace(0.0, 1.0, len(wave)), wave),
                  (np.linspace(0.0, 1.0, len(rim)), rim[:, 1] / radius))  # fmt: skip
    found = fold_number(best)
    cost = float(np.median([trial.cost_ms for trial in ended]))
    return TrialResult(float(cone.folds), float(found), float(abs(found - cone.folds)), cost, curve)


def drape(setting: TrialSetting, fabric: Fabric) -> Trial:
    """A fabric in Cusick's drape meter: of starts with 4 to 8 folds the one that ends with the least energy."""
    return min((_draped(setting, fabric, DISC, PEDESTAL, folds) for folds in STARTS), key=_energy)


@lru_cache(maxsize=16)
def cusick_drape(setting: TrialSetting, gravity_length: float) -> tuple[float, float, np.ndarray]:
    """Cusick's drape coefficient of a fabric [-], cost of a frame [ms], rim from above [m], shape (k, 2)."""
    trial = _draped(setting, _fabric(gravity_length), DISC, PEDESTAL, 6)
    return drape_coefficient(trial), trial.cost_ms, _rim(trial)[:, [0, 2]]


def drape_coefficient(trial: Trial) -> float:
    """Cusick's drape coefficient [-]: the ring's shadow over the flat ring."""
    # The shadow: the farthest that the cloth reaches in each direction.
    places, count = trial.world(), len(_rim(trial))
    turn, reach = np.arctan2(places[:, 2], places[:, 0]), np.hypot(places[:, 0], places[:, 2])
    bins = np.arange(count) * 2.0 * math.pi / count - math.pi
    k = np.digitize(turn, bins) - 1
    farthest = np.full(count, PEDESTAL)
    np.maximum.at(farthest, k, reach)
    area = 0.5 * float((farthest**2).sum()) * 2.0 * math.pi / count
    return (area - math.pi * PEDESTAL**2) / (math.pi * (DISC**2 - PEDESTAL**2))


def _cusick(setting: TrialSetting, gravity_length_cm: float) -> TrialResult:
    """Above the estimate by radial strips, and below the coefficient of a fabric with a fifth more l_g."""
    shadow, cost, rim = cusick_drape(setting, 0.01 * gravity_length_cm)
    stiffer, _, _ = cusick_drape(setting, 0.012 * gravity_length_cm)
    estimate = cusick_estimate(0.01 * gravity_length_cm, DISC, pedestal=PEDESTAL)
    turn = np.linspace(0.0, 2.0 * math.pi, 100)
    size = math.sqrt(estimate * (DISC**2 - PEDESTAL**2) + PEDESTAL**2)
    curve = Curve("x [m]", "z [m]", (size * np.cos(turn), size * np.sin(turn)), (rim[:, 0], rim[:, 1]))
    error = max(0.0, estimate - shadow) + max(0.0, shadow - stiffer)
    return TrialResult(estimate, shadow, error, cost, curve)


ROWS = (
    Row("disc_folds", "disc held at its centre: folds of least energy", _disc_folds, 1.0, 2.0,
        {"radius_over_length": Parameter("R / l_g", 6.0, 2.0, 16.0),
         "radius_over_clamp": Parameter("R / R*", 5.0, 1.5, 20.0)},
        tuple({"radius_over_length": r} for r in (4.0, 6.0, 8.0))),
    Row("cusick", "drape coefficient: above the estimate by radial strips, and it grows with l_g", _cusick, 0.0, 0.0,
        {"gravity_length_cm": Parameter("l_g [cm]", 2.0, 0.5, 6.0)},
        tuple({"gravity_length_cm": length} for length in (1.5, 2.0, 2.8))),
)  # fmt: skip
