"""Patches from coarse to fine in one substep: what carries tension over long ways in few passes."""

from pbd.constraints import link_multiplier
from pbd.engine import ti
from pbd.geometry import vec3, vec4, xyz

__all__ = ["gather_places", "gather_ways", "solve_patches"]


# No link changes the speed of its ends against each other by more than this in a substep [m/s]: patches would throw
# cloth that held vertices pull out of all reach.
FASTEST = 30.0
GRAIN = 1e-6  # links pull beyond their length and this: positions in float32 say no more [m]


@ti.func
def gather_places(
    team: ti.template(),
    position: ti.template(),
    shift: ti.template(),
    part: ti.template(),
    places: ti.template(),
    starts: ti.template(),
    children: ti.template(),
    child_starts: ti.template(),
    levels: ti.i32,
):
    """Centres of mass of the patches of all levels [m]."""
    count = position.shape[0]
    for level in range(levels):
        for a in range(team.begin(starts[level], starts[level + 1]), team.end(starts[level], starts[level + 1])):
            place = ti.math.vec4(0.0)
            for q in range(child_starts[a], child_starts[a + 1]):
                i = children[q]
                if level == 0:
                    place += part[i] * vec4(xyz(position[i]) + xyz(shift[i]))
                else:
                    place += part[i] * places[i - count]
            places[a] = place
        team.meet()


@ti.func
def gather_ways(
    team: ti.template(),
    velocity: ti.template(),
    gained: ti.template(),
    h: ti.f32,
    part: ti.template(),
    ways: ti.template(),
    starts: ti.template(),
    children: ti.template(),
    child_starts: ti.template(),
    levels: ti.i32,
):
    """Ways of the centres of mass as predicted for the substep [m]; the fourth column, the inverse mass, stays."""
    count = velocity.shape[0]
    for level in range(levels):
        for a in range(team.begin(starts[level], starts[level + 1]), team.end(starts[level], starts[level + 1])):
            way = vec3(0.0)
            for q in range(child_starts[a], child_starts[a + 1]):
                i = children[q]
                if level == 0:
                    way += (h * part[i]) * (velocity[i] + xyz(gained[i]))
                else:
                    way += part[i] * xyz(ways[i - count])
            ways[a] = vec4(way, ways[a][3])
        team.meet()


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
    lines: ti.template(),
    multipliers: ti.template(),
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
        lines: room for direction and length of each link.
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
            direction = (xyz(places[links[c][0]]) - xyz(places[links[c][1]])).normalized(1e-20)
            lines[c] = vec4(direction, GRAIN + data[c, 0][0] * (1.0 + xyz(e).dot(xyz(data[c, 1]))))
            multipliers[c] = 0.0
        team.meet()
        for _ in range(sweeps):
            for k in range(color_starts[level], color_starts[level + 1]):
                for c in range(team.begin(colors[k], colors[k + 1]), team.end(colors[k], colors[k + 1])):
                    a, b = links[c][0], links[c][1]
                    p, q = ways[a], ways[b]
                    direction, length = xyz(lines[c]), lines[c][3]
                    had = multipliers[c]
                    total = p[3] + q[3]
                    change = link_multiplier(
                        (xyz(places[a]) - xyz(places[b])) + (xyz(p) - xyz(q)),
                        direction,
                        length,
                        data[c, 0][1] * inverse_h2,
                        total,
                        had,
                    )
                    change = ti.max(had + change, -FASTEST * h / total) - had
                    if change != 0.0:
                        multipliers[c] = had + change
                        ways[a] = vec4(xyz(p) + (p[3] * change) * direction, p[3])
                        ways[b] = vec4(xyz(q) - (q[3] * change) * direction, q[3])
                team.meet()
        for k in range(color_starts[level], color_starts[level + 1]):
            for c in range(team.begin(colors[k], colors[k + 1]), team.end(colors[k], colors[k + 1])):
                strain = -multipliers[c] * inverse_h2 * xyz(data[c, 2])
                borne[links[c][0]] = borne[links[c][0]] + vec4(shares[c, 0] * strain)
                borne[links[c][1]] = borne[links[c][1]] + vec4(shares[c, 1] * strain)
            team.meet()
