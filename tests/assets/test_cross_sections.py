import math

import numpy as np
import pytest
import trimesh

from assets.cross_sections import cross_section, hull_length, tape_length

UP = np.array([0.0, 1.0, 0.0])


def test_the_girth_of_a_tilted_cylinder_is_that_of_an_ellipse() -> None:
    mesh = trimesh.creation.cylinder(radius=0.1, height=2.0, sections=400)
    axis = np.array([0.0, 0.0, 1.0])
    points = cross_section(mesh.vertices, mesh.faces, np.zeros(3), axis)
    assert hull_length(points, axis) == pytest.approx(2.0 * math.pi * 0.1, rel=1e-4)
    normal = np.array([0.0, math.sin(0.6), math.cos(0.6)])
    points = cross_section(mesh.vertices, mesh.faces, np.zeros(3), normal)
    assert np.abs(points @ normal).max() < 1e-12
    a, b = 0.1 / math.cos(0.6), 0.1
    ellipse = math.pi * (3 * (a + b) - math.sqrt((3 * a + b) * (a + 3 * b)))  # Ramanujan
    assert hull_length(points, normal) == pytest.approx(ellipse, rel=1e-4)


def test_a_tape_bridges_hollows() -> None:
    left = trimesh.creation.box((0.1, 1.0, 0.1), trimesh.transformations.translation_matrix((-0.2, 0.0, 0.0)))
    vertices = np.concatenate([left.vertices, left.vertices + (0.4, 0.0, 0.0)])
    faces = np.concatenate([left.faces, left.faces + len(left.vertices)])
    points = cross_section(vertices, faces, np.array([0.0, 0.03, 0.0]), UP)
    assert hull_length(points, UP) == pytest.approx(2 * (0.5 + 0.1))
    valley = np.array([[0.25, 0.0], [0.5, -1.0], [0.75, 0.0]])
    assert tape_length(valley, np.zeros(2), np.array([1.0, 0.0])) == pytest.approx(1.0)
    hill = np.array([[0.5, 0.5]])
    assert tape_length(hill, np.zeros(2), np.array([1.0, 0.0])) == pytest.approx(math.sqrt(2.0))


def test_a_plane_beside_the_mesh_cuts_nothing() -> None:
    mesh = trimesh.creation.box((1.0, 1.0, 1.0))
    points = cross_section(mesh.vertices, mesh.faces, np.array([0.0, 2.0, 0.0]), UP)
    assert points.shape == (0, 3)
    assert hull_length(points, UP) == 0.0
