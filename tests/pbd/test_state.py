"""States: files, hashes, origins; models' options; what a solver refuses to step."""

import math
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pbd import Colliders, Fabric, ModelOptions, Solver, SolverOptions, Sphere, State, build_model
from tests.pbd.meshes import body_of, cloth, free_model, grid, icosphere, run
from tests.refusals import refuses

RUBBING = Fabric(bend_hysteresis_warp=1e-3, bend_hysteresis_weft=5e-4, shear_hysteresis=1.0)
MODEL = free_model(cloth(*grid(6, 6, 0.05)), RUBBING, held=np.array([0, 6]))


def moved_state() -> State:
    state = State.at_rest(MODEL)
    run(MODEL, state, 20, colliders=Colliders([Sphere((0.15, -0.2, 0.02), 0.1)]))
    return state


def test_a_state_comes_back_bit_by_bit(tmp_path: Path) -> None:
    state, path = moved_state(), str(tmp_path / "state.npz")
    state.save(path)
    back = State.load(path)
    assert back.hash() == state.hash() == state.copy().hash()
    assert all(np.array_equal(getattr(back, name), getattr(state, name)) for name in State._names)
    run(MODEL, state, 3)
    run(MODEL, back, 3)
    assert back.hash() == state.hash()
    assert list(tmp_path.iterdir()) == [Path(path)]


@pytest.mark.parametrize("name", [name for name in State._names if not name.startswith("pair")])  # there are none here
def test_the_hash_sees_every_array(name: str) -> None:
    state = moved_state()
    before = state.hash()
    array = getattr(state, name)
    last = array.flat[-1]
    array.flat[-1] += 1
    assert state.hash() != before
    array.flat[-1] = last
    assert state.hash() == before


def test_a_copy_is_its_own() -> None:
    state = moved_state()
    before, other = state.hash(), state.copy()
    run(MODEL, other, 1)
    assert state.hash() == before != other.hash()


def wrong_files(folder: Path) -> list[Path]:
    state = moved_state()
    state.save(str(folder / "whole.npz"))
    whole = (folder / "whole.npz").read_bytes()
    arrays = {name: getattr(state, name) for name in State._names}
    (folder / "text.npz").write_text("not a state")
    (folder / "empty.npz").write_bytes(b"")
    (folder / "half.npz").write_bytes(whole[: len(whole) // 2])
    damaged = bytearray(whole)
    damaged[whole.index(state.velocity.tobytes())] ^= 255
    (folder / "damaged.npz").write_bytes(damaged)
    np.save(folder / "array.npy", state.position)
    np.savez(folder / "others.npz", a=state.position)
    np.savez(folder / "double.npz", **{**arrays, "position": state.position.astype(float)})
    np.savez(folder / "short.npz", **{**arrays, "velocity": state.velocity[:-1]})
    np.savez(folder / "pickled.npz", **{**arrays, "velocity": np.array([{}], object)})
    with zipfile.ZipFile(folder / "archive.npz", "w") as archive:
        archive.writestr("position.npy", b"nonsense")
    (folder / "folder.npz").mkdir()
    return [path for path in folder.iterdir() if path.name != "whole.npz"] + [folder / "missing.npz"]


def test_what_is_no_state_is_refused_with_its_name(tmp_path: Path) -> None:
    paths = wrong_files(tmp_path)
    assert len(paths) == 12
    for path in paths:
        refuses(path.name, State.load, str(path))


def test_another_origin_leaves_the_world_where_it_is() -> None:
    state = moved_state()
    before = state.world()
    for origin in ([3.0, -7.0, 2.0], [0.0, 0.0, 0.0], [-1.0, 5.0, 0.0]):
        state.move_origin(np.array(origin))
        assert np.array_equal(state.origin, origin)
        assert np.abs(state.world() - before).max() < 1e-6


def test_the_origin_follows_the_garment_and_takes_the_body_along() -> None:
    state = moved_state()
    sphere, faces = icosphere(2, 0.1)
    body = body_of(sphere + [0.3, -0.2, 0.0], faces, state)
    colliders = Colliders((), body)
    state.position[:, 0] += 5.3
    cloth_before, body_before = state.world(), body.current + body.origin
    Solver(MODEL).follow(state, colliders)
    assert np.abs(state.position[:, :3]).max() < 1.0
    assert np.array_equal(body.origin, state.origin)
    assert np.array_equal(state.origin, np.round(state.origin))
    assert np.abs(state.world() - cloth_before).max() < 1e-6
    assert np.abs(body.current + body.origin - body_before).max() < 1e-6
    # At rest about an origin it stays: no flicker between two grid points.
    origin = state.origin.copy()
    for shift in (0.4, -0.4):
        state.position[:, 0] += shift
        Solver(MODEL).follow(state, colliders)
        assert np.array_equal(state.origin, origin)


@pytest.mark.parametrize("bad", [np.zeros((3, 3)), np.full((49, 3), np.nan), np.zeros((49, 2))])
def test_bad_start_positions_are_refused(bad: np.ndarray) -> None:
    refuses("start positions", State.at_rest, MODEL, bad)


@pytest.mark.parametrize("dt", [-1e-9, math.nan, math.inf, -math.inf])
def test_a_bad_time_step_is_refused(dt: float) -> None:
    state = moved_state()
    before = state.hash()
    refuses("dt", Solver(MODEL).step, state, Colliders(), dt)
    assert state.hash() == before


def test_no_time_changes_nothing() -> None:
    state = moved_state()
    before = state.hash()
    solver = Solver(MODEL)
    solver.step(state, Colliders([Sphere((0.15, -0.2, 0.02), 0.2)]), 0.0, targets=np.ones((2, 3)))
    assert state.hash() == before


def test_one_solver_may_step_several_garments_whose_bodies_change() -> None:
    """The first garment loses its body after two frames, the second gets one; each has a solver of its own as well."""
    sphere, faces = icosphere(2, 0.1)
    shared, ends = Solver(MODEL), []
    for solvers in ((shared, shared), (Solver(MODEL), Solver(MODEL))):
        states = [State.at_rest(MODEL) for _ in solvers]
        bodies = [body_of(sphere + [0.15, -0.05, 0.05 * k], faces, state) for k, state in enumerate(states)]
        for frame in range(4):
            for k, (solver, state) in enumerate(zip(solvers, states, strict=True)):
                colliders = Colliders(body=bodies[k] if (frame < 2) == (k == 0) else None)
                solver.step(state, colliders, 1 / 60, wind=(0.0, 0.5 * frame * k, 2.0 * k))
        assert all(state.velocity.any() for state in states)
        ends.append([state.hash() for state in states])
    assert ends[0] == ends[1] and ends[0][0] != ends[0][1]


def test_what_the_kernels_could_not_take_is_refused() -> None:
    solver, colliders = Solver(MODEL), Colliders()
    other = State.at_rest(free_model(cloth(*grid(3, 3, 0.05)), Fabric()))
    refuses("another model", solver.step, other, colliders, 0.01)
    for name in ("position", "velocity"):
        state = moved_state()
        getattr(state, name)[3, 1] = np.nan
        refuses("not finite", solver.step, state, colliders, 0.01)
    state = moved_state()
    for targets in (np.zeros((3, 3)), np.zeros(3), np.full((2, 3), np.nan)):
        refuses("targets", solver.step, state, colliders, 0.01, targets)
    for wind in (np.array([0.0, np.inf, 0.0]), np.ones(2)):
        refuses("wind", solver.step, state, colliders, 0.01, wind=wind)
    sphere, faces = icosphere(1, 0.1)
    body = body_of(sphere, faces, state)
    body.origin = body.origin + 1.0
    refuses("origins", solver.step, state, Colliders((), body), 0.01)


@pytest.mark.parametrize(
    "options",
    [{"substep": 0.0}, {"substep": math.nan}, {"gravity": (0.0, 1.0)}, {"gravity": (0.0, math.nan, 0.0)}]
    + [{"contact_refreshes": value} for value in (0.0, -1.0, math.nan)]
    + [{"local_damping": -1.0}, {"linear_inertia": 1.1}, {"angular_inertia": math.nan}, {"coarse_sweeps": -1}],
)
def test_bad_solver_options_are_refused(options: dict) -> None:
    refuses(next(iter(options)), SolverOptions, **options)


@pytest.mark.parametrize(
    "options",
    [{"compression_compliance_scale": 0.5}, {"tether_slack": math.nan}, {"pressure": math.inf}, {"pressure": math.nan}],
)
def test_bad_model_options_are_refused(options: dict) -> None:
    refuses(next(iter(options)), ModelOptions, **options)


def test_tethers_follow_the_cloth_to_the_nearest_held_vertex() -> None:
    vertices, faces = grid(10, 4, 0.1)
    folded = vertices.copy()
    folded[:, 0] = np.abs(folded[:, 0] - 0.5)  # both ends lie on one another in space, not along the cloth
    mesh = replace(cloth(vertices, faces), vertices=folded)
    held = np.flatnonzero(vertices[:, 0] < 1e-9)
    model = build_model(mesh, Fabric(), held, options=ModelOptions(tether_slack=1.1), bend_factor=1 / 3)
    pairs = zip(model.tethers, model.tether_lengths, strict=True)
    tethers = {int(vertex): (int(to), length) for (vertex, to), length in pairs}
    assert len(tethers) == len(vertices) - len(held) and set(held) >= {to for to, _ in tethers.values()}
    far = int(np.argmax(vertices[:, 0]))
    assert tethers[far][1] == pytest.approx(1.1 * 1.0, rel=1e-5)
    assert (
        len(build_model(mesh, Fabric(), held, options=ModelOptions(tether_slack=0.0), bend_factor=1 / 3).tethers) == 0
    )
    assert model.mass.sum() == pytest.approx(Fabric().areal_density * 0.4)
