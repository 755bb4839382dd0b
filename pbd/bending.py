"""Bending by hinges: coefficients of the quadratic hinge and their calibration, once per mesh.

The hinge of two faces has the energy E = 3/2 c B |K x|^2 / (A0 + A1) with K the cotangent row of Bergou et al. 2006
("A quadratic bending model for inextensible surfaces", eq. 4): |K x| = l theta for small angles. With c = 1 it
bends about three times too stiff; how much exactly depends on the mesh. :func:`hinge_calibration` measures
it on strips cut from the mesh and returns the factor c that gives the fabric's own stiffness back.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.sparse import bmat, csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.sparse.linalg import spsolve

from pbd.fabric import Fabric
from pbd.mesh import ClothMesh, Hinges, edges_of, hinges_of

__all__ = [
    "bends_of", "border_share", "friction_share", "hinge_calibration", "hinge_friction", "hinge_rows",
    "hinge_stiffness", "layer_stiffness",
]  # fmt: skip


def hinge_rows(mesh: ClothMesh, held: np.ndarray | None = None) -> Hinges:
    """Hinges of a mesh with the rows of the quadratic bending operator in the rest metric.

    Args:
        mesh: the cloth.
        held: vertices that are moved from outside. A face with three of them is rigid: all the bending at its
            hinge happens over the other face.

    """
    hinges, first, second, sides = _hinge_sides(mesh)
    (start_0, end_0, direction), (end_1, start_1, _) = sides  # the second face runs the edge the other way
    rows = np.stack([end_0 + end_1, start_0 + start_1, -start_0 - end_0, -start_1 - end_1], axis=1)
    bends = mesh.face_areas.copy()
    if held is not None:
        bends[np.isin(mesh.faces, held).all(axis=1)] = 0.0
    areas = np.maximum(bends[first] + bends[second], 1e-12)
    return Hinges(hinges, rows, areas, np.arctan2(direction[:, 1], direction[:, 0]))


def _hinge_sides(mesh: ClothMesh) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple]:
    """Hinges with both of their faces.

    Returns:
        the hinges, int, shape (h, 4); the first and the second face of each; and of both the cotangents at the start
        and at the end of the edge as that face runs it, and the edge's direction [m], shape (h, 2).
    """
    hinges = hinges_of(mesh.faces)
    # Directed side (a, b) -> face and corner, to find both faces of each hinge again.
    count = len(mesh.vertices)
    sides = np.stack([mesh.faces, np.roll(mesh.faces, -1, axis=1)], axis=2).reshape(-1, 2).astype(np.int64)
    key = sides[:, 0] * count + sides[:, 1]
    order = np.argsort(key)
    place = lambda a, b: order[np.searchsorted(key[order], a.astype(np.int64) * count + b)]  # noqa: E731
    i, j = hinges[:, 0], hinges[:, 1]
    first, second = place(i, j), place(j, i)
    flat = np.concatenate([np.zeros((len(mesh.faces), 1, 2)), mesh.flat.transpose(0, 2, 1)], axis=1)

    def cotangents(side: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Cotangents at the start and end of a directed side, and the side's direction."""
        face, corner = side // 3, side % 3
        a, b, c = flat[face, corner], flat[face, (corner + 1) % 3], flat[face, (corner + 2) % 3]
        cross = lambda u, v: u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]  # noqa: E731
        area_2 = np.abs(cross(b - a, c - a))
        at_start = np.einsum("ij,ij->i", b - a, c - a) / area_2
        at_end = np.einsum("ij,ij->i", a - b, c - b) / area_2
        return at_start, at_end, b - a

    return hinges, first // 3, second // 3, (cotangents(first), cotangents(second))


def hinge_stiffness(fabric: Fabric, angle: np.ndarray) -> np.ndarray:
    """Stiffness B of each hinge [N m], shape (h,), with which hinges of all directions bend as the fabric does.

    A hinge feels the curvature across its edge alone: k = n . K n. A bend along the warp bends hinges of other
    directions too, so that a hinge with the fabric's own stiffness in its direction would draw warp and weft together.
    With hinges in all directions alike, the means of B cos^4, B sin^4 and 3 B cos^2 sin^2 are 3/8 of the warp's
    stiffness, the weft's, and the root of their product (Huber's estimate of the twist). B = a + b cos(2 p) +
    c cos(4 p), with p from the warp to n, has three numbers for these three. Below a tenth of the other axis it would
    be negative in places, and is 0 there.

    Args:
        fabric: B of warp and weft.
        angle: of each hinge's edge against the warp [rad], shape (h,).
    """
    warp, weft, twist = fabric.bend_warp, fabric.bend_weft, math.sqrt(fabric.bend_warp * fabric.bend_weft)
    once = -np.cos(2.0 * angle)  # the hinge bends at right angles to its edge
    twice = 2.0 * once**2 - 1.0
    mean = 0.375 * (warp + weft) + 0.25 * twist
    return np.maximum(mean + 0.75 * (warp - weft) * once + 0.75 * (warp + weft - 2.0 * twist) * twice, 0.0)


def hinge_friction(fabric: Fabric, angle: np.ndarray) -> np.ndarray:
    """Hysteresis 2HB of each hinge [N], shape (h,), with which hinges of all directions lose what the fabric loses.

    As :func:`hinge_stiffness`; what is lost grows with the first power of the curvature, whose mean is that of cos^2.
    Below a third of the other axis it would be negative in places, and is 0 there.
    """
    warp, weft = fabric.bend_hysteresis_warp, fabric.bend_hysteresis_weft
    return np.maximum(0.5 * (warp + weft) - (warp - weft) * np.cos(2.0 * angle), 0.0)


def friction_share(mesh: ClothMesh) -> float:
    """What a moment of friction per width becomes as the force of friction at each hinge [-].

    Cloth that is bent to a curvature k along a direction bends each hinge by b = n . K x. The hinges must lose, over a
    change dk, what the cloth loses by its area: the sum of F |db| is H A |dk|. With the same force F at all hinges that
    is F = H A / sum |db/dk|, here as the mean over eight directions.
    """
    hinges, _, _, ((start_0, end_0, direction), (end_1, start_1, _)) = _hinge_sides(mesh)
    if not len(hinges):
        return 0.0
    length, angle = np.linalg.norm(direction, axis=1), np.arctan2(direction[:, 1], direction[:, 0])
    height_0, height_1 = length / np.maximum(start_0 + end_0, 1e-9), length / np.maximum(start_1 + end_1, 1e-9)
    shares = []
    for turn in DIRECTIONS:
        along, across = np.cos(turn - angle), np.sin(turn - angle)
        at_j = length * along
        at_k, at_l = (start_0 * along + across) * height_0, (start_1 * along - across) * height_1
        bends = (start_0 + start_1) * at_j**2 - length / height_0 * at_k**2 - length / height_1 * at_l**2
        shares.append(mesh.face_areas.sum() / (0.5 * np.abs(bends).sum()))
    return float(np.mean(shares))


def border_share(mesh: ClothMesh, held: np.ndarray | None = None) -> np.ndarray:
    """How much stiffer each hinge has to be for the free sides of its faces, shape (h,), as :func:`pbd.mesh.hinges_of`.

    A face with a free side has two hinges or one. On some meshes these bend freely along the side, if the cloth bends
    across it at will, and narrow strips are too soft. Its hinges make up for that: they share all of its area, unless
    less is enough to bear a bend along the side as three would. A side whose ends are both sewn is not free.

    Args:
        mesh, held: as for :func:`hinge_rows`.

    Returns:
        The mean over the two faces of each hinge [-], at least 1.
    """
    _, first, second, _ = _hinge_sides(mesh)
    edges, side_edge = edges_of(mesh.faces)
    sewn = np.zeros(len(mesh.vertices), bool)
    sewn[mesh.stitches.ravel()] = True
    free = ((np.bincount(side_edge.ravel(), minlength=len(edges)) == 1) & ~sewn[edges].all(axis=1))[side_edge]
    flat = np.concatenate([np.zeros((len(mesh.faces), 1, 2)), mesh.flat.transpose(0, 2, 1)], axis=1)
    sides = np.roll(flat, -1, axis=1) - flat
    sides /= np.linalg.norm(sides, axis=2, keepdims=True)
    shares = np.ones(len(mesh.faces))
    for side in range(3):
        along = sides[:, side, None]
        cosine = (along * sides).sum(axis=2)
        sine = along[:, :, 0] * sides[:, :, 1] - along[:, :, 1] * sides[:, :, 0]
        # What each hinge bends by for a bend along the side, one across it, and a twist.
        bends = np.stack([sine**2, cosine**2, math.sqrt(2.0) * sine * cosine], axis=2)
        whole, left = _border_stiffness(bends), _border_stiffness(bends * ~free[:, :, None])
        shares = np.where(free[:, side], np.maximum(shares, whole / np.maximum(left, 1e-12)), shares)
    shares = np.minimum(shares, 3.0 / np.maximum(3 - free.sum(axis=1), 1))
    areas = mesh.face_areas.copy()
    if held is not None:
        areas[np.isin(mesh.faces, held).all(axis=1)] = 0.0
    share = (areas * shares)[first] + (areas * shares)[second]
    return np.where(areas[first] + areas[second] > 0.0, share / np.maximum(areas[first] + areas[second], 1e-12), 1.0)


def _border_stiffness(bends: np.ndarray) -> np.ndarray:
    """Stiffness of faces against the first of three kinds of bend, where the others find their least energy [-].

    The cloth beyond the face resists these by ``NEIGHBOUR_STIFFNESS``.

    Args:
        bends: of each hinge for each kind [-], shape (m, 3, 3).
    """
    energy = np.einsum("fha,fhb->fab", bends, bends)
    others = energy[:, 1:, 1:] + NEIGHBOUR_STIFFNESS * np.eye(2)
    coupling = np.linalg.solve(others, energy[:, 1:, :1])
    return energy[:, 0, 0] - (energy[:, :1, 1:] @ coupling)[:, 0, 0]


def layer_stiffness(mesh: ClothMesh) -> np.ndarray:
    """Bending stiffness of the cloth at each hinge over that of one layer: shape (h,), as :func:`pbd.mesh.hinges_of`.

    Layers that slide on one another bend n times as stiffly as one layer, layers that are glued n^3 times. Layers that
    are sewn together along lines, as in hems, bands and seams, slide between the lines: n^2 is taken for them.
    """
    _, side_edge = edges_of(mesh.faces)
    counts = np.bincount(side_edge.ravel())
    layers = np.ones(len(mesh.faces)) if mesh.layers is None else np.asarray(mesh.layers)
    return (np.bincount(side_edge.ravel(), np.repeat(layers**2, 3)) / counts)[counts == 2]


def bends_of(mesh: ClothMesh, positions: np.ndarray) -> np.ndarray:
    """How far each hinge is bent: n . K x, for small angles the angle times the edge's length, with a sign.

    Args:
        mesh: the cloth; K is of its rest metric, see :func:`hinge_rows`.
        positions: of its vertices [m], shape (f, n, 3).

    Returns:
        [m], shape (f, h), in the order of :func:`pbd.mesh.hinges_of`; n is the unit vector along (j - i) x (k - l).
    """
    hinges, rows, _, _ = hinge_rows(mesh)
    i, j, k, l = np.moveaxis(np.asarray(positions, float)[:, hinges], 2, 0)  # noqa: E741
    normal = np.cross(j - i, k - l)
    normal /= np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-12)
    return np.einsum("ha,ahfx,fhx->fh", rows, np.stack([i, j, k, l]).swapaxes(1, 2), normal)


# Of the cloth beyond a face at the border over that of one hinge [-]. Strips on irregular triangles at four angles bend
# within 4 % of their fabric with 0.05 (4.3 % with 0.1 and 0.02), without all of this by up to 8 % too far.
NEIGHBOUR_STIFFNESS = 0.05
DIRECTIONS = np.arange(8) * np.pi / 8
LENGTH, WIDTH = 0.85, 0.5  # half length and half width of a test strip, as parts of its patch's reach


def hinge_calibration(mesh: ClothMesh, patches: int = 6, *, rings: tuple[int, ...] = (10, 8, 6)) -> float:
    """The factor c of the hinge energy that makes strips cut from this mesh bend with the stiffness asked for.

    Patches of the mesh are laid flat by their tangent plane, cut to strips and bent by pure moments (small deflection:
    a linear solve). The mean over patches and eight directions is inverted. Meshes too small or too curved for a whole
    patch keep 1/3.

    Args:
        mesh: the cloth.
        patches: number of patches, spread over the mesh.
        rings: sizes of a patch in rings of edges; the first one of which patches fit on the mesh is taken.

    Returns:
        c [-].
    """
    rng = np.random.default_rng(0)
    edges, side_edge = edges_of(mesh.faces)
    rim = edges[np.bincount(side_edge.ravel(), minlength=len(edges)) == 1].ravel()
    graph = _edge_graph(edges, len(mesh.vertices))
    to_rim = np.full(len(mesh.vertices), np.inf)  # in rings of edges
    if len(rim):
        to_rim = dijkstra(graph, unweighted=True, indices=np.unique(rim), min_only=True)
    centres = rng.permutation(len(mesh.vertices))
    for size in rings:
        stiffness: list[float] = []
        for centre in centres:
            if len(stiffness) >= len(DIRECTIONS) * patches:
                break
            if to_rim[centre] <= size:  # a patch cut short by the border would measure the border
                continue
            patch = _flat_patch(mesh, _disc(graph, centre, size), int(centre))
            if patch is not None:
                stiffness.extend(_strip_stiffness(*patch, angle) for angle in DIRECTIONS)
        good = [value for value in stiffness if np.isfinite(value) and value > 0]
        if good:
            return 1.0 / float(np.mean(good))
    return 1.0 / 3.0


def _edge_graph(edges: np.ndarray, count: int) -> csr_matrix:
    both = np.concatenate([edges, edges[:, ::-1]])
    return csr_matrix((np.ones(len(both)), (both[:, 0], both[:, 1])), (count, count))


def _disc(graph: csr_matrix, centre: int, rings: int) -> np.ndarray:
    """Vertices that so many edges or fewer join to the centre, int, ascending."""
    return np.flatnonzero(dijkstra(graph, unweighted=True, indices=centre, limit=rings) <= rings)


def _flat_patch(mesh: ClothMesh, disc: np.ndarray, centre: int) -> tuple[np.ndarray, np.ndarray] | None:
    """Patch laid flat: coordinates (k, 2) about the centre and faces (f, 3), or None where it folds over."""
    local = np.full(len(mesh.vertices), -1)
    local[disc] = np.arange(len(disc))
    faces = local[mesh.faces]
    faces = faces[(faces >= 0).all(axis=1)]
    if len(faces) < 24:
        return None
    points = mesh.vertices[disc] - mesh.vertices[centre]
    corner = points[faces]
    normals = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    # The plane of least squares shortens a curved patch a little; lengths are given back by one global scale.
    normal = normals.sum(axis=0)
    if np.linalg.norm(normal) < 0.9 * np.linalg.norm(normals, axis=1).sum():
        return None
    basis = np.linalg.svd(np.outer(normal, normal))[0][:, 1:]
    flat = points @ basis
    side = lambda p: np.linalg.norm(p[faces] - p[np.roll(faces, -1, axis=1)], axis=2)  # noqa: E731
    flat *= side(points).mean() / side(flat).mean()
    cross = np.linalg.det(np.stack([flat[faces[:, 1]] - flat[faces[:, 0]], flat[faces[:, 2]] - flat[faces[:, 0]]], 1))
    if np.median(cross) < 0:
        flat[:, 0] *= -1.0
        cross = -cross
    return (flat, faces) if cross.min() > 1e-12 else None


def _strip_stiffness(flat: np.ndarray, faces: np.ndarray, angle: float) -> float:
    """Stiffness of the hinge energy with c = B = 1 for bending along a direction: pure moments at a strip's ends.

    Forces on the two last rows of each end make the moment; nothing is held, so that neither ends nor
    sides stiffen the strip. Stiffness is moment per width over the curvature fitted to the middle.
    """
    along = np.array([np.cos(angle), np.sin(angle)])
    s, t = flat @ along, flat @ np.array([-along[1], along[0]])
    ends = flat[edges_of(faces)[0]]
    step = float(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).mean())
    reach = min(np.abs(s).max(), np.abs(t).max())
    inside = (np.abs(s) <= LENGTH * reach) & (np.abs(t) <= WIDTH * reach)
    keep = faces[inside[faces].all(axis=1)]
    if len(keep) < 16:
        return float("nan")
    used, keep = np.unique(keep, return_inverse=True)
    s, t = s[used], t[used]
    strip = ClothMesh.from_surface(np.stack([s, t, 0.0 * s], axis=1), keep.reshape(-1, 3), warp=(1.0, 0.0, 0.0))
    hinges, rows, areas, _ = hinge_rows(strip)
    count = len(used)
    operator = csr_matrix((rows.ravel(), (np.repeat(np.arange(len(hinges)), 4), hinges.ravel())), (len(hinges), count))
    quadratic = operator.T @ operator.multiply((3.0 / areas)[:, None])
    depth = np.abs(s).max() - np.abs(s)
    end = depth < 1.6 * step
    force = np.zeros(count)
    for sign in (-1.0, 1.0):
        rows_here = np.flatnonzero(end & (sign * s > 0))
        if len(rows_here) < 3:
            return float("nan")
        # Weights with no sum and no lean, linear in s: a couple of moment one.
        arms = np.stack([np.ones(len(rows_here)), t[rows_here], s[rows_here]])
        force[rows_here] += np.linalg.pinv(arms) @ np.array([0.0, 0.0, sign])
    # Rigid motions are free: three unknown multipliers hold their mean at zero.
    rigid = csr_matrix(np.stack([np.ones(count), s, t]))
    system = bmat([[quadratic, rigid.T], [rigid, None]]).tocsc()
    shape = spsolve(system, np.concatenate([force, np.zeros(3)]))[:count]
    middle = np.abs(s) < 0.5 * np.abs(s).max()
    if middle.sum() < 8:
        return float("nan")
    monomials = np.stack([s**2 / 2, s * t, t**2 / 2, s, t, np.ones(count)], axis=1)[middle]
    curvature = np.linalg.lstsq(monomials, shape[middle], rcond=None)[0][0]
    width = strip.face_areas.sum() / np.ptp(s)
    return float(1.0 / (width * curvature))
