"""Texture coordinates of corners: joined, split, and as files have them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from assets.garment import BUILTIN_GARMENTS
from assets.io.converted import write_garment
from assets.loading import load_character, load_garment
from assets.procedural.builtin import builtin_garment
from assets.texture import joined, split
from tests.assets.files import Glb, bar_glb

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def test_a_vertex_is_copied_where_its_coordinates_differ() -> None:
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    texture = np.array([[[0, 0], [1, 0], [1, 1]], [[5, 5], [1, 1], [0, 1]]], float)
    source, cut, places = split(faces, texture, 5)
    assert source.tolist() == [0, 1, 2, 3, 4, 0]  # vertices stay in front, also one without a face
    np.testing.assert_array_equal(source[cut], faces)
    np.testing.assert_array_equal(places[cut], texture)
    texture[1] = np.nan
    source, cut, places = split(faces, texture, 4)
    np.testing.assert_array_equal(source[cut], faces)
    np.testing.assert_array_equal(places[cut], [texture[0], np.zeros((3, 2))])


def test_meshes_without_coordinates_get_none_among_others() -> None:
    one = np.arange(12.0).reshape(2, 3, 2)
    both = joined([(None, 1), (one, 2)])
    assert both is not None and np.isnan(both[0]).all()
    np.testing.assert_array_equal(both[1:], one)
    assert joined([(None, 1), (None, 2)]) is None and joined([]) is None


def test_a_face_without_coordinates_has_none_and_others_keep_theirs(tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    path.write_text(SQUARE + "vt .1 .2\nvt .3 .2\nvt .3 .7\nvt 9 9\nf 1/1 2/2 3/3\nf 1/4 3 4/4\n")
    texture = load_garment(path).texture
    assert texture is not None
    np.testing.assert_array_equal(texture, [[[0.1, 0.2], [0.3, 0.2], [0.3, 0.7]], np.full((3, 2), np.nan)])
    write_garment(tmp_path / "b.obj", np.eye(4, 3), np.array([[0, 1, 2], [0, 2, 3]], np.int32), texture, "a test")
    assert (tmp_path / "b.obj").read_text().splitlines()[-2:] == ["f 1/1 2/2 3/3", "f 1 3 4"]
    path.write_text(SQUARE + "f 1 2 3\nf 1 3 4\n")
    assert load_garment(path).texture is None


def test_coordinates_are_turned_with_their_face(tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    coordinates = "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvt 0 2\n"
    path.write_text(SQUARE + "v 0 2 0\n" + coordinates + "f 1/1 2/2 3/3\nf 1/1 4/4 3/3\nf 3/3 5/5 4/4\n")
    garment = load_garment(path)
    assert garment.faces[1].tolist() == [0, 2, 3]
    np.testing.assert_array_equal(garment.texture, garment.vertices[garment.faces][..., :2])


def test_a_gltf_file_counts_v_downwards(tmp_path: Path) -> None:
    """Two primitives, the second without coordinates; two sets, of which the first counts."""
    glb = Glb()
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0]], float)
    first = {"POSITION": glb.accessor(corners), "TEXCOORD_0": glb.accessor([[0.25, 0.125], [1, 0], [1, 1]])}
    first["TEXCOORD_1"] = glb.accessor(np.full((3, 2), 7.0))
    second = {"POSITION": glb.accessor(corners + [2, 0, 0])}
    glb.json |= {"nodes": [{"mesh": 0}], "meshes": [{"primitives": [{"attributes": first}, {"attributes": second}]}]}
    texture = load_garment(glb.write(tmp_path / "a.glb")).texture
    assert texture is not None
    np.testing.assert_array_equal(texture, [[[0.25, 0.875], [1, 1], [1, 0]], np.full((3, 2), np.nan)])


def test_built_in_garments_have_their_pattern_in_metres_unmirrored() -> None:
    for name in BUILTIN_GARMENTS:
        garment = builtin_garment(name)
        assert garment.texture is not None and garment.pattern is not None
        sides = [np.linalg.norm(np.roll(x, -1, axis=1) - x, axis=2) for x in (garment.texture, garment.pattern)]
        np.testing.assert_allclose(*sides, rtol=1e-9)
        assert (np.linalg.det(garment.texture[:, 1:] - garment.texture[:, :1]) > 0.0).all()
        along_warp = garment.pattern[..., 0 if garment.layers is not None else 1]
        np.testing.assert_array_equal(garment.texture[..., 1], along_warp)


def test_a_character_keeps_the_coordinates_of_every_corner(tmp_path: Path) -> None:
    """A bar without, and one whose vertices are all split: they are welded, and no corner loses its coordinates."""
    assert load_character(bar_glb().write(tmp_path / "a.glb")).texture is None
    texture = np.arange(48.0).reshape(8, 3, 2) ** 2 / 64.0
    body = load_character(bar_glb(texture=texture).write(tmp_path / "b.glb"))
    assert len(body.vertices) == 10
    np.testing.assert_array_equal(body.texture, texture)
