"""Normals of the fine mesh against those of any triangle mesh."""

from __future__ import annotations

import numpy as np
import pytest

from pbd.geometry import surface_normals
from tests.wrinkles.delivered import delivered_levels, delivered_panels
from tests.wrinkles.meshes import icosphere
from wrinkles.fine_normals import FineNormals
from wrinkles.surface import Subdivision


def reference(subdivision: Subdivision, vertices: np.ndarray) -> np.ndarray:
    normals = np.zeros_like(vertices)
    surface_normals(vertices, subdivision.faces, normals)
    return normals if subdivision.stands_for is None else normals[subdivision.stands_for]


@pytest.mark.parametrize("levels", [1, 2, 3])
def test_normals_of_a_subdivided_mesh(levels: int) -> None:
    vertices, faces = icosphere(1)
    subdivision = Subdivision.of(faces, len(vertices), levels)
    rng = np.random.default_rng(0)
    fine = subdivision.upsample(vertices) + 0.02 * rng.standard_normal((subdivision.fine_count, 3))
    normals = np.full(fine.shape, np.nan, np.float32)
    write = FineNormals(subdivision)
    for _ in range(2):  # nothing is kept
        write(fine.astype(np.float32), normals)
        np.testing.assert_allclose(normals, reference(subdivision, fine.astype(np.float32)), atol=1e-5)


def test_vertices_along_a_seam_of_a_delivered_mesh_have_one_normal() -> None:
    subdivision = delivered_levels(*delivered_panels()[2:]).subdivision
    rng = np.random.default_rng(0)
    fine = rng.standard_normal((subdivision.fine_count, 3)).astype(np.float32)
    normals = np.full(fine.shape, np.nan, np.float32)
    FineNormals(subdivision)(fine, normals)
    np.testing.assert_allclose(normals, reference(subdivision, fine), atol=1e-4)
    one = subdivision.stands_for
    assert one is not None and (one != np.arange(len(one))).any() and np.array_equal(normals, normals[one])
