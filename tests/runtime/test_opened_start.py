"""Garments that start through themselves: what is opened, and what is said."""

from __future__ import annotations

import numpy as np

from pbd import Fabric, SolverOptions
from runtime.setup.opened_start import opened
from tests.pbd.meshes import grid
from wrinkles.levels import Levels, levels_of

BODY = np.array([[-0.2, 0.0, -0.2], [0.3, 0.0, -0.2], [0.0, 0.0, 0.4]]), np.array([[0, 2, 1]], np.int32)
OPTIONS = SolverOptions(self_collision=True)


def levels_from(vertices: np.ndarray, faces: np.ndarray) -> Levels:
    return levels_of(vertices, faces, np.zeros(0, int), *BODY, 1)


def two_sheets(apart: float, lift: float) -> tuple[np.ndarray, np.ndarray]:
    """Level sheets over one another in one garment; one corner of the lower one is lifted through the upper one."""
    vertices, faces = grid(8, 8, 0.02)
    level = vertices[:, [0, 2, 1]] + [0.0, 0.1, 0.0]
    lifted = level + lift * np.exp(-((np.linalg.norm(vertices[:, :2], axis=1) / 0.03) ** 2))[:, None] * [0.0, 1.0, 0.0]
    return np.concatenate([lifted, level + [0.003, apart, 0.002]]), np.concatenate([faces, faces + len(vertices)])


def test_what_starts_free_stays_as_it_is() -> None:
    levels = levels_from(*two_sheets(0.01, 0.0))
    found, said = opened(levels, Fabric(), OPTIONS, OPTIONS, *BODY, lambda x: levels_from(x, levels.coarse.faces))
    assert found is levels and not said


def test_a_corner_that_is_through_another_sheet_is_opened_and_told_of() -> None:
    levels = levels_from(*two_sheets(0.01, 0.018))
    found, said = opened(levels, Fabric(), OPTIONS, OPTIONS, *BODY, lambda x: levels_from(x, levels.coarse.faces))
    coarse = said[0]
    assert coarse.mesh == "coarse" and coarse.before > 0 == coarse.after and 0.001 < coarse.moved < 0.03
    moved = np.linalg.norm(found.coarse.vertices - levels.coarse.vertices, axis=1).max()
    assert abs(moved - coarse.moved) < 1e-9
    assert f"starts through itself in {coarse.before} of 256 faces" in str(coarse) and "0 are left" in str(coarse)


def test_sheets_in_one_another_are_named_with_their_place() -> None:
    vertices, faces = grid(8, 8, 0.02)
    level = vertices[:, [0, 2, 1]] + [0.0, 0.1, 0.0]
    levels = levels_from(np.concatenate([level, level]), np.concatenate([faces, faces + len(level)]))
    _, said = opened(levels, Fabric(), OPTIONS, OPTIONS, *BODY, lambda x: levels_from(x, levels.coarse.faces))
    assert said[0].coincident == 256
    assert "256 of 256 faces of the coarse garment lie in another sheet, around (0.08, 0.10, 0.08) m" in str(said[0])
