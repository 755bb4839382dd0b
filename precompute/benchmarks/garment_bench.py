"""`gube bench garment`: the same garment on the same moving body in other engines, beside ours.

Every method runs freely over the first held-out motion of a database and is judged by the database's truth, with the
measures of `gube compare`. A rival simulates one mesh of the garment's chain, with its own contact and self-collision,
and is drawn smooth on the fine mesh. Its time does not count skinning; ours does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pbd import build_model
from pbd.crossings import FaceGrid
from precompute.learning.crossed import crossed_share
from precompute.learning.pipeline import default_cache
from precompute.learning.run_recording import move_start
from precompute.learning.truth import SETTLE, Truth, database_run, truth_of
from precompute.reporting.cost_charts import Chart, Point, draw_charts, write_png
from precompute.reporting.tables import write_table
from precompute.rivals.dressing import Dressing
from precompute.rivals.engines import RIVALS, Rival, Tried, for_quality, for_speed, play_rival, search_settings
from precompute.scratch import scratch_folder
from precompute.workers import Workers
from precompute.wrinkle_comparison.baselines import Cloth, plain_cloths
from precompute.wrinkle_comparison.compare_database import RUNS, compare, run_again
from precompute.wrinkle_comparison.comparison import Method, MotionComparison
from precompute.wrinkle_comparison.comparison_page import draw_methods
from precompute.wrinkle_comparison.method_figures import figures_of, shared_figures
from runtime.draw.pictures import save_png
from runtime.setup.playback_inputs import playback_inputs
from wrinkles.database_file import read_database
from wrinkles.mesh_measures import edge_stretch
from wrinkles.metrics import normal_error_deg

__all__ = ["GarmentBench", "bench_garments", "bench_text", "write_garments"]

MOST_VERTICES = 10_000  # of a mesh that a rival simulates
SEARCHED = 1.0  # motion that a setting is tried on after the garment has settled [s]
LOOKED = 24  # frames in which crossings are counted, at most
HEAP = 500  # faces whose boxes overlap a face's in the mean from which all cross: to count them takes minutes
STIFFENED, DAMPED, RESTED = 30.0, 5.0, 60  # bending over the fabric's, damping [1/s] and frames of the rest shape
LOST = 100.0  # stretch from which a chart leaves a cloth out: it has burst or lies in a heap [%]
BUDGETS_MS = (4.0, 8.0, 16.0)  # of a frame, for which the best of each engine is named
JUDGED = ("octaves", "normals", "bias", "spread")  # errors by which ours must be as good as a rival, beside the stretch
STRETCH, CROSSED, INSIDE = "edge_stretch_p99_percent", "crossed_faces_percent", "inside_body_with_room_percent"
_COLUMNS = {
    "worst octave": "octave_error_max",
    "normals [deg]": "free_normal_error_deg",
    "bias": "low_frequency_bias",
    "spread": "low_frequency_spread",
    "stretch [%]": STRETCH,
    "in body [%]": INSIDE,
    "crossed [%]": CROSSED,
}


class RivalSetting(NamedTuple):
    """A rival with one of its settings on one mesh.

    Attributes:
        method: with its figures; none where it stopped early.
        engine: its name.
        purpose: quality or speed.
        ended: why it stopped early; empty where it did not.
    """

    method: Method
    engine: str
    purpose: str
    ended: str


@dataclass(frozen=True)
class GarmentBench:
    """All methods on one garment.

    Attributes:
        garment: its name.
        motion: ours and plain cloth, the truth and the floor, with rivals behind them.
        rivals: their settings.
        tried: every setting that a search looked at, by the rival's name.
        missing: why a rival is not there, by its name.
    """

    garment: str
    motion: MotionComparison
    rivals: tuple[RivalSetting, ...]
    tried: Mapping[str, Sequence[Tried]]
    missing: Mapping[str, str]

    @property
    def _ours(self) -> list[Method]:
        """Wrinkles and plain cloth, those that held."""
        return [one for one in self.motion.methods if (one.ours or one.mesh) and one.figures]

    def cheapest_as_good(self, rival: Method) -> Method | None:
        """The cheapest of ours that is as good as a rival by all that is judged at once."""
        good = [one for one in self._ours if not self.ahead(rival, one)]
        return min(good, key=lambda one: one.frame_ms, default=None)

    def ahead(self, rival: Method, one: Method) -> list[str]:
        """Names of the errors by which a rival is ahead of one of ours, beyond chance; unknown ones are not asked."""
        known = [name for name in JUDGED if math.isfinite(rival.error(name)) and math.isfinite(one.error(name))]
        found = [name for name in known if not self.motion.no_worse(one, rival, name)]
        allowed = max(self.motion.method(prefix).figures[STRETCH] for prefix in (rival.prefix, "truth_", "floor_"))
        return found + (["stretch"] if one.figures[STRETCH] > allowed else [])

    @property
    def shown(self) -> list[Method]:
        """Of each rival its setting for quality on the finest mesh on which it held."""
        held = {one.engine: one.method for one in self.rivals if one.purpose == "quality" and one.method.runs}
        return list(held.values())

    @property
    def undecided(self) -> list[Method]:
        """Plain cloths that decide what ours costs where a rival is, and that only one run is known of."""
        wanted = [self.cheapest_as_good(one.method) for one in self.rivals if one.method.figures]
        found = {one.prefix: one for one in wanted if one is not None and one.mesh and len(one.runs) == 1}
        return list(found.values())

    def reached(self) -> list[dict[str, Any]]:
        """Each engine's method with the best octaves within each of BUDGETS_MS; engines without one share a row."""
        engines: dict[str, list[Method]] = {
            "gube, wrinkles": [one for one in self._ours if one.ours],
            "gube, plain cloth": [one for one in self._ours if one.mesh],
        }
        for one in self.rivals:
            engines.setdefault(one.engine, []).extend([one.method] if one.method.figures else [])
        rows = []
        for budget in BUDGETS_MS:
            within = {name: [one for one in some if one.frame_ms <= budget] for name, some in engines.items()}
            best = {name: min(some, key=lambda one: one.error("octaves")) for name, some in within.items() if some}
            found: dict[str, Method | None] = {**best}
            if len(best) < len(engines):
                found["; ".join(name for name in engines if name not in best)] = None
            rows += [
                {"garment": self.garment, "within [ms]": budget, "engine": engine} | _cells(one)
                for engine, one in found.items()
            ]
        return rows

    def rows(self) -> list[dict[str, Any]]:
        """A row for every method."""
        purposes = {one.method.prefix: one for one in self.rivals}
        rows = []
        for method in self.motion.methods:
            found = purposes.get(method.prefix)
            row: dict[str, Any] = {
                "garment": self.garment, "engine": found.engine if found else "gube", **_cells(method),
                "ended": found.ended if found else "burst" if method.broke_at is not None else "",
            }  # fmt: skip
            if found is not None and method.figures:
                good = self.cheapest_as_good(method)
                row["ours as good"] = "" if good is None else good.name
                row["its ms"] = None if good is None else good.frame_ms
                row["its share"] = None if good is None else good.frame_ms / method.frame_ms
                row["rival ahead by"] = "" if good is not None else " ".join(self._ahead_of_all(method))
            rows.append(row | {"settings": " ".join(f"{name} {value:g}" for name, value in method.settings.items())})
        return rows

    def _ahead_of_all(self, rival: Method) -> list[str]:
        """By what a rival is ahead of the one of ours that comes nearest to it."""
        return min((self.ahead(rival, one) for one in self._ours), key=len, default=[])


def _cells(method: Method | None) -> dict[str, Any]:
    """What a table shows of a method, or of none."""
    cells = {name: None if method is None else method.figures.get(key) for name, key in _COLUMNS.items()}
    shown = {"method": "none" if method is None else method.name, "frame_ms": method and method.frame_ms}
    return shown | cells


def bench_garments(
    paths: Sequence[Path],
    *,
    rivals: bool,
    seconds: float,
    workers: Workers | int = 2,
    report: Callable[[str], None] | None = None,
) -> list[GarmentBench]:
    """Play the garments of databases by everything that there is.

    Args:
        paths: databases.
        rivals: whether other engines play, too.
        seconds: of each motion, at most.
        workers: processes that work side by side.
        report: called with lines of progress.
    """
    with Workers.of(workers) as pool:
        return [_bench(path, rivals, seconds, pool, report or (lambda line: None)) for path in paths]


def _bench(path: Path, rivals: bool, seconds: float, pool: Workers, tell: Callable[[str], None]) -> GarmentBench:
    database = read_database(path)
    inputs = playback_inputs(database)
    truth = truth_of(database_run(database, inputs, inputs.motions[0]), default_cache(path), pool, tell, count=RUNS)
    truth = truth.until(seconds)
    (motion,) = compare(database, [truth], workers=pool, report=tell).motions
    missing = {one.name: one.missing if rivals else "--rivals was not asked for" for one in RIVALS.values()}
    there = {name: one for name, one in RIVALS.items() if not missing[one.name]}
    clothes = [one for one in plain_cloths(database, truth.run).values() if one.model.vertex_count <= MOST_VERTICES]
    settings: list[RivalSetting] = []
    tried: dict[str, Sequence[Tried]] = {}
    # A rival's process computes; a thread only waits for it.
    with scratch_folder() as folder, ThreadPoolExecutor(max(1, pool.count)) as threads:
        dressings = [_write_dressings(cloth, folder, number) for number, cloth in enumerate(clothes if there else [])]
        # The last takes longest: it begins first.
        jobs = {name: threads.submit(_rival, name, truth, clothes, dressings, folder, tell) for name in reversed(there)}
        for name, rival in there.items():
            tried[rival.name], found = jobs[name].result()
            settings += found
    tell(f"{database.garment_name}: figures of {len(settings)} settings of rivals; body, stretch and crossings of all")
    # The frames of `gube compare` lie in files that are gone by now: another process cannot open them.
    # Each process makes the filters of the mesh once for its share.
    shares = [[one.method for one in settings[first :: pool.count]] for first in range(pool.count)]
    judged = [_judged(truth, motion.methods), *pool.run([partial(_judged, truth, one) for one in shares if one])]
    by_prefix = {one.prefix: one for some in judged for one in some}
    order = [one.prefix for one in (*motion.methods, *(one.method for one in settings))]
    motion = replace(motion, methods=tuple(by_prefix[prefix] for prefix in order))
    settings = [one._replace(method=motion.method(one.method.prefix)) for one in settings]
    found = {name: why for name, why in missing.items() if why}
    bench = GarmentBench(database.garment_name, motion, tuple(settings), tried, found)
    while bench.undecided:
        for method in bench.undecided:
            tell(f"{bench.garment}: again, {method.name}")
            (again,) = _judged(truth, [run_again(database, truth, method)])
            bench = replace(bench, motion=bench.motion.with_method(again))
    return bench


def _judged(truth: Truth, methods: Sequence[Method]) -> list[Method]:
    """Methods with all figures; those of `gube compare` have most of them already."""
    fresh = {one.prefix: one for one in figures_of(truth, [one for one in methods if not one.figures])}
    found = []
    for one in (fresh.get(one.prefix, one) for one in methods):
        if not one.runs:
            found.append(one)
            continue
        frames = one.runs[0]
        figures = {CROSSED: _crossed(truth, frames)}
        if STRETCH not in one.figures:
            figures |= shared_figures(truth, frames)
        found.append(replace(one, figures={**one.figures, **figures}))
    return found


def _crossed(truth: Truth, frames: np.ndarray) -> float:
    """Share of the faces that go through others, mean over frames [%]; 100 for cloth that lies in a heap."""
    mesh, shares = truth.levels.fine, []
    grid = FaceGrid(mesh.faces)
    for vertices in frames[:: -(-len(frames) // LOOKED)].astype(float):
        heap = not grid.pairs(vertices, vertices, most=HEAP * len(mesh.faces))[1]
        shares.append(100.0 if heap else crossed_share(mesh, vertices))
    return float(np.mean(shares))


def _write_dressings(cloth: Cloth, folder: Path, number: int) -> list[Path]:
    """Files of a garment for other engines, one for each start; of finer meshes than the coarsest only the first."""
    first, paths = _dressing(cloth), []
    for start in range(1 if number else RUNS):
        simulation = cloth.simulation(cloth.options)
        move_start(simulation.state, start)
        paths.append(folder / f"dressing_{number}_{start}.npz")
        off = simulation.state.world() - first.start
        # Blender begins with the shape at rest.
        replace(first, start=first.start + off, rest=first.rest + off).write(paths[-1])
    return paths


def _dressing(cloth: Cloth) -> Dressing:
    """What another engine is given of a garment."""
    model, run, source = cloth.model, cloth.run, cloth.source
    simulation = cloth.simulation(cloth.options)
    body = np.zeros((len(run.poses), len(source.vertices), 3), np.float32)
    for one, pose in zip(body, run.poses, strict=True):
        source.skin(pose, np.zeros(3), one)
    targets = np.array([cloth.attachment.targets(one) for one in body]).reshape(len(body), len(model.held), 3)
    return Dressing(
        model.mesh.faces, model.mesh.flat, *model.mesh.edge_lengths(), model.mass, simulation.state.world(),
        _rest(cloth), model.held, targets, model.stitches, model.stitch_weights, source.faces, body,
        asdict(model.fabric), run.dt, cloth.options.self_collision,
    )  # fmt: skip


def _rest(cloth: Cloth) -> np.ndarray:
    """A smooth shape at the first pose whose edges are about as long as in the pattern [m], shape (n, 3).

    It is what the cloth comes to without weight, when it is so stiff that it has no small folds.
    """
    model, fabric = cloth.model, cloth.model.fabric
    stiff = replace(fabric, bend_warp=STIFFENED * fabric.bend_warp, bend_weft=STIFFENED * fabric.bend_weft)
    smooth = build_model(model.mesh, stiff, model.held, bend_factor=model.bend_factor, limits=model.limits)
    options = replace(cloth.options, gravity=(0.0, 0.0, 0.0), local_damping=DAMPED)
    simulation = replace(cloth, model=smooth).simulation(options)
    for _ in range(RESTED):
        simulation.step(cloth.run.poses[0], cloth.run.dt)
    return simulation.state.world()


def _rival(
    name: str, truth: Truth, clothes: Sequence[Cloth], dressings: Sequence[Sequence[Path]], folder: Path,
    tell: Callable[[str], None],
) -> tuple[list[Tried], list[RivalSetting]]:  # fmt: skip
    """The search of one rival on the coarsest mesh, and what its settings come to on every mesh."""
    rival, found = RIVALS[name], []
    tried = _search(name, rival, truth, clothes[0], dressings[0][0], folder, tell)
    keep = truth.recording.frames
    for purpose, chosen in (("quality", for_quality(tried)), ("speed", for_speed(tried))):
        if chosen is None:
            found.append(
                RivalSetting(
                    _method(name, rival, purpose, clothes[0], rival.first), rival.name, purpose, tried[0].ended
                )
            )
            continue
        for cloth, starts in zip(clothes, dressings, strict=True):
            tell(f"{rival.name}: for {purpose}, {cloth.model.vertex_count:,} vertices")
            method, runs = _method(name, rival, purpose, cloth, chosen.settings), []
            for dressing in starts:
                beside = folder / f"{name}_{purpose}_{dressing.stem}"
                runs.append(play_rival(name, chosen.settings, dressing, keep.tolist(), truth.run.frame_count, beside))
                if runs[-1].ended:
                    break
            shown = () if runs[-1].ended else tuple(_fine(cloth, one.frames) for one in runs)
            method = replace(method, frame_ms=runs[0].frame_ms, runs=shown)
            found.append(RivalSetting(method, rival.name, purpose, runs[-1].ended))
    return tried, found


def _search(
    name: str, rival: Rival, truth: Truth, cloth: Cloth, dressing: Path, folder: Path, tell: Callable[[str], None]
) -> list[Tried]:
    last = round((max(SETTLE, truth.run.lead_in) + SEARCHED) / truth.run.dt)
    judged = truth.recording.frames <= last
    keep, right, mesh = truth.recording.frames[judged], truth.frames[judged], truth.levels.fine
    edges, lengths = mesh.edge_lengths()
    allowed, count = edge_stretch(right, edges, lengths).p99, 0

    def measure(settings: Mapping[str, float]) -> Tried:
        nonlocal count
        count += 1
        run = play_rival(name, settings, dressing, keep.tolist(), last, folder / f"{name}_{count}")
        error = math.inf
        if not run.ended:
            fine = _fine(cloth, run.frames)
            normals = float(np.mean(normal_error_deg(fine, right, mesh.faces)))
            # A degree counts as much as a per cent of stretch that the truth does not have.
            error = normals + 100.0 * max(0.0, edge_stretch(fine, edges, lengths).p99 - allowed)
        tell(f"{rival.name}: try {count}: {run.frame_ms:.0f} ms, error {error:.2f}")
        return Tried(dict(settings), run.frame_ms, error, run.ended)

    return search_settings(rival, measure)


def _method(name: str, rival: Rival, purpose: str, cloth: Cloth, settings: Mapping[str, float]) -> Method:
    count = cloth.model.vertex_count
    called = f"{rival.name} {rival.version} for {purpose}, {count:,}"
    return Method(f"rival_{name}_{purpose}_{count}_", called, math.nan, {}, {"simulated vertices": count, **settings})


def _fine(cloth: Cloth, frames: np.ndarray) -> np.ndarray:
    """The smooth fine surface of frames of a simulated mesh."""
    if cloth.levels is None:
        return frames
    return cloth.levels.subdivision.upsample(frames).astype(np.float32)


def bench_text(bench: GarmentBench) -> str:
    """A line for every method, and what ours costs where it is as good as a rival."""
    heads = ["ms", *_COLUMNS]
    lines = [f"{bench.garment:<44}" + "".join(f"{head:>15}" for head in heads)]
    rows = bench.rows()
    for row in rows:
        cells = [row["frame_ms"], *(row[name] for name in _COLUMNS)]
        shown = ["" if cell is None or math.isnan(cell) else f"{cell:.3g}" for cell in cells]
        lines.append(f"{row['method']:<44}" + "".join(f"{cell:>15}" for cell in shown) + f"  {row['ended']}".rstrip())
    for row in rows:
        if "ours as good" not in row:
            continue
        if row["ours as good"]:
            words = f"ours is as good with {row['ours as good']}: {row['its share']:.2f} of its time"
        else:
            words = f"ahead of ours by {row['rival ahead by']}"
        lines.append(f"{row['method']}: {words}")
    for row in bench.reached():
        words = f"{row['method']}, {row['frame_ms']:.3g} ms" if row["frame_ms"] else "none"
        error = "" if row["worst octave"] is None else f", worst octave {row['worst octave']:.2g}"
        lines.append(f"within {row['within [ms]']:g} ms, {row['engine']}: {words}{error}")
    lines += [f"{name}: {why}" for name, why in bench.missing.items()]
    return "\n".join(lines)


def write_garments(folder: Path, benches: Sequence[GarmentBench]) -> None:
    """Write of each garment ``NAME.csv``, ``NAME_tries.csv``, ``NAME_within.csv``, a chart and a strip of pictures.

    Args:
        folder: which exists.
        benches: what was found.
    """
    for bench in benches:
        stem = bench.garment.replace(" ", "_")
        write_table(folder / f"{stem}.csv", bench.rows(), digits=4, machine=True)
        write_table(folder / f"{stem}_within.csv", bench.reached(), digits=4, machine=True)
        tries = [
            {"engine": name, "frame_ms": one.frame_ms, "error": one.error, "ended": one.ended}
            | {"settings": " ".join(f"{key} {value:g}" for key, value in one.settings.items())}
            for name, some in bench.tried.items()
            for one in some
        ]
        write_table(folder / f"{stem}_tries.csv", tries, digits=4, machine=True)
        write_png(folder / f"{stem}_chart.png", draw_charts(_charts(bench), 11.0, 8.0))
        picture = draw_methods(bench.motion, [bench.motion.method(one) for one in ("truth_", "")] + bench.shown)
        save_png(folder / f"{stem}_strip.png", picture)


def _charts(bench: GarmentBench) -> dict[str, Chart]:
    """Cost against each error, all engines."""
    charts = {}
    for name in ("normals [deg]", "worst octave", "bias", "stretch [%]"):
        points = []
        engines = {one.method.prefix: one.engine for one in bench.rivals}
        for method in bench.motion.methods:
            value = method.figures.get(_COLUMNS[name], math.nan)
            if method.prefix in ("truth_", "floor_") or not math.isfinite(value + method.frame_ms):
                continue
            if method.figures[STRETCH] > LOST:
                continue
            group = engines.get(method.prefix, "gube, wrinkles" if method.ours else "gube, plain cloth")
            points.append(Point(method.frame_ms, value, group, settings=method.settings))
        floor = bench.motion.method("floor_").figures.get(_COLUMNS[name], 0.0)
        charts[f"{bench.garment}: {name}"] = Chart(points, "time of a frame [ms]", name, floor=floor)
    return charts
