from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from assets.garment import boundary_loops
from assets.loading import load_garment
from assets.seams import Seams, load_seams, sew, without_pleats
from pbd.mesh import edges_of
from tests.assets.panels import two_panels
from tests.data import data_path
from tests.refusals import refuses


def area(vertices: np.ndarray, faces: np.ndarray) -> float:
    corner = vertices[faces]
    return 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1).sum()


@pytest.mark.parametrize(("first", "second"), [(6, 6), (6, 4), (4, 6), (7, 5), (2, 9)])
def test_panels_are_closed_to_one_surface(first: int, second: int) -> None:
    vertices, faces, seams = two_panels(3, first, second)
    made = sew(faces, vertices[:, :2], seams)
    sewn, one = made.faces, made.one
    loops = boundary_loops(sewn)
    assert len(loops) == 1  # one border round both, and none along the seam
    assert area(vertices, sewn) == pytest.approx(area(vertices, faces), rel=1e-12)
    assert area(np.insert(made.flat.reshape(-1, 2), 2, 0.0, axis=1), np.arange(3 * len(sewn)).reshape(-1, 3)) == (
        pytest.approx(area(vertices, faces), rel=1e-12)
    )
    assert np.isin(made.panel_face, np.arange(len(faces))).all() and len(np.unique(made.panel_face)) == len(faces)
    used = np.unique(sewn)
    assert np.array_equal(one[used], used)
    assert np.abs(vertices[one] - vertices).max() < 1e-12  # what has become one lay at one place
    # A disc: every inner vertex of the seam is inside now.
    assert len(used) - len(edges_of(sewn)[0]) + len(sewn) == 1


def test_without_seams_nothing_changes() -> None:
    vertices, faces, _ = two_panels()
    made = sew(faces, vertices[:, :2], Seams(np.zeros((0, 3), np.int32), np.zeros(0)))
    assert np.array_equal(made.faces, faces) and np.array_equal(made.one, np.arange(len(vertices)))


def test_a_pleat_that_is_sewn_down_leaves_a_manifold_surface() -> None:
    """The second panel's side runs forward, back and forward again along one edge of the first's."""
    vertices, faces, _ = two_panels(3, 2, 4)
    side, start = 3 * 3, 4 * 3
    # Its vertices 0 1 2 3 4 lie at 0, 1, 0, 1, 2 of the first panel's side.
    rows = [(start + k, side + min(at, 1), side + min(at, 1) + 1) for k, at in enumerate((0, 1, 0, 1, 2))]
    seams = Seams(np.array(rows, np.int32), np.array([float(at == 2) for at in (0, 1, 0, 1, 2)]))
    sewn = sew(faces, vertices[:, :2], seams).faces
    assert np.bincount(edges_of(sewn)[1].ravel()).max() > 2
    closed, _ = without_pleats(sewn)
    assert np.bincount(edges_of(closed)[1].ravel()).max() == 2
    assert len(boundary_loops(closed)) == 1


def write(path: Path, *rows: str, title: str = "v,a,b,w") -> Path:
    path.write_text("\n".join([title, *rows]) + "\n")
    return path


def test_stitches_are_read(tmp_path: Path) -> None:
    seams = load_seams(write(tmp_path / "s.csv", "3,0,1,0.25", "4,1,2,1"), 5)
    assert seams.vertices.tolist() == [[3, 0, 1], [4, 1, 2]] and seams.weights.tolist() == [0.25, 1.0]


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (["0,1,2"], r"s\.csv.*line 2.*received '0,1,2'.*v,a,b,w"),
        (["0,1,2,0.5", "9,1,2,0.5"], r"line 3, column v.*received '9'.*0 to 4"),
        (["0,-1,2,0.5"], r"line 2, column a.*received '-1'"),
        (["0,1,2,1.5"], r"line 2, column w.*received '1\.5'.*0 to 1"),
        (["0,1,2,nan"], r"column w.*received 'nan'"),
        (["0,1,2,x"], r"column w.*received 'x'"),
        (["0,1,1,0.5"], r"line 2.*received \[0, 1, 1\]"),
        ([], r"no stitches"),
    ],
)
def test_bad_stitches_are_refused(rows: list[str], message: str, tmp_path: Path) -> None:
    refuses(message, load_seams, write(tmp_path / "s.csv", *rows), 5)


def test_a_file_with_other_columns_or_none_at_all_is_refused(tmp_path: Path) -> None:
    refuses(r"line 1.*received 'a,b,c'.*v,a,b,w", load_seams, write(tmp_path / "s.csv", "0,1,2,0.5", title="a,b,c"), 5)
    refuses(r"cannot be read.*gone\.csv|gone\.csv.*cannot be read", load_seams, tmp_path / "gone.csv", 5)


def test_the_dress_has_a_hem_a_neck_and_two_sleeves() -> None:
    garment = load_garment(data_path("garments/cipc_dress_draped.obj"), pattern=True)
    assert garment.pattern is not None
    flat = np.zeros((len(garment.vertices), 2))
    flat[garment.faces] = garment.pattern
    seams = load_seams(data_path("garments/cipc_dress_stitches.csv"), len(garment.vertices))
    made = sew(garment.faces, flat, seams)
    sewn, one = made.faces, made.one
    assert np.linalg.norm(garment.vertices[one] - garment.vertices, axis=1).max() < 0.001
    assert area(garment.vertices, sewn) == pytest.approx(area(garment.vertices, garment.faces), rel=1e-3)
    closed, _ = without_pleats(sewn)
    loops = boundary_loops(closed)
    heights = sorted(float(garment.vertices[loop, 1].mean()) for loop in loops)
    assert len(loops) == 4 and heights[0] < 0.7 and heights[1] > 1.2
