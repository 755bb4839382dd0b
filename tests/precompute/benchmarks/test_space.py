"""Convergence in space."""

from __future__ import annotations

import numpy as np
import pytest

from assets.io.scene import parse_scene
from pbd import ClothMesh
from pbd.mesh import lattice_faces
from precompute.benchmarks.space import Measured, away_from_hems, converged_mesh, measure_meshes, space_rows, space_text
from wrinkles.spectrum import BandedEnergy


def measured(level: int, settled: list[float], moving: list[float]) -> Measured:
    names = ("under 6 mm", "over 6 mm")
    return Measured(
        "wool", level, 100 * 4**level, 0.02 / 2**level, 0.02, 1.0, names, np.array(settled), np.array(moving), 5.0
    )


def test_a_mesh_has_converged_where_the_next_one_hardly_differs() -> None:
    coarse, middle = measured(1, [0.0, 60.0], [0.0, 70.0]), measured(2, [1.0, 95.0], [1.0, 96.0])
    fine = measured(3, [3.0, 97.0], [3.0, 98.0])
    assert coarse.change_to(middle) == pytest.approx((1.0 - 60.0 / 96.0, 1.0 - 60.0 / 95.0))
    assert converged_mesh([coarse, middle, fine]) is middle  # the octave with little energy does not count
    assert converged_mesh([coarse, middle]) is None
    # One octave's loss is another's gain: the whole energy alone does not say that folds are the same.
    assert converged_mesh([measured(2, [50.0, 50.0], [50.0, 50.0]), measured(3, [30.0, 70.0], [50.0, 50.0])]) is None
    assert "converged from 2 subdivisions on" in space_text([coarse, middle, fine])
    assert "change_total_percent" not in space_rows([coarse, middle, fine])[-1]


def test_cloth_around_a_turned_hem_is_left_out() -> None:
    # A sheet whose last 20 mm are turned about a radius of 4 mm.
    s, t = np.meshgrid(np.linspace(0.0, 0.3, 151), np.linspace(0.0, 0.1, 11), indexing="ij")
    angle = np.clip((s - 0.27) / 0.004, 0.0, np.pi)
    x = np.where(s < 0.27, s, 0.27 + 0.004 * np.sin(angle) - np.maximum(s - 0.27 - 0.004 * np.pi, 0.0))
    rest = np.stack([x, t, 0.004 * (1.0 - np.cos(angle))], axis=2).reshape(-1, 3)
    faces = lattice_faces(np.arange(len(rest)).reshape(s.shape))
    energy = BandedEnergy(ClothMesh.from_surface(rest, faces), [0.01, 0.1])
    where = away_from_hems(energy, rest)
    assert where[s.ravel() < 0.24].all() and not where[s.ravel() > 0.26].any()
    assert energy.energy(rest[None], where).sum() < 0.01 * energy.energy(rest[None]).sum()
    flat = np.stack([s, t, 0.0 * s], axis=2).reshape(-1, 3)
    assert away_from_hems(BandedEnergy(ClothMesh.from_surface(flat, faces), [0.01]), flat).all()


def test_each_fabric_is_measured_on_each_mesh() -> None:
    text = """
[[garment]]
name = "skirt"
mesh = "builtin:skirt"
attach = "top"
[character]
file = "builtin:mannequin"
clip = "walk"
[solver]
frame_rate = 30
"""
    (found,) = measure_meshes(parse_scene(text), ["wool"], most=1, seconds=1.5)
    assert (found.fabric, found.subdivisions, found.vertices, found.counted) == ("wool", 1, 2424, 1.0)
    assert found.settled.sum() > 50.0 and found.moving.sum() > 50.0
