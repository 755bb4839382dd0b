from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from assets.character import Character
from assets.io.sequence import Sequence
from pbd import ClothMesh, Fabric, ModelOptions, Plane, SolverOptions
from precompute.learning import run_recording as recording
from precompute.learning.run_recording import Recording, record_runs
from runtime.play.simulation import Simulation, body_source
from tests.data import ROOT
from tests.precompute.learning.runs import CHUNK, FRAMES, skirt_run
from tests.wrinkles.meshes import flat_sheet, icosphere
from wrinkles.levels import build_levels

ARRAYS = ("frames", "positions", "coarse", "contact", "nearest")


@pytest.fixture(autouse=True)
def short_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recording, "CHUNK_SECONDS", CHUNK / 60)


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Times of the steps that were simulated in this process."""
    seen: list[float] = []
    step = Simulation.step_cloth

    def counted(self: Simulation, dt: float, *rest) -> None:
        seen.append(dt)
        step(self, dt, *rest)

    monkeypatch.setattr(Simulation, "step_cloth", counted)
    return seen


def assert_same(first: Recording, second: Recording) -> None:
    for name in ARRAYS:
        a, b = getattr(first, name), getattr(second, name)
        assert a.dtype == b.dtype and np.array_equal(a, b), name


def test_a_run_ends_where_its_cloth_has_come_apart(
    tmp_path: Path, steps: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[np.ndarray] = []

    def share(mesh: ClothMesh, vertices: np.ndarray) -> float:
        seen.append(vertices)
        return 6.0 if len(seen) > 1 else 0.0

    monkeypatch.setattr(recording, "crossed_share", share)
    run = replace(skirt_run(), while_whole=True)
    assert run.key() != skirt_run().key()
    (ended,) = record_runs([run], tmp_path, workers=1)
    assert len(steps) == 2 * CHUNK and ended.frames.tolist() == list(range(2, 2 * CHUNK + 1, 2))
    assert np.isfinite(ended.step_ms) and ended.frames.dtype == int
    (again,) = record_runs([run], tmp_path, workers=1)
    assert len(steps) == 2 * CHUNK
    assert_same(ended, again)
    (whole,) = record_runs([skirt_run()], tmp_path, workers=1)
    assert_same(ended, whole.where(whole.frames <= 2 * CHUNK))


def test_a_run_is_recorded_every_other_frame(tmp_path: Path) -> None:
    run = skirt_run()
    (recorded,) = record_runs([run], tmp_path, workers=1)
    count = len(run.levels.coarse.vertices)
    assert recorded.name == "walk" and recorded.frames.tolist() == list(range(2, FRAMES + 1, 2))
    assert recorded.positions.shape == (20, count, 3)
    assert recorded.contact.shape == recorded.nearest.shape == (20, count)
    assert np.array_equal(recorded.coarse, recorded.positions) and recorded.step_ms > 0.0
    # In the world: held vertices ride on the body, and all of it was carried 2 m off.
    held = run.levels.coarse_held
    skinned = np.zeros(run.body.vertices.shape, np.float32)
    body_source(run.body).skin(run.poses[FRAMES], np.zeros(3), skinned)
    np.testing.assert_allclose(recorded.positions[-1, held], run.levels.coarse_attachment.targets(skinned), atol=1e-5)
    assert recorded.positions[-1, :, 2].mean() - recorded.positions[0, :, 2].mean() > 1.5
    later = recorded.where(recorded.frames > 30)
    assert later.frames.tolist() == [32, 34, 36, 38, 40] and len(later.positions) == len(later.nearest) == 5


def test_nothing_is_put_back_on_the_body_in_a_run() -> None:
    """A hand that pinches a hem for long stretches a few edges: to put all of it back tangles what was whole."""
    simulation = skirt_run().simulation()
    assert simulation.redressing is None
    for pose in skirt_run().poses[1:3]:
        simulation.step(pose)
    assert np.isfinite(simulation.state.position).all()


def test_a_fine_run_is_filtered_down(tmp_path: Path) -> None:
    run = skirt_run(fine=True)
    run = replace(run, poses=run.poses[:11])
    (recorded,) = record_runs([run], tmp_path, workers=1)
    levels = run.levels
    assert recorded.positions.shape == (5, levels.subdivision.fine_count, 3)
    assert recorded.coarse.shape == (5, levels.subdivision.coarse_count, 3)
    assert recorded.contact.shape[1] == recorded.nearest.shape[1] == levels.subdivision.coarse_count
    np.testing.assert_allclose(recorded.coarse, levels.filter_down(recorded.positions), atol=1e-6)


def test_what_is_recorded_is_not_simulated_again(tmp_path: Path, steps: list[float]) -> None:
    run, told = skirt_run(), []
    (first,) = record_runs([run], tmp_path, workers=1, report=told.append)
    assert len(steps) == FRAMES and told[-1].startswith(f"simulating: {FRAMES} of {FRAMES} frames")
    (again,) = record_runs([replace(run, name="another name")], tmp_path, workers=2)
    assert len(steps) == FRAMES and again.name == "another name"
    assert_same(first, again)


def test_the_last_chunk_may_be_short(tmp_path: Path, steps: list[float]) -> None:
    run = skirt_run()
    cut = replace(run, poses=run.poses[:14])
    (whole,) = record_runs([run], tmp_path, workers=1)
    (part,) = record_runs([cut], tmp_path, workers=1)
    assert len(steps) == FRAMES + 13 and part.frames.tolist() == [2, 4, 6, 8, 10, 12]
    assert_same(part, whole.where(slice(0, 6)))


KILLED = """
import os, signal, sys
from pathlib import Path
from precompute.learning import run_recording as recording
from runtime.play.simulation import Simulation, body_source
from tests.precompute.learning.runs import CHUNK, skirt_run

recording.CHUNK_SECONDS = CHUNK / 60
step, count = Simulation.step_cloth, 0

def mortal(self, *args):
    global count
    count += 1
    if count == 25:
        os.kill(os.getpid(), signal.SIGKILL)
    step(self, *args)

Simulation.step_cloth = mortal
recording.record_runs([skirt_run(fine=sys.argv[2] == "fine")], Path(sys.argv[1]), workers=1)
"""


@pytest.mark.parametrize("level", ["coarse", "fine"])
def test_a_killed_run_goes_on_with_the_same_bits(tmp_path: Path, steps: list[float], level: str) -> None:
    run = skirt_run(fine=level == "fine")
    killed = subprocess.run(
        [sys.executable, "-c", KILLED, str(tmp_path / "killed"), level], cwd=ROOT, capture_output=True, text=True
    )
    assert killed.returncode == -9, killed.stderr
    (resumed,) = record_runs([run], tmp_path / "killed", workers=1)
    assert len(steps) == FRAMES - 2 * CHUNK  # 24 frames were done, 20 of them kept
    (whole,) = record_runs([run], tmp_path / "whole", workers=1)
    assert_same(resumed, whole)


def test_a_body_of_large_faces_is_the_same_after_a_restart(tmp_path: Path) -> None:
    """A crystal that grows under a sheet: how its faces are found is settled by its size at the start."""
    shape, faces = icosphere(0, 1.0)
    growth = np.linspace(0.05, 0.15, FRAMES + 1)[:, None, None]
    crystal = (shape * growth + [0.3, -0.05, 0.3]).astype(np.float32)
    body = Sequence("crystal", crystal, faces, 1 / 60)
    levels = build_levels(
        *flat_sheet(13, 0.6), np.array([], int), crystal[0].astype(float), faces, 1, warp=(1.0, 0.0, 0.0)
    )
    run = replace(skirt_run(), levels=levels, body=body, poses=crystal.astype(float))
    (whole,) = record_runs([run], tmp_path, workers=1)
    for late in (1, 2, 3):
        (tmp_path / run.key() / f"chunk_{late:04d}.npz").unlink()
    (resumed,) = record_runs([run], tmp_path, workers=1)
    assert (whole.contact[-1] < 0.03).any()
    assert_same(resumed, whole)


def test_a_file_that_was_being_written_is_not_taken_for_a_chunk(tmp_path: Path, steps: list[float]) -> None:
    run = skirt_run()
    run = replace(run, poses=run.poses[:11])
    folder = tmp_path / run.key()
    folder.mkdir()
    (folder / ".chunk_0000.npz.4711.part").write_bytes(b"half a chunk")
    (recorded,) = record_runs([run], tmp_path, workers=1)
    assert len(steps) == 10 and len(recorded.frames) == 5


@pytest.mark.proof
def test_runs_in_two_processes_give_the_same_bits(tmp_path: Path) -> None:
    run = skirt_run()
    run = replace(run, poses=run.poses[:11])
    runs = [run, replace(run, name="stiff", fabric=Fabric(bend_warp=1e-4, bend_weft=1e-4))]
    together = record_runs(runs, tmp_path / "together", workers=2)
    for parallel, serial in zip(together, record_runs(runs, tmp_path / "serial", workers=1), strict=True):
        assert_same(parallel, serial)
    assert not np.array_equal(together[0].positions, together[1].positions)


def test_the_key_tells_what_the_result_depends_on() -> None:
    run = skirt_run()
    poses = run.poses.copy()
    poses[-1, 3, 0, 3] += 1e-12
    levels, body = run.levels, run.body
    assert isinstance(body, Character)
    weights = body.joint_weights.copy()
    weights[5] = weights[5][::-1]
    others = [
        replace(run, fabric=Fabric(areal_density=0.2)),
        replace(run, poses=poses),
        replace(run, poses=run.poses[:-1]),
        replace(run, options=ModelOptions(pressure=2.0)),
        replace(run, solver=SolverOptions(substep=1 / 240, gravity=(0.0, -9.0, 0.0))),
        replace(run, fine=True),
        replace(run, dt=1 / 50),
        replace(run, every=1),
        replace(run, bend_factor=None),
        replace(run, wind=(0.0, 0.0, 1.0)),
        replace(run, primitives=(Plane((0.0, 0.0, 0.0)),)),
        replace(run, primitives=(Plane((0.0, 0.1, 0.0)),)),
        replace(run, levels=replace(levels, coarse_held=levels.coarse_held[1:])),
        replace(run, levels=replace(levels, coarse=replace(levels.coarse, flat=1.001 * levels.coarse.flat))),
        replace(run, body=replace(body, joint_weights=weights)),
    ]
    keys = [run.key(), *(other.key() for other in others)]
    assert len(set(keys)) == len(keys)
    assert replace(run, name="other").key() == skirt_run().key() == run.key()


def test_chunks_of_another_length_are_not_mixed_and_change_no_bit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = skirt_run(fine=True)
    run = replace(run, poses=run.poses[: 2 * CHUNK + 1])
    (short,) = record_runs([run], tmp_path, workers=1)
    monkeypatch.setattr(recording, "CHUNK_SECONDS", 2 * CHUNK / 60)
    (long,) = record_runs([run], tmp_path, workers=1)
    assert_same(short, long)
    assert sorted(len(list(folder.iterdir())) for folder in tmp_path.iterdir()) == [1, 2]


def test_a_change_of_the_solver_makes_old_runs_worthless(monkeypatch: pytest.MonkeyPatch) -> None:
    run = skirt_run()
    before = run.key()
    monkeypatch.setattr(recording, "_solver_version", lambda: "another")
    assert run.key() != before
