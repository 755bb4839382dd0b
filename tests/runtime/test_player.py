"""The player: what it refuses, what it leaves alone, and that its bits hang on nothing but its input."""

from __future__ import annotations

import gc
import hashlib
import os
import subprocess
import sys
import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest

from assets.character import Character
from assets.fabrics import PRESETS
from pbd import InputError, Plane, build_model
from runtime.play.player import Player
from runtime.play.simulation import Simulation, body_source, poses_of
from tests.data import ROOT
from tests.runtime.players import skirt_database, skirt_stage

DT = 1.0 / 60.0


@pytest.fixture(scope="module")
def poses() -> np.ndarray:
    return poses_of(skirt_stage().motion(), DT, 2.0)


@pytest.fixture
def player(poses: np.ndarray) -> Player:
    return Player(skirt_database(), skirt_stage().body, poses[0])


def bits(player: Player) -> str:
    """Everything that a frame leaves behind."""
    digest = hashlib.sha256(player.simulation.state.hash().encode())
    body = player.simulation.body
    for array in (player.vertices, player.normals, body.previous, body.current, body.normals):
        digest.update(array.tobytes())
    return digest.hexdigest()


@pytest.mark.parametrize(
    ("spoil", "key"),
    [
        (lambda p, pose: p.update(np.where(np.arange(pose.size).reshape(pose.shape) == 40, np.nan, pose), DT), "pose"),
        (lambda p, pose: p.update(np.full_like(pose, np.inf), DT), "pose"),
        (lambda p, pose: p.update(pose[1:], DT), "pose"),
        (lambda p, pose: p.update(pose, np.nan), "dt"),
        (lambda p, pose: p.update(pose, -DT), "dt"),
        (lambda p, pose: p.update(pose, DT, (0.0, np.inf, 0.0)), "wind"),
        (lambda p, pose: p.update(pose, DT, (1.0, 0.0)), "wind"),
        (lambda p, pose: p.drag(3, np.array([0.0, np.nan, 0.0])), "target"),
        (lambda p, pose: p.drag(3, np.zeros(2)), "target"),
        (lambda p, pose: p.drag(10**6, np.zeros(3)), "vertex"),
        (lambda p, pose: p.drag(-1, None), "vertex"),
    ],
)
def test_bad_input_is_refused_and_changes_nothing(
    player: Player, poses: np.ndarray, spoil: Callable[[Player, np.ndarray], None], key: str
) -> None:
    player.update(poses[1], DT)
    before = bits(player)
    with pytest.raises(InputError) as caught:
        spoil(player, poses[2])
    assert caught.value.key == key
    assert bits(player) == before


def test_a_bad_first_pose_and_another_body_are_refused(poses: np.ndarray) -> None:
    database, body = skirt_database(), skirt_stage().body
    with pytest.raises(InputError, match="pose"):
        Player(database, body, poses[0] * np.nan)
    with pytest.raises(InputError, match="another character"):
        Player(skirt_database(body_hash="0" * 64), body, poses[0])


def test_it_starts_in_the_bind_pose_unless_told_another() -> None:
    database, body = skirt_database(), skirt_stage().body
    assert isinstance(body, Character)
    assert bits(Player(database, body)) == bits(Player(database, body, body.bind_pose()))


def test_a_garment_is_played_in_any_fabric_that_it_was_learned_in(poses: np.ndarray) -> None:
    database, body = skirt_database(other_fabrics={"denim": PRESETS["denim"]}), skirt_stage().body
    own, plain, other, alone = (
        Player(one, body, poses[0], fabric=fabric)
        for one, fabric in (
            (database, None),
            (skirt_database(), None),
            (database, "denim"),
            (database.in_fabric("denim"), None),
        )
    )
    for pose in poses[1:4]:
        for player in (own, plain, other, alone):
            player.update(pose, DT)
    assert bits(own) == bits(plain) != bits(other) == bits(alone)
    mass = [player.simulation.model.mass.sum() for player in (own, other)]
    assert mass[1] / mass[0] == pytest.approx(PRESETS["denim"].areal_density / database.fabric.areal_density)
    with pytest.raises(InputError, match="fabric: a fabric that was not learned.*'silk'.*muslin, denim"):
        Player(database, body, poses[0], fabric="silk")


def test_warming_up_leaves_no_trace(poses: np.ndarray) -> None:
    """The same garment, stepped by hand from its start."""
    database, stage = skirt_database(), skirt_stage()
    player = Player(database, stage.body, poses[0])
    mesh = player.levels.coarse
    model = build_model(
        mesh, database.fabric, database.held, options=database.options, bend_factor=database.bend_factor
    )
    assert isinstance(stage.body, Character)
    attachment = player.levels.coarse_attachment
    plain = Simulation(model, attachment, body_source(stage.body), poses[0], database.solver)
    assert player.simulation.state.hash() == plain.state.hash()
    for pose in poses[1:6]:
        player.step(pose, DT)
        plain.step(pose, DT)
    assert player.simulation.state.hash() == plain.state.hash()


def test_the_garment_meets_the_colliders_of_the_scene(poses: np.ndarray) -> None:
    height = skirt_stage().levels.coarse.vertices[:, 1]
    floor = float(height.min()) + 0.1
    player = Player(skirt_database(), skirt_stage().body, poses[0], (Plane((0.0, floor, 0.0)),))
    for _ in range(60):
        player.step(poses[0], DT)
    assert player.simulation.state.world()[:, 1].min() > floor - 1e-3


def test_a_frame_allocates_little(poses: np.ndarray) -> None:
    """Less than one more array of fine vertices at any time, and nothing of that size stays."""
    player = Player(skirt_database(subdivisions=2), skirt_stage().body, poses[0])
    for pose in poses[1:6]:
        player.update(pose, DT)
    largest = 0
    tracemalloc.start()
    try:
        for pose in poses[6:16]:
            gc.collect()
            before = tracemalloc.get_traced_memory()[0]
            tracemalloc.reset_peak()
            player.update(pose, DT)
            largest = max(largest, tracemalloc.get_traced_memory()[1] - before)
        gc.collect()
        stays = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert largest < player.vertices.nbytes
    assert stays < player.vertices.nbytes / 2


SCRIPT = """
import hashlib
from pbd.engine import ti
from pbd.taichi_internals import translations
from runtime.play.level_of_detail import LevelOfDetail
from runtime.play.player import Player
from runtime.play.simulation import poses_of
from tests.runtime.players import skirt_database, skirt_stage

def compiled():
    return sum(len(translations(kernel)) for kernel in ti.lang.impl.get_runtime().kernels)

poses = poses_of(skirt_stage().motion(), 1.0 / 60.0, 2.0)
player = Player(skirt_database(), skirt_stage().body, poses[0])
before, digest = compiled(), hashlib.sha256()
for pose in poses[1:]:
    player.update(pose, 1.0 / 60.0)
    digest.update(player.vertices.tobytes())
print(len(poses) - 1, before, compiled(), player.simulation.state.hash(), digest.hexdigest())
"""


@pytest.mark.proof
def test_120_frames_are_the_same_bits_on_one_thread_and_on_two() -> None:
    runs = []
    for threads in ("1", "2"):
        settings = {"GUBE_THREADS": threads, "OPENBLAS_NUM_THREADS": threads, "OMP_NUM_THREADS": threads}
        command = [sys.executable, "-c", SCRIPT]
        runs.append(subprocess.Popen(command, cwd=ROOT, env=os.environ | settings, stdout=subprocess.PIPE, text=True))
    results = [run.communicate()[0] for run in runs]
    assert [run.returncode for run in runs] == [0, 0]
    assert results[0] == results[1]
    frames, before, after, *_ = results[0].split()
    assert frames == "120"
    assert int(before) == int(after) > 0  # nothing is compiled while it plays: that takes longer than many frames
