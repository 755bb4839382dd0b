from __future__ import annotations

import time

import pytest

from precompute.learning.stages import StageClock, StageTime, counted, remaining, stage_figures, stage_table
from precompute.workers import Workers


def test_stages_are_timed_by_the_clock_and_by_the_processor() -> None:
    told: list[str] = []
    clock = StageClock(("sleeping", "working hard"), Workers(1), told.append)
    with clock.stage("sleeping"):
        time.sleep(0.05)
        clock("half asleep")
    with clock.stage("working hard"):
        began = time.process_time()
        while time.process_time() - began < 0.05:
            pass
    sleeping, working = clock.times
    assert sleeping.wall_s >= 0.05 > sleeping.processor_s
    assert working.processor_s >= 0.05 and working.wall_s >= working.processor_s - 0.02
    assert told == ["stage 1 of 2: sleeping", "stage 1 of 2: half asleep", "stage 2 of 2: working hard"]


def test_a_stage_out_of_turn_is_refused() -> None:
    clock = StageClock(("first", "second"), Workers(1))
    with pytest.raises(ValueError, match="stage 'second' is not next, but 'first'"), clock.stage("second"):
        pass
    assert not clock.times


def test_the_table_says_how_many_cores_were_busy() -> None:
    times = [StageTime("fitting patches", 3.0, 6.0), StageTime("fitting", 1.0, 0.5)]
    assert stage_figures(times) == {"stage_fitting_patches_s": 3.0, "stage_fitting_s": 1.0}
    head, *rows, last = [line.split() for line in stage_table(times).splitlines()]
    assert head == ["stage", "wall", "s", "processor", "s", "cores", "share"]
    assert rows == [["fitting", "patches", "3.0", "6.0", "2.00", "75%"], ["fitting", "1.0", "0.5", "0.50", "25%"]]
    assert last == ["all", "4.0", "6.5", "1.62", "100%"]


def test_the_time_left_follows_from_the_share_that_is_done() -> None:
    assert remaining(time.monotonic() - 10.0, 0.25) == ", 30 s left"
    assert remaining(time.monotonic(), 0.0) == ""


def test_parts_are_counted() -> None:
    told: list[str] = []
    tell = counted(told.append, "evaluating", 4)
    for done in (0, 2, 4):
        tell(done, None)
    assert told == ["evaluating: 2 of 4, 0 s left", "evaluating: 4 of 4, 0 s left"]
