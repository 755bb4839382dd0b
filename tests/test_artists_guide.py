"""The commands of the artist's guide, taken from its own text, do what it says."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pygltflib
import pytest

from assets.io.converted import write_garment
from assets.io.scene import load_scene
from assets.motion import ClipMotion
from assets.procedural.mannequin import builtin_mannequin
from runtime.cli import command
from runtime.export.animation_files import bake_glb
from runtime.viewer.viewer import Viewer
from tests.data import ROOT
from tests.documents import commands, prose_and_code
from tests.runtime.players import SCENE, skirt_database, tube
from wrinkles.database_file import read_database, write_database

GUIDE = (ROOT / "docs" / "artists-guide.md").read_text(encoding="utf-8")
COMMANDS = {
    words[1]: words[1:]
    for _, code in prose_and_code(GUIDE)[1]
    for line in commands(code)
    if (words := shlex.split(line, comments=True))
}
SECONDS, LONGER, HZ = 0.8, 2.2, 30  # of the clip


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Path:
    """A character with one clip, of 0.8 s or as long as asked for, and a garment of few vertices."""
    mannequin, seconds = builtin_mannequin(), getattr(request, "param", SECONDS)
    motion = ClipMotion(mannequin, "walk", blend=0.0)
    poses = np.array([motion.pose(frame / HZ) for frame in range(round(seconds * HZ) + 1)])
    corner = np.repeat([[[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]]], len(poses), axis=0)
    bake_glb(tmp_path / "woman.glb", np.array([[0, 1, 2]]), corner, HZ, body=mannequin, poses=poses)
    vertices, faces, _ = tube()
    write_garment(tmp_path / "tshirt.obj", vertices, faces, None, "a test")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def baked(path: Path) -> tuple[list[str], float]:
    """Names of the meshes of an animation, and its length [s]."""
    document = pygltflib.GLTF2().load(str(path))
    assert document is not None
    times = [document.accessors[sampler.input].max[0] for sampler in document.animations[0].samplers]
    return [mesh.name for mesh in document.meshes], max(times)


def run(name: str, monkeypatch: pytest.MonkeyPatch) -> int:
    """Run a command of the guide; `gube view` to where it serves until Ctrl-C. What the artist made stays as it is."""

    def ended(*_: object) -> None:
        raise KeyboardInterrupt

    made = {file: Path(file).read_bytes() for file in ("woman.glb", "tshirt.obj")}
    with monkeypatch.context() as patch:
        patch.setattr(Viewer, "run", ended)
        status = command.main(COMMANDS[name])
    assert {file: Path(file).read_bytes() for file in made} == made
    return status


def test_the_guide_has_a_command_for_each_step() -> None:
    assert list(COMMANDS) == ["new", "simulate", "precompute", "view", "export", "bake"]


def test_a_scene_is_written_and_simulated(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run("new", monkeypatch) == 0
    scene = load_scene("woman.toml")
    assert scene.garments[0].mesh == folder / "tshirt.obj"
    assert str(folder) not in Path("woman.toml").read_text(encoding="utf-8")  # all of it can be moved together
    assert run("simulate", monkeypatch) == 0
    names, seconds = baked(folder / "out" / "woman.glb")
    assert names == ["garment", "body"] and seconds == pytest.approx(SECONDS, abs=1e-3)


def test_what_was_learned_goes_into_other_programs(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = SCENE.rstrip() + "\nend = 0.2\n"
    write_database(Path("woman.h5"), skirt_database(scene=scene, held_out=("walk 0-0.2 s",)))
    for name in ("view", "export", "bake"):
        assert run(name, monkeypatch) == 0
    assert (folder / "woman" / "index.html").exists()
    names, seconds = baked(folder / COMMANDS["bake"][-1])
    assert names == ["garment", "body"] and seconds == pytest.approx(0.2, abs=1e-3)


@pytest.mark.proof
@pytest.mark.parametrize("folder", [LONGER], indirect=True)
def test_the_whole_guide_from_its_first_command_to_its_last(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in COMMANDS:
        assert run(name, monkeypatch) == 0
    database = read_database("woman.h5")
    assert database.garment_name == "tshirt" and database.held_out == ("baked 1.54- s",)
    assert np.isfinite(database.quality["octave_error_max"])
    _, seconds = baked(folder / COMMANDS["bake"][-1])
    assert seconds == pytest.approx(LONGER - 1.54, abs=1.0 / HZ)
