"""One quasi-static pass on the fine mesh: stretched edges back to length, held vertices in place, out of the body."""

from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from pbd.contact.colliders import Body
from pbd.engine import ensure_initialized, ti
from pbd.geometry import Float1, Float2, Int1, Int2, Int3, Vec3, closest_in_fan, descend, vec3
from pbd.mesh import ClothMesh, greedy_colors
from pbd.taichi_internals import Launch, in_kernel, quickly_compiled
from pbd.xpbd.views import BodySurface
from wrinkles.charts import leading_vertices
from wrinkles.clearance import clearances, facing
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
MAX_SQUARED_DISTANCE = 0.01  # to a body vertex that may be near the cloth [m2]
MAX_FACE_DISTANCE = 0.05  # to a face that may be near the cloth [m]


@in_kernel
@dataclass(eq=False)
class _Covered:
    """The body under the cloth in one pass; a view, see :mod:`pbd.xpbd.views`.

    Attributes:
        surface: :class:`pbd.xpbd.views.BodySurface`, which stands still.
        clearance: kept from it at each of its vertices [m].
        nearest: of each fine vertex the body vertex where it was last near the body, -1 for none.
        coarse_nearest, coarse_contact: body vertex near each coarse vertex, -1 for none, and distance to the body [m].
        across: of each coarse vertex a body vertex opposite to the one that it is near to, -1 for none.
        leading: three coarse vertices around each fine one.
        frames: of the coarse vertices, their normals from column 6 on.
        facing: 1 where the garment's faces look away from the body, -1 where they look at it.
        level: coarse vertices further than this from the body are not near it [m].
    """

    surface: Any
    clearance: Any
    nearest: Any
    coarse_nearest: Any
    coarse_contact: Any
    across: Any
    leading: Any
    frames: Any
    facing: Any
    level: Any
    _data_oriented = True


@quickly_compiled
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
    phase: ti.i32,
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
    """See :meth:`Relaxation.__call__` and :class:`_Covered`. Over 12 arguments: a kernel takes arrays one by one."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        covered = _Covered(
            BodySurface(body, body, ring_start, ring, fan_start, fan, body_normals), clearance, nearest,
            coarse_nearest, coarse_contact, across, leading, frames, facing, level,
        )  # fmt: skip
        for c in range(held.shape[0]):
            fine[held[c]] = targets[c]
        for _pass in range(passes):
            _shorten_edges(fine, inverse_mass, edges, lengths)
            _find_opposite(phase, covered)
            for i in range(fine.shape[0]):
                if inverse_mass[i] > 0.0:
                    fine[i] = _out_of_body(i, fine[i], covered)


@ti.func
def _shorten_edges(fine: ti.template(), inverse_mass: ti.template(), edges: ti.template(), lengths: ti.template()):
    """Take back a share of the stretch of each edge, one edge after the other."""
    for c in range(edges.shape[0]):
        i, j = edges[c][0], edges[c][1]
        d = fine[j] - fine[i]
        squared = d.dot(d)
        if squared > lengths[c] * lengths[c]:
            size = ti.sqrt(squared)
            total = inverse_mass[i] + inverse_mass[j]
            # Only stretch is taken back: pushing short edges apart in one pass folds the mesh edge by edge. And only a
            # share of it: whole corrections of a stretched coarse state overshoot from edge to edge.
            d *= STRETCH_SHARE * (size - lengths[c]) / (size * total)
            fine[i] += inverse_mass[i] * d
            fine[j] -= inverse_mass[j] * d


@ti.func
def _out_of_body(i: ti.i32, start: vec3, covered: ti.template()) -> vec3:
    """Where fine vertex i goes from ``start`` [m] so that it keeps its clearance from the body.

    First from the part of the body that the cloth covers, then from a part opposite to it, where there is one.
    """
    p = start
    coarse = covered.leading[i][0]
    last = covered.nearest[i]
    covered.nearest[i] = -1
    others = ti.min(covered.coarse_contact[covered.leading[i][1]], covered.coarse_contact[covered.leading[i][2]])
    if ti.min(covered.coarse_contact[coarse], others) < covered.level:
        frames = ti.static(covered.frames)
        outwards = covered.facing * vec3(frames[coarse, 6], frames[coarse, 7], frames[coarse, 8])
        normal, other_normal, home = vec3(0.0), vec3(0.0), vec3(0.0)
        gap, other_gap, kept, other_kept = MAX_HEIGHT, MAX_HEIGHT, 0.0, 0.0
        parts = 1
        for c in ti.static(range(3)):
            if covered.across[covered.leading[i][c]] >= 0:
                parts = 2
        for part in range(parts):
            best = _body_vertex(i, part, last, p, home, outwards, covered)
            if best < 0:
                break
            if part == 0:
                covered.nearest[i] = best
                home, outwards = covered.surface.body_start[best], covered.surface.body_normals[best]
            n, h, c = _height(p, best, covered)
            if part == 0:
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
    return p


@ti.func
def _body_vertex(
    i: ti.i32, part: ti.i32, last: ti.i32, p: vec3, home: vec3, outwards: vec3, covered: ti.template()
) -> ti.i32:
    """Body vertex near fine vertex i at p [m], on the part that it covers (0) or on the opposite one (1); -1 for none.

    The search starts where the coarse vertices around this one are near the body, and where it was itself last.

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
    if best >= 0:
        best = descend(p, best, 0.0, covered.surface)
        offset = p - body[best]
        if offset.dot(offset) > MAX_SQUARED_DISTANCE:
            best = -1
    if part == 1 and best >= 0:
        if not _opposed(home, outwards, body[best], normals[best]):
            best = -1
    return best


@ti.func
def _opposed(p: vec3, normal: vec3, q: vec3, other_normal: vec3) -> bool:
    """Whether two places of the body [m] face one another; both sides of a bump look apart as well, but from behind."""
    offset = q - p
    apart = -normal.dot(other_normal)
    limit = -ti.max(MAX_SINE_BEHIND * offset.norm(), MAX_OVERLAP * apart)
    return apart > 0.0 and offset.dot(normal) > limit and -offset.dot(other_normal) > limit


@ti.func
def _find_opposite(phase: ti.i32, covered: ti.template()):
    """Find for coarse vertices a body vertex opposite to the one that they touch, which the garment touches elsewhere.

    A coarse vertex searches once in ``PHASES`` frames, or in each if ``phase`` is below 0.
    """
    body, normals, across = ti.static(covered.surface.body_start, covered.surface.body_normals, covered.across)
    for c in range(across.shape[0]):
        own, old = covered.coarse_nearest[c], across[c]
        if own < 0 or covered.coarse_contact[c] >= covered.level:
            across[c] = -1
        else:
            # A coarse vertex that goes over from one part to the other leaves the part behind that was opposite to the
            # first.
            stale = old >= 0 and not _opposed(body[own], normals[own], body[old], normals[old])
            if stale or phase < 0 or c % PHASES == phase:
                best, distance = -1, MAX_ACROSS * MAX_ACROSS
                for k in range(across.shape[0]):
                    if covered.coarse_contact[k] < covered.level:
                        for other in ti.static(range(2)):
                            seed = across[k] if ti.static(other == 1) else covered.coarse_nearest[k]
                            if seed >= 0:
                                offset = body[seed] - body[own]
                                away = offset.dot(offset)
                                if away < distance and _opposed(body[own], normals[own], body[seed], normals[seed]):
                                    distance = away
                                    best = seed
                across[c] = best


@ti.func
def _height(p: vec3, vertex: ti.i32, covered: ti.template()):
    """Normal of the body near one of its vertices, height of p [m] over it, and the clearance there [m].

    Near the body the faces around the vertex count; further away its tangent plane is enough.
    """
    body, normals, clearance = ti.static(covered.surface.body_start, covered.surface.body_normals, covered.clearance)
    normal, height, kept = normals[vertex], (p - body[vertex]).dot(normals[vertex]), 0.0
    if height < ti.min(clearance[vertex] + MAX_TESTED_EXCESS, MAX_HEIGHT):
        f, w, squared = closest_in_fan(p, vertex, 0.0, covered.surface)
        offset = p - (w[0] * body[vertex] + w[1] * body[f[0]] + w[2] * body[f[1]])
        normal = w[0] * normals[vertex] + w[1] * normals[f[0]] + w[2] * normals[f[1]]
        normal /= ti.max(normal.norm(), 1e-20)
        kept = w[0] * clearance[vertex] + w[1] * clearance[f[0]] + w[2] * clearance[f[1]]
        height = offset.dot(normal)
        if squared > MAX_FACE_DISTANCE * MAX_FACE_DISTANCE:
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
        other._nearest, other._across = np.full_like(self._nearest, -1), np.full_like(self._across, -1)
        other._targets, other._phase, other._relax = np.zeros_like(self._targets), -1, Launch(_relax)
        return other

    @property
    def memory(self) -> tuple[np.ndarray, np.ndarray, int]:
        """Where the next pass starts to look for the body: a copy; may be set again."""
        return self._nearest.copy(), self._across.copy(), self._phase

    @memory.setter
    def memory(self, memory: tuple[np.ndarray, np.ndarray, int]) -> None:
        self._nearest[:], self._across[:], self._phase = memory

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
            self._phase,
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
        self._phase = (self._phase + 1) % PHASES
