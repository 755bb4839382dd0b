"""Garments from files: welding, triangles, boundaries, and every refusal with the element named."""

import re
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from assets.garment import Garment, boundary_loops, highest_loop
from assets.io.obj import read_obj, triangulate
from assets.loading import load_garment
from assets.weld import weld
from pbd.errors import InputError
from tests.assets.files import Glb
from tests.data import data_path
from tests.refusals import refuses

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def load(folder: Path, text: str, pattern: bool = False) -> Garment:
    path = folder / "cloth.obj"
    path.write_text(text)
    return load_garment(path, pattern=pattern)


def tube(rings: int = 4, around: int = 6) -> tuple[np.ndarray, np.ndarray]:
    """An open tube about Y, wound outwards."""
    angle = np.arange(around) * 2 * np.pi / around
    ring = np.stack([np.sin(angle), np.zeros(around), np.cos(angle)], axis=1)
    vertices = np.concatenate([ring + [0, height, 0] for height in np.linspace(0, 1, rings)])
    faces = []
    for level in range(rings - 1):
        for k in range(around):
            a, b = level * around + k, level * around + (k + 1) % around
            faces += [[a, b, b + around], [a, b + around, a + around]]
    return vertices, np.array(faces, dtype=np.int32)


def obj_text(vertices: np.ndarray, faces: np.ndarray) -> str:
    lines = [f"v {x} {y} {z}" for x, y, z in vertices.tolist()]
    return "\n".join(lines + [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]) + "\n"


def test_weld_keeps_the_order_and_says_what_became_of_each_vertex() -> None:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 0, 0], [2, 0, 0], [1, 0, 0], [-0.0, 0, 0]])
    welded, faces, index_map = weld(vertices, np.array([[0, 1, 3], [5, 4, 3]], dtype=np.int32))
    assert welded.tolist() == [[0, 0, 0], [1, 0, 0], [2, 0, 0]]
    assert index_map.tolist() == [0, 1, 0, 2, 1, 0]
    assert faces.tolist() == [[0, 1, 2], [0, 1, 2]]
    assert np.array_equal(welded[index_map], vertices)


@pytest.mark.parametrize("spikes", [0.0, 0.3, 0.9])
def test_a_face_of_many_corners_is_cut_inside_at_once(spikes: float) -> None:
    """When the cost grew with the cube of the corners, these 600 took minutes."""
    angle = np.linspace(0.0, 2.0 * np.pi, 600, endpoint=False)
    radius = 1.0 + spikes * np.random.default_rng(1).uniform(-1.0, 1.0, 600)
    corners = np.stack([radius * np.cos(angle), 0.0 * angle, radius * np.sin(angle)], axis=1)
    began = time.process_time()
    triangles = np.array(triangulate(corners))
    assert time.process_time() - began < 2.0
    assert triangles.shape == (598, 3) and len(np.unique(triangles)) == 600
    sides = corners[triangles[:, 1:]] - corners[triangles[:, :1]]
    areas = -np.cross(sides[:, 0], sides[:, 1])[:, 1] / 2.0  # seen from above the polygon runs clockwise
    following = np.roll(corners, -1, axis=0)
    outline = (corners[:, 0] * following[:, 2] - corners[:, 2] * following[:, 0]).sum() / 2.0
    assert (areas > 0.0).all() and areas.sum() == pytest.approx(outline)


def test_corners_along_straight_sides_make_no_face_without_area(tmp_path: Path) -> None:
    """A triangle traced from a drawing, to a micrometre: corners of a side turn a little by rounding alone."""
    share = np.arange(100)[:, None] / 100.0
    ends = np.array([[0.0, 0.0], [0.5, 0.0], [0.3, 0.7]])
    corners = np.concatenate([(1.0 - share) * a + share * b for a, b in zip(ends, np.roll(ends, -1, 0), strict=True)])
    face = " ".join(map(str, range(1, len(corners) + 1)))
    traced = load(tmp_path, "".join(f"v {x:.6f} {y:.6f} 0\n" for x, y in corners) + f"f {face}\n")
    assert len(traced.faces) == 298


def test_texture_seams_of_an_obj_file_close(tmp_path: Path) -> None:
    """Two triangles that share an edge of the mesh, but not of the texture."""
    text = SQUARE + "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvt 5 5\nvt 6 6\nf 1/1 2/2 3/3\nf 1/5 3/6 4/4\n"
    square = load(tmp_path, text)
    assert (square.name, square.vertices.shape, square.faces.tolist()) == ("cloth", (4, 3), [[0, 1, 2], [0, 2, 3]])
    assert square.pattern is None
    assert square.source.endswith("cloth.obj")


def test_a_pattern_keeps_the_texture_of_each_corner(tmp_path: Path) -> None:
    text = SQUARE + "vt 0 0\nvt 1 0\nvt 1 1\nvt 3 0\nvt 4 1\nvt 3 1\nf 1/1 2/2 3/3\nf 1/4 3/5 4/6\n"
    pattern = load(tmp_path, text, pattern=True).pattern
    assert pattern.tolist() == [[[0, 0], [1, 0], [1, 1]], [[3, 0], [4, 1], [3, 1]]]


def test_split_vertices_close_except_between_the_panels_of_a_pattern(tmp_path: Path) -> None:
    """Two squares side by side, the common side written twice."""
    text = SQUARE + "v 1 0 0\nv 2 0 0\nv 2 1 0\nv 1 1 0\n"
    text += "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 4/4\nf 5/1 6/2 7/3 8/4\n"
    assert len(load(tmp_path, text).vertices) == 6
    assert len(load(tmp_path, text, pattern=True).vertices) == 8  # to be stitched


def test_unused_vertices_are_dropped(tmp_path: Path) -> None:
    assert load(tmp_path, "v 9 9 9\n" + SQUARE + "v 7 7 7\nf 2 3 4\n").vertices.tolist() == [
        [0, 0, 0],
        [1, 0, 0],
        [1, 1, 0],
    ]


def test_faces_that_disagree_are_turned_with_their_pattern(tmp_path: Path) -> None:
    vertices, faces = tube()
    wrong = faces.copy()
    wrong[[3, 4, 17]] = wrong[[3, 4, 17]][:, [0, 2, 1]]
    assert np.array_equal(load(tmp_path, obj_text(vertices, wrong)).faces, faces)
    text = SQUARE + "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3\nf 1/1 4/4 3/3\n"
    square = load(tmp_path, text, pattern=True)
    assert square.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert square.pattern[1].tolist() == [[0, 0], [1, 1], [0, 1]]


def test_obj_details(tmp_path: Path) -> None:
    """Comments, continued lines, negative indices, normals, materials and lines of other kinds."""
    text = "# cloth\nmtllib a.mtl\no one\n" + SQUARE + "vn 0 0 1\nusemtl a\nf -4//1 -3//1 \\\n -2//1 # half\ns off\n"
    text += "usemtl b\nf 1//1 3//1 4//1\nl 1 2\n"
    assert load(tmp_path, text).faces.tolist() == [[0, 1, 2], [0, 2, 3]]


def test_polygons_are_cut_into_triangles_also_where_they_are_not_convex() -> None:
    # An L of area 3 whose inner corner (1, 1) no triangle may reach across, an arrow head, and a slit.
    corner_shape = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]], dtype=float)
    arrow = np.array([[0, 0], [2, 1], [0, 2], [1, 1]], dtype=float)
    slit = np.array([[0, 0], [4, 0], [4, 2], [2.2, 2], [2, 0.5], [1.8, 2], [0, 2]], dtype=float)
    for polygon, whole in ((corner_shape, 3.0), (arrow, 1.0), (slit, 7.7), (corner_shape[::-1], -3.0)):
        triangles = triangulate(np.c_[polygon, np.zeros(len(polygon))])
        assert len(triangles) == len(polygon) - 2
        signed = area(polygon, triangles)
        assert (np.sign(signed) == np.sign(whole)).all()  # wound alike, so equal areas mean no overlap
        assert signed.sum() == pytest.approx(whole)


def test_a_quad_is_cut_along_its_shorter_diagonal() -> None:
    kite = np.array([[0.0, 0, 0], [1, -0.5, 0], [4, 0, 0], [1, 0.5, 0]])
    assert {tuple(sorted(t)) for t in triangulate(kite)} == {(0, 1, 3), (1, 2, 3)}


@settings(max_examples=50, deadline=None)
@given(st.integers(3, 9), st.integers(0, 1000))
def test_triangles_of_a_convex_polygon_fill_it(count: int, seed: int) -> None:
    angles = np.sort(np.random.default_rng(seed).uniform(0, 2 * np.pi, count))
    polygon = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    triangles = triangulate(np.c_[polygon, np.zeros(count)])
    x, y = polygon.T
    shoelace = (x * np.roll(y, -1) - np.roll(x, -1) * y).sum() / 2
    assert np.abs(area(polygon, triangles)).sum() == pytest.approx(shoelace, abs=1e-9)


def test_boundary_loops_of_a_tube() -> None:
    vertices, faces = tube()
    loops = boundary_loops(faces)
    assert sorted(sorted(loop.tolist()) for loop in loops) == [list(range(6)), list(range(18, 24))]
    sides = {(a, b) for face in faces.tolist() for a, b in zip(face, face[1:] + face[:1], strict=True)}
    for loop in loops:  # ordered, closed, and along the faces
        assert all((a, b) in sides for a, b in zip(loop.tolist(), np.roll(loop, -1).tolist(), strict=True))
    assert sorted(highest_loop(vertices, faces).tolist()) == list(range(18, 24))


def test_the_longest_loop_comes_first_and_a_closed_mesh_has_none() -> None:
    _, faces = tube(around=6)
    fewer = faces[1:]  # a hole that joins the lower boundary
    assert [len(loop) for loop in boundary_loops(fewer)] == [7, 6]
    tetrahedron = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], dtype=np.int32)
    assert boundary_loops(tetrahedron) == []
    refuses("without openings", highest_loop, np.eye(4)[:, :3], tetrahedron)


def test_loops_that_touch_at_a_vertex_stay_apart() -> None:
    bow_tie = np.array([[0, 1, 2], [0, 3, 4]], dtype=np.int32)
    assert sorted(sorted(loop.tolist()) for loop in boundary_loops(bow_tie)) == [[0, 1, 2], [0, 3, 4]]


def test_boundary_loops_refuse_faces_that_disagree() -> None:
    with pytest.raises(InputError, match="edge 0-1: faces that run along an edge in the same direction"):
        boundary_loops(np.array([[0, 1, 2], [0, 1, 3]], dtype=np.int32))


def area(polygon: np.ndarray, triangles: list[tuple[int, int, int]]) -> np.ndarray:
    """Signed areas of triangles in the plane."""
    a, b, c = (polygon[np.array(triangles)[:, k]] for k in range(3))
    (x, y), (u, v) = (b - a).T, (c - a).T
    return (x * v - y * u) / 2


MOEBIUS = "v 0 0 0\nv 1 0 0\nv 2 1 0\nv 1 2 0.5\nv 0 1 1\nf 1 2 3\nf 2 3 4\nf 3 4 5\nf 4 5 1\nf 5 1 2\n"

REFUSED = {
    "empty": ("", "a mesh without faces"),
    "points": (SQUARE, "a mesh without faces (received '4 vertices', expected a whole file with faces)"),
    "nan": ("v 0 0 nan\n" + SQUARE, "line 1: a number that is not finite"),
    "infinite": (SQUARE + "v 0 inf 0\n", "line 5: a number that is not finite"),
    "short vertex": ("v 0 0\n", "line 1: fewer than 3 numbers"),
    "word": ("v 0 zero 0\n", "line 1: could not convert string to float: 'zero'"),
    "out of range": (SQUARE + "f 1 2 3\nf 1 2 9\n", "line 6: a face with a vertex that does not exist (received 9"),
    "zero": (SQUARE + "f 0 1 2\n", "line 5: index 0 is out of range"),
    "before the first": (SQUARE + "f -5 1 2\n", "line 5: index -5 is out of range"),
    "texture": (SQUARE + "vt 0 0\nf 1/1 2/1 3/2\n", "line 6: a face with a texture coordinate that does not exist"),
    "short face": (SQUARE + "f 1 2\n", "line 5: a face with fewer than three corners"),
    "same corner": (SQUARE + "f 1 2 3\nf 1 1 3\n", "face 1 (line 6): a face without area"),
    "in a line": ("v 0.1 0.1 0.1\nv 0.2 0.2 0.2\nv 0.7 0.7 0.7\nf 1 2 3\n", "face 0 (line 4): a face without area"),
    "twice": (SQUARE + "f 1 2 3\nf 1 3 4\nf 3 1 2\n", "face 2 (line 7): the same face as face 0 (line 5)"),
    "both sides": (SQUARE + "f 1 2 3\nf 1 3 2\n", "face 1 (line 6): the same face as face 0 (line 5)"),
    "three faces": (
        SQUARE + "v 0 0 1\nf 1 2 3\nf 1 3 4\nf 1 3 5\n",
        "edge 0-2: an edge of 3 faces: face 0 (line 6), face 1 (line 7), face 2 (line 8)",
    ),
    "one side": (MOEBIUS, "edge 0-4: a surface with one side only"),
    "centimetres": (obj_text(tube()[0] * 45, tube()[1]), "looks like centimetres (multiply by 0.01)"),
    "millimetres": (obj_text(tube()[0] * 450, tube()[1]), "looks like millimetres (multiply by 0.001)"),
    "tiny": (obj_text(tube()[0] * 0.004, tube()[1]), "looks like metres that were scaled by 0.01 (multiply by 100)"),
    "huge": (obj_text(tube()[0] * 1e6, tube()[1]), "not in metres (received '2e+06', expected 0.01 to 10 m)"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused(case: str, tmp_path: Path) -> None:
    text, message = REFUSED[case]
    assert "cloth.obj" in refuses(re.escape(message), load, tmp_path, text)


@pytest.mark.parametrize(
    ("texture", "message"),
    [
        ("f 1 2 3\n", "pattern: no texture coordinates to take a pattern from"),
        ("vt 0 0\nvt 1 0\nvt 1 1\nf 1/1 2/2 3/3\nf 1 3 4\n", "pattern: no texture coordinates to take a pattern from"),
        ("vt 0 0\nvt 1 0\nvt 2 0\nf 1/1 2/2 3/3\n", "face 0 (line 8): a face without area in the pattern"),
        ("vt 0 0\nvt .1 0\nvt .1 .1\nf 1/1 2/2 3/3\n", "pattern: texture coordinates that are no flat pattern"),
    ],
)
def test_no_pattern(texture: str, message: str, tmp_path: Path) -> None:
    refuses(re.escape(message), load, tmp_path, SQUARE + texture, pattern=True)


def test_other_files_are_refused(tmp_path: Path) -> None:
    refuses(r"absent\.obj: cannot be read", load_garment, tmp_path / "absent.obj")
    refuses(r"cloth\.fbx: an unknown kind of file \(received '\.fbx'", load_garment, tmp_path / "cloth.fbx")
    (tmp_path / "noise.obj").write_bytes(np.random.default_rng(0).bytes(5000))
    refuses(r"noise\.obj", load_garment, tmp_path / "noise.obj")


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 400))
def test_a_cut_file_loads_or_is_refused(tmp_path_factory: pytest.TempPathFactory, length: int) -> None:
    path = tmp_path_factory.mktemp("cut") / "cut.obj"
    path.write_text(obj_text(*tube())[:-length])
    try:
        garment = load_garment(path)
    except InputError:
        return
    assert garment.faces.max() < len(garment.vertices)


def square_glb(**node: object) -> Glb:
    """Two triangles with all vertices split, texture coordinates as glTF has them: downwards."""
    glb = Glb()
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    attributes = {"POSITION": glb.accessor(corners), "TEXCOORD_0": glb.accessor(corners[:, :2] * [1, -1] + [0, 1])}
    glb.json["meshes"] = [{"name": "square", "primitives": [{"attributes": attributes}]}]
    glb.json["nodes"] = [{"mesh": 0, **node}]
    return glb


def test_a_gltf_garment_is_welded_and_placed(tmp_path: Path) -> None:
    path = square_glb(translation=[0.0, 2.0, 0.0], scale=[0.5, 0.5, 0.5]).write(tmp_path / "square.glb")
    square = load_garment(path)
    assert square.vertices.tolist() == [[0, 2, 0], [0.5, 2, 0], [0.5, 2.5, 0], [0, 2.5, 0]]
    assert square.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    flat = load_garment(square_glb().write(path), pattern=True).pattern
    assert flat is not None
    np.testing.assert_allclose(flat, [[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]], atol=1e-7)


def test_a_gltf_garment_has_the_shape_of_its_morph_weights(tmp_path: Path) -> None:
    glb = square_glb(weights=[0.5])
    wide = glb.accessor(np.array([[0, 0, 0], [1, 0, 0], [1, 0, 0], [0, 0, 0], [1, 0, 0], [0, 0, 0]]))
    glb.json["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": wide}]
    square = load_garment(glb.write(tmp_path / "square.glb"))
    assert square.vertices.tolist() == [[0, 0, 0], [1.5, 0, 0], [1.5, 1, 0], [0, 1, 0]]


def test_bad_gltf_garments_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "square.glb"
    data = square_glb().bytes()
    path.write_bytes(data[:-20])
    refuses(r"square\.glb: a truncated file \(received '\d+ bytes', expected \d+ bytes\)", load_garment, path)
    glb = square_glb()
    glb.data[4:8] = np.float32(np.nan).tobytes()
    refuses("mesh square, primitive 0, vertex 0: positions that are not three finite", load_garment, glb.write(path))
    nothing = Glb()
    refuses("a mesh without faces", load_garment, nothing.write(path))


@pytest.mark.parametrize(
    ("name", "vertices", "faces", "openings"),
    [
        ("mh_female_tshirt", 810, 1528, 4),
        ("mh_female_trousers", 886, 1712, 3),
        ("mh_female_skirt_knee", 395, 728, 2),
        ("mh_female_skirt_long", 720, 1368, 2),
        ("arcsim_dress_yellow_sub2_NC", 3566, 6848, 4),
        ("newton_unisex_shirt", 6436, 12736, 4),
    ],
)
def test_real_garments(name: str, vertices: int, faces: int, openings: int) -> None:
    garment = load_garment(data_path(f"garments/{name}.obj"))
    assert (len(garment.vertices), len(garment.faces)) == (vertices, faces)
    loops = boundary_loops(garment.faces)
    assert len(loops) == openings
    highest = garment.vertices[highest_loop(garment.vertices, garment.faces), 1].mean()
    assert highest > garment.vertices[:, 1].mean() + 0.1  # a waistband or neckline, not the hem


def test_real_patterns() -> None:
    draped = load_garment(data_path("garments/cipc_dress_draped.obj"), pattern=True)
    assert len(draped.vertices) == len(read_obj(data_path("garments/cipc_dress_draped.obj")).vertices) == 15656
    assert draped.pattern is not None and draped.pattern.shape == (29456, 3, 2)
    dress = load_garment(data_path("garments/arcsim_dress_yellow_NC.obj"), pattern=True)
    assert (len(dress.vertices), len(dress.faces)) == (248, 428)
    with pytest.raises(InputError, match="no flat pattern in metres"):
        load_garment(data_path("garments/mh_female_tshirt.obj"), pattern=True)  # its texture is an atlas
