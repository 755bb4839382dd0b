"""Figures in words, and how many digits of them are shown."""

from __future__ import annotations

import re

import pytest

from runtime.output.figures import FIGURES, FIRST, figure_lines, figure_of, value_texts

# What the end of a figure's name says about its unit.
UNITS = {
    unit if unit != "%" else "percent": unit for unit in ("deg", "%", "mm", "mm/s", "px", "ms", "s", "frames", "W/kg")
}


def test_a_figure_has_a_plain_name_and_the_unit_of_its_name() -> None:
    wrong = []
    for name, figure in FIGURES.items():
        plain = figure.label and figure.meaning and "_" not in figure.label + figure.meaning
        end = re.sub("_p[0-9]+$", "", name.replace("_mm_s", "_mm/s").replace("w_kg", "W/kg")).rpartition("_")[2]
        if not plain or figure.unit != ("us" if name.startswith("us_") else UNITS.get(end, "-")):
            wrong.append(name)
    assert wrong == []


def test_no_two_figures_share_a_name() -> None:
    labels = [figure.label for figure in FIGURES.values()]
    assert len(set(labels)) == len(labels)


def test_figures_that_come_first_are_declared() -> None:
    names = [name for group in FIRST.values() for name in group]
    assert len(set(names)) == len(names) and set(names) <= set(FIGURES)


@pytest.mark.parametrize(
    ("name", "label", "meaning"),
    [
        ("normal_error_deg", "normal error", "angle between our normals"),
        ("band_ratio_under_52.1_mm", "bending energy, under 52.1 mm", "band of wavelengths"),
        ("denim_normal_error_deg", "normal error, denim", "angle between our normals"),
        ("seam_gap_mm", "seam gap mm", ""),
    ],
)
def test_a_figure_is_found_by_its_name(name: str, label: str, meaning: str) -> None:
    figure = figure_of(name)
    assert figure.label == label and meaning in figure.meaning
    assert figure.meaning in figure_lines({name: 1.0})[1]


@pytest.mark.parametrize(
    ("values", "texts"),
    [
        ([3.2608, 8.8609, None], ["3.26", "8.86", ""]),
        ([0.0414, 34.97], ["0.0", "35.0"]),
        ([9552.0], ["9552"]),
        ([120.1049], ["120"]),
        ([0.0, 0.0], ["0", "0"]),
        ([0.0193703], ["0.0194"]),
        ([5.9e-5], ["0.0001"]),
        ([-0.62], ["-0.620"]),
        ([None], [""]),
    ],
)
def test_numbers_of_a_row_have_equally_many_decimals(values: list[float | None], texts: list[str]) -> None:
    assert value_texts(values) == texts
