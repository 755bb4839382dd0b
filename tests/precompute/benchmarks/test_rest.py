"""Garments on a body that stands still come to rest."""

import sys

import pytest

from precompute.benchmarks.rest import OUTFITS, rest_speed


def test_a_waistband_on_a_standing_body_does_not_tremble() -> None:
    """Where contact was kept while cloth slid 1.5 mm, it was 10 mm/s, 0.6 mm to and fro."""
    found = rest_speed((("trousers", "cotton"),), moving=0.0)
    assert found["rest_speed_mm_s"] < 1.0
    assert found["tremble_mm"] < 0.05


@pytest.mark.proof
@pytest.mark.parametrize("name", list(OUTFITS))
def test_garments_tremble_little_after_a_walk(name: str) -> None:
    """What is left of the speed is mostly swinging, which air slows down the less the slower it is."""
    found = rest_speed(OUTFITS[name])
    sys.stdout.write(f"{name}: {found['rest_speed_mm_s']:.2f} mm/s, {found['tremble_mm']:.3f} mm\n")
    assert found["tremble_mm"] < 0.3
