"""Drafts: sound outlines, seams that match, garments larger than the body, panels that stand clear of it."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import trimesh

from assets.anthropometry import measure
from assets.loading import load_character
from assets.measures import BodyMeasures
from assets.patterns.curves import crossings, signed_area
from assets.patterns.drafts import DRAFTS, draft, draft_parameters
from assets.patterns.drafts.placing import Surroundings
from assets.patterns.pattern import EdgeName, Pattern, Placement, edge_length
from assets.sewing.body import StandingBody
from tests.assets.shell_figure import moved
from tests.data import data_path
from tests.refusals import refuses

WOMAN = "characters/mh_female_bandai_NC.glb"
LENGTHS = {"tshirt": (0.45, 0.75), "shirt": (0.5, 0.8), "aline_skirt": (0.35, 0.9), "circle_skirt": (0.3, 0.9)}


@cache
def measured(body: str, size: float = 1.0) -> BodyMeasures:
    character = load_character("builtin:mannequin" if body == "mannequin" else data_path(WOMAN))
    return measure(StandingBody(body, size * character.vertices, character.faces))


def variant(name: str, seed: int, body: str) -> tuple[BodyMeasures, Pattern]:
    """A garment of random size, ease and lengths."""
    rng = np.random.default_rng([seed, DRAFTS.index(name)])
    m = measured(body, (0.85, 1.0, 1.15)[seed % 3])
    parameters = {"ease": rng.uniform(0.0, 0.06) if name == "circle_skirt" else rng.uniform(0.03, 0.25)}
    low, high = LENGTHS.get(name, (0.45, 1.0))
    if seed:
        whole = m.waist_to_floor if name not in ("tshirt", "shirt") else m.height / 1.7
        parameters["length"] = rng.uniform(low, high) * whole
    if name in ("tshirt", "shirt"):
        parameters["neck_depth"] = rng.uniform(0.06, 0.14)
    if name == "tshirt":
        parameters["sleeve_length"] = rng.uniform(0.36, 0.75) * m.arm_length
    if name == "aline_skirt":
        parameters["flare"] = rng.uniform(0.0, 0.5)
    if name == "circle_skirt":
        parameters["circle"] = rng.uniform(0.55, 1.0)
    if name == "trousers":
        parameters["leg_width"] = m.thigh * rng.uniform(1.05, 1.2)
    return m, draft(name, m, **parameters)


def dense(outline: np.ndarray) -> np.ndarray:
    """Points every centimetre of a closed polyline."""
    ring = np.concatenate([outline, outline[:1]])
    at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(ring, axis=0), axis=1))])
    steps = np.arange(0.0, at[-1], 0.01)
    return np.stack([np.interp(steps, at, ring[:, k]) for k in (0, 1)], axis=1)


def check_sound(m: BodyMeasures, pattern: Pattern) -> None:
    for panel in pattern.panels:
        for edge, after in zip(panel.edges, panel.edges[1:] + panel.edges[:1], strict=True):
            assert np.abs(edge[-1] - after[0]).max() < 1e-12, panel.name
            assert edge_length(edge) > 0.004, panel.name
        outline = panel.outline
        assert not len(crossings(outline, outline)) and signed_area(outline) > 0.01, panel.name
    sewn = [edge for seam in pattern.seams for edge in seam[:2]]
    assert len(sewn) == len(set(sewn))
    for seam in pattern.seams:
        ratio = edge_length(pattern.edge(seam.first)) / edge_length(pattern.edge(seam.second))
        assert 0.97 < ratio < 1.03, seam
    around = Surroundings(m)
    for panel in pattern.panels:
        assert around.room(m.frame.local(panel.placement.apply(dense(panel.outline)))) > 0.01, panel.name


def in_space(pattern: Pattern, name: EdgeName) -> np.ndarray:
    placement = pattern.panel(name.panel).placement
    assert placement is not None
    return placement.apply(pattern.edge(name))


def free_girth(pattern: Pattern, names: list[EdgeName]) -> float:
    return sum(edge_length(pattern.edge(name)) for name in names)


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("name", DRAFTS)
def test_a_draft_is_sound(name: str, seed: int) -> None:
    check_sound(*variant(name, seed, "mannequin"))


@pytest.mark.proof
@pytest.mark.parametrize("body", ["mannequin", "woman"])
@pytest.mark.parametrize("name", DRAFTS)
def test_twenty_variants_are_sound(name: str, body: str) -> None:
    for seed in range(20):
        check_sound(*variant(name, seed, body))


def test_the_chest_is_as_wide_as_bust_and_ease() -> None:
    m = measured("mannequin")
    for ease in (0.05, 0.20):
        pattern = draft("tshirt", m, ease=ease)
        under = [pattern.panel(name).edges[3][0, 0] for name in ("front", "back")]  # where the armhole begins
        assert 2.0 * sum(under) == pytest.approx(m.bust + ease, abs=1e-9)


def test_waists_fit_the_body() -> None:
    """The edges of the waist, without darts, are as long as the waist."""
    m = measured("mannequin")
    for name in ("aline_skirt", "circle_skirt", "trousers"):
        pattern = draft(name, m)
        waist = [band.edge for band in pattern.bands if band.layers > 2.0]
        assert free_girth(pattern, waist) == pytest.approx(m.waist, rel=0.025), name


def test_the_circle_skirt_is_a_circle() -> None:
    m = measured("mannequin")
    pattern = draft("circle_skirt", m, ease=0.0, length=0.5)
    hems = [band.edge for band in pattern.bands if band.layers == 2.0]
    assert free_girth(pattern, hems) == pytest.approx(m.waist + 2.0 * np.pi * 0.5, rel=1e-3)


def test_sleeve_caps_are_as_long_as_armholes() -> None:
    for name in ("tshirt", "shirt"):
        pattern = draft(name, measured("mannequin"))
        pairs = [seam for seam in pattern.seams if {"left_sleeve"} < {seam.first.panel, seam.second.panel}]
        assert len(pairs) == 2
        for seam in pairs:
            lengths = [edge_length(pattern.edge(edge)) for edge in seam[:2]]
            assert lengths[0] == pytest.approx(lengths[1], rel=1e-6)


def test_the_right_sleeve_is_the_mirror_image_of_the_left_one() -> None:
    """Of a body that is its own mirror image."""
    pattern = draft("shirt", measured("woman"))
    left, right = (in_space(pattern, EdgeName(f"{side}_sleeve", k)) for side, k in (("left", 0), ("right", 4)))
    np.testing.assert_allclose(right[::-1] * [-1.0, 1.0, 1.0], left, atol=1e-6)


def test_seams_start_nearly_closed_at_matching_ends() -> None:
    """Ends that are sewn together are nearer to each other than the wrong ones."""
    for name in DRAFTS:
        pattern = draft(name, measured("mannequin"))
        for seam in pattern.seams:
            first, second = (in_space(pattern, edge) for edge in seam[:2])
            assert seam.reversed
            right = np.linalg.norm(first[0] - second[-1]) + np.linalg.norm(first[-1] - second[0])
            wrong = np.linalg.norm(first[0] - second[0]) + np.linalg.norm(first[-1] - second[-1])
            assert right < wrong, (name, seam)


@pytest.mark.parametrize(
    ("name", "parameters", "words"),
    [
        ("tshirt", {"ease": -0.02}, "ease is too small"),
        ("tshirt", {"length": 0.2}, "length is too small"),
        ("shirt", {"ease": 0.0}, "ease is too small"),
        ("shirt", {"sleeve_length": 0.9}, "longer than the arm"),
        ("aline_skirt", {"ease": -0.1}, "ease is too small"),
        ("aline_skirt", {"length": 2.0}, "lie on the floor"),
        ("circle_skirt", {"circle": 2.0}, "no part of a circle"),
        ("circle_skirt", {"ease": 0.2}, "nothing holds so wide a waist"),
        ("circle_skirt", {"circle": 0.25, "length": 0.5}, ""),
        ("trousers", {"leg_width": 0.1}, "leg width is too small"),
        ("trousers", {"length": 0.2}, "length is too small"),
        ("trousers", {"ease": float("nan")}, "ease is too small"),
        ("tshirt", {"sleeves": 3.0}, "no such parameter"),
        ("kilt", {}, "no such draft"),
    ],
)
def test_what_cannot_be_worn_is_refused(name: str, parameters: dict[str, float], words: str) -> None:
    m = measured("mannequin")
    if not words:  # a quarter circle is wide enough for this body
        check_sound(m, draft(name, m, **parameters))
        return
    refuses(words, draft, name, m, **parameters)


def test_a_body_without_a_waist_wears_no_skirt_of_ours() -> None:
    m = measured("mannequin")
    ball = trimesh.creation.icosphere()
    barrel = BodyMeasures(
        **{**m.__dict__, "waist": float("nan"), "surface": StandingBody("barrel", ball.vertices, ball.faces)}
    )
    refuses("body without a waist", draft, "circle_skirt", barrel)


def test_panels_stand_around_a_body_that_stands_elsewhere() -> None:
    """Where they stand around the body at the origin, moved and turned as the body is."""
    body = measured("mannequin").surface
    by, degrees = (1.0, 0.0, -0.5), 30.0
    here = draft("circle_skirt", measured("mannequin"))
    there = draft("circle_skirt", measure(moved(StandingBody("there", body.vertices, body.faces), by, degrees)))
    for panel, other in zip(here.panels, there.panels, strict=True):
        placed = StandingBody("panel", panel.placement.apply(panel.outline), body.faces)
        np.testing.assert_allclose(other.placement.apply(other.outline), moved(placed, by, degrees).vertices, atol=1e-4)


def test_a_bow_turns_with_its_panel() -> None:
    bow = np.array([[0.0, 0.1, 0.0, 0.0], [1.0, 0.0, 0.2, 0.3]])
    placement = Placement(np.eye(3), np.array([0.1, 0.2, 0.3]), 0.5, bow)
    turn, move = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]), np.array([1.0, 2.0, 3.0])
    flat = np.random.default_rng(0).uniform(0.0, 1.0, (20, 2))
    np.testing.assert_allclose(
        placement.moved(turn, move).apply(flat), placement.apply(flat) @ turn.T + move, atol=1e-12
    )


def test_a_waist_by_hand_makes_a_skirt_for_a_body_without_one() -> None:
    m = measured("mannequin")
    lacking = BodyMeasures(**{**m.__dict__, "waist": float("nan"), "doubts": {"waist": "it is too thin"}})
    refuses(r"without a waist \(received 'it is too thin', .*--param waist=METRES", draft, "circle_skirt", lacking)
    pattern = draft("circle_skirt", measure(m.surface, {"waist": 0.7}))
    waist = [band.edge for band in pattern.bands if band.layers > 2.0]
    assert free_girth(pattern, waist) == pytest.approx(0.7, rel=1e-3)


def test_parameters_are_listed_with_units() -> None:
    for name in DRAFTS:
        parameters = draft_parameters(name)
        assert parameters[0].name == "ease"
        assert {parameter.unit for parameter in parameters} <= {"m", "-"}
        assert all(parameter.meaning for parameter in parameters)
