"""Realism: identical processes cannot be told, noise, blur and a stiffer motion can."""

from __future__ import annotations

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from pbd import ClothMesh, InputError
from precompute.wrinkle_comparison.realism import FEATURES, PatchStatistics, Realism, realism
from tests.wrinkles.meshes import tube, turned
from wrinkles.spectrum import LowPass

FRAMES = 120


@pytest.fixture(scope="module")
def mesh() -> ClothMesh:
    """A skirt of 5,100 vertices, 8 mm apart: half a metre high."""
    vertices, faces = tube(72, 0.09)
    return ClothMesh.from_surface(vertices, faces)


@pytest.fixture(scope="module")
def statistics(mesh: ClothMesh) -> PatchStatistics:
    return PatchStatistics(mesh)


def folds(mesh: ClothMesh, seed: int, height: float = 0.0015, pace: float = 0.35, spread: float = 0.7) -> np.ndarray:
    """Random waves of 4 to 12 cm that wander over the cloth, in FRAMES frames [m].

    All seeds have the same waves: their phases are random, and the ways that they go.

    Args:
        mesh: of the cloth.
        seed: of the phases.
        height: root mean square [m].
        pace: mean change of a phase in a frame [rad].
        spread: of the paces of the waves over their mean. Where it is 0, places of large and small folds never change.
    """
    rng = np.random.default_rng(seed)
    around, up = np.meshgrid(np.arange(0, 15), np.arange(0, 17))
    radius, tall = np.linalg.norm(mesh.vertices[0, [0, 2]]), np.ptp(mesh.vertices[:, 1])
    length = 2.0 * np.pi / np.hypot(around / radius, 2.0 * np.pi * up / tall + 1e-9)
    waves = np.stack([around, up, length], axis=-1)[(length > 0.04) & (length < 0.12)]
    angle = np.arctan2(mesh.vertices[:, 0], mesh.vertices[:, 2])
    phase = np.outer(angle, waves[:, 0] * rng.choice([-1.0, 1.0], len(waves)))
    phase += np.outer(mesh.vertices[:, 1] * 2.0 * np.pi / tall, waves[:, 1])
    phase += rng.uniform(0.0, 2.0 * np.pi, len(waves))
    paces = pace * np.random.default_rng(0).uniform(1.0 - spread, 1.0 + spread, len(waves))
    wander = np.outer(np.arange(FRAMES), rng.choice([-1.0, 1.0], len(waves)) * paces)
    size = waves[:, 2] ** 1.5
    size *= height * np.sqrt(2.0) / np.linalg.norm(size)
    offset = np.cos(wander) @ (size[:, None] * np.cos(phase.T)) - np.sin(wander) @ (size[:, None] * np.sin(phase.T))
    normal = np.stack([np.sin(angle), np.zeros(len(angle)), np.cos(angle)], axis=1)
    return mesh.vertices + offset[..., None] * normal


@pytest.fixture(scope="module")
def truth(mesh: ClothMesh) -> np.ndarray:
    return folds(mesh, 0)


@pytest.fixture(scope="module")
def of_truth(statistics: PatchStatistics, truth: np.ndarray) -> np.ndarray:
    return statistics(truth)


def told(statistics: PatchStatistics, of_truth: np.ndarray, method: np.ndarray) -> Realism:
    return realism(statistics, of_truth, statistics(method))


@pytest.mark.parametrize("seed", [1, 2])
def test_two_runs_of_one_process_cannot_be_told(
    seed: int, mesh: ClothMesh, statistics: PatchStatistics, of_truth: np.ndarray
) -> None:
    assert told(statistics, of_truth, folds(mesh, seed)).auc < 0.55
    assert realism(statistics, of_truth, of_truth).auc == 0.5


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.proof) for seed in (2, 3))])
def test_folds_that_keep_their_places_do_not_tell_two_runs_of_one_process(
    seed: int, mesh: ClothMesh, statistics: PatchStatistics
) -> None:
    of_truth = statistics(folds(mesh, 0, spread=0.0))
    assert told(statistics, of_truth, folds(mesh, seed, spread=0.0)).auc < 0.55


def test_the_place_in_space_does_not_matter(
    statistics: PatchStatistics, truth: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("precompute.wrinkle_comparison.realism.NOISE", 0.0)
    moved = turned(truth, 70.0, axis=1) + [3.0, 1.0, -2.0]
    np.testing.assert_allclose(statistics(moved), statistics(truth), rtol=1e-3, atol=1e-3)


def test_what_turns_normals_less_than_the_noise_is_not_found(
    mesh: ClothMesh, statistics: PatchStatistics, of_truth: np.ndarray
) -> None:
    noise = np.random.default_rng(5).normal(size=(FRAMES, *mesh.vertices.shape))
    assert told(statistics, of_truth, folds(mesh, 1) + 3e-5 * noise).auc < 0.55


def test_noise_and_blur_and_haste_are_found(mesh: ClothMesh, statistics: PatchStatistics, of_truth: np.ndarray) -> None:
    noise = np.random.default_rng(5).normal(size=(FRAMES, *mesh.vertices.shape))
    noisy = told(statistics, of_truth, folds(mesh, 1) + 1e-3 * noise)
    assert noisy.auc > 0.9
    assert noisy.by_feature["turn of the normals, within 3 cm"] > 0.9
    blurred = told(statistics, of_truth, LowPass(mesh, 0.06)(folds(mesh, 1)))
    assert blurred.auc > 0.9
    assert blurred.by_feature["size of the bend, within 6 cm"] < 0.1
    assert "too small" in blurred.told_by()
    hasty = told(statistics, of_truth, folds(mesh, 1, pace=0.8))
    assert hasty.auc > 0.9
    assert max(hasty.by_feature, key=lambda name: hasty.by_feature[name]).split(",")[0].endswith("in time")


def test_the_place_that_gives_a_method_away_is_named(
    mesh: ClothMesh, statistics: PatchStatistics, of_truth: np.ndarray
) -> None:
    share = np.clip((mesh.vertices[:, 1].min() + 0.15 - mesh.vertices[:, 1]) / 0.05, 0.0, 1.0)[:, None]
    other, flat = folds(mesh, 1), folds(mesh, 1, height=1e-4)
    found = told(statistics, of_truth, (1.0 - share) * other + share * flat)
    assert max(found.by_place["front bottom"], found.by_place["back bottom"]) > 0.8
    assert max(found.by_place["front top"], found.by_place["back top"]) < 0.6
    assert "too small" in found.told_by()


def test_the_count_of_threads_does_not_matter(
    mesh: ClothMesh, statistics: PatchStatistics, of_truth: np.ndarray
) -> None:
    found = []
    for count in (1, 2):
        with threadpool_limits(count):
            found.append(told(statistics, of_truth, folds(mesh, 1, height=0.0033)))
    assert found[0] == found[1]


def test_a_short_motion_is_refused(statistics: PatchStatistics, truth: np.ndarray) -> None:
    with pytest.raises(InputError, match="too few frames"):
        statistics(truth[:8])
    assert statistics(truth[:16]).shape[1:] == (len(statistics.centres), len(FEATURES))
