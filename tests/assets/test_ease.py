"""Ease: garments in other sizes than their mesh."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from assets.ease import eased, stretch_by_direction
from assets.garment import Garment, boundary_loops
from assets.seams import Seams
from pbd import InputError
from pbd.mesh import flatten_by_surface, lattice_faces

NOBODY = np.zeros((0, 3)), np.zeros((0, 3), np.int32)
UP = np.array([0.0, 1.0, 0.0])


def tube(radius: float, height: float = 0.5, around: int = 48, rows: int = 20) -> Garment:
    angle = 2.0 * np.pi * np.arange(around) / around
    y = height * (np.arange(rows + 1) / rows - 0.5)
    ring = np.stack([radius * np.sin(angle), 0.0 * angle, radius * np.cos(angle)], axis=1)
    vertices = (ring[:, None] + y[None, :, None] * UP).reshape(-1, 3)
    index = np.arange(around * (rows + 1)).reshape(around, -1)
    faces = lattice_faces(np.concatenate([index, index[:1]]))
    return Garment("tube", vertices, faces, None, "tube")


def size(garment: Garment, eased_garment: Garment) -> tuple[float, float]:
    flat = flatten_by_surface(garment.vertices, garment.faces, UP)
    return stretch_by_direction(eased_garment.vertices, garment.faces, flat)


@pytest.mark.parametrize("ease", [(0.18, 0.05), (0.0, 0.1), (0.3, 0.0), (-0.1, 0.0)])
def test_a_tube_becomes_wider_around_and_longer_along(ease: tuple[float, float]) -> None:
    garment = tube(0.15)
    made = eased(garment, ease, np.zeros(0, int), *NOBODY)
    assert size(garment, made) == pytest.approx(ease, abs=2e-3)
    radius = np.hypot(made.vertices[:, 0], made.vertices[:, 2])
    np.testing.assert_allclose(radius, 0.15 * (1.0 + ease[0]), rtol=3e-3)  # a tube still, without folds


def test_held_vertices_stay_where_they_are() -> None:
    garment = tube(0.15)
    top = max(boundary_loops(garment.faces), key=lambda loop: garment.vertices[loop, 1].mean())
    made = eased(garment, (0.2, 0.0), top, *NOBODY)
    np.testing.assert_allclose(made.vertices[top], garment.vertices[top], atol=1e-6)
    hem = np.hypot(*made.vertices[garment.vertices[:, 1] < -0.24][:, [0, 2]].T)
    assert hem.mean() == pytest.approx(0.18, rel=0.02)


def test_eased_cloth_starts_outside_the_body_and_not_smaller_than_it() -> None:
    garment, body = tube(0.154), tube(0.145, height=0.7, rows=28)
    made = eased(garment, (0.1, 0.0), np.zeros(0, int), body.vertices, body.faces)
    assert np.hypot(made.vertices[:, 0], made.vertices[:, 2]).min() > 0.16
    with pytest.raises(InputError, match=r"smaller than the body.*-0\.1.*expected about \[-0\.0[345], 0\.00\]"):
        eased(garment, (-0.1, 0.0), np.zeros(0, int), body.vertices, body.faces)


def test_panels_stay_sewn() -> None:
    whole = tube(0.15)
    count = 21  # vertices of a row from hem to top
    cut = whole.faces.copy()
    last = np.arange(len(whole.vertices) - count, len(whole.vertices))
    at_end = np.isin(cut, last).any(axis=1)
    new = len(whole.vertices) + np.arange(count)
    for old, copy in zip(range(count), new, strict=True):  # the first row is doubled: its copy closes the tube
        cut[at_end] = np.where(cut[at_end] == old, copy, cut[at_end])
    garment = replace(whole, vertices=np.concatenate([whole.vertices, whole.vertices[:count]]), faces=cut)
    edge = np.minimum(np.arange(count), count - 2)
    stitches = np.stack([new, edge, edge + 1], axis=1).astype(np.int32)
    seams = Seams(stitches, (np.arange(count) == count - 1).astype(float))
    made = eased(garment, (0.2, 0.1), np.zeros(0, int), *NOBODY, seams)
    assert np.linalg.norm(made.vertices[new] - made.vertices[:count], axis=1).max() < 1e-3
    assert size(garment, made) == pytest.approx((0.2, 0.1), abs=5e-3)


def test_a_flat_pattern_is_scaled_alike() -> None:
    garment = tube(0.15)
    flat = flatten_by_surface(garment.vertices, garment.faces, UP)
    corners = np.concatenate([np.zeros((len(flat), 1, 2)), flat.transpose(0, 2, 1)[:, :, ::-1]], axis=1)
    made = eased(replace(garment, pattern=corners), (0.2, 0.1), np.zeros(0, int), *NOBODY)
    assert made.pattern is not None
    np.testing.assert_allclose(made.pattern, corners * [1.2, 1.1])
    sewn = replace(garment, pattern=corners[:, :, ::-1], layers=np.ones(len(flat)))  # counts (warp, weft)
    made = eased(sewn, (0.2, 0.1), np.zeros(0, int), *NOBODY)
    assert made.pattern is not None
    np.testing.assert_allclose(made.pattern, corners[:, :, ::-1] * [1.1, 1.2])
