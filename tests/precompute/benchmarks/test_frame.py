"""The parts of a frame: they add up, plain cloth has its own, and the stopwatch leaves everything as it was."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from pbd import InputError
from pbd.taichi_internals import Launch
from precompute.benchmarks import frame as frame_module
from precompute.benchmarks.frame import FrameBench, bench_frame, frame_text
from precompute.benchmarks.frame_limits import MachineSpeed, network_products
from precompute.benchmarks.stopwatch import METHODS, Stopwatch, stopwatch
from tests.runtime.players import skirt_database
from wrinkles.database_file import write_database

OURS = {"skinning", "preparation", "search", "coarse_step", "network", "surface", "relaxation", "normals"}
PLAIN = {"skinning", "preparation", "search", "coarse_step", "normals"}


@pytest.fixture(scope="module", params=[1, pytest.param(2, marks=pytest.mark.proof)])
def path(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A skirt with one mesh between the coarse and the fine one, or none."""
    path = tmp_path_factory.mktemp("frame") / "skirt.h5"
    write_database(path, skirt_database(subdivisions=request.param))
    return path


@pytest.fixture(scope="module")
def bench(path: Path) -> FrameBench:
    with patch.object(frame_module, "PLAIN_S", dict.fromkeys(frame_module.PLAIN_S, 0.0)):
        return bench_frame(path, 0.3)


def test_every_part_of_ours_and_of_plain_cloth_has_a_time_and_a_limit(bench: FrameBench) -> None:
    middle = {"plain_middle", "plain_middle_6_substeps"} if len(bench.costs) == 3 else set()
    assert [cost.name for cost in bench.costs] == ["ours", *(n for n in frame_module.PLAIN_S if n not in middle)]
    for cost in bench.costs:
        parts = OURS if cost.name == "ours" else PLAIN
        assert set(cost.times) == parts | {"rest", "frame"} and set(cost.limits) == parts | {"frame"}
        assert all((cost.times[part] > 0).any() and cost.limits[part] > 0 for part in parts)
        whole = sum(times for part, times in cost.times.items() if part != "frame")
        assert np.allclose(whole, cost.times["frame"], rtol=1e-12)
    counts, fine = [cost.vertex_count for cost in bench.costs], bench.costs[-1]
    if middle:
        assert counts[0] == counts[1] < counts[2] and fine.substeps == 2 * bench.costs[1].substeps
        return
    assert counts[0] == counts[1] < counts[2] == counts[3] < counts[4]
    assert bench.costs[3].substeps == 6 and fine.substeps == 2 * bench.costs[2].substeps


def test_figures_have_the_names_of_the_parts(bench: FrameBench) -> None:
    figures = bench.figures()
    for part in (*OURS, "frame"):
        assert figures[f"{part}_over_limit"] == figures[f"{part}_ms"] / figures[f"{part}_limit_ms"]
    assert figures["frame_p99_over_p50"] == figures["frame_ms_p99"] / figures["frame_ms_p50"] >= 1.0
    assert figures["plain_fine_frame_ms"] > figures["plain_coarse_frame_ms"]
    assert figures["frame_without_network_ms"] < figures["frame_ms_p50"]
    assert figures["growth_of_four_times_the_vertices"] > 1.0
    assert len(bench.rows()) == sum(len(cost.times) for cost in bench.costs)
    text = frame_text(bench)
    assert all(cost.name.replace("_", " ") in text for cost in bench.costs)
    delivered = replace(bench, growth=None)  # where a fine mesh was delivered
    assert set(figures) - set(delivered.figures()) == {"growth_of_four_times_the_vertices"}
    assert set(text.splitlines()) - set(frame_text(delivered).splitlines()) == {
        f"four times the vertices take {bench.growth:.2f} times as long"
    }


def test_a_limit_counts_bytes_and_products() -> None:
    assert MachineSpeed(1e7, 5e7).figures() == {"memory_copy_gb_s": 10.0, "blas_gflop_s": 100.0}
    database = skirt_database()
    m = database.mapping
    each = m.weights_1.size + m.weights_2[0].size + m.weights_3[0].size + database.atoms.shapes.size
    assert network_products(database) == each * len(database.coarse_vertices)


def test_a_stopwatch_charges_the_innermost_part() -> None:
    ticks = iter([0.0, 1.0, 3.0, 6.0, 10.0, 15.0])
    with patch("precompute.benchmarks.stopwatch.time.process_time", lambda: next(ticks)):
        watch = Stopwatch()
        with watch.part("network"):
            assert watch.part_of("wrinkles.decoder") == "surface" and watch.part_of("pbd.attachment") == "relaxation"
            with watch.part("surface"):
                assert watch.part_of("wrinkles.decoder") == "surface"
        found = watch.take()
    assert found == {"rest": 1000.0 + 5000.0, "network": 2000.0 + 4000.0, "surface": 3000.0}


def test_a_stopwatch_leaves_methods_as_they_were() -> None:
    wrapped = [(owner, name, getattr(owner, name)) for owner, name, _ in METHODS] + [
        (Launch, "__call__", Launch.__call__)
    ]
    with pytest.raises(ZeroDivisionError), stopwatch():
        assert all(getattr(owner, name) is not was for owner, name, was in wrapped)
        raise ZeroDivisionError
    assert all(getattr(owner, name) is was for owner, name, was in wrapped)


def test_a_motion_of_a_few_frames_is_refused(path: Path) -> None:
    with pytest.raises(InputError, match="--seconds.*0.1.*at least"):
        bench_frame(path, 0.1)
