"""Bodies that are inside out are refused by every reader; open surfaces, of which either side may be meant, are not."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Usd, UsdGeom, Vt

import assets.io.usd
from assets.body_checks import check_right_side_out
from assets.io.converted import write_garment
from assets.io.sequence import load_sequence
from assets.loading import load_character, load_garment, load_standing_body
from tests.assets.files import Glb
from tests.refusals import refuses
from tests.wrinkles.meshes import icosphere, tube

BALL, FACES = icosphere(1, 0.3)
BALL = (BALL + [5.0, 1.0, 0.0]).astype(np.float32)  # far from the origin: the volume does not hang on it
FACES = FACES.astype(np.int32)
INWARD = FACES[:, ::-1]


def npz(folder: Path, faces: np.ndarray) -> Path:
    np.savez(folder / "ball.npz", vertices=BALL[None], faces=faces, dt=0.1)
    return folder / "ball.npz"


def mdd(folder: Path, faces: np.ndarray) -> Path:
    write_garment(folder / "ball.obj", BALL.astype(float), faces, None, "ball")
    data = struct.pack(">iif", 1, len(BALL), 0.0) + BALL.astype(">f4").tobytes()
    (folder / "ball.mdd").write_bytes(data)
    return folder / "ball.mdd"


def pc2(folder: Path, faces: np.ndarray) -> Path:
    write_garment(folder / "ball.obj", BALL.astype(float), faces, None, "ball")
    header = struct.pack("<12siiffi", b"POINTCACHE2\0", 1, len(BALL), 0.0, 1.0, 1)
    (folder / "ball.pc2").write_bytes(header + BALL.tobytes())
    return folder / "ball.pc2"


def obj(folder: Path, faces: np.ndarray) -> Path:
    write_garment(folder / "ball.obj", BALL.astype(float), faces, None, "ball")
    return folder / "ball.obj"


def usd(folder: Path, faces: np.ndarray) -> Path:
    stage: Any = Usd.Stage.CreateNew(str(folder / "ball.usda"))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    mesh = UsdGeom.Mesh.Define(stage, "/ball")
    for code in (0, 1):
        mesh.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy(BALL), code)
    mesh.CreateFaceVertexCountsAttr([3] * len(faces))
    mesh.CreateFaceVertexIndicesAttr(faces.ravel().tolist())
    stage.Save()
    return folder / "ball.usda"


def ball_glb(faces: np.ndarray, scale: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> Glb:
    """The ball on one joint, which is scaled together with the mesh."""
    glb, count = Glb(), len(BALL)
    attributes = {
        "POSITION": glb.accessor(BALL),
        "JOINTS_0": glb.accessor(np.zeros((count, 4)), "uint8"),
        "WEIGHTS_0": glb.accessor(np.tile([1, 0, 0, 0], (count, 1))),
    }
    glb.json |= {
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [
            {"name": "armature", "scale": list(scale), "children": [1, 2]},
            {"name": "root"},
            {"name": "ball", "mesh": 0, "skin": 0},
        ],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": glb.accessor(faces.ravel(), "uint16")}]}],
        "skins": [{"joints": [1]}],
    }
    return glb


def glb(folder: Path, faces: np.ndarray) -> Path:
    return ball_glb(faces).write(folder / "ball.glb")


@pytest.fixture(autouse=True)
def unguarded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(assets.io.usd, "require_sound", lambda path: None)


READERS: list[tuple[Callable[[Path, np.ndarray], Path], Callable[[Path], Any]]] = [
    (npz, load_sequence),
    (mdd, load_sequence),
    (pc2, lambda path: load_sequence(path, 25.0)),
    (usd, load_sequence),
    (glb, load_character),
    *((write, load_standing_body) for write in (npz, mdd, usd, glb, obj)),
]


@pytest.mark.parametrize(("write", "load"), READERS)
def test_every_reader_refuses_a_body_that_is_inside_out(
    tmp_path: Path, write: Callable[[Path, np.ndarray], Path], load: Callable[[Path], Any]
) -> None:
    body = load(write(tmp_path, FACES))
    assert volume(np.asarray(body.vertices, float).reshape(-1, len(BALL), 3)[0], body.faces) > 0.09
    refuses(r"ball\.\w+: faces: a body that is inside out \(expected normals that point", load, write(tmp_path, INWARD))


def test_a_mirrored_skin_is_turned_as_its_format_says(tmp_path: Path) -> None:
    """Mirrored, faces that run counter-clockwise run clockwise: glTF turns them back, as it does without a skin."""
    path = ball_glb(FACES, (-1.0, 1.0, 1.0)).write(tmp_path / "ball.glb")
    for body in (load_character(path), load_garment(path)):
        np.testing.assert_allclose(body.vertices[:, 0].mean(), -5.0, atol=1e-5)
        assert volume(body.vertices, body.faces) > 0.09
    refuses("inside out", load_character, ball_glb(INWARD, (-1.0, 1.0, 1.0)).write(path))


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    return float(np.linalg.det(vertices[faces] - vertices.mean(axis=0)).sum()) / 6.0


@pytest.mark.parametrize("turned", [1, -1])
def test_open_surfaces_pass_whichever_way_they_face(turned: int) -> None:
    bowl = FACES[BALL[FACES].mean(axis=1)[:, 1] < 1.0]
    sheet = np.array([[0, 0, 0], [1, 0, 0], [1, 0.1, 1], [0, 0, 1]], float), np.array([[0, 2, 1], [0, 3, 2]])
    for vertices, faces in ((BALL.astype(float), bowl), tube(16), sheet):
        check_right_side_out(vertices, faces[:, ::turned].astype(np.int32), Path("body.npz"))


def test_small_holes_and_corners_that_are_not_joined_do_not_hide_it() -> None:
    soup = BALL.astype(float)[INWARD].reshape(-1, 3), np.arange(3 * len(FACES), dtype=np.int32).reshape(-1, 3)
    for vertices, faces in (soup, (BALL.astype(float), INWARD[1:])):
        refuses("inside out", check_right_side_out, vertices, faces, Path("body.npz"))
