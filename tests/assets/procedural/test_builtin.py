"""The built-in clothes: sound meshes that fit."""

import functools
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from assets.garment import BUILTIN_GARMENTS, boundary_loops
from assets.loading import load_garment
from assets.procedural.builtin import builtin_garment
from assets.procedural.builtin_sewing import CUTS, sewn_builtin
from assets.procedural.mannequin import builtin_mannequin
from pbd.mesh import MAX_STRETCH, ClothMesh
from tests.refusals import refuses

SEWN = tuple(CUTS)
LOOPS = {"flag": 1, "tablecloth": 1, "circle_skirt": 2, "shirt": 4, "skirt": 2, "trousers": 3, "tshirt": 4}
# Panels are cut along their outlines, whose corners are as sharp as the draft draws them.
LEAST_ANGLE = {"flag": 44.0, "tablecloth": 44.0} | dict.fromkeys(SEWN, 24.0)
MOST_VERTICES = {"circle_skirt": 1500, "shirt": 1200, "trousers": 1200}  # others 1000


def flat(name: str) -> np.ndarray:
    """Corners of the faces as they were cut [m], shape (m, 3, 3)."""
    garment = builtin_garment(name)
    assert garment.pattern is not None
    return np.insert(garment.pattern, 2, 0.0, axis=2)


def angles(p: np.ndarray) -> np.ndarray:
    u, v = np.roll(p, -1, axis=1) - p, np.roll(p, 1, axis=1) - p
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(u, v), axis=2), (u * v).sum(axis=2)))


@functools.cache
def body_mesh() -> trimesh.Trimesh:
    body = builtin_mannequin()
    return trimesh.Trimesh(body.vertices, body.faces, process=False)


def gap(points: np.ndarray) -> np.ndarray:
    """Signed distance to the body's triangles [m], positive outside, from the forty nearest by centre."""
    from scipy.spatial import cKDTree

    mesh = body_mesh()
    near = cKDTree(mesh.triangles_center).query(points, k=40)[1]
    repeated = np.repeat(points, near.shape[1], axis=0)
    closest = trimesh.triangles.closest_point(mesh.triangles[near.ravel()], repeated).reshape(*near.shape, 3)
    offset = points[:, None] - closest
    distance = np.linalg.norm(offset, axis=2)
    best = distance.argmin(axis=1)
    rows = np.arange(len(points))
    outside = (offset[rows, best] * mesh.face_normals[near[rows, best]]).sum(axis=1) > 0.0
    return np.where(outside, 1.0, -1.0) * distance[rows, best]


@pytest.mark.parametrize("name", BUILTIN_GARMENTS)
def test_mesh_is_manifold_with_the_right_openings(name: str) -> None:
    garment = builtin_garment(name)
    sides = np.concatenate([garment.faces[:, [0, 1]], garment.faces[:, [1, 2]], garment.faces[:, [2, 0]]])
    assert len(np.unique(sides, axis=0)) == len(sides)  # no edge twice in one direction: manifold, one winding
    assert len(boundary_loops(garment.faces)) == LOOPS[name]
    assert np.array_equal(np.unique(garment.faces), np.arange(len(garment.vertices)))
    edges = len(np.unique(np.sort(sides, axis=1), axis=0))
    assert len(garment.vertices) - edges + len(garment.faces) == 2 - LOOPS[name]  # a sphere with holes
    assert garment.vertices.dtype == np.float64 and garment.faces.dtype == np.int32
    assert garment.source == f"builtin:{name}"


@pytest.mark.parametrize("name", BUILTIN_GARMENTS)
def test_triangles_are_even(name: str) -> None:
    garment, p = builtin_garment(name), flat(name)
    lengths = np.linalg.norm(p - np.roll(p, -1, axis=1), axis=2)
    mean = lengths.mean()
    assert 0.028 < mean < 0.048
    assert 0.5 * mean < lengths.min() and lengths.max() < 1.6 * mean
    assert angles(p).min() > LEAST_ANGLE[name]
    assert 450 <= len(garment.vertices) <= MOST_VERTICES.get(name, 1000)


@pytest.mark.parametrize("name", SEWN)
def test_is_worn_outside_the_body_everywhere(name: str) -> None:
    garment = builtin_garment(name)
    assert gap(garment.vertices).min() > 0.0025  # the fabrics' thickness is 3 mm
    middles = garment.vertices[garment.faces].mean(axis=1)
    sides = garment.vertices[np.concatenate([garment.faces[:, [0, 1]], garment.faces[:, [1, 2]]])].mean(axis=1)
    assert gap(np.concatenate([middles, sides])).min() > 0.0


@pytest.mark.parametrize("name", SEWN)
def test_faces_look_away_from_the_body(name: str) -> None:
    """Those that lie on it: cloth that hangs in folds also looks aside and back."""
    garment = builtin_garment(name)
    p = garment.vertices[garment.faces]
    normals = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    middles = p.mean(axis=1)
    closest = body_mesh().triangles_center
    from scipy.spatial import cKDTree

    away = middles - closest[cKDTree(closest).query(middles)[1]]
    lies = np.linalg.norm(away, axis=1) < 0.02
    assert lies.sum() > 100 and ((normals * away).sum(axis=1) > 0.0)[lies].mean() > 0.95


def test_flag_hangs_upright_and_the_tablecloth_lies_level() -> None:
    flag, cloth = builtin_garment("flag"), builtin_garment("tablecloth")
    assert np.ptp(flag.vertices, axis=0) == pytest.approx([1.2, 0.8, 0.0])
    assert np.ptp(cloth.vertices, axis=0) == pytest.approx([1.2, 0.0, 1.2])
    p = cloth.vertices[cloth.faces]
    assert (np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])[:, 1] > 0.0).all()  # upper side up


def test_flag_has_no_bias() -> None:
    """As many diagonals run one way as the other."""
    flag = builtin_garment("flag")
    p = flag.vertices[flag.faces]
    sides = (p - np.roll(p, -1, axis=1)).reshape(-1, 3)
    diagonal = np.abs(sides[:, 0] * sides[:, 1]) > 1e-6
    assert np.sign(sides[diagonal, 0] * sides[diagonal, 1]).sum() == 0


@pytest.mark.parametrize("name", BUILTIN_GARMENTS)
def test_pattern_is_flat_and_keeps_lengths(name: str) -> None:
    """Cloth that hangs is stretched a little; at seams and armholes a few edges are."""
    p, q = builtin_garment(name).vertices[builtin_garment(name).faces], flat(name)
    ratio = np.linalg.norm(p - np.roll(p, -1, axis=1), axis=2) / np.linalg.norm(q - np.roll(q, -1, axis=1), axis=2)
    if name not in SEWN:
        assert ratio == pytest.approx(1.0, abs=0.005)
    assert np.median(ratio) == pytest.approx(1.0, abs=0.002)
    assert np.percentile(ratio, 1) > 0.97 and np.percentile(ratio, 99) < 1.05
    u, v = q[:, 1] - q[:, 0], q[:, 2] - q[:, 0]
    assert (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0] > 0.0).all()  # seen from outside, not mirrored


def test_skirt_sits_at_the_waist_and_flares() -> None:
    skirt = builtin_garment("skirt")
    loops = sorted(boundary_loops(skirt.faces), key=lambda loop: -skirt.vertices[loop, 1].mean())
    waist, hem = (skirt.vertices[loop] for loop in loops)
    assert 0.0025 < gap(waist).min() and gap(waist).max() < 0.008
    around = [np.linalg.norm(loop - np.roll(loop, 1, axis=0), axis=1).sum() for loop in (waist, hem)]
    hips = body_mesh().section([0.0, 1.0, 0.0], [0.0, 0.88, 0.0])
    middle = max(hips.entities, key=lambda entity: entity.length(hips.vertices))
    assert 2.0 < around[1] / middle.length(hips.vertices) < 2.4
    assert 0.35 < hem[:, 1].mean() < 0.55  # between the knee and the calf


@pytest.mark.parametrize(("name", "rings"), [("skirt", 1), ("circle_skirt", 1), ("trousers", 1), ("tshirt", 0)])
def test_waistbands_hardly_give_way(name: str, rings: int) -> None:
    """Every edge of the waist, and no edge of the hem."""
    garment = builtin_garment(name)
    mesh = replace(ClothMesh.from_surface(garment.vertices, garment.faces), max_stretch=garment.max_stretch)
    limits = mesh.edge_limits(MAX_STRETCH)
    edges = mesh.edge_lengths()[0]
    loops = sorted(boundary_loops(garment.faces), key=lambda loop: -garment.vertices[loop, 1].mean())
    for number, loop in enumerate(loops):
        around = np.sort(np.stack([loop, np.roll(loop, 1)], axis=1), axis=1)
        mine = (edges[:, None] == around[None]).all(axis=2).any(axis=1)
        assert mine.sum() == len(loop)
        np.testing.assert_allclose(limits[mine], 1.01 if number < rings else MAX_STRETCH)


@pytest.mark.proof
@pytest.mark.parametrize("name", SEWN)
def test_garments_are_what_sewing_makes(name: str) -> None:
    """The cut is the same; folds are, up to what other rounding of another processor makes of them."""
    garment, made = builtin_garment(name), sewn_builtin(name).garment
    np.testing.assert_array_equal(garment.faces, made.faces)
    for key in ("pattern", "layers", "max_stretch"):
        np.testing.assert_allclose(getattr(garment, key), getattr(made, key), atol=1e-9)
    assert np.linalg.norm(garment.vertices - made.vertices, axis=1).max() < 0.001


@pytest.mark.parametrize("name", BUILTIN_GARMENTS)
def test_they_are_loaded_by_their_names(name: str) -> None:
    loaded, made = load_garment(f"builtin:{name}"), builtin_garment(name)
    assert (loaded.name, loaded.source) == (name, f"builtin:{name}")
    assert np.array_equal(loaded.vertices, made.vertices) and np.array_equal(loaded.faces, made.faces)
    refuses("circle_skirt, flag, shirt, skirt, tablecloth, trousers, tshirt", load_garment, "builtin:toga")
