"""Coarse garments in random motion: they stay free of crossings. `pytest -s -m proof` prints a table."""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np
import pytest

from assets.io.scene import load_scene, parse_scene
from assets.procedural.exploration import exploration_motion
from assets.procedural.mannequin import builtin_mannequin
from pbd.crossings import SelfCrossings
from runtime.play.simulation import poses_of
from runtime.setup.garment_setup import GarmentSetup
from runtime.setup.scene_simulation import simulation_of
from tests.data import ROOT, data_path

DT = 1.0 / 60.0
GARMENTS = ("skirt", "circle_skirt", "trousers", "tshirt", "shirt")
SCENE = """
[[garment]]
name = "{name}"
mesh = "builtin:{name}"
{attach}
[character]
file = "builtin:mannequin"
clip = "walk"
"""


@dataclass(frozen=True)
class Played:
    """Faces that cross others in each frame of a motion, and how many faces there are."""

    crossed: np.ndarray
    faces: int

    @property
    def longest(self) -> float:
        """Longest time for which any faces cross [s]."""
        ends = np.flatnonzero(np.diff(np.concatenate([[0], self.crossed > 0, [0]]).astype(int)))
        return float(np.diff(ends)[::2].max(initial=0)) * DT


def played(name: str, seed: int, seconds: float) -> Played:
    """A built-in garment, coarse, in a random motion of the mannequin."""
    attach = 'attach = "top"' if name == "skirt" else ""
    simulation, _ = simulation_of(parse_scene(SCENE.format(name=name, attach=attach), "crossings.toml"))
    poses = poses_of(exploration_motion(builtin_mannequin(), seed, seconds), DT)
    crossings, found = SelfCrossings(simulation.model.mesh), []
    simulation.place_body(poses[0])
    for pose in poses[1:]:
        simulation.step(pose, DT)
        found.append(len(crossings.faces_of(crossings.find(simulation.state.world()))))
    return Played(np.array(found), len(simulation.model.mesh.faces))


@pytest.mark.parametrize("name", ["tshirt", "skirt"])
def test_a_garment_in_random_motion_does_not_go_through_itself(name: str) -> None:
    assert played(name, 3, 2.5).crossed.max() == 0


@pytest.mark.proof
def test_twenty_random_motions_of_all_built_in_garments() -> None:
    missed = []
    for name in GARMENTS:
        runs = [played(name, seed, 5.0) for seed in range(20)]
        crossed = np.concatenate([run.crossed for run in runs])
        free, longest = 100.0 * float((crossed == 0).mean()), max(run.longest for run in runs)
        row = f"{runs[0].faces:>7} faces {free:7.2f} % of frames free, {crossed.max()} faces at worst, {longest:.2f} s"
        sys.stdout.write(f"{name:<14}{row} at most\n")
        if free < 99.0 or longest > 1.0:
            missed.append(name)
    assert not missed


@pytest.mark.proof
@pytest.mark.parametrize(
    ("name", "open_fine"), [("mannequin_layers", True), ("cipc_dress", False)], ids=["layers", "pleats"]
)
def test_starts_that_cross_are_opened(name: str, open_fine: bool) -> None:
    """Three layers that are put on at once; a dress in pleats, whose fine mesh stays through itself at its gathers."""
    if name == "cipc_dress":
        data_path("garments/cipc_dress_draped.obj")
    openings = GarmentSetup.of(load_scene(ROOT / "docs" / "scenes" / f"{name}.toml")).openings
    sys.stdout.write("\n".join(["", *map(str, openings), ""]))
    assert [one.mesh for one in openings] == ["coarse", "fine"]
    assert openings[0].after == 0 and openings[0].moved < 0.2
    assert openings[1].after == 0 or not open_fine
