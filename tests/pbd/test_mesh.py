"""Topology, rest metric and areas of cloth meshes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from pbd import Fabric, InputError, build_model
from pbd.mesh import ClothMesh, edges_of, flatten_by_lengths, greedy_colors, hinges_of, lattice_faces, vertex_rings
from tests.pbd.meshes import cloth, grid, icosphere, turn
from tests.refusals import refuses


def random_sheet(seed: int, count: int = 60) -> tuple[np.ndarray, np.ndarray]:
    flat = np.random.default_rng(seed).uniform(0.0, 1.0, (count, 2))
    faces = Delaunay(flat).simplices
    side_1, side_2 = flat[faces[:, 1]] - flat[faces[:, 0]], flat[faces[:, 2]] - flat[faces[:, 0]]
    twice_area = side_1[:, 0] * side_2[:, 1] - side_1[:, 1] * side_2[:, 0]
    faces[twice_area < 0] = faces[twice_area < 0][:, ::-1]
    keep = np.abs(twice_area) > 1e-4
    return np.concatenate([flat, np.zeros((count, 1))], axis=1), faces[keep].astype(np.int32)


def test_edges_and_hinges_of_a_closed_surface_follow_euler() -> None:
    vertices, faces = icosphere(2)
    edges, side_edge = edges_of(faces)
    assert len(vertices) - len(edges) + len(faces) == 2
    assert len(hinges_of(faces)) == len(edges)  # nowhere a border
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2), axis=2)
    assert np.array_equal(edges[side_edge], ends)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_hinges_of_any_mesh(seed: int) -> None:
    _, faces = random_sheet(seed)
    edges, side_edge = edges_of(faces)
    hinges = hinges_of(faces)
    assert len(hinges) == (np.bincount(side_edge.ravel()) == 2).sum()
    known = {frozenset(face) for face in faces.tolist()}
    for i, j, k, other in hinges.tolist():
        assert frozenset((i, j, k)) in known and frozenset((i, j, other)) in known and k != other
        # The edge runs i to j in the face of k.
        assert [i, j, k] in [np.roll(face, s).tolist() for face in faces for s in range(3) if set(face) == {i, j, k}]


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_no_two_constraints_of_a_colour_share_a_vertex(seed: int) -> None:
    vertices, faces = random_sheet(seed)
    for members in (faces, hinges_of(faces)):
        colors = greedy_colors(members, len(vertices))
        for color in range(colors.max() + 1):
            used = members[colors == color].ravel()
            assert used.size and len(np.unique(used)) == used.size


def test_colours_of_a_model_are_proper() -> None:
    mesh = cloth(*grid(12, 9, 0.05, "equilateral"))
    model = build_model(mesh, Fabric(), bend_factor=1 / 3)
    for rows, offsets in ((model.triangles, model.triangle_colors), (model.hinges, model.hinge_colors)):
        assert offsets[0] == 0 and offsets[-1] == len(rows)
        for start, end in zip(offsets[:-1], offsets[1:], strict=True):
            assert len(np.unique(rows[start:end])) == rows[start:end].size


def test_rings_are_the_neighbours() -> None:
    _, faces = random_sheet(3)
    offsets, ring = vertex_rings(faces, 60)
    for vertex in range(60):
        neighbours = set(faces[(faces == vertex).any(axis=1)].ravel().tolist()) - {vertex}
        assert sorted(ring[offsets[vertex] : offsets[vertex + 1]].tolist()) == sorted(neighbours)


def test_areas_and_lengths_do_not_depend_on_the_pose() -> None:
    vertices, faces = grid(7, 5, 0.1)
    turned = vertices @ turn((1.0, 2.0, 3.0), 77.0).T + [3.0, -2.0, 5.0]
    for mesh in (cloth(vertices, faces), cloth(turned, faces)):
        assert mesh.face_areas.sum() == pytest.approx(0.35)
        assert mesh.vertex_areas.sum() == pytest.approx(0.35)
        edges, lengths = mesh.edge_lengths()
        assert lengths == pytest.approx(np.linalg.norm(mesh.vertices[edges[:, 0]] - mesh.vertices[edges[:, 1]], axis=1))


def test_the_warp_is_the_first_material_axis() -> None:
    vertices, faces = grid(2, 2, 0.1)
    angle = np.radians(30.0)
    flat = cloth(vertices, faces, warp=(np.cos(angle), np.sin(angle), 0.0)).flat
    side = vertices[faces[0, 1]] - vertices[faces[0, 0]]
    assert flat[0, :, 0] == pytest.approx([side[0] * np.cos(angle), -side[0] * np.sin(angle)])
    # Faces across the warp direction still get a frame.
    assert np.allclose(
        cloth(vertices, faces, warp=(0.0, 0.0, 1.0)).side_lengths(), cloth(vertices, faces).side_lengths()
    )


def test_a_pattern_gives_the_metric_of_the_surface_that_it_was_taken_from() -> None:
    vertices, faces = grid(6, 4, 0.05, "equilateral")
    surface, pattern = cloth(vertices, faces), ClothMesh.from_pattern(vertices, faces, vertices[faces][:, :, :2])
    assert np.allclose(pattern.flat, surface.flat)
    mirrored = vertices[faces][:, :, :2] * [1.0, -1.0]
    assert np.allclose(ClothMesh.from_pattern(vertices, faces, mirrored).side_lengths(), surface.side_lengths())


def test_lengths_give_the_metric_back() -> None:
    mesh = cloth(*random_sheet(1))
    edges, side_edge = edges_of(mesh.faces)
    _, lengths = mesh.edge_lengths()
    flat = flatten_by_lengths(mesh.flat, mesh.faces, lengths * 1.1, side_edge)
    assert ClothMesh(mesh.vertices, mesh.faces, flat).side_lengths() == pytest.approx(1.1 * mesh.side_lengths())
    assert len(edges) == len(lengths)


def test_lengths_that_close_no_triangle_are_refused() -> None:
    mesh = cloth(*grid(1, 1, 1.0))
    _, side_edge = edges_of(mesh.faces)
    lengths = mesh.edge_lengths()[1]
    lengths[side_edge[1, 1]] = 5.0  # a side that only this face has
    refuses("face 1", flatten_by_lengths, mesh.flat, mesh.faces, lengths, side_edge)


def test_what_is_no_cloth_is_refused() -> None:
    vertices, faces = grid(2, 2, 0.1)
    book = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]], np.int32)  # three pages at one spine
    pages = np.array([[0, 0, 0], [0, 1, 0], [1, 0, 0], [-1, 0, 0], [0, 0, 1.0]])
    refuses("edge 0-1.*non-manifold", build_model, cloth(pages, book), Fabric())
    bad = vertices.copy()
    bad[4, 1] = np.nan
    refuses(r"vertices\[4\].*not finite", ClothMesh, bad, faces, cloth(vertices, faces).flat)
    refuses(r"not finite", cloth, bad, faces)
    flat = cloth(vertices, faces).flat.copy()
    flat[3, 0, 1] = np.inf
    refuses(r"flat\[3\].*not finite", ClothMesh, vertices, faces, flat)
    refuses("empty", cloth, vertices, faces[:0])
    refuses("vertex 9.*in no face", build_model, cloth(np.concatenate([vertices, [[1.0, 1.0, 1.0]]]), faces), Fabric())
    refuses("held vertex outside", build_model, cloth(vertices, faces), Fabric(), held=np.array([0, 9]))


def test_a_face_without_area_is_named() -> None:
    vertices, faces = grid(3, 3, 0.1)
    collapsed = vertices.copy()
    collapsed[faces[5, 1]] = 0.5 * (vertices[faces[5, 0]] + vertices[faces[5, 2]])
    areas = np.linalg.norm(
        np.cross(collapsed[faces[:, 1]] - collapsed[faces[:, 0]], collapsed[faces[:, 2]] - collapsed[faces[:, 0]]),
        axis=1,
    )
    refuses(f"face {np.argmin(areas)}: .*without area", cloth, collapsed, faces)
    with pytest.raises(InputError, match="face 2: .*without area"):
        repeated = faces.copy()
        repeated[2] = repeated[2, [0, 1, 1]]
        cloth(vertices, repeated)


@pytest.mark.parametrize("corner", [-1, 16])
def test_a_face_that_points_outside_the_mesh_is_named(corner: int) -> None:
    vertices, faces = grid(3, 3, 0.1)
    faces[7, 2] = corner
    refuses(r"faces\[7\].*outside the mesh", cloth, vertices, faces)


def test_faces_wound_against_each_other_are_named() -> None:
    vertices, faces = grid(3, 3, 0.1)
    refuses("wound|non-manifold", build_model, cloth(vertices, np.concatenate([faces, faces[-1:]])), Fabric())
    faces[7] = faces[7, ::-1]
    refuses("wound", build_model, cloth(vertices, faces), Fabric())


@pytest.mark.parametrize("kind", ["alternating", "diagonal"])
def test_a_lattice_is_cut_as_squares_are(kind: str) -> None:
    _, faces = grid(4, 3, 0.1, kind)
    index = np.arange(5 * 4).reshape(5, 4)
    assert np.array_equal(lattice_faces(index, alternating=kind == "alternating"), faces)


@pytest.mark.parametrize("level", [False, True])
def test_a_grid_is_a_rectangle_with_its_warp_along_its_height(level: bool) -> None:
    centre, up, normal = (1.0, 2.0, 3.0), np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    if level:
        up, normal = -normal, up
    mesh = ClothMesh.grid(0.6, 0.4, 3, 5, centre, level=level)
    assert len(mesh.vertices) == 4 * 6 and len(mesh.faces) == 2 * 3 * 5
    assert mesh.face_areas == pytest.approx(0.6 * 0.4 / 30)
    corners = mesh.vertices[mesh.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    np.testing.assert_allclose(across / np.linalg.norm(across, axis=1)[:, None], np.tile(normal, (30, 1)), atol=1e-12)
    np.testing.assert_allclose(mesh.vertices.mean(axis=0), centre)
    np.testing.assert_allclose(mesh.vertices[5] - mesh.vertices[0], 0.4 * up, atol=1e-12)
    np.testing.assert_allclose(mesh.vertices[18] - mesh.vertices[0], [0.6, 0.0, 0.0], atol=1e-12)
    # The first material axis is the warp: sides of the faces have their rise there.
    sides = corners[:, 1:] - corners[:, :1]
    np.testing.assert_allclose(mesh.flat[:, 0], sides @ up, atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "key"), [({"width": 0.0}, "width"), ({"height": np.nan}, "height"), ({"rows": 0}, "rows")]
)
def test_a_grid_of_no_size_is_refused(changes: dict, key: str) -> None:
    refuses(key, ClothMesh.grid, **{"width": 1.0, "height": 1.0, "columns": 2, "rows": 2} | changes)
