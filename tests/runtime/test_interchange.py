"""Scenes whose bodies and motions come from other programs' files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from assets.character import Character
from assets.io.body_settings import MotionSettings
from assets.io.obj import read_obj
from assets.io.scene import parse_scene
from assets.io.sequence import Sequence
from assets.loading import load_character, load_garment
from assets.motion import ClipMotion
from assets.procedural.mannequin import builtin_mannequin
from pbd import InputError
from runtime.cli import command
from runtime.export.animation_files import bake_mdd, bake_pc2, bake_usd
from runtime.setup.garment_setup import GarmentSetup
from runtime.setup.playback_inputs import open_database
from runtime.setup.scene_body import body_of, motion_of
from tests.assets.captures import write_bvh
from tests.assets.files import bar_glb, bend_glb
from tests.refusals import refuses
from tests.runtime.baking import sheet_sequence, walking_mannequin
from tests.runtime.players import SCENE, skirt_database
from wrinkles.database_file import write_database


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The mannequin as a USD character, its walk as a capture in centimetres, a sheet as point caches."""
    path = tmp_path_factory.mktemp("files")
    mannequin, poses = walking_mannequin(20)
    faces, frames, sheet = sheet_sequence()
    bake_usd(path / "body.usdc", faces, frames[:1].repeat(20, axis=0), 30.0, body=mannequin, poses=poses)
    bind = np.linalg.inv(mannequin.inverse_bind)[:, :3, 3]
    joints = np.einsum("fjab,jb->fja", poses[..., :3], bind) + poses[..., 3]
    write_bvh(path / "walk.bvh", mannequin.joint_names, mannequin.joint_parents.tolist(), 100 * joints, 30.0)
    bake_mdd(path / "sheet.mdd", sheet.faces, sheet.vertices, 30.0)
    bake_pc2(path / "sheet.pc2", sheet.faces, sheet.vertices)
    return path


def test_a_captured_motion_is_learned_from_and_played(folder: Path) -> None:
    text = SCENE.replace(
        'clip = "walk"\n\n[[training.clips]]',
        '\n[character.motion]\nfile = "walk.bvh"\nlabel = "march"\n\n[[training.clips]]',
    )
    text = text.replace('file = "builtin:mannequin"\nclip = "sway"', 'file = "walk.bvh"\nend = 0.5')
    stage = GarmentSetup.of(parse_scene(text, folder / "scene.toml"))
    (learned,) = stage.training_motions()
    assert (learned.name, learned.duration) == ("walk 0-0.5 s", pytest.approx(1.5))  # a second leads into it
    whole = stage.motion()
    assert (whole.name, whole.duration) == ("march", pytest.approx(1.0 + 19 / 30))
    steps = whole.pose(1.6)[:, :, 3] - whole.pose(1.0)[:, :, 3]
    assert np.linalg.norm(steps, axis=1).max() > 0.2


def test_a_captured_motion_on_a_vertex_sequence_is_refused(folder: Path) -> None:
    scene = parse_scene(SCENE, folder / "scene.toml")
    text = SCENE.replace('"builtin:mannequin"\nclip = "sway"', '"walk.bvh"\nlabel = "march"')
    capture = parse_scene(text, folder / "scene.toml")
    with pytest.raises(InputError, match=r"another kind of body.*walk\.bvh.*a vertex sequence"):
        motion_of(sheet_sequence()[2], capture.training.clips[0])
    wrong = '[[garment]]\nname = "skirt"\nmesh = "builtin:skirt"\n[character]\nsequence = "body.usdc"'
    with pytest.raises(InputError, match=r"body\.usdc: /World/body/mesh: a skinned mesh.*read as a character"):
        body_of(parse_scene(wrong, folder / "scene.toml"))
    assert isinstance(body_of(scene), Character)


def test_a_clip_in_a_file_of_its_own_is_played(tmp_path: Path) -> None:
    body = load_character(bar_glb().write(tmp_path / "bar.glb"))
    settings = MotionSettings(file=bend_glb().write(tmp_path / "bend.glb"), clip="bend", start=0.5)
    motion, own = motion_of(body, settings), ClipMotion(body, "bend")
    assert motion.duration == pytest.approx(1.5)  # a second leads into it
    np.testing.assert_allclose(motion.pose(1.5), own.pose(2.0), atol=1e-6)
    with pytest.raises(InputError, match=r"bend\.glb: clip: no such clip \(received 'jump', expected one of bend\)"):
        motion_of(body, MotionSettings(file=settings.file, clip="jump"))


def test_point_caches_are_bodies(folder: Path) -> None:
    head = '[[garment]]\nname = "skirt"\nmesh = "builtin:skirt"\n[character]\nsequence = '
    truth = sheet_sequence()[2]
    for file in ('"sheet.mdd"', '"sheet.pc2"\nrate = 30'):
        body = body_of(parse_scene(head + file, folder / "scene.toml"))
        assert isinstance(body, Sequence)
        assert np.array_equal(body.vertices, truth.vertices) and np.array_equal(body.faces, truth.faces)
        assert body.dt == pytest.approx(1 / 30)


def test_a_database_is_played_with_a_usd_character(folder: Path, tmp_path: Path) -> None:
    write_database(tmp_path / "skirt.h5", skirt_database())
    _, inputs = open_database(tmp_path / "skirt.h5", character=folder / "body.usdc")
    (motion,) = inputs.motions
    assert motion.name == "animation"
    mannequin = builtin_mannequin()
    assert np.array_equal(load_character(folder / "body.usdc").vertices, mannequin.vertices)
    np.testing.assert_allclose(motion.pose(0.0), mannequin.bind_pose(), atol=1.0)
    refuses(r"walk\.bvh", open_database, tmp_path / "skirt.h5", character=folder / "walk.bvh")


def test_a_garment_on_a_captured_motion_is_simulated_and_baked(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = folder / "capture.toml"
    scene.write_text(
        '[[garment]]\nname = "skirt"\nmesh = "builtin:skirt"\nattach = "top"\nsubdivisions = 1\n'
        '[character]\nfile = "body.usdc"\n[character.motion]\nfile = "walk.bvh"\n'
    )
    out = tmp_path / "skirt.usdc"
    assert command.main(["simulate", str(scene), "-o", str(out), "--seconds", "0.2"]) == 0
    assert load_character(out).clip("animation").frame_count == 7
    assert command.main(["simulate", str(scene), "-o", str(tmp_path / "skirt.mdd"), "--seconds", "0.2"]) == 0
    stage = Usd.Stage.Open(str(out))
    places = np.reshape(UsdGeom.PrimvarsAPI.Get(stage, "/World/garment").GetPrimvar("st").Get(), (-1, 3, 2))
    texture, beside = load_garment("builtin:skirt").texture, read_obj(tmp_path / "skirt.obj").texture
    assert texture is not None and beside is not None
    np.testing.assert_allclose(places, texture, atol=1e-6)
    np.testing.assert_allclose(beside, texture, atol=1e-6)
    (folder / "walk.bvh").rename(folder / "gone.bvh")
    try:
        assert command.main(["simulate", str(scene), "-o", str(out)]) == 2
    finally:
        (folder / "gone.bvh").rename(folder / "walk.bvh")
    assert "character.motion.file: no such file" in capsys.readouterr().err
