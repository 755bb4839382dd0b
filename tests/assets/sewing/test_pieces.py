from __future__ import annotations

from dataclasses import replace

import numpy as np

from assets.garment import boundary_loops
from assets.patterns.panel_mesh import cut
from assets.sewing.pieces import Pieces, carried_over, join, pieces_of, without_closing_chords
from tests.assets.sewing.tubes import tube_pattern
from tests.refusals import refuses


def flat_pieces(corners: list[list[float]], faces: list[list[int]], owner: list[int], stitches: list) -> Pieces:
    flat, triangles = np.array(corners, float), np.array(faces, np.int32)
    vertex_owner = np.zeros(len(flat), np.int32)
    vertex_owner[triangles] = np.array(owner, np.int32)[:, None]
    names = tuple(f"piece {k}" for k in range(max(owner) + 1))
    rows = np.array(stitches, np.int32).reshape(-1, 2)
    return Pieces(names, flat, triangles, flat[triangles], np.ones(len(faces)), vertex_owner, np.array(owner), rows)


def test_two_rectangles_become_a_tube() -> None:
    pieces = pieces_of(cut(tube_pattern(), 0.02))
    surface = join(pieces)
    assert [len(loop) for loop in boundary_loops(surface.faces)] == [30, 30]
    assert surface.count == len(pieces.flat) - len(pieces.stitches)
    assert len(surface.seams) == 10  # two of 5 edges


def test_corners_that_two_pieces_share_on_both_sides_get_an_edge_more() -> None:
    # Both pieces have a triangle at the corner 0 whose long side would lie on that of the other piece.
    corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
    faces = [[0, 1, 3], [1, 2, 3]]
    pieces = flat_pieces(
        corners + [[-x, y] for x, y in corners],
        faces + [[c + 4 for c in face[::-1]] for face in faces],
        [0, 0, 1, 1],
        [[0, 4], [1, 5], [3, 7]],
    )
    refuses("close to no surface", join, pieces)
    whole = without_closing_chords(pieces)
    assert len(whole.faces) == 8
    assert len(boundary_loops(join(whole).faces)) == 1
    assert np.isclose(areas(whole.rest).sum(), areas(pieces.rest).sum())


def areas(corners: np.ndarray) -> np.ndarray:
    sides = corners[:, 1:] - corners[:, :1]
    return 0.5 * np.abs(np.linalg.det(sides))


def test_a_piece_that_is_turned_over_is_named() -> None:
    pieces = pieces_of(cut(tube_pattern(), 0.02))
    back = pieces.piece_of_face == 1
    faces = pieces.faces.copy()
    faces[back] = faces[back][:, ::-1]
    refuses("front.*seen from their outer side", join, replace(pieces, faces=faces))


def test_a_finer_cut_takes_its_place_from_the_coarser_one() -> None:
    coarse, fine = (pieces_of(cut(tube_pattern(), edge)) for edge in (0.03, 0.011))
    matrix = np.array([[0.3, 1.0], [1.0, 0.2], [-0.5, 0.4]])  # any linear map is carried over exactly
    found = carried_over(coarse, coarse.flat @ matrix.T, fine)
    np.testing.assert_allclose(found, fine.flat @ matrix.T, atol=1e-12)
