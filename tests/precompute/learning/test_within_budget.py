"""A scene's budget chooses the mesh that is simulated."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from assets.io.scene import Scene
from pbd import InputError
from precompute.learning import pipeline
from precompute.learning.pipeline import Precomputed, precompute
from precompute.learning.within_budget import choices_within_budget
from tests.precompute.miniature import SCENE, scene


def budgeted(text: str = SCENE, subdivisions: int = 2, budget: float = 5.0) -> Scene:
    text = text.replace("subdivisions = 1", f"subdivisions = {subdivisions}")
    return scene(text.replace("[wrinkles]\n", f"[wrinkles]\nbudget_ms = {budget}\n"))


def shape_of(choice: Scene) -> tuple[int, int, float]:
    garment = choice.garments[0]
    return garment.coarse_subdivisions, garment.subdivision_count, round(choice.solver.substep * 1e3, 3)


def test_a_scene_without_a_budget_is_its_only_choice() -> None:
    assert choices_within_budget(scene()) == [scene()]


def test_every_mesh_below_the_fine_one_is_a_choice_the_finest_first() -> None:
    asked = budgeted(subdivisions=3)
    found = [shape_of(choice) for choice in choices_within_budget(asked)]
    assert found == [(2, 1, 1.042), (2, 1, 2.083), (2, 1, 4.167), (1, 2, 2.083), (1, 2, 4.167), (0, 3, 4.167)]


def test_the_choice_does_not_hang_on_where_the_scene_cuts_its_mesh() -> None:
    cut = replace(budgeted().garments[0], coarse_subdivisions=1, subdivisions=1)
    assert choices_within_budget(replace(budgeted(), garments=(cut,))) == choices_within_budget(budgeted())


@pytest.mark.parametrize(
    ("coarse_fits", "frames_ms", "chosen"),
    [((True,), (4.0,), 0), ((False, True), (4.0,), 1), ((True, True), (6.0, 4.0), 1), ((False, False), (9.0,), 2)],
)
def test_the_first_that_fits_is_kept_and_the_last_in_any_case(
    learned: Precomputed,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    coarse_fits: tuple[bool, ...],
    frames_ms: tuple[float, ...],
    chosen: int,
) -> None:
    asked, lines, seen = budgeted(), [], []
    fits, frames = iter(coarse_fits), iter(frames_ms)
    step_ms = {True: 1.0, False: 6.0}

    def timed(*_: Any) -> list[SimpleNamespace]:
        return [SimpleNamespace(step_ms=step_ms[next(fits)])]

    def made(work: Any, *_: Any) -> Precomputed:
        seen.append(work.scene)
        return replace(learned, database=replace(learned.database, quality={"frame_ms_p50": next(frames)}))

    monkeypatch.setattr(pipeline, "build_layer", lambda levels: SimpleNamespace(levels=levels))  # it takes seconds
    monkeypatch.setattr(pipeline, "record_runs", timed)
    monkeypatch.setattr(pipeline, "_precomputed", made)
    precompute(asked, tmp_path / "skirt.h5", report=lines.append)
    assert seen[-1] == choices_within_budget(asked)[chosen]
    assert (tmp_path / "skirt.h5").exists() and any("ms of 5" in line for line in lines)


def test_a_budget_that_cannot_be_kept_to_is_refused() -> None:
    text = SCENE.replace("[[training.held_out]]", "[[training.clips]]")
    with pytest.raises(InputError, match=r"wrinkles\.budget_ms: a budget without motion to time.*training\.held_out"):
        choices_within_budget(budgeted(text))
    cut = replace(budgeted().garments[0], coarse_vertices=200, pattern=True)
    with pytest.raises(InputError, match="a budget for a decimated mesh.*coarse_vertices"):
        choices_within_budget(replace(budgeted(), garments=(cut,)))
