"""The table of garments in other engines: what is as good as a rival, and what a rival is ahead by."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from pbd import ClothMesh
from pbd.distance import penetration_figures
from precompute.benchmarks.garment_bench import (
    CROSSED,
    INSIDE,
    STRETCH,
    GarmentBench,
    RivalSetting,
    _crossed,
    bench_text,
)
from precompute.learning.truth import Truth
from precompute.wrinkle_comparison.comparison import ERRORS, Method, MotionComparison
from tests.wrinkles.meshes import flat_sheet


def some(
    prefix: str, frame_ms: float, error: float, *, mesh: str = "", stretch: float = 2.0, **errors: float
) -> Method:
    """A method with one error for all but those that are named."""
    values = dict.fromkeys(ERRORS, error) | errors
    figures = {ERRORS[name]: math.exp(value) if name == "spread" else value for name, value in values.items()}
    runs = (np.zeros((1, 1, 3)),) * 4
    return Method(
        prefix, prefix or "ours", frame_ms, figures | {STRETCH: stretch, INSIDE: 0.0, CROSSED: 0.0}, {}, runs, mesh=mesh
    )


def bench(rival: Method, *ours: Method, ended: str = "") -> GarmentBench:
    """A garment with one rival; the floor and the truth have errors of 0.1 and a stretch of 2 %."""
    methods = (*ours, some("floor_", math.nan, 0.1), some("truth_", 100.0, 0.1), rival)
    motion = MotionComparison("walk", cast(Truth, None), methods)
    return GarmentBench(
        "skirt", motion, (RivalSetting(rival, "Blender", "speed", ended),), {}, {"MuJoCo flex": "not installed"}
    )


def test_the_cheapest_of_ours_that_is_as_good_is_named_with_its_share() -> None:
    ours = some("", 8.0, 0.2), some("plain_3_", 4.0, 0.3, mesh="coarse"), some("plain_6_", 5.0, 0.25, mesh="coarse")
    found = bench(some("rival_", 50.0, 0.25), *ours)
    row = found.rows()[-1]
    assert row["ours as good"] == "plain_6_" and row["its share"] == pytest.approx(0.1)
    assert "as good with plain_6_: 0.10 of its time" in bench_text(found)


def test_a_rival_within_the_floor_is_no_better() -> None:
    assert (
        bench(some("rival_", 50.0, 0.01), some("", 8.0, 0.09)).cheapest_as_good(some("rival_", 50.0, 0.01)) is not None
    )


@pytest.mark.parametrize(
    ("rival", "by"),
    [
        (some("rival_", 50.0, 0.5, normals=0.15), "normals"),
        (some("rival_", 50.0, 0.5, bias=0.15, octaves=0.15), "octaves bias"),
    ],
)
def test_what_a_rival_is_ahead_by_is_said(rival: Method, by: str) -> None:
    found = bench(rival, some("", 8.0, 0.2), some("plain_3_", 4.0, 0.6, mesh="coarse"))
    assert found.rows()[-1]["rival ahead by"] == by
    assert f"ahead of ours by {by}" in bench_text(found)


def test_cloth_that_is_stretched_more_than_the_rival_and_the_truth_is_not_as_good() -> None:
    assert (
        bench(some("rival_", 50.0, 0.5, stretch=1.0), some("", 8.0, 0.2, stretch=3.0)).rows()[-1]["rival ahead by"]
        == "stretch"
    )
    assert (
        bench(some("rival_", 50.0, 0.5, stretch=1.0), some("", 8.0, 0.2, stretch=2.0)).rows()[-1]["ours as good"]
        == "ours"
    )


def test_a_spread_that_a_single_run_does_not_have_is_not_asked() -> None:
    rival = some("rival_", 50.0, 0.5)
    figures = {name: value for name, value in rival.figures.items() if name != ERRORS["spread"]}
    alone = Method("rival_", "rival_", 50.0, figures, {}, rival.runs[:1])
    assert bench(alone, some("", 8.0, 0.2)).rows()[-1]["ours as good"] == "ours"


def test_what_stopped_a_rival_and_what_is_missing_is_said() -> None:
    stopped = Method("rival_", "Blender for speed, 9,552", 700.0, {}, {})
    text = bench_text(bench(stopped, some("", 8.0, 0.2), ended="given up: 700 ms a frame"))
    assert "given up: 700 ms a frame" in text and "MuJoCo flex: not installed" in text


def test_plain_cloth_that_decides_on_one_run_is_run_again_until_several_decide() -> None:
    once = some("plain_3_", 4.0, 0.3, mesh="coarse")
    once = replace(once, runs=once.runs[:1])
    found = bench(some("rival_", 50.0, 0.35), some("", 8.0, 0.2), once)
    assert [one.prefix for one in found.undecided] == ["plain_3_"]
    worse = replace(some("plain_3_", 4.0, 0.9, mesh="coarse"), name="worse")
    found = replace(found, motion=found.motion.with_method(worse))
    assert found.undecided == [] and found.rows()[-1]["ours as good"] == "ours"


def test_the_best_of_each_engine_within_a_time_is_named_and_where_there_is_none_that_is_said() -> None:
    plain = some("plain_3_", 3.0, 0.5, mesh="coarse"), some("plain_6_", 7.0, 0.3, mesh="coarse")
    found = bench(some("rival_", 12.0, 0.6), some("", 9.0, 0.2), *plain)
    best = {(row["within [ms]"], row["engine"]): row["method"] for row in found.reached()}
    assert best == {
        (4.0, "gube, plain cloth"): "plain_3_", (4.0, "gube, wrinkles; Blender"): "none",
        (8.0, "gube, plain cloth"): "plain_6_", (8.0, "gube, wrinkles; Blender"): "none",
        (16.0, "gube, wrinkles"): "ours", (16.0, "gube, plain cloth"): "plain_6_", (16.0, "Blender"): "rival_",
    }  # fmt: skip
    assert "within 8 ms, gube, wrinkles; Blender: none" in bench_text(found)
    assert "within 16 ms, Blender: rival_, 12 ms, worst octave 0.6" in bench_text(found)


def test_the_share_inside_the_body_is_one_that_is_measured() -> None:
    assert INSIDE in penetration_figures(np.zeros(3), np.ones(3, bool))


def test_cloth_in_a_heap_crosses_wholly_and_smooth_cloth_nowhere() -> None:
    vertices, faces = flat_sheet(25, 1.0)
    truth = cast(Truth, SimpleNamespace(levels=SimpleNamespace(fine=ClothMesh.from_surface(vertices, faces))))
    heap = 1e-3 * np.random.default_rng(0).random(vertices.shape)
    assert _crossed(truth, vertices[None].astype(np.float32)) == 0.0
    assert _crossed(truth, np.array([vertices, heap], np.float32)) == 50.0
