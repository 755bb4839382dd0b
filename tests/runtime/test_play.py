"""`gube play`, `bake` and `simulate`: what they play, write and refuse."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from assets.character import Character
from assets.io.converted import write_garment
from assets.io.scene import parse_scene
from assets.io.sequence import Sequence
from assets.loading import load_garment
from assets.motion import ClipMotion
from pbd.wind import Wind
from runtime.cli import command
from runtime.draw.strips import draw_strips_apart
from runtime.export.animation_baking import baked_frames, simulated_frames
from runtime.export.free_run import play
from runtime.play.player import Player
from runtime.play.simulation import poses_of
from runtime.setup.garment_setup import GarmentSetup
from runtime.setup.playback_inputs import PlaybackInputs, playback_inputs
from runtime.setup.scene_simulation import simulation_of
from tests.processes import python
from tests.refusals import refuses
from tests.runtime.players import OUTFIT, SCENE, random_database, skirt_database, skirt_stage
from wrinkles.database import body_hash
from wrinkles.database_file import read_database, write_database

FLAG = """
[[garment]]
name = "flag"
mesh = "builtin:flag"
subdivisions = 1
pins = [0, 620]
"""


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("skirt") / "skirt.h5"
    write_database(path, skirt_database())
    return path


@pytest.mark.parametrize(
    ("clip", "character", "names"),
    [
        (None, None, ["walk"]),
        ("sway", None, ["sway"]),
        ("turn", None, ["turn"]),  # in no list of the scene, but in the body's file
        (None, Path("builtin:mannequin"), ["walk"]),
        ("twirl", Path("builtin:mannequin"), ["twirl"]),
    ],
)
def test_what_is_played(clip: str | None, character: Path | None, names: list[str]) -> None:
    inputs = playback_inputs(skirt_database(), character, clip=clip)
    assert [motion.name for motion in inputs.motions] == names
    assert all(motion.duration > 1.0 for motion in inputs.motions)


def test_without_a_held_out_clip_the_scenes_own_is_played() -> None:
    scene = SCENE.partition("[[training.held_out]]")[0].replace('clip = "walk"', 'clip = "slow_walk"')
    database = skirt_database(held_out=(), scene=scene)
    assert [motion.name for motion in playback_inputs(database).motions] == ["slow_walk"]


def test_wind_and_colliders_come_from_the_scene() -> None:
    scene = SCENE + '[wind]\nvelocity = [3.0, 0.0, 1.0]\n[[collider]]\ntype = "plane"\n'
    inputs = playback_inputs(skirt_database(scene=scene))
    assert inputs.wind == Wind((3.0, 0.0, 1.0))
    assert len(inputs.primitives) == 1


def test_a_vertex_sequence_has_no_clips(tmp_path: Path) -> None:
    body = skirt_stage().body
    frames = np.repeat(np.asarray(body.vertices, np.float32)[None], 3, axis=0)
    file = tmp_path / "still.npz"
    np.savez(file, vertices=frames, faces=body.faces, dt=0.1)
    database = skirt_database(body_hash=body_hash(Sequence("still", frames, body.faces, 0.1)))
    assert [motion.name for motion in playback_inputs(database, file).motions] == ["still"]
    refuses("no clips", playback_inputs, database, file, clip="walk")


def test_kept_frames_are_those_that_were_asked_for() -> None:
    stage = skirt_stage()
    poses = poses_of(stage.motion(), 1.0 / 60.0, 0.5)
    player = Player(skirt_database(), stage.body, poses[0])
    free = play(player, poses, 1.0 / 60.0, every=5, after=0.2)
    assert free.numbers.tolist() == [15, 20, 25, 30]
    assert free.frames.shape == (4, player.levels.subdivision.fine_count, 3)
    np.testing.assert_array_equal(free.frames[-1], (player.vertices + player.origin).astype(np.float32))
    assert np.abs(free.frames - free.smooth).max() > 0.0
    assert len(free.timings["frame"]) == 30
    assert free.state_hash == player.simulation.state.hash()


def test_play_writes_pictures_and_figures(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[tuple] = []
    monkeypatch.setattr(
        "runtime.export.free_run.draw_strips_apart", lambda *given: drawn.append(given) or draw_strips_apart(*given)
    )
    pictures, out = tmp_path / "pictures", tmp_path / "play.json"
    assert command.main(["play", str(path), "--seconds", "0.4", "-o", str(pictures), "--json", str(out), "--all"]) == 0
    assert sorted(file.name for file in pictures.iterdir()) == ["walk_0010.png", "walk_0020.png"]
    assert np.array_equal(drawn[0][7], skirt_stage().body.faces)
    figures = json.loads(out.read_text(encoding="utf-8"))["figures"]
    parts = {f"{name}_ms_p50" for name in ("frame", "coarse", "skin", "decode", "relax", "normals")}
    wanted = parts | {"frame_ms_p99", "us_per_fine_vertex", "first_frame_s", "import_s", "state_hash"}
    assert wanted <= set(figures)
    assert figures["frame_count"] == 24
    printed = capsys.readouterr().out
    assert f"state_hash {figures['state_hash']}" in printed
    assert "frame_ms_p50" in printed


def test_play_by_the_clock_counts_deadlines(path: Path, tmp_path: Path) -> None:
    out = tmp_path / "loop.json"
    assert command.main(["play", str(path), "--loop", "0.5", "--hz", "30", "--json", str(out)]) == 0
    figures = json.loads(out.read_text(encoding="utf-8"))["figures"]
    assert {"missed_deadlines", "frame_ms_p50", "frame_ms_p99", "dropped_time_s"} <= set(figures)
    assert figures["frame_count"] + figures["missed_deadlines"] >= 15  # every period is one or the other


def test_play_loads_nothing_that_only_learning_needs_and_prints_nothing_of_its_engine(
    path: Path, tmp_path: Path
) -> None:
    script = (
        "import sys; from runtime.cli import command\n"
        "status = command.main(sys.argv[1:])\n"
        "loaded = [name for name in ('sklearn', 'matplotlib', 'precompute', 'dask') if name in sys.modules]\n"
        "sys.exit(f'loaded {loaded}' if loaded else status)\n"
    )
    printed = python(script, "play", str(path), "--seconds", "0.2", "-o", str(tmp_path))
    assert (
        printed.startswith("The garment 'skirt' (muslin) moves in real time")
        and "\nwalk:\n" in printed
        and "aichi" not in printed
    )
    assert len(printed.splitlines()) <= 3 + 2 + 12 + 1  # sentences, the motion's name, rows, where pictures are


@pytest.mark.parametrize("text", [SCENE, OUTFIT], ids=["skirt", "outfit"])
def test_truth_is_found_where_precompute_left_it(text: str, tmp_path: Path) -> None:
    """Both must ask for the same run, or the fine cloth is simulated again. The outfit's fine mesh starts crossed."""
    from precompute.learning.pipeline import scene_run
    from precompute.learning.truth import database_run

    stage = GarmentSetup.of(parse_scene(text, "scene.toml"))
    assert {opening.mesh for opening in stage.openings} == ({"coarse", "fine"} if text == OUTFIT else set())
    write_database(tmp_path / "a.h5", random_database(stage))
    learned = scene_run(stage, stage.scene, stage.motion(stage.scene.training.held_out[0]))
    database = read_database(tmp_path / "a.h5")
    inputs = playback_inputs(database)
    played = database_run(database, inputs, inputs.motions[0])
    assert played.key() == learned.key()
    assert replace(played, wind=(1.0, 0.0, 0.0)).key() != learned.key()


def truncated(path: Path, tmp_path: Path) -> Path:
    content = path.read_bytes()
    (tmp_path / "half.h5").write_bytes(content[: len(content) // 2])
    return tmp_path / "half.h5"


def of_another_body(path: Path, tmp_path: Path) -> Path:
    write_database(tmp_path / "other.h5", skirt_database(body_hash="0" * 64))
    return tmp_path / "other.h5"


def of_a_scene_with_a_slip(path: Path, tmp_path: Path) -> Path:
    write_database(tmp_path / "slip.h5", skirt_database(scene=SCENE.replace("attach", "atach")))
    return tmp_path / "slip.h5"


@pytest.mark.parametrize(
    ("file", "arguments", "words"),
    [
        (lambda path, tmp_path: tmp_path / "absent.h5", [], ["absent.h5", "no such file"]),
        (truncated, [], ["half.h5", "truncated"]),
        (of_another_body, [], ["another character"]),
        (of_a_scene_with_a_slip, [], ["atach", "did you mean 'attach'?"]),
        (lambda path, tmp_path: path, ["--clip", "hop"], ["'hop'", "sway", "walk"]),
        (
            lambda path, tmp_path: path,
            ["--fabric", "silk"],
            ["fabric: a fabric that was not learned", "'silk'", "muslin"],
        ),
        (lambda path, tmp_path: path, ["--character", "absent.glb"], ["absent.glb"]),
        (lambda path, tmp_path: path, ["--seconds", "0.001"], ["--seconds", "0.001"]),
    ],
)
def test_bad_input_is_one_message_and_status_2(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], file, arguments: list[str], words: list[str]
) -> None:
    assert command.main(["play", str(file(path, tmp_path)), "-o", str(tmp_path), *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("gube play: ")
    assert all(word in captured.err for word in words), captured.err


@pytest.mark.parametrize("seconds", ["0", "-1", "nan", "inf", "long"])
def test_a_time_that_is_none_is_refused(path: Path, seconds: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        command.main(["play", str(path), "--seconds", seconds])
    assert caught.value.code == 2
    assert "expected a number above 0" in capsys.readouterr().err


def test_baked_animations_hold_the_body_too(path: Path, tmp_path: Path) -> None:
    import pygltflib

    out = tmp_path / "skirt.glb"
    assert command.main(["bake", str(path), "-o", str(out), "--seconds", "0.3", "--rate", "20"]) == 0
    document = pygltflib.GLTF2().load(str(out))
    assert document is not None
    assert [mesh.name for mesh in document.meshes] == ["garment", "body"]
    assert [len(mesh.primitives[0].targets or ()) for mesh in document.meshes] == [7, 0]  # frames; joints move the body
    assert [node.skin is not None for node in document.nodes if node.mesh is not None] == [False, True]
    drawn = document.accessors[document.meshes[1].primitives[0].indices].count
    assert drawn == 3 * len(skirt_stage().body.faces)
    garment, fine = document.meshes[0].primitives[0], skirt_stage().levels.subdivision.faces
    assert document.accessors[garment.indices].count == 3 * len(fine)
    place = document.accessors[garment.attributes.TEXCOORD_0]
    assert place.count == document.accessors[garment.attributes.POSITION].count > fine.max() + 1  # seams are split


@pytest.mark.parametrize("rate_hz", [60.0, 24.0])
def test_a_baked_animation_begins_in_the_first_frame_of_the_clip(rate_hz: float) -> None:
    stage, database = skirt_stage(), skirt_database()
    assert isinstance(stage.body, Character)
    motion, own = ClipMotion(stage.body, "walk", blend=0.1), ClipMotion(stage.body, "walk", blend=0.0)
    inputs = PlaybackInputs(stage.body, (motion,))
    _, frames, normals, poses = baked_frames(database, inputs, motion, rate_hz, 0.125)
    times = np.arange(int(0.125 * rate_hz + 1e-6) + 1) / rate_hz
    np.testing.assert_allclose(poses, np.stack([own.pose(t) for t in times]), atol=1e-9)
    assert len(frames) == len(normals) == len(times)
    player = Player(database, stage.body, motion.pose(0.0))
    for tick in range(1, 7):
        player.update(motion.pose(tick / 60.0), 1.0 / 60.0)
    np.testing.assert_allclose(frames[0], player.vertices + player.origin, atol=1e-6)


def test_a_simulated_animation_begins_in_the_first_frame_of_the_clip(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = parse_scene(SCENE, "skirt.toml")
    simulation, motion = simulation_of(scene)
    assert isinstance(motion, ClipMotion)
    own = ClipMotion(skirt_stage().body, "walk", blend=0.0)  # pyright: ignore[reportArgumentType]
    stepped: list[int] = []
    monkeypatch.setattr(type(simulation), "step", lambda *_: stepped.append(1))
    frames, poses, rate, figures = simulated_frames(simulation, motion, scene, 0.1)
    assert (len(frames), rate, figures["frame_count"], len(stepped)) == (4, 30.0, 6, 66)
    assert poses is not None
    np.testing.assert_allclose(poses, np.stack([own.pose(frame / 30.0) for frame in range(4)]), atol=1e-9)


@pytest.mark.parametrize("name", ["tshirt.glb", "tshirt.pc2"])
def test_nothing_is_written_over_what_a_scene_is_made_of(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A point cache comes with an .obj beside it, which may be the garment."""
    mesh = load_garment("builtin:skirt")
    write_garment(tmp_path / "tshirt.obj", mesh.vertices, mesh.faces, None, "a test")
    (tmp_path / "tshirt.glb").write_bytes(b"the artist's")
    scene = tmp_path / "scene.toml"
    words = '[[garment]]\nname = "skirt"\nmesh = "tshirt.obj"\n[character]\nfile = "tshirt.glb"\n'
    scene.write_text(words, encoding="utf-8")
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    assert command.main(["simulate", str(scene), "-o", str(tmp_path / name)]) == 2
    assert "would be written over" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_cache_of_points_is_baked_at_its_own_rate(path: Path, tmp_path: Path) -> None:
    """Frames that fall between ticks of 1/60 s are interpolated: 25 a second."""
    assert command.main(["bake", str(path), "-o", str(tmp_path / "a.pc2"), "--seconds", "0.2", "--rate", "25"]) == 0
    assert command.main(["bake", str(path), "-o", str(tmp_path / "b.pc2"), "--seconds", "0.2", "--rate", "5"]) == 0
    count = skirt_stage().levels.subdivision.fine_count
    first, second = (
        np.frombuffer((tmp_path / name).read_bytes()[32:], "<f4").reshape(-1, count, 3) for name in ("a.pc2", "b.pc2")
    )
    assert (len(first), len(second)) == (6, 2)
    np.testing.assert_array_equal(first[0], second[0])
    np.testing.assert_allclose(first[-1], second[-1], atol=1e-6)


@pytest.mark.parametrize("fine", [False, True])
def test_a_flag_hangs_on_its_pins_and_flies_in_the_wind(fine: bool) -> None:
    still = parse_scene(FLAG, "flag.toml")
    windy = parse_scene(FLAG + "[wind]\nvelocity = [4.0, 0.0, 4.0]\n", "flag.toml")
    depths = []
    for scene in (still, windy):
        simulation, motion = simulation_of(scene, fine)
        assert motion is None
        start = simulation.state.world()[[0, 620]]
        frames, poses, rate, figures = simulated_frames(simulation, None, scene, 0.5)
        assert poses is None
        assert (len(frames), rate) == (16, 30.0)
        np.testing.assert_allclose(frames[-1][[0, 620]], start, atol=1e-6)
        depths.append(float(frames[-1][:, 2].mean()))
    assert abs(depths[0]) < 0.01
    assert depths[1] > depths[0] + 0.05


def test_a_tablecloth_falls_onto_the_colliders() -> None:
    text = FLAG.replace("flag", "tablecloth").replace("pins = [0, 620]", "")
    ball = '[[collider]]\ntype = "sphere"\ncentre = [0.0, 0.4, 0.0]\nradius = 0.3\n'
    scene = parse_scene(text + ball, "table.toml")
    simulation, _ = simulation_of(scene)
    frames = simulated_frames(simulation, None, scene, 0.7)[0]
    distance = np.linalg.norm(frames[-1] - [0.0, 0.4, 0.0], axis=1)
    assert distance.min() > 0.299
    assert distance.min() < 0.305
    assert frames[-1][:, 1].max() > 0.69  # it lies on top
    assert frames[-1][:, 1].min() < 0.5  # and hangs down


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("pins = [0, 620]", 'attach = "top"'), ["garment[0].attach", "pins"]),
        (("pins = [0, 620]", "pins = [100000]"), ["garment[0].pins", "100000"]),
        (("pins = [0, 620]", 'pins = [0]\n[character]\nfile = "builtin:mannequin"'), ["garment[0].pins", "attach"]),
    ],
)
def test_a_scene_that_cannot_be_simulated_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: tuple[str, str], words: list[str]
) -> None:
    scene = tmp_path / "flag.toml"
    scene.write_text(FLAG.replace(*change), encoding="utf-8")
    assert command.main(["simulate", str(scene), "-o", str(tmp_path / "flag.glb")]) == 2
    error = capsys.readouterr().err
    assert all(word in error for word in words), error


def test_simulate_bakes_the_garment_with_its_body(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import pygltflib

    scene = tmp_path / "skirt.toml"
    scene.write_text(SCENE, encoding="utf-8")
    out = tmp_path / "skirt.glb"
    assert command.main(["simulate", str(scene), "-o", str(tmp_path / "a.fbx")]) == 2
    assert "a.fbx" in (error := capsys.readouterr().err) and ".glb or .usdc or .pc2 or .mdd or .obj" in error
    assert command.main(["simulate", str(scene), "-o", str(out), "--seconds", "0.2"]) == 0
    document = pygltflib.GLTF2().load(str(out))
    assert document is not None
    assert [mesh.name for mesh in document.meshes] == ["garment", "body"]


def test_precompute_refuses_what_it_cannot_do_before_it_begins(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE, encoding="utf-8")
    assert command.main(["precompute", str(scene), "-o", str(tmp_path / "a.h5"), "--workers", "0"]) == 2
    assert "--workers" in capsys.readouterr().err
    assert command.main(["precompute", str(tmp_path / "absent.toml"), "-o", str(tmp_path / "a.h5")]) == 2
    assert "absent.toml" in capsys.readouterr().err
