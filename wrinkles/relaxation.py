"""One quasi-static pass on the fine mesh: stretched edges back to length, held vertices in place, out of the body."""

from copy import copy

import numpy as np
from scipy.spatial import cKDTree

from pbd.colliders import Body
from pbd.engine import Launch, ensure_initialized, ti
from pbd.geometry import Float1, Float2, Int1, Int2, Int3, Vec3, closest_in_fan, descend, vec3
from pbd.mesh import ClothMesh, greedy_colors
from wrinkles.charts import leading_vertices
from wrinkles.clearance import clearances, facing
from wrinkles.levels import Levels

__all__ = ["Relaxation"]

STRETCH_SHARE = 0.25  # of an edge's stretch that a relaxation pass takes back
LEVEL = 0.025  # where the coarse garment is further than this from the body, so is the fine one [m],
PLEATED = 0.045  # unless it came with pleats, which go deeper
NEARBY = 0.008  # fine vertices within this height over the tangent plane are near the body [m]
CURVED = 0.003  # those of them that are no more than this over their clearance are tested against faces [m]
ACROSS = 0.05  # another part of the body is looked for this far from the part that a coarse vertex covers [m]
TURNS = 8  # frames in which every coarse vertex looks for that once
BEHIND = 0.7  # greatest sine by which one part may lie behind the other: more, and both are sides of one bump,
OVERLAP = 0.008  # unless it is by no more than this, and they look apart: then they overlap [m]
COVERED = 0.04  # further away than this is no part that the cloth covers, if another is right at it [m]
ROOM_SHARE = 0.3  # of the room between two parts that the cloth keeps from each, if that is less than its clearance
LEAST = 0.0003  # kept from what it covers where there is no room [m]


@ti.kernel
def _relax(
    fine: Vec3,
    inverse_mass: Float1,
    edges: Int2,
    lengths: Float1,
    held: Int1,
    targets: Vec3,
    leading: Int3,
    frames: Float2,
    facing: ti.f32,
    coarse_nearest: Int1,
    coarse_contact: Float1,
    nearest: Int1,
    turn: ti.i32,
    across: Int1,
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
    ti.loop_config(serialize=True)
    for _ in range(1):
        for c in range(held.shape[0]):
            fine[held[c]] = targets[c]
        for _pass in range(passes):
            for c in range(edges.shape[0]):
                i, j = edges[c][0], edges[c][1]
                d = fine[j] - fine[i]
                squared = d.dot(d)
                if squared > lengths[c] * lengths[c]:
                    size = ti.sqrt(squared)
                    total = inverse_mass[i] + inverse_mass[j]
                    # Only stretch is taken back: pushing short edges apart in one pass folds the mesh edge by edge.
                    # A part at a time: whole corrections of a stretched coarse state overshoot from edge to edge.
                    d *= STRETCH_SHARE * (size - lengths[c]) / (size * total)
                    fine[i] += inverse_mass[i] * d
                    fine[j] -= inverse_mass[j] * d
            _look_across(turn, coarse_nearest, coarse_contact, level, body, body_normals, across)
            for i in range(fine.shape[0]):
                if inverse_mass[i] > 0.0:
                    coarse = leading[i][0]
                    last = nearest[i]
                    nearest[i] = -1
                    others = ti.min(coarse_contact[leading[i][1]], coarse_contact[leading[i][2]])
                    if ti.min(coarse_contact[coarse], others) < level:
                        p = fine[i]
                        looks = facing * vec3(frames[coarse, 6], frames[coarse, 7], frames[coarse, 8])
                        normal, other_normal, home = vec3(0.0), vec3(0.0), vec3(0.0)
                        gap, other_gap, kept, other_kept = NEARBY, NEARBY, 0.0, 0.0
                        # The part of the body that the cloth covers, then one opposite to it, where there is one.
                        sides = 1
                        for c in ti.static(range(3)):
                            if across[leading[i][c]] >= 0:
                                sides = 2
                        for side in range(sides):
                            best = -1
                            distance = 1e30
                            # Starts: where the coarse vertices around this one are, and where it was itself last.
                            for c in ti.static(range(6)):
                                seed = -1
                                if ti.static(c < 3):
                                    seed = coarse_nearest[leading[i][c]]
                                elif side == 1:
                                    seed = across[leading[i][c - 3]]
                                elif ti.static(c == 3):
                                    seed = last
                                if seed >= 0 and seed != best:
                                    offset = body[seed] - p
                                    away = offset.dot(offset)
                                    # The part that is covered looks the way the cloth does. Others will do if there is
                                    # no such one near: what strikes the cloth from its other side.
                                    if side == 0 and body_normals[seed].dot(looks) < 0.0:
                                        away += COVERED * COVERED
                                    if side == 1 and not _opposed(home, looks, body[seed], body_normals[seed]):
                                        away = 1e30
                                    if away < distance:
                                        distance = away
                                        best = seed
                            if best >= 0:
                                best = descend(p, best, 0.0, body, body, ring_start, ring)
                                offset = p - body[best]
                                if offset.dot(offset) > 0.01:
                                    best = -1
                            if side == 1 and best >= 0:
                                if not _opposed(home, looks, body[best], body_normals[best]):
                                    best = -1
                            if best < 0:
                                break
                            if side == 0:
                                nearest[i] = best
                                home, looks = body[best], body_normals[best]
                            n, h, c = body_normals[best], (p - body[best]).dot(body_normals[best]), 0.0
                            if h < ti.min(clearance[best] + CURVED, NEARBY):
                                n, h, c = _height(p, best, body, body_normals, fan_start, fan, clearance)
                            if side == 0:
                                normal, gap, kept = n, h, c
                            else:
                                other_normal, other_gap, other_kept = n, h, c
                        if other_gap < NEARBY:
                            # Between two parts the cloth keeps from both what room there is, and to its own where they
                            # overlap. Pushed out of one after the other it would zigzag and end inside one of them.
                            room = gap + other_gap
                            kept = ti.min(kept, ti.max(ROOM_SHARE * ti.abs(room), LEAST))
                            other_kept = ti.min(other_kept, ti.max(ROOM_SHARE * room, LEAST))
                            if other_gap < other_kept and gap > kept:
                                d = ti.min(other_kept - other_gap, gap - kept) * other_normal
                                p += d
                                gap += d.dot(normal)
                        if gap < kept:
                            p += (kept - gap) * normal
                        fine[i] = p


@ti.func
def _opposed(p: vec3, normal: vec3, q: vec3, other_normal: vec3) -> bool:
    """Whether two places of the body face one another; both sides of a bump look apart as well, but from behind."""
    offset = q - p
    apart = -normal.dot(other_normal)
    limit = -ti.max(BEHIND * offset.norm(), OVERLAP * apart)
    return apart > 0.0 and offset.dot(normal) > limit and -offset.dot(other_normal) > limit


@ti.func
def _look_across(
    turn: ti.i32,
    coarse_nearest: ti.template(),
    coarse_contact: ti.template(),
    level: ti.f32,
    body: ti.template(),
    normals: ti.template(),
    across: ti.template(),
):
    """A body vertex opposite to what a coarse vertex touches, -1 for none: one that the garment touches elsewhere."""
    for c in range(across.shape[0]):
        own, old = coarse_nearest[c], across[c]
        if own < 0 or coarse_contact[c] >= level:
            across[c] = -1
        else:
            # A coarse vertex that goes over from one part to the other leaves behind what was opposite to the first.
            stale = old >= 0 and not _opposed(body[own], normals[own], body[old], normals[old])
            if stale or turn < 0 or c % TURNS == turn:
                best, distance = -1, ACROSS * ACROSS
                for k in range(across.shape[0]):
                    if coarse_contact[k] < level:
                        for other in ti.static(range(2)):
                            seed = across[k] if ti.static(other == 1) else coarse_nearest[k]
                            if seed >= 0:
                                offset = body[seed] - body[own]
                                away = offset.dot(offset)
                                if away < distance and _opposed(body[own], normals[own], body[seed], normals[seed]):
                                    distance = away
                                    best = seed
                across[c] = best


@ti.func
def _height(
    p: vec3,
    vertex: ti.i32,
    body: ti.template(),
    normals: ti.template(),
    fan_start: ti.template(),
    fan: ti.template(),
    clearance: ti.template(),
):
    """Normal of the faces around a body vertex where p is nearest to them, its height over them, and the clearance."""
    f, w, squared = closest_in_fan(p, vertex, 0.0, body, body, fan_start, fan)
    offset = p - (w[0] * body[vertex] + w[1] * body[f[0]] + w[2] * body[f[1]])
    normal = w[0] * normals[vertex] + w[1] * normals[f[0]] + w[2] * normals[f[1]]
    normal /= ti.max(normal.norm(), 1e-20)
    kept = w[0] * clearance[vertex] + w[1] * clearance[f[0]] + w[2] * clearance[f[1]]
    height = offset.dot(normal)
    if squared > 0.05 * 0.05:
        height = NEARBY
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
        self._inverse_mass = np.ones(len(mesh.vertices), np.float32)
        self._inverse_mass[held] = 0.0
        edges, lengths = mesh.edge_lengths()
        free = self._inverse_mass[edges].any(axis=1)
        edges, lengths = edges[free], lengths[free]
        order = np.argsort(greedy_colors(edges, len(mesh.vertices)), kind="stable")
        self._edges, self._lengths = np.ascontiguousarray(edges[order]), lengths[order].astype(np.float32)
        self._held = np.asarray(held, np.int32)
        self._targets = np.zeros((len(held), 3), np.float32)
        self._leading, self._clearance, self._facing, self._level = leading, clearance, facing, level
        self._nearest = np.full(len(mesh.vertices), -1, np.int32)
        self._across = np.full(int(leading.max()) + 1, -1, np.int32)
        self._turn = -1  # everyone's
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
        other._nearest, other._across = np.full_like(self._nearest, -1), np.full_like(self._across, -1)
        other._targets, other._turn, other._relax = np.zeros_like(self._targets), -1, Launch(_relax)
        return other

    @property
    def memory(self) -> tuple[np.ndarray, np.ndarray, int]:
        """Where the next pass starts to look for the body: a copy; may be set again."""
        return self._nearest.copy(), self._across.copy(), self._turn

    @memory.setter
    def memory(self, memory: tuple[np.ndarray, np.ndarray, int]) -> None:
        self._nearest[:], self._across[:], self._turn = memory

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
            self._inverse_mass,
            self._edges,
            self._lengths,
            self._held,
            self._targets,
            self._leading,
            frames,
            self._facing,
            coarse_nearest,
            coarse_contact,
            self._nearest,
            self._turn,
            self._across,
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
        self._turn = (self._turn + 1) % TURNS
