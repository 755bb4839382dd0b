"""Rows of the validation table about contact and friction: a slope and a cylinder."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from pbd import Body, Capsule, Colliders, Plane
from pbd.models import StepError
from precompute.experiment.measures import FRAME_RATE
from precompute.experiment.sheets import level
from precompute.validation.membrane_rows import ROPE
from precompute.validation.strip_references import capstan_ratio
from precompute.validation.trial import FABRIC, Trial, TrialResult, TrialSetting, strip
from precompute.validation.validation_row import Parameter, ParameterChoice, Row

__all__ = ["ROWS"]

MOVING = ("default", "fem-stvk/implicit-euler")
SLIPPED = 1e-3  # way down a slope in half a second that is no creep [m]


@dataclass
class _OnMesh(Trial):
    """A trial on a body that stands still.

    Attributes:
        surface: its vertices [m], shape (b, 3), and faces.
    """

    surface: tuple[np.ndarray, np.ndarray] = field(default_factory=lambda: (np.zeros((0, 3)), np.zeros((0, 3), int)))

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.setting.solver != "default":
            raise StepError("knows no body mesh", self.setting.solver)
        vertices, faces = self.surface
        self._body = Body(faces, len(vertices))
        self._body.origin = self.state.origin.copy()
        self._body.place((vertices - self.state.origin).astype(np.float32))
        self.colliders = Colliders((), self._body)

    def frame(self, targets: np.ndarray | None = None, *, dt: float = 1.0 / FRAME_RATE) -> None:
        self.solver.follow(self.state, self.colliders)
        self._body.advance((self.surface[0] - self.state.origin).astype(np.float32))
        super().frame(targets, dt=dt)


def _wall(columns: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A surface spanned by a curve, shape (c, 3), moved to each of the ways, shape (r, 3): vertices and faces."""
    vertices = (columns[:, None] + rows[None]).reshape(-1, 3)
    corner = (np.arange(len(columns) - 1)[:, None] * len(rows) + np.arange(len(rows) - 1)).reshape(-1, 1)
    step = len(rows)
    faces = np.concatenate([corner + [0, step, 1], corner + [1, step, step + 1]])
    return vertices, faces


def _on_slope(setting: TrialSetting, mu: float, angle: float, mesh: bool) -> Trial:
    """A sheet of 20 cm that lies on a slope."""
    specimen = strip(0.2, 0.2, setting.edges, clamp=0)
    fabric = replace(FABRIC, friction=mu)
    cosine, sine = math.cos(angle), math.sin(angle)
    lying = level(specimen.flat) + [0.0, fabric.thickness, 0.0]
    turned = lying @ np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    if mesh:
        along = np.arange(-1.0, 0.4, 0.03)[:, None] * [cosine, sine, 0.0]
        surface = _wall(along, np.arange(0.2, -0.45, -0.03)[:, None] * [0.0, 0.0, 1.0])
        return _OnMesh(specimen, turned, fabric, np.zeros(0, int), setting, surface=surface)
    slope = Colliders([Plane((0.0, 0.0, 0.0), (-sine, cosine, 0.0))])
    return Trial(specimen, turned, fabric, np.zeros(0, int), setting, colliders=slope)


def _slid(trial: Trial, seconds: float) -> float:
    """Greatest way of a vertex [m]."""
    start = trial.world()
    for _ in range(round(seconds * FRAME_RATE)):
        trial.frame()
    return float(np.linalg.norm(trial.world() - start, axis=1).max())


def _incline(setting: TrialSetting, quantity: str, mu: float, collider: str) -> TrialResult:
    """The angle at which it slips [deg], or how far it creeps in a minute half a degree below [mm]."""
    steepest = math.atan(mu)
    if quantity == "creep":
        trial = _on_slope(setting, mu, steepest - math.radians(0.5), collider == "mesh")
        way = 1e3 * _slid(trial, 60.0)
        return TrialResult(0.0, way, way / 1.0, trial.cost_ms)
    low, high, cost = 0.0, 0.5 * math.pi, math.nan
    while high - low > math.radians(0.05):
        middle = 0.5 * (low + high)
        trial = _on_slope(setting, mu, middle, collider == "mesh")
        low, high = (low, middle) if _slid(trial, 0.5) > SLIPPED else (middle, high)
        cost = trial.cost_ms
    found = math.degrees(0.5 * (low + high))
    return TrialResult(math.degrees(steepest), found, abs(found - math.degrees(steepest)), cost)


def _capstan(setting: TrialSetting, mu: float, wrap_deg: float, collider: str) -> TrialResult:
    """A belt without weight, stretched by 2 %, drawn 2 cm over a cylinder; tension by the strain of its legs."""
    radius, leg, wrap = 0.05, 0.15, math.radians(wrap_deg)
    fabric = replace(ROPE, friction=mu, thickness=1e-3)
    round_it = radius + fabric.thickness
    length = 2.0 * leg + round_it * wrap
    specimen = strip(length, 2.0 * length / setting.edges, setting.edges, clamp=0)
    s, across = specimen.flat[:, 0] - 0.5 * length, specimen.flat[:, 1]
    turn = np.clip(s / round_it, -0.5 * wrap, 0.5 * wrap)
    beyond = s - turn * round_it
    x = round_it * np.sin(turn) + beyond * np.cos(turn)
    y = round_it * np.cos(turn) - beyond * np.sin(turn)
    start = np.stack([x, y, across], axis=1)
    ends = np.abs(s) > 0.5 * length - 1e-9
    if collider == "mesh":
        around = np.linspace(-2.5, -0.5, 129)[:, None] * math.pi  # outside out; its seam is where no belt lies
        circle = radius * np.concatenate([np.cos(around), np.sin(around), 0.0 * around], axis=1)
        surface = _wall(circle, np.arange(-0.06, 0.061, 0.01)[:, None] * [0.0, 0.0, 1.0])
        trial: Trial = _OnMesh(specimen, start, fabric, ends, setting, (0.0, 0.0, 0.0), surface=surface)
    else:
        capsule = Colliders([Capsule((0.0, 0.0, -1.0), (0.0, 0.0, 1.0), radius)])
        trial = Trial(specimen, start, fabric, ends, setting, (0.0, 0.0, 0.0), colliders=capsule)
    held = trial.model.held
    # Away from the cylinder along both legs for 2 %, then after the right end.
    out = np.sign(s[held])[:, None] * np.stack(
        [np.full(len(held), math.cos(0.5 * wrap)), -np.sign(s[held]) * math.sin(0.5 * wrap), np.zeros(len(held))],
        axis=1,
    )
    keep = np.float32(0.9)
    frames, ratios = 180, []
    legs = [(sign * s > 0.5 * round_it * wrap + 0.04) & (sign * s < 0.5 * length - 0.02) for sign in (1.0, -1.0)]
    for frame in range(2 * frames):
        pull = 0.01 * length * min(1.0, (frame + 1) / frames)
        draw = 0.02 * max(0.0, (frame + 1) / frames - 1.0)
        trial.frame(start[held] + out * (pull + draw * np.sign(s[held]))[:, None])
        trial.state.velocity[:] *= keep if frame < frames else np.float32(1.0)
        if frame >= 1.8 * frames:
            strains = [_strain(trial.world()[leg_], s[leg_]) for leg_ in legs]
            ratios.append(strains[0] / strains[1])
    return TrialResult.relative(capstan_ratio(mu, wrap), float(np.mean(ratios)), trial.cost_ms)


def _strain(places: np.ndarray, s: np.ndarray) -> float:
    """Strain of a straight leg: way per length along the belt, less one."""
    design = np.stack([s, np.ones_like(s)], axis=1)
    return float(np.linalg.norm(np.linalg.lstsq(design, places, rcond=None)[0][0]) - 1.0)


MU = Parameter("coefficient of friction", 0.4, 0.01, 2.0)
COLLIDER = ParameterChoice("plane or capsule, or a body mesh", "primitive", ("primitive", "mesh"))
ROWS = (
    Row("incline", "sheet on a slope: angle at which it slips [deg]; creep in a minute half a degree below [mm]",
        _incline, 0.2, 1.0, {"quantity": ParameterChoice("what is measured", "angle", ("angle", "creep")), "mu": MU,
                             "collider": COLLIDER},
        tuple({"quantity": q, "collider": c} for c in COLLIDER.allowed for q in ("angle", "creep")), MOVING),
    Row("capstan", "belt drawn over a cylinder: ratio of its tensions", _capstan, 0.02, 0.05,
        {"mu": Parameter("coefficient of friction", 0.2, 0.01, 1.0),
         "wrap_deg": Parameter("angle of wrap [deg]", 180.0, 10.0, 300.0),
         "collider": COLLIDER},
        tuple({"mu": m, "wrap_deg": w, "collider": c}
              for c in COLLIDER.allowed for m, w in ((0.2, 180.0), (0.4, 90.0))), MOVING),
)  # fmt: skip
