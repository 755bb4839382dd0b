"""The extension for Blender: its checks and jobs anywhere, its buttons in Blender itself (a proof)."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from assets.io.scene import load_scene
from assets.loading import load_character, load_garment
from assets.motion import ClipMotion
from assets.procedural.mannequin import builtin_mannequin
from assets.skinning import skin_vertices
from runtime.blender import checks, jobs
from runtime.export.animation_files import bake_obj, bake_usd
from tests.blender import POSED_VERTICES, require_blender
from tests.data import ROOT

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

EXTENSION = ROOT / "runtime" / "blender"


def box(height: float = 1.7) -> tuple[np.ndarray, np.ndarray]:
    """A closed box, Z up."""
    corners = np.array([[x, y, z] for z in (0, height) for y in (0, 0.3) for x in (0, 0.4)], float)
    quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [1, 3, 7, 5], [3, 2, 6, 7], [2, 0, 4, 6]]
    return corners, np.array([face for a, b, c, d in quads for face in ([a, b, c], [a, c, d])])


def tube(count: int = 60, closed: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """A tube open at both ends, or with its ends closed by one point each."""
    angle = np.linspace(0, 2 * np.pi, count // 2, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    vertices = np.concatenate([ring, ring + [0, 0, 1]])
    a = np.arange(count // 2)
    b, up = np.roll(a, -1), count // 2
    faces = [np.stack([a, b, b + up], 1), np.stack([a, b + up, a + up], 1)]
    if closed:
        vertices = np.concatenate([vertices, [[0, 0, 0], [0, 0, 1]]])
        faces += [np.stack([b, a, 0 * a + count], 1), np.stack([a + up, b + up, 0 * a + count + 1], 1)]
    return vertices, np.concatenate(faces)


ONE = np.ones(3)


@pytest.mark.parametrize(
    ("findings", "words"),
    [
        (lambda: checks.check_body(*box()), []),
        (lambda: checks.check_body(*box(170.0)), ["170.00 m tall: scale it to 0.5 to 3 m and apply the scale"]),
        (lambda: checks.check_body(box()[0], box()[1][:-2]), ["borders of holes: fill the holes (F)"]),
        (lambda: checks.check_garment(*tube(), ONE), []),
        (lambda: checks.check_garment(*tube(), 0.01 * ONE), ["apply it (Ctrl A, Scale)"]),
        (lambda: checks.check_garment(*tube(60, True), ONE), ["a garment needs openings"]),
        (lambda: checks.check_garment(*tube(20), ONE), ["20 vertices: subdivide it to at least 50"]),
        (lambda: checks.check_garment(*tube(20_002), ONE), ["decimate it to at most 20000"]),
        (
            lambda: checks.check_garment(tube()[0], np.concatenate([tube()[1], [[0, 31, 5]]]), ONE),
            ["1 edges of the garment have more than two faces: remove inner faces"],
        ),
        (lambda: [checks.check_fit(np.zeros(50))], []),
        (lambda: [checks.check_fit(np.r_[np.zeros(97), 0.01 * np.ones(3)])], []),
        (lambda: [checks.check_fit(np.r_[np.zeros(97), 0.03 * np.ones(3)])], ["30 mm at most: fit the garment"]),
        (lambda: [checks.check_fit(0.001 * np.ones(20))], ["100.0 % of the garment lie inside"]),
        (lambda: [checks.check_motion(1.0, 61.0, 30.0)], []),
        (lambda: [checks.check_motion(None, None, 30.0)], ["no action: assign one"]),
        (lambda: [checks.check_motion(1.0, 16.0, 30.0)], ["takes 0.5 s: at least 2 s are needed"]),
    ],
)
def test_what_fails_says_what_to_do(findings: Any, words: list[str]) -> None:
    failed = [finding.text for finding in findings() if not finding.passed]
    assert len(failed) == len(words)
    for text, word in zip(failed, words, strict=True):
        assert word in text


def test_seams_of_a_body_are_no_holes() -> None:
    vertices, faces = box()
    assert all(
        finding.passed for finding in checks.check_body(vertices[faces.ravel()], np.arange(faces.size).reshape(-1, 3))
    )


def python(script: str) -> list[str]:
    return [sys.executable, "-c", script]


def test_a_job_runs_one_command_after_the_other(tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    job = jobs.Job([python(f"open({str(mark)!r}, 'w').write('a')"), python(f"print(open({str(mark)!r}).read() + 'b')")])
    job.wait()
    assert (job.error, job.line, job.running) == (None, "ab", False)


def test_a_job_that_fails_says_what_the_command_said() -> None:
    job = jobs.Job([["gube-that-is-not-there", "precompute"]])
    job.wait()
    assert job.error is not None and "gube-that-is-not-there cannot be run" in job.error
    assert "preferences" in job.error
    job = jobs.Job([python("import sys; print('no such file', file=sys.stderr); sys.exit(2)"), python("print('on')")])
    job.wait()
    assert job.error is not None and job.error.endswith("failed: no such file")


def test_a_job_is_stopped() -> None:
    job = jobs.Job([python("import time; print('begun', flush=True); time.sleep(60)"), python("print('on')")])
    while not job.line:
        assert job.running
    job.stop()
    job.wait()
    assert (job.line, job.error) == ("begun", "stopped")


def test_commands_learn_and_bake_the_whole_clip(tmp_path: Path) -> None:
    learn, bake = jobs.commands("gube", tmp_path / "scene.toml", "Animation", 24.0)
    assert learn[1:] == ["precompute", str(tmp_path / "scene.toml"), "-o", str(tmp_path / "garment.h5")]
    assert bake[1] == "bake" and bake[-4:] == ["--clip", "Animation", "--rate", "24"]
    from runtime.cli.command import COMMANDS

    assert {learn[1], bake[1]} <= set(COMMANDS)


def test_the_garment_is_written_with_its_texture_coordinates(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A triangle and a square with a seam between them, as Blender's objects give them; Z is up there."""
    uv = [(0.0, 0.25), (1.0, 0.25), (0.0, 0.75), (3.0, 3.0), (4.0, 3.0), (4.0, 4.0), (3.0, 4.0)]
    mesh = SimpleNamespace(
        vertices=[SimpleNamespace(co=place) for place in ((0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1), (0.5, 0, -1))],
        polygons=[
            SimpleNamespace(vertices=[1, 0, 4], loop_indices=range(3)),
            SimpleNamespace(vertices=[0, 1, 2, 3], loop_indices=range(3, 7)),
        ],
        uv_layers=SimpleNamespace(active=SimpleNamespace(data=[SimpleNamespace(uv=place) for place in uv])),
    )
    shown = SimpleNamespace(to_mesh=lambda: mesh, to_mesh_clear=lambda: None, matrix_world=np.eye(4))
    context = SimpleNamespace(evaluated_depsgraph_get=lambda: None)
    monkeypatch.setitem(sys.modules, "bpy", SimpleNamespace(context=context))
    monkeypatch.setitem(sys.modules, "runtime.blender.files", None)
    monkeypatch.delitem(sys.modules, "runtime.blender.files")
    files = importlib.import_module("runtime.blender.files")
    files._write_obj(tmp_path / "a.obj", SimpleNamespace(evaluated_get=lambda graph: shown))
    garment = load_garment(tmp_path / "a.obj")
    np.testing.assert_array_equal(garment.vertices[2], [1, 1, 0])
    assert garment.texture[0].tolist() == [list(place) for place in uv[:3]]
    square = garment.vertices[garment.faces[1:]][..., :2] + 3.0
    np.testing.assert_array_equal(garment.texture[1:], square)
    mesh.uv_layers.active = None
    files._write_obj(tmp_path / "b.obj", SimpleNamespace(evaluated_get=lambda graph: shown))
    assert load_garment(tmp_path / "b.obj").texture is None


def test_the_manifest_is_that_of_this_version() -> None:
    manifest = tomllib.loads((EXTENSION / "blender_manifest.toml").read_text())
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert manifest["version"] == project["version"] and manifest["type"] == "add-on"
    assert len(manifest["tagline"]) <= 64 and not manifest["tagline"].endswith(".")


SCRIPT = (
    POSED_VERTICES
    + """
import sys
import types

archive, folder, gube, what = sys.argv[1:]
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.extensions.package_install_files(filepath=archive, repo="user_default", enable_on_install=True)
bpy.context.preferences.addons["bl_ext.user_default.gube"].preferences.command = gube
scene = bpy.context.scene
scene.render.fps = 30
bpy.ops.wm.usd_import(filepath=folder + "/mannequin.usdc")
bpy.data.objects.remove(bpy.data.objects["garment"])
bpy.ops.wm.obj_import(filepath=folder + "/skirt_0000.obj", forward_axis="NEGATIVE_Z", up_axis="Y")
skirt = bpy.context.selected_objects[0]
skirt.name = 'skirt "A"'
bpy.ops.wm.save_as_mainfile(filepath=folder + "/scene.blend")
bpy.ops.wm.open_mainfile(filepath=folder + "/scene.blend")
scene = bpy.context.scene
settings = scene.gube
print("NOTHING", bpy.ops.gube.check(), settings.findings)
settings.armature = next(item for item in scene.objects if item.type == "ARMATURE")
settings.garment = skirt = scene.objects['skirt "A"']
settings.fabric, settings.attach = "denim", "top"
print("CHECK", bpy.ops.gube.check(), settings.findings.replace("\\n", "|"))
skirt.location.y += 0.1
bpy.context.view_layer.update()
print("MOVED", bpy.ops.gube.check(), settings.findings.replace("\\n", "|"))
skirt.location.y -= 0.1
bpy.context.view_layer.update()

class Layout:
    drawn = []

    def prop(self, data, name):
        self.drawn.append(data.bl_rna.properties[name].name)

    def operator(self, name):
        self.drawn.append(getattr(getattr(bpy.ops, name.split(".")[0]), name.split(".")[1]).get_rna_type().name)

    def label(self, text, icon="NONE"):
        self.drawn.append(icon + " " + text[:24])

bpy.types.VIEW3D_PT_gube.draw(types.SimpleNamespace(layout=Layout()), bpy.context)
print("PANEL", "|".join(Layout.drawn))

if what == "write":
    print("WRITE", bpy.ops.gube.write(), settings.status)
    body = next(item for item in scene.objects if item.type == "MESH" and item != skirt)
    frames = []
    for number in (0, 7, 20):
        scene.frame_set(number)
        frames.append(posed_vertices(body))
    np.savez(folder + "/truth.npz", body=np.array(frames), skirt=posed_vertices(skirt))
else:
    print("LEARN", bpy.ops.gube.learn(), settings.status)
    shown = scene.objects['skirt "A" (gube)']
    modifier = shown.modifiers["gube"]
    scene.frame_set(int(modifier.frame_start + 15))
    np.save(folder + "/shown.npy", posed_vertices(shown))
    print("SHOWN", modifier.frame_start, skirt.hide_render)
"""
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two seconds of the mannequin's walk, the skirt, and the extension's archive."""
    require_blender()
    path = tmp_path_factory.mktemp("blender")
    mannequin, skirt = builtin_mannequin(), load_garment("builtin:skirt")
    motion = ClipMotion(mannequin, "walk", blend=0.0)
    poses = np.array([motion.pose(k / 30) for k in range(61)])
    frames = skirt.vertices.astype(np.float32)[None]
    bake_usd(path / "mannequin.usdc", skirt.faces, frames.repeat(61, axis=0), 30.0, body=mannequin, poses=poses)
    bake_obj(path / "skirt.obj", skirt.faces, frames)
    with zipfile.ZipFile(path / "gube_blender.zip", "w") as archive:
        for file in EXTENSION.iterdir():
            if file.is_file():
                archive.write(file, file.name)
    return path


def in_blender(folder: Path, what: str) -> dict[str, str]:
    """What the script printed, by its first word."""
    gube = Path(sys.executable).with_name("gube")
    if not gube.exists():
        gube = ROOT / ".venv" / "bin" / "gube"
    command = [sys.executable, "-c", SCRIPT, str(folder / "gube_blender.zip"), str(folder), str(gube), what]
    environment = os.environ | {"BLENDER_USER_RESOURCES": str(folder / "user")}
    result = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=3600)
    lines = [line.partition(" ") for line in result.stdout.splitlines()]
    said = {word: rest for word, _, rest in lines if word.isupper()}
    assert result.returncode == 0, result.stdout + result.stderr
    return said


@pytest.mark.proof
def test_blender_checks_and_writes_a_scene(folder: Path) -> None:
    said = in_blender(folder, "write")
    assert said["NOTHING"] == "{'FINISHED'} -Choose an armature and a garment"
    passed = said["CHECK"].removeprefix("{'FINISHED'} ").split("|")
    assert len(passed) == 8 and all(finding.startswith("+") for finding in passed)
    (failed,) = [finding for finding in said["MOVED"].split("|") if finding.startswith("-")]
    assert "inside the body" in failed and "fit the garment to the rest pose" in failed
    panel = said["PANEL"].split("|")
    assert panel[:8] == [
        "Armature",
        "Garment",
        "Fabric",
        "Held by",
        "Folder",
        "Check",
        "Write scene file",
        "Learn and bake",
    ]
    assert panel[8] == "CHECKMARK The body is 1.70 m tall" and any(text.startswith("ERROR ") for text in panel[8:])
    assert said["WRITE"] == f"{{'FINISHED'}} wrote {folder / 'gube' / 'scene.toml'}"
    scene = load_scene(folder / "gube" / "scene.toml")
    assert (scene.garments[0].name, scene.garments[0].attach) == ('skirt "A"', "top")
    with np.load(folder / "truth.npz") as truth:
        garment = load_garment(scene.garments[0].mesh)
        np.testing.assert_allclose(garment.vertices, truth["skirt"], atol=1e-6)
        body = load_character(str(scene.character and scene.character.file))
        clip = body.clip("Animation")
        assert clip.frame_count == 61 and round(clip.rate) == 30
        for number, expected in zip((0, 7, 20), truth["body"], strict=True):
            pose = body.pose_from_local(clip.translation[number], clip.rotation[number], clip.scale[number])
            np.testing.assert_allclose(skin_vertices(body, pose), expected, atol=1e-4)


@pytest.mark.proof
def test_blender_learns_and_shows_the_result(folder: Path) -> None:
    said = in_blender(folder, "learn")
    assert said["LEARN"].startswith("{'FINISHED'} Animation: ")
    start, hidden = said["SHOWN"].split()
    assert (float(start), hidden) == (0.0, "True")
    data = (folder / "gube" / "result.pc2").read_bytes()
    count = int.from_bytes(data[16:20], "little")
    frames = np.frombuffer(data[32:], "<f4").reshape(-1, count, 3)
    assert len(frames) == 61  # the action, without what leads to its first frame
    np.testing.assert_allclose(np.load(folder / "shown.npy"), frames[15], atol=1e-5)
