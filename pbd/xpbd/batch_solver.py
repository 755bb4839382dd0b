"""Many garments in one launch, on all threads; or one large garment shared by several threads.

A launch of a kernel runs on one thread, and no other can start beside it. Here one launch takes all garments: their
arrays lie end to end in a few long ones (:mod:`pbd.xpbd.array_pools`). The schedule is that of
:mod:`pbd.xpbd.schedule`, and so are the bits of the result, whatever the number of threads.

On CUDA a block of threads has a garment: every colour of constraints is one parallel loop. There is no other schedule
for CUDA; players, whose garments collide with themselves and with one another, do not use this one.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from pbd.contact.body_search import BodySearch, find_nearest, find_nearest_vertices
from pbd.contact.colliders import Colliders
from pbd.engine import running_arch, running_threads, ti
from pbd.errors import InputError
from pbd.geometry import Float1, Float2, Int1, Int2, Int3, Int4, Vec2, Vec3, Vec4
from pbd.limits import LimitTargets
from pbd.model import State
from pbd.taichi_internals import Launch, in_kernel, signature
from pbd.xpbd.advance import advance_kernel
from pbd.xpbd.array_pools import ArgumentLayout, ArrayPools
from pbd.xpbd.schedule import advance_garment
from pbd.xpbd.solver import MIN_FRAME_TIME, Solver
from pbd.xpbd.views import (
    BodySurface,
    ClothArrays,
    ConstraintArrays,
    ContactWork,
    MultigridArrays,
    Obstacles,
    PairArrays,
    StepView,
    view_of,
)
from pbd.xpbd.workers import MAX_WORKERS, WorkerGroup

__all__ = ["BatchSolver"]

LOOP_BLOCK = 512  # Taichi gives a thread no less than this much of a loop
# Of each garment alone: the arrays that a step reads of the world, those that it writes for it, and its workspace. All
# others belong to its model or to its body's mesh, and garments may share them.
READ = (
    "position", "velocity", "nearest", "contact_faces", "contact_weights", "target_start", "target_end", "limits",
    "air", "primitives", "fields", "body_start", "body_end", "body_normals", "steps",
)  # fmt: skip
WRITTEN = ("position", "velocity", "nearest", "contact_faces", "contact_weights", "contact_distance")
WORKSPACE = (
    "contact_distance", "position_delta", "normals", "velocity_delta", "contact_points", "active_samples",
    "active_counts", "displacement", "patch_centers", "predicted_displacement", "coarse_strain", "spring_workspace",
    "max_approach", "limit_work", "reached", "cell_start", "cell_items", "item_cell",
)  # fmt: skip
OWN = frozenset(READ + WORKSPACE)


@in_kernel
class _GarmentViews:
    """The views of one garment, made of its arguments."""

    _data_oriented = True

    def __init__(self, arguments: Any, with_multigrid: bool, stiff: bool) -> None:
        found = arguments.found
        self.step = StepView(found["steps"], found["parameters"])
        self.cloth = view_of(ClothArrays, found)
        self.constraints = view_of(ConstraintArrays, {**found, "stiff": stiff})
        self.body = view_of(BodySurface, found)
        self.obstacles = view_of(Obstacles, found)
        self.contact = view_of(ContactWork, found)
        self.multigrid = view_of(MultigridArrays, {**found, "used": with_multigrid})
        self.pairs = PairArrays(used=False)
        self.search = view_of(BodySearch, found)
        self.dt, self.thickness = found["dt"], found["thickness"]


@cache
def _layout(with_multigrid: bool) -> ArgumentLayout:
    return ArgumentLayout({**signature(find_nearest), **signature(advance_kernel(with_multigrid))})


@cache
def _batch_kernel(with_multigrid: bool, stiff: bool, on_cuda: bool) -> Callable[..., None]:
    layout, stride = _layout(with_multigrid), 1 if on_cuda else LOOP_BLOCK

    @ti.kernel
    def advance_batch(
        floats: Float1,
        twos: Vec2,
        threes: Vec3,
        fours: Vec4,
        integers: Int1,
        pairs: Int2,
        triples: Int3,
        quads: Int4,
        table: Int1,
        reals: Float2,
        counts: ti.types.ndarray(dtype=ti.i32, ndim=2),
        barrier_counts: Int1,
        workers: ti.i32,
    ):
        ti.loop_config(block_dim=LOOP_BLOCK)
        for q in range(barrier_counts.shape[0] * workers * stride):
            if q % stride == 0:
                job = q // stride
                garment, worker, awaited = job // workers, job % workers, 0
                views = _GarmentViews(
                    layout.read(
                        garment, [floats, twos, threes, fours, integers, pairs, triples, quads], table, reals, counts
                    ),
                    with_multigrid,
                    stiff,
                )
                group = WorkerGroup(worker, workers, barrier_counts, garment, awaited)
                if group.first():
                    find_nearest_vertices(views.search, views.body, views.dt, views.thickness)
                group.barrier()
                advance_garment(
                    group, views.step, views.cloth, views.constraints, views.body, views.obstacles, views.contact,
                    views.multigrid, views.pairs,
                )  # fmt: skip

    return advance_batch


class BatchSolver:
    """Steps many garments at once, each as its solver would alone, to the bit.

    Args:
        solvers: of each garment; one solver may stand for several garments.
        threads_each: threads that share a garment. More than one pays for large meshes only, and if no other program
            wants the processor: they wait for each other hundreds of times a frame. On CUDA a block of threads does.

    Raises:
        InputError: no garment, one that collides with itself or has internal friction, or more threads than Taichi has.
    """

    def __init__(self, solvers: Sequence[Solver], threads_each: int = 1) -> None:
        if not solvers:
            raise InputError("batch without garments", key="solvers", received=0, expected="at least one solver")
        if not 1 <= threads_each <= running_threads():
            raise InputError(
                "bad thread count", key="threads_each", received=threads_each, expected=f"1..{running_threads()}"
            )
        if any(solver.in_contact for solver in solvers):
            raise InputError("garments that collide with themselves", key="solvers", expected="self_collision = false")
        if any(solver.model.plastic_count or solver.model.plastic_shear_count for solver in solvers):
            expected = "bend_hysteresis and shear_hysteresis of 0"
            raise InputError("garments with internal friction", key="solvers", expected=expected)
        with_multigrid = any(solver.with_multigrid for solver in solvers)
        stiff = any(solver.stiff for solver in solvers)
        on_cuda = running_arch() == "cuda"
        self._solvers = list(solvers)
        self._workers = MAX_WORKERS if on_cuda else threads_each
        self._layout = _layout(with_multigrid)
        self._launch = Launch(_batch_kernel(with_multigrid, stiff, on_cuda))
        self._arrays: list[dict[str, np.ndarray]] = []  # that the pools were made for
        self._pools: ArrayPools | None = None
        self._views: list[list[tuple[str, np.ndarray]]] = []  # parts of the pools that a step reads of the world
        self._barrier_counts = np.zeros(len(solvers), np.int32)

    def step(
        self,
        states: Sequence[State],
        colliders: Sequence[Colliders],
        dt: float,
        targets: Sequence[np.ndarray | None] | None = None,
        winds: Sequence[tuple[float, float, float] | np.ndarray] | None = None,
        limit_targets: Sequence[LimitTargets | None] | None = None,
    ) -> None:
        """Advance the states in place.

        Args:
            states, colliders, targets, winds, limit_targets: of each garment as in :meth:`pbd.Solver.step`.
            dt: frame time [s]; 0, or below 1e-7, does nothing.

        Raises:
            InputError: as in :meth:`pbd.Solver.step`, or not one of each for every garment.
        """
        if not np.isfinite(dt) or dt < 0:
            raise InputError("bad time step", key="dt", received=dt, expected="a finite number, at least 0 [s]")
        count = len(self._solvers)
        every = {
            "states": states,
            "colliders": colliders,
            "targets": targets,
            "winds": winds,
            "limit_targets": limit_targets,
        }
        for name, given in every.items():
            if given is not None and len(given) != count:
                raise InputError("not one for every garment", key=name, received=len(given), expected=str(count))
        if dt < MIN_FRAME_TIME:
            return
        arguments, read = [], []
        for number, solver, state, collider, target, wind, limit_target in zip(
            range(count),
            self._solvers,
            states,
            colliders,
            targets if targets is not None else [None] * count,
            winds if winds is not None else [(0.0, 0.0, 0.0)] * count,
            limit_targets if limit_targets is not None else [None] * count,
            strict=True,
        ):
            found = solver.prepare(state, collider, dt, target, wind, limit_target)
            arguments.append(found)
            # Copied at once: a solver that stands for several garments writes the next one's into the same arrays.
            read.append(self._place(number, found))
        self._run(arguments, self._pools if self._pools and not any(read) else self._make_pools(arguments, read))

    def _place(self, number: int, found: Mapping[str, Any]) -> dict[str, np.ndarray]:
        """Copy the arrays that a garment's step reads of the world into the pools.

        Returns:
            Copies of them by their names where the pools were made for other arrays; else none.
        """
        if self._pools is None or not self._fits(number, found):
            return {name: found[name].copy() for name in READ}
        for name, there in self._views[number]:
            there[...] = found[name]
        return {}

    def _make_pools(
        self, arguments: Sequence[Mapping[str, Any]], read: Sequence[Mapping[str, np.ndarray]]
    ) -> ArrayPools:
        """Make pools for the arguments of all garments; those whose ``read`` is empty have it in the old pools."""
        whole = [own or {name: there.copy() for name, there in self._views[k]} for k, own in enumerate(read)]
        self._arrays = [{name: own[name] for name in self._layout.arrays} for own in arguments]
        pools = self._pools = ArrayPools(self._layout, self._arrays, READ + WORKSPACE, READ + WRITTEN)
        self._views = [[(name, its[name]) for name in READ] for its in pools.views]
        for own, views in zip(whole, self._views, strict=True):
            for name, there in views:
                there[...] = own[name]
        return pools

    def _run(self, arguments: Sequence[Mapping[str, Any]], pools: ArrayPools) -> None:
        """Launch the kernel with the arguments of all garments by their names, and copy its results back."""
        reals, integers = zip(*(self._layout.numbers_of(own) for own in arguments), strict=True)
        self._barrier_counts[:] = 0
        self._launch(
            *pools.pools,
            pools.table,
            np.array(reals, np.float32),
            np.array(integers, np.int32),
            self._barrier_counts,
            self._workers,
        )
        for own, there in zip(arguments, pools.views, strict=True):
            for name in WRITTEN:
                own[name][...] = there[name]

    def _fits(self, number: int, found: Mapping[str, Any]) -> bool:
        """Whether the pools were made for a garment's arrays: the same ones, or of the same shape where it has own."""
        return all(
            found[name] is array or (name in OWN and found[name].shape == array.shape)
            for name, array in self._arrays[number].items()
        )
