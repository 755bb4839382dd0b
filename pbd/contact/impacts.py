"""The last word of a substep: cloth that starts it free of crossings ends it free of them.

The closest points of two features that are apart give a direction. Along it, the least coordinate of the one less the
greatest of the other is concave over a straight motion of their corners. So features that are apart along it at both
ends of the substep are apart in all of it. (Chen et al. 2025, "Offset geometric contact", bound the displacement of
each vertex instead, which also holds back cloth that moves as a whole.) Pairs that would not be apart at the end are
brought apart along their direction. Where that does not end, because one pair pushes another, the vertices of such
pairs move on as rigid pieces (the zones of impact of Provot 1997).
"""

import numpy as np

from pbd.contact.pairs import closest_on_segments, corners_of
from pbd.crossings import FaceGrid
from pbd.engine import ti
from pbd.geometry import Double1, Double3, Double4, Int1, Int2, Int3, Int4, closest_on_triangle
from pbd.taichi_internals import Launch

__all__ = ["Impacts"]

MARGIN = 1e-3  # by which boxes over the motion are larger: pairs are good while corrections are smaller [m], ...
MAX_LISTS = 6  # ... and are listed anew, so often at most, where one is larger
MOST_PAIRS = 20  # of faces, for each that counts: cloth that has more goes to and fro by its own size, and is left so
LEAST_PAIRS = 100_000  # for which there is always room
KEPT_GAP = 0.2  # share of their distance at the start that features keep at least [-], ...
LEAST_GAP = 4e-6  # ... and a gap that they keep if they have it: far above the rounding of positions [m]
HALVINGS = 24  # of the range in which the level between two features is looked for
PASSES = 40  # over the pairs, before what still collides is moved as rigid pieces


@ti.kernel
def list_impacts(
    start: Double3,
    end: Double3,
    faces: Int3,
    edges: Int2,
    owned: Int1,
    seam: Int1,
    near: Int2,
    count: ti.i32,
    pairs: Int4,
    directions: Double4,
    found: Int1,
):
    """List the pairs of features of the first ``count`` pairs of faces that might collide from start to end [m].

    ``directions`` receives the direction of each, and the gap along it that is kept [m]; ``found`` how many there are.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        found[0] = 0
        for r in range(count):
            f, g = near[r][0], near[r][1]
            for n in range(15):
                q, own = ti.Vector([-1, 0, 0, 0]), 0
                if n < 6:
                    one, two, corner = f, g, n
                    if n >= 3:
                        one, two, corner = g, f, n - 3
                    v, t = faces[one][corner], faces[two]
                    own = (owned[one] >> corner) & 1
                    if v != t[0] and v != t[1] and v != t[2]:
                        q = ti.Vector([v, t[0], t[1], t[2]])
                else:
                    side, other = (n - 6) // 3, (n - 6) % 3
                    e, d = edges[3 * f + side], edges[3 * g + other]
                    own = (owned[f] >> (3 + side)) & (owned[g] >> (3 + other)) & 1
                    if e[0] != d[0] and e[0] != d[1] and e[1] != d[0] and e[1] != d[1]:
                        q = ti.Vector([e[0], -e[1] - 1, d[0], d[1]])
                if own == 0 or q[0] < 0:
                    continue
                if seam.shape[0] > 0:
                    if joined(q, seam):
                        continue
                if may_meet(q, start, end):
                    offset = distance(q, start)
                    size = offset.norm()
                    normal = offset / ti.max(size, 1e-30)
                    a, b = extremes(q, corners_of(q), normal, start)
                    if a > b:  # those that touch have no direction
                        if found[0] < pairs.shape[0]:
                            kept = ti.max(KEPT_GAP * (a - b), ti.min(a - b, LEAST_GAP))
                            pairs[found[0]] = q
                            directions[found[0]] = ti.Vector([normal[0], normal[1], normal[2], kept])
                        found[0] += 1


@ti.func
def joined(q, seam: ti.template()):
    """Whether both features of a pair have a vertex of the same seam."""
    k = corners_of(q)
    a, b, c, d = seam[k[0]], seam[k[1]], seam[k[2]], seam[k[3]]
    found = a == c or a == d
    if q[1] < 0:
        found = found or b == c or b == d
    else:
        found = found or a == b
    return found


@ti.func
def may_meet(q, start: ti.template(), end: ti.template()):
    """Whether the boxes of both features over their motion are near."""
    k = corners_of(q)
    low, high = ti.min(start[k[0]], end[k[0]]), ti.max(start[k[0]], end[k[0]])
    other_low = ti.min(ti.min(start[k[2]], end[k[2]]), ti.min(start[k[3]], end[k[3]]))
    other_high = ti.max(ti.max(start[k[2]], end[k[2]]), ti.max(start[k[3]], end[k[3]]))
    least, most = ti.min(start[k[1]], end[k[1]]), ti.max(start[k[1]], end[k[1]])
    if q[1] < 0:
        low, high = ti.min(low, least), ti.max(high, most)
    else:
        other_low, other_high = ti.min(other_low, least), ti.max(other_high, most)
    return (low - MARGIN <= other_high).all() and (other_low - MARGIN <= high).all()


@ti.func
def distance(q, position: ti.template()):
    """From the closest point of the second feature of a pair to that of the first [m]."""
    k = corners_of(q)
    x0, x1, x2, x3 = position[k[0]], position[k[1]], position[k[2]], position[k[3]]
    offset = x0 - x2
    if q[1] < 0:
        s, t = closest_on_segments(x1 - x0, x3 - x2, x0 - x2)
        offset = (x0 - x2) + s * (x1 - x0) - t * (x3 - x2)
    else:
        w = closest_on_triangle(x0, x1, x2, x3)
        offset = w[0] * (x0 - x1) + w[1] * (x0 - x2) + w[2] * (x0 - x3)
    return offset


@ti.func
def extremes(q, k, n, end: ti.template()):
    """Coordinates along a direction [m]: the least of the first feature, and the greatest of the second."""
    a, b = end[k[0]].dot(n), ti.max(end[k[2]].dot(n), end[k[3]].dot(n))
    second = end[k[1]].dot(n)
    if q[1] < 0:
        a = ti.min(a, second)
    else:
        b = ti.max(b, second)
    return a, b


@ti.kernel
def part_pairs(
    start: Double3,
    end: Double3,
    inverse_mass: Double1,
    pairs: Int4,
    directions: Double4,
    count: ti.i32,
    passes: ti.i32,
    rigid: Int1,
    zone: Int1,
    motion: Double4,
    result: Int1,
):
    """Change the ends of the motion [m] so that all pairs stay apart.

    Args:
        start, end: of the vertices; ``inverse_mass`` [1/kg].
        pairs, directions, count: see :func:`list_impacts`.
        passes: over the pairs at most.
        rigid: workspace, a number for each pair; ``zone``, ``motion``: a row for each vertex.
        result: receives how many pairs collided, and how many vertices moved on in rigid pieces.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        collided, left, made = 0, 1, 0
        while left > 0 and made < passes:
            left = 0
            for c in range(count):
                q, n = pairs[c], ti.Vector([directions[c][0], directions[c][1], directions[c][2]])
                k = corners_of(q)
                a, b = extremes(q, k, n, end)
                if a - b < directions[c][3]:
                    left += 1
                    # Half as much again: a pair at its bound would be the first to collide again.
                    part(q, k, n, a, b, 1.5 * directions[c][3], inverse_mass, end)
            if made == 0:
                collided = left
            made += 1
        result[0], result[1] = collided, 0
        if left > 0:
            result[1] = move_zones(start, end, inverse_mass, pairs, directions, count, rigid, zone, motion)


@ti.func
def part(q, k, n, a: ti.f64, b: ti.f64, gap: ti.f64, inverse_mass: ti.template(), end: ti.template()):
    """Move the corners that are too far along a direction so that both features are a gap apart [m].

    The first feature's go to the one side of a level, the second's to the other. The level is where both gain the same
    momentum.
    """
    least, most = ti.min(a, b) - gap, ti.max(a, b) + gap
    for _ in range(HALVINGS):
        level = 0.5 * (least + most)
        gained = level_gain(q, k, n, level, gap, inverse_mass, end)
        if gained > 0.0:
            most = level
        else:
            least = level
    level = 0.5 * (least + most)
    for corner in ti.static(range(4)):
        i = k[corner]
        of_first = corner == 0 or (corner == 1 and q[1] < 0)
        if inverse_mass[i] > 0.0:
            end[i] += beyond(of_first, end[i].dot(n), level, gap) * n


@ti.func
def beyond(of_first, along: ti.f64, level: ti.f64, gap: ti.f64):
    """How far a corner must go along the direction, so that it is half a gap on its side of a level [m]."""
    move = ti.min(level - 0.5 * gap - along, 0.0)
    if of_first:
        move = ti.max(level + 0.5 * gap - along, 0.0)
    return move


@ti.func
def level_gain(q, k, n, level: ti.f64, gap: ti.f64, inverse_mass: ti.template(), end: ti.template()):
    """Mass times way along the direction that all corners gain if they go to their sides of a level [kg m]."""
    gained = ti.cast(0.0, ti.f64)
    for corner in ti.static(range(4)):
        i = k[corner]
        of_first = corner == 0 or (corner == 1 and q[1] < 0)
        # A held vertex does not move: as a very heavy one it draws the level to where it need not.
        gained += beyond(of_first, end[i].dot(n), level, gap) / ti.max(inverse_mass[i], 1e-9)
    return gained


@ti.func
def move_zones(
    start: ti.template(),
    end: ti.template(),
    inverse_mass: ti.template(),
    pairs: ti.template(),
    directions: ti.template(),
    count: ti.i32,
    rigid: ti.template(),
    zone: ti.template(),
    motion: ti.template(),
):
    """Let the corners of pairs that still collide move on without turning, joined where they have a vertex in common.

    Pairs that collide with these corners are joined to them, until no pair does.

    Returns:
        how many vertices.
    """
    for i in range(end.shape[0]):
        zone[i] = -1
    for c in range(count):
        rigid[c] = 0
    moved, collided = 0, 1
    while collided != 0:
        collided = 0
        for c in range(count):
            if rigid[c] == 0:
                q, n = pairs[c], ti.Vector([directions[c][0], directions[c][1], directions[c][2]])
                k = corners_of(q)
                a, b = extremes(q, k, n, end)
                if a - b < directions[c][3]:
                    rigid[c], collided = 1, 1
                    for corner in ti.static(range(4)):
                        zone[k[corner]] = ti.max(zone[k[corner]], k[corner])
        if collided != 0:
            join_zones(pairs, count, rigid, zone)
            moved = move_rigidly(start, end, inverse_mass, zone, motion)
    return moved


@ti.func
def join_zones(pairs: ti.template(), count: ti.i32, rigid: ti.template(), zone: ti.template()):
    """Give the corners of each rigid pair the same zone."""
    changed = 1
    while changed != 0:
        changed = 0
        for c in range(count):
            if rigid[c] != 0:
                k = corners_of(pairs[c])
                most = ti.max(ti.max(zone[k[0]], zone[k[1]]), ti.max(zone[k[2]], zone[k[3]]))
                for corner in ti.static(range(4)):
                    if zone[k[corner]] != most:
                        zone[k[corner]] = most
                        changed = 1


@ti.func
def move_rigidly(
    start: ti.template(), end: ti.template(), inverse_mass: ti.template(), zone: ti.template(), motion: ti.template()
) -> ti.i32:
    """Move the vertices of each zone by their mean motion; returns how many there are in all."""
    moved = 0
    for i in range(end.shape[0]):
        motion[i] = ti.Vector([0.0, 0.0, 0.0, 0.0])
    for i in range(end.shape[0]):
        if zone[i] >= 0:
            moved += 1
            # A held vertex weighs as much as a thousand tonnes: its zone goes with it.
            mass = 1.0 / ti.max(inverse_mass[i], 1e-6)
            step = mass * (end[i] - start[i])
            motion[zone[i]] += ti.Vector([step[0], step[1], step[2], mass])
    for i in range(end.shape[0]):
        if zone[i] >= 0:
            m = motion[zone[i]]
            end[i] = start[i] + ti.Vector([m[0], m[1], m[2]]) / m[3]
    return moved


class Impacts:
    """Keeps the cloth of one mesh from going through itself in a motion.

    Args:
        faces: int, shape (m, 3).
        count: of vertices.
        seam: see :class:`pbd.crossings.FaceGrid`.

    Attributes:
        grid: finds the faces that are near one another.
    """

    def __init__(self, faces: np.ndarray, count: int, seam: np.ndarray | None = None) -> None:
        self.grid = FaceGrid(faces, seam)
        self._zone, self._motion = np.zeros(count, np.int32), np.zeros((count, 4))
        self._found, self._result = np.zeros((2, 2), np.int32)
        self._list, self._part = Launch(list_impacts), Launch(part_pairs)
        self._make_room(count)

    def _make_room(self, count: int) -> None:
        self._pairs, self._directions = np.zeros((count, 4), np.int32), np.zeros((count, 4))
        self._rigid = np.zeros(count, np.int32)

    def keep_apart(
        self, start: np.ndarray, end: np.ndarray, inverse_mass: np.ndarray, chosen: np.ndarray | None = None
    ) -> tuple[int, int]:
        """Change the end of a straight motion, in place, so that no face goes through another on the way.

        Args:
            start, end: positions of the vertices [m], float64, shape (n, 3). The start is free of crossings.
            inverse_mass: of the vertices [1/kg], float64, shape (n,); 0 for those that are held.
            chosen: numbers of the faces that count, int32; None for all.

        Returns:
            how many pairs collided, and how many vertices moved on in rigid pieces.
        """
        collided, rigid, proposed, largest = 0, 0, np.zeros_like(end), np.inf
        for _ in range(MAX_LISTS):
            proposed[:] = end
            found = self._list_pairs(start, end, chosen)
            self._part(
                start, end, inverse_mass, self._pairs, self._directions, found, PASSES, self._rigid, self._zone,
                self._motion, self._result,
            )  # fmt: skip
            correction = float(np.abs(end - proposed).max())
            if correction > largest:  # boxes and corrections make one another larger: the last ones lead nowhere
                end[:] = proposed
                break
            collided, rigid = max(collided, int(self._result[0])), max(rigid, int(self._result[1]))
            if correction < MARGIN:
                break
            largest = correction
        return collided, rigid

    def _list_pairs(self, start: np.ndarray, end: np.ndarray, chosen: np.ndarray | None) -> int:
        """List the pairs of features that might collide; returns how many there are."""
        grid = self.grid
        counting = len(grid.faces if chosen is None else chosen)
        near, count = grid.pairs(start, end, MARGIN, chosen=chosen, most=max(MOST_PAIRS * counting, LEAST_PAIRS))
        while True:
            self._list(
                start, end, grid.faces, grid.edges, grid.owned, grid.seam, near, count, self._pairs, self._directions,
                self._found,
            )  # fmt: skip
            found = int(self._found[0])
            if found <= len(self._pairs):
                return found
            self._make_room(found * 3 // 2)
