"""Where a curve of crossings cuts a sheet in two: a flood along its edges, and the least cut where it is open."""

from typing import NamedTuple

import numpy as np

from pbd.engine import ti
from pbd.geometry import Int1, Int2
from pbd.taichi_internals import Launch

__all__ = ["CLOSED", "NEAR", "SheetCuts"]

RINGS = 3  # cloth counts as near up to so many edges away
# What a vertex knows of itself while a sheet is cut.
ABOVE, BELOW, NEAR, UPPER = 1, 2, 4, 8
CUT, CLOSED = 1, 2  # results: the curve cuts the sheet by itself, or with the least cut


class CutCurve(NamedTuple):
    """Crossings of one sheet along a curve: ``edges`` (numbers), and their ends ``above`` and ``below`` the other."""

    edges: np.ndarray
    above: np.ndarray
    below: np.ndarray


class SheetCuts:
    """Cuts sheets of one mesh.

    Args:
        edges: of the mesh, int, shape (e, 2).
        count: of vertices.

    Attributes:
        marks: what each vertex is since the last call: bits ``NEAR`` and ``UPPER``, int32, shape (n,).
    """

    def __init__(self, edges: np.ndarray, count: int) -> None:
        ends = np.concatenate([edges[:, 0], edges[:, 1]])
        others = np.concatenate([edges[:, 1], edges[:, 0]])
        order = np.argsort(ends, kind="stable")
        number = np.tile(np.arange(len(edges)), 2)
        self._start = np.searchsorted(ends[order], np.arange(count + 1)).astype(np.int32)
        self._beside = np.stack([others[order], number[order]], axis=1).astype(np.int32)
        self.marks = np.zeros(count, np.int32)
        self._flow = np.zeros(len(edges), np.int32)
        self._parent, self._queue = np.zeros((2, count), np.int32)
        self._result = np.zeros(1, np.int32)
        self._cut, self._spread = Launch(cut_sheet), Launch(spread_marks)

    def upper(self, curve: CutCurve, most: float, nearby: bool) -> np.ndarray | None:
        """The part of the sheet above the other one, as a mask; None if the curve does not cut the sheet.

        Args:
            curve: the crossings; vertices on both sides show nothing.
            most: edges that the least cut may go through where the curve alone does not cut.
            nearby: whether that cut must lie within a few edges of the curve's edges. Then ``marks`` has ``NEAR``.
        """
        marks = self.marks
        self._cut(
            curve.edges, curve.above, curve.below, self._start, self._beside, marks, self._flow, self._parent,
            self._queue, self._result, int(most), int(nearby),
        )  # fmt: skip
        self.closed = int(self._result[0]) == CLOSED
        return (marks & UPPER) > 0 if self._result[0] else None

    def around(self, vertices: np.ndarray, part: np.ndarray) -> np.ndarray:
        """Vertices of a part, a few edges from given ones at most, as masks."""
        self.marks[:] = part
        seeds = np.ascontiguousarray(vertices.ravel(), np.int32)
        if len(seeds):
            self._spread(seeds, self._start, self._beside, self.marks, self._queue)
        return (self.marks & NEAR) > 0


@ti.kernel
def spread_marks(seeds: Int1, start: Int1, beside: Int2, marks: Int1, queue: Int1):
    """Mark as ``NEAR`` the vertices that had a mark and are at most ``RINGS`` edges, along such, from the seeds."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        spread(seeds, start, beside, marks, queue)


@ti.func
def spread(
    seeds: ti.template(), start: ti.template(), beside: ti.template(), marks: ti.template(), queue: ti.template()
):
    """See :func:`spread_marks`."""
    last = 0
    for r in range(seeds.shape[0]):
        if marks[seeds[r]] != 0 and marks[seeds[r]] & NEAR == 0:
            marks[seeds[r]] |= NEAR
            queue[last] = seeds[r]
            last += 1
    mark_rings(last, 1, start, beside, marks, queue)


@ti.func
def mark_rings(
    count: ti.i32,
    only_marked: ti.i32,
    start: ti.template(),
    beside: ti.template(),
    marks: ti.template(),
    queue: ti.template(),
):
    """Mark as ``NEAR`` the vertices at most ``RINGS`` edges from the first ``count`` of the queue, which are marked.

    If ``only_marked``, the way leads along vertices that had a mark.
    """
    first, last = 0, count
    for _ in range(RINGS):
        ring = last
        while first < ring:
            i = queue[first]
            first += 1
            for r in range(start[i], start[i + 1]):
                j = beside[r][0]
                if marks[j] & NEAR == 0 and (only_marked == 0 or marks[j] != 0):
                    marks[j] |= NEAR
                    queue[last] = j
                    last += 1


@ti.kernel
def cut_sheet(
    edges: Int1,
    above: Int1,
    below: Int1,
    start: Int1,
    beside: Int2,
    marks: Int1,
    flow: Int1,
    parent: Int1,
    queue: Int1,
    result: Int1,
    most: ti.i32,
    nearby: ti.i32,
):
    """Cut a sheet along a curve, see :meth:`SheetCuts.upper`; ``result`` receives how, 0 for not at all.

    The least cut between both sides is as large as the flow from one to the other (Ford and Fulkerson 1956), an edge
    taking one in either direction. The part that the flow leaves within reach is the same for every greatest flow.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        blocked = 2  # flow of an edge that goes through the other sheet
        for i in range(marks.shape[0]):
            marks[i] = 0
        for r in range(above.shape[0]):
            marks[above[r]] |= ABOVE
            marks[below[r]] |= BELOW
        sides = 0
        for i in range(marks.shape[0]):
            if marks[i] == ABOVE | BELOW:
                marks[i] = 0
            sides |= marks[i]
        for e in range(flow.shape[0]):
            flow[e] = 0
        for r in range(edges.shape[0]):
            flow[edges[r]] = blocked
        result[0] = 0
        if sides == ABOVE | BELOW:
            if reach(start, beside, marks, flow, parent, queue, 0) < 0:
                result[0] = CUT
            else:
                if nearby != 0:
                    mark_near(edges, above, below, start, beside, marks, queue)
                steps = 0
                while steps >= 0:
                    end = reach(start, beside, marks, flow, parent, queue, nearby)
                    if end < 0:
                        result[0] = CLOSED
                        steps = -1
                    elif steps == most:  # one more would be too many
                        steps = -1
                    else:
                        send(end, start, beside, flow, parent)
                        steps += 1


@ti.func
def mark_near(
    edges: ti.template(),
    above: ti.template(),
    below: ti.template(),
    start: ti.template(),
    beside: ti.template(),
    marks: ti.template(),
    queue: ti.template(),
):
    """Mark as ``NEAR`` the vertices a few edges from the ends of the curve's edges."""
    last = 0
    for r in range(edges.shape[0]):
        for end in range(2):
            i = ti.select(end == 0, above[r], below[r])
            if marks[i] & NEAR == 0:
                marks[i] |= NEAR
                queue[last] = i
                last += 1
    mark_rings(last, 0, start, beside, marks, queue)


@ti.func
def reach(
    start: ti.template(),
    beside: ti.template(),
    marks: ti.template(),
    flow: ti.template(),
    parent: ti.template(),
    queue: ti.template(),
    nearby: ti.i32,
) -> ti.i32:
    """Mark as ``UPPER`` the vertices that the flow may still reach from above, until one below is: returns it, or -1.

    ``flow`` counts from the lower to the higher vertex of an edge; ``parent`` receives the vertex from which each one
    was reached.
    """
    last, found = 0, -1
    for i in range(marks.shape[0]):
        marks[i] &= ~UPPER
        if marks[i] & ABOVE != 0:
            marks[i] |= UPPER
            parent[i] = -1
            queue[last] = i
            last += 1
    first = 0
    while first < last and found < 0:
        i = queue[first]
        first += 1
        if nearby == 0 or marks[i] & NEAR != 0:
            for r in range(start[i], start[i + 1]):
                j, e = beside[r][0], beside[r][1]
                along = ti.select(i < j, flow[e], -flow[e])
                if (
                    found < 0
                    and marks[j] & UPPER == 0
                    and flow[e] < 2
                    and along < 1
                    and (nearby == 0 or marks[j] & NEAR != 0)
                ):
                    marks[j] |= UPPER
                    parent[j] = i
                    queue[last] = j
                    last += 1
                    if marks[j] & BELOW != 0:
                        found = j
    return found


@ti.func
def send(end: ti.i32, start: ti.template(), beside: ti.template(), flow: ti.template(), parent: ti.template()):
    """Send one more along the way by which :func:`reach` came to a vertex."""
    j = end
    while parent[j] >= 0:
        i = parent[j]
        for r in range(start[i], start[i + 1]):
            if beside[r][0] == j:
                flow[beside[r][1]] += ti.select(i < j, 1, -1)
        j = i
