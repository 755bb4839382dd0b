"""Quasi-static relaxation of the fine mesh: its own forces come to rest, held vertices in place, out of the body."""

from collections.abc import Sequence
from copy import copy

import numpy as np
from scipy.sparse import csr_matrix, diags, identity
from scipy.spatial import cKDTree

from pbd import Fabric
from pbd.contact.body_surface import BodySurface
from pbd.contact.colliders import Body
from pbd.engine import ensure_initialized, ti
from pbd.geometry import Float1, Float2, Int1, Int2, Int3, Vec3, Vec4, Vec4Rows, vec3, vec4, xyz
from pbd.mesh import vertex_rings
from pbd.model import Model
from pbd.taichi_internals import Launch
from pbd.xpbd.constraint_passes import solve_membrane, solve_stitches
from pbd.xpbd.views import ClothArrays, ConstraintArrays, MultigridArrays
from wrinkles.charts import leading_vertices
from wrinkles.clearance import clearances, facing
from wrinkles.covered_body import CoveredBody
from wrinkles.fine_surface import sparse_row
from wrinkles.garment_separation import GarmentSeparation
from wrinkles.levels import Levels
from wrinkles.opposite_parts import BETWEEN, PHASES, TouchedBody, find_parts
from wrinkles.out_of_body import MAX_LIFT, MIN_LIFT, lift_around, out_of_body, state_around
from wrinkles.surface import csr_arrays

__all__ = ["PASSES", "Relaxation"]

PASSES = 1  # of full detail: a second one takes folds away and mends nothing that is seen
# The substep of a pass is the time in which this speed [m/s] passes a mean fine edge: 1/2880 s for 5 mm. The shortest
# folds come to rest in a few passes then, and longer ones hardly move.
SPEED = 14.4
# Of the thickness, kept from a flat body: cloth that is pressed gives way by the rest, and if every vertex were at one
# distance, the body's faces would be seen in the cloth.
KEPT = 0.5
# Where the coarse garment is further than this from the body, so is the fine one [m], ...
LEVEL = 0.025
PLEATED = 0.045  # ... unless the garment came with pleats, which go deeper


@ti.kernel
def _rest(
    fine: Vec3,
    work: Vec4,
    triangles: Int3,
    triangle_blocks: Int2,
    block_colors: Int1,
    triangle_data: Float2,
    stitches: Int3,
    stitch_data: Vec4,
    bending_start: Int1,
    bending_index: Int1,
    bending_value: Float1,
    inverse_h2: ti.f32,
):
    """A pass over membrane, bending and stitches; ``work`` has the inverse masses.

    From rest: velocities would only carry away what is not solved.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        for i in range(fine.shape[0]):
            work[i] = vec4(fine[i], work[i][3])
        cloth = ClothArrays(position=work, position_delta=work)
        constraints = ConstraintArrays(
            triangles, triangle_blocks, block_colors, triangle_data, stitches=stitches, stitch_data=stitch_data,
        )  # fmt: skip
        no_levels = MultigridArrays(False, parent=block_colors, coarse_strain=work)
        for k in range(block_colors.shape[0] - 1):
            first, last = block_colors[k], block_colors[k + 1]
            solve_membrane(cloth, constraints, no_levels, 0, inverse_h2, 1.0, first, last)
        for i in range(work.shape[0]):
            x = sparse_row(bending_start, bending_index, bending_value, work, i)
            work[i] = vec4(xyz(x), work[i][3])
        solve_stitches(cloth, constraints, 0.0)
        for i in range(fine.shape[0]):
            fine[i] = xyz(work[i])


@ti.kernel
def _find_parts(
    body: Vec3,
    body_normals: Vec3,
    coarse_nearest: Int1,
    coarse_contact: Float1,
    coarse_before: Int1,
    across: Int1,
    state: Int1,
    cell_start: Int1,
    items: Int2,
    item_places: Vec4Rows,
    level: ti.f32,
    phase: ti.i32,
):
    """See :func:`find_parts` and :class:`TouchedBody`."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        find_parts(
            phase,
            TouchedBody(
                body, body_normals, coarse_nearest, coarse_contact, coarse_before, across, state, cell_start,
                items, item_places, level,
            ),
        )  # fmt: skip


@ti.kernel
def _leave_body(
    fine: Vec3,
    free: Int1,
    held: Int1,
    leading: Int3,
    frames: Float2,
    facing: ti.f32,
    coarse_nearest: Int1,
    across: Int1,
    state: Int1,
    nearest: Int1,
    body: Vec3,
    body_normals: Vec3,
    ring_start: Int1,
    ring: Int1,
    fan_start: Int1,
    fan: Int2,
    edge_ends: Int1,
    edge_sides: Int2,
    clearance: Float1,
    fine_start: Int1,
    fine_ring: Int1,
    lifts: Vec4,
    queue: Int1,
):
    """Free vertices leave the body and lift what is around them; see :class:`CoveredBody`.

    Over 12 arguments: a kernel takes arrays one by one.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        covered = CoveredBody(
            BodySurface(body, body, ring_start, ring, fan_start, fan, body_normals), clearance, nearest,
            edge_ends, edge_sides, coarse_nearest, across, state, leading, frames, facing,
        )  # fmt: skip
        for i in range(lifts.shape[0]):
            lifts[i] = ti.math.vec4(0.0)
        for c in range(held.shape[0]):
            lifts[held[c]] = vec4(vec3(0.0), MAX_LIFT)
        count = 0
        for i in range(free.shape[0]):
            j = free[i]
            start = fine[j]
            around = state_around(i, covered)
            end = out_of_body(i, start, around, covered)
            fine[j] = end
            moved_by = end - start
            if around >= BETWEEN:
                lifts[j][3] = MAX_LIFT  # nothing may lift it into the other part
            elif moved_by.dot(moved_by) > MIN_LIFT * MIN_LIFT:
                height = moved_by.norm()
                lifts[j] = vec4(moved_by / height, ti.min(height, MAX_LIFT))
                queue[count] = j
                count += 1
        lift_around(fine, fine_start, fine_ring, lifts, queue, count)


class Relaxation:
    """Quasi-static relaxation of the fine mesh: its own forces come to rest, held vertices in place, out of the body.

    Smooth surface and wrinkles are a guess. A pass moves them as XPBD moves cloth that stands still, by the constraints
    of the fine garment: folds get the shape in which they would rest.

    Args:
        model: the fine garment.
        leading: coarse vertices around each fine one, whose contact it starts from; see
            :func:`wrinkles.charts.leading_vertices`.
        clearance: kept from the body at each of its vertices [m], float32, shape (b,); see
            :func:`wrinkles.clearance.clearances`.
        facing: 1 where the garment's faces look away from the body, -1 where they look at it.
        level: where the coarse vertices around a fine one are all further than this from the body, so is that one [m].
        comes_to_rest: whether a pass moves vertices by the garment's own forces. A delivered mesh may have pleats that
            are longer than the coarse garment leaves room for: its shortest folds would get sharper with each pass.
        separations: that keep the outer garments of an outfit over the inner ones, from the innermost outwards.
    """

    def __init__(
        self,
        model: Model,
        leading: np.ndarray,
        clearance: np.ndarray,
        facing: float,
        level: float = LEVEL,
        comes_to_rest: bool = True,
        separations: Sequence[GarmentSeparation] = (),
    ) -> None:
        ensure_initialized()
        self._separations = separations
        held = model.held
        is_held = model.inverse_mass == 0.0
        # Vertices that lie near one another look at the same part of the body.
        order = np.lexsort((leading[:, 1], leading[:, 0]))
        self._free = order[~is_held[order]].astype(np.int32)
        self._leading = np.ascontiguousarray(leading[self._free], np.int32)
        stitch_data = np.zeros((len(model.stitches), 4), np.float32)
        stitch_data[:, 0], stitch_data[:, 1] = model.stitch_weights, model.stitch_gaps
        stitch_data[:, 2] = model.stitch_gaps
        self._inverse_h2 = (SPEED / float(model.mesh.edge_lengths()[1].mean())) ** 2
        self._constraints = (
            model.triangles, model.triangle_blocks, model.block_colors, model.triangle_data, model.stitches,
            stitch_data, *csr_arrays(_bending_sweep(model, self._inverse_h2)),
        )  # fmt: skip
        self._inverse_mass = model.inverse_mass
        self._rings = vertex_rings(model.mesh.faces, len(model.mesh.vertices))
        self._held = np.asarray(held, np.int32)
        self._clearance, self._facing, self._level = clearance, facing, level
        self._comes_to_rest = comes_to_rest
        self._forget(int(leading.max()) + 1)

    def _forget(self, coarse_count: int) -> None:
        """Make everything that changes from pass to pass."""
        count = len(self._free)
        self._nearest = np.full(2 * count, -1, np.int32)
        self._across, self._before = (np.full(coarse_count, -1, np.int32) for _ in range(2))
        self._state = np.zeros(coarse_count, np.int32)
        self._work = np.zeros((count + len(self._held), 4), np.float32)
        self._work[:, 3] = self._inverse_mass
        lifts, queue = np.zeros((len(self._work), 4), np.float32), np.zeros(4 * len(self._work), np.int32)
        self._lifting = *self._rings, lifts, queue
        cells = 1 << (2 * coarse_count).bit_length()
        self._cells = (
            np.zeros(cells + 1, np.int32),
            np.zeros((2 * coarse_count, 2), np.int32),
            np.zeros((2 * coarse_count, 2, 4), np.float32),
        )
        self._phase = -1  # every vertex searches
        self._rest, self._find_parts, self._leave_body = Launch(_rest), Launch(_find_parts), Launch(_leave_body)

    @classmethod
    def of(
        cls,
        levels: Levels,
        body_vertices: np.ndarray,
        body_faces: np.ndarray,
        fabric: Fabric,
        bend_factor: float | None,
    ) -> "Relaxation":
        """Relaxation of a garment on a body.

        Args:
            levels: of the garment.
            body_vertices: of the body in its bind pose [m], shape (b, 3).
            body_faces: int, shape (k, 3).
            fabric: of the garment.
            bend_factor: hinge factor of its meshes, see :func:`pbd.bending.hinge_calibration`; None finds it.
        """
        edges, lengths = levels.fine.edge_lengths()
        longest = np.zeros(len(levels.fine.vertices))
        np.maximum.at(longest, edges, lengths[:, None])
        delivered = levels.subdivision.binding is not None
        spacing = longest[cKDTree(levels.fine.vertices).query(body_vertices)[1]]
        model = levels.model(fabric, bend_factor=bend_factor, fine=True)
        outwards = facing(levels.coarse, body_vertices, body_faces)
        leading = leading_vertices(levels.subdivision)
        return cls(
            model,
            leading,
            clearances(body_vertices, body_faces, spacing, KEPT * fabric.thickness),
            outwards,
            PLEATED if delivered else LEVEL,
            not delivered,
            _separations(levels, leading, outwards, model.fabric.thickness),
        )

    def fresh(self) -> "Relaxation":
        """A relaxation of the same garment that remembers no pass; what takes long to set up is shared."""
        other = copy(self)
        other._forget(len(self._across))
        return other

    @property
    def memory(self) -> tuple[np.ndarray | int, ...]:
        """What the next pass starts from: where the last ones found the body. A copy; may be set again."""
        return *(array.copy() for array in self._remembered), self._phase

    @memory.setter
    def memory(self, memory: tuple[np.ndarray | int, ...]) -> None:
        *arrays, phase = memory
        for array, kept in zip(self._remembered, arrays, strict=True):
            array[:] = kept
        self._phase = int(phase)

    @property
    def _remembered(self) -> tuple[np.ndarray, ...]:
        return self._nearest, self._across, self._before

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
            passes: number of passes over the garment's own forces; none for a delivered mesh.
        """
        fine[self._held] = targets
        for _ in range(passes if self._comes_to_rest else 0):
            self._rest(fine, self._work, *self._constraints, self._inverse_h2)
        self._find_parts(
            current, body.normals, coarse_nearest, coarse_contact, self._before, self._across, self._state,
            *self._cells, self._level, self._phase,
        )  # fmt: skip
        self._leave_body(
            fine, self._free, self._held, self._leading, frames, self._facing, coarse_nearest, self._across,
            self._state, self._nearest, current, body.normals, body.ring_start, body.ring, body.fan_start, body.fan,
            *body.first_edges, self._clearance, *self._lifting,
        )  # fmt: skip
        for separation in self._separations:
            separation(fine)
        self._phase = (self._phase + 1) % PHASES


def _bending_sweep(model: Model, inverse_h2: float) -> csr_matrix:
    """Rows of a sweep of Gauss and Seidel over an implicit step of the bending forces alone, shape (N, N).

    Hinges that are flat at rest have the energy |K x|^2 / (2 alpha): their force is -B x with one matrix B. Vertex i
    moves by -(B x)_i / (B_ii + m_i/h^2). Each row sums to one, and that of a held vertex leaves it where it is.
    """
    rows, laws = model.hinge_data[:, 0].astype(float), model.hinge_data[:, 1].astype(float)
    number = np.repeat(np.arange(len(rows)), 4)
    curl = csr_matrix((rows.ravel(), (number, model.hinges.ravel())), (len(rows), len(model.inverse_mass)))
    bending = (curl.T @ diags(1.0 / laws[:, 1]) @ curl).tocsr()
    mobility = model.inverse_mass / (model.inverse_mass * bending.diagonal() + inverse_h2)
    return (identity(len(mobility)) - diags(mobility) @ bending).tocsr()


def _separations(levels: Levels, leading: np.ndarray, outwards: float, kept: float) -> list[GarmentSeparation]:
    """What keeps each outer garment of an outfit over those below it, from the innermost outwards."""
    if levels.layers is None:
        return []
    edge, layers = float(levels.coarse.edge_lengths()[1].mean()), levels.layers
    held, subdivision = levels.fine_held, levels.subdivision
    return [
        GarmentSeparation(layers, subdivision, leading, number, held, outwards, kept, edge)
        for number in range(1, len(layers.names))
    ]
