import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pbd import ClothMesh
from precompute.validation import drape_cipc
from precompute.validation.drape_cipc import SECTIONS, compare_drapes, folds_of, outermost_radius
from precompute.validation.trial import TrialResult, TrialSetting
from precompute.validation.validation import ROWS, validate


def tube(folds: int, depth: float, turn: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """An upright tube about the axis x = z = 0 with folds of a depth [m], turned by an angle [rad]."""
    around, rows = 360, 12
    angle, height = np.meshgrid(2.0 * np.pi * np.arange(around) / around, np.linspace(0.55, 1.0, rows))
    radius = 0.2 + 0.5 * depth * np.cos(folds * (angle - turn))
    vertices = np.stack([radius * np.cos(angle), height, radius * np.sin(angle)], axis=-1).reshape(-1, 3)
    row, column = (part.ravel() for part in np.indices((rows - 1, around)))
    a, b = row * around + column, row * around + (column + 1) % around
    faces = np.concatenate([np.stack([a, a + around, b], axis=1), np.stack([b, a + around, b + around], axis=1)])
    return vertices, faces.astype(np.int32)


def test_folds_are_counted_with_their_depths_and_places() -> None:
    vertices, faces = tube(9, 0.02, turn=0.1)
    directions, depths = folds_of(outermost_radius(vertices, faces, 0.7, np.zeros(2)))
    assert len(directions) == 9
    np.testing.assert_allclose(depths, 0.02, rtol=0.05)
    np.testing.assert_allclose(np.sort(directions)[0], np.degrees(0.1), atol=0.6)


def test_a_round_tube_has_no_folds() -> None:
    directions, _ = folds_of(outermost_radius(*tube(9, 0.001), 0.7, np.zeros(2)))
    assert len(directions) == 0


def test_a_drape_is_compared_with_itself_and_with_a_turned_one() -> None:
    mesh = ClothMesh.from_surface(*tube(0, 0.0))
    reference, turned = tube(9, 0.02)[0], tube(9, 0.02, turn=np.radians(20.0))[0]
    same = compare_drapes(mesh, reference, reference, 0.0)
    assert same.worst_octave == pytest.approx(0.0) and (same.same_place == 1.0).all()
    assert (same.folds == 9).all() and same.folds.shape == (len(SECTIONS), 2)
    moved = compare_drapes(mesh, turned, reference, 0.0)
    assert (moved.same_place == 0.0).all() and (moved.folds == 9).all()
    deeper = compare_drapes(mesh, tube(9, 0.03)[0], reference, 0.0)
    assert deeper.worst_octave > 1.0  # energy grows as the square of the depth


def test_without_the_data_nothing_is_measured(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("GUBE_DATA", str(tmp_path))
    result = validate(ROWS["drape_cipc"], {})
    assert not result.passed_best and "GUBE_DATA" in result.reason


def test_a_given_mesh_is_not_run_again_as_a_finer_one(monkeypatch: pytest.MonkeyPatch) -> None:
    tried = []

    def hopeless(setting: TrialSetting) -> TrialResult:
        tried.append(setting.edges)
        return TrialResult(1.0, 2.0, 1.0, 0.1)

    given = replace(ROWS["drape_cipc"], measure=hopeless, parameters={})
    validate(given, {})
    assert set(tried) == {TrialSetting.edges}
    tried.clear()
    validate(replace(given, refines=True), {})
    assert set(tried) == {TrialSetting.edges // 2, TrialSetting.edges, 2 * TrialSetting.edges}


@pytest.mark.proof
def test_the_dress_closes_and_hangs_as_an_ipc_solver_drapes_it(monkeypatch: pytest.MonkeyPatch) -> None:
    data = Path(os.environ.get("GUBE_DATA") or "../shared/data")
    if not (data / "garments" / "cipc_dress_draped.obj").exists():
        pytest.skip(f"the dress is not in {data} (GUBE_DATA)")
    monkeypatch.setattr(drape_cipc, "_side_by_side", lambda *_: None)
    result = ROWS["drape_cipc"].run(TrialSetting(substeps=24), {})
    assert result.figures["seam gap [mm]"] < 0.5
    # The shortest octave is left out: the panels do not touch one another, and the tops of the pleats crumple.
    longer = [v for name, v in result.figures.items() if name.startswith("octave") and "under" not in name]
    assert 0.65 < min(longer) and max(longer) < 1.35
