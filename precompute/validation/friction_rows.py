"""Rows of the validation table about internal friction: loops, creases, a swing that dry friction brakes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

from pbd import ClothMesh, Colliders, Fabric, Model, Solver, SolverOptions, State
from pbd.bending import bends_of
from pbd.xpbd.constraints import FRICTION_STIFFNESS
from precompute.experiment.measures import FRAME_RATE, TimedSteps, typical_ms
from precompute.experiment.sheets import level, triangulated, untethered
from precompute.validation.laboratory import DIRECTIONS, LoadCurve
from precompute.validation.loops import LOOPS, bending_loop, branches, loop_area, read_loop, shear_loop
from precompute.validation.trial import FABRIC, Curve, Specimen, Trial, TrialResult, TrialSetting, strip
from precompute.validation.validation_row import Parameter, ParameterChoice, Row

__all__ = ["ROWS", "laid_bending_loop", "laid_shear_loop", "rolled", "unordered"]

# Cotton broadcloth: B and 2HB; G and 2HG of a cotton cloth.
COTTON = replace(
    FABRIC, bend_warp=11.6e-6, bend_weft=11.6e-6, bend_hysteresis_warp=1.2e-3, bend_hysteresis_weft=1.2e-3,
    shear=40.0, shear_hysteresis=1.0,
)  # fmt: skip
CREASABLE = replace(COTTON, shear_hysteresis=0.0)
SMOOTH = replace(CREASABLE, bend_hysteresis_warp=0.0, bend_hysteresis_weft=0.0)
HEAVY = 1e9  # areal density of cloth that stays where it is laid [kg/m2]
TURNS = 8  # directions of the mesh over which a laid loop is the mean
SIDE = 0.04  # of a sheet that is laid [m]
LAID = SolverOptions(substep=1.0 / FRAME_RATE, gravity=(0.0, 0.0, 0.0), coarse_sweeps=0)
CREASE, SPAN = 0.3, 0.1  # place of the crease over the length, and length over which the sheet is bent, over it
CREASED_BY = math.radians(150.0)
LENGTH = 0.1  # of a strip that is creased [m]
PUSHED = 0.02  # by so much of the length its clamps come together
APART = 0.1  # by so much of the length wrinkles must lie apart to be two
SWUNG = 0.025  # length of the strip that swings [m]
AMPLITUDE = 0.05  # of its tip over the length
STEPS = 48  # of the default setting in a period
HALF_SWINGS = 4
LOST_EACH = 0.05  # part of the first amplitude that friction takes in each half swing


def unordered(side: float, count: int) -> Specimen:
    """A square sheet of about so many vertices without any order, from (0, 0) to (side, side) [m]."""
    points = np.random.default_rng(0).uniform(0.0, side, (count, 2))
    for _ in range(40):  # each goes to the middle of its faces
        faces, _ = triangulated(points)
        sums, used = np.zeros_like(points), np.bincount(faces.ravel(), minlength=count)
        for corner in range(3):
            np.add.at(sums, faces[:, corner], points[faces].mean(axis=1))
        points = np.clip(sums / used[:, None], 0.0, side)
    faces, twice_area = triangulated(points)
    used, faces = np.unique(faces[twice_area > 5e-7], return_inverse=True)
    return Specimen(points[used], faces.reshape(-1, 3).astype(np.int32), side / np.sqrt(count))


def rolled(specimen: Specimen, curvature: float, angle: float) -> np.ndarray:
    """The specimen on a cylinder of a curvature [1/m] with its axis at right angles to a direction [m]."""
    along = np.array([np.cos(angle), np.sin(angle)])
    s, t = specimen.flat @ along, specimen.flat @ np.array([-along[1], along[0]])
    turn = curvature * s
    x, up = (s, 0.0 * s) if curvature == 0.0 else (np.sin(turn) / curvature, (1.0 - np.cos(turn)) / curvature)
    flat = x[:, None] * along + t[:, None] * np.array([-along[1], along[0]])
    return np.stack([flat[:, 0], up, -flat[:, 1]], axis=1)


def _laid(
    specimen: Specimen,
    fabric: Fabric,
    path: np.ndarray,
    place: Callable[[float], np.ndarray],
    load: Callable[[Model, State, float], float],
) -> LoadCurve:
    """Loads of cloth so heavy that it stays where it is laid, given to the default solver at one place after the other.

    Args:
        specimen: the cloth; its x is the warp.
        fabric: SI values.
        path: deformations one after the other, shape (k,).
        place: where the cloth is laid at a deformation [m], shape (n, 3).
        load: that it then bears.
    """
    mesh = ClothMesh.from_pattern(level(specimen.flat), specimen.faces, specimen.flat[specimen.faces])
    model = untethered(mesh, replace(fabric, areal_density=HEAVY), bend_factor=None)
    state, steps, found = State.at_rest(model), TimedSteps(Solver(model, LAID).step, ()), []
    for at in path:
        state.position[:, :3] = place(at) - state.origin
        state.velocity[:] = 0.0
        steps(state, Colliders(), 1.0 / FRAME_RATE)
        found.append(load(model, state, at))
    return LoadCurve(np.array(path), np.array(found), typical_ms(steps.times))


def laid_bending_loop(specimen: Specimen, fabric: Fabric, angle: float, path: np.ndarray) -> LoadCurve:
    """Moment per width [N] of cloth that the default solver is given on one cylinder after the other.

    The moment is the work by which its hinges resist a change of the curvature, over that change and the area.

    Args:
        specimen: the cloth; its x is the warp.
        fabric: SI values.
        angle: of the direction that is bent to the warp [rad].
        path: curvatures one after the other [1/m], shape (k,).
    """

    def moment(model: Model, state: State, curvature: float) -> float:
        order, softness = model.hinge_numbers, model.hinge_data[:, 1, 1].astype(float)
        places = np.stack([rolled(specimen, c, angle) for c in (curvature, curvature + 0.1)])
        bends, more = bends_of(model.mesh, places)[:, order]
        rubbing = FRICTION_STIFFNESS * (bends - state.plastic_bends[order]) if model.plastic_count else 0.0 * bends
        return (((bends + rubbing) / softness) @ (more - bends)) / 0.1 / model.mesh.face_areas.sum()

    return _laid(specimen, fabric, path, lambda curvature: rolled(specimen, curvature, angle), moment)


def laid_shear_loop(specimen: Specimen, fabric: Fabric, path: np.ndarray) -> LoadCurve:
    """Shear force per width [N/m] of cloth that the default solver is given at one shear after the other.

    The weft turns against the warp and keeps its length, so that nothing but the shear is strained.

    Args:
        specimen, fabric: see :func:`laid_bending_loop`.
        path: angles one after the other [rad], shape (k,).
    """
    x, y, z = level(specimen.flat).T

    def force(model: Model, state: State, angle: float) -> float:
        rubbing = FRICTION_STIFFNESS * (np.sin(angle) - state.plastic_shears) if model.plastic_shear_count else 0.0
        stress = fabric.shear * (np.sin(angle) + rubbing) * np.ones(len(model.triangles))
        return float(np.cos(angle) * model.mesh.face_areas @ stress / model.mesh.face_areas.sum())

    place = lambda angle: np.stack([x - np.sin(angle) * z, y, np.cos(angle) * z], axis=1)  # noqa: E731
    return _laid(specimen, fabric, path, place, force)


@cache
def _turned(count: int, turn: int) -> Specimen:
    specimen = unordered(SIDE, count)
    angle = math.pi * turn / TURNS
    cosine, sine = math.cos(angle), math.sin(angle)
    return replace(specimen, flat=specimen.flat @ np.array([[cosine, sine], [-sine, cosine]]))


def _measured_loop(setting: TrialSetting, fabric: Fabric, instrument: str, angle: float) -> LoadCurve | None:
    """None for a solver with which no loop can be measured."""
    path = LOOPS[instrument].path
    if setting.timeless:
        return {"bending_loop": bending_loop, "shear_loop": shear_loop}[instrument](setting, fabric, angle, path)
    if setting.solver != "default":
        return None
    samples = [_turned(setting.edges**2, turn) for turn in range(TURNS)]
    if instrument == "shear_loop":
        loops = [laid_shear_loop(sample, fabric, path) for sample in samples[:1]]
    else:
        loops = [laid_bending_loop(sample, fabric, angle, path) for sample in samples]
    return LoadCurve(path, np.mean([loop.load for loop in loops], axis=0), loops[-1].cost_ms)


def _hysteresis(setting: TrialSetting, loop: str, direction: str, weft: float) -> TrialResult:
    """The loop's area, slope and widths against the fabric's own; the error is the largest of them."""
    fabric = replace(COTTON, bend_weft=weft * COTTON.bend_warp, bend_hysteresis_weft=weft * COTTON.bend_hysteresis_warp)
    instrument, share = f"{loop}_loop", weft if direction == "weft" else 1.0
    curve = _measured_loop(setting, fabric, instrument, DIRECTIONS[direction])
    if curve is None:
        return TrialResult.lost("loops are measured with the default solver and with those without time")
    if loop == "bending":
        stiffness, width, names = share * fabric.bend_warp, share * fabric.bend_hysteresis_warp, ("B", "2HB")
    else:
        stiffness, width, names = fabric.shear, fabric.shear_hysteresis, ("G", "2HG", "2HG5")
    far = LOOPS[instrument].far
    # A parallelogram: the element sticks until the deformation at which it slips.
    own = 2.0 * width * (far - 0.5 * width / (FRICTION_STIFFNESS * stiffness))
    reading, area = read_loop(curve, instrument, direction), loop_area(curve, instrument, direction)
    found = dict(zip(names, (reading.stiffness, *reading.widths), strict=True))
    figures = {"loop area over the fabric's": area / own}
    figures |= {f"{name} over the fabric's": v / (stiffness if name in "BG" else width) for name, v in found.items()}
    rising, falling = branches(curve, instrument, direction)
    x = np.array([-far, far, far, -far, -far])
    sides = np.array([-1.0, 1.0, -1.0, -1.0, 1.0]) * 0.5 * width + stiffness * x
    drawn = np.concatenate([rising, falling[:, ::-1]], axis=1)
    error = max(abs(value - 1.0) for value in figures.values())
    picture = Curve("curvature [1/m]" if loop == "bending" else "shear [rad]", "load", (x, sides), (drawn[0], drawn[1]))
    return TrialResult(own, area, error, curve.cost_ms, picture, figures=figures)


def _creases(setting: TrialSetting) -> TrialResult:
    """Place of the wrinkle over the length, of a sheet that was creased at another place than it wrinkles by itself."""
    rubbed, cost = _wrinkle(setting, CREASABLE)
    smooth, _ = _wrinkle(setting, SMOOTH)
    place = rubbed if abs(smooth - CREASE) > APART else math.nan
    figures = {"wrinkle without friction, over the length": smooth}
    return TrialResult(CREASE, place, abs(place - CREASE), cost, figures=figures)


def _wrinkle(setting: TrialSetting, fabric: Fabric) -> tuple[float, float]:
    """Place of the largest curvature over the length after creasing and pushing, and the cost of a frame [ms].

    The sheet is bent about its crease, the rest of it flat, and made flat again; then its clamps come together.
    """
    specimen = strip(LENGTH, 0.2 * LENGTH, setting.edges, clamp=1)
    x = specimen.flat[:, 0]
    clamps = (x < 1e-9) | (x > LENGTH - 1.5 * specimen.edge)
    low, high = (CREASE - 0.5 * SPAN) * LENGTH, (CREASE + 0.5 * SPAN) * LENGTH
    weightless = (0.0, 0.0, 0.0)
    plates = ((x < low + 1e-9) | (x > high - 1e-9)) if setting.timeless else clamps
    heavy = fabric if setting.timeless else replace(fabric, areal_density=HEAVY)
    bending = Trial(specimen, level(specimen.flat), heavy, plates, replace(setting, substeps=1), weightless)
    turns = np.linspace(0.0, CREASED_BY, 16)
    for turn in (*turns[1:], *turns[-2::-1]):
        bending.lay(_folded(specimen, low, high, turn))
    trial = Trial(specimen, level(specimen.flat), fabric, clamps, setting, weightless)
    for name in ("plastic_bends", "plastic_curvatures", "plastic_shears"):
        getattr(trial.state, name)[:] = getattr(bending.state, name)
    start = level(specimen.flat)
    bump = 1e-3 * LENGTH * np.where(clamps, 0.0, np.sin(math.pi * np.clip(x / LENGTH, 0.0, 1.0)) ** 2)
    trial.state.position[:, 1] += bump.astype(np.float32)
    for share in np.linspace(0.0, PUSHED, 11)[1:]:
        moved = start.copy()
        moved[x > LENGTH - 1.5 * specimen.edge, 0] -= share * LENGTH
        _rest(trial, moved[trial.model.held])
    return _most_curved(specimen, trial.world()), trial.cost_ms


def _rest(trial: Trial, targets: np.ndarray) -> None:
    """Clamps go to their targets, and the cloth comes to rest."""
    trial.frame(targets)
    for _ in range(0 if trial.setting.timeless else 60):
        trial.state.velocity *= np.float32(0.8)
        trial.frame()


def _folded(specimen: Specimen, low: float, high: float, turn: float) -> np.ndarray:
    """Places of the strip with an arc from ``low`` to ``high`` that turns it by an angle, and flat beside it [m]."""
    x, y = specimen.flat.T
    s = np.clip(x - low, 0.0, high - low)
    angle, beyond = turn * s / (high - low), x - low - s
    along = s * np.sinc(angle / math.pi) + np.where(beyond > 0.0, beyond * math.cos(turn), beyond)
    up = 0.5 * s * angle * np.sinc(0.5 * angle / math.pi) ** 2 + np.maximum(beyond, 0.0) * math.sin(turn)
    return np.stack([low + along, up, -y], axis=1)


def _most_curved(specimen: Specimen, places: np.ndarray) -> float:
    """Middle of the most curved part of a strip over its length: where it bends by more than half of its most."""
    x = specimen.flat[:, 0]
    at = np.arange(0.1, 0.9001, 0.01) * LENGTH
    reach = 1.5 * specimen.edge
    bends = []
    for middle in at:
        near = np.abs(x - middle) < reach
        bends.append(np.linalg.norm(np.polyfit(x[near] - middle, places[near, :2], 2)[0]))
    bends = np.array(bends)
    best = int(np.argmax(bends))
    strong = bends > 0.5 * bends[best]
    left, right = best, best
    while left > 0 and strong[left - 1]:
        left -= 1
    while right < len(at) - 1 and strong[right + 1]:
        right += 1
    part = slice(left, right + 1)
    return float(at[part] @ bends[part] / bends[part].sum() / LENGTH)


def _dry_damping(setting: TrialSetting) -> TrialResult:
    """Amplitude after some half swings; the error is the largest distance of a peak from the line, over its whole fall.

    A strip in its first mode phi loses the energy 2 H int |phi''| A in each half swing, with the moment of friction
    H = 2HB/2. Its energy is omega^2 rho_A int phi^2 A^2 / 2, so that A falls by the same length each time. Friction
    sticks near the end alone, where hardly anything bends.
    """
    edges = max(4, setting.edges // 2)
    density, width, step = FABRIC.areal_density, 3.0 * SWUNG / edges, SolverOptions().substep
    root = 1.875104068711961  # cos x cosh x = -1
    omega = 2.0 * math.pi / (STEPS * step)
    bend = density * omega**2 * (SWUNG / root) ** 4
    fall = LOST_EACH * AMPLITUDE * SWUNG
    # With phi = 1 at the tip phi'(L) = 1.376506/L and int phi^2 = L/4.
    moment = fall * omega**2 * density * SWUNG**2 / (8.0 * _mode(root, 1)(1.0))
    fabric = replace(
        FABRIC, poisson=0.0, bend_warp=bend, bend_weft=bend,
        bend_hysteresis_warp=2.0 * moment, bend_hysteresis_weft=2.0 * moment,
    )  # fmt: skip
    specimen = strip(SWUNG, width, edges, clamp=1)
    x, y = specimen.flat.T
    s = np.linspace(0.0, 1.0, 1001)
    angle = AMPLITUDE * _mode(root, 1)(s)
    way = [np.concatenate([[0.0], np.cumsum(0.5 * (f[1:] + f[:-1])) / 1000.0]) for f in (np.cos(angle), np.sin(angle))]
    at = np.clip(x / SWUNG, 0.0, None)
    along, up = (SWUNG * np.interp(at, s, part) for part in way)
    start = np.stack([along + np.minimum(x, 0.0), up, -y], axis=1)
    trial = Trial(specimen, level(specimen.flat), fabric, x < 1e-9, setting, (0.0, 0.0, 0.0))
    trial.state.position[:, :3] = start - trial.state.origin
    tip, times, heights, now = x > SWUNG - 1e-9, [0.0], [float(start[x > SWUNG - 1e-9, 1].mean())], 0.0
    while now < (HALF_SWINGS + 0.5) * math.pi / omega:
        trial.frame(dt=step)
        now += step
        times.append(now)
        heights.append(float(trial.world()[tip, 1].mean()))
    peaks = _peaks(np.array(heights))[: HALF_SWINGS + 1] / SWUNG
    if len(peaks) <= HALF_SWINGS:
        return TrialResult(AMPLITUDE, math.nan, math.nan, trial.cost_ms)
    line = peaks[0] - LOST_EACH * AMPLITUDE * np.arange(HALF_SWINGS + 1)
    error = float(np.abs(peaks - line).max() / (line[0] - line[-1]))
    half = HALF_SWINGS // 2
    figures = {"loss of the second half over the first": float((peaks[half] - peaks[-1]) / (peaks[0] - peaks[half]))}
    turns = np.arange(HALF_SWINGS + 1.0)
    curve = Curve("half swings", "amplitude / L", (turns, line), (turns, peaks))
    return TrialResult(float(line[-1]), float(peaks[-1]), error, trial.cost_ms, curve, figures=figures)


def _mode(root: float, derivative: int) -> Callable[[np.ndarray | float], np.ndarray]:
    """A derivative of the first mode of a clamped strip by s/L, 1 at its tip."""
    share = (math.cosh(root) + math.cos(root)) / (math.sinh(root) + math.sin(root))
    sums = [
        lambda z: np.cosh(z) - np.cos(z) - share * (np.sinh(z) - np.sin(z)),
        lambda z: np.sinh(z) + np.sin(z) - share * (np.cosh(z) - np.cos(z)),
    ]
    size = float(sums[0](root))
    return lambda s: root**derivative * sums[derivative](root * np.asarray(s)) / size


def _peaks(heights: np.ndarray) -> np.ndarray:
    """Sizes of the first height and of all turning points, by a parabola through three samples."""
    before, at, after = heights[:-2], heights[1:-1], heights[2:]
    turning = np.flatnonzero((at - before) * (after - at) < 0.0)
    before, at, after = before[turning], at[turning], after[turning]
    found = at - (after - before) ** 2 / (8.0 * (after - 2.0 * at + before))
    return np.abs(np.concatenate([heights[:1], found]))


# No row is run on a finer mesh: loops are laid on a mesh that is given, and the other two have no need of one.
LOOP_SOLVERS = ("default", "fem-stvk/quasi-static")
ROWS = (
    Row("hysteresis", "loops of bending and shear: area [J/m2], slope and widths against the fabric's own",
        _hysteresis, 0.02, 0.05,
        {"loop": ParameterChoice("what is measured", "bending", ("bending", "shear")),
         "direction": ParameterChoice("of the sample", "warp", ("warp", "weft")),
         "weft": Parameter("B and 2HB of the weft over those of the warp", 1.0, 0.1, 10.0)},
        ({"loop": "shear"}, {"loop": "bending"}, {"loop": "bending", "weft": 0.5},
         {"loop": "bending", "direction": "weft", "weft": 0.5}), LOOP_SOLVERS, refines=False),
    Row("creases", "sheet creased, made flat and pushed together: place of its wrinkle over the length",
        _creases, 0.02, 0.05, best_solvers=LOOP_SOLVERS, refines=False),
    Row("dry_damping", "strip that swings: amplitude over the length after 4 half swings, against the line of dry "
        "friction", _dry_damping, 0.02, 0.05, best_solvers=("default", "fem-stvk/midpoint"), refines=False),
)  # fmt: skip
