"""Fourteen runs that break cloth engines: stiff cloth, long frames, a corner that jumps, cloth squeezed at the start.

A square of 1 m, 0.2 kg/m2 and 32 by 32 vertices hangs by two corners for five seconds; what other engines came to on
such a square is quoted in :data:`QUOTED`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pbd import Colliders, Fabric, InputError, State, build_model
from pbd.models.registry import make_solver
from precompute.experiment.measures import FRAME_RATE, TimedSteps, elongation, typical_ms
from precompute.experiment.swinging_square import STIFF, hanging_square

__all__ = ["QUOTED", "RUNS", "StressRun", "stress_figures", "stress_rows", "stress_text"]

SIDE = 32  # vertices
SECONDS = 5.0  # of a run; the corner jumps after the first
MOST_STRETCH = 0.2  # of the worst face, median over the last second [-]
FURTHEST = 10.0  # cloth that is further from where it hangs has exploded [m]
VERDICTS = ("ok", "stretched", "exploded")
NUDGE = 1e-7  # standard deviation of what moves the vertices of one start from those of another [m]
BUDGET = 0.25  # of a frame's own length that its computation may take [-]
FABRIC = replace(STIFF, bend_warp=1e-5, bend_weft=1e-5, air_drag=1.0)
# Engine: runs that ended well, over 20 % stretched, exploded; 2026-11-21.
QUOTED: Mapping[str, tuple[int, int, int]] = {
    "MuJoCo elastic flex": (13, 1, 0),
    "Newton Style3D (implicit)": (12, 2, 0),
    "Blender": (10, 4, 0),
    "PositionBasedDynamics XPBD (20 iterations)": (3, 11, 0),
    "Newton VBD": (3, 10, 1),
    "Genesis PBD": (3, 10, 1),
    "Newton XPBD": (1, 3, 10),
    "PyBullet": (1, 0, 13),
    "Taichi mass-spring example": (3, 0, 11),
    "Newton semi-implicit": (0, 0, 14),
}


@dataclass(frozen=True)
class StressRun:
    """One of the runs.

    Attributes:
        name: of the run.
        fabric: of the square.
        dt: length of a frame [s].
        start: from the square's vertices, about the middle of its upper side, to those that it starts with [m].
        jumps: whether a pinned corner is moved by 1 m in one frame, about the other one by 60 deg: no further than the
            cloth's own length.
        starts: where rounding errors alone decide how the cloth lies in the end, the run is made from this many starts
            that differ by less than a micrometre, and its stretch is the median of theirs.
    """

    name: str
    fabric: Fabric = FABRIC
    dt: float = 1.0 / FRAME_RATE
    start: Callable[[np.ndarray], np.ndarray] = np.array
    jumps: bool = False
    starts: int = 1


def _stiffness(stretch: float) -> Fabric:
    return replace(FABRIC, stretch_warp=stretch, stretch_weft=stretch, shear=0.375 * stretch)


RUNS: Sequence[StressRun] = (
    *(StressRun(f"E h 1e{power} N/m", _stiffness(10.0**power)) for power in range(2, 9)),
    *(StressRun(f"frames of 1/{rate} s", dt=1.0 / rate) for rate in (30, 20, 15, 10)),
    StressRun("a pinned corner jumps by 1 m", jumps=True),
    StressRun("starts on a line", start=lambda x: x * [1.0, 0.0, 0.0], starts=15),
    StressRun("starts ten times compressed", start=lambda x: 0.1 * x),
)


def stress_rows(
    solver: str = "default",
    *,
    names: Sequence[str] = (),
    seconds: float = SECONDS,
    report: Callable[[str], None] | None = None,
) -> list[dict[str, Any]]:
    """A row of each run: ``run``, ``solver``, ``verdict``, ``worst_stretch``, ``frame_ms``, ``budget_ms``.

    The verdict is "ok" (finite, within 10 m, the worst face stretched by at most 20 % along warp or weft in the median
    over the last second), "stretched" or "exploded". The default solver is asked with its default options.

    Args:
        solver: a key of :data:`pbd.models.registry.SOLVERS`.
        names: of the runs; all where none is named.
        seconds: length of each run [s].
        report: gets lines of progress.

    Raises:
        InputError: no such solver or run.
    """
    known = [run.name for run in RUNS]
    for name in names:
        if name not in known:
            raise InputError("no such run", key="NAME", received=name, expected=", ".join(known))
    rows = []
    for run in RUNS:
        if not names or run.name in names:
            if report is not None:
                report(f"{solver}: {run.name}")
            rows.append(_row(run, solver, seconds))
    return rows


def stress_figures(rows: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Numbers of runs by verdict, and of those whose median frame took longer than its budget [-]."""
    return {f"{verdict}_runs": float(sum(row["verdict"] == verdict for row in rows)) for verdict in VERDICTS} | {
        "over_budget_runs": float(sum(row["frame_ms"] > row["budget_ms"] for row in rows))
    }


def stress_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """The rows as a table, and below it the verdicts of other engines on all runs."""
    lines = [f"{'run':<30}{'verdict':<12}{'stretch [%]':>11}{'frame [ms]':>12}{'budget [ms]':>13}"]
    for row in rows:
        stretch = f"{100.0 * row['worst_stretch']:.1f}" if np.isfinite(row["worst_stretch"]) else "-"
        times = f"{row['frame_ms']:>12.3g}{row['budget_ms']:>13.3g}"
        lines.append(f"{row['run']:<30}{row['verdict']:<12}{stretch:>11}{times}")
    counts = {row["solver"]: [0, 0, 0] for row in rows}
    for row in rows:
        counts[row["solver"]][VERDICTS.index(row["verdict"])] += 1
    lines += ["", f"{'engine (others: quoted)':<46}" + "".join(f"{verdict:>11}" for verdict in VERDICTS)]
    for name, numbers in {**counts, **QUOTED}.items():
        lines.append(f"{name:<46}" + "".join(f"{number:>11}" for number in numbers))
    return "\n".join(lines)


def _row(run: StressRun, solver: str, seconds: float) -> dict[str, Any]:
    ends = [_end(run, solver, seconds, seed) for seed in range(run.starts)]
    worst = float(np.median([stretch for stretch, _ in ends]))
    verdict = "ok" if worst <= MOST_STRETCH else "stretched"
    return {
        "run": run.name,
        "solver": solver,
        "verdict": verdict if np.isfinite([stretch for stretch, _ in ends]).all() else "exploded",
        "worst_stretch": worst,
        "frame_ms": typical_ms([time for _, times in ends for time in times], np.inf),
        "budget_ms": 1e3 * BUDGET * run.dt,
    }


def _end(run: StressRun, solver: str, seconds: float, seed: int) -> tuple[float, list[float]]:
    """Stretch of the worst face over the last second [-], infinite if the cloth exploded, and times of frames [s]."""
    square = hanging_square(SIDE)
    model = build_model(square.mesh, run.fabric, square.held, bend_factor=1 / 3)
    nudge = NUDGE * np.random.default_rng(seed).standard_normal(square.mesh.vertices.shape) if seed else 0.0
    state, colliders = State.at_rest(model, run.start(square.mesh.vertices) + nudge), Colliders()
    targets, inverse_flat = state.world()[model.held], np.linalg.inv(model.mesh.flat)
    stretch, frame = [], TimedSteps(make_solver(solver, model).step)
    if not frame(state.copy(), colliders, run.dt):
        return np.inf, []
    frame.times.clear()  # it compiled
    for number in range(round(seconds / run.dt)):
        if run.jumps and number == round(1.0 / run.dt):
            targets[0] = [0.0, 0.0, np.sin(np.pi / 3)]
        if not frame(state, colliders, run.dt, targets) or not np.abs(state.world()).max() < FURTHEST:
            return np.inf, frame.times
        stretch.append(float(elongation(state.world(), model.mesh.faces, inverse_flat).max()) - 1.0)
    return float(np.median(stretch[-round(1.0 / run.dt) :])), frame.times
