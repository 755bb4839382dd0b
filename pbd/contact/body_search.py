"""Where a body is near a garment: the nearest body vertex of every contact sample."""

from dataclasses import dataclass
from typing import Any

from pbd.contact.blocks import greater, smaller
from pbd.contact.body_surface import BodySurface
from pbd.engine import ti
from pbd.geometry import FAR, Float1, Int1, Int2, Int3, Vec3, Vec4, between, larger, vec3, vec4, xyz
from pbd.taichi_internals import in_kernel

__all__ = ["MAX_CELLS", "find_nearest"]

GRID_SIDE = 48
MAX_CELLS = GRID_SIDE**3
MIN_CELL_SIZE = FAR  # [m]
REACH_MARGIN = FAR  # how far cloth may stray in a frame from where its velocity brings it [m]
MAX_SEARCHES = 8  # in a frame
SPREAD_RINGS = 2  # a fast body pulls cloth into its way from so many edges around


@in_kernel
@dataclass(eq=False)
class BodySearch:
    """Input and output of the search for the nearest body vertices; a view, see :mod:`pbd.xpbd.views`.

    Attributes:
        position, velocity: of the cloth [m], [m/s], vec4 and vec3.
        samples, triangles: of the cloth.
        nearest: body vertex near each sample, -1 for none.
        max_approach: see :class:`pbd.xpbd.views.ContactWork`.
        surface: body vertices that lie in a face.
        probes, probe_weights: points spread over large faces of the body, see :class:`pbd.Body`.
        reached: workspace, the items that the cloth can reach in the frame.
        cell_start, cell_items, cell_points, item_cell: workspace of the uniform grid; of the items in the order of
            its cells their numbers and where they are, vec4.
    """

    position: Any = None
    velocity: Any = None
    samples: Any = None
    triangles: Any = None
    nearest: Any = None
    max_approach: Any = None
    surface: Any = None
    probes: Any = None
    probe_weights: Any = None
    reached: Any = None
    cell_start: Any = None
    cell_items: Any = None
    cell_points: Any = None
    item_cell: Any = None
    _data_oriented = True


@ti.func
def heaviest(corners, weights: vec3) -> ti.i32:
    """The corner with the greatest weight."""
    best = corners[0]
    if weights[1] > weights[0] and weights[1] >= weights[2]:
        best = corners[1]
    elif weights[2] > weights[0]:
        best = corners[2]
    return best


@ti.func
def item_point(b: ti.i32, t: ti.f32, body: ti.template(), search: ti.template()) -> vec3:
    """Body vertex b, or probe b less the number of vertices, at t in [0, 1] of the frame [m]."""
    x = vec3(0.0)
    if b < body.body_start.shape[0]:
        x = between(b, t, body)
    else:
        corners = search.probes[b - body.body_start.shape[0]]
        weights = search.probe_weights[b - body.body_start.shape[0]]
        for a in ti.static(range(3)):
            x += weights[a] * between(corners[a], t, body)
    return x


@ti.func
def searches(i: ti.i32, t: ti.f32, nearest: ti.template()):
    """Whether vertex i searches: at the frame's start all do, later only those that have found nothing yet."""
    return t == 0.0 or nearest[i] < 0


@ti.func
def find_at(t: ti.f32, dt: ti.f32, reached_count: ti.i32, body: ti.template(), search: ti.template()):
    """Nearest of the body's vertices and probes at t in [0, 1] of the frame, for each cloth vertex that searches.

    A uniform grid over the box of those cloth vertices is filled by counting sort. A vertex looks into the cells that
    are nearer than the body vertex that it has.
    """
    low = vec3(1e30)
    high = vec3(-1e30)
    for i in range(search.position.shape[0]):
        if searches(i, t, search.nearest):
            p = xyz(search.position[i]) + t * dt * search.velocity[i]
            low, high = smaller(low, p), greater(high, p)
    count = reached_count
    if low[0] > high[0]:  # no vertex searches
        low, high = vec3(0.0), vec3(0.0)
        count = 0
    low -= FAR
    high += FAR
    size = high - low
    cell = ti.max(MIN_CELL_SIZE, size.max() / GRID_SIDE * 1.0001)
    inverse = 1.0 / cell
    nx = ti.min(int(size[0] * inverse) + 1, GRID_SIDE)
    ny = ti.min(int(size[1] * inverse) + 1, GRID_SIDE)
    nz = ti.min(int(size[2] * inverse) + 1, GRID_SIDE)
    cells = ti.Vector([nx, ny, nz])
    fill_cells(t, count, low, inverse, cells, body, search)
    for i in range(search.position.shape[0]):
        if searches(i, t, search.nearest):
            p = xyz(search.position[i]) + t * dt * search.velocity[i]
            search.nearest[i] = nearest_item(i, p, t, low, inverse, cells, body, search)


@ti.func
def fill_cells(t: ti.f32, count: ti.i32, low: vec3, inverse: ti.f32, cells, body: ti.template(), search: ti.template()):
    """Sort ``count`` reached items into cells of the grid that starts at ``low`` [m]; ``inverse``: 1/cell [1/m]."""
    nx, ny, nz = cells[0], cells[1], cells[2]
    for c in range(nx * ny * nz + 2):
        search.cell_start[c] = 0
    for s in range(count):
        q = (item_point(search.reached[s], t, body, search) - low) * inverse
        search.item_cell[s] = -1
        if q.min() >= 0.0 and q[0] < nx and q[1] < ny and q[2] < nz:
            c = (int(q[0]) * ny + int(q[1])) * nz + int(q[2]) + 1
            search.item_cell[s] = c
            search.cell_start[c] = search.cell_start[c] + 1
    total = 0
    for c in range(1, nx * ny * nz + 2):
        total += search.cell_start[c]
        search.cell_start[c] = total
    # Filled from the back: in the end cell c starts at cell_start[c + 1].
    for r in range(count):
        s = count - 1 - r
        c = search.item_cell[s]
        if c >= 0:
            place = search.cell_start[c] - 1
            search.cell_start[c] = place
            search.cell_items[place] = search.reached[s]
            search.cell_points[place] = vec4(item_point(search.reached[s], t, body, search))


@ti.func
def nearest_item(
    i: ti.i32, p: vec3, t: ti.f32, low: vec3, inverse: ti.f32, cells, body: ti.template(), search: ti.template()
) -> ti.i32:
    """Body vertex nearest to cloth vertex i, which is at p [m], within FAR; -1 for none. The grid as above."""
    nx, ny, nz = cells[0], cells[1], cells[2]
    best = -1
    reach = FAR
    if search.nearest[i] >= 0:
        gap = (body.body_start[search.nearest[i]] - p).norm()
        if gap < 2.0 * FAR:
            best = search.nearest[i]
            reach = ti.min(reach, gap)
    distance = reach * reach
    q = (p - low) * inverse
    r = reach * inverse
    found = -1
    for ix in range(ti.max(int(q[0] - r), 0), ti.min(int(q[0] + r) + 1, nx)):
        for iy in range(ti.max(int(q[1] - r), 0), ti.min(int(q[1] + r) + 1, ny)):
            # Cells along z lie next to one another: their items are one range.
            row = (ix * ny + iy) * nz + 1
            begin = search.cell_start[row + ti.max(int(q[2] - r), 0)]
            end = search.cell_start[row + ti.min(int(q[2] + r) + 1, nz)]
            for s in range(begin, end):
                offset = xyz(search.cell_points[s]) - p
                candidate = offset.dot(offset)
                if candidate < distance:
                    distance = candidate
                    found = s
    if found >= 0:
        best = search.cell_items[found]
    if best >= body.body_start.shape[0]:
        probe = best - body.body_start.shape[0]
        best = heaviest(search.probes[probe], search.probe_weights[probe])
    return best


@ti.func
def reach_of(dt: ti.f32, body: ti.template(), search: ti.template()):
    """List the items that the cloth can reach in a frame of dt [s] in ``search.reached``.

    They are those whose way meets the box of the cloth's, which is wider by FAR and REACH_MARGIN.

    Returns:
        their number; greatest displacement of the cloth and greatest of these items, against the cloth's mean, summed
        [m].
    """
    low, high, mean = vec3(1e30), vec3(-1e30), vec3(0.0)
    for i in range(search.position.shape[0]):
        p, way = xyz(search.position[i]), dt * search.velocity[i]
        low, high = smaller(low, smaller(p, p + way)), greater(high, greater(p, p + way))
        mean += way
    mean /= search.position.shape[0]
    of_cloth, of_body = 0.0, 0.0
    for i in range(search.position.shape[0]):
        displacement = dt * search.velocity[i] - mean
        of_cloth = larger(of_cloth, displacement.dot(displacement))
    low -= FAR + REACH_MARGIN
    high += FAR + REACH_MARGIN
    count = 0
    for s in range(search.surface.shape[0]):
        b = search.surface[s]
        search.reached[count] = b
        count += meets(body.body_start[b], between(b, 1.0, body), low, high)
    for s in range(search.probes.shape[0]):
        b = body.body_start.shape[0] + s
        search.reached[count] = b
        count += meets(item_point(b, 0.0, body, search), item_point(b, 1.0, body, search), low, high)
    for s in range(count):
        b = search.reached[s]
        displacement = item_point(b, 1.0, body, search) - item_point(b, 0.0, body, search) - mean
        of_body = larger(of_body, displacement.dot(displacement))
    return count, ti.sqrt(of_cloth) + ti.sqrt(of_body)


@ti.func
def meets(x: vec3, y: vec3, low: vec3, high: vec3) -> ti.i32:
    """1 if the box of two points meets another, else 0; without branches, for nobody can foresee it."""
    inside = smaller(greater(x, y) - low, high - smaller(x, y))
    least = ti.select(inside[0] < inside[1], inside[0], inside[1])
    least = ti.select(inside[2] < least, inside[2], least)
    return ti.select(least >= 0.0, 1, 0)


@ti.func
def spread_nearest(count: ti.i32, triangles: ti.template(), nearest: ti.template()):
    """Vertices that have no body vertex take one of their neighbours', from up to SPREAD_RINGS edges around."""
    for _ in range(SPREAD_RINGS):
        for c in range(triangles.shape[0]):
            best = -1
            for a in ti.static(range(3)):
                best = ti.max(best, nearest[triangles[c][a]])
            if best >= 0:
                for a in ti.static(range(3)):
                    if nearest[triangles[c][a]] == -1:
                        nearest[triangles[c][a]] = -2 - best  # no start for others in this round
        for i in range(count):
            if nearest[i] < -1:
                nearest[i] = -2 - nearest[i]


@ti.func
def find_nearest_vertices(search: ti.template(), body: ti.template(), dt: ti.f32, thickness: ti.f32):
    """For every contact sample a body vertex near it: the nearest within FAR, or the one that it had; else -1.

    The search is at the start of the frame. Where body or cloth move far in the frame, there are further searches at
    later times, for cloth that keeps its velocity. Then the vertices around those that have found a body vertex start
    from there as well, for they may be pulled along. ``max_approach`` receives how far cloth and body can come nearer
    to one another in the frame [m], accelerations aside. Large body faces are found by probes, points spread over them;
    each stands for its heaviest corner.

    The first samples are the vertices themselves. The others are the middles of long edges, and search from the body
    vertices that the ends of their edge found.

    Args:
        search: :class:`BodySearch`; ``body``: :class:`pbd.contact.body_surface.BodySurface`.
        dt: frame time [s].
        thickness: kept between cloth and body [m].
    """
    count, approach = reach_of(dt, body, search)
    search.max_approach[0] = approach
    # A vertex that moves further than the search reaches is searched for again on its way.
    unseen = (approach + thickness - FAR) / (1.5 * FAR)
    later = int(ti.ceil(ti.math.clamp(unseen, 0.0, MAX_SEARCHES - 1.0)))
    for k in range(later + 1):
        find_at(k / (later + 0.5), dt, count, body, search)
    if later > 0:
        spread_nearest(search.position.shape[0], search.triangles, search.nearest)
    for c in range(search.position.shape[0], search.samples.shape[0]):
        search.nearest[c] = nearest_between_ends(c, body, search)


@ti.func
def nearest_between_ends(c: ti.i32, body: ti.template(), search: ti.template()) -> ti.i32:
    """Body vertex near sample c, the middle of an edge; -1 for none.

    It is the one that it had, unless that of an end of the edge is nearer. When it looks for the face that it touches,
    it goes on from all three.
    """
    ends = search.samples[c]
    p = 0.5 * (xyz(search.position[ends[0]]) + xyz(search.position[ends[1]]))
    best, distance = search.nearest[c], 1e30
    if best >= 0:
        offset = body.body_start[best] - p
        distance = offset.dot(offset)
        if distance >= 4.0 * FAR * FAR:
            best, distance = -1, 1e30
    for a in ti.static(range(2)):
        start = search.nearest[ends[a]]
        if start >= 0:
            offset = body.body_start[start] - p
            away = offset.dot(offset)
            if away < distance:
                best, distance = start, away
    return best


@ti.kernel
def find_nearest(
    position: Vec4,
    velocity: Vec3,
    samples: Int2,
    triangles: Int3,
    nearest: Int1,
    max_approach: Float1,
    surface: Int1,
    probes: Int3,
    probe_weights: Vec3,
    reached: Int1,
    cell_start: Int1,
    cell_items: Int1,
    cell_points: Vec4,
    item_cell: Int1,
    body_start: Vec3,
    body_end: Vec3,
    ring_start: Int1,
    ring: Int1,
    dt: ti.f32,
    thickness: ti.f32,
):
    """See :func:`find_nearest_vertices`. Over 12 arguments: a kernel takes arrays one by one."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        find_nearest_vertices(
            BodySearch(
                position, velocity, samples, triangles, nearest, max_approach, surface, probes,
                probe_weights, reached, cell_start, cell_items, cell_points, item_cell,
            ),
            BodySurface(body_start, body_end, ring_start, ring),
            dt,
            thickness,
        )  # fmt: skip
