"""The figures of self-collision on a sphere."""

from precompute.benchmarks.contact_bench import self_collision_cost


def test_a_small_square_stays_on_the_sphere_and_out_of_itself() -> None:
    found = self_collision_cost(21, frames=100)  # an odd number: one vertex lies on top
    assert set(found) == {f"self_collision_{name}_21" for name in ("ms", "crossings", "top_mm")}
    assert found["self_collision_crossings_21"] == 0
    assert 2.0 < found["self_collision_top_mm_21"] < 12.0  # kept off by the thickness, of 3 mm
    assert found["self_collision_ms_21"] > 0
