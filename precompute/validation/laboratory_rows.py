"""Rows of the validation table that the fabric laboratory measures, at any angle and by Kawabata's way."""

from __future__ import annotations

import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from assets.fabrics import load_fabric, measured_tension
from pbd import Fabric
from precompute.validation.laboratory import (
    DIRECTIONS,
    LoadCurve,
    bending_curve,
    compression_curve,
    friction_coefficient,
    shear_curve,
    tension_curve,
)
from precompute.validation.strip_references import off_axis
from precompute.validation.trial import FABRIC, Curve, TrialResult, TrialSetting
from precompute.validation.validation_row import Parameter, ParameterChoice, Row

__all__ = ["ROWS"]

# The built-in fabric with half its stiffness along the weft, so that the axes differ.
WOVEN = replace(FABRIC, stretch_weft=0.5 * FABRIC.stretch_warp, bend_weft=0.5 * FABRIC.bend_warp)
# Its thickness gives by a third at 5 kPa, which is about what a wool cloth does in Kawabata's instrument.
SOFT = replace(WOVEN, compression=2000.0, air_drag=0.0)
PRESSURES = (50.0, 500.0, 2000.0, 5000.0)  # [Pa]
STRAINS = (0.005, 0.01, 0.02)
SHEARS = (0.01, 0.03, 0.05)  # [rad]
CURVATURES = (50.0, 100.0)  # [1/m]
# Measured by Wang, O'Brien and Ramamoorthi 2011.
CLOTHS = (
    "gray-interlock", "camel-ponte-roma", "ivory-rib-knit", "navy-sparkle-sweat", "pink-ribbon-brown",
    "tango-red-jet-set", "white-swim-solid", "11oz-black-denim", "royal-target", "white-dots-on-blk",
)  # fmt: skip
FAR_STRAINS = (0.02, 0.05, 0.10, 0.17)


def _elastic(fabric: Fabric, angle: float) -> float:
    return off_axis(fabric.stretch_warp, fabric.stretch_weft, fabric.shear, fabric.poisson, angle)[0]


def _tension(setting: TrialSetting, angle_deg: float, strain: float) -> TrialResult:
    angle = math.radians(angle_deg)
    measured = tension_curve(setting, WOVEN, angle, (strain,))
    found = float(measured.load[0] / measured.deformation[0])
    degrees = np.linspace(0.0, 180.0, 91)
    law = np.array([_elastic(WOVEN, math.radians(a)) for a in degrees])
    curve = Curve("angle to the warp [deg]", "E h [N/m]", (degrees, law), (np.array([angle_deg]), np.array([found])))
    return TrialResult.relative(_elastic(WOVEN, angle), found, measured.cost_ms, curve)


def _tension_measured(setting: TrialSetting, fabric: str, direction: str) -> TrialResult:
    """Tension at 17 %; the error is the largest of the four strains."""
    path = Path(os.environ.get("GUBE_DATA", "out/data")) / "materials" / f"{fabric}.json"
    if not path.is_file():
        return TrialResult.lost(f"no file {path} (GUBE_DATA)")
    cloth = replace(load_fabric(path), air_drag=0.0)
    drawn = tension_curve(setting, cloth, DIRECTIONS[direction], FAR_STRAINS)
    law = measured_tension(path, direction, drawn.deformation)
    errors = drawn.load / law - 1.0
    figures = {f"error_at_{100.0 * e:.0f}_percent": float(error) for e, error in zip(FAR_STRAINS, errors, strict=True)}
    curve = Curve("strain", "tension [N/m]", (drawn.deformation, law), (drawn.deformation, drawn.load))
    error = float(np.abs(errors).max())
    return TrialResult(float(law[-1]), float(drawn.load[-1]), error, drawn.cost_ms, curve, figures=figures)


def _shear_forces(fabric: Fabric, angle: float, shears: np.ndarray) -> np.ndarray:
    """Forces per width that simple shear takes, the height at an angle to the warp and kept [N/m].

    St. Venant-Kirchhoff: P = F C (F^T F - I)/2. Off the axes shear pulls the sample too, so that it is no line.
    """
    c, s = math.cos(angle), math.sin(angle)
    # Strains (warp, weft, shear) along the fabric's axes of those along the sample's.
    turn = np.array([[c * c, s * s, -c * s], [s * s, c * c, c * s], [2.0 * c * s, -2.0 * c * s, c * c - s * s]])
    strains = np.stack([0.5 * shears**2, np.zeros_like(shears), shears])
    pull, _, slide = turn.T @ fabric.membrane_stiffness() @ turn @ strains
    return slide + shears * pull


def _bend_stiffness(fabric: Fabric, angle: float) -> float:
    """The model's own rule between warp and weft: the square of a mixed root."""
    return (
        math.sqrt(fabric.bend_warp) * math.cos(angle) ** 2 + math.sqrt(fabric.bend_weft) * math.sin(angle) ** 2
    ) ** 2


def _kawabata(setting: TrialSetting, instrument: str, direction: str) -> TrialResult:
    """Stiffness by a line through the curve, or thickness at 5 kPa; the error is the largest of its points."""
    measured: LoadCurve
    angle = DIRECTIONS[direction]
    if instrument == "compression":
        measured = compression_curve(setting, SOFT, PRESSURES)
        law = SOFT.thickness * (1.0 + measured.load / SOFT.compression) ** (-1.0 / 3.0)
        curve = Curve("pressure [Pa]", "thickness [m]", (measured.load, law), (measured.load, measured.deformation))
        error = float(np.abs(measured.deformation / law - 1.0).max())
        return TrialResult(float(law[-1]), float(measured.deformation[-1]), error, measured.cost_ms, curve)
    if instrument == "friction":
        found, cost = friction_coefficient(setting, WOVEN)
        return TrialResult.relative(WOVEN.friction, found, cost)
    if instrument == "tension":
        measured = tension_curve(setting, WOVEN, angle, STRAINS)
        own, labels = _elastic(WOVEN, angle) * measured.deformation, ("strain", "tension [N/m]")
    elif instrument == "shear":
        measured = shear_curve(setting, WOVEN, angle, SHEARS)
        own, labels = _shear_forces(WOVEN, angle, measured.deformation), ("shear [rad]", "shear force [N/m]")
    else:
        measured = bending_curve(setting, WOVEN, angle, CURVATURES)
        own, labels = _bend_stiffness(WOVEN, angle) * measured.deformation, ("curvature [1/m]", "moment [N]")
    design = measured.deformation / (measured.deformation @ measured.deformation)
    stiffness, line = float(design @ own), float(design @ measured.load)
    error = float(np.abs(measured.load / own - 1.0).max())
    curve = Curve(*labels, (measured.deformation, own), (measured.deformation, measured.load))
    return TrialResult(stiffness, line, error, measured.cost_ms, curve)


INSTRUMENTS = ("tension", "shear", "bending", "compression", "friction")
ROWS = (
    Row("tension", "strip pulled at an angle to the warp: E h [N/m]", _tension, 0.005, 0.02,
        {"angle_deg": Parameter("strip against warp [deg]", 0.0, 0.0, 180.0),
         "strain": Parameter("strain of the strip", 0.002, 1e-4, 0.1)},
        tuple({"angle_deg": a} for a in (0.0, 22.5, 45.0, 67.5, 90.0))),
    Row("tension_measured", "ten measured fabrics at 2, 5, 10 and 17 % strain against their own curves [N/m]",
        _tension_measured, 0.02, 0.05,
        {"fabric": ParameterChoice("measured fabric", CLOTHS[0], CLOTHS),
         "direction": ParameterChoice("of the sample", "warp", ("warp", "weft"))},
        tuple({"fabric": f, "direction": d} for f in CLOTHS for d in ("warp", "weft")),
        ("default", "fem-corotational/quasi-static")),
    Row("kawabata", "the fabric's own curves by Kawabata's instruments", _kawabata, 0.01, 0.05,
        {"instrument": ParameterChoice("instrument", "tension", INSTRUMENTS),
         "direction": ParameterChoice("of the sample", "warp", tuple(DIRECTIONS))},
        (*({"instrument": i, "direction": d} for i in INSTRUMENTS[:3] for d in DIRECTIONS),
         {"instrument": "compression"}, {"instrument": "friction"})),
)  # fmt: skip
