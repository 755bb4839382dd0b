"""Scenes of delivered fine meshes on vertex sequences."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from assets.fabrics import PRESETS
from assets.io.scene import Scene, parse_scene, scene_text
from assets.procedural.builtin import builtin_garment
from assets.procedural.mannequin import builtin_mannequin
from pbd import DistanceField, InputError, Plane
from pbd.attachment import Attachment
from runtime.play.plain_cloth import middle_levels
from runtime.play.player import Player
from runtime.play.simulation import body_source, poses_of
from runtime.setup.garment_mesh import pattern_of, with_subdivisions
from runtime.setup.garment_setup import GarmentSetup, colliders_of, fabrics_of, fine_substep_of
from runtime.setup.scene_body import motion_of
from runtime.setup.scene_simulation import simulation_of
from tests.assets.panels import two_panels
from tests.refusals import refuses
from tests.wrinkles.databases import small_database
from tests.wrinkles.delivered import delivered_database
from tests.wrinkles.meshes import icosphere
from wrinkles.database import WrinkleDatabase, body_hash
from wrinkles.database_file import read_database, write_database

SCENE = """
[[garment]]
name = "cloth"
mesh = "cloth.obj"
pattern = true
seams = "stitches.csv"
coarse_vertices = 60

[character]
sequence = "ball.npz"

[training]
[[training.clips]]
file = "ball.npz"
end = 0.5
speed = 0.5

[[training.held_out]]
file = "ball.npz"
start = 0.5
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two panels that are sewn together, lying over a ball that comes up."""
    path = tmp_path_factory.mktemp("sewn")
    vertices, faces, seams = two_panels(20, 20, 17)
    lines = [f"v {x} 0.1 {-y}" for x, y, _ in vertices] + [f"vt {x} {y}" for x, y, _ in vertices]
    lines += ["f " + " ".join(f"{v + 1}/{v + 1}" for v in face) for face in faces]
    (path / "cloth.obj").write_text("\n".join(lines))
    rows = [f"{v},{a},{b},{w}" for (v, a, b), w in zip(seams.vertices.tolist(), seams.weights.tolist(), strict=True)]
    (path / "stitches.csv").write_text("\n".join(["v,a,b,w", *rows]))
    ball, ball_faces = icosphere(2, 0.08)
    heights = np.linspace(0.0, 0.05, 11)
    moved = ball + np.stack([0.0 * heights + 0.24, heights, 0.0 * heights - 0.12], axis=1)[:, None]
    np.savez(path / "ball.npz", vertices=moved.astype(np.float32), faces=ball_faces.astype(np.int32), dt=0.1)
    return path


@pytest.fixture(scope="module")
def stage(folder: Path) -> GarmentSetup:
    return GarmentSetup.of(scene(folder))


def scene(folder: Path, old: str = "", new: str = "") -> Scene:
    assert old in SCENE
    return parse_scene(SCENE.replace(old, new) if old else SCENE, folder / "scene.toml")


def test_the_delivered_mesh_is_the_fine_one(stage: GarmentSetup) -> None:
    assert len(stage.levels.fine.vertices) == 21 * 21 + 21 * 18
    assert len(stage.levels.coarse.vertices) <= 60 and len(stage.garment.vertices) == len(stage.levels.coarse.vertices)
    assert len(stage.levels.fine.stitches) == 18
    assert not len(stage.levels.fine_held)


def test_a_delivered_mesh_is_drawn_with_its_own_pattern(stage: GarmentSetup) -> None:
    subdivision = stage.levels.subdivision
    flat = subdivision.flat_corners(stage.levels.pattern)
    assert flat is not None and flat.shape == (*subdivision.faces.shape, 2)
    assert (np.linalg.det(flat[:, 1:] - flat[:, :1]) != 0.0).all()


def test_a_sequence_is_learned_from_and_judged_by_parts(stage: GarmentSetup) -> None:
    (learned,) = stage.training_motions()
    held_out = stage.motion(stage.scene.training.held_out[0])
    assert (learned.name, learned.lead_in, learned.duration) == ("ball 0-0.5 s x 0.5", 0.0, pytest.approx(1.0))
    assert (held_out.name, held_out.lead_in, held_out.duration) == ("ball 0.5- s", 0.5, pytest.approx(1.0))
    assert stage.motion().duration == pytest.approx(1.0)


def test_a_body_of_another_unit_is_refused_where_the_scene_is_loaded(tmp_path: Path) -> None:
    """Exported at a hundredth of its size it stood in the shirt, which fell to the floor without a word."""
    mannequin = builtin_mannequin()
    small = (0.01 * mannequin.vertices[None]).astype(np.float32)
    np.savez(tmp_path / "small.npz", vertices=small, faces=mannequin.faces, dt=0.1)
    text = '[[garment]]\nname = "shirt"\nmesh = "builtin:tshirt"\n[character]\nsequence = "small.npz"\n'
    with pytest.raises(InputError, match=r"garment\[0\]\.mesh: a body of another unit .*a body 100 times as large"):
        GarmentSetup.of(parse_scene(text, tmp_path / "scene.toml"))


def test_motions_of_another_body_are_refused(stage: GarmentSetup, folder: Path) -> None:
    part = stage.scene.training.held_out[0]
    refuses(r"ball\.npz.*start.*received 2\.0.*below 1", motion_of, stage.body, replace(part, start=2.0))
    with pytest.raises(InputError, match=r"another kind of body.*builtin:mannequin.*vertex sequence"):
        motion_of(stage.body, replace(part, file="builtin:mannequin", clip="walk"))
    ball, faces = icosphere(1, 0.08)
    np.savez(folder / "other.npz", vertices=ball[None].astype(np.float32), faces=faces.astype(np.int32), dt=0.1)
    refuses(r"other\.npz.*another surface", motion_of, stage.body, replace(part, file=folder / "other.npz"))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("coarse_vertices = 60", "coarse_vertices = 200", r"cloth\.obj.*coarse_vertices.*received 200.*eighth.*819"),
        ('"stitches.csv"', '"bad.csv"', r"bad\.csv.*line 2, column v.*received '9999'"),
        ('"cloth.obj"', '"shared.obj"', r"shared\.obj.*face \d+.*several places in the pattern"),
    ],
)
def test_what_cannot_be_bound_is_refused(folder: Path, old: str, new: str, message: str) -> None:
    (folder / "bad.csv").write_text("v,a,b,w\n9999,0,1,0.5\n")
    lines = (folder / "cloth.obj").read_text().splitlines()
    first = lines[-1].split()[1].split("/")[0]
    (folder / "shared.obj").write_text("\n".join([*lines[:-1], lines[-1].replace(f"{first}/{first}", f"{first}/1", 1)]))
    refuses(message, GarmentSetup.of, scene(folder, old, new))


def database_of(stage: GarmentSetup) -> WrinkleDatabase:
    known = {"warp": (0.0, 1.0, 0.0), "body_hash": body_hash(stage.body), "limits": small_database().limits}
    return delivered_database(stage.levels.coarse.vertices, stage.levels.subdivision, **known)


def test_a_delivered_mesh_has_a_middle_one(stage: GarmentSetup, monkeypatch: pytest.MonkeyPatch) -> None:
    # As if the subdivided mesh had another area than the coarse one, which is nothing to a mesh that came fine.
    monkeypatch.setattr("wrinkles.levels.MAX_AREA_CORRECTION", -1.0)
    run: Any = SimpleNamespace(body=stage.body)
    middle = middle_levels(database_of(stage), body_source(run.body))
    assert middle is not None and np.array_equal(middle.fine.faces, stage.levels.fine.faces)
    assert len(stage.levels.coarse.vertices) < len(middle.coarse.vertices) < len(middle.fine.vertices)


def test_a_database_plays_a_delivered_mesh_without_its_file(stage: GarmentSetup, tmp_path: Path) -> None:
    body, database = stage.body, database_of(stage)
    write_database(tmp_path / "cloth.h5", database)
    poses = poses_of(stage.motion(), 1.0 / 60.0, 0.1)
    player = Player(read_database(tmp_path / "cloth.h5"), body, poses[0])
    for name in ("vertices", "flat", "faces", "stitches", "stitch_weights"):
        assert np.array_equal(getattr(player.levels.fine, name), getattr(stage.levels.fine, name)), name
    for pose in poses[1:]:
        player.update(pose, 1.0 / 60.0)
    assert np.isfinite(player.vertices).all()
    # Normals of all vertices are of length one, and those that are sewn together share theirs.
    assert np.linalg.norm(player.normals, axis=1) == pytest.approx(1.0, abs=1e-5)
    stands_for = player.levels.subdivision.stands_for
    assert stands_for is not None and (stands_for != np.arange(len(stands_for))).any()
    assert np.array_equal(player.normals, player.normals[stands_for])


def test_the_fabrics_of_a_scene_go_by_the_names_of_presets() -> None:
    text = '[[garment]]\nname = "skirt"\nmesh = "builtin:skirt"\nfabric = "wool"\nthickness = 0.002\n'
    others = '[training]\nfabrics = ["silk", "denim"]\n'
    found = parse_scene(text + others, "scene.toml")
    fabrics = fabrics_of(found, found.garments[0])
    assert list(fabrics) == ["wool", "silk", "denim"]
    assert all(fabrics[name] == replace(PRESETS[name], thickness=0.002) for name in fabrics)
    measured = parse_scene(text.replace('"wool"', "{ shear = 70 }") + others, "scene.toml")
    assert list(fabrics_of(measured, measured.garments[0])) == ["own", "silk", "denim"]
    twice = parse_scene(text.replace("wool", "silk") + others, "scene.toml")
    refuses(r"training\.fabrics: the garment's own fabric.*others than.*silk", fabrics_of, twice, twice.garments[0])


def skirt_with(folder: Path, keys: str, more: str = "", rows: str = "") -> Scene:
    (folder / "limits.csv").write_text("vertex,maximum_distance,backstop,stiffness\n" + rows)
    text = f'[[garment]]\nname = "skirt"\nmesh = "builtin:skirt"\nattach = "top"\nsubdivisions = 1\n{keys}\n'
    return parse_scene(text + f'[character]\nfile = "builtin:mannequin"\nclip = "twirl"\n{more}', folder / "scene.toml")


@pytest.mark.parametrize(("keys", "expected"), [("", 2), ('fabric = "silk"', 3), ("subdivisions = 1", 1)])
def test_subdivisions_follow_from_the_fabric_unless_they_are_named(keys: str, expected: int) -> None:
    scene = parse_scene(f'[[garment]]\nname = "skirt"\nmesh = "builtin:skirt"\n{keys}\n')
    assert with_subdivisions(scene).garments[0].subdivisions == expected


def test_softer_fabrics_need_finer_meshes() -> None:
    def needed(bend: float, more: str = "") -> int | None:
        fabric = f"fabric = {{ areal_density = 0.2, bend_warp = {bend}, bend_weft = {bend} }}"
        scene = parse_scene(f'[[garment]]\nname = "skirt"\nmesh = "builtin:skirt"\n{fabric}\n{more}')
        return with_subdivisions(scene).garments[0].subdivisions

    assert [needed(bend) for bend in (1e-3, 3e-5, 1e-6, 0.0)] == [1, 2, 3, 3]
    assert needed(1e-3, '[training]\nfabrics = ["silk"]\n') == 3


def test_ease_reaches_both_meshes_of_a_scene(tmp_path: Path) -> None:
    plain, eased = (GarmentSetup.of(skirt_with(tmp_path, keys)).levels for keys in ("", "ease = [0.2, 0.05]"))
    for name in ("coarse", "fine"):
        before, after = getattr(plain, name), getattr(eased, name)
        assert after.face_areas.sum() / before.face_areas.sum() == pytest.approx(1.2 * 1.05, rel=0.02)
    held = plain.coarse_held
    # A sewn waist lies at the clearance itself, so that both garments are pushed out of the body a little.
    np.testing.assert_allclose(eased.coarse.vertices[held], plain.coarse.vertices[held], atol=2e-5)
    refuses("ease: a garment smaller than the body", GarmentSetup.of, skirt_with(tmp_path, "ease = [-0.4, 0]"))


@pytest.mark.parametrize("fine", [False, True])
def test_painted_limits_hold_both_meshes(tmp_path: Path, fine: bool) -> None:
    count = len(builtin_garment("skirt").vertices)
    rows = "".join(f"{vertex},0.02,,\n" for vertex in range(count))
    simulation, motion = simulation_of(skirt_with(tmp_path, 'limits = "limits.csv"', rows=rows), fine)
    free, _ = simulation_of(skirt_with(tmp_path, ""), fine)
    assert motion is not None and simulation.source is not None
    model = simulation.model
    carried = Attachment.bind(model.mesh.vertices, simulation.source.vertices, simulation.source.faces)
    for frame in range(1, 76):  # a second of lead-in, a quarter of a turn
        for one in (simulation, free):
            one.step(motion.pose(frame / 60), 1 / 60)
    place = carried.targets(simulation.body.current) + simulation.state.origin
    off = np.linalg.norm(simulation.state.world() - place, axis=1)
    assert np.percentile(off, 95) < 0.02 + 1e-4  # contact with the body may push further
    assert np.linalg.norm(free.state.world() - place, axis=1).max() > 0.05


def test_wind_and_pressure_of_a_scene_are_felt(tmp_path: Path) -> None:
    calm, _ = simulation_of(skirt_with(tmp_path, ""))
    wind = "[wind]\nvelocity = [0, 0, 8]\nturbulence = 0.3"
    blown, motion = simulation_of(skirt_with(tmp_path, "", wind))
    inflated, _ = simulation_of(skirt_with(tmp_path, "pressure = 5"))
    assert motion is not None
    air = parse_scene(wind + "\n[[garment]]\nname = 'a'\nmesh = 'builtin:skirt'", "scene.toml").wind.air()
    for frame in range(1, 16):
        pose = motion.pose(frame / 60)
        calm.step(pose, 1 / 60)
        blown.step(pose, 1 / 60, air)
        inflated.step(pose, 1 / 60)
    assert blown.time == pytest.approx(0.25)
    assert (blown.state.world() - calm.state.world())[:, 2].mean() > 0.002
    axis = calm.state.world()[:, [0, 2]].mean(axis=0)
    girth = [np.linalg.norm(one.state.world()[:, [0, 2]] - axis, axis=1).mean() for one in (calm, inflated)]
    assert girth[1] > girth[0] + 0.002


def test_limits_need_a_body(tmp_path: Path) -> None:
    text = '[[garment]]\nname = "skirt"\nmesh = "builtin:skirt"\nlimits = "limits.csv"\n'
    (tmp_path / "limits.csv").write_text("vertex,maximum_distance,backstop,stiffness\n")
    refuses(r"garment\[0\].limits: nothing to be carried by", simulation_of, parse_scene(text, tmp_path / "scene.toml"))


def solids(folder: Path, faces: np.ndarray, more: str = "") -> Scene:
    """A skirt over a ball of a mesh and a floor."""
    vertices, _ = icosphere(2, 0.15)
    lines = [f"v {x:.17g} {y:.17g} {z:.17g}" for x, y, z in vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    (folder / "ball.obj").write_text("\n".join(lines) + "\n", encoding="utf-8")
    text = '[[garment]]\nname = "skirt"\nmesh = "builtin:skirt"\n'
    text += '[[collider]]\ntype = "field"\nmesh = "ball.obj"\ncentre = [0.0, 1.0, 0.0]\n'
    return parse_scene(text + more + '[[collider]]\ntype = "plane"\n', folder / "scene.toml")


def test_a_mesh_of_a_scene_becomes_a_distance_field(tmp_path: Path) -> None:
    found = solids(tmp_path, icosphere(2, 0.15)[1])
    field, floor = colliders_of(found)
    assert isinstance(field, DistanceField) and isinstance(floor, Plane)
    assert (field.position, field.spacing) == ((0.0, 1.0, 0.0), 0.01)
    assert field.values.min() == pytest.approx(-0.15, abs=0.01)
    again = colliders_of(found)[0]
    assert again is not field and isinstance(again, DistanceField) and again.values is field.values
    simulation, _ = simulation_of(found)
    assert len(simulation.colliders.fields(np.zeros(3))[0]) == 1
    simulation.step(None, 1 / 60)


def test_a_mesh_that_is_no_solid_is_refused(tmp_path: Path) -> None:
    faces = icosphere(2, 0.15)[1]
    with pytest.raises(InputError, match=r"ball\.obj: collider\[0\]\.mesh: a mesh that is not closed.*watertight"):
        colliders_of(solids(tmp_path, faces[1:]))
    (tmp_path / "fine").mkdir()
    with pytest.raises(InputError, match=r"ball\.obj: collider\[0\]\.spacing: a grid of .* points.*10,000,000"):
        colliders_of(solids(tmp_path / "fine", faces, "spacing = 0.0005\n"))


FINER = '[[garment]]\nname = "s"\nmesh = "builtin:skirt"\nattach = "top"\nsubdivisions = {}\n{}\n'
FINER += '[character]\nfile = "builtin:mannequin"\n'


def test_a_mesh_is_subdivided_before_it_is_simulated() -> None:
    plain = GarmentSetup.of(parse_scene(FINER.format(2, ""), "plain")).levels
    scene = parse_scene(FINER.format(1, "coarse_subdivisions = 1"), "finer")
    finer = GarmentSetup.of(scene).levels
    assert len(finer.coarse.vertices) == plain.subdivision.middle.fine_count
    assert np.array_equal(finer.fine.faces, plain.fine.faces)
    np.testing.assert_allclose(finer.fine.flat, plain.fine.flat, atol=1e-9)  # the pattern of the same cloth
    assert np.array_equal(finer.fine_held, plain.fine_held) and len(finer.coarse_held) > len(plain.coarse_held)
    moved = np.linalg.norm(finer.fine.vertices - plain.fine.vertices, axis=1)
    assert moved.max() < 0.004  # pushed out of the body anew
    assert finer.pattern is not None and len(finer.pattern) == len(finer.coarse.faces)
    np.testing.assert_array_equal(pattern_of(scene), finer.pattern)
    assert finer.cutoff == pytest.approx(0.5 * plain.cutoff, rel=0.02)


@pytest.mark.proof
def test_the_fine_cloth_is_as_converged_whichever_mesh_is_simulated() -> None:
    scenes = [
        parse_scene(FINER.format(2, ""), "plain"),
        parse_scene(FINER.format(1, "coarse_subdivisions = 1") + "[solver]\nsubstep = 0.01\n", "finer"),
    ]
    plain, finer = (simulation_of(scene, fine=True)[0].solver.options for scene in scenes)
    assert plain == finer
    stored = [
        replace(small_database(), scene=scene_text(scene), subdivisions=subdivisions)
        for scene, subdivisions in zip(scenes, (2, 1), strict=True)
    ]
    assert [fine_substep_of(database) for database in stored] == [plain.substep] * 2


def test_too_fine_a_mesh_to_simulate_is_refused() -> None:
    text = '[[garment]]\nname = "s"\nmesh = "builtin:skirt"\ncoarse_subdivisions = 4\n'
    text += '[character]\nfile = "builtin:mannequin"\n'
    with pytest.raises(InputError, match="coarse_subdivisions: too fine a mesh to simulate.*received 4, expected 0..3"):
        GarmentSetup.of(parse_scene(text, "s"))


def test_a_delivered_fine_mesh_has_no_coarse_subdivisions(folder: Path) -> None:
    with pytest.raises(InputError, match="coarse_vertices says how fine") as caught:
        parse_scene(
            SCENE.replace("coarse_vertices = 60", "coarse_vertices = 60\ncoarse_subdivisions = 1"), folder / "s.toml"
        )
    assert "coarse_subdivisions" in str(caught.value)
