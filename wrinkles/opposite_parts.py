"""Parts of the body that face one another with cloth between: arm and trunk, both legs, a hand on the hip."""

from dataclasses import dataclass
from typing import Any

from pbd.engine import ti
from pbd.geometry import vec3, vec4, xyz
from pbd.taichi_internals import in_kernel

__all__ = ["BETWEEN", "NEAR", "PHASES", "TouchedBody", "find_parts", "opposed"]

MAX_ACROSS = 0.05  # an opposite part of the body is searched so far from the part that a coarse vertex covers [m]
PHASES = 8  # frames in which every coarse vertex searches for an opposite part once
# Two parts do not face one another, but are sides of one bump, if one lies behind the other by more than this sine, ...
MAX_SINE_BEHIND = 0.7
MAX_OVERLAP = 0.008  # ... unless it is by no more than this, and their normals point apart: then they overlap [m]
MAX_WANDER = 0.03  # a coarse vertex whose body vertex is so far from its last one has gone over to another part [m]
# What a coarse vertex says of the fine ones around it: that the body is near, that it has gone over to another part of
# the body, that it lies between two parts.
NEAR, MOVED, BETWEEN = 1, 2, 4


@in_kernel
@dataclass(eq=False)
class TouchedBody:
    """The body under the coarse garment in one pass; a view, see :mod:`pbd.xpbd.views`.

    Attributes:
        body, normals: of the body's vertices [m], [-].
        nearest, contact: body vertex near each coarse vertex, -1 for none, and distance to the body [m].
        before: ``nearest`` of the last pass.
        across: of each coarse vertex a body vertex opposite to the one that it is near to, -1 for none.
        state: of each coarse vertex the sum of :data:`NEAR`, :data:`MOVED` and :data:`BETWEEN`, so far as they apply.
        cell_start, items, item_places: workspace of :func:`sort_touched`: where cells start; in their order body
            vertices, and beside them the cells before they are sorted; positions and normals of these vertices.
        level: coarse vertices further than this from the body are not near it [m].
    """

    body: Any
    normals: Any
    nearest: Any
    contact: Any
    before: Any
    across: Any
    state: Any
    cell_start: Any
    items: Any
    item_places: Any
    level: Any
    _data_oriented = True


@ti.func
def opposed(p: vec3, normal: vec3, q: vec3, other_normal: vec3) -> bool:
    """Whether two places of the body [m] face one another; both sides of a bump look apart as well, but from behind."""
    offset = q - p
    apart = -normal.dot(other_normal)
    limit = -ti.max(MAX_SINE_BEHIND * offset.norm(), MAX_OVERLAP * apart)
    return apart > 0.0 and offset.dot(normal) > limit and -offset.dot(other_normal) > limit


@ti.func
def went_over(now: ti.i32, last: ti.i32, touched: ti.template()) -> ti.i32:
    """1 if one body vertex is not beside another, which may be -1 for none; else 0."""
    moved = 0
    if now >= 0 and now != last:
        moved = 1
        if last >= 0:
            offset = touched.body[now] - touched.body[last]
            moved = ti.cast(offset.dot(offset) > MAX_WANDER * MAX_WANDER, ti.i32)
    return moved


@ti.func
def find_parts(phase: ti.i32, touched: ti.template()):
    """Find for coarse vertices a body vertex opposite to the one that they touch, which the garment touches elsewhere.

    A coarse vertex searches once in ``PHASES`` frames, or in each if ``phase`` is below 0. ``state`` is written: what
    each coarse vertex says of the fine ones around it.
    """
    body, normals, across = ti.static(touched.body, touched.normals, touched.across)
    sort_touched(touched)
    for c in range(across.shape[0]):
        own, old = touched.nearest[c], across[c]
        moved = went_over(own, touched.before[c], touched)
        touched.before[c] = own
        near = touched.contact[c] < touched.level
        if own < 0 or not near:
            across[c] = -1
        else:
            # A coarse vertex that goes over from one part to the other leaves the part behind that was opposite to the
            # first.
            stale = old >= 0 and not opposed(body[own], normals[own], body[old], normals[old])
            if stale or phase < 0 or c % PHASES == phase:
                across[c] = nearest_opposite(own, touched)
                moved |= went_over(across[c], old, touched)
        touched.state[c] = ti.select(near, NEAR, 0) | MOVED * moved | ti.select(across[c] >= 0, BETWEEN, 0)


@ti.func
def nearest_opposite(own: ti.i32, touched: ti.template()) -> ti.i32:
    """The nearest body vertex within MAX_ACROSS of body vertex ``own`` that is opposite to it and touched; or -1."""
    start, places = ti.static(touched.cell_start, touched.item_places)
    p, normal = touched.body[own], touched.normals[own]
    best, distance = -1, MAX_ACROSS * MAX_ACROSS
    at = ti.cast(ti.floor(p / MAX_ACROSS), ti.i32)
    for neighbour in range(27):
        cell = hashed(at[0] + neighbour // 9 - 1, at[1] + neighbour // 3 % 3 - 1, at[2] + neighbour % 3 - 1, touched)
        for k in range(start[cell], start[cell + 1]):
            other = xyz(places[k, 1])
            if normal.dot(other) < 0.0:  # most of what is near belongs to the same part
                q = xyz(places[k, 0])
                away = (q - p).dot(q - p)
                if away < distance and opposed(p, normal, q, other):
                    distance = away
                    best = touched.items[k][0]
    return best


@ti.func
def sort_touched(touched: ti.template()):
    """Sort the body vertices that the garment touches into cells, by counting."""
    start, items = ti.static(touched.cell_start, touched.items)
    count = items.shape[0]
    for c in range(start.shape[0]):
        start[c] = 0
    for k in range(count):
        b = item(k, touched)
        items[k][1] = -1
        if b >= 0:
            cell = cell_of(touched.body[b], touched)
            items[k][1] = cell
            start[cell] = start[cell] + 1
    for c in range(start.shape[0] - 1):
        start[c + 1] = start[c + 1] + start[c]
    # Filled from the back: in the end cell c starts at start[c].
    for k in range(count):
        cell = items[k][1]
        if cell >= 0:
            start[cell] = start[cell] - 1
            place, b = start[cell], item(k, touched)
            items[place][0] = b
            touched.item_places[place, 0] = vec4(touched.body[b])
            touched.item_places[place, 1] = vec4(touched.normals[b])


@ti.func
def item(k: ti.i32, touched: ti.template()) -> ti.i32:
    """A body vertex that the garment touches, -1 for none: first those near the coarse vertices, then opposite ones."""
    count = touched.across.shape[0]
    c = ti.select(k < count, k, k - count)
    found = ti.select(k < count, touched.nearest[c], touched.across[c])
    return ti.select(touched.contact[c] < touched.level, found, -1)


@ti.func
def cell_of(p: vec3, touched: ti.template()) -> ti.i32:
    """Number of the cell that p [m] lies in: a hash of its three coordinates, counted in cells MAX_ACROSS wide."""
    q = ti.cast(ti.floor(p / MAX_ACROSS), ti.i32)
    return hashed(q[0], q[1], q[2], touched)


@ti.func
def hashed(x: ti.i32, y: ti.i32, z: ti.i32, touched: ti.template()) -> ti.i32:
    """A number below the number of cells, which is a power of two (Teschner et al. 2003, spatial hashing)."""
    return ((x * 73856093) ^ (y * 19349663) ^ (z * 83492791)) & (touched.cell_start.shape[0] - 2)
