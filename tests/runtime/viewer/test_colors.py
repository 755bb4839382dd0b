"""Colours: strain and curvature of known shapes, bands that lose no face, legends."""

from __future__ import annotations

import numpy as np
import pytest

from pbd import ClothMesh
from pbd.mesh import lattice_faces
from runtime.viewer.colors import (
    BANDS,
    SCALES,
    ColorScale,
    FaceBending,
    FaceStrain,
    bands_of,
    legend,
    names_legend,
    place,
)

SIDE = 12


@pytest.fixture
def sheet() -> ClothMesh:
    """A level square of 1 m by 1 m."""
    line = np.linspace(0.0, 1.0, SIDE + 1)
    x, z = np.meshgrid(line, line, indexing="ij")
    vertices = np.stack([x.ravel(), 0.0 * x.ravel(), z.ravel()], axis=1)
    return ClothMesh.from_surface(vertices, lattice_faces(np.arange(x.size).reshape(x.shape)), (1.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("change", "percent"),
    [
        (np.eye(3), 0.0),
        (np.diag([1.05, 1.0, 1.0]), 5.0),
        (np.diag([1.0, 1.0, 0.9]), -10.0),
        (np.diag([1.02, 1.0, 0.95]), -5.0),
        (np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]), 0.0),
    ],
    ids=["rest", "stretched", "shortened", "both", "turned"],
)
def test_strain_of_a_known_deformation(sheet: ClothMesh, change: np.ndarray, percent: float) -> None:
    strain = FaceStrain(sheet)((sheet.vertices @ change.T).astype(np.float32))
    assert strain == pytest.approx(np.full(len(sheet.faces), percent), abs=2e-3)


def test_shear_stretches_one_diagonal(sheet: ClothMesh) -> None:
    """Simple shear by g: the principal stretches are sqrt(1 + g^2/4) +- g/2."""
    shear = np.eye(3)
    shear[0, 2] = 0.1
    strain = FaceStrain(sheet)((sheet.vertices @ shear.T).astype(np.float32))
    assert strain == pytest.approx(np.full(len(sheet.faces), 100.0 * (np.sqrt(1.0025) + 0.05 - 1.0)), abs=2e-3)


def test_curvature_of_a_cylinder_is_the_inverse_of_its_radius(sheet: ClothMesh) -> None:
    radius, (x, _, z) = 0.4, sheet.vertices.T
    bent = np.stack([radius * np.sin(x / radius), radius * np.cos(x / radius), z], axis=1).astype(np.float32)
    curvature = FaceBending(sheet)(bent)
    at_rim = np.isin(x[sheet.faces], (x.min(), x.max())).sum(axis=1) == 2  # the surface ends there, and turns no more
    assert curvature[~at_rim] == pytest.approx(np.full((~at_rim).sum(), 1.0 / radius), rel=0.01)
    assert curvature[at_rim].max() == pytest.approx(0.0, abs=1e-3)
    assert FaceBending(sheet)(sheet.vertices.astype(np.float32)).max() == pytest.approx(0.0, abs=1e-3)


def test_bands_hold_each_face_once(sheet: ClothMesh) -> None:
    rng = np.random.default_rng(0)
    vertices = sheet.vertices.astype(np.float32)
    band = rng.integers(0, BANDS - 2, len(sheet.faces)).astype(np.int8)  # the last two bands have no face
    parts = bands_of(vertices, sheet.faces, band)
    assert len(parts) == BANDS
    for number, part in enumerate(parts):
        corners = part.vertices[part.faces]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        drawn = {tuple(face.ravel().round(5)) for face in corners[area > 0.0]}
        assert drawn == {tuple(face.ravel().round(5)) for face in vertices[sheet.faces[band == number]]}
        assert part.faces.max(initial=0) < len(part.vertices)
        assert np.isfinite(part.vertices).all()


def test_values_beyond_the_ends_are_in_the_last_bands() -> None:
    scale = ColorScale("x", "", -1.0, 1.0, SCALES["strain"].colors)
    assert scale.band(np.array([-np.inf, -1.0, -0.99, 0.0, 0.99, 1.0, 50.0])).tolist() == [
        0, 0, 0, BANDS // 2, BANDS - 1, BANDS - 1, BANDS - 1
    ]  # fmt: skip
    kinds = SCALES["level of detail"]
    assert [int(kinds.band(np.array(place(index)))) for index in range(BANDS)] == list(range(BANDS))


def test_every_scale_has_a_colour_for_each_band() -> None:
    for scale in SCALES.values():
        assert len(scale.colors) == len(set(scale.colors)) == BANDS


def test_legends_escape_what_they_name() -> None:
    text = legend(SCALES["strain"]) + names_legend({"<script>": (1, 2, 3)})
    assert "<script>" not in text and "&lt;script&gt;" in text
    assert "strain [%]" in text and "+9" in text and "-9" in text
