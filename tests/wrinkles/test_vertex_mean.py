from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import identity

from pbd import ClothMesh
from pbd.geometry import surface_normals
from tests.wrinkles.delivered import delivered_levels, delivered_panels
from tests.wrinkles.fine_surfaces import patch_sums
from tests.wrinkles.meshes import icosphere
from wrinkles.charts import Charts
from wrinkles.features import DYNAMIC_COUNT, Stencil
from wrinkles.fine_surface import FineSurface
from wrinkles.levels import Levels
from wrinkles.patches import Patches
from wrinkles.surface import Subdivision
from wrinkles.vertex_mean import MEAN_STEP, fit_vertex_mean, turned


@pytest.fixture(scope="module")
def levels() -> Levels:
    return delivered_levels(*delivered_panels()[2:])


@pytest.fixture(scope="module")
def patches(levels: Levels) -> Patches:
    return Patches.of(levels.subdivision, Charts.of(levels.coarse))


def frames_of(levels: Levels, coarse: np.ndarray) -> np.ndarray:
    """Frames of the coarse vertices, float32, shape (n, 9)."""
    count = len(coarse)
    position, frames = np.zeros((count, 4), np.float32), np.zeros((count, 9), np.float32)
    position[:, :3] = coarse
    stencil = Stencil.of(Charts.of(levels.coarse), levels.coarse_held)
    stencil.read(position, np.zeros(count, np.float32), frames, np.zeros((count, DYNAMIC_COUNT), np.float32))
    return frames


def rotation(axis: int, angle: float) -> np.ndarray:
    cos, sin = np.cos(angle), np.sin(angle)
    return np.roll(np.array([[1.0, 0.0, 0.0], [0.0, cos, -sin], [0.0, sin, cos]]), axis, axis=(0, 1))


def test_the_frames_of_a_delivered_mesh_turn_with_the_cloth(levels: Levels, patches: Patches) -> None:
    assert np.asarray(patches.turning.sum(axis=1)).ravel() == pytest.approx(1.0)
    assert np.diff(patches.turning.indptr).max() < 16
    smooth = levels.subdivision.upsample(levels.coarse.vertices).astype(np.float32)
    normals = np.zeros(smooth.shape, np.float32)
    surface_normals(smooth, levels.subdivision.faces, normals)
    up = np.tile([0.0, 0.0, 1.0], (len(smooth), 1))
    turn = rotation(1, 0.7)
    for by in (np.eye(3), turn):
        out = turned(patches.turning, frames_of(levels, levels.coarse.vertices @ by.T), up)
        size = np.linalg.norm(out, axis=1)
        cosine = np.abs((out * (normals[levels.subdivision.stands_for] @ by.T)).sum(axis=1)) / size
        assert size.min() > 0.95 and np.median(cosine) > 0.999


def test_the_mean_is_found_again(patches: Patches) -> None:
    rng = np.random.default_rng(0)
    count = patches.turning.shape[1]
    turns = [rotation(axis, angle) for axis, angle in ((0, 0.4), (1, -1.1), (2, 2.0))]
    frames = np.array([np.tile(turn.ravel(), (count, 1)) for turn in turns])
    mean = 0.01 * rng.standard_normal((patches.turning.shape[0], 3))
    noise = 0.002 * rng.standard_normal((1, *mean.shape))
    residual = np.array([turned(patches.turning, frame, mean) for frame in frames])
    found = fit_vertex_mean(patches.turning, frames, residual)
    assert found == pytest.approx(mean, abs=5e-5) and found.dtype == np.float32
    assert np.array_equal(found / MEAN_STEP, np.round(found / MEAN_STEP))
    # What comes and goes is no mean.
    still = np.concatenate([frames[:1]] * 2)
    swaying = fit_vertex_mean(patches.turning, still, residual[:1] + np.concatenate([noise, -noise]))
    assert swaying == pytest.approx(mean, abs=5e-5)


def flat(levels: Levels) -> np.ndarray:
    """Middle vertices that add nothing [m], shape (q, 4)."""
    return np.zeros((levels.subdivision.middle.fine_count, 4), np.float32)


def test_patches_are_written_smoothly_where_places_crowd(levels: Levels, patches: Patches) -> None:
    rng, binding = np.random.default_rng(1), levels.subdivision.binding
    assert binding is not None and patches.smoothing is not None
    even = identity(len(binding.face), format="csr")[binding.sewn.one]
    assert abs(patches.smoothing - even).max() == 0.0
    patches = replace(patches, smoothing=binding.smoothing_where(levels.fine.vertices[:, 0] > 0.3))
    frames = frames_of(levels, levels.coarse.vertices)
    grids = rng.standard_normal((len(frames), 3 * patches.grid.nodes)).astype(np.float32)
    none, smoothed = np.zeros((2, levels.subdivision.fine_count, 3), np.float32)
    surface = FineSurface(levels.subdivision, patches, none)
    for _ in range(2):  # nothing is kept
        surface(flat(levels), grids, frames, smoothed)
        expected = patches.smoothing @ patch_sums(patches, grids, frames)
        np.testing.assert_allclose(smoothed, expected, atol=1e-5)


def test_the_mean_is_written_as_it_is_turned(levels: Levels, patches: Patches) -> None:
    frames = frames_of(levels, levels.coarse.vertices @ rotation(2, 0.3))
    mean = np.random.default_rng(2).standard_normal((levels.subdivision.fine_count, 3)).astype(np.float32)
    surface, fine = FineSurface(levels.subdivision, patches, mean), np.zeros_like(mean)
    surface(flat(levels), np.zeros((len(frames), 3 * patches.grid.nodes), np.float32), frames, fine)
    np.testing.assert_allclose(fine, turned(patches.turning, frames, mean), atol=1e-5)


def test_frames_of_a_subdivided_mesh_are_blended_as_its_patches() -> None:
    vertices, faces = icosphere(1)
    subdivision = Subdivision.of(faces, len(vertices), 2)
    patches = Patches.of(subdivision, Charts.of(ClothMesh.from_surface(vertices, faces)))
    weights = patches.turning.toarray()
    read = np.take_along_axis(weights, patches.corners, axis=1)
    assert weights.sum(axis=1) == pytest.approx(1.0) and np.abs(read - patches.blend).max() < 0.03
