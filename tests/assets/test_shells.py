import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from assets.sewing.body import closed_body
from assets.shells import count_shells, join_seams, open_share, outer_surface
from pbd.mesh import edges_of
from tests.refusals import refuses
from tests.wrinkles.meshes import icosphere

Mesh = tuple[NDArray[np.float64], NDArray[np.int32]]


SLIM = np.array([0.25, 1.0, 0.25])  # balls are squeezed so, for a body is tall


def ball(radius: float, x: float = 0.0) -> Mesh:
    vertices, faces = icosphere(3)
    unit = vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    return SLIM * (radius * unit + [x, 0.0, 0.0]), faces


def together(*meshes: Mesh) -> Mesh:
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    faces = [faces + start for (_, faces), start in zip(meshes, starts, strict=False)]
    return np.concatenate([vertices for vertices, _ in meshes]), np.concatenate(faces).astype(np.int32)


def without_cap(mesh: Mesh, above: float) -> Mesh:
    vertices, faces = mesh
    return vertices, faces[(vertices[faces][:, :, 1] < above).all(axis=1)]


def volume(mesh: Mesh) -> float:
    return float(trimesh.Trimesh(*mesh, process=False).volume)


def test_the_outer_surface_of_a_ball_is_the_ball() -> None:
    found = outer_surface(*ball(0.5))
    assert (np.bincount(edges_of(found[1])[1].ravel()) == 2).all()
    # The ball's own faces are up to 4 mm inside of it.
    assert np.abs(np.linalg.norm(found[0] / SLIM, axis=1) - 0.5).max() < 0.01
    assert volume(found) == pytest.approx(volume(ball(0.5)), rel=2e-3)  # wound to the outside


def test_overlapping_balls_become_one_surface() -> None:
    """Two balls of radius r = 0.5 at a distance d = 0.6 share a lens of pi (2 r - d)^2 (d^2 + 4 d r) / (12 d)."""
    pair = together(ball(0.5, -0.3), ball(0.5, 0.3))
    r, d = 0.5, 0.6
    lens = np.pi * (2.0 * r - d) ** 2 * (d**2 + 4.0 * d * r) / (12.0 * d)
    found = outer_surface(*pair)
    assert count_shells(pair[1]) == 2 and count_shells(found[1]) == 1
    scale = volume(ball(r)) / (SLIM.prod() * 4.0 / 3.0 * np.pi * r**3)  # of the polyhedron
    assert volume(found) == pytest.approx(SLIM.prod() * scale * (8.0 / 3.0 * np.pi * r**3 - lens), rel=5e-3)


def test_what_lies_inside_or_has_no_inside_leaves_no_surface() -> None:
    card = np.array([[0.2, 0.0, 0.0], [0.3, 0.0, 0.0], [0.3, 0.3, 0.0], [0.2, 0.3, 0.0]])
    sheet = card, np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    found = outer_surface(*together(ball(0.5), ball(0.2, 0.1), sheet))
    assert volume(found) == pytest.approx(volume(ball(0.5)), rel=2e-3)
    assert np.linalg.norm(found[0] / SLIM, axis=1).min() > 0.48


def test_open_and_inverted_shells_count_as_solids() -> None:
    """The upper ball is open where it is inside the lower one, and inside out."""
    first, (vertices, faces) = ball(0.5, -0.3), without_cap(ball(0.5, 0.3), 0.35)
    found = outer_surface(*together(first, (vertices, faces[:, ::-1])))
    cap = SLIM.prod() * np.pi * 0.15**2 * (3.0 * 0.5 - 0.15) / 3.0  # about: the hole's rim is not level
    whole = volume(outer_surface(*together(first, ball(0.5, 0.3))))
    assert whole - 1.6 * cap < volume(found) < whole - 0.5 * cap
    assert open_share(found[1]) < 0.001


def test_legs_that_nearly_touch_stay_apart() -> None:
    """A gap of 2 mm around x = 0, in a grid of 5.6 mm."""
    pair = together(ball(0.5, -0.504), ball(0.5, 0.504))
    assert count_shells(outer_surface(*pair)[1]) == 2


def test_seams_of_rounded_numbers_are_joined() -> None:
    vertices, faces = ball(0.5)
    torn = vertices[faces.ravel()] + 4e-6 * np.random.default_rng(0).uniform(-1.0, 1.0, (3 * len(faces), 3))
    joined, used = join_seams(torn, np.arange(3 * len(faces), dtype=np.int32).reshape(-1, 3))
    assert len(joined) == len(vertices)
    assert open_share(used) == 0.0


def test_a_body_of_one_shell_is_left_as_it_is() -> None:
    vertices, faces = ball(0.5)
    body = closed_body("ball", vertices, faces)
    assert body.vertices is vertices and body.faces is faces


def test_a_body_of_several_shells_is_sewn_on_its_outer_surface() -> None:
    body = closed_body("pair", *together(ball(0.5, 7.7), ball(0.5, 8.3)))
    assert count_shells(body.faces) == 1
    assert body.vertices[:, 0].min() == pytest.approx(1.8, abs=0.006)
    assert body.vertices[:, 0].max() == pytest.approx(2.2, abs=0.006)


def test_a_body_of_sheets_is_refused() -> None:
    square = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    refuses("not closed", closed_body, "cards", *together((square, faces), (square + [0.0, 0.0, 1.0], faces)))
