"""Contact of the float64 solvers: derivatives of the contact forces, slopes, creep, the capstan, moving obstacles."""

import numpy as np
import pytest

from pbd import Capsule, ClothMesh, Colliders, Fabric, Plane, Sphere, State
from pbd.models import Options, make_solver
from pbd.models.obstacles import ContactForces, Cushion, Obstacles
from pbd.models.stepping import ClothSolver
from tests.pbd.meshes import cloth, free_model, grid, turn
from tests.pbd.models.sheets import INTEGRATORS, differences, integrated

THICKNESS = 0.003


def scene(end: float = 1.0) -> Obstacles:
    """A plane, a ball and a capsule in motion, met by points within some centimetres."""
    plane, ball = Plane((0.0, 0.0, 0.0), (0.1, 1.0, 0.0)), Sphere((0.0, -0.05, 0.0), 0.06)
    capsule = Capsule((-0.1, 0.0, 0.05), (0.1, 0.0, 0.06), 0.02)
    colliders = Colliders([plane, ball, capsule])
    Obstacles.of_frame(colliders, np.zeros(3))
    ball.centre, capsule.start = (0.01, -0.045, 0.0), (-0.1, 0.01, 0.05)
    return Obstacles(Obstacles.of_frame(colliders, np.zeros(3)), 0.0, end, THICKNESS)


def forces() -> tuple[ContactForces, np.ndarray]:
    """Contact with memory of some force: some vertices stick, some slide, some are clear."""
    rng = np.random.default_rng(0)
    start = rng.uniform(-0.04, 0.04, (30, 3))
    memory = rng.uniform(-0.5, 1.0, (30, 3)).clip(0.0), rng.normal(0.0, 0.1, (30, 3, 3))
    contact = ContactForces(scene(), start, np.arange(25), np.full(30, 40.0), 0.4, 0.01, memory)
    return contact, start + rng.normal(0.0, 0.004, start.shape)


def test_contact_forces_are_the_slope_of_their_energy() -> None:
    contact, x = forces()
    gradient = contact.gradient(x)
    measured = differences(contact.energy, x, 1e-7).reshape(x.shape)
    assert measured == pytest.approx(gradient, abs=1e-6 * np.abs(gradient).max())


def test_their_hessian_is_exact_against_a_plane_and_positive_elsewhere() -> None:
    contact, x = forces()
    eigenvalues = np.linalg.eigvalsh(contact.hessian(x).toarray())
    assert eigenvalues.min() > -1e-12 * eigenvalues.max()
    rows = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]])
    flat = Obstacles(rows, 0.0, 1.0, THICKNESS)
    rng = np.random.default_rng(1)
    memory = rng.uniform(0.0, 1.0, (30, 1)), rng.normal(0.0, 0.1, (30, 1, 3)) * [1.0, 0.0, 1.0]
    contact = ContactForces(flat, x, np.arange(30), np.full(30, 40.0), 0.4, 0.01, memory)
    y = x + rng.normal(0.0, 0.004, x.shape)
    hessian = contact.hessian(y).toarray()
    for place in range(0, y.size, 7):
        move = np.zeros(y.size)
        move[place] = 1e-7
        move = move.reshape(y.shape)
        column = (contact.gradient(y + move) - contact.gradient(y - move)).ravel() / 2e-7
        assert column == pytest.approx(hessian[place], abs=1e-5 * hessian.max())


def test_gaps_and_carried_points() -> None:
    obstacles = scene(end=0.5)
    x = np.array([[0.0, 0.1, 0.0], [0.2, 0.01, 0.055]])
    gaps, normals = obstacles.gaps(x)
    tilt = np.array([0.1, 1.0, 0.0]) / np.sqrt(1.01)
    assert gaps[:, 0] == pytest.approx(x @ tilt - THICKNESS, abs=1e-7)
    centre = np.array([0.005, -0.0475, 0.0])
    assert gaps[:, 1] == pytest.approx(np.linalg.norm(x - centre, axis=1) - 0.06 - THICKNESS, abs=1e-7)
    assert normals[0, 1] == pytest.approx((x[0] - centre) / np.linalg.norm(x[0] - centre), abs=1e-6)
    end = np.array([0.1, 0.0, 0.06])  # the second point lies beyond the capsule's end, which stands still
    assert gaps[1, 2] == pytest.approx(np.linalg.norm(x[1] - end) - 0.02 - THICKNESS, abs=1e-7)
    carried = obstacles.carried(x)
    assert carried[0] == pytest.approx(np.array([[0, 0, 0], [0.005, 0.0025, 0], [0, 0.0025, 0]]), abs=2e-4)
    assert carried[1, 2] == pytest.approx(np.zeros(3), abs=1e-7)


def slid(name: str, excess: float, seconds: float, substep: float | None = 1 / 240) -> tuple[np.ndarray, float]:
    """Way down a slope of atan(0.4) + ``excess`` degrees [m], and the way of a block by Coulomb's law."""
    angle = np.arctan(0.4) + np.radians(excess)
    rotation = turn((0.0, 0.0, 1.0), np.degrees(angle))
    vertices, faces = grid(3, 2, 0.05)
    start = (vertices[:, [1, 2, 0]] + [-0.1, THICKNESS, -0.1]) @ rotation.T
    fabric = Fabric(friction=0.4, thickness=THICKNESS, air_drag=0.0, stretch_warp=100.0, stretch_weft=100.0, shear=40.0)
    model = free_model(cloth(start, faces, tuple(rotation[:, 0])), fabric)
    solver, state = integrated(name, model, Options(substep=substep)), State.at_rest(model)
    colliders = Colliders([Plane((0.0, 0.0, 0.0), tuple(rotation[:, 1]))])
    for _ in range(round(60 * seconds)):
        solver.step(state, colliders, 1 / 60)
    moved = state.world() - start
    assert np.abs(moved @ rotation[:, 1]).max() < 1e-7  # it stays on the slope
    law = 0.5 * 9.81 * seconds**2 * (np.sin(angle) - 0.4 * np.cos(angle))
    return -moved @ rotation[:, 0], law


@pytest.mark.parametrize("name", ["verlet", "midpoint", "implicit-euler", "bdf2"])
def test_it_slips_above_the_angle_of_friction_and_holds_below(name: str) -> None:
    """A fifth of a degree either way. Implicit Euler slides g h t/2 too far, as it falls."""
    substep = None if name == "verlet" else 1 / 240
    assert np.abs(slid(name, -0.2, 0.25, substep)[0]).max() < 1e-8
    way, law = slid(name, 0.2, 0.25, substep)
    share = 1.0 + (1 / 240 / 0.25 if name == "implicit-euler" else 0.0)
    assert way == pytest.approx(np.full(len(way), share * law), rel=5e-3)


@pytest.mark.proof
@pytest.mark.parametrize("name", ["implicit-euler", "bdf2"])
def test_nothing_creeps_in_a_minute(name: str) -> None:
    assert np.abs(slid(name, -1.0, 60.0, 1 / 60)[0]).max() < 1e-8


def over_a_cylinder(edges: int, friction: float) -> float:
    """Tension ratio over half a turn of a strip that is drawn across a cylinder, in equilibrium."""
    radius, straight = 0.1, 0.1
    length = np.pi * radius + 2 * straight
    vertices, faces = grid(edges, 1, length / edges)
    s = vertices[:, 0]
    angle = (s - straight) / radius
    inside = np.clip(angle, 0.0, np.pi)
    beyond = np.maximum(straight - s, 0.0) + np.maximum(s - straight - np.pi * radius, 0.0)
    wound = np.stack([-radius * np.cos(inside), radius * np.sin(inside) - beyond, vertices[:, 1]], axis=1)
    stiff = {"stretch_warp": 500.0, "stretch_weft": 500.0, "poisson": 0.0, "bend_warp": 1e-7, "bend_weft": 1e-7}
    fabric = Fabric(friction=friction, thickness=1e-3, **stiff)
    held = np.flatnonzero((s < 1e-9) | (s > length - 1e-9))
    model = free_model(ClothMesh.from_pattern(wound, faces, vertices[faces][:, :, :2]), fabric, held)
    solver = make_solver("fem-stvk/quasi-static", model, Options(gravity=(0.0, 0.0, 0.0)))
    assert isinstance(solver, ClothSolver)
    state, right = State.at_rest(model), wound[held, 0] > 0
    cylinder = Colliders([Capsule((0.0, 0.0, -1.0), (0.0, 0.0, 1.0), radius - 1e-3)])
    for k in range(1, 13):
        targets = wound[held].copy()
        targets[:, 1] -= 0.01 * min(1.0, k / 3)
        targets[:, 1] += np.where(right, -0.003, 0.0028) * k
        solver.step(state, cylinder, 1 / 60, targets=targets)
    pull = -solver.energy.gradient(solver.position)[held, 1]
    return float(pull[right].sum() / pull[~right].sum())


def test_capstan() -> None:
    """exp(mu phi); a polygon of 24 edges stands 0.4 % from it."""
    assert over_a_cylinder(24, 0.3) == pytest.approx(np.exp(0.3 * np.pi), rel=5e-3)


FALLING = ["bdf2", "verlet", "projective-dynamics", "vertex-block-descent", "xpbd", "strain-based"]


OBSTACLES = {
    "sphere": lambda y: Sphere((0.1, y - 0.1, 0.1), 0.1),
    "plane": lambda y: Plane((0.0, y, 0.0)),
    "capsule": lambda y: Capsule((0, y, 0), (0.2, y, 0.2), 0.02),
}
# All in the proofs; here each solver and each obstacle at least once.
FALLS = [(name, list(OBSTACLES)[k % 3]) for k, name in enumerate(FALLING)]


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        pytest.param(name, kind, marks=() if (name, kind) in FALLS else pytest.mark.proof)
        for name in FALLING
        for kind in OBSTACLES
    ],
)
def test_a_sheet_falls_on_obstacles_and_a_lift_carries_it(name: str, kind: str) -> None:
    obstacle = OBSTACLES[kind]
    vertices, faces = grid(4, 4, 0.05)
    fabric = Fabric(stretch_warp=60.0, stretch_weft=60.0, shear=25.0, thickness=THICKNESS, air_drag=0.0)
    model = free_model(cloth(vertices[:, [1, 2, 0]], faces), fabric)
    state = State.at_rest(model, model.mesh.vertices + [0.0, 0.025, 0.0])
    solver = integrated(name, model) if name in INTEGRATORS else make_solver(name, model)
    colliders = Colliders([obstacle(0.0)])
    for frame in range(15):
        colliders.primitives[:] = [obstacle(0.1 * frame / 60)]
        solver.step(state, colliders, 1 / 60)
    gaps, _ = Obstacles(Obstacles.of_frame(colliders, np.zeros(3)), 0.0, 1.0, THICKNESS).gaps(state.world())
    assert gaps.min() > -1e-4 and gaps.min() < 2e-3  # outside, and there
    assert state.world()[:, 1].max() < 0.06


def test_a_cushion_s_force_and_stiffness_are_derivatives_of_its_energy() -> None:
    """Within van Wyk's law, at its end and beyond."""
    cushion = Cushion(2000.0, 0.003, np.full((1, 1), 1e-4))
    depth = np.array([[1e-5, 5e-4, 1.5e-3, 2.7e-3, 2.84e-3, 2.86e-3, 4e-3]])
    step = 1e-9
    slope = (cushion.energy(depth + step) - cushion.energy(depth - step)) / (2.0 * step)
    assert slope == pytest.approx(cushion.force(depth), rel=1e-5)
    rate = (cushion.force(depth + step) - cushion.force(depth - step)) / (2.0 * step)
    assert rate == pytest.approx(cushion.stiffness(depth), rel=1e-5)
    assert cushion.force(np.full((1, 1), -1e-4)) == 0.0
    assert cushion.depth(cushion.force(depth[:, :4])) == pytest.approx(depth[:, :4])


def test_forces_of_cloth_that_gives_are_derivatives() -> None:
    contact, x = forces()
    contact.cushion = Cushion(2000.0, THICKNESS, np.full((len(x), 1), 1e-4))
    contact.floor[:] = 0.0
    rng = np.random.default_rng(3)
    way, step = rng.normal(size=x.shape), 1e-7
    slope = (contact.energy(x + step * way) - contact.energy(x - step * way)) / (2.0 * step)
    assert slope == pytest.approx((contact.gradient(x) * way).sum(), rel=1e-5)
    flat = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]])
    contact.obstacles, contact.floor = Obstacles(flat, 0.0, 1.0, THICKNESS), contact.floor[:, :1]
    contact.memory, contact.carried = (np.zeros((30, 1)), np.zeros((30, 1, 3))), np.zeros((30, 1, 3))
    contact.normals = np.broadcast_to([0.0, 0.0, 1.0], (30, 1, 3))
    x[:, 2] = rng.uniform(0.0005, 0.004, 30)
    rate = (contact.gradient(x + step * way) - contact.gradient(x - step * way)) / (2.0 * step)
    assert contact.hessian(x) @ way.ravel() == pytest.approx(rate.ravel(), rel=1e-3, abs=1e-3 * np.abs(rate).max())


def on_a_floor(degrees: float, speed: float, frames: int) -> tuple[np.ndarray, float]:
    """A sheet on a floor, tilted, at the surface with a speed into it: places in the floor's axes [m], by substep.

    Returns:
        shape (frames, n, 3), about the start; the substep [s].
    """
    rotation = turn((0.0, 0.0, 1.0), degrees)
    vertices, faces = grid(3, 3, 0.05)
    start = (vertices[:, [1, 2, 0]] + [-0.1, THICKNESS, -0.1]) @ rotation.T
    fabric = Fabric(friction=0.5, thickness=THICKNESS, air_drag=0.0, stretch_warp=100.0, stretch_weft=100.0, shear=40.0)
    model = free_model(cloth(start, faces, tuple(rotation[:, 0])), fabric)
    solver, state = make_solver("springs-triangle/symplectic-euler", model), State.at_rest(model)
    assert isinstance(solver, ClothSolver)
    state.velocity[:] = -speed * rotation[:, 1]
    colliders, places = Colliders([Plane((0.0, 0.0, 0.0), tuple(rotation[:, 1]))]), []
    for _ in range(frames):
        solver.step(state, colliders, solver.substep)
        places.append((solver.position - start) @ rotation)
    return np.array(places), solver.substep


def test_contact_by_position_carries_does_not_creep_and_lets_nothing_dive_in() -> None:
    places, h = on_a_floor(0.0, 0.0, 400)
    assert np.abs(places[-1, :, 1]).max() < 1e-2 * 9.81 * h**2  # at its thickness
    assert np.abs(on_a_floor(10.0, 0.0, 800)[0][-1, :, 0]).max() < 1e-9  # mu 0.5 holds up to 26.6 degrees
    assert on_a_floor(0.0, 5.0, 60)[0][:, :, 1].min() > -1e-9
