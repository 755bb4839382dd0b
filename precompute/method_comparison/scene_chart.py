"""The charts of a comparison of scenes as a picture: PNG and SVG."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pbd.storage import replacing
from precompute.method_comparison.error_classes import ErrorClass
from precompute.method_comparison.scene_compare import SceneComparison

__all__ = ["draw_charts"]

INK = {
    ErrorClass.IMPERCEPTIBLE: "#00764f",
    ErrorClass.ACCEPTED: "#0067a8",
    ErrorClass.VISIBLE: "#c24a00",
    ErrorClass.CATASTROPHIC: "#b81f3c",
}
MARKERS = "os^DvPphX*<>8d1234"


def draw_charts(folder: Path, found: Sequence[SceneComparison]) -> None:
    """Error against time, a panel for each scene, into ``compare.png`` and ``compare.svg``."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    methods = list(dict.fromkeys(p.run.setting.method for one in found for p in one.points))
    marker = {name: MARKERS[k % len(MARKERS)] for k, name in enumerate(methods)}
    columns = min(2, len(found))
    rows = -(-len(found) // columns)
    figure = Figure(figsize=(6.2 * columns, 4.2 * rows + 1.6), layout="constrained")
    FigureCanvasAgg(figure)
    for k, one in enumerate(found):
        axes = figure.add_subplot(rows, columns, k + 1)
        finite = [p.judgement.error for p in one.points if np.isfinite(p.judgement.error)]
        top = 2.0 * max([*finite, one.judge.floor])
        for point in one.points:
            error = min(point.judgement.error, top)
            style = {"marker": marker[point.run.setting.method], "color": INK[point.judgement.worst], "zorder": 3}
            axes.scatter(point.frame_ms[0], error, s=42, linewidths=0.6, edgecolors="white", **style)
        front = one.pareto_front()
        axes.step([p.frame_ms[0] for p in front], [p.judgement.error for p in front], "k--", where="post", lw=0.9)
        axes.axhspan(axes.get_ylim()[0] * 1e-6, one.judge.floor, color="0.87", zorder=0)
        axes.set(xscale="log", yscale="log", title=one.scene.title)
        axes.set_ylim(0.5 * min([*finite, one.judge.floor]), 1.3 * top)
        axes.set_xlabel("time of a frame [ms]")
        axes.set_ylabel("position error, p95 [px]" if one.scene.unique else "error of statistics [octaves]")
        axes.grid(alpha=0.25)
    keys = [Line2D([], [], ls="", marker=marker[name], color="0.35", label=name) for name in methods]
    keys += [Line2D([], [], ls="", marker="o", color=INK[kind], label=kind.name.lower()) for kind in ErrorClass]
    keys += [Line2D([], [], ls="--", color="k", lw=0.9, label="front")]
    keys += [Line2D([], [], color="0.87", lw=6, label="floor")]
    figure.legend(handles=keys, loc="outside lower center", ncols=2 * columns, fontsize=8, frameon=False)
    for kind in ("png", "svg"):
        with replacing(folder / f"compare.{kind}") as beside:
            figure.savefig(beside, format=kind, dpi=110)
