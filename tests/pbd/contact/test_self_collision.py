"""Cloth against itself: what is found, what is kept apart, what is conserved, what is remembered."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pbd import Colliders, Fabric, Plane, Solver, SolverOptions, State
from pbd.attachment import closest_weights
from pbd.contact.pairs import PULL
from pbd.contact.patch_tree import joined_groups
from pbd.contact.self_collision import SelfCollision
from pbd.crossings import crossings
from pbd.mesh import edges_of
from tests.pbd.meshes import cloth, free_model, level, turn

THICKNESS = 0.003
ON = SolverOptions(self_collision=True)


def sheets(*placed: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sheets of the same faces as one mesh."""
    count = len(placed[0])
    return np.concatenate(placed), np.concatenate([faces + k * count for k in range(len(placed))])


def segment_gap(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Distance of the segments a-b and c-d, by trying the ends and the inner point."""
    best = np.full(len(a), np.inf)
    for p, q, r in ((a, c, d), (b, c, d), (c, a, b), (d, a, b)):
        side = r - q
        t = np.clip(((p - q) * side).sum(1) / (side * side).sum(1), 0, 1)[:, None]
        best = np.minimum(best, np.linalg.norm(q + t * side - p, axis=1))
    u, v, w = b - a, d - c, a - c
    uu, uv, vv, uw, vw = ((x * y).sum(1) for x, y in ((u, u), (u, v), (v, v), (u, w), (v, w)))
    size = uu * vv - uv * uv
    inner = size > 1e-9 * uu * vv
    safe = np.where(inner, size, 1.0)
    s, t = (uv * vw - vv * uw) / safe, (uu * vw - uv * uw) / safe
    inner &= (s > 0) & (s < 1) & (t > 0) & (t < 1)
    gap = np.linalg.norm(w + s[:, None] * u - t[:, None] * v, axis=1)
    return np.where(inner, np.minimum(best, gap), best)


def near_features(vertices: np.ndarray, faces: np.ndarray, reach: float) -> set[tuple]:
    """Every vertex and face, and every two edges, without common vertex and nearer than ``reach``: brute force."""
    edges, _ = edges_of(faces)
    found = set()
    v, f = (part.ravel() for part in np.meshgrid(np.arange(len(vertices)), np.arange(len(faces)), indexing="ij"))
    apart = (faces[f] != v[:, None]).all(axis=1)
    v, f = v[apart], f[apart]
    corner = vertices[faces[f]]
    weights = closest_weights(vertices[v], *(corner[:, k] for k in range(3)))
    near = np.linalg.norm(np.einsum("kc,kci->ki", weights, corner) - vertices[v], axis=1) < reach
    found |= {(int(a), *sorted(faces[b].tolist())) for a, b in zip(v[near], f[near], strict=True)}
    e, d = np.triu_indices(len(edges), 1)
    apart = ~(edges[e][:, :, None] == edges[d][:, None, :]).any(axis=(1, 2))
    e, d = e[apart], d[apart]
    near = segment_gap(*(vertices[edges[k][:, m]] for k in (e, d) for m in (0, 1))) < 0.5 * reach
    return found | {frozenset((tuple(edges[a]), tuple(edges[b]))) for a, b in zip(e[near], d[near], strict=True)}


def found_features(pairs: np.ndarray) -> set[tuple]:
    points = {(int(q[0]), *sorted(q[1:].tolist())) for q in pairs if q[1] >= 0}
    lines = {frozenset((tuple(sorted((q[0], -q[1] - 1))), tuple(sorted(q[2:])))) for q in pairs if q[1] < 0}
    return points | lines


@pytest.mark.parametrize("seed", range(3))
def test_every_pair_that_brute_force_finds_is_found_once(seed: int) -> None:
    random = np.random.default_rng(seed)
    flat, faces = level(7, 6, 0.02)
    leaves = [flat @ turn(random.normal(size=3), 8.0).T + [0.004 * k, 0.0025 * k, 0.0] for k in range(3)]
    vertices, faces = sheets(*leaves, faces=faces)
    model = free_model(cloth(vertices, faces), Fabric(thickness=THICKNESS))
    state, pairs = State.at_rest(model), SelfCollision(model)
    pairs.find(state, 1e-6, 1, THICKNESS)
    rows = pairs.pairs[: pairs.ready[0]][pairs.data[: pairs.ready[0], 1, 1] != PULL]
    wanted, found = near_features(state.world(), faces, THICKNESS), found_features(rows)
    assert len(wanted) > 300
    assert wanted <= found
    assert len(found) == len(rows)  # none twice


def test_between_layers_alone_the_same_pairs_are_found_as_when_all_are() -> None:
    random = np.random.default_rng(7)
    flat, faces = level(24, 20, 0.02)  # several groups each, so that the tree parts the layers
    leaves = [flat @ turn(random.normal(size=3), 3.0).T + [0.004 * k, 0.0025 * k, 0.0] for k in range(4)]
    vertices, faces = sheets(*leaves, faces=faces)
    layer = np.repeat(np.array([0, 1, 0, 2], np.int32), len(flat))
    model = replace(free_model(cloth(vertices, faces), Fabric(thickness=THICKNESS)), layer=layer)
    state, rows = State.at_rest(model), {}
    for within in (True, False):
        pairs = SelfCollision(model, within)
        pairs.find(state, 1e-6, 1, THICKNESS)
        rows[within] = pairs.pairs[: pairs.ready[0]][pairs.data[: pairs.ready[0], 1, 1] != PULL]
    crossing = layer[rows[True][:, 0]] != layer[rows[True][:, 3]]
    assert 300 < crossing.sum() < len(crossing)
    assert found_features(rows[False]) == found_features(rows[True][crossing])
    assert len(rows[False]) == crossing.sum()


@pytest.mark.parametrize(("gap", "through"), [(-0.5 * THICKNESS, True), (-1.5 * THICKNESS, False)])
def test_edges_are_through_one_another_only_so_far(gap: float, through: bool) -> None:
    """What seems further through than cloth is thick has gone around; taken for through, it trembled for good."""
    flat, faces = level(3, 3, 0.02)
    vertices, faces = sheets(flat, flat @ turn((0.0, 1.0, 0.0), 30.0).T + [0.003, 0.002, 0.001], faces=faces)
    model = free_model(cloth(vertices, faces), Fabric(thickness=THICKNESS))
    state, pairs = State.at_rest(model), SelfCollision(model)
    pairs.find(state, 1e-6, 1, THICKNESS)
    count = pairs.ready[0]
    (edges, *_) = np.flatnonzero((pairs.pairs[:count, 1] < 0) & (np.abs(pairs.data[:count, 0, 1]) > 0.99))
    pair, normal = pairs.pairs[edges].copy(), pairs.data[edges, 0, :3].copy()
    state.pairs, state.pair_sides = pair[None], np.append(-normal, np.float32(gap))[None].astype(np.float32)
    pairs.find(state, 1e-6, 1, THICKNESS)
    (again,) = np.flatnonzero((pairs.pairs[: pairs.ready[0]] == pair).all(axis=1))
    assert (pairs.data[again, 0, :3] @ normal < 0.0) == through


def test_groups_that_branch_or_do_not_hang_together_are_searched_whole() -> None:
    """Three squares in a row, one group each: all join; those with a flap on an edge, or of two pieces, do not."""
    faces = np.array([[0, 1, 2], [1, 3, 2], [2, 3, 4], [3, 5, 4], [4, 5, 6], [5, 7, 6]])
    group = np.array([0, 0, 1, 1, 2, 2])
    starts, joined = joined_groups(faces, edges_of(faces)[1], group, 8)
    assert starts.tolist() == [0, 2, 5, 7] and joined.tolist() == [0, 1, 0, 1, 2, 1, 2]
    flap = np.insert(faces, 4, [2, 3, 8], axis=0)
    starts, joined = joined_groups(flap, edges_of(flap)[1], np.array([0, 0, 1, 1, 1, 2, 2]), 9)
    assert starts.tolist() == [0, 0, 0, 1] and joined.tolist() == [2]
    apart = faces.copy()
    apart[3] = [5, 7, 6]
    starts, joined = joined_groups(apart, edges_of(apart)[1], group, 8)
    assert 1 not in joined and starts[1] == starts[2]


@pytest.mark.parametrize("amplitude", [0.004, 0.006, 0.008, 0.012, 0.02])
def test_crossings_that_the_search_leaves_out_are_found_around_the_vertices(amplitude: float) -> None:
    """Sheets that are crumpled at random, from a few crossings to hundreds: what the grid of all faces finds."""
    flat, faces = level(16, 16, 0.02)
    model = free_model(cloth(flat, faces), Fabric(thickness=THICKNESS))
    state, pairs = State.at_rest(model), SelfCollision(model)
    assert pairs.impacts is not None
    found_by_fans = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        state.position[:, :3] = flat + amplitude * rng.normal(size=flat.shape)
        wanted = {tuple(row) for row in pairs.impacts.grid.crossings(state.position[:, :3].astype(float))}
        fans = {tuple(row) for row in pairs.impacts.grid.fan_crossings(state.position)}
        found = {tuple(row) for row in pairs.look_ahead(state, 1 / 720, 12, THICKNESS)}
        assert found == wanted
        found_by_fans += len(fans)
    assert (found_by_fans > 0) == (amplitude > 0.005)


def test_cloth_that_meets_on_its_way_is_found_and_cloth_that_leaves_is_not() -> None:
    """Two leaves 1 cm apart: towards each other at 0.9 m/s they meet within 1/60 s, away from each other never."""
    flat, faces = level(7, 6, 0.02)
    vertices, faces = sheets(flat, flat + [0.004, 0.01, 0.0025], faces=faces)
    model = free_model(cloth(vertices, faces), Fabric(thickness=THICKNESS))
    for speed, found in ((-0.9, True), (0.9, False)):
        state, pairs = State.at_rest(model), SelfCollision(model)
        state.velocity[len(flat) :, 1] = speed
        pairs.find(state, 1 / 600, 10, THICKNESS)
        assert (pairs.ready[0] > 300) == found and (pairs.ready[0] == 0) != found


def test_of_cloth_that_goes_to_and_fro_by_its_own_size_no_pairs_are_kept() -> None:
    """Too few substeps make it so; all of its features might meet. Once it is calm, they are found again."""
    flat, faces = level(20, 20, 0.02)
    vertices, faces = sheets(flat, flat + [0.004, 0.01, 0.0025], faces=faces)
    model = free_model(cloth(vertices, faces), Fabric(thickness=THICKNESS))
    state, pairs = State.at_rest(model), SelfCollision(model)
    state.velocity[len(flat) :, 1] = -0.9
    found, crossed = [], []
    for speed in (0.0, 30.0, 0.0):
        moving = state.copy()
        moving.velocity += np.random.default_rng(0).normal(0.0, 1.0, state.velocity.shape).astype(np.float32) * speed
        crossed.append(len(pairs.look_ahead(moving, 1 / 600, 10, THICKNESS)))
        assert pairs.overfull == (speed > 0.0)
        pairs.find(moving, 1 / 600, 10, THICKNESS)
        found.append(int(pairs.ready[0]))
    assert found[0] > 1000 and found == [found[0], 0, found[0]] and crossed == [0, 0, 0]
    assert len(pairs.pairs) < 3 * found[0]


def test_meshes_in_columns_cost_no_copies() -> None:
    """The kernel takes arrays in rows; others it would copy at every search, and be launched the slow way."""
    vertices, faces = level(3, 3, 0.02)
    model = free_model(replace(cloth(vertices, faces), vertices=np.asfortranarray(vertices)), Fabric())
    assert not model.mesh.vertices.flags.c_contiguous
    assert SelfCollision(model)._fixed["rest"].flags.c_contiguous


def run(model, state: State, frames: int, colliders: Colliders | None = None, options: SolverOptions = ON) -> Solver:
    solver, colliders = Solver(model, options), colliders or Colliders()
    for _ in range(frames):
        solver.follow(state, colliders)
        solver.step(state, colliders, 1 / 60)
    return solver


@pytest.fixture(scope="module")
def dropped() -> tuple:
    """A sheet dropped, turned, on a sheet on a plane; after 1.5 s."""
    flat, faces = level(12, 12, 0.02)
    upper = flat @ turn((0.0, 1.0, 0.0), 20.0).T + [0.01, 0.06, 0.005]
    vertices, both = sheets(flat + [0.0, THICKNESS, 0.0], upper, faces=faces)
    model = free_model(cloth(vertices, both), Fabric(thickness=THICKNESS, friction=0.3))
    state, colliders = State.at_rest(model), Colliders([Plane((0.0, 0.0, 0.0))])
    run(model, state, 90, colliders)
    return model, state, colliders, len(flat)


def test_a_sheet_on_a_sheet_stays_on_it(dropped: tuple) -> None:
    model, state, _, count = dropped
    world = state.world()
    assert len(crossings(world, model.mesh.faces)) == 0
    assert world[:count, 1].min() > 0.9 * THICKNESS
    over = np.abs(world[count:, [0, 2]]).max(axis=1) < 0.09
    assert over.sum() > 50
    assert world[count:, 1][over].min() > 1.8 * THICKNESS


def test_what_rests_does_not_jitter(dropped: tuple) -> None:
    model, state, colliders, _ = dropped
    later = state.copy()
    run(model, later, 30, colliders)
    assert np.abs(later.world() - state.world()).max() < 0.1 * THICKNESS


def test_states_with_contacts_come_back_bit_by_bit(dropped: tuple, tmp_path: Path) -> None:
    model, state, colliders, _ = dropped
    assert len(state.pairs) > 100
    state.save(str(tmp_path / "state.npz"))
    back = State.load(str(tmp_path / "state.npz"))
    assert back.hash() == state.hash()
    other = state.copy()
    run(model, back, 2, colliders)
    run(model, other, 2, colliders)
    assert back.hash() == other.hash()
    for name in ("pairs", "pair_sides", "colliding"):
        changed = state.copy()
        getattr(changed, name).flat[-1] += 1
        assert changed.hash() != state.hash()


def test_a_sheet_that_went_through_comes_back_to_its_side(dropped: tuple) -> None:
    model, state, colliders, count = dropped
    state = state.copy()
    # What the memory holds decides, not where the sheet is: a corner is put 2 mm under the lower sheet.
    top = count + int(np.argmin(np.linalg.norm(state.world()[count:, [0, 2]], axis=1)))
    state.position[top, 1] -= np.float32(THICKNESS + 0.001)
    assert len(crossings(state.world(), model.mesh.faces)) > 0
    run(model, state, 6, colliders)
    assert len(crossings(state.world(), model.mesh.faces)) == 0
    assert state.world()[top, 1] > 1.8 * THICKNESS


def test_sheets_nearer_at_rest_than_the_thickness_do_not_fly_apart() -> None:
    flat, faces = level(8, 8, 0.02)
    vertices, both = sheets(flat, flat + [0.001, 0.0005, 0.002], faces=faces)
    model = free_model(cloth(vertices, both), Fabric(thickness=THICKNESS))
    state = State.at_rest(model)
    run(model, state, 30, options=replace(ON, gravity=(0.0, 0.0, 0.0)))
    assert np.abs(state.world() - vertices).max() < 1e-4
    assert np.abs(state.velocity).max() < 1e-3


@pytest.mark.parametrize(("degrees", "holds"), [(10.0, True), (25.0, False)])
def test_friction_holds_a_sheet_on_an_inclined_sheet(degrees: float, holds: bool) -> None:
    flat, faces = level(16, 16, 0.02)
    small, small_faces = level(5, 5, 0.02)
    slope = turn((0.0, 0.0, 1.0), degrees)
    vertices = np.concatenate([flat, small + [0.0, THICKNESS, 0.0]]) @ slope.T
    both = np.concatenate([faces, small_faces + len(flat)])
    model = free_model(
        cloth(vertices, both), Fabric(thickness=THICKNESS, friction=0.3, air_drag=0.0), np.arange(len(flat))
    )
    state = State.at_rest(model)
    run(model, state, 60 if holds else 15)
    slid = ((vertices - state.world())[len(flat) :] @ slope[:, 0]).mean()
    if holds:
        assert abs(slid) < 1e-4
    else:
        angle = np.radians(degrees)
        assert slid == pytest.approx(0.5 * 9.81 * (np.sin(angle) - 0.3 * np.cos(angle)) * 0.25**2, rel=0.1)


def test_sheets_that_meet_in_free_flight_keep_their_momentum() -> None:
    flat, faces = level(8, 8, 0.02)
    upper = flat @ turn((0.3, 1.0, 0.1), 15.0).T + [0.01, 0.02, 0.0]
    vertices, both = sheets(flat, upper, faces=faces)
    model = free_model(cloth(vertices, both), Fabric(thickness=THICKNESS, air_drag=0.0))
    state = State.at_rest(model)
    state.velocity[:] = (0.3, 0.0, 0.0)
    state.velocity[len(flat) :, 1] = -1.0
    mass = model.mass[:, None]
    linear = lambda: (mass * state.velocity).sum(axis=0)  # noqa: E731
    angular = lambda: np.cross(state.world(), mass * state.velocity).sum(axis=0)  # noqa: E731
    before, turning = linear(), angular()
    run(model, state, 20, options=replace(ON, gravity=(0.0, 0.0, 0.0)))
    assert state.velocity[: len(flat), 1].mean() < -0.2  # they have met
    assert np.abs(linear() - before).max() < 1e-5 * np.abs(before).sum()
    scale = np.abs(mass * state.velocity).sum() * 0.1
    assert np.abs(angular() - turning).max() < 1e-2 * scale
    assert len(crossings(state.world(), both)) == 0


def test_later_searches_of_a_frame_find_every_pair_of_cloth_that_moved_otherwise() -> None:
    """Part of a leaf leaves its expected motion; the pairs found are those near now, each once, and not all anew."""
    flat, faces = level(12, 12, 0.02)
    leaves = [flat + [0.004 * k, 0.02 * k, 0.0025 * k] for k in range(2)]
    vertices, faces = sheets(*leaves, faces=faces)
    model = free_model(cloth(vertices, faces), Fabric(thickness=THICKNESS))
    state, pairs = State.at_rest(model), SelfCollision(model)
    state.velocity[len(flat) :, 1] = -0.5  # in 1/60 s 8 mm of the 20 mm
    step = 1 / 600
    pairs.find(state, step, 10, THICKNESS)
    assert not near_features(state.world(), faces, THICKNESS)
    state.position[:, :3] += 4 * step * state.velocity
    moved = len(flat) + np.flatnonzero(flat[:, 0] < -0.11)
    state.position[moved, 1] -= np.float32(0.0156)
    pairs.find(state, step, 6, THICKNESS, done=4)
    stale = pairs._fixed["stale"]
    assert set(moved) <= set(np.flatnonzero(stale)) and stale.sum() < 0.5 * len(stale)
    rows = pairs.pairs[: pairs.ready[0]]
    wanted, found = near_features(state.world(), faces, THICKNESS), found_features(rows)
    assert len(wanted) > 20
    assert wanted <= found
    assert len(found) == len(rows)  # none twice
