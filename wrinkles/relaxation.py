"""One quasi-static pass on the fine mesh: stretched edges back to length, held vertices in place, out of the body."""

from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from pbd.contact.colliders import Body
from pbd.engine import ensure_initialized, ti
from pbd.geometry import Float1, Float2, Int1, Int2, Int3, Vec3, Vec4, closest_in_fan, descend, vec3, vec4, xyz
from pbd.mesh import ClothMesh
from pbd.taichi_internals import Launch, in_kernel
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
# A remembered place of the body serves until the vertex has slid so far along the body from where it was found ...
MAX_SLIDE = 0.0015  # ... [m], and this share of its height over the tested ones, where it is further away.
SLIDE_SHARE = 0.5
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
        corners: the other two corners of the face that was the closest there, -1 where the vertex was too high for a
            test against faces.
        beside: how far the vertex was then from the place that was found, along the body [m].
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
    corners: Any
    beside: Any
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
    corners: Int2,
    beside: Float1,
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
            BodySurface(body, body, ring_start, ring, fan_start, fan, body_normals), clearance, nearest, corners,
            beside, coarse_nearest, coarse_contact, coarse_before, moved, across, cell_start, cell_items, item_cell,
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
            best, n, h, c = _remembered(slot, p, covered)
            if best < 0 or anew:
                best = _searched(i, part, p, home, outwards, anew, covered)
                covered.nearest[slot] = best
                if best < 0:
                    break
                n, h, c = _height(p, best, slot, covered)
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
def _remembered(slot: ti.i32, p: vec3, covered: ti.template()):
    """Where the body is near p [m] by what an earlier pass found in a slot of :class:`_Covered`.

    The place that was found moves with the body, and p may have come nearer to it in any way; once p has slid along the
    body it no longer serves.

    Returns:
        body vertex, -1 if the place does not serve; the others as :func:`_height`.
    """
    body, normals, clearance = ti.static(covered.surface.body_start, covered.surface.body_normals, covered.clearance)
    best = covered.nearest[slot]
    normal, height, kept = vec3(0.0), MAX_HEIGHT, 0.0
    if best >= 0:
        f, offset, reach = covered.corners[slot], p - body[best], covered.beside[slot] + MAX_SLIDE
        if f[0] < 0:
            normal = normals[best]
            height = offset.dot(normal)
            room = height - _tested_height(best, covered)
            reach += SLIDE_SHARE * ti.max(room, 0.0)
            if room < 0.0:
                best = -1
        else:
            w = _weights_near(offset, body[f[0]] - body[best], body[f[1]] - body[best])
            offset -= w[1] * (body[f[0]] - body[best]) + w[2] * (body[f[1]] - body[best])
            normal = w[0] * normals[best] + w[1] * normals[f[0]] + w[2] * normals[f[1]]
            normal /= ti.max(normal.norm(), 1e-20)
            kept = w[0] * clearance[best] + w[1] * clearance[f[0]] + w[2] * clearance[f[1]]
            height = offset.dot(normal)
            if ti.abs(height) > MAX_HEIGHT:
                best = -1
        if offset.dot(offset) - height * height > reach * reach:
            best = -1
    return best, normal, height, kept


@ti.func
def _searched(
    i: ti.i32, part: ti.i32, p: vec3, home: vec3, outwards: vec3, anew: bool, covered: ti.template()
) -> ti.i32:
    """Body vertex nearest to free vertex i at p [m], on the part that it covers (0) or on the opposite one (1); or -1.

    On the part that it covers the search goes on from where it was. Another part does not come near unseen: the coarse
    vertices around would have found it.

    Args:
        home, outwards: place of the body that it covers [m] and normal there, of use for the opposite part only.
        anew: whether to look for a start, though there is one from the last pass.
    """
    body, normals, frames = ti.static(covered.surface.body_start, covered.surface.body_normals, covered.frames)
    last = covered.nearest[i + part * covered.leading.shape[0]]
    best = last
    if anew or last < 0:
        way = outwards
        if part == 0:
            coarse = covered.leading[i][0]
            way = covered.facing * vec3(frames[coarse, 6], frames[coarse, 7], frames[coarse, 8])
        best = _start(i, part, last, p, home, way, covered)
    if best >= 0:
        best = descend(p, best, 0.0, covered.surface)
    if part == 1 and best >= 0 and not _opposed(home, outwards, body[best], normals[best]):
        best = -1
    return best


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
def _weights_near(offset: vec3, side_1: vec3, side_2: vec3) -> vec3:
    """Barycentric weights of the point of a triangle near ``offset`` from its first corner [m].

    Inside it is the closest point. Outside it is near the closest one on the rim.
    """
    a, b, c = side_1.dot(side_1), side_1.dot(side_2), side_2.dot(side_2)
    d, e = offset.dot(side_1), offset.dot(side_2)
    scale = 1.0 / ti.max(a * c - b * b, 1e-20)
    u, v = ti.max((c * d - b * e) * scale, 0.0), ti.max((a * e - b * d) * scale, 0.0)
    inside = 1.0 / ti.max(u + v, 1.0)
    u, v = u * inside, v * inside
    return vec3(1.0 - u - v, u, v)


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
def _height(p: vec3, vertex: ti.i32, slot: ti.i32, covered: ti.template()):
    """Normal of the body near one of its vertices, height of p [m] over it, and the clearance there [m].

    Near the body the faces around the vertex count; further away its tangent plane is enough. The place is remembered
    in a slot of :class:`_Covered`.
    """
    body, normals, clearance = ti.static(covered.surface.body_start, covered.surface.body_normals, covered.clearance)
    offset = p - body[vertex]
    normal, height, kept = normals[vertex], offset.dot(normals[vertex]), 0.0
    corners, far = ti.Vector([-1, -1]), False
    if height < _tested_height(vertex, covered):
        f, w, squared = closest_in_fan(p, vertex, 0.0, covered.surface)
        offset = p - (w[0] * body[vertex] + w[1] * body[f[0]] + w[2] * body[f[1]])
        normal = w[0] * normals[vertex] + w[1] * normals[f[0]] + w[2] * normals[f[1]]
        normal /= ti.max(normal.norm(), 1e-20)
        kept = w[0] * clearance[vertex] + w[1] * clearance[f[0]] + w[2] * clearance[f[1]]
        height = offset.dot(normal)
        corners = f
        far = squared > MAX_FACE_DISTANCE * MAX_FACE_DISTANCE
    covered.corners[slot] = corners
    covered.beside[slot] = ti.sqrt(ti.max(offset.dot(offset) - height * height, 0.0))
    if far:
        height = MAX_HEIGHT
    return normal, height, kept


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
        self._corners, self._beside = np.full((2 * count, 2), -1, np.int32), np.zeros(2 * count, np.float32)
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
        return self._nearest, self._corners, self._beside, self._across, self._before

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
            self._corners,
            self._beside,
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
