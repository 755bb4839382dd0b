"""Patches from coarse to fine: what they are made of, and what they do to the cloth's physics."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from pbd import Colliders, Fabric, Model, Solver, SolverOptions, State
from pbd.engine import ti
from pbd.xpbd.constraints import spring_multiplier
from pbd.xpbd.multigrid import Multigrid, build_multigrid
from tests.pbd.meshes import cloth, free_model, grid, momentum, turn
from tests.wrinkles.meshes import flat_sheet, tube

vec3 = ti.math.vec3
Rows = ti.types.ndarray(dtype=ti.f32, ndim=2)
VACUUM = {"air_drag": 0.0}


def multigrid_of(model: Model) -> Multigrid:
    return build_multigrid(model.mesh, model.mass, model.inverse_mass, model.fabric)


def centres(levels: Multigrid, vertices: np.ndarray) -> np.ndarray:
    """Centres of mass of all patches, shape (k, 3)."""
    places = np.concatenate([vertices, np.zeros((len(levels.inverse_mass), 3))])
    for member, (patch, share) in enumerate(zip(levels.parent, levels.mass_share, strict=True)):
        if patch >= 0:
            places[len(vertices) + patch] += share * places[member]
    return places[len(vertices) :]


def spans(levels: Multigrid, places: np.ndarray) -> np.ndarray:
    return np.linalg.norm(places[levels.springs[:, 0]] - places[levels.springs[:, 1]], axis=1)


@pytest.mark.parametrize("jitter", [0.0, 0.3])
def test_on_a_flat_sheet_links_are_as_long_as_centres_are_apart(jitter: float) -> None:
    vertices, faces = flat_sheet(25, 1.0, jitter)
    vertices = vertices @ turn((1.0, 2.0, 0.5), 40.0).T
    model = free_model(cloth(vertices, faces), Fabric(), np.array([0, 24]))
    levels = multigrid_of(model)
    assert len(levels.level_starts) > 2 and np.all(
        np.diff(levels.level_starts)[1:] < 0.25 * np.diff(levels.level_starts)[:-1]
    )
    assert levels.spring_data[:, 0, 0] == pytest.approx(spans(levels, centres(levels, vertices)), rel=1e-5)


def test_on_a_tube_links_have_the_length_of_the_unrolled_sheet() -> None:
    around, radius = 36, 0.3
    vertices, faces = tube(around, radius)
    levels = multigrid_of(free_model(cloth(vertices, faces), Fabric()))
    # Unrolled about each link: angles from its first patch's middle.
    angle = np.arctan2(vertices[:, 2], vertices[:, 0])
    first = slice(*levels.spring_starts[:2])
    inside = levels.parent[: len(vertices)]
    side = 2 * radius * around * np.sin(np.pi / around) / (2 * np.pi * radius)  # of the prism, over the arc
    for (a, b), length in zip(levels.springs[first], levels.spring_data[first, 0, 0], strict=True):
        rolled = {}
        middle = angle[np.argmax(inside == a)]
        for patch in (a, b):
            members = np.flatnonzero(inside == patch)
            turned = radius * side * ((angle[members] - middle + np.pi) % (2 * np.pi) - np.pi)
            rolled[patch] = levels.mass_share[members] @ np.stack([turned, vertices[members, 1]], axis=1)
        assert length == pytest.approx(np.linalg.norm(rolled[a] - rolled[b]), rel=1e-5)


def test_links_do_not_depend_on_how_the_cloth_lies_at_the_start() -> None:
    vertices, faces = flat_sheet(25, 1.0, 0.3)
    flat = cloth(vertices, faces)
    crumpled = replace(flat, vertices=vertices + 0.1 * np.random.default_rng(0).standard_normal(vertices.shape))
    here, there = (multigrid_of(free_model(mesh, Fabric(stretch_weft=300.0))) for mesh in (flat, crumpled))
    assert np.array_equal(here.springs, there.springs)
    assert there.spring_data == pytest.approx(here.spring_data, rel=1e-5, abs=1e-9)


def test_links_over_a_seam_have_the_length_of_the_unrolled_sheet() -> None:
    vertices, faces = flat_sheet(25, 1.0, 0.3)
    mesh = cloth(vertices, faces)
    # Panels are cut at the middle and laid out in other directions.
    c, s = np.cos(0.7), np.sin(0.7)
    beyond = vertices[faces].mean(axis=1)[:, 0] > vertices[:, 0].mean()
    turned = np.where(beyond[:, None, None], np.array([[c, -s], [s, c]]) @ mesh.flat, mesh.flat)
    here, there = (multigrid_of(free_model(one, Fabric())) for one in (mesh, replace(mesh, flat=turned)))
    assert there.spring_data[:, 0, 0] == pytest.approx(here.spring_data[:, 0, 0], rel=1e-5)


@pytest.mark.parametrize("stretch", [(1.5, 1.5, 1.0), (3.0, 1.0, 1.0), (0.8, 1.2, 1.0)])
def test_links_are_as_long_as_the_pattern_says_where_cloth_starts_stretched(stretch: tuple) -> None:
    vertices, faces = flat_sheet(25, 1.0)
    mesh = cloth(vertices, faces)
    at_rest = multigrid_of(free_model(mesh, Fabric()))
    stretched = multigrid_of(free_model(replace(mesh, vertices=vertices * stretch), Fabric()))
    assert stretched.spring_data[:, 0, 0] == pytest.approx(at_rest.spring_data[:, 0, 0], rel=1e-5)


def test_every_vertex_has_a_patch_and_shares_make_a_whole() -> None:
    vertices, faces = grid(30, 20, 0.03)
    held = np.array([0, 20])
    model = free_model(cloth(vertices, faces), Fabric(), held)
    levels = multigrid_of(model)
    last = levels.level_starts[-2]
    assert np.all(levels.parent[: len(vertices) + last] >= 0) and np.all(levels.parent[len(vertices) + last :] == -1)
    sums = np.bincount(levels.parent[: len(vertices) + last], levels.mass_share[: len(vertices) + last])
    assert sums == pytest.approx(np.ones(levels.level_starts[-1]), abs=1e-6)
    stays = levels.inverse_mass == 0
    assert stays[levels.parent[held]].all() and stays.sum() == 2 * (len(levels.level_starts) - 1)
    # A patch that stays stands where its held vertex is.
    assert centres(levels, vertices)[levels.parent[held]] == pytest.approx(vertices[held], abs=1e-6)
    free = levels.inverse_mass[: levels.level_starts[1]][~stays[: levels.level_starts[1]]]
    held_patches = np.isin(levels.parent[: len(vertices)], levels.parent[held])
    assert (1.0 / free).sum() == pytest.approx(model.mass[~held_patches].sum(), rel=1e-5)


def test_pieces_that_do_not_touch_have_no_levels() -> None:
    corner = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]])
    vertices = np.concatenate([corner + [k, 0.0, 0.0] for k in range(20)])
    model = free_model(cloth(vertices, np.arange(60, dtype=np.int32).reshape(-1, 3)), Fabric())
    levels = multigrid_of(model)
    assert levels.useful(1.0) == 0 and len(levels.springs) == 0
    Solver(model, SolverOptions(coarse_sweeps=2)).step(State.at_rest(model), Colliders(), 1 / 60)


def test_soft_cloth_and_small_steps_need_no_levels() -> None:
    vertices, faces = grid(30, 20, 0.03)
    levels = multigrid_of(free_model(cloth(vertices, faces), Fabric()))
    counts = [levels.useful(h) for h in (1e-5, 1e-3, 1e-1)]
    assert counts == [0, 1, len(levels.level_starts) - 1] and counts[2] > 1


@ti.kernel
def spring_rows(offsets: Rows, directions: Rows, numbers: Rows, out: Rows):
    for c in range(offsets.shape[0]):
        out[c, 0] = spring_multiplier(
            vec3(offsets[c, 0], offsets[c, 1], offsets[c, 2]),
            vec3(directions[c, 0], directions[c, 1], directions[c, 2]),
            numbers[c, 0],
            numbers[c, 1],
            numbers[c, 2],
            numbers[c, 3],
        )


def test_a_spring_reaches_its_length_and_never_pushes() -> None:
    rng = np.random.default_rng(0)
    offsets = rng.normal(size=(200, 3))
    directions = offsets + 0.02 * rng.normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    distance = np.linalg.norm(offsets, axis=1)
    length = distance * rng.uniform(0.98, 1.02, 200)
    total, had = rng.uniform(1.0, 5.0, 200), -rng.uniform(0.0, 0.01, 200)
    for give in (0.0, 0.7):
        out = np.zeros((200, 1), np.float32)
        numbers = np.stack([length, np.full(200, give), total, had], axis=1)
        spring_rows(*(part.astype(np.float32) for part in (offsets, directions, numbers)), out)
        change = out[:, 0].astype(float)
        moved = np.linalg.norm(offsets + (total * change)[:, None] * directions, axis=1)
        pulls = had + change < -1e-7
        assert 50 < pulls.sum() < 150 and np.all(had + change <= 1e-7)
        assert (moved - length + give * (had + change))[pulls] == pytest.approx(np.zeros(pulls.sum()), abs=2e-4)


def hanging(stiffness: float, substeps: int, sweeps: int) -> float:
    """Stretch of a strip of 40 edges under its own weight over rho_A g L/(2 E h)."""
    vertices, faces = grid(40, 6, 1.0 / 40)
    vertices = np.stack([vertices[:, 1], -vertices[:, 0], vertices[:, 2]], axis=1)
    fabric = Fabric(stretch_warp=stiffness, stretch_weft=stiffness, shear=stiffness / 2, poisson=0.0, **VACUUM)
    model = free_model(cloth(vertices, faces, (0.0, 1.0, 0.0)), fabric, np.flatnonzero(vertices[:, 1] > -1e-9))
    state, options = State.at_rest(model), SolverOptions(substep=1.0 / (60.0 * substeps), coarse_sweeps=sweeps)
    solver = Solver(model, options)
    for _ in range(150):
        solver.step(state, Colliders(), 1 / 60)
        state.velocity *= np.float32(0.9)
    tip = vertices[:, 1] < -1.0 + 1e-9
    return (vertices[tip, 1] - state.world()[tip, 1]).mean() * 2.0 * stiffness / (fabric.areal_density * 9.81)


@pytest.mark.parametrize("stiffness", [30.0, 300.0])
def test_the_fabric_keeps_its_stiffness(stiffness: float) -> None:
    """Where plain small steps are right, patches change nothing, though all levels pull."""
    assert hanging(stiffness, 60, 4) == pytest.approx(hanging(stiffness, 60, 0), rel=0.03)


def test_stiff_cloth_is_held_in_few_substeps() -> None:
    """Plain small steps stretch this strip by 4.6 % (the law of one pass), 600 times too far."""
    excess = hanging(1e5, 8, 0) / hanging(1e5, 8, 4)
    assert excess > 10.0


def spinning(place: float) -> tuple[Model, State]:
    vertices, faces = grid(20, 14, 0.03, "equilateral")
    vertices[:, 2] = 0.03 * np.sin(9.0 * vertices[:, 0]) * np.cos(7.0 * vertices[:, 1])
    vertices = vertices @ turn((1.0, 2.0, 0.5), 40.0).T + [place, place, 0.0]
    stiff = Fabric(stretch_warp=2e4, stretch_weft=2e4, shear=5e3, **VACUUM)
    model = free_model(cloth(vertices, faces), stiff)
    arm = vertices - vertices.mean(axis=0)
    state = State.at_rest(model, vertices + 0.02 * arm * [1.0, -0.5, 1.0])
    state.velocity[:] = np.cross([1.0, 3.0, -2.0], arm) + [0.5, 0.2, -0.1]
    return model, state


@pytest.mark.parametrize("place", [0.0, 100.0])
def test_patches_keep_momentum(place: float) -> None:
    model, state = spinning(place)
    solver = Solver(model, SolverOptions(substep=1 / 600, gravity=(0.0, 0.0, 0.0), coarse_sweeps=4))
    linear, angular = momentum(model, state)
    for _ in range(30):
        solver.step(state, Colliders(), 1 / 60)
    after_linear, after_angular = momentum(model, state)
    assert np.abs(after_linear - linear).max() < 1e-6 * np.linalg.norm(linear)
    # Implicit Euler may take its part, h omega^2; patches give nothing.
    lost = 1.0 - np.linalg.norm(after_angular) / np.linalg.norm(angular)
    assert -1e-3 < lost < 14.0 / 600 * 0.5 + 1e-3


@pytest.mark.parametrize("place", [0.0, 8.0, 100.0])
def test_free_fall_of_stiff_cloth(place: float) -> None:
    vertices, faces = grid(20, 20, 0.03, "equilateral")
    vertices = vertices @ turn((1.0, 2.0, 0.5), 40.0).T + [place, place, 0.0]
    model = free_model(cloth(vertices, faces), Fabric(stretch_warp=1e5, stretch_weft=1e5, shear=4e4, **VACUUM))
    state, solver = State.at_rest(model), Solver(model, SolverOptions(substep=1 / 1200, coarse_sweeps=4))
    for _ in range(60):
        solver.follow(state, Colliders())
        solver.step(state, Colliders(), 1 / 60)
    assert np.abs(state.velocity - [0.0, -9.81, 0.0]).max() < 1e-4


def test_more_than_patches_may_give_is_left_to_the_membranes() -> None:
    """A held corner that jumps far out of reach: membranes must not be told that patches bore what they left."""
    vertices, faces = grid(24, 24, 1.0 / 24)
    held = np.flatnonzero((vertices[:, 1] > vertices[:, 1].max() - 1e-9) & (np.abs(vertices[:, 0] - 0.5) > 0.5 - 1e-9))
    model = free_model(cloth(vertices, faces), Fabric(0.2, 1e5, 1e5, 1 / 3, 3.75e4, **VACUUM), held)
    state, solver = State.at_rest(model), Solver(model, SolverOptions(coarse_sweeps=4))
    targets = state.world()[held]
    out = targets + np.array([[0.0, 0.0, 0.0], [0.6, 0.0, 0.0]])
    for frame in range(160):
        solver.step(state, Colliders(), 1 / 60, out if 10 <= frame < 40 else targets)
        assert np.abs(state.velocity).max() < 200.0  # without patches 75
    edges, rest = model.mesh.edge_lengths()
    x = state.world()
    assert np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1).max() < 1.3 * rest.max()  # without patches 1.2


PATCHES = """
from assets.loading import load_garment
from pbd import Fabric
from pbd.xpbd.multigrid import build_multigrid
from tests.pbd.meshes import cloth, free_model
skirt = load_garment("builtin:skirt")
model = free_model(cloth(skirt.vertices, skirt.faces), Fabric())
print(build_multigrid(model.mesh, model.mass, model.inverse_mass, model.fabric).parent.tolist())
"""


def test_patches_are_the_same_on_every_processor() -> None:
    """NumPy sorts equal numbers in another order where it has AVX-512; without it both runs are one."""
    made = set()
    for without in ("", "X86_V4 AVX512_ICL AVX512_SPR"):
        environment = {**os.environ, "NPY_DISABLE_CPU_FEATURES": without}
        ran = subprocess.run(
            [sys.executable, "-c", PATCHES], env=environment, capture_output=True, text=True, check=True
        )
        made.add(ran.stdout)
    assert len(made) == 1
