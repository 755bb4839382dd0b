"""`gube new`: guesses about a character and garments, the scene file that they make, and what is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from assets.character import Character, Clip
from assets.garment import Garment, boundary_loops
from assets.io.converted import write_garment
from assets.io.scene import load_scene
from assets.io.settings import portable_path
from assets.loading import load_garment
from assets.placement import fit_of
from pbd import InputError
from runtime.cli import command
from runtime.setup.new_body import BodyGuess, guess_body, guess_motions
from runtime.setup.new_garment import guess_garment
from runtime.setup.new_scene import write_new_scene
from runtime.setup.scene_simulation import simulation_of
from tests.assets.files import bar_glb, bend_glb
from tests.data import data_path
from tests.refusals import refuses

MANNEQUIN = "builtin:mannequin"


@pytest.fixture(scope="module")
def mannequin() -> BodyGuess:
    return guess_body(MANNEQUIN, Path())


def one_layer(name: str) -> Garment:
    """A built-in garment as somebody else's mesh: without layers and pattern."""
    return replace(load_garment(f"builtin:{name}"), pattern=None, layers=None, max_stretch=None)


def stored(folder: Path, garment: Garment, name: str, scale: float = 1.0) -> Path:
    write_garment(folder / name, scale * garment.vertices, garment.faces, garment.pattern, "a test")
    return folder / name


def test_a_scene_of_files_in_centimetres_loads_and_says_so(tmp_path: Path) -> None:
    shirt = stored(tmp_path, one_layer("tshirt"), "my shirt.obj", 100.0)
    made = write_new_scene(MANNEQUIN, [str(shirt)], tmp_path / "scene.toml")
    text = (tmp_path / "scene.toml").read_text(encoding="utf-8")
    assert text == made.text
    assert "centimetres, Y up" in text
    assert 'mesh = "my shirt_metres.obj"' in text
    scene = load_scene(tmp_path / "scene.toml")
    (garment,) = scene.garments
    assert (garment.name, garment.attach, made.garments[0].kind) == ("my shirt", "none", "shirt")
    assert scene.character is not None and scene.character.clip == scene.training.held_out[0].clip
    assert not set(scene.training.clips) & set(scene.training.held_out)
    simulation, motion = simulation_of(scene)
    simulation.step(motion.pose(1 / 60), 1 / 60)
    assert np.isfinite(simulation.vertices).all()


@pytest.mark.parametrize(
    ("name", "kind", "fabric", "attach"),
    [
        ("tshirt", "shirt", "jersey", "none"),
        ("skirt", "skirt", "wool", "top"),
        ("trousers", "trousers", "denim", "top"),
    ],
)
def test_kind_fabric_and_hold_follow_from_the_shape(
    name: str, kind: str, fabric: str, attach: str, mannequin: BodyGuess, tmp_path: Path
) -> None:
    guess = guess_garment(str(stored(tmp_path, one_layer(name), f"{name}.obj")), mannequin, tmp_path)
    assert (guess.kind, guess.fabric, guess.attach) == (kind, fabric, attach)
    assert guess_garment(f"builtin:{name}", mannequin, tmp_path).attach == "bands"  # as it was sewn


def test_a_fabric_in_the_name_is_taken(mannequin: BodyGuess, tmp_path: Path) -> None:
    file = stored(tmp_path, one_layer("skirt"), "Silk-Skirt_2.obj")
    assert guess_garment(str(file), mannequin, tmp_path).fabric == "silk"


def test_a_garment_that_is_inside_out_is_turned(mannequin: BodyGuess, tmp_path: Path) -> None:
    skirt = one_layer("skirt")
    assert skirt.texture is not None
    atlas = skirt.texture * [0.3, 0.7]  # no pattern
    file = tmp_path / "skirt.obj"
    write_garment(file, skirt.vertices, skirt.faces[:, ::-1], atlas[:, ::-1], "a test")
    guess = guess_garment(str(file), mannequin, tmp_path)
    assert guess.turned and guess.garment.pattern is None
    turned = load_garment(tmp_path / "skirt_metres.obj")
    np.testing.assert_allclose(_by_face(turned.faces, turned.texture), _by_face(skirt.faces, atlas), atol=1e-7)
    corner = turned.vertices[turned.faces]
    normals = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    outwards = (corner.mean(axis=1) - turned.vertices.mean(axis=0)) * [1.0, 0.0, 1.0]
    assert (normals * outwards).sum() > 0.0


def _by_face(faces: np.ndarray, texture: np.ndarray | None) -> np.ndarray:
    """Texture coordinates with the lowest vertex of each face first."""
    assert texture is not None
    first = faces.argmin(axis=1)[:, None]
    return np.take_along_axis(texture, ((first + np.arange(3)) % 3)[..., None], axis=1)


def test_flat_texture_coordinates_are_taken_for_the_pattern(mannequin: BodyGuess, tmp_path: Path) -> None:
    skirt = replace(load_garment("builtin:skirt"), layers=None)
    guess = guess_garment(str(stored(tmp_path, skirt, "skirt.obj", 100.0)), mannequin, tmp_path)
    assert guess.garment.pattern is not None  # in metres, beside vertices in centimetres
    np.testing.assert_allclose(guess.garment.pattern, skirt.pattern, atol=1e-7)
    assert skirt.pattern is not None
    atlas = replace(skirt, pattern=skirt.pattern * [1.0, 1.3])
    guess = guess_garment(str(stored(tmp_path, atlas, "atlas.obj")), mannequin, tmp_path)
    assert guess.garment.pattern is None


def test_a_hole_is_noted_and_an_opening_is_not(mannequin: BodyGuess, tmp_path: Path) -> None:
    skirt = one_layer("skirt")
    assert not any("hole" in note for note in _notes(skirt, mannequin, tmp_path))
    middle = int(np.abs(skirt.vertices[skirt.faces].mean(axis=1)[:, 1] - skirt.vertices[:, 1].mean()).argmin())
    torn = replace(skirt, faces=np.delete(skirt.faces, middle, axis=0))
    assert any("1 hole beside its openings" in note for note in _notes(torn, mannequin, tmp_path))


def _notes(garment: Garment, body: BodyGuess, folder: Path) -> tuple[str, ...]:
    return guess_garment(str(stored(folder, garment, "noted.obj")), body, folder).notes


def test_a_character_in_centimetres_is_written_once_more(tmp_path: Path) -> None:
    file = bar_glb(100.0).write(tmp_path / "bar.glb")
    guess = guess_body(str(file), tmp_path)
    assert str(guess.placement) == "centimetres, Y up"
    assert guess.file == tmp_path / "bar_metres.glb"
    same = guess_body(str(bar_glb().write(tmp_path / "bar.glb")), tmp_path)
    np.testing.assert_allclose(guess.vertices, same.vertices, atol=1e-6)
    ends = [body.body.clip("bend") for body in (guess, same)]
    places = [
        body.body.joint_transforms(clip.translation[-1], clip.rotation[-1], clip.scale[-1])[:, :3, 3]
        for body, clip in zip((guess, same), ends, strict=True)
    ]
    np.testing.assert_allclose(*places, atol=1e-6)


def test_the_only_clip_is_cut_in_two(tmp_path: Path) -> None:
    motions = guess_motions(guess_body(str(bar_glb().write(tmp_path / "bar.glb")), tmp_path))
    assert [(part.clip, part.start, part.end) for part in motions.clips] == [("bend", 0.0, 0.7)]
    assert (motions.held_out.clip, motions.held_out.start) == ("bend", 0.7)
    assert motions.procedural_seconds == 0.0  # two joints are no figure


def test_a_walk_is_held_out_and_others_are_learned_from(mannequin: BodyGuess) -> None:
    motions = guess_motions(mannequin)
    assert motions.held_out.clip == "walk"
    assert "walk" not in {part.clip for part in motions.clips}
    assert motions.procedural_seconds > 0.0


def of_lengths(guess: BodyGuess, **seconds: float) -> BodyGuess:
    """The body with its walk cut or repeated to some lengths, by name."""
    assert isinstance(guess.body, Character)
    walk = guess.body.clip("walk")

    def lasting(name: str, length: float) -> Clip:
        frames = np.arange(round(length * walk.rate) + 1) % walk.frame_count
        parts = {part: getattr(walk, part)[frames] for part in ("translation", "rotation", "scale")}
        return replace(walk, name=name, **parts)

    clips = {name: lasting(name, length) for name, length in seconds.items()}
    return replace(guess, body=replace(guess.body, clips=clips))


def test_a_clip_is_held_out_that_can_be_judged_by(mannequin: BodyGuess) -> None:
    assert guess_motions(of_lengths(mannequin, walk_loop=0.8, dance=2.0)).held_out.clip == "dance"
    assert guess_motions(of_lengths(mannequin, walk_loop=1.2, dance=2.0)).held_out.clip == "walk_loop"
    assert guess_motions(of_lengths(mannequin, walk_loop=0.8, dance=0.9)).held_out.clip == "walk_loop"  # none can
    cut = guess_motions(of_lengths(mannequin, dance=3.0))
    assert (cut.clips[0].end, cut.held_out.start) == pytest.approx((1.9, 1.9))


def test_files_are_named_so_that_all_can_be_moved_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    work, data = tmp_path / "home" / "work", tmp_path / "data"
    scenes, elsewhere = work / "scenes", tmp_path / "elsewhere"
    for folder in (scenes, work / "meshes", data / "meshes", elsewhere):
        folder.mkdir(parents=True)
    monkeypatch.delenv("GUBE_DATA", raising=False)
    assert portable_path(scenes / "a.obj", scenes) == "a.obj"
    assert portable_path(scenes / "below" / "a.obj", scenes) == "below/a.obj"
    assert portable_path(work / "meshes" / "a.obj", scenes) == "../meshes/a.obj"
    assert portable_path(scenes / ".." / "meshes" / "a.obj", scenes) == "../meshes/a.obj"
    assert portable_path(elsewhere / "a.obj", scenes) == str(elsewhere / "a.obj")
    assert portable_path(data / "meshes" / "a.obj", scenes) == str(data / "meshes" / "a.obj")
    monkeypatch.setenv("GUBE_DATA", str(data))
    assert portable_path(data / "meshes" / "a.obj", scenes) == "${GUBE_DATA}/meshes/a.obj"
    assert portable_path(data / "meshes" / "a.obj", data / "scenes") == "../meshes/a.obj"  # they move together
    assert portable_path(elsewhere / "a.obj", scenes) == str(elsewhere / "a.obj")


def test_a_scene_that_is_moved_with_its_files_loads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, data = tmp_path / "here", tmp_path / "data"
    for one in (folder / "meshes", folder / "scenes", data):
        one.mkdir(parents=True)
    monkeypatch.setenv("GUBE_DATA", str(data))
    monkeypatch.setattr("runtime.setup.new_scene.simulation_of", lambda scene: None)  # takes time and changes no name
    skirt = stored(folder / "meshes", one_layer("skirt"), "skirt.obj")
    shirt = stored(data, one_layer("tshirt"), "shirt.obj")
    write_new_scene(MANNEQUIN, [str(skirt), str(shirt)], folder / "scenes" / "scene.toml")
    folder.rename(tmp_path / "there")
    data.rename(tmp_path / "other data")
    monkeypatch.setenv("GUBE_DATA", str(tmp_path / "other data"))
    meshes = {garment.mesh for garment in load_scene(tmp_path / "there" / "scenes" / "scene.toml").garments}
    assert meshes == {tmp_path / "there" / "meshes" / "skirt.obj", tmp_path / "other data" / "shirt.obj"}


def broken(folder: Path, kind: str) -> list[str]:
    """Character and garment files with a fault of a kind."""
    shirt, bar = one_layer("tshirt"), bar_glb()
    character = MANNEQUIN
    if kind == "empty":
        (folder / "shirt.obj").write_text("", encoding="utf-8")
        return [character, str(folder / "shirt.obj")]
    if kind == "only an animation":
        character = str(bend_glb().write(folder / "bend.glb"))
    if kind in ("no clip", "no skin", "a tiny body"):
        if kind == "no clip":
            bar.json.pop("animations")
        if kind == "no skin":
            bar.json["nodes"][2].pop("skin")
        character = str((bar if kind != "a tiny body" else bar_glb(1e-5)).write(folder / "bar.glb"))
    faces, vertices = shirt.faces, shirt.vertices
    if kind == "a face twice":
        faces = np.concatenate([faces, faces[3:4]])
    if kind == "a fin":
        vertices = np.concatenate([vertices, vertices[faces[9]].mean(axis=0, keepdims=True) + [0.0, 0.0, 0.1]])
        faces = np.concatenate([faces, [[faces[9, 0], faces[9, 1], len(vertices) - 1]]])
    if kind == "not a number":
        vertices = np.where(np.arange(len(vertices))[:, None] == 7, np.nan, vertices)
    if kind == "far away":
        vertices = vertices + [3.0, 0.0, 0.0]
    if kind == "another body's":
        vertices = 0.8 * (vertices - vertices.mean(axis=0)) + vertices.mean(axis=0)
    if kind == "two pieces":
        cut = vertices[faces][:, :, 1].mean(axis=1) > np.median(vertices[:, 1])
        halves = faces.copy()
        halves[cut] += len(vertices)
        vertices, faces = np.concatenate([vertices - [0.0, 0.0, 1e-4], vertices]), halves
    if kind == "a closed mesh":  # with an inner side
        inner = vertices - 0.002 * (vertices - vertices.mean(axis=0))
        rims = [
            [[a, b, len(vertices) + b], [a, len(vertices) + b, len(vertices) + a]]
            for loop in boundary_loops(faces)
            for b, a in zip(loop, np.roll(loop, -1), strict=True)
        ]
        faces = np.concatenate([faces, faces[:, ::-1] + len(vertices), np.concatenate(rims)])
        vertices = np.concatenate([vertices, inner])
    if kind == "a tiny garment":
        vertices = 1e-6 * vertices
    return [character, str(stored(folder, replace(shirt, vertices=vertices, faces=faces), "shirt.obj"))]


@pytest.mark.parametrize(
    ("kind", "problem", "mend"),
    [
        ("empty", "a mesh without faces", "export the mesh"),
        ("no skin", "no skin", "armature"),
        ("only an animation", "only an animation, without a mesh", "give the file of the body"),
        ("no clip", "no clip that moves", "export with Animation"),
        ("a tiny body", "not the size of a body", "scale it"),
        ("a tiny garment", "not the size of a garment", "scale it"),
        ("a face twice", "the same face as face 3", "delete one of the two"),
        ("a fin", "an edge of 3 faces", "delete the inner faces"),
        ("not a number", "a number that is not finite", "delete the vertex"),
        ("far away", "lies beside the body", "put it around the body"),
        ("another body's", "starts inside the body", "take the garment of this body"),
        ("a closed mesh", "a closed mesh", "Solidify"),
        ("two pieces", "2 pieces that nothing holds together", "join them"),
    ],
)
def test_a_fault_is_named_with_what_mends_it(kind: str, problem: str, mend: str, tmp_path: Path) -> None:
    character, *garments = broken(tmp_path, kind)
    text = refuses("", write_new_scene, character, garments, tmp_path / "scene.toml")
    assert problem in text
    assert mend in text.partition("to mend it:")[2]
    assert not (tmp_path / "scene.toml").exists()


def test_all_faults_are_reported_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.glb").write_bytes(b"")
    (tmp_path / "bad.obj").write_text("v 0 0\n", encoding="utf-8")
    assert command.main(["new", "bad.glb", "bad.obj", "missing.obj", "-o", "scene.toml"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("gube new: 3 problems:\n")
    assert all(name in error for name in ("bad.glb", "bad.obj: line 1", "missing.obj: cannot be read"))


def test_the_command_prints_the_scene_and_never_writes_over_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, figures = tmp_path / "scene.toml", tmp_path / "new.json"
    words = ["new", MANNEQUIN, "builtin:skirt", "-o", str(out)]
    assert command.main([*words, "--json", str(figures)]) == 0
    printed = capsys.readouterr().out
    assert out.read_text(encoding="utf-8") in printed
    assert f"gube precompute {out}" in printed and f"gube export {out.with_suffix('.h5')}" in printed
    (row,) = json.loads(figures.read_text(encoding="utf-8"))["rows"]
    assert (row["kind"], row["read_as"], row["held_out"]) == ("skirt", "metres, Y up", "walk")
    assert command.main(words) == 2
    assert "exists already" in capsys.readouterr().err


@pytest.mark.proof
def test_two_garments_are_ordered_from_the_body_outwards(tmp_path: Path) -> None:
    made = write_new_scene(MANNEQUIN, ["builtin:skirt", "builtin:tshirt"], tmp_path / "scene.toml")
    assert [garment.garment.name for garment in made.garments] == ["skirt", "tshirt"]
    assert "Garments are an outfit" in made.text


@pytest.mark.proof
def test_three_garments_are_ordered_too(tmp_path: Path) -> None:
    three = ["builtin:shirt", "builtin:trousers", "builtin:tshirt"]
    made = write_new_scene(MANNEQUIN, three, tmp_path / "three.toml")
    assert [garment.garment.name for garment in made.garments] == ["trousers", "tshirt", "shirt"]


WOMAN = "characters/mh_female_bandai_NC.glb"
JUMPING = "characters/mh_female_cmu_rokoko.glb"
OWN = [f"garments/mh_female_{name}.obj" for name in ("tshirt", "trousers", "skirt_knee", "skirt_long", "tshirt_tight")]
PAIRS = [
    *((woman, garment) for woman in (WOMAN, JUMPING) for garment in OWN),
    ("characters/arcsim_female_dance_NC.glb", "garments/arcsim_dress_yellow_NC.obj"),
    ("characters/arcsim_female_dance_NC.glb", "garments/arcsim_dress_yellow_sub2_NC.obj"),
    ("sequences/cipc_body_rumba_dancing.npz", "garments/cipc_dress_draped.obj"),
]
NOT_WORN = [
    (WOMAN, "garments/newton_unisex_shirt.obj"),
    (WOMAN, "garments/cipc_dress_draped.obj"),
    (WOMAN, "garments/cipc_dress_pattern_stitches.obj"),
    (WOMAN, "garments/arcsim_dress_yellow_NC.obj"),
    ("characters/quaternius_mannequin_44clips.glb", "garments/mh_female_tshirt.obj"),
    ("characters/quaternius_mannequin_44clips.glb", "garments/mh_female_trousers.obj"),
    ("characters/arcsim_female_dance_NC.glb", "garments/mh_female_skirt_long.obj"),
    ("sequences/cipc_body_rumba_dancing.npz", "garments/mh_female_tshirt.obj"),
]


@pytest.mark.proof
@pytest.mark.parametrize(("character", "garment"), PAIRS)
def test_real_pairs_run_a_second_and_stay_on_the_body(character: str, garment: str, tmp_path: Path) -> None:
    made = write_new_scene(str(data_path(character)), [str(data_path(garment))], tmp_path / "scene.toml")
    simulation, motion = simulation_of(load_scene(tmp_path / "scene.toml"))
    assert motion is not None
    for frame in range(1, 61):
        simulation.step(motion.pose(frame / 60), 1 / 60)
    assert np.isfinite(simulation.vertices).all()
    body = (simulation.body.current + simulation.state.origin).astype(float)
    fit = fit_of(simulation.vertices, simulation.model.mesh.faces, body, simulation.body.faces)
    assert fit.is_worn
    assert fit.gap_p50 < made.garments[0].fit.gap_p50 + 0.03


@pytest.mark.proof
@pytest.mark.parametrize(("character", "garment"), NOT_WORN)
def test_real_garments_of_other_bodies_are_refused(character: str, garment: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="inside the body|beside the body|nothing holds together"):
        write_new_scene(str(data_path(character)), [str(data_path(garment))], tmp_path / "scene.toml")
