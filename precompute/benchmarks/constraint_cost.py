"""What one constraint of each type costs, beside the scalar limit of the machine measured in the same run."""

import time
from collections.abc import Callable

import numpy as np

from pbd import Fabric, State
from pbd.engine import ensure_initialized, ti
from pbd.geometry import Float1, Float2, Int1, Int2, Int3, Int4, Vec4, Vec4Rows, vec4, xyz
from pbd.mesh import greedy_colors
from pbd.model import BLOCK
from pbd.xpbd.constraint_passes import solve_bending, solve_membrane
from pbd.xpbd.constraints import spring_multiplier
from pbd.xpbd.multigrid_cycle import solve_springs
from pbd.xpbd.views import ClothArrays, ConstraintArrays, MultigridArrays
from precompute.experiment.swinging_square import hanging_square

__all__ = ["constraint_costs"]

SIDE = 64  # vertices along a side of the cloth
PASSES, REPEATS = 10, 15


@ti.kernel
def _membranes(
    position: Vec4,
    delta: Vec4,
    triangles: Int3,
    blocks: Int2,
    data: Float2,
    parent: Int1,
    strain: Vec4,
    inverse_h2: ti.f32,
):
    ti.loop_config(serialize=True)
    for _ in range(1):
        for _pass in range(PASSES):
            solve_membrane(
                ClothArrays(position=position, position_delta=delta),
                ConstraintArrays(triangles=triangles, triangle_blocks=blocks, triangle_data=data),
                MultigridArrays(parent=parent, coarse_strain=strain),
                1,
                inverse_h2,
                1.0,
                0,
                blocks.shape[0],
            )


@ti.kernel
def _hinges(position: Vec4, delta: Vec4, hinges: Int4, data: Vec4Rows, inverse_h2: ti.f32):
    ti.loop_config(serialize=True)
    for _ in range(1):
        for _pass in range(PASSES):
            solve_bending(
                ClothArrays(position=position, position_delta=delta),
                ConstraintArrays(hinges=hinges, hinge_data=data),
                inverse_h2,
                0,
                hinges.shape[0],
            )


@ti.kernel
def _distances(displacement: Vec4, edges: Int2, colors: Int1, workspace: Float2):
    ti.loop_config(serialize=True)
    for _ in range(1):
        for _pass in range(PASSES):
            for k in range(colors.shape[0] - 1):
                levels = MultigridArrays(displacement=displacement, springs=edges, spring_workspace=workspace)
                solve_springs(levels, colors[k], colors[k + 1])


@ti.kernel
def _limit(offsets: Vec4, lengths: Float1, corrections: Vec4):
    """The arithmetic of a distance alone: no indices, no vertex that two constraints share."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        for _pass in range(PASSES):
            for c in range(offsets.shape[0]):
                offset = xyz(offsets[c])
                direction = offset.normalized()
                change = spring_multiplier(offset, direction, lengths[c], 0.0, offsets[c][3], 0.0)
                corrections[c] = vec4(change * direction)


def constraint_costs() -> dict[str, float]:
    """Processor time of a constraint on a square of 64 by 64 vertices, the best of 15 runs: ``TYPE_constraint_ns``."""
    ensure_initialized()
    model = hanging_square(SIDE, Fabric())
    count, noise = model.vertex_count, np.random.default_rng(0)
    edges, lengths = model.mesh.edge_lengths()
    colors = greedy_colors(edges, count)
    order = np.argsort(colors, kind="stable")
    edges, lengths = np.ascontiguousarray(edges[order]), lengths[order].astype(np.float32)
    color_starts = np.concatenate([[0], np.cumsum(np.bincount(colors))]).astype(np.int32)
    delta, strain = np.zeros((count, 4), np.float32), np.zeros((1, 4), np.float32)
    position = State.at_rest(model).position
    position[:, :3] += noise.normal(0.0, 1e-4, (count, 3))
    offsets = position[edges[:, 0]] - position[edges[:, 1]]
    offsets[:, 3] = 2.0 * position[:, 3].max()
    corrections = np.zeros_like(offsets)
    displacement, workspace = np.zeros((count, 4), np.float32), np.zeros((9, len(edges) + BLOCK), np.float32)
    displacement[:, 3] = position[:, 3]
    distances = np.linalg.norm(offsets[:, :3], axis=1)
    # All are too long, so that none is passed over: springs only pull.
    workspace[:7, : len(edges)] = [
        *(offsets[:, :3].T / distances),
        distances,
        0.9 * lengths,
        0.0 * lengths,
        offsets[:, 3],
    ]
    workspace[8] = -1.0
    parent, rate = np.zeros(count, np.int32), 480.0**2
    costs = {
        "scalar_limit": _time(len(edges), lambda: _limit(offsets, lengths, corrections)),
        "membrane": _time(
            len(model.triangles),
            lambda: _membranes(
                position, delta, model.triangles, model.triangle_blocks, model.triangle_data, parent, strain, rate
            ),
        ),
        "hinge": _time(len(model.hinges), lambda: _hinges(position, delta, model.hinges, model.hinge_data, rate)),
        "distance": _time(len(edges), lambda: _distances(displacement, edges, color_starts, workspace)),
    }
    return {f"{name}_constraint_ns": cost for name, cost in costs.items()}


def _time(count: int, launch: Callable[[], None]) -> float:
    times = np.zeros(REPEATS)
    launch()
    for repeat in range(REPEATS):
        begin = time.process_time()
        launch()
        times[repeat] = time.process_time() - begin
    return float(times.min()) / (PASSES * count) * 1e9
