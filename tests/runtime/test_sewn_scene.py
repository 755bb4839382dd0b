"""A scene whose garment was sewn: its flat pattern and its layers go with it to every level."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from assets.garment import boundary_loops, highest_loop
from assets.io.scene import parse_scene
from assets.procedural.mannequin import DATA
from assets.sewing.sewing import sew
from assets.sewing.sewn_file import read_sewn, write_sewn
from pbd.mesh import MAX_STRETCH
from runtime.cli import command
from runtime.setup.garment_setup import GarmentSetup
from runtime.setup.scene_simulation import simulation_of
from tests.assets.sewing.tubes import egg, tube_pattern


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tube on the egg, and the egg as a sequence that stands still."""
    path = tmp_path_factory.mktemp("sewn")
    write_sewn(path / "tube.npz", sew(tube_pattern(), egg(), "cotton", edge_length=0.03))
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
        assert mesh.max_stretch is not None and len(mesh.max_stretch) == len(mesh.faces)
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


def slid(mesh: str | Path, clip: str = "walk", seconds: float = 2.5) -> float:
    """How far the waist of an unattached garment has gone down against the body's skin under it [m]."""
    text = f'[[garment]]\nname = "skirt"\nmesh = "{mesh}"\nfabric = "wool"\nsubdivisions = 1\nattach = "none"\n'
    text += f'[character]\nfile = "builtin:mannequin"\nclip = "{clip}"\n'
    simulation, motion = simulation_of(parse_scene(text, "scene.toml"))
    assert motion is not None and simulation.source is not None and not len(simulation.model.held)
    waist = highest_loop(simulation.model.mesh.vertices, simulation.model.mesh.faces)
    near = cKDTree(simulation.source.vertices).query(simulation.model.mesh.vertices[waist])[1]

    def height() -> float:
        skin = simulation.body.current[near, 1] + simulation.body.origin[1]
        return float((simulation.vertices[waist, 1] - skin).mean())

    start = height()
    for frame in range(1, round(60 * seconds)):
        simulation.step(motion.pose(frame / 60), 1 / 60)
    return start - height()


@pytest.mark.parametrize(
    ("name", "clip"),
    [
        ("skirt", "twirl"),
        pytest.param("skirt", "walk", marks=pytest.mark.proof),
        pytest.param("trousers", "walk", marks=pytest.mark.proof),
        pytest.param("trousers", "twirl", marks=pytest.mark.proof),
    ],
)
def test_a_waistband_holds_without_being_attached(name: str, clip: str) -> None:
    assert -0.005 < slid(f"builtin:{name}", clip) < 0.015


WORN = '[[garment]]\nname = "g"\nmesh = "builtin:{}"\nfabric = "cotton"\nsubdivisions = 1\n{}\n'
MANNEQUIN = '[character]\nfile = "builtin:mannequin"\nclip = "walk"\n'


def held_rims(*garments: tuple[str, str]) -> list[float]:
    """Heights of the openings that the body carries, of garments worn over one another, each with its settings [m]."""
    text = "".join(WORN.format(*one).replace('"g"', f'"{n}"') for n, one in enumerate(garments))
    setup = GarmentSetup.of(parse_scene(text + MANNEQUIN, "scene.toml"))
    rims = [
        setup.garment.vertices[loop, 1].mean()
        for loop in boundary_loops(setup.garment.faces)
        if np.isin(loop, setup.levels.coarse_held).all()
    ]
    assert len(rims) or not len(setup.levels.coarse_held)
    return rims


@pytest.mark.parametrize("name", ["skirt", "trousers"])
def test_the_body_carries_a_waistband(name: str) -> None:
    assert held_rims((name, "")) == held_rims((name, 'attach = "top"')) == pytest.approx([1.09], abs=0.01)
    assert not held_rims((name, 'attach = "none"'))


def test_a_band_that_is_loose_or_lies_on_another_garment_is_not_carried() -> None:
    assert not held_rims(("shirt", ""))  # its neckline and its cuffs have room
    assert held_rims(("trousers", ""), ("skirt", "")) == held_rims(("trousers", ""))


@pytest.mark.parametrize("attach", ["", 'attach = "none"'])
def test_trousers_are_still_on_a_body_that_stands_still(attach: str) -> None:
    simulation, motion = simulation_of(parse_scene(WORN.format("trousers", attach) + MANNEQUIN, "scene.toml"))
    still, seen = motion.pose(0.0), []
    for frame in range(240):
        simulation.step(still, 1 / 60)
        if frame >= 200:
            seen.append(simulation.vertices.copy())
    hop = np.linalg.norm(np.diff(seen, 2, axis=0), axis=2) / 4.0
    assert hop.max() < 1e-4


def test_without_its_limits_the_waistband_gives_way(tmp_path: Path) -> None:
    """The same skirt with the usual limits on every edge."""
    sewn = read_sewn(DATA / "circle_skirt.npz")
    unlimited = np.full(len(sewn.garment.faces), MAX_STRETCH)
    write_sewn(tmp_path / "loose.npz", replace(sewn, garment=replace(sewn.garment, max_stretch=unlimited)))
    assert slid("builtin:circle_skirt", seconds=1.0) < 0.02
    assert slid(tmp_path / "loose.npz", seconds=1.0) > 0.08


def test_the_command_writes_a_garment_or_says_why_not(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = ["-o", str(tmp_path / "garment.npz")]
    assert command.main(["sew", "draft:cloak", "-b", "builtin:mannequin", *output]) == 2
    assert "no such draft" in capsys.readouterr().err
    assert command.main(["sew", "draft:tshirt", "-b", "builtin:mannequin", "--param", "ease", *output]) == 2
    assert "KEY=NUMBER" in capsys.readouterr().err
    assert command.main(["sew", "pattern.json", "-b", "builtin:mannequin", "--ease", "0.1", *output]) == 2
    assert "only a draft" in capsys.readouterr().err
    assert command.main(["sew", "draft:tshirt", "-b", "nobody.obj", *output]) == 2
    for given, words in (("waist=72", "a measure that no body has"), ("belly=0.7", "or a measure: height, bust")):
        assert command.main(["sew", "draft:circle_skirt", "-b", "builtin:mannequin", "--param", given, *output]) == 2
        assert words in capsys.readouterr().err
    assert not (tmp_path / "garment.npz").exists()


def test_the_command_takes_measures_by_hand_and_says_how_fine_the_garment_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The built-in skirt stands for what is sewn."""
    drafted, sewn = [], read_sewn(DATA / "circle_skirt.npz")
    made = lambda name, measures, **parameters: drafted.append((measures, parameters))  # noqa: E731
    edges: list[float] = []
    monkeypatch.setattr("assets.patterns.drafts.draft", made)
    monkeypatch.setattr(
        "assets.sewing.sewing.sew", lambda *parts, edge_length, **_: (edges.append(edge_length), sewn)[1]
    )
    arguments = ["sew", "draft:circle_skirt", "-b", "builtin:mannequin", "-o", str(tmp_path / "garment.npz")]
    assert command.main([*arguments, "--ease", "0", "--param", "waist=0.7", "--param", "circle=0.5"]) == 0
    measures, parameters = drafted[0]
    assert measures.waist == 0.7
    assert parameters == {"ease": 0.0, "circle": 0.5}
    assert edges == [0.02]
    said = capsys.readouterr().out
    assert re.search(rf"garment of {len(sewn.garment.vertices):,} vertices, edges of \d\d mm, in", said)
    for ease in ("-0.1", "nan", "inf"):
        with pytest.raises(SystemExit):
            command.main([*arguments, f"--ease={ease}"])
