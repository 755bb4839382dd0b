"""Motions in which cloth would go through itself: none of its faces does, whatever the motion is."""

import numpy as np
import pytest

from pbd import Colliders
from pbd.contact import impacts
from pbd.contact.impacts import Impacts
from pbd.crossings import FaceGrid, crossings, seams_of
from pbd.xpbd.collision_handling import MAX_STRETCH, CollisionHandling
from tests.pbd.meshes import grid, thrown_sheet

STEP = 0.02


def two_sheets(random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A sheet that is nearly flat, and one about 12 mm above it; one mesh."""
    vertices, faces = grid(10, 10, STEP)
    other = vertices + random.normal(0.0, 0.002, vertices.shape) + [0.003, 0.004, 0.012]
    below = vertices + random.normal(0.0, 0.002, vertices.shape)
    return np.concatenate([below, other]), np.concatenate([faces, faces + len(vertices)])


def crosses_on_the_way(start: np.ndarray, end: np.ndarray, faces: np.ndarray) -> int:
    return sum(len(crossings(start + t * (end - start), faces)) for t in np.linspace(0.0, 1.0, 21))


@pytest.mark.parametrize("seed", range(3))
def test_a_sheet_does_not_pass_another_in_one_motion(seed: int) -> None:
    random = np.random.default_rng(seed)
    start, faces = two_sheets(random)
    half = len(start) // 2
    end = start + random.normal(0.0, 0.001, start.shape)
    end[half:, 2] -= 0.03
    assert not len(crossings(start, faces)) and not len(crossings(end, faces))
    assert crosses_on_the_way(start, end, faces)  # it would be wholly on the other side
    kept = end.copy()
    collided, _ = Impacts(faces, len(start)).keep_apart(start, kept, np.ones(len(start)))
    assert collided > 50
    assert not crosses_on_the_way(start, kept, faces)
    assert (kept[half:, 2] > kept[:half, 2]).all()
    # Both have the same mass: what the one loses in speed the other gains, but for faces that move as three corners.
    assert kept[:, 2].mean() == pytest.approx(end[:, 2].mean(), abs=0.003)


@pytest.mark.parametrize("seed", range(3))
def test_what_is_crumpled_at_random_does_not_cross(seed: int) -> None:
    random = np.random.default_rng(seed)
    start, faces = two_sheets(random)
    end = start + random.normal(0.0, STEP, start.shape)
    assert len(crossings(end, faces)) > 500
    kept = end.copy()
    Impacts(faces, len(start)).keep_apart(start, kept, np.ones(len(start)))
    assert not crosses_on_the_way(start, kept, faces)


def test_what_cannot_be_parted_moves_on_in_rigid_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(impacts, "PASSES", 1)
    random = np.random.default_rng(0)
    start, faces = two_sheets(random)
    end = start + random.normal(0.0, STEP, start.shape) + [0.05, 0.0, 0.0]
    kept = end.copy()
    _, rigid = Impacts(faces, len(start)).keep_apart(start, kept, np.ones(len(start)))
    assert rigid > 100
    assert not crosses_on_the_way(start, kept, faces)
    assert (kept - start).mean(axis=0) == pytest.approx((end - start).mean(axis=0), abs=0.003)


def test_what_is_pushed_far_does_not_go_through_a_third_sheet() -> None:
    """The two lower sheets are near one another neither before nor after the motion that is proposed for them."""
    vertices, faces = grid(10, 10, STEP)
    count = len(vertices)
    start = np.concatenate([vertices + [0.003 * k, 0.004 * k, 0.003 * k] for k in range(3)])
    end = start.copy()
    end[2 * count :, 2] -= 0.03
    inverse_mass = np.repeat([1.0, 1.0, 0.001], count)
    all_faces = np.concatenate([faces + k * count for k in range(3)])
    Impacts(all_faces, len(start)).keep_apart(start, end, inverse_mass)
    assert end[count : 2 * count, 2].max() < 0.0  # the middle sheet was pushed by more than their distance
    assert not crosses_on_the_way(start, end, all_faces)
    assert (end[count : 2 * count, 2] > end[:count, 2]).all()


def test_cloth_that_goes_to_and_fro_by_its_own_size_takes_no_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Too few substeps make it so; all of its faces might collide with one another then."""
    random = np.random.default_rng(0)
    start, faces = two_sheets(random)
    end = start + random.normal(0.0, 10.0 * STEP, start.shape)
    monkeypatch.setattr(impacts, "LEAST_PAIRS", 1000)
    kept, guard = end.copy(), Impacts(faces, len(start))
    assert guard.keep_apart(start, kept, np.ones(len(start))) == (0, 0)
    assert np.array_equal(kept, end)
    assert len(guard._pairs) == len(start)
    guard.grid.pairs(start, end)  # has room for all of them now: the answer stays
    assert guard.keep_apart(start, kept, np.ones(len(start))) == (0, 0)


def test_held_vertices_and_faces_that_do_not_count_stay_as_they_are() -> None:
    start, faces = two_sheets(np.random.default_rng(1))
    half = len(start) // 2
    end = start.copy()
    end[half:, 2] -= 0.02
    inverse_mass = np.ones(len(start))
    inverse_mass[:half] = 0.0
    kept = end.copy()
    Impacts(faces, len(start)).keep_apart(start, kept, inverse_mass)
    assert np.array_equal(kept[:half], end[:half])
    assert not crosses_on_the_way(start, kept, faces)
    chosen = np.arange(len(faces) // 2, dtype=np.int32)  # the lower sheet alone
    kept = end.copy()
    assert Impacts(faces, len(start)).keep_apart(start, kept, inverse_mass, chosen) == (0, 0)
    assert np.array_equal(kept, end)


def test_what_is_stitched_to_one_another_may_go_through_one_another() -> None:
    vertices, faces = grid(3, 3, STEP)
    count = len(vertices)
    both = np.concatenate([faces, faces + count])
    start = np.concatenate([vertices, vertices + [0.004, 0.003, 0.01]])
    end = start.copy()
    end[:count, 2] += 0.02
    stitches = np.stack([np.arange(count), np.arange(count) + count, np.roll(np.arange(count), 1) + count], axis=1)
    kept = end.copy()
    seams = seams_of(stitches.astype(np.int32), 2 * count)
    assert Impacts(both, 2 * count, seams).keep_apart(start, kept, np.ones(2 * count)) == (0, 0)
    assert Impacts(both, 2 * count).keep_apart(start, kept, np.ones(2 * count))[0] > 0
    middle = start.copy()
    middle[:count, 2] = 0.01 + 0.003 * (-1.0) ** np.arange(count)
    assert len(FaceGrid(both).crossings(middle)) > 0
    assert not len(FaceGrid(both, seams).crossings(middle))


def test_motion_without_impacts_keeps_its_bits() -> None:
    start, faces = two_sheets(np.random.default_rng(2))
    end = start + [0.5, -0.3, 0.2]
    kept = end.copy()
    assert Impacts(faces, len(start)).keep_apart(start, kept, np.ones(len(start))) == (0, 0)
    assert np.array_equal(kept, end)


def thrown(guarded: bool, watched: bool = True) -> list[int]:
    """Crossings in each frame of the thrown sheet."""
    solver, state = thrown_sheet()
    assert solver._collisions is not None
    if not guarded:
        solver._collisions.pairs.impacts = None
    found = []
    for _ in range(20):
        solver.step(state, Colliders(), 1.0 / 60.0)
        found.append(len(crossings(state.world(), solver.model.mesh.faces)))
        if not watched:
            state.colliding[:] = 0
    return found


def test_a_sheet_that_is_thrown_at_itself_stays_free_of_crossings() -> None:
    assert max(thrown(guarded=False)) > 0  # contact alone does not keep it so
    assert max(thrown(guarded=True)) == 0


def test_what_collided_is_watched_from_the_start_of_the_next_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    """A frame that begins freely and crosses is done again: then fewer are."""
    assert max(thrown(guarded=True, watched=False)) == 0
    begun = []
    advance, name = CollisionHandling._advance_with_pairs, "_advance_with_pairs"
    monkeypatch.setattr(CollisionHandling, name, lambda *arguments: (begun.append(1), advance(*arguments)))
    thrown(guarded=True, watched=False)
    freely = len(begun)
    begun.clear()
    thrown(guarded=True)
    assert freely == 20
    assert 0 < len(begun) < freely - 3


def test_what_is_drawn_out_is_not_watched_and_nothing_is_that_moved_otherwise() -> None:
    solver, state = thrown_sheet()
    while not state.colliding.any():
        solver.step(state, Colliders(), 1.0 / 60.0)
    assert not state.colliding.all()
    later = state.copy()
    assert later.hash() == state.hash()
    later.forget_self_contact()
    assert not later.colliding.any()
    assert not len(later.pairs)
    assert later.hash() != state.hash()
    assert solver._collisions.stretch(state, state.colliding > 0) < MAX_STRETCH
    drawn = int(np.flatnonzero(state.colliding)[0])
    state.position[drawn, :3] += np.float32(0.5)
    assert solver._collisions.stretch(state, state.colliding > 0) > MAX_STRETCH
