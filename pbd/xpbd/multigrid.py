"""Coarser levels of a cloth mesh, made of patches of its vertices. Any mesh will do; held vertices need no search.

The vertices of a level fall into patches, each a vertex and what surrounds it; a patch is a vertex of the next level.
It stands at its centre of mass, and centres of patches that touch are linked by a spring that only pulls. Moving whole
patches along such lines keeps linear and angular momentum, like any central force. Rest lengths of the lines come from
the flat shapes of the faces, turned into one map around each vertex: it does not count how the cloth lies at the start.

After unsmoothed aggregation in algebraic multigrid (Vanek, Mandel, Brezina 1996) and hierarchical position-based
dynamics (Mueller 2008), whose levels are chosen vertices instead.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components

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
    """Vertices of one level while the levels are made. Each has a flat map of the cloth around it at rest.

    Attributes:
        mass: [kg], shape (n,).
        area: [m2], shape (n,).
        edges: in both directions, sorted by their first end, shape (e, 2).
        rest: vector along each edge in the map of its first end, warp + 1j weft [m], shape (e,).
        turn: turns vectors in the map of each edge's second end into that of its first, of size 1, shape (e,).
    """

    mass: np.ndarray
    area: np.ndarray
    edges: np.ndarray
    rest: np.ndarray
    turn: np.ndarray


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


def _unit(numbers: np.ndarray) -> np.ndarray:
    return numbers / np.maximum(np.abs(numbers), 1e-30)


def _finest(mesh: ClothMesh, mass: np.ndarray) -> _Level:
    """The cloth itself. The map of a vertex is the flat shape of a face at it, unrolled over the faces around it."""
    faces, flat = mesh.faces, mesh.flat[:, 0] + 1j * mesh.flat[:, 1]
    sides = np.stack([flat[:, 0], flat[:, 1] - flat[:, 0], -flat[:, 1]], axis=1)  # from each corner to the next
    edges, side_edge = edges_of(faces)
    turns = _corner_turns(faces, side_edge, sides)
    edge, first = np.unique(side_edge, return_index=True)
    face, side = np.divmod(first, 3)
    one, other = faces[face, side], faces[face, (side + 1) % 3]
    lengths = mesh.edge_lengths()[1][edge]
    along = lengths * _unit(sides[face, side])
    here, there = turns[face, side], turns[face, (side + 1) % 3]
    both = np.concatenate([np.stack([one, other], axis=1), np.stack([other, one], axis=1)])
    rest = np.concatenate([here * along, -there * along])
    turn = np.concatenate([here * there.conj(), there * here.conj()])
    order = np.lexsort((both[:, 1], both[:, 0]))
    return _Level(mass, mesh.vertex_areas, both[order], rest[order], turn[order])


def _corner_turns(faces: np.ndarray, side_edge: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """What turns the flat shape of each face into the map of each of its corners, complex of size 1, shape (m, 3)."""
    count = len(faces)
    own, before = np.arange(3 * count), np.arange(3 * count).reshape(-1, 3)[:, [2, 0, 1]].ravel()
    vertex, edge, side = faces.ravel(), side_edge.ravel(), _unit(sides.ravel())
    # At a vertex two faces share an edge: each corner has one that starts with it and one that ends with it.
    ends = np.concatenate([np.stack([vertex, edge, own], axis=1), np.stack([vertex, edge[before], own], axis=1)])
    away = np.concatenate([side, -side[before]])
    order = np.lexsort(ends.T[::-1])
    ends, away = ends[order], away[order]
    same = np.flatnonzero((ends[1:, :2] == ends[:-1, :2]).all(axis=1))
    pairs, turn = np.stack([ends[same, 2], ends[same + 1, 2]], axis=1), away[same] / away[same + 1]
    pairs, turn = np.concatenate([pairs, pairs[:, ::-1]]), np.concatenate([turn, turn.conj()])
    turns, known = np.ones(3 * count, complex), np.zeros(3 * count, bool)
    while not known.all():
        step = np.flatnonzero(known[pairs[:, 0]] & ~known[pairs[:, 1]])
        if len(step):
            start, end = pairs[step].T
            turns[end], known[end] = turns[start] * turn[step], True
        else:  # the first corner of each vertex, and of each further fan that meets others in it alone
            left = np.flatnonzero(~known)
            known[left[np.unique(vertex[left], return_index=True)[1]]] = True
    return turns.reshape(-1, 3)


def _patches(level: _Level) -> tuple[np.ndarray, np.ndarray]:
    """Patch of each vertex, and the vertex in the middle of each patch.

    In order, a vertex makes a patch with its neighbours if none of them is in a patch yet. Each vertex that is left
    over then joins the patch that it touches most. The order goes through the mesh in fronts, which packs patches
    closely; the heaviest vertices come first.
    """
    edges, count = level.edges, len(level.mass)
    order = _order_through(edges, count)
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


def _order_through(edges: np.ndarray, count: int) -> np.ndarray:
    """Vertices in the order of fronts that go through the mesh (reverse Cuthill-McKee), int, shape (n,).

    SciPy has the same order but for vertices with as many neighbours: theirs depends on the processor.
    """
    by_degree = np.argsort(np.bincount(edges[:, 0], minlength=count), kind="stable")
    place = np.argsort(by_degree)
    graph = csr_matrix((np.ones(len(edges), np.int8), place[edges].T), (count, count))
    graph.sort_indices()
    starts = np.unique(connected_components(graph, directed=False)[1], return_index=True)[1]
    orders = [breadth_first_order(graph, start, return_predecessors=False) for start in np.sort(starts)]
    return by_degree[np.concatenate(orders)][::-1]


def _coarser(level: _Level, patch: np.ndarray, roots: np.ndarray) -> tuple[_Level, np.ndarray]:
    """The level whose vertices are the patches, and the share of each vertex in the mass of its patch."""
    count = len(roots)
    edges, rest, turn = level.edges, level.rest, level.turn
    mass = np.bincount(patch, level.mass, count)
    share = level.mass / mass[patch]
    # Where each vertex lies about the middle of its patch, in the middle's map: its neighbours, then theirs.
    offset, turned, known = np.zeros(len(patch), complex), np.ones(len(patch), complex), np.zeros(len(patch), bool)
    known[roots] = True
    inside = patch[edges[:, 0]] == patch[edges[:, 1]]
    while not known.all():
        step = np.flatnonzero(inside & known[edges[:, 0]] & ~known[edges[:, 1]])
        step = step[np.unique(edges[step, 1], return_index=True)[1]]
        start, end = edges[step].T
        offset[end], turned[end] = offset[start] + turned[start] * rest[step], turned[start] * turn[step]
        known[end] = True
    centre = np.zeros(count, complex)
    np.add.at(centre, patch, share * offset)
    # Vectors from centre to centre over every edge that joins two patches; on cloth that unrolls they all agree.
    start, end = edges[~inside].T
    here, there = patch[start], patch[end]
    between = turned[start] * turn[~inside] * turned[end].conj()
    vectors = offset[start] + turned[start] * rest[~inside] - centre[here] - between * (offset[end] - centre[there])
    key, which = np.unique(here.astype(np.int64) * count + there, return_inverse=True)
    pairs = np.stack(np.divmod(key, count), axis=1)
    sums, lengths = np.zeros((2, len(pairs)), complex), np.zeros(len(pairs))
    np.add.at(sums[0], which, vectors)
    np.add.at(sums[1], which, between)
    # The longest of them counts: a spring that is too short would add a stiffness that no cloth has; one that is too
    # long only helps less.
    np.maximum.at(lengths, which, np.abs(vectors))
    area = np.bincount(patch, level.area, count)
    return _Level(mass, area, pairs, _unit(sums[0]) * lengths, _unit(sums[1])), share


def _springs(level: _Level, softness: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Springs of a level, once each, with their data and shares for :class:`Multigrid`.

    A lattice of springs in all directions with k = 3 E A/L^2 has Young's modulus E, where A is the area that belongs to
    a spring.
    """
    degree = np.bincount(level.edges[:, 0], minlength=len(level.mass))
    once = level.edges[:, 0] < level.edges[:, 1]
    rows = level.edges[once]
    back = csr_matrix((np.abs(level.rest), level.edges.T))
    lengths = np.maximum(np.abs(level.rest[once]), np.asarray(back[rows[:, 1], rows[:, 0]]).ravel())
    direction = _unit(level.rest[once])
    u, v = np.real(direction), np.imag(direction)
    parts = np.stack([u * u, v * v, u * v], axis=1)
    compliance = np.einsum("ma,ab,mb->m", parts, softness, parts)
    area = (level.area / np.maximum(degree, 1))[rows].sum(axis=1)
    data = np.zeros((len(rows), 3, 4))
    data[:, 0, 0], data[:, 0, 1] = lengths, compliance * lengths**2 / (3.0 * area)
    data[:, 1, :3] = parts
    data[:, 2, :3] = (lengths / area)[:, None] * (parts @ softness)
    return rows, data, 1.0 / np.maximum(degree, 1)[rows]
