"""Pictures of the validation table: each measured curve against its reference."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from precompute.reporting.cost_charts import panels, write_png
from precompute.validation.validation import ValidationResult, case_words
from runtime.draw.pictures import save_png

__all__ = ["draw_results"]


def draw_results(folder: Path, results: Sequence[ValidationResult]) -> list[Path]:
    """One PNG per test, a panel per case that has a curve, and the pictures of results; the best run's.

    Returns:
        The files.
    """
    files = []
    for name in dict.fromkeys(result.row.name for result in results):
        for result in results:
            if result.row.name == name and result.best.picture is not None:
                files.append(folder / f"{name}-side-by-side.png")
                folder.mkdir(parents=True, exist_ok=True)
                save_png(files[-1], result.best.picture)
        drawn = [v for v in results if v.row.name == name and v.best.curve is not None]
        if not drawn:
            continue
        figure, places = panels(len(drawn))
        for panel, result in zip(places, drawn, strict=True):
            curve = result.best.curve
            assert curve is not None
            panel.plot(*curve.reference, color="0.6", linewidth=2.5, label="reference")
            panel.plot(*curve.measured, ".", color="tab:red", markersize=3.5, label="measured")
            panel.set_xlabel(curve.x_label)
            panel.set_ylabel(curve.y_label)
            panel.set_title(case_words(result.case) or name, fontsize=9)
            panel.legend(fontsize=8)
        figure.suptitle(drawn[0].row.words, fontsize=10)
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{name}.png"
        write_png(path, figure)
        files.append(path)
    return files
