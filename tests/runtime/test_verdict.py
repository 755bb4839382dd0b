"""The first three sentences on a database and the rows below them: true, short, and without a word of the glossary."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from runtime.output.verdict import ROWS, cost_sentence, first_lines, verdict
from tests.data import ROOT
from tests.wrinkles.databases import small_database

LEARNED = {
    "normal_error_deg": 5.5,
    "normal_error_smooth_deg": 11.0,
    "bending_energy_ratio": 0.97,
    "smooth_bending_energy_ratio": 0.13,
    "frame_ms_p50": 12.34,
}
COMPARED = {
    "cost_advantage": 1.5,
    "cost_advantage_is_at_least": 0.0,
    "plain_frame_ms": 18.0,
    "plain_substeps": 14.0,
    "plain_vertex_count": 2424.0,
    "plain_passes": 0.0,
}
CHOICES = [{}, {"cost_advantage": 0.5}, {"cost_advantage_is_at_least": 1.0}, {"plain_passes": 2.0}]
QUALITIES = [{}, LEARNED, *(LEARNED | COMPARED | choice for choice in CHOICES)]


def glossary() -> list[str]:
    """Every word that the glossary explains."""
    text = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
    return [word.strip() for found in re.findall(r"^- \*\*(.+?)\*\*", text, re.M) for word in found.split(",")]


def test_the_glossary_is_read() -> None:
    assert {"truth", "fine simulation", "frame", "skill"} <= set(glossary())


@pytest.mark.parametrize("quality", QUALITIES)
def test_no_word_needs_the_glossary(quality: dict[str, float]) -> None:
    database = replace(small_database(side=3), quality=quality)
    text = " ".join([*verdict(database), *(row.label for row in ROWS)])
    assert [word for word in glossary() if re.search(rf"\b{re.escape(word)}\b", text)] == []


def test_the_first_sentence_says_what_it_is() -> None:
    what, *_ = verdict(small_database(side=3))
    assert what.startswith("The garment 'curtain č' (muslin) moves in real time: 9 points are simulated, and 81 are")


def test_the_second_sentence_says_how_good_it_is() -> None:
    database = small_database(side=3)
    assert "take away 50 %" in (good := verdict(replace(database, quality=LEARNED))[1])
    assert "11.0 degrees without them, 5.5 with them" in good and "strength of the garment's folds is 97 % of" in good
    assert "add 100 %" in verdict(replace(database, quality=LEARNED | {"normal_error_deg": 22.0}))[1]
    assert verdict(replace(database, quality={}))[1] == "How near they come to it was not measured."


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, "takes 18.0 ms: the learned folds are played."),
        ({"cost_advantage": 0.5}, "is as good and takes 18.0 ms: that cloth is played instead."),
        ({"cost_advantage_is_at_least": 1.0}, "none is as good up to 18.0 ms (2,424 points in 14 steps)"),
        ({"plain_passes": 2.0}, "(2,424 points in 14 steps, smoothed)"),
    ],
)
def test_the_third_sentence_says_what_it_costs_and_what_else_would_do(changes: dict[str, float], words: str) -> None:
    quality = COMPARED | changes
    sentence = cost_sentence(quality)
    own = quality["plain_frame_ms"] / quality["cost_advantage"]
    assert sentence.startswith(f"A picture takes {own:.1f} ms of one processor core; ") and words in sentence


def test_without_a_comparison_the_third_sentence_says_how_to_get_one() -> None:
    assert cost_sentence(LEARNED).startswith("A picture takes 12.3 ms of one processor core; `gube compare` finds out")
    assert cost_sentence({}).startswith("Its cost was not measured; ")


def test_rows_are_few_and_have_the_figures_of_other_ways_beside_them() -> None:
    lines = first_lines(LEARNED | {"truth_inside_body_percent": 0.03, "inside_body_percent": 0.02, "sted": 1.0})
    assert len(lines) == 4 and len(ROWS) + 2 <= 12  # `gube info` has three rows more, and no time of a first picture
    assert lines[0].split()[-6:] == ["5.5", "degrees", "(without", "learned", "folds", "11.0)"]
    assert lines[2].endswith("0.0200 % (the exact simulation 0.0300)")
    assert first_lines({"sted": 1.0}) == []
