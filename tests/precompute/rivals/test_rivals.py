"""Other engines, dressed: the search for settings, their process, and each that is installed on a falling cloth."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from pbd import ClothMesh, Fabric
from pbd.mesh import lattice_faces
from precompute.experiment.sheets import lattice
from precompute.rivals import engines, worker
from precompute.rivals.dressing import Dressing
from precompute.rivals.engines import (
    RIVALS,
    TRIES,
    Rival,
    Tried,
    for_quality,
    for_speed,
    play_rival,
    search_settings,
)

SIDE = 12


@pytest.fixture
def dressing() -> Dressing:
    """A square of cloth of 0.5 m that lies 1 cm above a box, which rises by 0.4 m/s; one corner goes with it."""
    index, across, along = lattice(SIDE, SIDE)
    step = 0.5 / (SIDE - 1)
    vertices = np.stack([step * across - 0.25, np.full(across.shape, 0.01), step * along - 0.25], axis=1)
    mesh = ClothMesh.from_surface(vertices, lattice_faces(index, alternating=False))
    corners = np.array([[x, y, z] for x in (-0.2, 0.2) for y in (-0.3, 0.0) for z in (-0.2, 0.2)])
    faces = np.array(
        [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
         [1, 5, 7], [1, 7, 3]]
    )  # fmt: skip
    lift = np.linspace(0.0, 0.2, 31)[:, None, None] * np.array([0.0, 1.0, 0.0])
    held = np.array([0])
    return Dressing(
        mesh.faces, mesh.flat, *mesh.edge_lengths(), np.full(len(vertices), 0.15 * 0.25 / len(vertices)), vertices,
        vertices, held, vertices[held] + lift, np.zeros((0, 3), np.int32), np.zeros(0), faces,
        (corners + lift).astype(np.float32), asdict(Fabric()), 1.0 / 60.0, False,
    )  # fmt: skip


def test_a_dressing_survives_its_file(dressing: Dressing, tmp_path: Path) -> None:
    path = tmp_path / "dressing.npz"
    dressing.write(path)
    found = Dressing.read(path)
    for name, value in vars(dressing).items():
        assert np.array_equal(getattr(found, name), value), name
    assert found.frame_count == 30 and found.edge == pytest.approx(dressing.lengths.mean())


def test_a_run_that_takes_too_long_is_given_up(
    dressing: Dressing, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dressing.write(tmp_path / "dressing.npz")
    monkeypatch.setattr(engines, "START_S", 0.0)
    monkeypatch.setattr(engines, "FRAME_S", 1e-3)
    run = play_rival("blender", {}, tmp_path / "dressing.npz", [1], 30, tmp_path / "run")
    assert run.ended == "given up: not played after 0 s" and not len(run.frames)


def rival(ladders: Mapping[str, tuple[float, ...]], **first: float) -> Rival:
    return Rival("name", "module", "package", first, ladders)


def measured(error: Callable[..., float]) -> Callable[[Mapping[str, float]], Tried]:
    return lambda settings: Tried(settings, sum(settings.values()), error(**settings), "")


def test_the_search_climbs_to_the_lowest_error_and_tries_nothing_twice() -> None:
    ladders = {"a": (1, 2, 3, 4), "b": (10, 20, 30)}
    tried = search_settings(rival(ladders, a=1, b=10), measured(lambda a, b: abs(a - 3) + abs(b - 20)))
    best = for_quality(tried)
    assert best is not None and best.settings == {"a": 3, "b": 20} and best.error == 0.0
    assert len({tuple(one.settings.items()) for one in tried}) == len(tried) <= TRIES


def test_the_search_ends_after_so_many_tries() -> None:
    ladder = tuple(float(one) for one in range(100))
    assert len(search_settings(rival({"a": ladder}, a=0.0), measured(lambda a: -a))) == TRIES


def test_the_setting_for_speed_is_the_cheapest_that_is_nearly_as_good() -> None:
    tried = [Tried({"a": k}, ms, error, "") for k, (ms, error) in enumerate([(9.0, 1.0), (5.0, 1.29), (1.0, 1.31)])]
    fast = for_speed([*tried, Tried({"a": 9}, 0.1, math.inf, "burst after 0.10 s")])
    assert fast is not None and fast.settings == {"a": 1}
    assert for_speed([]) is None and for_quality([Tried({}, 1.0, math.inf, "burst")]) is None


def play(tmp_path: Path, dressing: Dressing, monkeypatch: pytest.MonkeyPatch, steps: list[np.ndarray]) -> dict:
    """What the worker writes about an engine that gives these vertices."""
    path, out = tmp_path / "dressing.npz", tmp_path / "out.npz"
    dressing.write(path)
    job = {"dressing": str(path), "engine": "x", "settings": {}, "frames": len(steps), "keep": [2, 4], "out": str(out)}
    (tmp_path / "job.json").write_text(json.dumps(job), encoding="utf-8")
    left = list(steps)
    monkeypatch.setattr(worker, "_start", lambda *arguments: (lambda frame: None, lambda: left.pop(0)))
    worker.main(tmp_path / "job.json")
    with np.load(out) as file:
        return dict(file)


def test_the_worker_keeps_the_frames_that_are_asked_for(
    tmp_path: Path, dressing: Dressing, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = play(tmp_path, dressing, monkeypatch, [dressing.start + 0.01 * k for k in range(1, 6)])
    assert np.allclose(found["frames"], [dressing.start + 0.02, dressing.start + 0.04], atol=1e-6)
    assert len(found["times"]) == 5 and not str(found["ended"])


@pytest.mark.parametrize("bad", [math.nan, 1e4])
def test_the_worker_stops_where_cloth_bursts(
    tmp_path: Path, dressing: Dressing, monkeypatch: pytest.MonkeyPatch, bad: float
) -> None:
    found = play(tmp_path, dressing, monkeypatch, [dressing.start, dressing.start, dressing.start + bad])
    assert str(found["ended"]) == "burst after 0.05 s" and len(found["frames"]) == 1


def test_the_worker_gives_up_what_is_slow(tmp_path: Path, dressing: Dressing, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worker, "SLOW_MS", -1.0)
    found = play(tmp_path, dressing, monkeypatch, [dressing.start] * 20)
    assert str(found["ended"]).startswith("given up: ") and len(found["times"]) == worker.SLOW_FRAMES


def test_a_process_that_fails_is_named(tmp_path: Path, dressing: Dressing) -> None:
    dressing.write(tmp_path / "dressing.npz")
    run = play_rival("style3d", {"no_such": 1}, tmp_path / "dressing.npz", [1], 1, tmp_path / "job")
    assert run.ended.startswith("ended with status 1: ") and not len(run.frames)


@pytest.mark.proof
@pytest.mark.parametrize("name", RIVALS)
def test_a_rival_rests_on_a_body_that_rises_and_holds_what_is_attached(
    name: str, tmp_path: Path, dressing: Dressing
) -> None:
    if RIVALS[name].missing:
        pytest.skip(RIVALS[name].missing)
    dressing.write(tmp_path / "dressing.npz")
    run = play_rival(name, RIVALS[name].first, tmp_path / "dressing.npz", [30], 30, tmp_path / "job")
    assert not run.ended and run.frame_ms > 0.0
    (last,) = run.frames
    over = (abs(dressing.start[:, [0, 2]]) < 0.15).all(axis=1)  # no border hangs over the edges of the box there
    top = dressing.body[-1, :, 1].max()  # further up than an engine looks around where the body was at first
    assert top - 0.01 < last[over, 1].min() and last[over, 1].max() < top + 0.03
    assert np.abs(last[0] - dressing.targets[-1, 0]).max() < 0.02


# Of each engine whose stiffness has units, settings with which it is near its own solution.
CONVERGED = {
    "style3d": {"substeps": 2, "iterations": 8, "linear_iterations": 50},
    "vbd": {"substeps": 8, "iterations": 20},
    "xpbd": {"substeps": 160, "stretch": 1.0},
    "mujoco": {"substeps": 8},
}


def hung(
    name: str, folder: Path, box: Dressing, mesh: ClothMesh, held: np.ndarray, mass: np.ndarray, fabric: Fabric
) -> np.ndarray:
    """Vertices of a cloth that hangs alone, over two seconds after the first [m], shape (120, n, 3)."""
    if RIVALS[name].missing:
        pytest.skip(RIVALS[name].missing)
    frames = 180
    far = box.body[:1] + np.float32(5.0)
    cloth = replace(
        box, faces=mesh.faces, flat=mesh.flat, edges=mesh.edge_lengths()[0], lengths=mesh.edge_lengths()[1], mass=mass,
        start=mesh.vertices, rest=mesh.vertices, held=held, body=far.repeat(frames + 1, axis=0),
        targets=mesh.vertices[held][None].repeat(frames + 1, axis=0), fabric=asdict(fabric),
    )  # fmt: skip
    cloth.write(folder / "cloth.npz")
    settings = {**RIVALS[name].first, **CONVERGED[name]}
    run = play_rival(name, settings, folder / "cloth.npz", list(range(61, frames + 1)), frames, folder / "job")
    assert not run.ended
    return run.frames


@pytest.mark.proof
@pytest.mark.parametrize("name", CONVERGED)
def test_a_hanging_strip_is_as_long_as_its_fabric_asks(name: str, tmp_path: Path, dressing: Dressing) -> None:
    """Its own weight draws a strip of length L out by g rho L / (2 E h) of its length."""
    rows, step = 11, 0.02
    fabric = replace(Fabric(), stretch_warp=40.0, stretch_weft=40.0, shear=20.0, poisson=0.0)
    index, across, down = lattice(4, rows)
    vertices = np.stack([step * across, 1.0 - step * down, np.zeros(across.shape)], axis=1)
    mesh = ClothMesh.from_surface(vertices, lattice_faces(index, alternating=True))
    mass, last, length = fabric.areal_density * mesh.vertex_areas, down == rows - 1, step * (rows - 1)
    played = hung(name, tmp_path, dressing, mesh, np.flatnonzero(down == 0), mass, fabric)
    drawn = (vertices[last, 1].mean() - played[:, last, 1].mean()) / length
    assert drawn == pytest.approx(9.81 * fabric.areal_density * length / (2.0 * fabric.stretch_warp), rel=0.15)


@pytest.mark.proof
@pytest.mark.parametrize("name", ["style3d", "vbd", "xpbd"])
def test_two_faces_bend_as_their_fabric_asks(name: str, tmp_path: Path, dressing: Dressing) -> None:
    """Equilateral faces of rigidity B have the energy sqrt(3) B angle^2 at their edge; MuJoCo bends in another way."""
    side, asked = 0.02, 0.2
    height = 0.5 * math.sqrt(3.0) * side
    vertices = np.array([[0.0, 0.0, 0.0], [side, 0.0, 0.0], [0.5 * side, 0.0, height], [0.5 * side, 0.0, -height]])
    mesh = ClothMesh.from_surface(vertices, np.array([[0, 2, 1], [0, 1, 3]], np.int32))
    fabric = replace(Fabric(), bend_warp=1e-3, bend_weft=1e-3)
    # The weight's moment at the asked angle, which the free vertex swings about.
    mass = 2.0 * math.sqrt(3.0) * fabric.bend_warp * asked / (9.81 * height * math.cos(asked))
    played = hung(name, tmp_path, dressing, mesh, np.array([0, 1, 3]), np.full(4, mass), fabric)
    assert np.arctan2(-played[:, 2, 1], played[:, 2, 2]).mean() == pytest.approx(asked, rel=0.1)
