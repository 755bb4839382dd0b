"""How the built-in clothes are made, and the data files of all that is built in.

``python -m assets.procedural.builtin_shape`` writes the files anew. Playing only reads them
(see :mod:`assets.procedural.builtin`).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from assets.garment import boundary_loops
from assets.procedural.implicit import field_gradient, loft, smooth_min, surface_mesh, tapered_tube
from assets.procedural.mannequin import DATA, JOINTS
from assets.procedural.mannequin_shape import body_field, make_mannequin
from assets.remesh import even_mesh
from pbd.mesh import edges_of
from pbd.storage import replacing

__all__ = ["make_skirt", "make_tshirt", "tshirt_field", "write_data"]

Floats = NDArray[np.float64]

# Skirt: a cone over the outline of the waist. The apex stands a little in front, since the body widens backwards.
# Heights of waist and hem [m], width of the hem over that of the waist [-], place of the apex along z [m].
_WAIST_HEIGHT, _HEM_HEIGHT, _FLARE, _APEX_Z = 1.06, 0.50, 2.55, 0.04
_SKIRT_COLUMNS = 32
_WAIST_GAP = 0.006  # between waistband and body [m]

# T-shirt: height, half width, depth in front of and behind the middle line, z of the middle line [m].
_SHIRT = np.array(
    [
        (0.800, 0.192, 0.132, 0.142, 0.000),
        (0.900, 0.186, 0.126, 0.134, 0.000),
        (1.000, 0.174, 0.122, 0.112, 0.000),
        (1.100, 0.164, 0.124, 0.103, -0.003),
        (1.180, 0.162, 0.128, 0.104, -0.008),
        (1.230, 0.164, 0.126, 0.104, -0.012),
        (1.290, 0.166, 0.108, 0.102, -0.017),
        (1.340, 0.160, 0.086, 0.094, -0.021),
        (1.375, 0.136, 0.072, 0.084, -0.025),
        (1.405, 0.102, 0.060, 0.072, -0.027),
        (1.480, 0.060, 0.050, 0.056, -0.025),
    ]
)
_SHIRT_GAP = 0.009  # least distance from the body [m]
_SLEEVE_SHARE = 0.62  # share of the upper arm that the sleeve covers
_SHIRT_EDGE = 0.0305  # mean edge of the mesh [m]


def make_skirt() -> dict[str, NDArray]:
    """A knee-length flared skirt on the mannequin: rows of one length, each shifted by half an edge.

    The rows grow with the distance from the apex, so that all triangles are nearly equilateral and every inner vertex
    has six neighbours.

    Returns:
        vertices [m] (n, 3), the waist first; faces (m, 3); pattern [m] (m, 3, 2): the cone cut open and unrolled.
    """
    columns = _SKIRT_COLUMNS
    apex = np.array([0.0, _WAIST_HEIGHT + (_WAIST_HEIGHT - _HEM_HEIGHT) / (_FLARE - 1.0), _APEX_Z])
    waist = _outline(_WAIST_HEIGHT, _WAIST_GAP, 2 * columns)
    reach = np.linalg.norm(waist - apex, axis=1)
    between = np.cross(waist - apex, np.roll(waist, -1, axis=0) - apex)
    angle = np.arcsin(np.linalg.norm(between, axis=1) / (reach * np.roll(reach, -1)))
    # Row spacing sqrt(3)/2 of the edge at every distance makes the distances a geometric series.
    length = np.linalg.norm(waist - np.roll(waist, -2, axis=0), axis=1).mean()
    rows = round(np.log(_FLARE) / np.log1p(np.sqrt(0.75) * length / reach.mean()))
    factors = _FLARE ** (np.arange(rows + 1) / rows)

    index = np.arange((rows + 1) * columns).reshape(rows + 1, columns)
    row, column = np.divmod(np.arange(index.size), columns)
    ruling = 2 * column + row % 2
    vertices = apex + factors[row, None] * (waist[ruling] - apex)
    faces, turns = [], []  # turns: how often each corner's ruling has passed the seam
    for i in range(rows):
        here, below = index[i], index[i + 1]
        shift = i % 2  # in even rows a vertex stands above and between `k - 1` and `k` of the next
        for k in range(columns):
            after = (k + 1) % columns
            passed = int(after == 0)
            if shift == 0:
                faces += [(here[k], below[k], here[after]), (here[after], below[k], below[after])]
                turns += [(0, 0, passed), (passed, 0, passed)]
            else:
                faces += [(here[k], below[k], below[after]), (here[k], below[after], here[after])]
                turns += [(0, 0, passed), (0, passed, passed)]
    faces, turns = np.array(faces), np.array(turns)
    start = np.concatenate([[0.0], np.cumsum(angle)])
    bearing = start[ruling[faces]] + turns * start[-1] - 0.5 * start[-1]
    radius = factors[row[faces]] * reach[ruling[faces]]
    pattern = np.stack([radius * np.sin(bearing), -radius * np.cos(bearing)], axis=-1)
    return {
        "vertices": vertices.astype(np.float32),
        "faces": faces.astype(np.uint16),
        "pattern": pattern.astype(np.float32),
    }


def _outline(height: float, gap: float, count: int) -> Floats:
    """Points evenly around the body at a height, `gap` [m] outside, from behind to the right, shape (count, 3)."""
    angle = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
    ray = np.stack([-np.sin(angle), np.zeros_like(angle), -np.cos(angle)], axis=1)
    near, far = np.full(len(angle), 0.02), np.full(len(angle), 0.4)
    for _ in range(40):
        middle = 0.5 * (near + far)
        outside = _distance(np.array([0.0, height, 0.0]) + middle[:, None] * ray) > gap
        near, far = np.where(outside, near, middle), np.where(outside, middle, far)
    points = np.array([0.0, height, 0.0]) + far[:, None] * ray
    steps = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    closed = np.concatenate([points, points[:1]])
    wanted = np.arange(count) / count * along[-1]
    return np.stack([np.interp(wanted, along, closed[:, k]) for k in range(3)], axis=1)


def _distance(points: Floats) -> Floats:
    """Distance from the body [m] to first order."""
    return body_field(points) / np.linalg.norm(field_gradient(body_field, points), axis=1)


def tshirt_field(points: Floats) -> Floats:
    """The solid whose surface the T-shirt is: a wide trunk, sleeves, and room for the body everywhere.

    Args:
        points: [m], shape (n, 3).

    Returns:
        [m], shape (n,), negative inside.
    """
    left = np.abs(points[:, :1]) * [1.0, 0.0, 0.0] + points * [0.0, 1.0, 1.0]
    shoulder, elbow = np.array(JOINTS["LeftArm"][1]), np.array(JOINTS["LeftForeArm"][1])
    sleeve = tapered_tube(
        left, shoulder + [-0.03, 0.010, 0.0], elbow + [0.0, -0.008, 0.0], [(0.0, 0.056), (0.5, 0.063), (1.0, 0.066)]
    )
    shirt = smooth_min(loft(points, _SHIRT), sleeve, 0.05)
    return smooth_min(shirt, body_field(points) - _SHIRT_GAP, 0.015)


def make_tshirt() -> dict[str, NDArray]:
    """A loose T-shirt on the mannequin in its bind pose, with openings for hips, neck and arms.

    Returns:
        vertices [m] (n, 3), the boundary first; faces (m, 3).
    """
    low, high = np.array([-0.45, 0.83, -0.24]), np.array([0.45, 1.52, 0.24])
    fine, faces = surface_mesh(tshirt_field, low, high, 0.010)
    mesh = trimesh.Trimesh(fine, faces, process=False)
    shoulder, elbow = np.array(JOINTS["LeftArm"][1]), np.array(JOINTS["LeftForeArm"][1])
    cuff, along = shoulder + _SLEEVE_SHARE * (elbow - shoulder), shoulder - elbow
    mirror = np.array([-1.0, 1.0, 1.0])
    cuts = [
        (np.array([0.0, 0.90, 0.0]), np.array([0.0, 1.0, 0.0]), 0.30),
        (np.array([0.0, 1.426, -0.02]), np.array([0.0, -1.0, -0.32]), 0.15),
        (cuff, along, 0.15),
        (cuff * mirror, along * mirror, 0.15),
    ]
    for place, inward, reach in cuts:
        # A cuff's plane meets the hips as well, further down: only the faces near the cuff are cut.
        near = np.linalg.norm(mesh.triangles_center - place, axis=1) < reach
        vertices, kept, _ = trimesh.intersections.slice_faces_plane(mesh.vertices, mesh.faces[near], inward, place)
        faces = np.concatenate([mesh.faces[~near], kept + len(mesh.vertices)])
        mesh = trimesh.Trimesh(np.concatenate([mesh.vertices, vertices]), faces, process=False)
        mesh.merge_vertices()
    fine, faces = _largest_part(np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int32))

    anchors = []
    for loop in boundary_loops(faces):
        closed = np.concatenate([fine[loop], fine[loop[:1]]])
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
        wanted = np.arange(round(along[-1] / _SHIRT_EDGE)) / round(along[-1] / _SHIRT_EDGE) * along[-1]
        anchors.append(loop[np.abs(along[None, :-1] - wanted[:, None]).argmin(axis=1)])
    area = trimesh.Trimesh(fine, faces, process=False).area
    count = round(1.09 * area / (np.sqrt(0.75) * _SHIRT_EDGE**2))
    vertices, faces = even_mesh(tshirt_field, fine, faces, count, np.concatenate(anchors))
    return {"vertices": vertices.astype(np.float32), "faces": faces.astype(np.uint16)}


def _largest_part(vertices: Floats, faces: NDArray[np.int32]) -> tuple[Floats, NDArray[np.int32]]:
    edges = edges_of(faces)[0]
    links = sparse.csr_matrix((np.ones(len(edges)), tuple(edges.T)), shape=(len(vertices), len(vertices)))
    _, part = csgraph.connected_components(links, directed=False)
    faces = faces[part[faces[:, 0]] == np.bincount(part).argmax()]
    used = np.unique(faces)
    return vertices[used], np.searchsorted(used, faces).astype(np.int32)


def write_data(folder: Path = DATA) -> None:
    """Make the data files of the mannequin and its clothes in a folder."""
    for name, make in (("mannequin", make_mannequin), ("skirt", make_skirt), ("tshirt", make_tshirt)):
        arrays: dict[str, Any] = make()
        with replacing(folder / f"{name}.npz") as path, open(path, "wb") as file:
            np.savez_compressed(file, **arrays)


if __name__ == "__main__":
    write_data()
