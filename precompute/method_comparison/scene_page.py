"""The files of a comparison of scenes: a page, a chart as picture, tables for programs, a strip of one moment."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from pbd import Plane, Sphere
from precompute.experiment.error_classes import ErrorClass
from precompute.experiment.measures import FRAME_RATE
from precompute.method_comparison.compare_scenes import CompareScene
from precompute.method_comparison.fabric_pictures import FABRICS, draw_fabrics, fabric_runs
from precompute.method_comparison.scene_compare import ComparedRun, SceneComparison
from precompute.method_comparison.scene_judging import screen_mm
from precompute.reporting.cost_charts import draw_charts, write_png
from precompute.reporting.html_page import Chart, Heading, Picture, Point, Section, Table, Text, write_page
from precompute.reporting.tables import write_table
from precompute.wrinkle_comparison.comparison import Comparison
from precompute.wrinkle_comparison.comparison_page import comparison_sections
from runtime.draw.picture_content import Drawn, frame_camera
from runtime.draw.pictures import render, save_png, strip
from runtime.output.report import machine_description, write_report

__all__ = ["comparison_figures", "comparison_text", "fabric_sections", "wrinkle_sections", "write_comparison"]

COLORS = {
    ErrorClass.IMPERCEPTIBLE: "#00764f",
    ErrorClass.ACCEPTED: "#0067a8",
    ErrorClass.VISIBLE: "#c24a00",
    ErrorClass.CATASTROPHIC: "#b81f3c",
}
PICTURE = (340, 400)
SHOWN_METHODS = (  # columns of a strip, where they were run
    "default", "xpbd", "pbd", "projective-dynamics", "fem-stvk+isometric/verlet", "fem-stvk+isometric/bdf2",
)  # fmt: skip
_NOTES = """All methods run the same scenes at 60 frames a second with the same fabric. Time of a frame is
processor time on one core (p50 and p99, the first frame left out); memory is the most that Python and
NumPy held for model, solver, state and a step, without compiled code of Taichi. A run's
cloth is compared as the cubic spline through its vertices, so that a coarse mesh is not blamed for its facets.

Where the answer is unique, the error is the distance to the reference that 95 % of the points and frames stay
below, on a screen of 1080 lines whose camera stands 3 m away, after the first half second. The reference is an
explicit run of finite elements; the floor is what parts it from another with two thirds of its resolution.
Where cloth folds chaotically, the error is that of statistics: bending energy in all and in each octave of
wavelength with a hundredth of it, and folds along the border, each as a ratio to the references' mean, root
mean square in octaves (1 is a factor of two). The references are the default solver at 32 edges and 32 substeps
from three starts that differ by a tenth of a millimetre; the floor is the largest error of one against the mean
of the others.

Colours are error classes: the worst of strain, velocity, speed, energy, depth in a collider, size and, where
the answer is unique, position. Energy is kinetic and gravity's, over the greatest kinetic energy; growth under
2 % is none."""


def comparison_figures(found: Sequence[SceneComparison]) -> dict[str, float]:
    """Counts, floors and the cheapest good point of each scene."""
    figures = {"points": float(sum(len(one.points) for one in found))}
    figures["methods"] = float(len({point.run.setting.method for one in found for point in one.points}))
    for one in found:
        figures |= one.figures()
    figures["processor_s"] = sum(value for name, value in figures.items() if name.endswith("_processor_s"))
    return figures


def comparison_text(one: SceneComparison) -> str:
    """The result of a scene, in words."""
    judge, unit = one.judge, one.judge.unit
    near = f" ({screen_mm(judge.floor):.2g} mm)" if one.scene.unique else ""
    lines = [f"{one.scene.name}: {one.scene.title}, {one.scene.seconds:g} s. Floor {judge.floor:.2g} {unit}{near}."]
    if not one.scene.unique:
        lines.append(f"A reference with 1.5 times the edges and substeps is {judge.refined:.2g} {unit} from the mean.")
    listed = [
        f"{point.run.setting.method} ({point.run.setting.words}) {point.frame_ms[0]:.3g} ms: "
        f"{point.judgement.error:.2g} {unit}, {point.judgement.worst.name.lower()}"
        for point in one.pareto_front()
    ]
    lines.append("The Pareto front, from the cheapest: " + "; ".join(listed) + ".")
    bad = [p for p in one.points if p.judgement.worst is ErrorClass.CATASTROPHIC]
    if bad:
        names = [f"{p.run.setting.method}@{p.run.setting.numbers} ({p.judgement.because})" for p in bad]
        lines.append("Catastrophic: " + "; ".join(names) + ".")
    if one.dropped:
        names = list(dict.fromkeys(setting.method for setting, _ in one.dropped))
        lines.append(f"Not run, for want of time: {len(one.dropped)} settings of {', '.join(names)}.")
    return "\n\n".join(lines)


def wrinkle_sections(comparison: Comparison | None) -> list[Section]:
    """With and without the wrinkle layer on the held-out motions of a database; without one, the reason."""
    heading = Heading("With and without the wrinkle layer")
    if comparison is None:
        why = "Not compared: no database was named. `gube demo` makes out/demo/skirt.h5; name it beside the scenes."
        return [heading, Text(why)]
    return [heading, Text(f"{comparison.garment}."), *comparison_sections(comparison)]


def fabric_sections(folder: Path, report: Callable[[str], None] | None = None) -> list[Section]:
    """One skirt in three fabrics, also written to ``fabrics.png``."""
    image = draw_fabrics(fabric_runs(), folder / "runs", report=report)
    save_png(folder / "fabrics.png", image)
    return [Heading("One skirt in three fabrics"), Picture(image, ", ".join(FABRICS) + ": the same cut and motion")]


def write_comparison(folder: Path, found: Sequence[SceneComparison], more: Sequence[Section] = ()) -> None:
    """Write ``compare.html``, ``.csv``, ``.json`` and ``.png``, and a strip of each scene, into a folder.

    Args:
        folder: is made where it is missing.
        found: what :func:`precompute.method_comparison.scene_compare.compare_scenes` gave.
        more: sections of the page after the scenes.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rows = [point.row(one.scene.name) for one in found for point in one.points]
    figures = comparison_figures(found)
    write_report(folder / "compare.json", "compare", figures, rows)
    write_table(folder / "compare.csv", rows, digits=5)
    charts = [_chart(one) for one in found]
    titled = {one.scene.title: chart for one, chart in zip(found, charts, strict=True)}
    write_png(folder / "compare.png", draw_charts(titled, 6.2, 4.2))
    sections: list[Section] = []
    for one, chart in zip(found, charts, strict=True):
        image = draw_strip(one)
        save_png(folder / f"{one.scene.name}.png", image)
        sections += [Heading(one.scene.title), Text(comparison_text(one)), chart]
        sections.append(Picture(image, f"{one.scene.name} after {one.scene.moment:g} s, by methods"))
    sections += more
    machine = machine_description()
    sections += [Heading("How it was measured"), Text(_NOTES), _table(found)]
    missing = [
        [one.scene.name, f"{setting.method}@{setting.numbers}", why] for one in found for setting, why in one.dropped
    ]
    if missing:
        sections.append(Table(["scene", "setting", "why"], missing, "Not run, or not to the end"))
    sections.append(Text(f"Measured on {machine['cores']} cores of: {machine['cpu']}, {machine['date']}."))
    write_page(folder / "compare.html", "Cost against error", sections)


def _chart(one: SceneComparison) -> Chart:
    return Chart(
        [_point(one.scene, point) for point in one.points],
        "time of a frame, p50 [ms]",
        "position error, p95 [px]" if one.scene.unique else "error of statistics [octaves]",
        log_y=True,
        floor=one.judge.floor,
        y_lines={} if one.scene.unique else {"a finer reference": one.judge.refined},
        caption="Points at the upper border did not end.",
        colors={COLORS[kind]: kind.name.lower() for kind in ErrorClass},
    )


def _point(scene: CompareScene, point: ComparedRun) -> Point:
    row = {name: value for name, value in point.row(scene.name).items() if name not in ("scene", "method", "error")}
    row["command"] = row.pop("command")  # last
    setting, error = point.run.setting, point.judgement.error
    x, y = max(point.frame_ms[0], 1e-3), max(error, 1e-3) if np.isfinite(error) else np.inf
    return Point(x, y, setting.method, setting.numbers, row, color=COLORS[point.judgement.worst])


def _table(found: Sequence[SceneComparison]) -> Table:
    names = {
        "scene": "scene", "method": "method", "edges": "edges", "substeps": "substeps", "passes": "passes",
        "frame_ms_p50": "ms p50", "frame_ms_p99": "ms p99", "setup_s": "set-up s", "memory_mb": "memory MB",
        "error": "error", "error_class": "class", "because": "because",
    }  # fmt: skip
    rows = [point.row(one.scene.name) for one in found for point in one.points]
    cells = [[row[name] for name in names] for row in rows]
    return Table(list(names.values()), cells, "All points")


def draw_strip(one: SceneComparison) -> np.ndarray:
    """One moment by the reference and by the best setting of several methods: uint8, shape (h, w, 3)."""
    scene, frame = one.scene, max(0, round(one.scene.moment * FRAME_RATE) - 1)
    chosen = [("reference", one.judge.reference.position[frame])]
    names = [name for name in SHOWN_METHODS if any(p.run.setting.method == name for p in one.points)]
    names += [p.run.setting.method for p in one.points if p.run.setting.method not in SHOWN_METHODS]
    for name in list(dict.fromkeys(names))[:6]:
        whole = [p for p in one.points if p.run.setting.method == name and len(p.run.position) > frame]
        if whole:
            best = min(whole, key=lambda point: point.judgement.error)
            chosen.append((f"{name} {best.run.setting.numbers}", best.run.position[frame]))
    sheet = scene.compared()
    pattern = sheet.flat[sheet.faces]
    frames = np.array([chosen[0][1]], float)
    camera = frame_camera(frames, azimuth_deg=35.0, aspect=PICTURE[0] / PICTURE[1], margin=1.25)[0]
    solid = [_drawn(primitive) for primitive in scene.colliders()]
    images = [
        [render([*solid, Drawn(x.astype(float), sheet.faces, pattern=pattern)], camera, PICTURE, floor=None)]
        for _, x in chosen
    ]
    return strip(images, [title for title, _ in chosen], [""])


def _drawn(primitive: Plane | Sphere) -> Drawn:
    assert isinstance(primitive, Sphere)
    rings, around = 24, 48
    polar, turn = np.meshgrid(
        np.linspace(0.0, np.pi, rings + 1), np.linspace(0.0, 2.0 * np.pi, around, endpoint=False), indexing="ij"
    )
    unit = np.stack([np.sin(polar) * np.cos(turn), np.cos(polar), np.sin(polar) * np.sin(turn)], axis=-1).reshape(-1, 3)
    row, column = np.divmod(np.arange(rings * around), around)
    a, b = row * around + column, row * around + (column + 1) % around
    faces = np.concatenate([np.stack([a, b, a + around], axis=1), np.stack([b, b + around, a + around], axis=1)])
    return Drawn.body(np.asarray(primitive.centre, float) + primitive.radius * unit, faces)
