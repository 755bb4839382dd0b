"""One quasi-static pass on the fine mesh: stretched edges back to length, held vertices in place, out of the body."""

from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from pbd.contact.colliders import EDGES, Body
from pbd.engine import ensure_initialized, ti
from pbd.geometry import Float1, Float2, Int1, Int2, Int3, Vec3, Vec4, closest_in_fan, descend, vec3, vec4, xyz
from pbd.mesh import ClothMesh
from pbd.taichi_internals import Launch, in_kernel
from pbd.xpbd.constraints import larger
from pbd.xpbd.views import BodySurface
from wrinkles.charts import leading_vertices
from wrinkles.clearance import clearances, facing
from wrinkles.edge_lengths import edges_by_color
from wrinkles.levels import Levels

__all__ = ["Relaxation"]

STRETCH_SHARE = 0.25  # of an edge's stretch that a relaxation pass takes back
# Where the coarse garment is further than this from the body, so is the fine one [m], ...
LEVEL = 0.025
PLEATED = 0.045  # ... unless the garment came with pleats, which go deeper
MAX_HEIGHT = 0.008  # fine vertices within this height over the tangent plane are near the body [m]
MAX_TESTED_EXCESS = 0.003  # near vertices no more than this over their clearance are tested against faces [m]
MAX_ACROSS = 0.05  # an opposite part of the body is searched so far from the part that a coarse vertex covers [m]
PHASES = 8  # frames in which every coarse vertex searches for an opposite part once
# Two parts do not face one another, but are sides of one bump, if one lies behind the other by more than this sine, ...
MAX_SINE_BEHIND = 0.7
MAX_OVERLAP = 0.008  # ... unless it is by no more than this, and their normals point apart: then they overlap [m]
MAX_COVERED = 0.04  # a part further away than this is not covered by the cloth if another part is right at it [m]
GAP_SHARE = 0.3  # of the gap between two parts that the cloth keeps from each, if that is less than its clearance [-]
MIN_KEPT = 0.0003  # kept from the part that the cloth covers where there is no gap [m]
MAX_FACE_DISTANCE = 0.05  # to a face that may be near the cloth [m]
MAX_WANDER = 0.03  # a coarse vertex whose body vertex is so far from its last one has gone over to another part [m]


@in_kernel
@dataclass(eq=False)
class _Covered:
    """The body under the cloth in one pass; a view, see :mod:`pbd.xpbd.views`.

    Attributes:
        surface: :class:`pbd.xpbd.views.BodySurface`, which stands still.
        clearance: kept from it at each of its vertices [m].
        nearest: body vertices where the last passes found each free vertex near the body, -1 for none: first on the
            part that it covers, for all of them, then on an opposite one.
        edge_ends, edge_sides: see :attr:`pbd.contact.colliders.Body.first_edges`.
        coarse_nearest, coarse_contact: body vertex near each coarse vertex, -1 for none, and distance to the body [m].
        coarse_before: ``coarse_nearest`` of the last pass.
        moved: 1 for the coarse vertices that have gone over to another part of the body, else 0.
        across: of each coarse vertex a body vertex opposite to the one that it is near to, -1 for none.
        cell_start, cell_items, item_cell: workspace of :func:`_sort_touched`.
        leading: three coarse vertices around each free vertex.
        frames: of the coarse vertices, their normals from column 6 on.
        facing: 1 where the garment's faces look away from the body, -1 where they look at it.
        level: coarse vertices further than this from the body are not near it [m].
    """

    surface: Any
    clearance: Any
    nearest: Any
    edge_ends: Any
    edge_sides: Any
    coarse_nearest: Any
    coarse_contact: Any
    coarse_before: Any
    moved: Any
    across: Any
    cell_start: Any
    cell_items: Any
    item_cell: Any
    leading: Any
    frames: Any
    facing: Any
    level: Any
    _data_oriented = True


@ti.kernel
def _relax(
    fine: Vec3,
    work: Vec4,
    free: Int1,
    edges: Int2,
    lengths: Float1,
    free_edges: ti.i32,
    held: Int1,
    targets: Vec3,
    leading: Int3,
    frames: Float2,
    facing: ti.f32,
    coarse_nearest: Int1,
    coarse_contact: Float1,
    coarse_before: Int1,
    moved: Int1,
    nearest: Int1,
    edge_ends: Int1,
    edge_sides: Int2,
    phase: ti.i32,
    across: Int1,
    cell_start: Int1,
    cell_items: Int1,
    item_cell: Int1,
    level: ti.f32,
    body: Vec3,
    body_normals: Vec3,
    ring_start: Int1,
    ring: Int1,
    fan_start: Int1,
    fan: Int2,
    clearance: Float1,
    passes: ti.i32,
):
    """See :meth:`Relaxation.__call__` and :class:`_Covered`. Over 12 arguments: a kernel takes arrays one by one."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        covered = _Covered(
            BodySurface(body, body, ring_start, ring, fan_start, fan, body_normals), clearance, nearest, edge_ends,
            edge_sides, coarse_nearest, coarse_contact, coarse_before, moved, across, cell_start, cell_items, item_cell,
            leading, frames, facing, level,
        )  # fmt: skip
        for c in range(held.shape[0]):
            fine[held[c]] = targets[c]
        for i in range(fine.shape[0]):
            work[i] = vec4(fine[i])
        for _pass in range(passes):
            _shorten_edges(work, edges, lengths, free_edges)
            _find_moved(covered)
            _find_opposite(phase, covered)
            for i in range(free.shape[0]):
                x = _out_of_body(i, xyz(work[free[i]]), covered)
                work[free[i]] = vec4(x)
                fine[free[i]] = x


@ti.func
def _shorten_edges(fine: ti.template(), edges: ti.template(), lengths: ti.template(), free_edges: ti.i32):
    """Take back a share of the stretch of each edge, one edge after the other.

    Only stretch is taken back: pushing short edges apart in one pass folds the mesh edge by edge. And only a share of
    it: whole corrections of a stretched coarse state overshoot from edge to edge.

    Args:
        free_edges: the edges before this one have two free ends; the others have their held end first.
    """
    for c in range(free_edges):
        i, j = edges[c][0], edges[c][1]
        start, end = fine[i], fine[j]
        # Half of the share at each end. A select, because whether an edge is stretched cannot be foreseen.
        d = 0.5 * _stretch(end - start, lengths[c])
        fine[i] = start + d
        fine[j] = end - d
    for c in range(free_edges, edges.shape[0]):
        j = edges[c][1]
        fine[j] = fine[j] - _stretch(fine[j] - fine[edges[c][0]], lengths[c])


@ti.func
def _stretch(d: ti.math.vec4, length: ti.f32) -> ti.math.vec4:
    """The share of an edge's stretch that is taken back, as a vector along the edge d [m].

    Without a root, 1 - L / |d| is 1 - 2 L^2 / (|d|^2 + L^2) up to half of the squared stretch (Jakobsen 2001).
    """
    squared, wanted = d[0] * d[0] + d[1] * d[1] + d[2] * d[2], length * length
    return ti.select(squared > wanted, STRETCH_SHARE * (1.0 - 2.0 * wanted / (squared + wanted)), 0.0) * d


@ti.func
def _out_of_body(i: ti.i32, start: vec3, covered: ti.template()) -> vec3:
    """Where free vertex i goes from ``start`` [m] so that it keeps its clearance from the body.

    First from the part of the body that the cloth covers, then from a part opposite to it, where there is one.
    """
    p = start
    around = covered.leading[i]
    contact, across, moved = ti.static(covered.coarse_contact, covered.across, covered.moved)
    if ti.min(contact[around[0]], contact[around[1]], contact[around[2]]) < covered.level:
        body, normals = ti.static(covered.surface.body_start, covered.surface.body_normals)
        normal, other_normal, home, outwards = vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0)
        gap, other_gap, kept, other_kept = MAX_HEIGHT, MAX_HEIGHT, 0.0, 0.0
        parts = ti.select(ti.max(across[around[0]], across[around[1]], across[around[2]]) >= 0, 2, 1)
        # Between two parts a vertex that stayed with the one that it was at would end inside the other.
        anew = parts == 2 or moved[around[0]] + moved[around[1]] + moved[around[2]] > 0
        for part in range(parts):
            slot = i + part * covered.leading.shape[0]
            best = covered.nearest[slot]
            search = best < 0 or anew
            if search:
                best = _seed(i, part, p, home, outwards, covered)
            # A body vertex of the last pass is taken only where a walk would end at it: so a pass comes to the same
            # bits, whatever came before it.
            edge, finished = -1, best < 0
            while not finished:
                if search:
                    best = descend(p, best, 0.0, covered.surface)
                offset = p - body[best]
                is_nearest, towards = _edge_towards(offset, best, covered)
                edge, finished = towards, search or (is_nearest and not _has_more_edges(best, covered))
                search = True
            if part == 1 and best >= 0 and not _opposed(home, outwards, body[best], normals[best]):
                best = -1
            covered.nearest[slot] = best
            if best < 0:
                break
            n, h, c = _height(p, best, edge, covered)
            if part == 0:
                home, outwards = body[best], normals[best]
                normal, gap, kept = n, h, c
            else:
                other_normal, other_gap, other_kept = n, h, c
        if other_gap < MAX_HEIGHT:
            # Between two parts the cloth keeps a share of the gap from both, and MIN_KEPT from its own where they
            # overlap. If it were pushed out of one after the other, it would zigzag and end inside one of them.
            between = gap + other_gap
            kept = ti.min(kept, ti.max(GAP_SHARE * ti.abs(between), MIN_KEPT))
            other_kept = ti.min(other_kept, ti.max(GAP_SHARE * between, MIN_KEPT))
            if other_gap < other_kept and gap > kept:
                d = ti.min(other_kept - other_gap, gap - kept) * other_normal
                p += d
                gap += d.dot(normal)
        if gap < kept:
            p += (kept - gap) * normal
    else:
        covered.nearest[i] = -1
        covered.nearest[i + covered.leading.shape[0]] = -1
    return p


@ti.func
def _seed(i: ti.i32, part: ti.i32, p: vec3, home: vec3, outwards: vec3, covered: ti.template()) -> ti.i32:
    """Body vertex from which the search for free vertex i at p [m] starts; -1 for none.

    It lies on the part that the cloth covers (0) or on the opposite one (1). Another part does not
    come near unseen: the coarse vertices around would have found it.

    Args:
        home, outwards: place of the body that it covers [m] and normal there, of use for the opposite part only.
    """
    frames = ti.static(covered.frames)
    way = outwards
    if part == 0:
        coarse = covered.leading[i][0]
        way = covered.facing * vec3(frames[coarse, 6], frames[coarse, 7], frames[coarse, 8])
    return _start(i, part, covered.nearest[i + part * covered.leading.shape[0]], p, home, way, covered)


@ti.func
def _start(
    i: ti.i32, part: ti.i32, last: ti.i32, p: vec3, home: vec3, outwards: vec3, covered: ti.template()
) -> ti.i32:
    """Body vertex from which the search for free vertex i at p [m] starts; -1 for none.

    It is the nearest of those where the coarse vertices around this one are near the body, and where it was itself.

    Args:
        last: where it was near the body last, -1 for nowhere.
        home, outwards: place of the body that it covers [m] and normal there; before they are known, the cloth's.
    """
    body, normals = ti.static(covered.surface.body_start, covered.surface.body_normals)
    best = -1
    distance = 1e30
    for c in ti.static(range(6)):
        seed = -1
        if ti.static(c < 3):
            seed = covered.coarse_nearest[covered.leading[i][c]]
        elif part == 1:
            seed = covered.across[covered.leading[i][c - 3]]
        elif ti.static(c == 3):
            seed = last
        if seed >= 0 and seed != best:
            offset = body[seed] - p
            away = offset.dot(offset)
            # The covered part looks the way the cloth does. Another part will do if there is no such part near: it
            # strikes the cloth from its other side.
            if part == 0 and normals[seed].dot(outwards) < 0.0:
                away += MAX_COVERED * MAX_COVERED
            if part == 1 and not _opposed(home, outwards, body[seed], normals[seed]):
                away = 1e30
            if away < distance:
                distance = away
                best = seed
    return best


@ti.func
def _opposed(p: vec3, normal: vec3, q: vec3, other_normal: vec3) -> bool:
    """Whether two places of the body [m] face one another; both sides of a bump look apart as well, but from behind."""
    offset = q - p
    apart = -normal.dot(other_normal)
    limit = -ti.max(MAX_SINE_BEHIND * offset.norm(), MAX_OVERLAP * apart)
    return apart > 0.0 and offset.dot(normal) > limit and -offset.dot(other_normal) > limit


@ti.func
def _edge_towards(offset: vec3, vertex: ti.i32, covered: ti.template()):
    """Look at the edges from a body vertex to its neighbours.

    Args:
        offset: from the body vertex to a place near it [m].

    Returns:
        whether no neighbour is nearer to the place than the vertex; the edge that comes nearest to the place, -1 if no
        edge comes nearer than the vertex. Edges are those of :attr:`pbd.contact.colliders.Body.first_edges`.
    """
    body, ends = ti.static(covered.surface.body_start, covered.edge_ends)
    best, nearer = 0, 0
    for k in range(EDGES):
        edge = body[ends[EDGES * vertex + k]] - body[vertex]
        along, squared = offset.dot(edge), edge.dot(edge)
        nearer |= ti.select(along + along > squared, 1, 0)
        # The squared distance to the edge is that to the vertex less this gain. Positive numbers are in the order of
        # their bits, and the largest of whole numbers is found without a branch.
        gain = larger(along, 0.0) * along / larger(squared, 1e-20)
        best = ti.max(best, (ti.bit_cast(gain, ti.i32) & -EDGES) | k)
    return nearer == 0, ti.select(best < EDGES, -1, EDGES * vertex + (best & (EDGES - 1)))


@ti.func
def _has_more_edges(vertex: ti.i32, covered: ti.template()) -> bool:
    """Whether a body vertex has more neighbours than :func:`_edge_towards` looks at."""
    return covered.surface.ring_start[vertex + 1] - covered.surface.ring_start[vertex] > EDGES


@ti.func
def _find_moved(covered: ti.template()):
    """Mark the coarse vertices that touch another part of the body than in the last pass."""
    before = ti.static(covered.coarse_before)
    for c in range(before.shape[0]):
        covered.moved[c] = _went_over(covered.coarse_nearest[c], before[c], covered)
        before[c] = covered.coarse_nearest[c]


@ti.func
def _went_over(now: ti.i32, last: ti.i32, covered: ti.template()) -> ti.i32:
    """1 if one body vertex is not beside another, which may be -1 for none; else 0."""
    moved = 0
    if now >= 0 and now != last:
        moved = 1
        if last >= 0:
            offset = covered.surface.body_start[now] - covered.surface.body_start[last]
            moved = ti.cast(offset.dot(offset) > MAX_WANDER * MAX_WANDER, ti.i32)
    return moved


@ti.func
def _cell(p: vec3, covered: ti.template()) -> ti.i32:
    """Number of the cell that p [m] lies in: a hash of its three coordinates, counted in cells MAX_ACROSS wide."""
    q = ti.cast(ti.floor(p / MAX_ACROSS), ti.i32)
    return _hash(q[0], q[1], q[2], covered)


@ti.func
def _hash(x: ti.i32, y: ti.i32, z: ti.i32, covered: ti.template()) -> ti.i32:
    """A number below the number of cells, which is a power of two (Teschner et al. 2003, spatial hashing)."""
    return ((x * 73856093) ^ (y * 19349663) ^ (z * 83492791)) & (covered.cell_start.shape[0] - 2)


@ti.func
def _touched(k: ti.i32, covered: ti.template()) -> ti.i32:
    """A body vertex that the garment touches, -1 for none: first those near the coarse vertices, then opposite ones."""
    count = covered.across.shape[0]
    c = ti.select(k < count, k, k - count)
    found = ti.select(k < count, covered.coarse_nearest[c], covered.across[c])
    return ti.select(covered.coarse_contact[c] < covered.level, found, -1)


@ti.func
def _sort_touched(covered: ti.template()):
    """Sort the body vertices that the garment touches into cells, by counting."""
    start, items = ti.static(covered.cell_start, covered.cell_items)
    count = covered.item_cell.shape[0]
    for c in range(start.shape[0]):
        start[c] = 0
    for k in range(count):
        b = _touched(k, covered)
        covered.item_cell[k] = -1
        if b >= 0:
            cell = _cell(covered.surface.body_start[b], covered)
            covered.item_cell[k] = cell
            start[cell] = start[cell] + 1
    for c in range(start.shape[0] - 1):
        start[c + 1] = start[c + 1] + start[c]
    # Filled from the back: in the end cell c starts at start[c].
    for k in range(count):
        cell = covered.item_cell[k]
        if cell >= 0:
            start[cell] = start[cell] - 1
            items[start[cell]] = _touched(k, covered)


@ti.func
def _find_opposite(phase: ti.i32, covered: ti.template()):
    """Find for coarse vertices a body vertex opposite to the one that they touch, which the garment touches elsewhere.

    A coarse vertex searches once in ``PHASES`` frames, or in each if ``phase`` is below 0.
    """
    body, normals, across = ti.static(covered.surface.body_start, covered.surface.body_normals, covered.across)
    _sort_touched(covered)
    for c in range(across.shape[0]):
        own, old = covered.coarse_nearest[c], across[c]
        if own < 0 or covered.coarse_contact[c] >= covered.level:
            across[c] = -1
        else:
            # A coarse vertex that goes over from one part to the other leaves the part behind that was opposite to the
            # first.
            stale = old >= 0 and not _opposed(body[own], normals[own], body[old], normals[old])
            if stale or phase < 0 or c % PHASES == phase:
                across[c] = _opposite(own, covered)
                covered.moved[c] = ti.max(covered.moved[c], _went_over(across[c], old, covered))


@ti.func
def _opposite(own: ti.i32, covered: ti.template()) -> ti.i32:
    """The nearest body vertex within MAX_ACROSS of body vertex ``own`` that is opposite to it and touched; or -1."""
    body, normals, start = ti.static(covered.surface.body_start, covered.surface.body_normals, covered.cell_start)
    best, distance = -1, MAX_ACROSS * MAX_ACROSS
    at = ti.cast(ti.floor(body[own] / MAX_ACROSS), ti.i32)
    for neighbour in range(27):
        cell = _hash(at[0] + neighbour // 9 - 1, at[1] + neighbour // 3 % 3 - 1, at[2] + neighbour % 3 - 1, covered)
        for k in range(start[cell], start[cell + 1]):
            seed = covered.cell_items[k]
            offset = body[seed] - body[own]
            away = offset.dot(offset)
            if away < distance and _opposed(body[own], normals[own], body[seed], normals[seed]):
                distance = away
                best = seed
    return best


@ti.func
def _tested_height(vertex: ti.i32, covered: ti.template()) -> ti.f32:
    """Cloth lower than this over the tangent plane of a body vertex is tested against the faces there [m]."""
    return ti.min(covered.clearance[vertex] + MAX_TESTED_EXCESS, MAX_HEIGHT)


@ti.func
def _height(p: vec3, vertex: ti.i32, edge: ti.i32, covered: ti.template()):
    """Normal of the body near one of its vertices, height of p [m] over it, and the clearance there [m].

    Near the body the nearer one of the two faces beside an edge counts, see :func:`_edge_towards`; further away the
    tangent plane is enough.
    """
    body, normals, clearance = ti.static(covered.surface.body_start, covered.surface.body_normals, covered.clearance)
    offset = p - body[vertex]
    normal, height, kept = normals[vertex], offset.dot(normals[vertex]), 0.0
    if height < _tested_height(vertex, covered):
        f, w = ti.Vector([vertex, vertex]), vec3(1.0, 0.0, 0.0)
        if _has_more_edges(vertex, covered):
            f, w, _squared = closest_in_fan(p, vertex, 0.0, covered.surface)
        elif edge >= 0:
            first, second, other = covered.edge_ends[edge], covered.edge_sides[edge][0], covered.edge_sides[edge][1]
            along = body[first] - body[vertex]
            w, gain = _weights_beside(offset, along, body[second] - body[vertex])
            other_w, other_gain = _weights_beside(offset, along, body[other] - body[vertex])
            f = ti.Vector([first, ti.select(other_gain > gain, other, second)])
            w = ti.select(other_gain > gain, other_w, w)
        offset -= w[1] * (body[f[0]] - body[vertex]) + w[2] * (body[f[1]] - body[vertex])
        normal = w[0] * normals[vertex] + w[1] * normals[f[0]] + w[2] * normals[f[1]]
        normal /= ti.max(normal.norm(), 1e-20)
        kept = w[0] * clearance[vertex] + w[1] * clearance[f[0]] + w[2] * clearance[f[1]]
        height = offset.dot(normal)
        if offset.dot(offset) > MAX_FACE_DISTANCE * MAX_FACE_DISTANCE:
            height = MAX_HEIGHT
    return normal, height, kept


@ti.func
def _weights_beside(offset: vec3, edge: vec3, side: vec3):
    """Closest point of a triangle to a place whose nearest corner is the first.

    Args:
        offset: from that corner to the place [m].
        edge: to the second corner; it is nearer to the place than the side to the third corner [m].

    Returns:
        barycentric weights; by how much the place is nearer to that point than to the first corner, squared [m2].
    """
    a, b, c = edge.dot(edge), edge.dot(side), side.dot(side)
    d, e = offset.dot(edge), offset.dot(side)
    u, v, area = c * d - b * e, a * e - b * d, ti.max(a * c - b * b, 1e-20)
    over = ti.min(u, v) > 0.0
    # Beyond the third side the point is taken on that side, in the direction of the projection.
    scale = 1.0 / ti.max(u + v, area)
    u, v = ti.select(over, u * scale, d / a), ti.select(over, v * scale, 0.0)
    return vec3(1.0 - u - v, u, v), u * d + v * e


class Relaxation:
    """One quasi-static pass on the fine mesh: stretched edges back to length, held vertices in place, out of the body.

    Args:
        mesh: the fine mesh.
        held: its held vertices, int, shape (P,).
        leading: coarse vertices around each fine one, whose contact it starts from; see
            :func:`wrinkles.charts.leading_vertices`.
        clearance: kept from the body at each of its vertices [m], float32, shape (b,); see
            :func:`wrinkles.clearance.clearances`.
        facing: 1 where the garment's faces look away from the body, -1 where they look at it.
        level: where the coarse vertices around a fine one are all further than this from the body, so is that one [m].
    """

    def __init__(
        self,
        mesh: ClothMesh,
        held: np.ndarray,
        leading: np.ndarray,
        clearance: np.ndarray,
        facing: float,
        level: float = LEVEL,
    ) -> None:
        ensure_initialized()
        is_held = np.zeros(len(mesh.vertices), bool)
        is_held[held] = True
        # Vertices that lie near one another look at the same part of the body.
        order = np.lexsort((leading[:, 1], leading[:, 0]))
        self._free = order[~is_held[order]].astype(np.int32)
        self._leading = np.ascontiguousarray(leading[self._free], np.int32)
        self._edges, lengths, self._free_edges = edges_by_color(*mesh.edge_lengths(), is_held)
        self._lengths = lengths.astype(np.float32)
        self._held = np.asarray(held, np.int32)
        self._clearance, self._facing, self._level = clearance, facing, level
        self._forget(int(leading.max()) + 1)

    def _forget(self, coarse_count: int) -> None:
        """Make everything that changes from pass to pass."""
        count = len(self._free)
        self._nearest = np.full(2 * count, -1, np.int32)
        self._across, self._before = (np.full(coarse_count, -1, np.int32) for _ in range(2))
        self._moved = np.zeros(coarse_count, np.int32)
        self._work = np.zeros((count + len(self._held), 4), np.float32)
        cells = 1 << (2 * coarse_count).bit_length()
        self._cells = np.zeros(cells + 1, np.int32), *(np.zeros(2 * coarse_count, np.int32) for _ in range(2))
        self._targets = np.zeros((len(self._held), 3), np.float32)
        self._phase = -1  # every vertex searches
        self._relax = Launch(_relax)

    @classmethod
    def of(cls, levels: Levels, body_vertices: np.ndarray, body_faces: np.ndarray, thickness: float) -> "Relaxation":
        """Relaxation of a garment on a body.

        Args:
            levels: of the garment.
            body_vertices: of the body in its bind pose [m], shape (b, 3).
            body_faces: int, shape (k, 3).
            thickness: kept from a flat body [m].
        """
        edges, lengths = levels.fine.edge_lengths()
        longest = np.zeros(len(levels.fine.vertices))
        np.maximum.at(longest, edges, lengths[:, None])
        spacing = longest[cKDTree(levels.fine.vertices).query(body_vertices)[1]]
        return cls(
            levels.fine,
            levels.fine_held,
            leading_vertices(levels.subdivision),
            clearances(body_vertices, body_faces, spacing, thickness),
            facing(levels.coarse, body_vertices, body_faces),
            LEVEL if levels.subdivision.binding is None else PLEATED,
        )

    def fresh(self) -> "Relaxation":
        """A relaxation of the same garment that remembers no pass; what takes long to set up is shared."""
        other = copy(self)
        other._forget(len(self._across))
        return other

    @property
    def memory(self) -> tuple[np.ndarray | int, ...]:
        """What the next pass starts from: where the last ones found the body. A copy; may be set again."""
        return *(array.copy() for array in self._remembered), self._phase

    @memory.setter
    def memory(self, memory: tuple[np.ndarray | int, ...]) -> None:
        *arrays, phase = memory
        for array, kept in zip(self._remembered, arrays, strict=True):
            array[:] = kept
        self._phase = int(phase)

    @property
    def _remembered(self) -> tuple[np.ndarray, ...]:
        return self._nearest, self._across, self._before

    def __call__(
        self,
        fine: np.ndarray,
        targets: np.ndarray,
        frames: np.ndarray,
        coarse_nearest: np.ndarray,
        coarse_contact: np.ndarray,
        body: Body,
        current: np.ndarray,
        passes: int = 1,
    ) -> None:
        """Relax ``fine`` in place.

        Args:
            fine: [m], float32, shape (N, 3), about the body's origin.
            targets: of the held vertices [m], shape (P, 3).
            frames: of the coarse vertices, as :meth:`Stencil.gather` gives them, float32, shape (n, 9).
            coarse_nearest: body vertex near each coarse vertex, -1 for none, int32, shape (n,) or longer.
            coarse_contact: distance of the coarse vertices, as in :class:`pbd.State`, float32, shape (n,).
            body: gives neighbourhoods and normals.
            current: where its vertices are [m], float32, shape (b, 3).
            passes: number of passes.
        """
        self._targets[:] = targets
        self._relax(
            fine,
            self._work,
            self._free,
            self._edges,
            self._lengths,
            self._free_edges,
            self._held,
            self._targets,
            self._leading,
            frames,
            self._facing,
            coarse_nearest,
            coarse_contact,
            self._before,
            self._moved,
            self._nearest,
            *body.first_edges,
            self._phase,
            self._across,
            *self._cells,
            self._level,
            current,
            body.normals,
            body.ring_start,
            body.ring,
            body.fan_start,
            body.fan,
            self._clearance,
            passes,
        )
        self._phase = (self._phase + 1) % PHASES
