from __future__ import annotations

import math

import numpy as np
import pytest

from precompute.learning.body_seen import BEHIND, body_seen_figures
from precompute.learning.nearest_faces import FAR, nearest_faces
from runtime.pictures import Camera
from tests.wrinkles.meshes import icosphere

SPHERE, FACES = icosphere(4, 0.5)
FRONT = Camera(np.array([0.0, 0.0, 3.0]), np.zeros(3), 30.0)


@pytest.mark.parametrize("outside", [True, False])
def test_the_nearest_faces_of_a_sphere_are_those_that_perspective_shows(outside: bool) -> None:
    faces = FACES if outside else FACES[:, ::-1]
    depth, owner = nearest_faces(SPHERE, faces, FRONT, (300, 400))
    radius = 200 * math.tan(math.asin(0.5 / 3.0)) / math.tan(math.radians(15.0))
    assert np.count_nonzero(owner) == pytest.approx(math.pi * radius**2, rel=0.01)
    assert (owner >= 0).all() if outside else (owner <= 0).all()
    shown = np.abs(owner[owner != 0]) - 1
    assert SPHERE[faces[shown]].mean(axis=1)[:, 2].min() > 0.0
    assert depth[200, 150] == pytest.approx(2.5, abs=2e-3) and depth[0, 0] == pytest.approx(FAR)
    rows, columns = np.nonzero(owner)
    assert (rows.mean(), columns.mean()) == pytest.approx((199.5, 149.5), abs=0.5)


def test_what_lies_before_and_behind_is_told_apart_and_a_face_behind_the_camera_left_out() -> None:
    triangle = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]])
    three = np.concatenate([triangle + [0.0, 0.0, z] for z in (0.0, 1.0, 4.0)])
    depth, owner = nearest_faces(three, np.arange(9).reshape(3, 3), FRONT, (100, 100))
    assert (depth[50, 50], owner[50, 50]) == (pytest.approx(2.0), 2)


@pytest.mark.parametrize(("out", "seen"), [(-0.005, False), (0.5 * BEHIND, True), (2.0 * BEHIND, False)])
def test_a_body_counts_where_it_stands_out_of_the_front_of_the_garment(out: float, seen: bool) -> None:
    body = SPHERE * (1.0 + out / 0.5)
    frames, dressed = [(SPHERE, body, body)], np.ones(len(SPHERE), bool)
    whole = body_seen_figures(frames, FACES, FACES, dressed)
    assert whole["body_seen_px"] == whole["body_seen_whole_px"]
    assert (whole["body_seen_px"] > 1e4) == seen == (whole["body_seen_frames_percent"] == 100.0)
    inwards = body_seen_figures(frames, FACES[:, ::-1], FACES, dressed)
    assert inwards["body_seen_whole_px"] == 0.0  # the garment's inner side covers nothing
    drawn_in = body_seen_figures([(SPHERE, 0.99 * SPHERE, body)], FACES, FACES, dressed)
    assert drawn_in["body_seen_px"] == 0.0 and drawn_in["body_seen_whole_px"] == whole["body_seen_px"]
    bare = body_seen_figures(frames, FACES, FACES, ~dressed)
    assert bare["body_seen_whole_px"] == 0.0  # an arm before the garment
