"""Error classes of runs against what is done to them."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pbd import InputError
from precompute.experiment.error_classes import LIMITS, ErrorClass, Recorded, classify, deviations

DT = 1.0 / 60.0
EDGES = np.array([[0, 1], [1, 2]])
REST = np.array([0.1, 0.1])


def swinging(count: int = 60) -> Recorded:
    """Three vertices in a row that swing along x by 10 cm, 60 frames."""
    t = DT * np.arange(count)
    way, speed = 0.1 * np.sin(6.0 * t), 0.6 * np.cos(6.0 * t)
    position = np.zeros((count, 3, 3))
    position[:, :, 1] = -0.1 * np.arange(3)
    position[:, :, 0] = way[:, None]
    velocity = np.zeros_like(position)
    velocity[:, :, 0] = speed[:, None]
    return Recorded(position, velocity, DT, energy=1.0 + 0.1 * t, depth=np.zeros(count))


def figures(run: Recorded, reference: Recorded, **more: Any) -> dict[str, float]:
    return deviations(run, reference, EDGES, REST, 0.004, **more)


def test_the_reference_itself_cannot_be_told_apart() -> None:
    run = replace(swinging(), energy=np.linspace(2.0, 1.0, 60))
    found = figures(run, run)
    assert max(classify(found).values()) is ErrorClass.IMPERCEPTIBLE
    assert {"edge_strain_p95", "velocity_rms", "position_px", "energy_growth", "penetration_s"} <= set(found)


@pytest.mark.parametrize(
    ("stretch", "expected"), [(0.005, "IMPERCEPTIBLE"), (0.05, "ACCEPTED"), (0.3, "VISIBLE"), (1.5, "CATASTROPHIC")]
)
def test_classes_of_a_stretched_edge(stretch: float, expected: str) -> None:
    reference = swinging()
    position = reference.position.copy()
    position[:, 2, 1] -= 0.1 * stretch
    found = classify(figures(replace(reference, position=position), reference))
    assert max(found[f"edge_strain_{kind}"] for kind in ("p95", "max", "beyond")).name == expected


def test_a_run_that_is_not_finite_or_too_fast_is_catastrophic() -> None:
    reference = swinging()
    broken = reference.position.copy()
    broken[40, 0, 0] = np.nan
    assert max(classify(figures(replace(reference, position=broken), reference)).values()) is ErrorClass.CATASTROPHIC
    fast = reference.velocity * 100.0
    found = figures(replace(reference, velocity=fast), reference)
    assert classify(found)["speed_over_limit"] is ErrorClass.CATASTROPHIC
    allowed = classify(figures(replace(reference, velocity=fast), reference, collider_speed=100.0))
    assert allowed["speed_over_limit"] is ErrorClass.IMPERCEPTIBLE


@pytest.mark.parametrize("frames", [20, 29])
def test_penetration_that_goes_in_time_is_accepted(frames: int) -> None:
    reference = swinging()
    depth = np.zeros(60)
    depth[30 : 30 + frames] = 0.0039
    found = classify(figures(replace(reference, depth=depth), reference))
    assert found["penetration_thicknesses"] is ErrorClass.ACCEPTED
    assert found["penetration_s"] is ErrorClass.IMPERCEPTIBLE


def test_a_layer_that_stays_through_is_catastrophic() -> None:
    reference = swinging(120)
    found = classify(figures(replace(reference, depth=np.full(120, 0.01)), reference))
    assert found["penetration_s"] is ErrorClass.CATASTROPHIC


def test_energy_that_doubles_is_catastrophic() -> None:
    reference = replace(swinging(), energy=np.linspace(2.0, 1.0, 60))
    grown = replace(reference, energy=np.linspace(2.0, 3.5, 60))
    assert classify(figures(grown, reference))["energy_growth"] is ErrorClass.CATASTROPHIC


def test_chaotic_runs_are_not_compared_by_position() -> None:
    reference = swinging()
    found = figures(replace(reference, position=reference.position + 1.0), reference, chaotic=True)
    assert (
        "position_px" not in found
        and max(classify({**found, "energy_growth": 0.0}).values()) is ErrorClass.IMPERCEPTIBLE
    )


def test_runs_of_different_lengths_are_refused() -> None:
    with pytest.raises(InputError, match="position"):
        figures(swinging(50), swinging(60))


def test_limits_rise() -> None:
    assert all(a <= b <= c for a, b, c in LIMITS.values())


def test_an_edge_that_stays_short_of_the_reference_is_no_catastrophe() -> None:
    """Only what goes beyond the reference by its own length is."""
    reference = swinging()
    long = reference.position.copy()
    long[:, 2, 1] -= 0.15
    found = classify(figures(reference, replace(reference, position=long)))
    assert found["edge_strain_max"] is ErrorClass.VISIBLE and found["edge_strain_beyond"] is ErrorClass.IMPERCEPTIBLE


def test_energy_that_the_reference_gains_too_is_no_growth() -> None:
    """Compressed cloth that is let go."""
    gains = replace(swinging(), energy=np.linspace(0.0, 1.0, 60))
    assert figures(gains, gains)["energy_growth"] == 0.0
    more = replace(gains, energy=np.linspace(0.0, 2.5, 60))
    assert figures(more, gains)["energy_growth"] == pytest.approx(1.5)
    assert figures(more, gains, energy_scale=5.0)["energy_growth"] == pytest.approx(0.3)


def test_cloth_folded_back_on_itself() -> None:
    flat = np.array([[0.0, 0.0, 0.0], [0.0, 0.1, 0.0], [-0.1, 0.05, 0.0], [0.1, 0.05, 0.0]])
    folded = flat.copy()
    folded[3, 0], folded[3, 2] = -0.099, 0.01
    runs = [Recorded(np.repeat(x[None], 60, axis=0), np.zeros((60, 4, 3)), DT) for x in (flat, folded)]
    edges, rest = np.array([[0, 1], [0, 2], [0, 3]]), np.full(3, 0.1)
    found = [deviations(run, runs[0], edges, rest, 0.004, hinges=np.array([[0, 1, 2, 3]])) for run in runs]
    assert [one["folded_percent"] for one in found] == [0.0, 100.0]
    assert classify(found[1])["folded_percent"] is ErrorClass.VISIBLE
