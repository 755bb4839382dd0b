import pytest

from assets.plausible import check_given, doubtful
from tests.refusals import refuses

WOMAN = {"height": 1.63, "bust": 0.95, "underbust": 0.8, "waist": 0.8, "hip": 1.02, "thigh": 0.6, "wrist": 0.155}


def test_measures_of_a_woman_are_not_doubted() -> None:
    assert doubtful(WOMAN) == {}


def test_a_waist_of_half_a_trunk_is_doubted_with_what_bodies_have() -> None:
    found = doubtful(WOMAN | {"waist": 0.228})
    assert list(found) == ["waist"]
    assert found["waist"] == "0.228 m would be 0.140 of the height: bodies have 0.212 to 1.166"


def test_of_two_measures_that_do_not_go_together_the_stranger_one_is_doubted() -> None:
    """A thigh as wide as the hip: 1.02 m is the mean of hips, and 1.7 times that of thighs."""
    found = doubtful(WOMAN | {"thigh": 1.02})
    assert list(found) == ["thigh"]
    assert "thigh over hip would be 1.00, bodies have 0.3 to 0.85" in found["thigh"]
    assert list(doubtful(WOMAN | {"underbust": 1.3})) == ["underbust"]  # the survey has no mean of it


def test_what_was_taken_by_hand_is_not_doubted() -> None:
    assert doubtful(WOMAN | {"waist": 0.228}, {"waist"}) == {}
    assert doubtful(WOMAN | {"thigh": 1.02}, {"thigh"}) == {}


@pytest.mark.parametrize("value", [72.0, 0.072, 0.0, -0.7, float("nan"), float("inf")])
def test_a_measure_by_hand_in_another_unit_is_refused(value: float) -> None:
    refuses(r"waist: a measure that no body has .*0\.346 to 1\.901 m", check_given, "waist", value, 1.63)


def test_a_measure_by_hand_that_bodies_have_is_taken() -> None:
    check_given("waist", 0.72, 1.63)
    check_given("bust_depth", 0.25, 1.63)
