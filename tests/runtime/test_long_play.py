"""An hour of play with all that a game does to an outfit: memory stays as it is, and no tick is catastrophic.

`GUBE_PROOF_SECONDS=300 python -m pytest -m proof -s tests/runtime/test_long_play.py` plays five minutes of it.
"""

from __future__ import annotations

import os
import random
import resource
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from assets.motion import ClipMotion
from assets.procedural.mannequin import builtin_mannequin
from pbd.wind import Wind
from precompute.experiment.error_classes import LIMITS
from runtime.output.terminal import say
from runtime.play.game_loop import GameLoop, LiveInput
from runtime.play.level_of_detail import LevelOfDetail
from runtime.play.player import Player
from tests.runtime.players import outfit_database

SECONDS = float(os.environ.get("GUBE_PROOF_SECONDS", "3600"))  # of the garment's time
TICK = 1.0 / 60.0  # [s]
PERIOD = 2.0  # in which the game does something else [s]
SETS = (("trousers",), ("skirt",), ("trousers", "skirt"))
MEMORY = 8 * 2**20  # that may come after the first half, in which all was done once or more often [bytes]


class Game:
    """Draws what happens next: wind, a vertex that is pulled, another detail, other garments; the walk begins again."""

    def __init__(self, seed: int) -> None:
        self.chance, body = random.Random(seed), builtin_mannequin()
        self.motion = ClipMotion(body, "walk")
        self.player = Player(outfit_database(), body, self.motion.pose(0.0))
        self.wind = Wind((0.0, 0.0, 0.0))
        self.drag: tuple[int, np.ndarray] | None = None  # a vertex, and where it is held from the middle of the body
        self.counts = dict.fromkeys(("ticks", "dress", "detail", "drag", "wind", "nothing"), 0)

    def details(self) -> list[LevelOfDetail]:
        full = self.player.full
        return [
            full, replace(full, every=3), replace(full, atoms=0, passes=0), replace(full, substeps=full.substeps // 2),
        ]  # fmt: skip

    def change(self) -> None:
        """Something else happens."""
        kind = self.chance.choice(("dress", "detail", "drag", "wind", "nothing"))
        self.counts[kind] += 1
        self.drag = None
        if kind == "dress":
            self.player.wear(self.chance.choice(SETS))
        elif kind == "detail":
            self.player.change(self.chance.choice(self.details()))
        elif kind == "drag":
            simulation = self.player.simulation
            vertex = self.chance.choice(np.flatnonzero(simulation.model.inverse_mass).tolist())
            off = [self.chance.uniform(-0.15, 0.15) for _ in range(3)]
            self.drag = vertex, simulation.state.world()[vertex] - self.place() + off
        elif kind == "wind":
            x, y, z = (self.chance.uniform(-8.0, 8.0) for _ in range(3))
            self.wind = Wind((x, y, z), turbulence=self.chance.uniform(0.0, 0.5))

    def place(self) -> np.ndarray:
        """Middle of the body [m], shape (3,): what is pulled goes along with it."""
        return self.player.body_vertices.mean(axis=0) + self.player.origin

    def input(self, t: float) -> LiveInput:
        drag = None if self.drag is None else (self.drag[0], self.drag[1] + self.place())
        return LiveInput(self.motion.pose(t % self.motion.duration), self.wind, drag)

    def judge(self) -> None:
        """No tick ends as a catastrophe (:data:`precompute.experiment.error_classes.LIMITS`)."""
        self.counts["ticks"] += 1
        player, simulation = self.player, self.player.simulation
        assert np.isfinite(player.vertices).all() and np.isfinite(player.normals).all(), self.counts
        position, mesh = simulation.state.position[:, :3], simulation.model.mesh
        assert np.isfinite(position).all() and np.isfinite(simulation.state.velocity).all(), self.counts
        box = np.ptp(position, axis=0).max() / np.ptp(mesh.vertices, axis=0).max()
        assert box < LIMITS["box_ratio"][2], (box, self.counts)
        edges, rest = mesh.edge_lengths()
        strain = np.linalg.norm(position[edges[:, 1]] - position[edges[:, 0]], axis=1) / rest - 1.0
        assert np.percentile(strain, 95) < LIMITS["edge_strain_beyond"][2], self.counts


class StoppedClock:
    """A clock that stands still while the player works: an hour passes as fast as it can be played."""

    now = 0.0

    def __call__(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds + 1e-3


def memory() -> int:
    """What this process holds in memory [bytes]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="no system that tells its memory")
@pytest.mark.parametrize("seconds", [4.0, pytest.param(SECONDS, marks=pytest.mark.proof)])
def test_memory_stays_and_no_tick_is_catastrophic(seconds: float) -> None:
    game, clock = Game(0), StoppedClock()
    for names in SETS:  # every set is made once
        game.player.wear(names)
    loop = GameLoop(game.player, game.input, 60.0, TICK, clock=clock, sleep=clock.sleep)
    held = []
    for _ in range(round(seconds / PERIOD)):
        loop.run(PERIOD, game.judge)
        game.change()
        held.append(memory())
        if len(held) % 150 == 0:
            say(f"{loop.tick_count * TICK:.0f} s played, {held[-1] >> 20} MiB")
    sizes = [size >> 20 for size in held[:: max(1, len(held) // 20)]]
    say(f"{game.counts}, {loop.tick_count * TICK:.0f} s; MiB: {sizes}")
    assert loop.tick_count == game.counts["ticks"] == round(seconds / TICK)
    assert held[-1] - max(held[: len(held) // 2]) < MEMORY
