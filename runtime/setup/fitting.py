"""A garment that was made for one body, fitted to another body of the same rig."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix, diags

from assets.character import Character
from assets.garment import Garment
from pbd import InputError
from pbd.attachment import closest_points, push_outside, smooth_normals
from pbd.mesh import edges_of
from runtime.setup.garment_mesh import rest_of

__all__ = ["fitted"]

NEAR = 0.08  # vertices further from the body than this keep no distance to it: they follow those that do [m]
ROUNDS, SMOOTHING = 3, 12  # of coming to the distances from the old body; of evening out each round's moves
CLEARANCE = 0.002  # from the body, at least [m]
SAME_PLACE = 0.01  # joints nearer to each other than this tell nothing of a body's size [m]
STRETCHES = 0.5, 2.0  # of an edge, over the median of all edges: outside of this the garment does not fit [-]
BEYOND = 0.01  # share of the edges that may be outside of it [-]


def fitted(garment: Garment, made_for: Character, body: Character, fit: str) -> Garment:
    """The garment on another body: moved by the joints that carry it, then to its old distances from the body.

    Args:
        garment: on ``made_for`` in its bind pose.
        made_for, body: characters with the same names of joints; meshes and bind poses may differ.
        fit: what becomes of the lengths at rest. "body": cloth grows and shrinks as the body does; "lengths": the
            cloth is the old one, and sits tighter or looser.

    Raises:
        InputError: joints that the body lacks or whose names are not their own, or a garment that would be torn or
            squeezed out of its shape.
    """
    own_place, own_weights, own_height = _on_body(garment.vertices, made_for)
    vertices, size = _carried(garment.vertices, own_weights, made_for, body)
    own_height *= size
    edges, _ = edges_of(garment.faces)
    evened = _evening(edges, len(vertices))
    near = own_place < NEAR
    for _ in range(ROUNDS):
        _, _, height, normal = _heights(vertices, body)
        move = np.where(near, own_height - height, 0.0)[:, None] * normal
        known = near.astype(float)
        for _ in range(SMOOTHING):
            move, known = evened @ move, evened @ known
        vertices = vertices + move / np.maximum(known, 1e-3)[:, None]
    vertices = push_outside(vertices, body.vertices, body.faces, CLEARANCE)
    _check_edges(garment, edges, vertices, made_for, body)
    if fit == "lengths":
        rest = rest_of(garment)
        kept = replace(garment, pattern=rest.pattern, layers=rest.layers, max_stretch=rest.max_stretch)
        return replace(kept, vertices=vertices)
    if garment.pattern is None:
        return replace(garment, vertices=vertices)
    growth = _areas(vertices, garment.faces) / np.maximum(_areas(garment.vertices, garment.faces), 1e-12)
    # Of a face alone it is rough: cloth grows as its surroundings do.
    by_vertex = np.bincount(garment.faces.ravel(), np.repeat(growth, 3), len(vertices))
    by_vertex /= np.bincount(garment.faces.ravel(), minlength=len(vertices))
    for _ in range(SMOOTHING):
        by_vertex = evened @ by_vertex
    size = np.sqrt(by_vertex[garment.faces].mean(axis=1))
    return replace(garment, vertices=vertices, pattern=size[:, None, None] * garment.pattern)


def _heights(points: np.ndarray, body: Character) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Nearest face and weights of each point on a body, its height along the normal there [m], and that normal."""
    face, weights = closest_points(points, body.vertices, body.faces)
    corners = body.faces[face]
    surface = np.einsum("pc,pci->pi", weights, body.vertices[corners])
    normal = np.einsum("pc,pci->pi", weights, smooth_normals(body.vertices, body.faces)[corners])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    return face, weights, np.einsum("pi,pi->p", points - surface, normal), normal


def _on_body(points: np.ndarray, body: Character) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance of points from a body [m], weights of its joints there, shape (p, joints), and heights [m]."""
    face, weights, height, _ = _heights(points, body)
    corners = body.faces[face]
    surface = np.einsum("pc,pci->pi", weights, body.vertices[corners])
    skin = np.zeros((len(body.vertices), body.joint_count))
    np.add.at(skin, (np.arange(len(skin))[:, None], body.joint_indices), body.joint_weights)
    carried = np.einsum("pc,pcj->pj", weights, skin[corners])
    return np.linalg.norm(points - surface, axis=1), carried, height


def _carried(points: np.ndarray, weights: np.ndarray, made_for: Character, body: Character) -> tuple[np.ndarray, float]:
    """Points where the joints carry them from the one bind pose to the other, and size of the new body in old ones."""
    used = np.flatnonzero(weights.max(axis=0) > 0.0)
    place = {name: number for number, name in enumerate(body.joint_names)}
    missing = [made_for.joint_names[joint] for joint in used if made_for.joint_names[joint] not in place]
    if missing:
        expected = f"a body with the joints that carry the garment; {body.name} lacks " + ", ".join(missing[:5])
        raise InputError("a body of another rig", key="made_for", received=made_for.name, expected=expected)
    names = [made_for.joint_names[joint] for joint in used]
    twice = [name for name in dict.fromkeys(names) if max(names.count(name), body.joint_names.count(name)) > 1]
    if twice:
        expected = "a name of its own for each joint that carries the garment"
        raise InputError("joints of one name", key="made_for", received=twice[:5], expected=expected)
    own_joints = [place[name] for name in names]
    # From the old joint's bind pose to the new one's, each with the joint's place in the world.
    old, new = np.linalg.inv(made_for.inverse_bind[used]), np.linalg.inv(body.inverse_bind[own_joints])
    away = [np.linalg.norm(places[:, None, :3, 3] - places[None, :, :3, 3], axis=2) for places in (old, new)]
    apart = away[0] > SAME_PLACE
    size = float(np.median(away[1][apart] / away[0][apart])) if apart.any() else 1.0
    moved = new @ np.diag([size, size, size, 1.0]) @ made_for.inverse_bind[used]
    blended = np.einsum("pj,jab->pab", weights[:, used], moved[:, :3])
    return np.einsum("pab,pb->pa", blended[:, :, :3], points) + blended[:, :, 3], size


def _evening(edges: np.ndarray, count: int) -> csr_matrix:
    """Matrix that gives each vertex the mean of itself and its neighbours."""
    ends = np.concatenate([edges, edges[:, ::-1], np.repeat(np.arange(count)[:, None], 2, axis=1)])
    around = csr_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), (count, count))
    return diags(1.0 / np.asarray(around.sum(axis=1)).ravel()) @ around


def _areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def _check_edges(
    garment: Garment, edges: np.ndarray, vertices: np.ndarray, made_for: Character, body: Character
) -> None:
    """Refuse a garment of which too many edges are much longer or shorter than the rest of it."""
    before, after = (np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1) for x in (garment.vertices, vertices))
    ratio = after / np.maximum(before, 1e-9)
    ratio /= np.median(ratio)
    beyond = (ratio < STRETCHES[0]) | (ratio > STRETCHES[1])
    if beyond.mean() > BEYOND:
        worst = int(np.argmax(np.abs(np.log(np.maximum(ratio, 1e-9)))))
        x, y, z = vertices[edges[worst]].mean(axis=0)
        raise InputError(
            f"does not fit {body.name}",
            file=garment.source,
            key="made_for",
            received=f"{100.0 * beyond.mean():.1f} % of its edges more than {STRETCHES[1]:g} times too long or short, "
            f"the worst at ({x:.2f}, {y:.2f}, {z:.2f})",
            expected=f"a body shaped like {made_for.name}, or a garment made for this body",
        )
