"""Panels of a pattern cut into even triangles, and the stitches between their edges.

The library is Qhull, through ``scipy.spatial.Delaunay``: SciPy is a dependency already, both are kept and have a
BSD-like licence. It triangulates points, so the points are made here: samples of the outline, a hexagonal lattice
inside, and some steps of optimal Delaunay smoothing. Segments of the outline that Delaunay's triangles leave out,
beside narrow notches, are put in by flips. The other libraries do not fit: the licence of Triangle (``triangle``,
``meshpy``) forbids commercial use, gmsh is GPL, netgen is LGPL and brings a whole solid modeller, and the constrained
triangulation of shapely adds no points inside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from assets.patterns.curves import contains, signed_area
from assets.patterns.delaunay import triangles_inside
from assets.patterns.pattern import Band, EdgeName, Panel, Pattern
from assets.patterns.pattern import edge_length as length_of
from pbd.errors import InputError

__all__ = ["CutPattern", "cut", "sample_edge"]

Floats = NDArray[np.float64]
Faces = NDArray[np.int32]

_STEPS = 13
_COUNTING_STEPS = (2, 5, 8)  # take points out and put points in; the others smooth
_LONGEST_MOVE = 0.25  # of an inner vertex in a step of smoothing, in edge lengths
_CLEARANCE = 0.72  # of the lattice from the samples of the outline, in edge lengths
_CROWDED, _SPARSE = 0.36, 0.82  # circumradius in edge lengths; 0.577 for an equilateral triangle
_MAX_VERTICES = 2_000_000


@dataclass(frozen=True, eq=False)
class CutPattern:
    """The triangles of a pattern. Every panel has vertices of its own; stitches join them.

    Attributes:
        pattern: the pattern that was cut.
        edge_length: the length asked for [m].
        flat: vertices in the coordinates of their own panel [m], shape (n, 2). Vertices and faces of a panel follow
            each other, panels in the pattern's order.
        faces: counter-clockwise in their panel, int32, shape (m, 3).
        panel_of_vertex: number of the panel in ``pattern.panels``, int32, shape (n,).
        panel_of_face: the same for faces, int32, shape (m,).
        stitches: pairs of vertices that are sewn together, int32, shape (s, 2); the first of the seam's first edge.
        seam_of_stitch: number of the seam in ``pattern.seams``, int32, shape (s,).
        edge_vertices: the vertices along each edge, both ends included, in the direction of the outline.
        layers: layers of cloth by face, shape (m,) [-]: 1, and more where a band covers the face or a part of it.
        rest: rest shape of each face by corner [m], shape (m, 3, 2): its corners in ``flat``, shortened along the edge
            where an elastic band covers the face.
    """

    pattern: Pattern
    edge_length: float
    flat: Floats
    faces: Faces
    panel_of_vertex: NDArray[np.int32]
    panel_of_face: NDArray[np.int32]
    stitches: NDArray[np.int32]
    seam_of_stitch: NDArray[np.int32]
    edge_vertices: dict[EdgeName, NDArray[np.int32]]
    layers: Floats
    rest: Floats


def cut(pattern: Pattern, edge_length: float) -> CutPattern:
    """Cut a pattern into triangles. The same pattern and length give the same triangles.

    Both edges of a seam get the same number of points, at equal shares of their lengths; the number follows from the
    mean of both lengths. Points lie on the curves of the pattern at every edge length, and corners are kept.

    Args:
        pattern: as :func:`assets.patterns.pattern_checks.check_pattern` accepts it.
        edge_length: wanted length of the triangles' sides [m].

    Raises:
        InputError: the edge length is not positive, gives too many vertices, or is so coarse that the outline of a
            panel crosses itself.
    """
    area = sum(signed_area(panel.outline) for panel in pattern.panels)
    if not edge_length > 0.0 or area / edge_length**2 > _MAX_VERTICES:
        expected = f"above {np.sqrt(area / _MAX_VERTICES):.2g} m for this pattern"
        raise InputError("a bad edge length", key="edge_length", received=edge_length, expected=expected)
    counts = _segment_counts(pattern, edge_length)
    flat, faces, edge_vertices, panel_of_vertex, panel_of_face = [], [], {}, [], []
    first = 0
    for number, panel in enumerate(pattern.panels):
        sides = [sample_edge(edge, counts[EdgeName(panel.name, k)]) for k, edge in enumerate(panel.edges)]
        outline = np.concatenate([side[:-1] for side in sides])
        points, triangles = _mesh(panel, outline, edge_length)
        start = 0
        for k, side in enumerate(sides):
            along = (start + np.arange(len(side))) % len(outline)
            edge_vertices[EdgeName(panel.name, k)] = (first + along).astype(np.int32)
            start += len(side) - 1
        flat.append(points)
        faces.append(first + triangles)
        panel_of_vertex.append(np.full(len(points), number, np.int32))
        panel_of_face.append(np.full(len(triangles), number, np.int32))
        first += len(points)
    all_flat, all_faces = np.concatenate(flat), np.concatenate(faces).astype(np.int32)
    stitches, seam_of_stitch = _stitches(pattern, edge_vertices)
    layers, rest = _bands(pattern, all_flat[all_faces], np.concatenate(panel_of_face))
    return CutPattern(
        pattern,
        edge_length,
        all_flat,
        all_faces,
        np.concatenate(panel_of_vertex),
        np.concatenate(panel_of_face),
        stitches,
        seam_of_stitch,
        edge_vertices,
        layers,
        rest,
    )


def sample_edge(points: Floats, segments: int) -> Floats:
    """Points at equal shares of the length of a polyline, both ends included: shape (segments + 1, 2)."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    places = np.linspace(0.0, along[-1], segments + 1)
    sampled = np.stack([np.interp(places, along, points[:, axis]) for axis in (0, 1)], axis=1)
    sampled[0], sampled[-1] = points[0], points[-1]
    return sampled


def _segment_counts(pattern: Pattern, edge_length: float) -> dict[EdgeName, int]:
    """Number of segments of each edge, the same on both sides of a seam."""
    lengths = {
        EdgeName(panel.name, k): length_of(edge) for panel in pattern.panels for k, edge in enumerate(panel.edges)
    }
    for seam in pattern.seams:
        lengths[seam.first] = lengths[seam.second] = (lengths[seam.first] + lengths[seam.second]) / 2.0
    return {name: max(1, round(length / edge_length)) for name, length in lengths.items()}


def _stitches(
    pattern: Pattern, edge_vertices: dict[EdgeName, NDArray[np.int32]]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Pairs of vertices of both sides of every seam, and the seam of each pair."""
    pairs, owners = [np.zeros((0, 2), np.int32)], [np.zeros(0, np.int32)]
    for number, seam in enumerate(pattern.seams):
        first, second = edge_vertices[seam.first], edge_vertices[seam.second]
        both = np.stack([first, second[::-1] if seam.reversed else second], axis=1)
        both = both[both[:, 0] != both[:, 1]]  # the tip of a dart
        pairs.append(both)
        owners.append(np.full(len(both), number, np.int32))
    return np.concatenate(pairs), np.concatenate(owners)


def _bands(pattern: Pattern, corners: Floats, panel_of_face: NDArray[np.int32]) -> tuple[Floats, Floats]:
    """Layers of cloth of each face, shape (m,), and its rest shape, shape (m, 3, 2)."""
    layers, rest = np.ones(len(corners)), corners.copy()
    names = [panel.name for panel in pattern.panels]
    for band in pattern.bands:
        own_faces = np.flatnonzero(panel_of_face == names.index(band.edge.panel))
        share, tangent = _covered(pattern.edge(band.edge), band, corners[own_faces])
        layers[own_faces] = np.maximum(layers[own_faces], 1.0 + share * (band.layers - 1.0))
        shorter = share * (band.length_ratio - 1.0)
        along = np.einsum("fcx,fx->fc", rest[own_faces], tangent)
        rest[own_faces] += (shorter[:, None] * along)[:, :, None] * tangent[:, None, :]
    return layers, rest


def _covered(edge: Floats, band: Band, corners: Floats) -> tuple[Floats, Floats]:
    """The share of each face within the width of a band, shape (k,), and the edge's direction beside it, shape (k, 2).

    The share counts the middles of 16 equal parts of the face, so that a band is as heavy at every edge length.
    """
    fine = sample_edge(edge, max(8, round(8.0 * length_of(edge) / band.width)))
    middles = (fine[:-1] + fine[1:]) / 2.0
    directions = np.diff(fine, axis=0)
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    tree = cKDTree(middles)
    weights = np.array(
        [[3 * i + 1 + up, 3 * j + 1 + up] for i in range(4) for j in range(4) for up in (0, 1) if i + j + up < 4]
    ) / 12.0  # fmt: skip
    weights = np.concatenate([weights, 1.0 - weights.sum(axis=1, keepdims=True)], axis=1)
    samples = np.einsum("wc,fcx->fwx", weights, corners)
    nearest = tree.query(samples)[1]
    offset = samples - middles[nearest]
    away = np.abs(offset[..., 0] * directions[nearest][..., 1] - offset[..., 1] * directions[nearest][..., 0])
    # Beyond the ends of the edge lies no band.
    along = np.abs((offset * directions[nearest]).sum(axis=2))
    reach = np.linalg.norm(fine[1] - fine[0]) * 2.0 + 0.25 * away
    inside = (away <= band.width) & (along <= reach)
    return inside.mean(axis=1), directions[tree.query(corners.mean(axis=1))[1]]


def _mesh(panel: Panel, outline: Floats, edge_length: float) -> tuple[Floats, Faces]:
    """Points, the outline first, and triangles inside a closed outline that runs counter-clockwise."""
    points = np.concatenate([outline, _lattice(outline, edge_length)])
    fixed = len(outline)
    points, faces = _triangulated(panel, points, fixed)
    for step in range(_STEPS):
        change = _recounted if step in _COUNTING_STEPS else _smoothed
        points, faces = _triangulated(panel, change(points, faces, fixed, edge_length), fixed)
    return points, faces


def _triangulated(panel: Panel, points: Floats, fixed: int) -> tuple[Floats, Faces]:
    """The points inside the outline, and their triangles. Beside a sharp notch smoothing may move a point out."""
    while True:
        try:
            faces = triangles_inside(points, fixed)
        except ValueError as error:
            raise InputError(
                "an edge length so coarse that the outline crosses itself, or an outline that does so in the pattern",
                key=f"panel {panel.name!r}",
                expected="a shorter edge length (--edge), or measures and parameters that go together",
            ) from error
        used = np.bincount(faces.ravel(), minlength=len(points)) > 0
        if used.all():
            return points, faces
        points = points[used]


def _lattice(outline: Floats, edge_length: float) -> Floats:
    """Points of a hexagonal lattice inside an outline and clear of its samples, shape (k, 2)."""
    low, high = outline.min(axis=0), outline.max(axis=0)
    rise = edge_length * np.sqrt(3.0) / 2.0
    middle = (low + high) / 2.0  # symmetric panels get symmetric lattices
    columns = int(np.ceil((high[0] - low[0]) / (2.0 * edge_length))) + 1
    rows = int(np.ceil((high[1] - low[1]) / (2.0 * rise))) + 1
    i, j = np.meshgrid(np.arange(-columns, columns + 1), np.arange(-rows, rows + 1), indexing="ij")
    x = middle[0] + edge_length * (i + np.where(j % 2, 0.5, 0.0))
    points = np.stack([x, middle[1] + rise * j], axis=2).reshape(-1, 2)
    following = np.roll(outline, -1, axis=0)
    clear = np.ones(len(points), bool)
    for target, gap in (
        (outline, np.full(len(outline), _CLEARANCE * edge_length)),
        ((outline + following) / 2.0, 0.52 * np.linalg.norm(following - outline, axis=1)),
    ):
        away, nearest = cKDTree(target).query(points)
        clear &= away > gap[nearest]
    points = points[clear]
    return points[contains(outline, points)]


def _smoothed(points: Floats, faces: Faces, fixed: int, edge_length: float) -> Floats:
    """Inner points at the area-weighted mean of the circumcentres of their triangles.

    Optimal Delaunay triangulation: Chen and Xu, "Optimal Delaunay triangulations", 2004; equation 5 of Alliez,
    Cohen-Steiner, Yvinec and Desbrun, "Variational tetrahedral meshing", 2005.
    """
    corners = points[faces]
    centre, area, _ = _circumcircles(corners)
    weight = np.zeros(len(points))
    moved = np.zeros_like(points)
    for corner in faces.T:
        weight += np.bincount(corner, area, len(points))
        for axis in (0, 1):
            moved[:, axis] += np.bincount(corner, area * centre[:, axis], len(points))
    move = moved[fixed:] / np.maximum(weight[fixed:], 1e-300)[:, None] - points[fixed:]
    length = np.linalg.norm(move, axis=1)
    move *= np.minimum(1.0, _LONGEST_MOVE * edge_length / np.maximum(length, 1e-300))[:, None]
    return np.concatenate([points[:fixed], points[fixed:] + move])


def _recounted(points: Floats, faces: Faces, fixed: int, edge_length: float) -> Floats:
    """Points with those inner ones taken out that stand too close, and others put in where triangles are too large."""
    corners = points[faces]
    centre, _, radius = _circumcircles(corners)
    kept = np.ones(len(points), bool)
    close = faces[radius < _CROWDED * edge_length]
    kept[close.max(axis=1)] = False  # one of each such face
    kept[:fixed] = True
    left = points[kept]
    lonely = centre[radius > _SPARSE * edge_length]
    outline = points[:fixed]
    lonely = lonely[contains(outline, lonely)] if len(lonely) else lonely
    if len(lonely):
        lonely = lonely[cKDTree(left).query(lonely)[0] > _CLEARANCE * edge_length]
    added: list[Floats] = []
    for point in lonely:
        if all(np.linalg.norm(point - other) > 0.8 * edge_length for other in added):
            added.append(point)
    return np.concatenate([left, np.array(added).reshape(-1, 2)])


def _circumcircles(corners: Floats) -> tuple[Floats, Floats, Floats]:
    """Centres, areas and radii of triangles, shape (m, 3, 2)."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    double = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    safe = np.where(np.abs(double) > 1e-18, double, 1e-18)
    aa, bb = (a**2).sum(axis=1), (b**2).sum(axis=1)
    offset = np.stack([b[:, 1] * aa - a[:, 1] * bb, a[:, 0] * bb - b[:, 0] * aa], axis=1) / (2.0 * safe)[:, None]
    return corners[:, 0] + offset, np.abs(double) / 2.0, np.linalg.norm(offset, axis=1)
