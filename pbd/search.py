"""Where a body is near a garment: the nearest body vertex of every contact sample."""

from pbd.engine import ti
from pbd.geometry import FAR, Float1, Int1, Int2, Int3, Vec3, Vec4, between, descend, vec3, xyz

__all__ = ["MAX_CELLS", "find_nearest", "find_of_garment"]

GRID_SIDE = 48
MAX_CELLS = GRID_SIDE**3
CELL = FAR  # least width of a cell [m]
MOST_SEARCHES = 8  # in a frame
PULLED = 2  # edges that a fast body pulls cloth from into its own way


@ti.func
def body_point(face, weights: vec3, t: ti.f32, body_0: ti.template(), body_1: ti.template()) -> vec3:
    """Point of a body face at t in [0, 1] of the frame."""
    p = vec3(0.0)
    for a in ti.static(range(3)):
        p += weights[a] * between(face[a], t, body_0, body_1)
    return p


@ti.func
def heaviest(corners, weights: vec3) -> ti.i32:
    best = corners[0]
    if weights[1] > weights[0] and weights[1] >= weights[2]:
        best = corners[1]
    elif weights[2] > weights[0]:
        best = corners[2]
    return best


@ti.func
def probed(
    b: ti.i32, t: ti.f32, body_0: ti.template(), body_1: ti.template(), probes: ti.template(), weights: ti.template()
) -> vec3:
    """Body vertex b, or beyond the vertices a probe, at t in [0, 1] of the frame."""
    x = vec3(0.0)
    if b < body_0.shape[0]:
        x = between(b, t, body_0, body_1)
    else:
        x = body_point(probes[b - body_0.shape[0]], weights[b - body_0.shape[0]], t, body_0, body_1)
    return x


@ti.func
def item(s: ti.i32, body_0: ti.template(), surface: ti.template()) -> ti.i32:
    """What is searched: first the vertices of the surface, then the probes, as :func:`probed` counts them."""
    b = body_0.shape[0] + s - surface.shape[0]
    if s < surface.shape[0]:
        b = surface[s]
    return b


@ti.func
def search(
    position: ti.template(),
    velocity: ti.template(),
    dt: ti.f32,
    t: ti.f32,
    nearest: ti.template(),
    body_0: ti.template(),
    body_1: ti.template(),
    surface: ti.template(),
    probes: ti.template(),
    weights: ti.template(),
    cell_start: ti.template(),
    cell_items: ti.template(),
    item_cell: ti.template(),
):
    """Nearest of the body's vertices and probes at t in [0, 1] of the frame.

    After the frame's start, for cloth vertices that have none yet. A uniform grid over the box of those cloth vertices,
    filled by counting sort; a vertex looks into the cells that reach nearer than what it has.
    """
    low = vec3(1e30)
    high = vec3(-1e30)
    for i in range(position.shape[0]):
        if t == 0.0 or nearest[i] < 0:
            p = xyz(position[i]) + t * dt * velocity[i]
            low = ti.min(low, p)
            high = ti.max(high, p)
    count = surface.shape[0] + probes.shape[0]
    if low[0] > high[0]:  # nobody searches
        low, high = vec3(0.0), vec3(0.0)
        count = 0
    low -= FAR
    high += FAR
    size = high - low
    cell = ti.max(CELL, size.max() / GRID_SIDE * 1.0001)
    inverse = 1.0 / cell
    nx = ti.min(int(size[0] * inverse) + 1, GRID_SIDE)
    ny = ti.min(int(size[1] * inverse) + 1, GRID_SIDE)
    nz = ti.min(int(size[2] * inverse) + 1, GRID_SIDE)
    for c in range(nx * ny * nz + 1):
        cell_start[c] = 0
    for s in range(count):
        q = (probed(item(s, body_0, surface), t, body_0, body_1, probes, weights) - low) * inverse
        item_cell[s] = -1
        if q.min() >= 0.0 and q[0] < nx and q[1] < ny and q[2] < nz:
            c = (int(q[0]) * ny + int(q[1])) * nz + int(q[2]) + 1
            item_cell[s] = c
            cell_start[c] = cell_start[c] + 1
    for c in range(nx * ny * nz):
        cell_start[c + 1] = cell_start[c + 1] + cell_start[c]
    total = cell_start[nx * ny * nz]
    # Filled from the back, cell c starts at cell_start[c + 1] in the end.
    for r in range(count):
        s = count - 1 - r
        c = item_cell[s]
        if c >= 0:
            cell_start[c] = cell_start[c] - 1
            cell_items[cell_start[c]] = item(s, body_0, surface)
    cell_start[nx * ny * nz + 1] = total

    for i in range(position.shape[0]):
        if t == 0.0 or nearest[i] < 0:
            p = xyz(position[i]) + t * dt * velocity[i]
            best = -1
            reach = FAR
            if nearest[i] >= 0:
                gap = (body_0[nearest[i]] - p).norm()
                if gap < 2.0 * FAR:
                    best = nearest[i]
                    reach = ti.min(reach, gap)
            distance = reach * reach
            q = (p - low) * inverse
            r = reach * inverse
            for ix in range(ti.max(int(q[0] - r), 0), ti.min(int(q[0] + r) + 1, nx)):
                for iy in range(ti.max(int(q[1] - r), 0), ti.min(int(q[1] + r) + 1, ny)):
                    # Cells along z lie next to one another: one run of items.
                    row = (ix * ny + iy) * nz + 1
                    begin = cell_start[row + ti.max(int(q[2] - r), 0)]
                    end = cell_start[row + ti.min(int(q[2] + r) + 1, nz)]
                    for s in range(begin, end):
                        b = cell_items[s]
                        offset = probed(b, t, body_0, body_1, probes, weights) - p
                        candidate = offset.dot(offset)
                        if candidate < distance:
                            distance = candidate
                            best = b
            if best >= body_0.shape[0]:
                probe = best - body_0.shape[0]
                best = heaviest(probes[probe], weights[probe])
            nearest[i] = best


@ti.func
def closing_way(velocity: ti.template(), dt: ti.f32, body_0: ti.template(), body_1: ti.template()) -> ti.f32:
    """The furthest that cloth, and the furthest that the body, goes in a frame against the cloth's mean, summed [m]."""
    mean = vec3(0.0)
    for i in range(velocity.shape[0]):
        mean += velocity[i]
    mean *= dt / velocity.shape[0]
    cloth, body = 0.0, 0.0
    for i in range(velocity.shape[0]):
        course = dt * velocity[i] - mean
        cloth = ti.max(cloth, course.dot(course))
    for b in range(body_0.shape[0]):
        course = body_1[b] - body_0[b] - mean
        body = ti.max(body, course.dot(course))
    return ti.sqrt(cloth) + ti.sqrt(body)


@ti.func
def spread_nearest(count: ti.i32, triangles: ti.template(), nearest: ti.template()):
    """Vertices that have no body vertex take one of their neighbours', PULLED edges far."""
    for _ in range(PULLED):
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
def find_of_garment(
    position: ti.template(),
    velocity: ti.template(),
    samples: ti.template(),
    triangles: ti.template(),
    nearest: ti.template(),
    body_0: ti.template(),
    body_1: ti.template(),
    ring_start: ti.template(),
    ring: ti.template(),
    surface: ti.template(),
    probes: ti.template(),
    weights: ti.template(),
    cell_start: ti.template(),
    cell_items: ti.template(),
    item_cell: ti.template(),
    way: ti.template(),
    dt: ti.f32,
    thickness: ti.f32,
):
    """For every contact sample a body vertex near it: the nearest within FAR, or the one that it had; else -1.

    Searched at the start of the frame and, where body or cloth move far in it, at later times on the cloth's present
    course. Then what lies around cloth that has found one starts from there as well, for it may be pulled into the way.
    ``way`` receives how far cloth and body can come nearer to one another in the frame [m], accelerations aside. Large
    body faces are found by probes, points spread over them; each stands for its heaviest corner.

    The first samples are the vertices themselves; the others stand in the middle of long edges and search from what
    the ends of their edge found. ``surface`` are the body vertices that lie in a face.
    """
    way[0] = 0.0
    if surface.shape[0] > 0:  # in a crowd, garments without a body come along
        way[0] = closing_way(velocity, dt, body_0, body_1)
        # What moves further than can be seen is looked for again on its way.
        unseen = (way[0] + thickness - FAR) / (1.5 * FAR)
        later = int(ti.ceil(ti.math.clamp(unseen, 0.0, MOST_SEARCHES - 1.0)))
        for k in range(later + 1):
            t = k / (later + 0.5)
            search(
                position, velocity, dt, t, nearest, body_0, body_1, surface, probes, weights,
                cell_start, cell_items, item_cell,
            )  # fmt: skip
        if later > 0:
            spread_nearest(position.shape[0], triangles, nearest)
        for c in range(position.shape[0], samples.shape[0]):
            p = 0.5 * (xyz(position[samples[c][0]]) + xyz(position[samples[c][1]]))
            best = -1
            distance = 1e30
            for a in ti.static(range(3)):
                start = nearest[c]
                reach = 4.0 * FAR * FAR  # of the vertex that it had; what an end found is near enough
                if ti.static(a < 2):
                    start = nearest[samples[c][a]]
                    reach = 1e30
                if start >= 0 and start != best:
                    found = descend(p, start, 0.0, body_0, body_1, ring_start, ring)
                    offset = body_0[found] - p
                    if offset.dot(offset) < ti.min(distance, reach):
                        distance = offset.dot(offset)
                        best = found
            nearest[c] = best


@ti.kernel
def find_nearest(
    position: Vec4,
    velocity: Vec3,
    samples: Int2,
    triangles: Int3,
    nearest: Int1,
    body_0: Vec3,
    body_1: Vec3,
    ring_start: Int1,
    ring: Int1,
    surface: Int1,
    probes: Int3,
    weights: Vec3,
    cell_start: Int1,
    cell_items: Int1,
    item_cell: Int1,
    way: Float1,
    dt: ti.f32,
    thickness: ti.f32,
):
    """See :func:`find_of_garment`."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        find_of_garment(
            position, velocity, samples, triangles, nearest, body_0, body_1, ring_start, ring, surface, probes, weights,
            cell_start, cell_items, item_cell, way, dt, thickness,
        )  # fmt: skip
