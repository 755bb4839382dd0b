"""The page of `gube compare --wrinkles`: error against time and against megabytes, and all figures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from precompute.reporting.html_page import Chart, Point, Section, Table, Text, write_page
from precompute.wrinkle_comparison.wrinkle_comparison import WrinkleComparison, WrinkleMethod

__all__ = ["wrinkle_rows", "wrinkle_verdict", "write_wrinkles"]

_GIVEN, _FREE = "normal_error_deg", "spectrum_band_error_max"
_NOTES = """Every learned method gives the coefficients of the same patches, learned from the same recorded frames; each
and the wrinkle meshes are relaxed alike. Given the coarse state, each is shown the truth's own coarse states of a
motion that nothing was learned from; running freely, all of them are shown one free run of the coarse garment, filtered
as our player does it (smooth and wrinkle meshes: as it is). Settings were chosen on training motion alone.

Times are medians of processor time on one core. Ours, smooth and simulations: a whole frame, body included. The others:
our frame with the time of making wrinkles exchanged, as measured here in NumPy and scikit-learn. Megabytes count what a
method must store as 32-bit numbers besides the mesh; methods that are not in a chart of megabytes store nothing.

The floor of a free run is what parts two converged simulations of the same scene. The floor given the coarse state is
what is left when the truth's own patches are reduced to the atoms."""


def write_wrinkles(path: Path, comparison: WrinkleComparison) -> None:
    """Write the page."""
    sections: list[Section] = [
        Text(wrinkle_verdict(comparison)),
        *(
            _chart(comparison, figure, cost, label)
            for figure in (_GIVEN, _FREE)
            for cost, label in ((_time, "time of a frame [ms]"), (_size, "to store [MB]"))
        ),
        _table(comparison),
        Text(_NOTES),
    ]
    write_page(path, f"{comparison.garment}, {comparison.motion}: methods to wrinkles", sections)


def _time(method: WrinkleMethod) -> float:
    return method.frame_ms


def _size(method: WrinkleMethod) -> float:
    return method.megabytes


def _chart(comparison: WrinkleComparison, figure: str, cost: Callable[[WrinkleMethod], float], label: str) -> Chart:
    given = figure == _GIVEN
    figures = lambda method: method.given if given else method.free  # noqa: E731
    points = [
        Point(cost(method), figures(method)[figure], method.name, method.name, {"settings": method.settings})
        for method in comparison.methods
        if figures(method) and cost(method) > 0.0
    ]
    return Chart(
        points,
        label,
        "given the coarse state: mean normal error [deg]" if given else "running freely: largest error of a band [-]",
        log_y=not given,
        floor=(comparison.limit if given else comparison.floor)[figure],
        y_lines={"smooth": next(figures(method)[figure] for method in comparison.methods if method.name == "smooth")},
    )


def _table(comparison: WrinkleComparison) -> Table:
    columns = [*comparison.methods, WrinkleMethod("floor", float("nan"), 0.0, comparison.limit, comparison.floor)]
    rows: list[list] = [["settings", *(method.settings for method in columns)]]
    rows += [["frame_ms_p50", *(None if method.name == "floor" else method.frame_ms for method in columns)]]
    rows += [["mb", *(method.megabytes for method in columns)]]
    rows += [[name, *(method.given.get(name) for method in columns)] for name in comparison.limit]
    rows += [[name, *(method.free.get(name) for method in columns)] for name in comparison.floor]
    return Table(["", *(method.name for method in columns)], rows, "Figures and settings")


def wrinkle_rows(comparison: WrinkleComparison) -> list[dict[str, float | str]]:
    """A row of figures for each method, and one for the floor."""
    rows: list[dict[str, float | str]] = [
        {
            "method": method.name,
            "settings": method.settings,
            "frame_ms_p50": method.frame_ms,
            "mb": method.megabytes,
            **method.given,
            **method.free,
        }
        for method in comparison.methods
    ]
    return [*rows, {"method": "floor", **comparison.limit, **comparison.floor}]


def wrinkle_verdict(comparison: WrinkleComparison) -> str:
    """Who is nearest to the truth, in sentences; a baseline that wins is named as plainly as our method."""
    given = {method.name: method.given[_GIVEN] for method in comparison.methods if method.given}
    free = {method.name: method.free[_FREE] for method in comparison.methods if method.free}
    listed = lambda figures, unit: ", ".join(  # noqa: E731
        f"{name} {value:.3g}{unit}" for name, value in sorted(figures.items(), key=lambda item: item[1])
    )
    return (
        f"Given the coarse state, {min(given, key=given.__getitem__)} is nearest to the truth's normals: "
        f"{listed(given, ' deg')}.\n\n"
        f"Running freely, {min(free, key=free.__getitem__)} is nearest to the truth's spectrum of folds (largest "
        f"relative error of a band's bending energy): {listed(free, '')}; the floor is {comparison.floor[_FREE]:.3g}."
    )
