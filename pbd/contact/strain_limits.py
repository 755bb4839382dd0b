"""Edges that contact may not draw out: the last word where limbs pinch cloth and push its vertices apart.

Few edges of a garment are ever too long, but length that is taken from one edge goes to its neighbours. Edges lie in
blocks. The first pass looks at all, and each pass after it at the blocks beside an edge that was shortened since.
"""

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from pbd.contact.corrections import tether_correction
from pbd.contact.response import height_over, substep_start
from pbd.engine import ti
from pbd.geometry import vec3, vec4, xyz
from pbd.mesh import MAX_STRETCH, ClothMesh

__all__ = ["limit_rows", "near_limits", "solve_strain_limits", "strain_limits"]

MAX_RETURN_SPEED = 3.0  # of an edge that starts a substep too long: a correction is also a velocity [m/s]
RETURN_RATE = 600.0  # of the same edge, over what it is too long by [1/s]: at once it would tremble for ever
NEAR_SHARE = 0.8  # share of their greatest length from which edges are near it [-]
EDGES = 16  # of a block


def limit_rows(
    edges: np.ndarray, longest: np.ndarray, count: int, clearances: np.ndarray | float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """The limits of edges, and which blocks of edges each vertex has edges in.

    Args:
        edges: their ends, int, shape (e, 2).
        longest: greatest lengths [m], shape (e,).
        count: of vertices.
        clearances: height over the body below which shortening an edge does not take its ends [m], shape (e,).

    Returns:
        rows of the ends of an edge, its greatest length and its clearance [m], float32, shape (e, 4);
        for each block the pass in which it is due, then for each vertex where its blocks begin and where the last one's
        end, then those blocks, int32, shape (k,).
    """
    limits = np.zeros((len(edges), 4), np.float32)
    limits[:, :2], limits[:, 2], limits[:, 3] = edges, longest, clearances
    blocks = (len(edges) + EDGES - 1) // EDGES
    block = np.repeat(np.arange(len(edges)) // EDGES, 2)
    used = np.unique(np.stack([edges.ravel(), block], axis=1), axis=0)
    first = blocks + count + 1
    starts = first + np.searchsorted(used[:, 0], np.arange(count + 1))
    return limits, np.concatenate([np.zeros(blocks, int), starts, used[:, 1]]).astype(np.int32)


def strain_limits(
    mesh: ClothMesh, thickness: float, held: np.ndarray, bands_only: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """The limits of a mesh's edges, see :func:`limit_rows`.

    Args:
        mesh: the garment.
        thickness: kept from the body [m]. Edges that are tight by themselves, like a waistband's, keep it as well.
        held: vertices that something else holds, int, shape (p,). Bands with any of them are usual cloth: they cannot
            slide, and where the held rim is longer than its limit, no pass could meet it.
        bands_only: leave edges with the usual limit out.
    """
    edges, lengths = mesh.edge_lengths()
    stretch = mesh.edge_limits(MAX_STRETCH)
    tight = stretch < MAX_STRETCH
    if len(held) and tight.any():
        count = len(mesh.vertices)
        graph = csr_matrix((np.ones(tight.sum()), tuple(edges[tight].T)), (count, count))
        _, band = connected_components(graph, directed=False)
        tight &= ~np.isin(band, band[held])[edges[:, 0]]
        stretch = np.where(tight, stretch, MAX_STRETCH)
    rows = tight if bands_only else np.ones(len(edges), bool)
    clearances = np.where(tight, thickness, 0.0)
    return limit_rows(edges[rows], (stretch * lengths)[rows], len(mesh.vertices), clearances[rows])


@ti.func
def near_limits(cloth: ti.template(), limits: ti.template()):
    """Whether any edge is near its greatest length; ``limits``: see :func:`limit_rows`."""
    found = 0
    for c in range(limits.shape[0]):
        i, j = int(limits[c][0]), int(limits[c][1])
        offset = (xyz(cloth.position[j]) - xyz(cloth.position[i])) + (
            xyz(cloth.position_delta[j]) - xyz(cloth.position_delta[i])
        )
        if offset.dot(offset) > (NEAR_SHARE * limits[c][2]) ** 2:
            found = 1
    return found


@ti.func
def solve_strain_limits(
    cloth: ti.template(),
    contact: ti.template(),
    limits: ti.template(),
    work: ti.template(),
    passes: ti.i32,
    h: ti.f32,
    t: ti.f32,
):
    """Shorten edges that are longer than they may be (Provot 1995, "Deformation constraints").

    Edges slide along the surface of the body and do not go under it. Only beside a held vertex they may.

    Args:
        cloth, contact: views of the garment.
        limits, work: see :func:`limit_rows`.
        passes: at most so many; fewer once no edge is too long.
        h: substep [s].
        t: time in the frame, in [0, 1].
    """
    blocks = (limits.shape[0] + EDGES - 1) // EDGES
    if passes > 0:
        for b in range(blocks):
            work[b] = 1
    last = 1  # pass in which blocks are due
    for this in range(1, passes + 1):
        if last >= this:
            for b in range(blocks):
                if work[b] == this:
                    for c in range(b * EDGES, ti.min((b + 1) * EDGES, limits.shape[0])):
                        i, j = int(limits[c][0]), int(limits[c][1])
                        p, q = cloth.position[i], cloth.position[j]
                        u, v = xyz(cloth.position_delta[i]), xyz(cloth.position_delta[j])
                        offset = (xyz(q) - xyz(p)) + (v - u)
                        if offset.dot(offset) > limits[c][2] * limits[c][2]:
                            before = (xyz(q) - xyz(p)) + (substep_start(cloth, j, h) - substep_start(cloth, i, h))
                            excess = ti.max(before.norm() - limits[c][2], 0.0)
                            excess -= h * ti.min(MAX_RETURN_SPEED, RETURN_RATE * excess)
                            longest = limits[c][2] + ti.max(excess, 0.0)
                            move = tether_correction(offset, longest) / ti.max(p[3] + q[3], 1e-20)
                            free = p[3] * q[3] == 0.0
                            cloth.position_delta[i] = vec4(
                                u + along_body(i, free, -p[3] * move, limits[c][3], t, cloth, contact)
                            )
                            cloth.position_delta[j] = vec4(
                                v + along_body(j, free, q[3] * move, limits[c][3], t, cloth, contact)
                            )
                            last = this + 1
                            for end in range(2):
                                fall_due(ti.select(end == 0, i, j), b, this, blocks, work)


@ti.func
def fall_due(i: ti.i32, b: ti.i32, this: ti.i32, blocks: ti.i32, work: ti.template()):
    """A vertex has moved: its blocks after block b are due in this pass, the others in the next one."""
    for r in range(work[blocks + i], work[blocks + i + 1]):
        other = work[r]
        work[other] = ti.select(other > b, this, this + 1)


@ti.func
def along_body(
    i: ti.i32, free, move: vec3, clearance: ti.f32, t: ti.f32, cloth: ti.template(), contact: ti.template()
) -> vec3:
    """A move of vertex i [m], less the part of it that would go below a height over the body unless it is free to."""
    allowed = move
    if not free and contact.nearest[i] >= 0:
        normal = xyz(contact.contact_points[i, 2])
        height = height_over(xyz(cloth.position[i]), i, i, i, t, cloth, contact.contact_points)
        allowed -= ti.min(ti.max(height - clearance, 0.0) + move.dot(normal), 0.0) * normal
    return allowed
