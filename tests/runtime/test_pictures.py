"""Pictures: what is drawn stands where the camera says, and folds can be seen."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from pbd.errors import InputError
from pbd.mesh import lattice_faces
from runtime.draw.picture_content import GARMENT_COLOR, GARMENT_COLORS, Camera, Drawn, frame_camera
from runtime.draw.pictures import encode_image, render, save_png, strip
from tests.refusals import refuses

pytest.importorskip("pyvista", reason="pictures are drawn by pyvista")

RED = (0.8, 0.1, 0.1)


def sphere(radius: float = 0.5, rings: int = 60, ripple: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A sphere round (0, 0, 0), shape (n, 3) and (m, 3); ripple [m] is the amplitude of 30 upright folds."""
    polar, around = np.meshgrid(
        np.linspace(0.0, math.pi, rings + 1), np.linspace(0.0, 2 * math.pi, 4 * rings, endpoint=False), indexing="ij"
    )
    r = radius + ripple * np.sin(30 * around) * np.sin(polar) ** 4
    vertices = np.stack(
        [r * np.sin(polar) * np.sin(around), r * np.cos(polar), r * np.sin(polar) * np.cos(around)], axis=-1
    )
    row, column = np.divmod(np.arange(rings * 4 * rings), 4 * rings)
    a, b = row * 4 * rings + column, row * 4 * rings + (column + 1) % (4 * rings)
    c, d = a + 4 * rings, b + 4 * rings
    return vertices.reshape(-1, 3), np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)])


def is_red(image: np.ndarray) -> np.ndarray:
    pixels = image.astype(float)
    return pixels[..., 0] > 1.5 * pixels[..., 1] + 5.0


def test_a_sphere_covers_the_pixels_that_perspective_gives_it():
    vertices, faces = sphere()
    camera = Camera(np.array([0.0, 0.0, 3.0]), np.zeros(3), field_of_view_deg=30.0)
    covered = is_red(render([Drawn(vertices, faces, RED)], camera, (320, 240), floor=None))
    radius = 120 * math.tan(math.asin(0.5 / 3.0)) / math.tan(math.radians(15.0))
    rows, columns = np.nonzero(covered)
    assert covered.shape == (240, 320)
    assert covered.sum() == pytest.approx(math.pi * radius**2, rel=0.01)
    assert (rows.mean(), columns.mean()) == pytest.approx((119.5, 159.5), abs=0.5)


def test_the_picture_is_the_right_way_round():
    vertices, faces = sphere(0.1)
    camera = Camera(np.array([0.0, 0.0, 3.0]), np.zeros(3))
    covered = is_red(render([Drawn(vertices + [0.4, 0.5, 0.0], faces, RED)], camera, (200, 200), floor=None))
    rows, columns = np.nonzero(covered)
    assert rows.mean() < 60 and columns.mean() > 130  # +Y is up, +X is right when seen from +Z


@pytest.mark.parametrize("azimuth", [0, 90, 200])
def test_folds_of_two_millimetres_show_from_every_side(azimuth):
    def middle(ripple: float) -> np.ndarray:
        vertices, faces = sphere(ripple=ripple)
        camera = frame_camera(vertices[None], azimuth_deg=azimuth)[0]
        image = render([Drawn(vertices, faces)], camera, (300, 300), floor=None)
        return image[110:190, 60:240].astype(float).mean(axis=2)

    # A slope of 7 degrees at the flanks; a grey value that differs by 2 % of the range is told apart easily.
    assert (middle(0.002) - middle(0.0)).std() > 0.02 * 255


def test_a_picture_depends_on_its_own_meshes_only():
    vertices, faces = sphere(rings=20)
    camera = Camera(np.array([0.0, 0.3, 3.0]), np.zeros(3))
    one = [Drawn(vertices, faces, RED)]
    flat = 0.1 * np.random.default_rng(2).normal(size=(len(faces), 3, 2))
    two = [Drawn.body(0.5 * vertices, faces[::2]), Drawn(vertices + 0.3, faces, pattern=flat)]
    first = render(one, camera, (160, 160))
    other = render(two, camera, (160, 160))
    assert np.array_equal(render(one, camera, (160, 160)), first)
    assert not np.array_equal(first, other)


def test_a_picture_is_as_sharp_far_from_the_origin():
    vertices, faces = sphere(ripple=0.002)
    far = np.array([20_000.0, 0.0, -30_000.0])
    here = Camera(np.array([0.0, 0.3, 3.0]), np.zeros(3))
    there = Camera(here.position + far, here.target + far)
    near_picture = render([Drawn(vertices, faces)], here, (200, 200), floor=-0.5)
    far_picture = render([Drawn(vertices + far, faces)], there, (200, 200), floor=-0.5)
    assert np.abs(near_picture.astype(int) - far_picture).max() <= 2


def test_the_garments_of_an_outfit_have_colours_of_their_own():
    vertices, faces = sphere(0.3)
    both = np.concatenate([vertices - [0.4, 0.0, 0.0], vertices + [0.4, 0.0, 0.0]])
    layer = np.repeat([0, 1], len(vertices))
    drawn = Drawn.garments(both, np.concatenate([faces, faces + len(vertices)]), None, layer)
    assert [one.color for one in drawn] == list(GARMENT_COLORS[:2])
    assert [len(one.vertices) for one in drawn] == [len(vertices)] * 2
    assert all(np.array_equal(one.faces, faces) for one in drawn)
    image = render(drawn, Camera(np.array([0.0, 0.0, 4.0]), np.zeros(3), 30.0), (200, 100), floor=None)
    left, right = image[45:55, 60:70].reshape(-1, 3).mean(axis=0), image[45:55, 130:140].reshape(-1, 3).mean(axis=0)
    assert left[2] > left[0] and right[0] > right[2]  # blue-grey and reddish
    (alone,) = Drawn.garments(vertices, faces, None, None)
    assert alone.color == GARMENT_COLOR and alone.vertices is vertices


def test_a_shadow_lies_on_the_floor():
    vertices, faces = sphere(0.2)
    camera = Camera(np.array([0.0, 1.0, 3.0]), np.zeros(3))
    bare = render([Drawn(vertices, faces)], camera, (200, 200), floor=None)
    shaded = render([Drawn(vertices, faces)], camera, (200, 200), floor=-0.2)
    darker = bare.astype(int) - shaded
    assert darker.max() > 20 and darker.min() >= -1
    assert darker[:60].max() <= 1


def sheet(height: float, turn_deg: float, cells: int = 225) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A square of 0.9 m that faces +Z with one fold of 3 cm across its middle; height [m] of the fold.

    Returns:
        vertices (n, 3), faces (m, 3), place of the corners in the pattern (m, 3, 2).
    """
    line = np.linspace(-0.45, 0.45, cells + 1)
    x, y = np.meshgrid(line, line, indexing="ij")
    across = x * math.cos(math.radians(turn_deg)) + y * math.sin(math.radians(turn_deg))
    z = np.where(np.abs(across) < 0.015, height * np.cos(np.pi * across / 0.03) ** 2, 0.0)
    faces = lattice_faces(np.arange(x.size).reshape(x.shape))
    flat = np.stack([x, y], axis=-1).reshape(-1, 2)
    return np.stack([x, y, z], axis=-1).reshape(-1, 3), faces, flat[faces]


def grey_levels(height: float, turn_deg: float, azimuth_deg: float) -> np.ndarray:
    """The middle of a picture of 900 pixels that a sheet fills, as grey levels of 255."""
    vertices, faces, _ = sheet(height, turn_deg)
    camera = frame_camera(sheet(0.0, 0.0)[0][None], azimuth_deg=azimuth_deg)[0]
    return render([Drawn(vertices, faces)], camera, (900, 900), floor=None)[400:500, 400:500].mean(axis=2)


# All twelve in the proofs; here each turn and each side at least once.
SEEN = [(0, -25), (45, 0), (90, 25), (135, -25)]
TURNS = [(turn, azimuth) for turn in (0, 45, 90, 135) for azimuth in (-25, 0, 25)]


@pytest.mark.parametrize(
    ("turn", "azimuth"), [pytest.param(*one, marks=() if one in SEEN else pytest.mark.proof) for one in TURNS]
)
def test_a_fold_of_three_millimetres_over_three_centimetres_is_seen(turn, azimuth):
    """Whichever way it runs, by 12 to 97 grey levels; by lights alone it was 2 where it ran along their direction."""
    flat = grey_levels(0.0, turn, azimuth)
    assert np.ptp(flat) <= 1.0
    assert np.ptp(grey_levels(0.003, turn, azimuth) - flat) >= 10.0


def test_a_weave_follows_the_pattern():
    """Lines each 2 cm of the pattern: cloth stretched to twice its width has them twice as far apart."""
    vertices, faces, flat = sheet(0.0, 0.0, cells=60)
    camera = Camera(np.array([0.0, 0.0, 1.0]), np.zeros(3))

    def lines(stretch: float) -> np.ndarray:
        drawn = Drawn(vertices * [stretch, 1.0, 1.0], faces, pattern=flat)
        row = render([drawn], camera, (600, 600), floor=None).astype(float).mean(axis=2)[290:310].max(axis=0)
        dark = row < row.mean() - 4.0
        return np.flatnonzero(dark[1:] & ~dark[:-1])

    spacing = 0.02 * 600 / (2.0 * math.tan(math.radians(15.0)))
    assert np.diff(lines(1.0)).mean() == pytest.approx(spacing, rel=0.02)
    assert np.diff(lines(2.0)).mean() == pytest.approx(2.0 * spacing, rel=0.02)


def test_what_stands_between_the_light_and_a_surface_shades_it():
    """The key light comes from the upper left: a ball there darkens the sheet at its lower right, softly."""
    vertices, faces, _ = sheet(0.0, 0.0, cells=60)
    ball, ball_faces = sphere(0.08, rings=20)
    camera = Camera(np.array([0.0, 0.0, 3.0]), np.zeros(3))
    bare = render([Drawn(vertices, faces)], camera, (300, 300), floor=None).astype(float).mean(axis=2)
    scene = [Drawn(vertices, faces), Drawn.body(ball + [-0.2, 0.15, 0.15], ball_faces)]
    darker = bare - render(scene, camera, (300, 300), floor=None).astype(float).mean(axis=2)
    darker[:, :140] = 0.0  # the ball itself
    rows, columns = np.nonzero(darker > 0.8 * darker.max())
    assert darker.max() > 30.0
    assert rows.mean() > 140 and columns.mean() > 150
    assert np.abs(np.diff(darker[round(rows.mean()), 150:])).max() < 0.5 * darker.max()
    assert np.abs(darker[:100, 200:]).max() < 4.0


def test_the_inside_of_a_tube_is_darker_than_its_outside():
    """Both sides of a surface have light of their own."""
    height, around = np.meshgrid(np.linspace(0.0, 1.0, 61), np.linspace(0.0, 2 * math.pi, 181), indexing="ij")
    tube = np.stack([0.12 * np.sin(around), -height, 0.12 * np.cos(around)], axis=-1).reshape(-1, 3)
    faces = lattice_faces(np.arange(around.size).reshape(around.shape))[:, ::-1]
    camera = Camera(np.array([0.0, 1.0, 1.6]), np.array([0.0, -0.1, 0.0]))
    image = render([Drawn(tube, faces)], camera, (300, 300), floor=None).astype(float).mean(axis=2)
    inside, outside = image[120:140, 120:180], image[200:220, 120:180]
    assert inside.mean() < 0.7 * outside.mean()


def test_a_coarse_mesh_has_the_outline_of_its_own_faces():
    vertices, faces = sphere(rings=4)
    camera = Camera(np.array([0.0, 0.0, 3.0]), np.zeros(3))
    covered = is_red(render([Drawn(vertices, faces, RED)], camera, (320, 240), floor=None))
    places = 120 * (1 + project(vertices, camera, 1.0) * [1.0, -1.0]) + [40.0, 0.0]
    corners = places[ConvexHull(places).vertices]
    area = 0.5 * abs(np.sum(corners[:, 0] * np.roll(corners[:, 1], -1) - corners[:, 1] * np.roll(corners[:, 0], -1)))
    assert covered.sum() == pytest.approx(area, rel=0.01)


def test_vertices_that_are_not_finite_are_refused():
    vertices, faces = sphere(rings=6)
    vertices[3, 1] = np.nan
    refuses(r"meshes\[0\]", render, [Drawn(vertices, faces)], Camera(np.ones(3), np.zeros(3)))


def test_a_pattern_of_other_faces_is_refused():
    vertices, faces, flat = sheet(0.0, 0.0, cells=2)
    flat[0, 0, 0] = np.nan
    for pattern in (flat[:-1], flat):
        with pytest.raises(InputError, match=r"meshes\[0\].pattern"):
            render([Drawn(vertices, faces, pattern=pattern)], Camera(np.ones(3), np.zeros(3)))


def project(points: np.ndarray, camera: Camera, aspect: float) -> np.ndarray:
    """Place of points on the picture, -1..1 both ways, shape (n, 2)."""
    forward = camera.target - camera.position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    offset = points - camera.position
    slope = math.tan(math.radians(camera.field_of_view_deg) / 2) * (offset @ forward)
    return np.stack([offset @ right / (slope * aspect), offset @ np.cross(right, forward) / slope], axis=1)


@pytest.mark.parametrize(("azimuth", "elevation", "aspect"), [(0, 0, 1.0), (25, 6, 0.6), (-110, 30, 1.8)])
def test_framing_holds_every_vertex_and_wastes_no_room(azimuth, elevation, aspect):
    walk = np.random.default_rng(3).normal(size=(5, 40, 3)) * [0.3, 0.8, 0.2]
    walk += np.linspace([0, 1, 0], [6, 1, -2], 5)[:, None]
    cameras = frame_camera(walk, azimuth_deg=azimuth, elevation_deg=elevation, aspect=aspect, margin=1.0)
    places = np.stack([project(points, camera, aspect) for points, camera in zip(walk, cameras, strict=True)])
    assert np.abs(places).max() == pytest.approx(1.0, abs=1e-6)


def test_cameras_follow_horizontally_and_keep_height_and_distance():
    body = np.random.default_rng(1).normal(size=(30, 3))
    steps = np.array([[0.0, 0.0, 0.0], [1.0, 0.2, 0.5], [2.0, 0.0, 1.0]])
    cameras = frame_camera(body + steps[:, None])
    positions = np.array([camera.position for camera in cameras])
    np.testing.assert_allclose(positions - positions[0], steps * [1, 0, 1], atol=1e-12)


def test_framing_refuses_what_is_no_sequence():
    refuses(r"frames, vertices, 3", frame_camera, np.zeros((4, 3)))


def test_a_strip_is_a_grid_with_room_for_titles():
    grid = [[np.full((60, 80, 3), 40 * c + 20 * r, np.uint8) for r in range(2)] for c in range(3)]
    sheet = strip(grid, ["coarse", "truth", "ours, with a title wider than its column"], ["0.0 s", "0.5 s"])
    assert sheet.dtype == np.uint8 and sheet.shape[0] > 120 and sheet.shape[1] > 240
    for c in range(3):
        for r in range(2):
            assert (sheet == 40 * c + 20 * r).all(axis=2).sum() >= 60 * 80
    assert (sheet[:20].min(axis=(0, 2)) < 128).any()  # the titles are written


def test_a_strip_refuses_pictures_that_form_no_grid():
    image = np.zeros((8, 8, 3), np.uint8)
    refuses("2 columns of 2 pictures", strip, [[image, image], [image]], ["a", "b"], ["c", "d"])
    refuses("one size", strip, [[image, image[:4]]], ["a"], ["c", "d"])


def test_a_saved_picture_reads_back_and_nothing_else_is_left(tmp_path):
    from PIL import Image

    image = np.random.default_rng(0).integers(0, 256, (20, 30, 3)).astype(np.uint8)
    save_png(tmp_path / "a.png", image)
    refuses("float64", save_png, tmp_path / "a.png", image.astype(float))
    with Image.open(tmp_path / "a.png") as opened:
        assert np.array_equal(np.asarray(opened), image)
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]
    assert encode_image(image, "jpeg")[:2] == b"\xff\xd8"
