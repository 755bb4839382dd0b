import json
from dataclasses import fields, replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from assets.fabrics import PRESETS
from assets.io.body_settings import CharacterSettings, MotionSettings
from assets.io.collider_settings import CapsuleSettings, FieldSettings
from assets.io.scene import Scene, load_scene, parse_scene, scene_text
from pbd import Capsule, Fabric, InputError, SolverOptions
from pbd.wind import Wind
from tests.refusals import refuses

SKIRT = '[[garment]]\nname = "skirt"\nmesh = "builtin:skirt"\n'
FULL = """
[[garment]]
name = "dress"
mesh = "dress.obj"
pattern = true
fabric = { areal_density = 0.2, bend_warp = 0 }
subdivisions = 1
ease = [0.18, 0.05]
attach = [0, 2]
attach_vertices = [7]
pins = [5, 6]
limits = "limits.csv"
thickness = 0.002
pressure = 50

[[garment]]
name = "skirt"
mesh = "builtin:skirt"
attach = "top"

[character]
file = "builtin:mannequin"
clip = "walk"

[training]
clips = [{ file = "builtin:mannequin", clip = "walk" }]
held_out = [{ file = "builtin:mannequin", clip = "turn" }]
procedural_seconds = 20
substep = 0.001
fabrics = ["denim", "silk"]

[[collider]]
type = "plane"

[[collider]]
type = "sphere"
centre = [0, 1, 0]
radius = 0.1

[[collider]]
type = "capsule"
start = [0, 0, 0]
end = [0, 1, 0]
radius = 0.1

[[collider]]
type = "field"
mesh = "dress.obj"
spacing = 0.02
centre = [0, 1, 0]

[wind]
velocity = [1, 0, 0.5]
turbulence = 0.2
length = 3

[solver]
frame_rate = 50
substep = 0.002
gravity = [0, -1.62, 0]
coarse_sweeps = 2
self_collision = false
contact_refreshes = 100
local_damping = 2
linear_inertia = 0.5
angular_inertia = 0.25

[wrinkles]
hidden_width = 32
atoms = 16
seed = 3

[camera]
position = [0, 1, 4]
target = [0, 0.9, 0]
field_of_view_deg = 35
"""


@pytest.fixture
def load(tmp_path: Path):
    """Writes a scene file beside a garment and loads it."""
    (tmp_path / "dress.obj").touch()
    (tmp_path / "limits.csv").touch()
    (tmp_path / "bad.json").write_text("{}", encoding="utf-8")
    measured = {"density": 0.2, "stretching": [[1000, 0, 1000, 50]] * 6, "bending": [[4e-5] * 5] * 3}
    (tmp_path / "measured.json").write_text(json.dumps(measured), encoding="utf-8")

    def write_and_load(text: str) -> Scene:
        path = tmp_path / "scene.toml"
        path.write_text(text, encoding="utf-8")
        return load_scene(path)

    return write_and_load


def test_a_scene_without_a_file_of_its_own_is_read_in_the_working_folder(load, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert parse_scene(FULL) == load(FULL)
    refuses("scene.toml: garment", parse_scene, "")


def test_a_short_scene_has_the_defaults(load) -> None:
    scene = load(SKIRT)
    (skirt,) = scene.garments
    assert (skirt.mesh, skirt.subdivisions, skirt.attach, skirt.fabric) == ("builtin:skirt", None, "bands", Fabric())
    assert scene.character is None
    assert scene.solver.gravity == (0.0, -9.81, 0.0)


def test_a_fabric_comes_by_name_or_from_a_file(load) -> None:
    assert load(SKIRT + 'fabric = "denim"').garments[0].fabric == PRESETS["denim"]
    assert load(SKIRT + 'fabric = "measured.json"').garments[0].fabric.bend_warp == pytest.approx(1e-5)


def test_every_key_is_read(load, tmp_path: Path) -> None:
    scene = load(FULL)
    dress, skirt = scene.garments
    assert dress.mesh == (tmp_path / "dress.obj").resolve()
    assert dress.fabric == Fabric(areal_density=0.2, bend_warp=0)
    assert (dress.pattern, dress.subdivisions, dress.thickness) == (True, 1, 0.002)
    assert (dress.limits, dress.pressure) == ((tmp_path / "limits.csv").resolve(), 50.0)
    assert scene.wind.air() == Wind((1.0, 0.0, 0.5), 0.2, 3.0)
    assert (dress.ease, skirt.ease) == ((0.18, 0.05), (0.0, 0.0))
    assert (dress.attach, dress.attach_vertices, dress.pins, skirt.attach) == ((0, 2), (7,), (5, 6), "top")
    assert scene.character == CharacterSettings(file="builtin:mannequin", clip="walk")
    assert [motion.clip for motion in scene.training.clips + scene.training.held_out] == ["walk", "turn"]
    assert [collider.type for collider in scene.colliders] == ["plane", "sphere", "capsule", "field"]
    assert scene.colliders[2] == CapsuleSettings(start=(0.0, 0.0, 0.0), end=(0.0, 1.0, 0.0), radius=0.1)
    field = FieldSettings(mesh=(tmp_path / "dress.obj").resolve(), spacing=0.02, centre=(0.0, 1.0, 0.0))
    assert scene.colliders[3] == field
    primitive = scene.colliders[2].primitive()
    assert primitive == Capsule(start=(0.0, 0.0, 0.0), end=(0.0, 1.0, 0.0), radius=0.1)
    assert scene.solver.options() == SolverOptions(0.002, (0.0, -1.62, 0.0), 2, 100.0, False, 2.0, 0.5, 0.25)
    # No section is left at its defaults: each default would show that its keys went unread.
    sections = (scene.training, scene.wind, scene.solver, scene.wrinkles, scene.camera)
    for section in sections:
        unread = [
            one.name for one in fields(section) if getattr(section, one.name) == getattr(type(section)(), one.name)
        ]
        assert unread == [], type(section)


DRESS = """
[[garment]]
name = "dress"
mesh = "dress.obj"
pattern = true
seams = "stitches.csv"
coarse_vertices = 500

[character]
sequence = "dance.npz"

[training]
[[training.clips]]
file = "dance.npz"
end = 3.0
speed = 0.75

[[training.held_out]]
file = "dance.npz"
start = 3.0
"""


def test_seams_and_parts_of_a_sequence_are_read(load, tmp_path: Path) -> None:
    for name in ("stitches.csv", "dance.npz"):
        (tmp_path / name).touch()
    scene = load(DRESS)
    (dress,) = scene.garments
    assert dress.seams == (tmp_path / "stitches.csv").resolve() and dress.coarse_vertices == 500
    (learned,), (held_out,) = scene.training.clips, scene.training.held_out
    assert (learned.start, learned.end, learned.speed, learned.clip) == (0.0, 3.0, 0.75, None)
    assert (learned.name, held_out.name) == ("dance 0-3 s x 0.75", "dance 3- s")
    assert parse_scene(scene_text(scene), tmp_path / "again.toml") == scene


WORN = """
[[garment]]
name = "dress"
mesh = "dress.obj"

[character]
file = "woman.usdc"

[character.motion]
file = "walk.bvh"
joints = "joints.csv"
end = 2.0

[[training.clips]]
file = "dance.bvh"

[[training.clips]]
file = "woman.usdc"
clip = "run"
"""


def test_files_of_other_programs_are_read(load, tmp_path: Path) -> None:
    for name in ("woman.usdc", "walk.bvh", "dance.bvh", "joints.csv", "body.mdd", "body.pc2"):
        (tmp_path / name).touch()
    scene = load(WORN)
    assert scene.character is not None and scene.character.motion is not None
    motion = scene.character.motion
    assert (motion.name, motion.is_sequence, motion.joints) == (
        "walk 0-2 s",
        False,
        (tmp_path / "joints.csv").resolve(),
    )
    assert [clip.name for clip in scene.training.clips] == ["dance", "run"]
    assert parse_scene(scene_text(scene), tmp_path / "again.toml") == scene
    cached = load(SKIRT + '[character]\nsequence = "body.pc2"\nrate = 25\nmotion = { file = "body.mdd" }')
    assert (cached.character.rate, cached.character.motion.is_sequence) == (25.0, True)
    assert parse_scene(scene_text(cached), tmp_path / "again.toml") == cached
    assert MotionSettings(file="body.usdc").is_sequence and not MotionSettings(file="body.usdc", clip="run").is_sequence


@pytest.mark.parametrize(
    ("text", "old", "new", "message"),
    [
        (DRESS, "coarse_vertices = 500\n", "", r"garment\[0\]\.seams.*coarse_vertices"),
        (DRESS, "pattern = true\n", "", r"garment\[0\]\.pattern.*received False.*pattern = true"),
        (DRESS, "coarse_vertices = 500", "coarse_vertices = 3", r"coarse_vertices.*received 3.*at least 50"),
        (DRESS, "start = 3.0", "start = 3.0\nend = 2.0", r"held_out\[0\]\.end.*received 2\.0.*after the start, 3"),
        (DRESS, "start = 3.0", 'clip = "walk"', r"held_out\[0\]\.clip.*received 'walk'.*no clips"),
        (DRESS, "speed = 0.75", "speed = 0", r"clips\[0\]\.speed.*received 0.*above 0"),
        (DRESS, '"stitches.csv"', '"gone.csv"', r"garment\[0\]\.seams.*no such file"),
        (WORN, '"dance.bvh"', '"dance.bvh"\nclip = "a"',
         r"clips\[0\]\.clip.*received 'a'.*none: a captured motion has no"),
        (WORN, '"dance.bvh"', '"woman.glb"', r"clips\[0\]\.clip: bad clip \(expected name of a clip"),
        (WORN, '"dance.bvh"', '"body.pc2"', r"clips\[0\]\.rate: bad rate \(expected frames a second"),
        (WORN, '"dance.bvh"', '"dance.bvh"\nrate = 25', r"clips\[0\]\.rate: bad rate \(received 25\.0, expected none"),
        (WORN, 'clip = "run"', 'clip = "run"\njoints = "joints.csv"',
         r"clips\[1\]\.joints: bad joints.*only a captured"),
        (WORN, '"woman.usdc"\n\n', '"woman.usdc"\nclip = "run"\n\n', r"character\.clip: two motions \(received 'run'"),
        (WORN, '"woman.usdc"\n\n', '"walk.bvh"\n\n', r"character\.file: bad value.*\.glb or \.gltf or \.usd"),
        (WORN, 'file = "woman.usdc"\n\n', 'sequence = "walk.bvh"\n\n',
         r"character\.sequence: bad value.*\.npz or \.mdd"),
        (WORN, 'file = "woman.usdc"\n\n', 'sequence = "body.pc2"\n\n', r"character\.rate: bad rate"),
    ],
)  # fmt: skip
def test_files_and_parts_that_do_not_fit_are_refused(
    load, tmp_path: Path, text: str, old: str, new: str, message: str
) -> None:
    files = "stitches.csv", "dance.npz", "woman.usdc", "woman.glb", "walk.bvh", "dance.bvh", "joints.csv", "body.pc2"
    for name in files:
        (tmp_path / name).touch()
    assert old in text
    refuses(message, load, text.replace(old, new, 1))


@pytest.mark.parametrize(
    ("one", "other", "expected"),
    [
        ({}, {}, True),
        ({"end": 3.0}, {"start": 3.0}, False),
        ({"end": 3.1}, {"start": 3.0, "speed": 2.0}, True),
        ({"start": 1.0, "end": 2.0}, {"start": 4.0, "end": 5.0}, False),
        ({"clip": "walk"}, {"clip": "run"}, False),
    ],
)
def test_parts_of_one_clip_overlap_where_they_have_time_in_common(one: dict, other: dict, expected: bool) -> None:
    first, second = (MotionSettings(**({"file": "woman.glb", "clip": "walk"} | part)) for part in (one, other))
    assert first.overlaps(second) is second.overlaps(first) is expected


@pytest.mark.parametrize("text", [SKIRT, FULL], ids=["short", "full"])
def test_the_printed_scene_reads_back(load, text: str) -> None:
    scene = load(text)
    assert load(scene_text(scene)) == scene


def test_the_printed_scene_shows_defaults_with_units(load) -> None:
    printed = scene_text(load(SKIRT))
    assert "gravity = [0.0, -9.81, 0.0]  # [m/s2]" in printed
    assert "[garment.fabric]\nareal_density = 0.15" in printed


@given(name=st.text(st.characters(codec="utf-8", exclude_characters="\x7f"), min_size=1).filter(str.strip))
def test_any_name_survives_printing(name: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("scene") / "scene.toml"
    path.write_text(SKIRT, encoding="utf-8")
    scene = load_scene(path)
    named = replace(scene, garments=(replace(scene.garments[0], name=name),))
    path.write_text(scene_text(named), encoding="utf-8", newline="")
    assert load_scene(path) == named


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", ["garment: missing key"]),
        ("garment = []", ["garment: bad value", "at least 1"]),
        (SKIRT + "subdivision = 2", ["garment[0].subdivision: unknown key", "did you mean 'subdivisions'?"]),
        (SKIRT + "[solvr]", ["solvr: unknown key", "did you mean 'solver'?"]),
        (SKIRT + SKIRT, ["garment: the same name twice", "'skirt'"]),
        (SKIRT + "subdivisions = 1.5", ["received 1.5", "a whole number, at least 1"]),
        (SKIRT + "subdivisions = true", ["received True", "a whole number"]),
        (SKIRT + 'pattern = "yes"', ["received 'yes'", "true or false"]),
        (SKIRT + "thickness = 0", ["received 0", "a finite number above 0 [m]"]),
        (SKIRT + "thickness = nan", ["received nan"]),
        (SKIRT + "thickness = 1" + "0" * 400, ["garment[0].thickness: bad value"]),
        (SKIRT + "thickness = inf", ["received inf"]),
        (SKIRT + 'attach = "topp"', ["received 'topp'", "did you mean 'top'?"]),
        (SKIRT + 'attach = "band"', ["received 'band'", "did you mean 'bands'?"]),
        (SKIRT + 'fasten = "bands"', ["garment[0].fasten", "received 'bands'", "one of 'top', 'none'"]),
        (SKIRT + "ease = [0.1]", ["garment[0].ease: bad value", "received [0.1]", "two finite numbers"]),
        (SKIRT + "ease = [0.1, nan]", ["garment[0].ease: bad value", "two finite numbers, each at least -0.5"]),
        (SKIRT + "ease = [3, 0]", ["garment[0].ease: bad value", "at most 2"]),
        (SKIRT + "pins = [1, 1]", ["received [1, 1]", "different"]),
        (SKIRT + "pins = [-1]", ["received [-1]"]),
        (SKIRT + "fabric = { areal_density = -1 }", ["garment[0].fabric.areal_density", "received -1"]),
        (SKIRT + "fabric = { shear = nan, thickness = 0 }", ["fabric.shear", "fabric.thickness", "received nan"]),
        (SKIRT + "fabric = { sheer = 1 }", ["garment[0].fabric.sheer: unknown key", "did you mean 'shear'?"]),
        (SKIRT + 'fabric = "denin"', ["garment[0].fabric: bad value", "'denin'", "did you mean 'denim'?"]),
        (SKIRT + 'fabric = "absent.json"', ["garment[0].fabric: no such file", "absent.json"]),
        (SKIRT + 'fabric = "bad.json"', ["scene.toml: garment[0].fabric: ", "bad.json: density"]),
        (SKIRT + '[training]\nfabrics = ["denin"]', ["training.fabrics[0]", "'denin'", "did you mean 'denim'?"]),
        (SKIRT + '[training]\nfabrics = ["silk", "silk"]', ["training.fabrics: bad value", "different values"]),
        (SKIRT + '[training]\nfabrics = "silk"', ["training.fabrics: bad value", "a list of different values"]),
        (SKIRT + "fabric = 3", ["garment[0].fabric: bad value", "received 3"]),
        (SKIRT.replace("builtin:skirt", "builtin:skrt"), ["builtin:skrt", "did you mean 'builtin:skirt'?"]),
        (SKIRT.replace("builtin:skirt", "absent.obj"), ["no such file", "absent.obj"]),
        (SKIRT.replace("builtin:skirt", "bad.json"), ["garment[0].mesh: bad value", ".obj or .glb or .gltf"]),
        (SKIRT.replace("builtin:skirt", "${HOME}/a.obj"), ["unknown variable", "${GUBE_DATA}"]),
        (SKIRT + "[character]", ["character: missing key", "'file', 'sequence'"]),
        (SKIRT + '[character]\nfile = "dress.obj"', ["character.file", "received 'dress.obj'", ".glb"]),
        (SKIRT + "[[collider]]", ["collider[0].type", "'capsule'"]),
        (SKIRT + '[[collider]]\ntype = "sphere"', ["collider[0].centre: missing key", "collider[0].radius"]),
        (SKIRT + '[[collider]]\ntype = "field"\nspacing = 0', ["collider[0].mesh: missing key", "collider[0].spacing"]),
        (SKIRT + '[[collider]]\ntype = "field"\nmesh = "no.obj"', ["collider[0].mesh: no such file"]),
        (SKIRT + '[[collider]]\ntype = "plane"\nnormal = [0, 0, 0]', ["collider[0].normal", "not all zero"]),
        (SKIRT + "[wind]\nvelocity = [1, 2]", ["wind.velocity", "received [1, 2]", "three finite numbers [m/s]"]),
        (SKIRT + "[wind]\nturbulence = -1", ["wind.turbulence", "received -1", "at least 0"]),
        (SKIRT + "[solver]\nlinear_inertia = 2", ["solver.linear_inertia", "received 2", "at least 0, at most 1"]),
        (SKIRT + 'limits = "absent.csv"', ["garment[0].limits: no such file", "absent.csv"]),
        (SKIRT + "[camera]\nfield_of_view_deg = 180", ["camera.field_of_view_deg", "below 180 [deg]"]),
        (SKIRT + "solver = 3\n", ["garment[0].solver: unknown key"]),
        ("solver = 3\n" + SKIRT, ["solver: bad value", "received 3", "a table"]),
        ("garment = {", ["not TOML"]),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "scene",
)
def test_what_is_refused_and_how_it_is_said(load, text: str, parts: list[str]) -> None:
    message = refuses("", load, text)
    assert "scene.toml" in message
    for part in parts:
        assert part in message


def test_all_errors_are_reported_at_once(load) -> None:
    message = refuses(
        "",
        load,
        SKIRT
        + "thickness = -1\nfabric = { sheer = 1 }\n[character]\nfil = 1\n[solver]\nsubstep = 0\n[wind]\nspeed = 3",
    )
    for key in ("thickness", "fabric.sheer", "character", "character.fil", "solver.substep", "wind.speed"):
        assert f"{key}: " in message
    assert message.startswith("6 problems:")


def test_the_data_folder_comes_from_the_environment(load, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = tmp_path / "data"
    data.mkdir()
    (data / "shirt.obj").touch()
    text = SKIRT.replace("builtin:skirt", "${GUBE_DATA}/shirt.obj")
    monkeypatch.setenv("GUBE_DATA", str(data))
    assert load(text).garments[0].mesh == (data / "shirt.obj").resolve()
    monkeypatch.delenv("GUBE_DATA")
    here = tmp_path / "checkout"
    here.mkdir()
    monkeypatch.chdir(here)
    assert "shared/data/shirt.obj" in refuses("", load, text)


def test_a_missing_scene_file_is_bad_input(tmp_path: Path) -> None:
    refuses("absent.toml: cannot be read", load_scene, tmp_path / "absent.toml")


def test_clips_of_one_name_in_two_files_are_told_apart_by_a_label(tmp_path: Path) -> None:
    text = '[[garment]]\nname = "s"\nmesh = "builtin:skirt"\n[character]\nfile = "builtin:mannequin"\n'
    for name in ("walk", "run"):
        (tmp_path / f"{name}.glb").touch()
    text += '[[training.clips]]\nfile = "run.glb"\nclip = "mixamo.com"\n'
    held_out = '[[training.held_out]]\nfile = "walk.glb"\nclip = "mixamo.com"\n'
    with pytest.raises(InputError, match=r"two motions with the name 'mixamo.com' .*run\.glb.*label = "):
        parse_scene(text + held_out, tmp_path / "scene.toml")
    training = parse_scene(f'{text}{held_out}label = "walk"\n', tmp_path / "scene.toml").training
    assert [motion.name for motion in training.clips + training.held_out] == ["mixamo.com", "walk"]
