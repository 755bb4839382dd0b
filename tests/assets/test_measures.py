from functools import cache

import numpy as np
import pytest
import trimesh

from assets.character import load_character
from assets.io.obj import read_obj
from assets.measures import BodyMeasures, measure
from assets.sewing.body import StandingBody
from pbd.errors import InputError
from tests.data import data_path


@cache
def mannequin() -> BodyMeasures:
    return measure(load_character("builtin:mannequin"))


def test_the_scanned_body_has_the_measures_of_its_tape() -> None:
    """mean_all.yaml has what its makers measured on the same surface [cm]."""
    mesh = read_obj(data_path("patterns/mean_all.obj"))
    m = measure(StandingBody("mean_all", mesh.vertices, mesh.faces))
    tape = {"bust": 99.84, "underbust": 86.25, "waist": 84.33, "hip": 103.48, "height": 171.99, "thigh": 60.20}
    for name, value in tape.items():
        assert m.values()[name] == pytest.approx(value / 100.0, rel=0.015), name
    # These have other definitions there: points were picked by hand, the arm is measured without the shoulder's cap.
    for name, value in {"arm_length": 53.97, "wrist": 16.59, "shoulder_width": 36.46, "back_length": 36.89}.items():
        assert m.values()[name] == pytest.approx(value / 100.0, rel=0.07), name
    assert np.degrees(m.shoulder_slope) == pytest.approx(21.68, abs=3.0)
    assert m.bust_point_distance == pytest.approx(0.169, abs=0.03)


def test_places_are_in_order() -> None:
    m = mannequin()
    p = m.landmarks
    heights = [p.ankle, p.knee, p.crotch, p.hip, p.waist, p.underbust, p.bust, p.armpit, p.shoulder, p.neck_side]
    assert (np.diff([place[1] for place in heights]) > 0.0).all()
    assert 0.0 < p.neck_side[0] < p.shoulder[0] < p.elbow[0] < p.wrist[0]
    assert p.neck_back[2] < p.neck_front[2]
    assert m.waist < m.underbust < m.bust < m.hip
    assert m.rise + m.inseam == pytest.approx(m.waist_to_floor)


def test_places_agree_with_the_rig() -> None:
    """The mannequin's joints lie in the middle of the limbs that were measured without them."""
    character = load_character("builtin:mannequin")
    joint = {name: np.linalg.inv(character.inverse_bind[k])[:3, 3] for k, name in enumerate(character.joint_names)}
    p = mannequin().landmarks
    assert np.linalg.norm(p.elbow - joint["LeftForeArm"]) < 0.02
    assert np.linalg.norm(p.wrist - joint["LeftHand"]) < 0.03
    assert np.linalg.norm(p.knee - joint["LeftLeg"]) < 0.02


def test_measures_scale_with_the_body() -> None:
    character = load_character("builtin:mannequin")
    larger = measure(StandingBody("larger", 1.1 * character.vertices, character.faces))
    for name, value in mannequin().values().items():
        factor = 1.0 if name == "shoulder_slope" else 1.1
        # Heights are searched in steps of 5 mm.
        assert larger.values()[name] == pytest.approx(factor * value, rel=0.05, abs=0.006), name


def test_a_belly_is_measured_by_a_tape_not_by_its_hollows() -> None:
    """A furrow around the waist, on the back only, shortens no girth."""
    character = load_character("builtin:mannequin")
    v = character.vertices.copy()
    spine = (np.abs(v[:, 0]) < 0.03) & (v[:, 2] < 0.0) & (np.abs(v[:, 1] - 0.87) < 0.05)
    assert spine.any()
    v[spine, 2] += 0.02
    changed = measure(StandingBody("furrow", v, character.faces))
    assert changed.hip == pytest.approx(mannequin().hip, abs=0.004)


def test_a_barrel_has_no_waist() -> None:
    character = load_character("builtin:mannequin")
    v = character.vertices.copy()
    m = mannequin()
    trunk = ~m.arm_vertices & (v[:, 1] > m.landmarks.crotch[1]) & (v[:, 1] < m.landmarks.armpit[1])
    middle = np.array([0.0, m.landmarks.waist[2]])
    offset = v[trunk][:, [0, 2]] - middle
    radius = 0.13 + 0.1 * (m.landmarks.armpit[1] - v[trunk, 1])  # a cone, wider below
    v[np.ix_(trunk, [0, 2])] = middle + offset / np.linalg.norm(offset, axis=1)[:, None] * radius[:, None]
    barrel = measure(StandingBody("barrel", v, character.faces))
    assert np.isnan(barrel.waist)
    assert np.isnan(barrel.back_length)
    assert np.isfinite(barrel.hip)


def test_a_body_that_is_no_figure_is_refused() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3)
    with pytest.raises(InputError, match="body ball"):
        measure(StandingBody("ball", np.asarray(ball.vertices), np.asarray(ball.faces)))


def test_arms_at_the_sides_are_refused() -> None:
    character = load_character("builtin:mannequin")
    lying = character.vertices[:, [1, 0, 2]] * (1.0, -1.0, 1.0)
    with pytest.raises(InputError):
        measure(StandingBody("lying", lying, character.faces))
