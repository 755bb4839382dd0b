"""Patches from coarse to fine in one substep: what carries tension over long ways in few passes."""

from pbd.constraints import larger, link_multiplier
from pbd.contact import substep_start
from pbd.engine import ti
from pbd.geometry import vec3, vec4, xyz
from pbd.model import BLOCK

__all__ = ["gather_patches", "solve_links", "solve_patches"]


# No link changes the speed of its ends against each other by more than this in a substep [m/s]: patches would throw
# cloth that held vertices pull out of all reach.
FASTEST = 30.0
GRAIN = 1e-6  # links pull beyond their length and this: positions in float32 say no more [m]


@ti.func
def gather_patches(
    team: ti.template(),
    position: ti.template(),
    shift: ti.template(),
    velocity: ti.template(),
    gained: ti.template(),
    h: ti.f32,
    part: ti.template(),
    places: ti.template(),
    ways: ti.template(),
    starts: ti.template(),
    children: ti.template(),
    child_starts: ti.template(),
    levels: ti.i32,
):
    """Centres of mass of the patches of all levels at the start of a substep, and their ways as predicted [m].

    The fourth column of ``ways``, the inverse mass, stays.
    """
    count = position.shape[0]
    for level in range(levels):
        for a in range(team.begin(starts[level], starts[level + 1]), team.end(starts[level], starts[level + 1])):
            place, way = vec3(0.0), vec3(0.0)
            for q in range(child_starts[a], child_starts[a + 1]):
                i = children[q]
                if level == 0:
                    start = substep_start(velocity, gained, i, h)
                    place += part[i] * (xyz(position[i]) + start)
                    way += part[i] * (xyz(shift[i]) - start)
                else:
                    place += part[i] * xyz(places[i - count])
                    way += part[i] * xyz(ways[i - count])
            places[a] = vec4(place)
            ways[a] = vec4(way, ways[a][3])
        team.meet()


@ti.func
def solve_links(ways: ti.template(), links: ti.template(), room: ti.template(), begin: ti.i32, end: ti.i32):
    """One pass over the links ``begin`` to ``end``, which is left out, of one colour.

    In blocks that are read, solved and written in turn, as in :func:`pbd.schedule.solve_membrane`; for ``room`` see
    :func:`solve_patches`.
    """
    x, y, z = ti.Vector([0.0] * BLOCK), ti.Vector([0.0] * BLOCK), ti.Vector([0.0] * BLOCK)
    changes = ti.Vector([0.0] * BLOCK)
    for b in range((end - begin + BLOCK - 1) // BLOCK):
        first = begin + b * BLOCK
        size = ti.min(BLOCK, end - first)
        for a in range(size):
            link = links[first + a]
            if link[0] < 0:  # never; see there
                break
            offset = ways[link[0]] - ways[link[1]]
            x[a], y[a], z[a] = offset[0], offset[1], offset[2]
        for a in range(BLOCK):  # those beyond the block's size come to nothing
            c = first + a
            direction = vec3(room[0, c], room[1, c], room[2, c])
            had = room[7, c]
            offset = room[3, c] * direction + vec3(x[a], y[a], z[a])
            change = link_multiplier(offset, direction, room[4, c], room[5, c], room[6, c], had)
            change = larger(had + change, room[8, c]) - had
            changes[a], x[a], y[a], z[a] = change, change * direction[0], change * direction[1], change * direction[2]
        for a in range(size):
            c, change = first + a, changes[a]
            if change != 0.0:
                move = vec4(vec3(x[a], y[a], z[a]))
                p, q = ways[links[c][0]], ways[links[c][1]]
                room[7, c] = room[7, c] + change
                ways[links[c][0]] = p + p[3] * move
                ways[links[c][1]] = q - q[3] * move


@ti.func
def solve_patches(
    team: ti.template(),
    count: ti.i32,
    parent: ti.template(),
    places: ti.template(),
    ways: ti.template(),
    first_ways: ti.template(),
    borne: ti.template(),
    starts: ti.template(),
    links: ti.template(),
    colors: ti.template(),
    color_starts: ti.template(),
    data: ti.template(),
    shares: ti.template(),
    room: ti.template(),
    levels: ti.i32,
    sweeps: ti.i32,
    h: ti.f32,
):
    """Correct the ways of patches until no link is longer than the fabric lets it be, from coarse to fine.

    Multipliers of links are multipliers of the fabric: what the coarser levels bear, as the mean stress of a patch, is
    strain (``borne``) that the finer ones need not take out, so that the stiffness stays the fabric's own.

    Args:
        places: centres at the start of the substep.
        ways: of the centres over the substep, and inverse masses. Corrections go here: small numbers keep their digits.
        first_ways: room for the ways as predicted.
        colors: where the links of each colour begin, those of all levels; ``color_starts``: the first of each level.
        room: of each link its direction, distance and length [m], compliance, inverse mass of both ends, multiplier and
            the least that this may be.
    """
    inverse_h2 = 1.0 / (h * h)
    for a in range(team.begin(0, starts[levels]), team.end(0, starts[levels])):
        first_ways[a] = ways[a]
        borne[a] = ti.math.vec4(0.0)
    team.meet()
    for down in range(levels):
        level = levels - 1 - down
        if down > 0:
            for a in range(team.begin(starts[level], starts[level + 1]), team.end(starts[level], starts[level + 1])):
                above = parent[count + a]
                p = ways[a]
                if p[3] > 0.0:
                    ways[a] = vec4(xyz(p) + (xyz(ways[above]) - xyz(first_ways[above])), p[3])
                borne[a] = borne[above]
            team.meet()
        begin, end = colors[color_starts[level]], colors[color_starts[level + 1]]
        for c in range(team.begin(begin, end), team.end(begin, end)):
            e = 0.5 * (borne[links[c][0]] + borne[links[c][1]])
            offset = xyz(places[links[c][0]]) - xyz(places[links[c][1]])
            distance = ti.max(offset.norm(), 1e-20)
            direction = offset / distance
            total = ways[links[c][0]][3] + ways[links[c][1]][3]
            room[0, c], room[1, c], room[2, c], room[3, c] = direction[0], direction[1], direction[2], distance
            room[4, c] = GRAIN + data[c, 0][0] * (1.0 + xyz(e).dot(xyz(data[c, 1])))
            room[5, c], room[6, c] = data[c, 0][1] * inverse_h2, total
            room[7, c], room[8, c] = 0.0, -FASTEST * h / total
        team.meet()
        for _ in range(sweeps):
            for k in range(color_starts[level], color_starts[level + 1]):
                solve_links(ways, links, room, team.begin(colors[k], colors[k + 1]), team.end(colors[k], colors[k + 1]))
                team.meet()
        for k in range(color_starts[level], color_starts[level + 1]):
            for c in range(team.begin(colors[k], colors[k + 1]), team.end(colors[k], colors[k + 1])):
                strain = -room[7, c] * inverse_h2 * xyz(data[c, 2])
                borne[links[c][0]] = borne[links[c][0]] + vec4(shares[c, 0] * strain)
                borne[links[c][1]] = borne[links[c][1]] + vec4(shares[c, 1] * strain)
            team.meet()
