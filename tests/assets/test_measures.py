import re
from functools import cache

import numpy as np
import pytest
import trimesh

from assets.anthropometry import measure
from assets.io.obj import read_obj
from assets.loading import load_character
from assets.measures import MEASURES, BodyMeasures
from assets.sewing.body import StandingBody, closed_body
from pbd.errors import InputError
from tests.assets.real_bodies import BODIES, raw
from tests.assets.shell_figure import WAIST, WAIST_AT, ellipse_girth, moved, shell_figure
from tests.data import data_path
from tests.refusals import refuses

PLACES = {"beside": ((1.0, 0.0, 0.0), 0.0), "turned": ((0.0, 0.0, 0.0), 30.0), "behind": ((-0.4, 0.1, 2.0), 200.0)}


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
    p, frame = mannequin().landmarks, mannequin().frame
    assert np.linalg.norm(frame.world(p.elbow) - joint["LeftForeArm"]) < 0.02
    assert np.linalg.norm(frame.world(p.wrist) - joint["LeftHand"]) < 0.03
    assert np.linalg.norm(frame.world(p.knee) - joint["LeftLeg"]) < 0.02


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
    body = StandingBody("barrel", v, character.faces)
    barrel = measure(body)
    assert np.isnan(barrel.waist)
    assert np.isnan(barrel.back_length)
    assert np.isfinite(barrel.hip)
    assert "no girth between hips and bust" in barrel.doubts["waist"]
    given = measure(body, {"waist": 0.9})  # where waists are
    assert given.waist == 0.9 and given.waist_to_floor == pytest.approx(0.64 * given.height, abs=0.005)
    assert given.rise + given.inseam == pytest.approx(given.waist_to_floor)
    assert given.doubts == {}
    placed = measure(body, {"waist_to_floor": 1.0})  # measured there: a polygon around a circle
    radius = 0.13 + 0.1 * (m.landmarks.armpit[1] - 1.0)
    assert placed.waist == pytest.approx(2.0 * np.pi * radius, rel=0.02)
    refuses(r"waist_to_floor: no height of a waist .*between hips and armpits", measure, body, {"waist_to_floor": 1.5})


def test_a_body_that_is_no_figure_and_arms_at_the_sides_are_refused() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3)
    refuses("body ball", measure, StandingBody("ball", np.asarray(ball.vertices), np.asarray(ball.faces)))
    character = load_character("builtin:mannequin")
    lying = character.vertices[:, [1, 0, 2]] * (1.0, -1.0, 1.0)
    refuses("", measure, StandingBody("lying", lying, character.faces))


def measured(body: StandingBody) -> BodyMeasures:
    return measure(closed_body(body.name, body.vertices, body.faces))


# Bodies of many parts or of many vertices take seconds each.
QUICK = ("woman", "quaternius")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in QUICK else pytest.mark.proof) for name in BODIES]
)
def test_neither_place_nor_turn_changes_a_measure(name: str) -> None:
    body = raw(BODIES[name])
    here = measured(body).values()
    assert all(np.isfinite(value) for value in here.values())
    for place, (by, degrees) in PLACES.items():
        there = measured(moved(body, by, degrees)).values()
        for measure_name, value in here.items():
            assert there[measure_name] == pytest.approx(value, rel=0.01), (place, measure_name)


@pytest.mark.parametrize("arms", [0.0, 20.0, 45.0])
def test_a_figure_of_shells_has_the_girths_that_it_was_made_with(arms: float) -> None:
    m = measured(moved(shell_figure(arms), (1.0, 0.0, 0.5), 37.0))
    assert m.waist == pytest.approx(ellipse_girth(*WAIST), rel=0.01)
    assert m.waist_to_floor == pytest.approx(WAIST_AT, abs=0.006)
    assert m.hip == pytest.approx(ellipse_girth(0.172, 0.125), rel=0.015)
    assert m.bust == pytest.approx(ellipse_girth(0.155, 0.125), rel=0.015)
    assert m.inseam == pytest.approx(0.77, abs=0.01)  # where the trunk ends
    assert m.height == pytest.approx(1.72, abs=0.005)
    assert m.doubts == {}


def test_arms_and_legs_are_measured_alike_in_both_poses() -> None:
    spread, hanging = (measured(shell_figure(arms)).values() for arms in (0.0, 45.0))
    for name in ("thigh", "knee", "ankle", "wrist", "waist", "hip", "underbust"):
        assert spread[name] == pytest.approx(hanging[name], rel=0.01), name
    assert spread["arm_length"] == pytest.approx(hanging["arm_length"], rel=0.03)


def test_a_body_without_head_and_neck_is_measured_below() -> None:
    body = shell_figure()
    corners = np.abs(body.vertices[body.faces])
    low = body.faces[~((corners[:, :, 0] < 0.12) & (corners[:, :, 1] > 1.37)).any(axis=1)]
    m = measured(StandingBody("headless", body.vertices, low))
    assert m.waist == pytest.approx(ellipse_girth(*WAIST), rel=0.01)
    assert np.isnan(m.neck) and np.isnan(m.back_length)
    assert "no neck rises above the shoulders" in m.doubts["neck"]
    with pytest.raises(InputError, match="neck by hand has no place: no neck rises"):
        measure(closed_body("headless", body.vertices, low), {"neck": 0.35})


def test_a_measure_that_no_body_has_is_not_a_number() -> None:
    """A trunk like a stick between hips and bust."""
    body = shell_figure()
    v = body.vertices.copy()
    near = np.abs(v[:, 1] - WAIST_AT) < 0.06
    v[near] *= [0.25, 1.0, 0.25]
    m = measured(StandingBody("stick", v, body.faces))
    assert np.isnan(m.waist)
    assert re.fullmatch(r"1\.\d\d m above the floor, 0\.1\d\d m would be 0\.1\d\d of the height: .*", m.doubts["waist"])
    by_hand = measure(closed_body("stick", v, body.faces), {"waist": 0.69})
    assert by_hand.waist == 0.69
    assert "waist" not in by_hand.doubts


def test_measures_by_hand_count() -> None:
    m = measure(load_character("builtin:mannequin"), {"waist": 0.72, "hip": 1.0})
    assert (m.waist, m.hip) == (0.72, 1.0)
    assert m.bust == mannequin().bust
    for given, words in (({"waist": 72.0}, "waist: a measure that no body has"), ({"belly": 1.0}, "no such measure")):
        refuses(words, measure, load_character("builtin:mannequin"), given)
    assert set(MEASURES) == set(m.values())


def test_a_figure_that_lies_askew_is_not_measured_in_silence() -> None:
    """On its back, and turned about the line of sight: what is taken for a shoulder is right of the middle."""
    body, half = shell_figure(45.0), np.sqrt(0.5)
    lying = body.vertices[:, [0, 2, 1]] * (1.0, -1.0, 1.0)
    askew = lying @ np.array([[-half, -half, 0.0], [half, -half, 0.0], [0.0, 0.0, 1.0]]).T
    m = measured(StandingBody("askew", askew, body.faces))
    assert np.isnan(m.shoulder_width) and "no neck rises above the shoulders" in m.doubts["shoulder_width"]
    assert len(m.doubts) > 15


def test_what_is_wrong_with_a_pose_is_said_with_the_place() -> None:
    body = shell_figure()
    v = body.vertices.copy()
    arm = np.abs(v[:, 0]) > 0.2  # no forearms
    v[arm, 0] = np.sign(v[arm, 0]) * 0.2
    with pytest.raises(
        InputError, match=r"the left arm does not stand away from the trunk .*at \(.*\) m.*T-pose.*pose it so"
    ):
        measured(StandingBody("stumps", v, body.faces))
