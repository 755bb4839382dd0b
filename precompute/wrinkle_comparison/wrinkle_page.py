"""The page of `gube compare --wrinkles`: error against time and against megabytes, and all figures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from precompute.reporting.page import Band, Chart, Line, Point, Section, Table, Text, write_page
from precompute.wrinkle_comparison.wrinkle_comparison import WrinkleComparison, Wrinkles

__all__ = ["wrinkle_rows", "wrinkle_verdict", "write_wrinkles"]

_GIVEN, _FREE = "normal_error_deg", "spectrum_band_error_max"
_NOTES = """Every learned way gives the coefficients of the same patches, learned from the same recorded frames; each
and the wrinkle meshes are relaxed alike. Given the coarse state, each is shown the truth's own coarse states of a
motion that nothing was learned from; running freely, all of them are shown one free run of the coarse garment, filtered
as our player does it (smooth and wrinkle meshes: as it is). Settings were chosen on training motion alone.

Times are medians of processor time on one core. Ours, smooth and simulations: a whole frame, body included. The others:
our frame with the time of making wrinkles exchanged, as measured here in NumPy and scikit-learn. Megabytes count what a
way must store as 32-bit numbers besides the mesh; ways that are not in a chart of megabytes store nothing.

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
    write_page(path, f"{comparison.garment}, {comparison.motion}: ways to wrinkles", sections)


def _time(way: Wrinkles) -> float:
    return way.frame_ms


def _size(way: Wrinkles) -> float:
    return way.megabytes


def _chart(comparison: WrinkleComparison, figure: str, cost: Callable[[Wrinkles], float], label: str) -> Chart:
    given = figure == _GIVEN
    figures = lambda way: way.given if given else way.free  # noqa: E731
    points = [
        Point(cost(way), figures(way)[figure], way.name, way.name, {"settings": way.settings})
        for way in comparison.ways
        if figures(way) and cost(way) > 0.0
    ]
    floor = (comparison.limit if given else comparison.floor)[figure]
    return Chart(
        points,
        label,
        "given the coarse state: mean normal error [deg]" if given else "running freely: largest error of a band [-]",
        log_x=True,
        log_y=not given,
        bands=[Band(0.0, floor, "floor")],
        lines=[Line("y", next(figures(way)[figure] for way in comparison.ways if way.name == "smooth"), "smooth")],
    )


def _table(comparison: WrinkleComparison) -> Table:
    columns = [*comparison.ways, Wrinkles("floor", float("nan"), 0.0, comparison.limit, comparison.floor)]
    rows: list[list] = [["settings", *(way.settings for way in columns)]]
    rows += [["frame_ms_p50", *(None if way.name == "floor" else way.frame_ms for way in columns)]]
    rows += [["mb", *(way.megabytes for way in columns)]]
    rows += [[name, *(way.given.get(name) for way in columns)] for name in comparison.limit]
    rows += [[name, *(way.free.get(name) for way in columns)] for name in comparison.floor]
    return Table(["", *(way.name for way in columns)], rows, "Figures and settings")


def wrinkle_rows(comparison: WrinkleComparison) -> list[dict[str, float | str]]:
    """A row of figures for each way, and one for the floor."""
    rows: list[dict[str, float | str]] = [
        {
            "method": way.name,
            "settings": way.settings,
            "frame_ms_p50": way.frame_ms,
            "mb": way.megabytes,
            **way.given,
            **way.free,
        }
        for way in comparison.ways
    ]
    return [*rows, {"method": "floor", **comparison.limit, **comparison.floor}]


def wrinkle_verdict(comparison: WrinkleComparison) -> str:
    """Who is nearest to the truth, in sentences; a rival that wins is named as plainly as ours would be."""
    given = {way.name: way.given[_GIVEN] for way in comparison.ways if way.given}
    free = {way.name: way.free[_FREE] for way in comparison.ways if way.free}
    told = lambda figures, unit: ", ".join(  # noqa: E731
        f"{name} {value:.3g}{unit}" for name, value in sorted(figures.items(), key=lambda item: item[1])
    )
    return (
        f"Given the coarse state, {min(given, key=given.__getitem__)} is nearest to the truth's normals: "
        f"{told(given, ' deg')}.\n\n"
        f"Running freely, {min(free, key=free.__getitem__)} is nearest to the truth's spectrum of folds (largest "
        f"relative error of a band's bending energy): {told(free, '')}; the floor is {comparison.floor[_FREE]:.3g}."
    )
