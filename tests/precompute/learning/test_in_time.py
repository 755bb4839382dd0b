"""Figures in time: each tells what it is named after from what it is not."""

from __future__ import annotations

import numpy as np
import pytest

from precompute.learning.in_time import SLOWED, Pause, popping
from precompute.learning.run_recording import Run
from precompute.learning.truth import fine_run
from runtime.play.simulation import poses_of
from tests.runtime.players import skirt_database, skirt_stage

START, STILL, PIECE = 1.5, 0.4, 0.5


@pytest.fixture(scope="module")
def run() -> Run:
    """Three seconds of the walk; nothing is simulated."""
    stage = skirt_stage()
    whole = fine_run(stage.levels, stage.body, stage.motion(), skirt_database(), substep=1.0 / 1440.0)
    return Run(**(vars(whole) | {"poses": poses_of(stage.motion(), whole.dt, 3.0)}))


@pytest.mark.parametrize("seconds", [3.0, 1.6, 0.5])
def test_a_pause_stops_and_goes_there_and_back_through_the_same_poses(run: Run, seconds: float) -> None:
    given = run.poses[: round(seconds / run.dt) + 1]
    pause = Pause.of(Run(**(vars(run) | {"poses": given})), START, STILL, piece=PIECE)
    poses, turn = pause.run.poses[1:], min(90, len(given) - 2)  # recorded frames begin after the first pose
    assert pause.run.every == 1 and pause.run.poses.dtype == run.poses.dtype
    assert np.array_equal(pause.run.poses[: turn + 1], given[: turn + 1])
    still = poses[pause.still]
    assert len(still) == round(STILL / run.dt) // 3 and (still == given[turn]).all()
    piece = min(round(PIECE / run.dt), len(given) - 1 - turn)
    there, back = poses[pause.there], poses[pause.back]
    assert len(there) == len(back) == SLOWED * piece // 2 and np.array_equal(there, back)
    assert np.array_equal(there[2::SLOWED], given[turn + 1 : turn + 1 + len(there[2::SLOWED])])
    assert np.array_equal(poses[-1], given[turn])
    # Nowhere a jump: a step is at most as long as the motion's own.
    length = lambda p: np.abs(np.diff(p, axis=0)).max(axis=(1, 2, 3))  # noqa: E731
    assert length(pause.run.poses).max() <= length(given).max() * (1 + 1e-9)
    assert length(poses[pause.still.stop :]).max() <= length(given[turn : turn + piece + 1]).max() / SLOWED * (1 + 1e-9)


def test_jitter_counts_at_rest_only_and_the_gap_between_both_ways_only(run: Run) -> None:
    pause = Pause.of(run, START)
    frames = np.random.default_rng(0).standard_normal((1, 50, 3)).repeat(pause.run.frame_count, axis=0)
    assert pause.figures(frames) == {"rest_jitter_px": 0.0, "reverse_gap_mm": 0.0}
    moved = frames.copy()
    moved[: pause.still.start] += np.random.default_rng(1).standard_normal(moved[: pause.still.start].shape)
    moved[pause.back] += [0.0, 3e-3, 4e-3]
    assert pause.figures(moved, "truth_") == {"truth_rest_jitter_px": 0.0, "truth_reverse_gap_mm": pytest.approx(5.0)}
    moved[pause.still][::2] += [1e-3, 0.0, 0.0]
    assert pause.figures(moved)["rest_jitter_px"] == pytest.approx(0.5, rel=0.05)  # a millimetre to and fro


def test_the_speed_at_rest_is_that_of_the_last_third_of_the_pause(run: Run) -> None:
    pause = Pause.of(run, START)
    assert len(pause.run.poses[1:][pause.still]) == round(1.0 / run.dt)
    steps = np.arange(pause.run.frame_count)[:, None, None] * run.dt * np.array([0.0, 3e-3, 4e-3])
    coarse = np.random.default_rng(0).standard_normal((1, 9, 3)) + steps
    assert pause.rest_speed(coarse) == pytest.approx(5.0)
    coarse[: pause.still.start] *= 2.0
    coarse[pause.still.stop :] *= 2.0
    assert pause.rest_speed(coarse) == pytest.approx(5.0)


def test_popping_is_seen_in_the_frame_of_each_patch() -> None:
    rng = np.random.default_rng(0)
    patches = np.repeat(np.arange(4), 25)
    turns = np.linalg.qr(rng.standard_normal((6, 4, 3, 3)))[0]
    local = np.broadcast_to(rng.standard_normal((100, 3)), (6, 100, 3)).copy()
    spatial = lambda d: np.einsum("fna,fnai->fni", d, turns[:, patches])  # noqa: E731
    frames = turns.reshape(6, 4, 9)
    assert popping(spatial(local), frames, patches) == pytest.approx(0.0, abs=1e-6)  # turned along, it does not change
    local[3:, patches == 2] += [0.0, 0.0, 2.0]
    rms = np.sqrt((local**2).sum(axis=2).mean())
    assert popping(spatial(local), frames, patches) == pytest.approx(2.0 / rms)
