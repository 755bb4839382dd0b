"""The fine simulation that a database is judged by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pbd import InputError, Plane
from precompute.learning.run_recording import Recording
from precompute.learning.truth import Truth, fine_run
from tests.runtime.players import skirt_database, skirt_stage

SUBSTEP = 1.0 / 1440.0  # of the fine run [s]


@pytest.fixture(scope="module")
def truth() -> Truth:
    """Of two seconds, every second frame recorded after 1.5 s; nothing is simulated."""
    stage = skirt_stage()
    run = fine_run(stage.levels, stage.body, stage.motion(), skirt_database(), substep=SUBSTEP)
    numbers = np.arange(92, 121, 2)
    zeros = np.zeros((len(numbers), 1, 3), np.float32)
    recording = Recording("walk", numbers, zeros, zeros, zeros, zeros, 1.0)
    energy = numbers[:, None].astype(float)
    return Truth(run, stage.levels, recording, zeros, energy, (zeros, zeros))


def test_the_fine_cloth_takes_its_own_substep(truth: Truth) -> None:
    assert truth.run.solver == replace(skirt_database().solver, substep=SUBSTEP)
    assert truth.run.bend_factor is not None  # measured once; each run would measure it again


def test_the_start_of_a_truth_is_cut_alike_everywhere(truth: Truth) -> None:
    start = truth.until(1.7)
    assert start.recording.frames.tolist() == [92, 94, 96, 98, 100, 102]
    assert start.run.frame_count == 102
    assert len(start.frames) == len(start.floor) == 6 and [len(other) for other in start.others] == [6, 6]
    assert start.energy[:, 0].tolist() == start.recording.frames.tolist()


def test_a_start_with_nothing_to_judge_is_refused(truth: Truth) -> None:
    with pytest.raises(InputError, match="too short"):
        truth.until(1.0)


def test_wind_and_colliders_make_another_run(truth: Truth) -> None:
    stage, database = skirt_stage(), skirt_database()
    motion = stage.motion()
    keys = [
        fine_run(stage.levels, stage.body, motion, database, substep=SUBSTEP, wind=wind, primitives=primitives).key()
        for wind, primitives in (
            ((0.0, 0.0, 0.0), ()),
            ((1.0, 0.0, 0.0), ()),
            ((0.0, 0.0, 0.0), (Plane((0.0, 0.0, 0.0)),)),
            ((0.0, 0.0, 0.0), (Plane((0.0, 0.1, 0.0)),)),
        )
    ]
    assert keys[0] == truth.run.key()
    assert len(set(keys)) == 4
