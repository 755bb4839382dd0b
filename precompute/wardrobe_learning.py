"""`gube precompute --all`: many wrinkle databases, and a page that shows the worst first."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import BrokenExecutor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from assets.io.scene import Scene, scene_text
from pbd.errors import InputError
from pbd.storage import replacing
from precompute.learning.options import LearningOptions
from precompute.learning.pipeline import DEFAULT, precompute
from precompute.learning.stages import counted
from precompute.reporting.html_page import Section, Table, Text, write_page
from precompute.scratch import scratch_folder
from precompute.workers import Workers
from wrinkles.database import code_version
from wrinkles.database_file import read_database

__all__ = ["GarmentOutcome", "learn_wardrobe", "wardrobe_rows", "wardrobe_text", "write_wardrobe"]

WORST_BY = "spectrum_band_error_max"  # the largest error of an octave of bending energy
COLUMNS = {  # figures of a database, and what they are called on the page
    WORST_BY: "worst octave",
    "floor_spectrum_band_error_max": "floor",
    "bending_energy_ratio": "energy",
    "normal_skill": "skill",
    "inside_body_percent": "inside [%]",
    "deepest_mm": "deepest [mm]",
    "frame_ms_p50": "frame [ms]",
}


@dataclass(frozen=True)
class GarmentOutcome:
    """What came of one database.

    Attributes:
        name: of the scene.
        problem: why there is none, empty where there is one.
        minutes: that it took; 0 for one that was there.
        figures: its quality by name.
    """

    name: str
    problem: str = ""
    minutes: float = 0.0
    figures: Mapping[str, float] = field(default_factory=dict)


def learn_wardrobe(
    scenes: Mapping[str, Scene],
    output: Path,
    cache: Path,
    workers: Workers,
    report: Callable[[str], None],
    options: LearningOptions = DEFAULT,
) -> list[GarmentOutcome]:
    """Learn a database from each scene; one that fails does not stop the others.

    A database that is there, of the same scene and code, is kept. Where at least as many are left as there are workers,
    and these see the scenes' files, each worker learns whole ones; else they come one after the other, and all workers
    share the work of each.

    Args:
        scenes: by their names.
        output: folder of the databases, ``NAME.h5``.
        cache: folder of simulated runs.
        workers: that simulate and learn.
        report: called with lines of progress.
        options: how much is done.

    Returns:
        outcomes in the order of the scenes.

    Raises:
        concurrent.futures.BrokenExecutor: the workers are gone.
    """
    found = {name: one for name, scene in scenes.items() if (one := _there(name, scene, output)) is not None}
    left = {name: scene for name, scene in scenes.items() if name not in found}
    report(f"{len(found)} of {len(scenes)} databases are there")
    tell = counted(report, "databases", len(left))
    if len(left) < workers.count or workers.count == 1 or not workers.sees_files:
        for done, (name, scene) in enumerate(left.items(), 1):
            told = lambda line, name=name: report(f"{name}: {line}")  # noqa: E731
            found[name] = _stored(_learned(name, scene, cache, options, workers, told), output)
            tell(done, None)
    else:
        jobs = [partial(_learned, name, scene, cache, options) for name, scene in left.items()]

        def store(done: int, result: tuple[GarmentOutcome, bytes]) -> None:
            found[result[0].name] = _stored(result, output)
            tell(done, None)

        workers.run(jobs, done=store)
    return [found[name] for name in scenes]


def _there(name: str, scene: Scene, output: Path) -> GarmentOutcome | None:
    """The outcome of a database that was learned before from the same scene by the same code."""
    try:
        database = read_database(output / f"{name}.h5")
    except InputError:  # there is none, or an older one
        return None
    if database.scene != scene_text(scene) or database.code_version != code_version():
        return None
    return GarmentOutcome(name, figures=dict(database.quality))


def _learned(
    name: str,
    scene: Scene,
    cache: Path,
    options: LearningOptions,
    workers: Workers | int = 1,
    report: Callable[[str], None] | None = None,
) -> tuple[GarmentOutcome, bytes]:
    """The outcome, and the database as the bytes of its file, since a worker may be on another machine."""
    began = time.monotonic()
    with scratch_folder() as folder:
        path = folder / f"{name}.h5"
        try:
            made = precompute(scene, path, cache=cache, workers=workers, report=report, options=options)
        except InputError as error:
            return GarmentOutcome(name, str(error)), b""
        except BrokenExecutor:  # the others have no workers either
            raise
        except Exception:  # noqa: BLE001 - the others shall go on
            return GarmentOutcome(name, traceback.format_exc()), b""
        minutes = (time.monotonic() - began) / 60.0
        return GarmentOutcome(name, minutes=minutes, figures=dict(made.database.quality)), path.read_bytes()


def _stored(result: tuple[GarmentOutcome, bytes], output: Path) -> GarmentOutcome:
    outcome, content = result
    if not outcome.problem:
        with replacing(output / f"{outcome.name}.h5") as beside:
            beside.write_bytes(content)
    return outcome


def worst_first(outcomes: Sequence[GarmentOutcome]) -> list[GarmentOutcome]:
    """Those without a database, then by the largest error of an octave."""
    return sorted(outcomes, key=lambda one: (not one.problem, -one.figures.get(WORST_BY, float("inf"))))


def wardrobe_rows(outcomes: Sequence[GarmentOutcome]) -> list[dict[str, float | str]]:
    """A row for each database, the worst first."""
    return [
        {"database": one.name, "problem": one.problem, "minutes": one.minutes}
        | {name: one.figures.get(name, float("nan")) for name in COLUMNS}
        for one in worst_first(outcomes)
    ]


def wardrobe_text(outcomes: Sequence[GarmentOutcome]) -> str:
    """A line for each database, the worst first."""
    width = max(len(one.name) for one in outcomes)
    lines = []
    for one in worst_first(outcomes):
        said = f"worst octave {one.figures[WORST_BY]:.2f}" if one.figures else "not judged: no motion is held out"
        lines.append(f"{one.name:<{width}}  {one.problem.strip().splitlines()[-1] if one.problem else said}")
    return "\n".join(lines)


def _cells(outcome: GarmentOutcome) -> list[str]:
    """A row of the page; a dash where there is no figure."""
    values = [outcome.minutes or None, *(outcome.figures.get(name) for name in COLUMNS)]
    return [outcome.name, *("-" if value is None else f"{value:.3g}" for value in values)]


def write_wardrobe(path: Path, outcomes: Sequence[GarmentOutcome]) -> None:
    """Write the page."""
    failed = [one for one in outcomes if one.problem]
    sections: list[Section] = [
        Text(
            f"{len(outcomes) - len(failed)} of {len(outcomes)} databases were learned. The worst come first, by the "
            "largest error of an octave of bending energy on motion that nothing was learned from; floor is the same "
            "of a second true run, energy is bending energy over the truth's, skill is how much nearer to the truth "
            "than a smooth garment the wrinkles are, put on the truth's own coarse garment."
        ),
        Table(("database", "minutes", *COLUMNS.values()), [_cells(one) for one in worst_first(outcomes)]),
    ]
    if failed:
        sections.append(Table(("database", "why there is none"), [(one.name, one.problem) for one in failed]))
    write_page(path, "Wardrobe", sections)
