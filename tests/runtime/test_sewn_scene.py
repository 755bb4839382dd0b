"""A scene whose garment was sewn: its flat pattern and its layers go with it to every level."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from assets.io.scene import parse_scene
from assets.io.sewn import write_sewn
from assets.sewing.sewing import sew
from runtime import command
from runtime.garment_setup import GarmentSetup, simulation_of
from tests.assets.sewing.tubes import egg, tube_pattern


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tube on the egg, and the egg as a sequence that stands still."""
    path = tmp_path_factory.mktemp("sewn")
    write_sewn(path / "tube.npz", sew(tube_pattern(), egg(), "cotton", 0.03))
    body = egg()
    vertices = np.repeat(body.vertices[None].astype(np.float32), 3, axis=0)
    np.savez(path / "egg.npz", vertices=vertices, faces=body.faces, dt=0.1)
    return path


SCENE = '[[garment]]\nname = "tube"\nmesh = "tube.npz"\nsubdivisions = 2\n[character]\nsequence = "egg.npz"\n'


def test_both_levels_rest_as_the_pattern(folder: Path) -> None:
    levels = GarmentSetup.of(parse_scene(SCENE, folder / "scene.toml")).levels
    for mesh in (levels.coarse, levels.fine):
        assert np.isclose(mesh.face_areas.sum(), 0.6 * 0.1)
        assert mesh.layers is not None and mesh.layers.max() > 1.5
    assert len(levels.fine.faces) == 16 * len(levels.coarse.faces)
    assert np.isclose(levels.fine.face_cloth_areas.sum(), levels.coarse.face_cloth_areas.sum())


@pytest.mark.parametrize("fine", [False, True])
def test_a_sewn_garment_stays_where_it_was_draped(folder: Path, fine: bool) -> None:
    simulation, motion = simulation_of(parse_scene(SCENE, folder / "scene.toml"), fine)
    assert motion is not None
    start = simulation.vertices
    for frame in range(12):
        simulation.step(motion.pose(frame / 60), 1 / 60)
    assert np.linalg.norm(simulation.vertices - start, axis=1).max() < 0.01


def test_the_command_writes_a_garment_or_says_why_not(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = ["-o", str(tmp_path / "garment.npz")]
    assert command.main(["sew", "draft:cloak", "-b", "builtin:mannequin", *output]) == 2
    assert "no such draft" in capsys.readouterr().err
    assert command.main(["sew", "draft:tshirt", "-b", "builtin:mannequin", "--param", "ease", *output]) == 2
    assert "KEY=NUMBER" in capsys.readouterr().err
    assert command.main(["sew", "pattern.json", "-b", "builtin:mannequin", "--ease", "0.1", *output]) == 2
    assert "only a draft" in capsys.readouterr().err
    assert command.main(["sew", "draft:tshirt", "-b", "nobody.obj", *output]) == 2
    assert not (tmp_path / "garment.npz").exists()
