"""Parts of the body that face one another with cloth between: arm and trunk, both legs, a hand on the hip."""

from pbd.engine import ti
from pbd.geometry import vec3

__all__ = ["PHASES", "find_moved", "find_opposite", "opposed"]

MAX_ACROSS = 0.05  # an opposite part of the body is searched so far from the part that a coarse vertex covers [m]
PHASES = 8  # frames in which every coarse vertex searches for an opposite part once
# Two parts do not face one another, but are sides of one bump, if one lies behind the other by more than this sine, ...
MAX_SINE_BEHIND = 0.7
MAX_OVERLAP = 0.008  # ... unless it is by no more than this, and their normals point apart: then they overlap [m]
MAX_WANDER = 0.03  # a coarse vertex whose body vertex is so far from its last one has gone over to another part [m]


@ti.func
def opposed(p: vec3, normal: vec3, q: vec3, other_normal: vec3) -> bool:
    """Whether two places of the body [m] face one another; both sides of a bump look apart as well, but from behind."""
    offset = q - p
    apart = -normal.dot(other_normal)
    limit = -ti.max(MAX_SINE_BEHIND * offset.norm(), MAX_OVERLAP * apart)
    return apart > 0.0 and offset.dot(normal) > limit and -offset.dot(other_normal) > limit


@ti.func
def find_moved(covered: ti.template()):
    """Mark the coarse vertices that touch another part of the body than in the last pass."""
    before = ti.static(covered.coarse_before)
    for c in range(before.shape[0]):
        covered.moved[c] = went_over(covered.coarse_nearest[c], before[c], covered)
        before[c] = covered.coarse_nearest[c]


@ti.func
def went_over(now: ti.i32, last: ti.i32, covered: ti.template()) -> ti.i32:
    """1 if one body vertex is not beside another, which may be -1 for none; else 0."""
    moved = 0
    if now >= 0 and now != last:
        moved = 1
        if last >= 0:
            offset = covered.surface.body_start[now] - covered.surface.body_start[last]
            moved = ti.cast(offset.dot(offset) > MAX_WANDER * MAX_WANDER, ti.i32)
    return moved


@ti.func
def find_opposite(phase: ti.i32, covered: ti.template()):
    """Find for coarse vertices a body vertex opposite to the one that they touch, which the garment touches elsewhere.

    A coarse vertex searches once in ``PHASES`` frames, or in each if ``phase`` is below 0.
    """
    body, normals, across = ti.static(covered.surface.body_start, covered.surface.body_normals, covered.across)
    sort_touched(covered)
    for c in range(across.shape[0]):
        own, old = covered.coarse_nearest[c], across[c]
        if own < 0 or covered.coarse_contact[c] >= covered.level:
            across[c] = -1
        else:
            # A coarse vertex that goes over from one part to the other leaves the part behind that was opposite to the
            # first.
            stale = old >= 0 and not opposed(body[own], normals[own], body[old], normals[old])
            if stale or phase < 0 or c % PHASES == phase:
                across[c] = nearest_opposite(own, covered)
                covered.moved[c] = ti.max(covered.moved[c], went_over(across[c], old, covered))


@ti.func
def nearest_opposite(own: ti.i32, covered: ti.template()) -> ti.i32:
    """The nearest body vertex within MAX_ACROSS of body vertex ``own`` that is opposite to it and touched; or -1."""
    body, normals, start = ti.static(covered.surface.body_start, covered.surface.body_normals, covered.cell_start)
    best, distance = -1, MAX_ACROSS * MAX_ACROSS
    at = ti.cast(ti.floor(body[own] / MAX_ACROSS), ti.i32)
    for neighbour in range(27):
        cell = hashed(at[0] + neighbour // 9 - 1, at[1] + neighbour // 3 % 3 - 1, at[2] + neighbour % 3 - 1, covered)
        for k in range(start[cell], start[cell + 1]):
            seed = covered.cell_items[k]
            offset = body[seed] - body[own]
            away = offset.dot(offset)
            if away < distance and opposed(body[own], normals[own], body[seed], normals[seed]):
                distance = away
                best = seed
    return best


@ti.func
def sort_touched(covered: ti.template()):
    """Sort the body vertices that the garment touches into cells, by counting."""
    start, items = ti.static(covered.cell_start, covered.cell_items)
    count = covered.item_cell.shape[0]
    for c in range(start.shape[0]):
        start[c] = 0
    for k in range(count):
        b = touched(k, covered)
        covered.item_cell[k] = -1
        if b >= 0:
            cell = cell_of(covered.surface.body_start[b], covered)
            covered.item_cell[k] = cell
            start[cell] = start[cell] + 1
    for c in range(start.shape[0] - 1):
        start[c + 1] = start[c + 1] + start[c]
    # Filled from the back: in the end cell c starts at start[c].
    for k in range(count):
        cell = covered.item_cell[k]
        if cell >= 0:
            start[cell] = start[cell] - 1
            items[start[cell]] = touched(k, covered)


@ti.func
def touched(k: ti.i32, covered: ti.template()) -> ti.i32:
    """A body vertex that the garment touches, -1 for none: first those near the coarse vertices, then opposite ones."""
    count = covered.across.shape[0]
    c = ti.select(k < count, k, k - count)
    found = ti.select(k < count, covered.coarse_nearest[c], covered.across[c])
    return ti.select(covered.coarse_contact[c] < covered.level, found, -1)


@ti.func
def cell_of(p: vec3, covered: ti.template()) -> ti.i32:
    """Number of the cell that p [m] lies in: a hash of its three coordinates, counted in cells MAX_ACROSS wide."""
    q = ti.cast(ti.floor(p / MAX_ACROSS), ti.i32)
    return hashed(q[0], q[1], q[2], covered)


@ti.func
def hashed(x: ti.i32, y: ti.i32, z: ti.i32, covered: ti.template()) -> ti.i32:
    """A number below the number of cells, which is a power of two (Teschner et al. 2003, spatial hashing)."""
    return ((x * 73856093) ^ (y * 19349663) ^ (z * 83492791)) & (covered.cell_start.shape[0] - 2)
