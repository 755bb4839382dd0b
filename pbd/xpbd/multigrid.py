"""Coarser levels of a cloth mesh, made of patches of its vertices. Any mesh will do; held vertices need no search.

The vertices of a level fall into patches, each a vertex and what surrounds it; a patch is a vertex of the next level.
It stands at its centre of mass, and centres of patches that touch are linked by a spring that only pulls. Moving whole
patches along such lines keeps linear and angular momentum, like any central force. Rest lengths of the lines come from
unrolling the surface: vectors along it are carried from normal to normal, which unrolls a tube exactly.

After unsmoothed aggregation in algebraic multigrid (Vanek, Mandel, Brezina 1996) and hierarchical position-based
dynamics (Mueller 2008), whose levels are chosen vertices instead.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import reverse_cuthill_mckee

from pbd.fabric import Fabric
from pbd.mesh import ClothMesh, edges_of, greedy_colors

__all__ = ["Multigrid", "build_multigrid"]

MIN_VERTICES = 12  # a level of fewer vertices is not made coarser
# Patches much heavier than their neighbours do not move. A held vertex weighs this many times all the cloth.
HELD_MASS = 1e9
# A level is worth a pass where stiffness of its springs times h^2 over the mass of their ends is above this [-].
MIN_USEFUL_STIFFNESS = 2.0


@dataclass(frozen=True)
class Multigrid:
    """Patches of all levels, numbered from the finest level of patches on. Arrays are float32 or int32, C-contiguous.

    Attributes:
        parent: patch of each vertex and then of each patch, -1 for those of the last level, shape (n + k,).
        mass_share: of each vertex, and then patch, in the mass of its patch [-], shape (n + k,).
        inverse_mass: of the patches [1/kg], 0 for those that hold a held vertex, shape (k,).
        level_starts: where the patches of each level begin, shape (levels + 1,).
        springs: patches that touch, by level and colour, shape (m, 2).
        spring_starts: where the springs of each level begin, shape (levels + 1,).
        spring_colors: where the springs of each colour begin, those of all levels, shape (colours + 1,).
        color_starts: where the colours of each level begin in that, shape (levels + 1,).
        spring_data: length at rest [m], compliance [m/N], 0, 0 | direction as (u u, v v, u v, 0) | strain of a patch
            (uu, vv, 2 uv) for 1 N in the spring and for one in all of its springs [1/N], 0; shape (m, 3, 4).
        spring_shares: one over the number of springs of its two ends, shape (m, 2).
    """

    parent: np.ndarray
    mass_share: np.ndarray
    inverse_mass: np.ndarray
    level_starts: np.ndarray
    springs: np.ndarray
    spring_starts: np.ndarray
    spring_colors: np.ndarray
    color_starts: np.ndarray
    spring_data: np.ndarray
    spring_shares: np.ndarray

    @classmethod
    def none(cls, count: int) -> Multigrid:
        """No coarser levels over a number of vertices."""
        one = np.zeros(1, np.int32)
        return cls(
            np.full(count, -1, np.int32), np.ones(count, np.float32), np.zeros(0, np.float32), one,
            np.zeros((0, 2), np.int32), one, one, one, np.zeros((0, 3, 4), np.float32), np.zeros((0, 2), np.float32),
        )  # fmt: skip

    def children(self) -> np.ndarray:
        """Members of the patches, int32: k + 1 numbers, where in this array those of each begin, and then the members
        by their indices in ``parent``.
        """
        order = np.argsort(self.parent, kind="stable")
        patches = np.arange(len(self.inverse_mass) + 1)
        begins = len(patches) + np.searchsorted(self.parent[order], patches)
        return np.concatenate([begins, order]).astype(np.int32)

    @cached_property
    def _rates(self) -> list[float]:
        """Of each level: median of its springs' stiffness times the inverse mass of their ends, but at most that of the
        finer levels [1/s2].
        """
        total = self.inverse_mass[self.springs].sum(axis=1) / np.maximum(self.spring_data[:, 0, 1], 1e-30)
        bounds = zip(self.spring_starts[:-1], self.spring_starts[1:], strict=True)
        rates = np.array([np.median(total[a:b]) if b > a else 0.0 for a, b in bounds])
        return np.minimum.accumulate(rates).tolist()

    def useful(self, h: float) -> int:
        """How many levels help in a substep of h [s]: in softer ones, one pass over the next finer level is enough."""
        return sum(rate * h * h > MIN_USEFUL_STIFFNESS for rate in self._rates)


@dataclass
class _Level:
    """Vertices of one level while the levels are made.

    Attributes:
        mass: [kg], shape (n,).
        area: [m2], shape (n,).
        position: at the start [m], shape (n, 3).
        stretch: how many times longer than at rest the cloth starts there, along whatever it is stretched most, at
            least 1 [-], shape (n,).
        normal: unit, shape (n, 3).
        warp: unit, at right angles to the normal, shape (n, 3).
        edges: in both directions, sorted by their first end, shape (e, 2).
        rest: vector along each edge at rest, in the tangent plane of its first end [m], shape (e, 3).
    """

    mass: np.ndarray
    area: np.ndarray
    position: np.ndarray
    stretch: np.ndarray
    normal: np.ndarray
    warp: np.ndarray
    edges: np.ndarray
    rest: np.ndarray


def build_multigrid(mesh: ClothMesh, mass: np.ndarray, inverse_mass: np.ndarray, fabric: Fabric) -> Multigrid:
    """Levels of patches of a mesh.

    Args:
        mesh: the cloth.
        mass: of its vertices [kg], shape (n,).
        inverse_mass: 0 for a vertex that is held [1/kg], shape (n,).
        fabric: its stiffness goes into the springs.
    """
    heavy = HELD_MASS * mass.sum()
    level = _finest(mesh, np.where(inverse_mass > 0, mass, heavy))
    parents, shares, inverse_masses, springs, data, spring_shares = [], [], [], [], [], []
    starts, spring_starts, spring_colors, color_starts = [0], [0], [np.array([0])], [0]
    softness = np.linalg.inv(fabric.membrane_stiffness())
    while len(level.mass) > MIN_VERTICES:
        patch, roots = _patches(level)
        if np.all(patch[level.edges[:, 0]] == patch[level.edges[:, 1]]):  # no two touch
            break
        coarse, share = _coarser(level, patch, roots)
        parents.append(patch + starts[-1])
        shares.append(share)
        moves = coarse.mass < heavy
        inverse_masses.append(np.where(moves, 1.0 / coarse.mass, 0.0))
        rows, pair_data, pair_shares = _springs(coarse, softness)
        rows, pair_data, pair_shares = (part[moves[rows].any(axis=1)] for part in (rows, pair_data, pair_shares))
        colors = greedy_colors(rows, len(roots))
        order = np.lexsort((rows.max(axis=1), colors))
        springs.append(rows[order] + starts[-1])
        data.append(pair_data[order])
        spring_shares.append(pair_shares[order])
        starts.append(starts[-1] + len(roots))
        spring_colors.append(spring_starts[-1] + np.cumsum(np.bincount(colors)))
        color_starts.append(color_starts[-1] + len(spring_colors[-1]))
        spring_starts.append(spring_starts[-1] + len(rows))
        level = coarse
    last = len(level.mass) if parents else len(mass)
    return Multigrid(
        np.concatenate([*parents, np.full(last, -1)]).astype(np.int32),
        np.concatenate([*shares, np.ones(last)]).astype(np.float32),
        np.concatenate([*inverse_masses, np.zeros(0)]).astype(np.float32),
        np.array(starts, np.int32),
        np.concatenate([*springs, np.zeros((0, 2))]).astype(np.int32),
        np.array(spring_starts, np.int32),
        np.concatenate(spring_colors).astype(np.int32),
        np.array(color_starts, np.int32),
        np.concatenate([*data, np.zeros((0, 3, 4))]).astype(np.float32),
        np.concatenate([*spring_shares, np.zeros((0, 2))]).astype(np.float32),
    )


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-30)


def _tangent(vectors: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """The part of vectors at right angles to normals."""
    return vectors - normals * (vectors * normals).sum(axis=1, keepdims=True)


def _carried(vectors: np.ndarray, normals: np.ndarray, to: np.ndarray) -> np.ndarray:
    """Vectors turned by the smallest turn that takes each normal to another (Rodrigues)."""
    axis, cosine = np.cross(normals, to), (normals * to).sum(axis=1, keepdims=True)
    along = (axis * vectors).sum(axis=1, keepdims=True) / np.maximum(1.0 + cosine, 1e-3)
    return cosine * vectors + np.cross(axis, vectors) + axis * along


def _finest(mesh: ClothMesh, mass: np.ndarray) -> _Level:
    faces, count = mesh.faces, len(mesh.vertices)
    corners = mesh.vertices[faces]
    sides = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
    face_normals = np.cross(sides[:, :, 0], sides[:, :, 1])
    slopes = sides @ np.linalg.inv(mesh.flat)
    face_warps = slopes[:, :, 0] * mesh.face_areas[:, None]
    sums = np.zeros((2, count, 3))
    stretch = np.zeros(count)
    # Along the cloth as it would lie there at rest: faces turned into place, but not stretched (polar decomposition).
    left, face_stretch, right = np.linalg.svd(slopes, full_matrices=False)
    side_1, side_2 = np.moveaxis(left @ right @ mesh.flat, 2, 0)
    edges, side_edge = edges_of(faces)
    forwards = np.where(faces < np.roll(faces, -1, axis=1), 1.0, -1.0)
    at_rest = np.zeros((len(edges), 3))
    for side, vector in enumerate((side_1, side_2 - side_1, -side_2)):
        np.add.at(at_rest, side_edge[:, side], forwards[:, side, None] * vector)
    for corner in range(3):
        np.maximum.at(stretch, faces[:, corner], face_stretch[:, 0])
        np.add.at(sums[0], faces[:, corner], face_normals)
        np.add.at(sums[1], faces[:, corner], face_warps)
    normal = _unit(sums[0])
    warp = _unit(_tangent(sums[1], normal))
    lengths = np.tile(mesh.edge_lengths()[1], 2)
    both, at_rest = np.concatenate([edges, edges[:, ::-1]]), np.concatenate([at_rest, -at_rest])
    order = np.lexsort((both[:, 1], both[:, 0]))
    both, lengths = both[order], lengths[order]
    directions = _unit(_tangent(at_rest[order], normal[both[:, 0]]))
    areas, stretch = mesh.vertex_areas, np.maximum(stretch, 1.0)
    return _Level(mass, areas, mesh.vertices, stretch, normal, warp, both, directions * lengths[:, None])


def _patches(level: _Level) -> tuple[np.ndarray, np.ndarray]:
    """Patch of each vertex, and the vertex in the middle of each patch.

    In order, a vertex makes a patch with its neighbours if none of them is in a patch yet. Each vertex that is left
    over then joins the patch that it touches most. The order goes through the mesh in fronts, which packs patches
    closely; the heaviest vertices come first.
    """
    edges, count = level.edges, len(level.mass)
    graph = csr_matrix((np.ones(len(edges), np.int8), edges.T), (count, count))
    order = reverse_cuthill_mckee(graph, symmetric_mode=True)
    order = order[np.argsort(-np.floor(np.log10(level.mass[order])), kind="stable")]
    ends = np.searchsorted(edges[:, 0], np.arange(count + 1)).tolist()
    others = edges[:, 1].tolist()
    patch, roots = [-1] * count, []
    for vertex in order.tolist():
        around = others[ends[vertex] : ends[vertex + 1]]
        if patch[vertex] < 0 and all(patch[other] < 0 for other in around):
            for member in (vertex, *around):
                patch[member] = len(roots)
            roots.append(vertex)
    first = patch.copy()
    for vertex in range(count):
        if first[vertex] < 0:
            around = [first[other] for other in others[ends[vertex] : ends[vertex + 1]] if first[other] >= 0]
            patch[vertex] = max(set(around), key=lambda name: (around.count(name), -name))
    return np.array(patch), np.array(roots)


def _coarser(level: _Level, patch: np.ndarray, roots: np.ndarray) -> tuple[_Level, np.ndarray]:
    """The level whose vertices are the patches, and the share of each vertex in the mass of its patch."""
    count, middle = len(roots), roots[patch]
    edges, rest, normal = level.edges, level.rest, level.normal
    mass = np.bincount(patch, level.mass, count)
    share = level.mass / mass[patch]
    # Where each vertex lies about the middle of its patch, in the middle's tangent plane: its neighbours, then theirs.
    offset, known = np.zeros((len(patch), 3)), np.zeros(len(patch), bool)
    known[roots] = True
    inside = patch[edges[:, 0]] == patch[edges[:, 1]]
    while not known.all():
        step = np.flatnonzero(inside & known[edges[:, 0]] & ~known[edges[:, 1]])
        step = step[np.unique(edges[step, 1], return_index=True)[1]]
        start, end = edges[step].T
        offset[end] = offset[start] + _carried(rest[step], normal[start], normal[middle[start]])
        known[end] = True
    centre = np.stack([np.bincount(patch, share * offset[:, axis], count) for axis in range(3)], axis=1)
    # Vectors from centre to centre over every edge that joins two patches; on a flat surface they all agree.
    start, end = edges[~inside].T
    here, there = patch[start], patch[end]
    from_here = offset[start] + _carried(rest[~inside], normal[start], normal[middle[start]]) - centre[here]
    beyond = _carried(offset[end] - centre[there], normal[middle[end]], normal[middle[start]])
    vectors = from_here - beyond
    key, which, times = np.unique(here.astype(np.int64) * count + there, return_inverse=True, return_counts=True)
    pairs = np.stack(np.divmod(key, count), axis=1)
    mean = lambda values: np.bincount(which, values, len(pairs)) / times  # noqa: E731
    # The longest of them counts, and none is shorter than the straight distance: a spring that is too short would add a
    # stiffness that no cloth has; one that is too long only helps less. Where the cloth starts stretched, the straight
    # distance is divided by the stretch.
    direction = _unit(np.stack([mean(vectors[:, axis]) for axis in range(3)], axis=1))
    straight = np.stack([np.bincount(patch, share * level.position[:, axis], count) for axis in range(3)], axis=1)
    stretch = np.bincount(patch, share * level.stretch, count)
    lengths = np.linalg.norm(straight[pairs[:, 0]] - straight[pairs[:, 1]], axis=1) / stretch[pairs].max(axis=1)
    np.maximum.at(lengths, which, np.linalg.norm(vectors, axis=1))
    area = np.bincount(patch, level.area, count)
    springs = direction * lengths[:, None]
    coarse = _Level(mass, area, straight, stretch, normal[roots], level.warp[roots], pairs, springs)
    return coarse, share


def _springs(level: _Level, softness: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Springs of a level, once each, with their data and shares for :class:`Multigrid`.

    A lattice of springs in all directions with k = 3 E A/L^2 has Young's modulus E, where A is the area that belongs to
    a spring.
    """
    degree = np.bincount(level.edges[:, 0], minlength=len(level.mass))
    once = level.edges[:, 0] < level.edges[:, 1]
    rows = level.edges[once]
    lengths = np.linalg.norm(level.rest[once], axis=1)
    back = csr_matrix((np.linalg.norm(level.rest, axis=1), level.edges.T))
    lengths = np.maximum(lengths, np.asarray(back[rows[:, 1], rows[:, 0]]).ravel())
    first = rows[:, 0]
    direction = _unit(level.rest[once])
    u = (direction * level.warp[first]).sum(axis=1)
    v = (direction * np.cross(level.normal[first], level.warp[first])).sum(axis=1)
    parts = np.stack([u * u, v * v, u * v], axis=1)
    compliance = np.einsum("ma,ab,mb->m", parts, softness, parts)
    area = (level.area / np.maximum(degree, 1))[rows].sum(axis=1)
    data = np.zeros((len(rows), 3, 4))
    data[:, 0, 0], data[:, 0, 1] = lengths, compliance * lengths**2 / (3.0 * area)
    data[:, 1, :3] = parts
    data[:, 2, :3] = (lengths / area)[:, None] * (parts @ softness)
    return rows, data, 1.0 / np.maximum(degree, 1)[rows]
