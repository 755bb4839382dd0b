"""Many garments in one launch, on all threads; or one large garment shared by several.

A launch of a kernel runs on one thread, and no other can start beside it. Here one launch takes all garments: their
arrays lie end to end in a few long ones, and each is seen as an array of its own (:class:`pbd.team.Part`). The schedule
is that of :mod:`pbd.schedule`, and so are the bits of the result, whatever the number of threads.

On CUDA a block of threads has a garment: every colour of constraints is one parallel loop.
"""

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np

from pbd.advance import advance_kernel
from pbd.colliders import Colliders
from pbd.engine import Launch, in_kernel, local, running_arch, running_threads, signature, subscript, ti
from pbd.errors import InputError
from pbd.geometry import Float1, Float2, Int1, Int2, Int3, Int4, Vec3, Vec4
from pbd.limits import Places
from pbd.model import State
from pbd.schedule import advance_garment
from pbd.search import find_nearest, find_of_garment
from pbd.solver import SHORTEST_FRAME, Solver
from pbd.team import MOST_WORKERS, Part, Team

__all__ = ["Crowd"]

BLOCK = 512  # Taichi gives a thread no less than this much of a loop
# Of each garment alone: what a step reads of the world, what it writes for it, and room for the step. All else is of
# its model or its body's mesh, and garments may share it.
READ = (
    "position", "velocity", "nearest", "target_0", "target_1", "limits", "air", "primitives", "fields",
    "body_0", "body_1", "body_normals", "steps",
)  # fmt: skip
WRITTEN = ("position", "velocity", "nearest", "contact")
ROOM = (
    "contact", "shift", "normals", "gained", "touched", "awake", "listed", "ways", "places", "first_ways",
    "borne", "link_room", "way", "cell_start", "cell_items", "item_cell",
)  # fmt: skip
POOLS = (Float1, Vec3, Vec4, Int1, Int2, Int3, Int4)


def _kind(array_type: Any) -> tuple[bool, int]:
    """Whether the numbers of a type of array are whole, and how many make an element."""
    element = array_type.dtype
    return (getattr(element, "dtype", element) == ti.i32, getattr(element, "n", 1))


_KINDS = [_kind(pool) for pool in POOLS]


class _Layout:
    """Arrays and numbers of the two kernels of a step.

    Attributes:
        arrays: name and type of each array.
        numbers: name and type of what is no array.
        search, course: names of the arguments of the two kernels.
    """

    def __init__(self, with_patches: bool) -> None:
        search, course = signature(find_nearest), signature(advance_kernel(with_patches))
        self.search, self.course = tuple(search), tuple(course)
        every = {**search, **course}
        self.arrays = {name: wish for name, wish in every.items() if isinstance(wish, ti.types.ndarray)}
        self.numbers = {name: wish for name, wish in every.items() if name not in self.arrays}

    @in_kernel
    def arguments(self, garment: Any, pools: Sequence[Any], table: Any, reals: Any, wholes: Any) -> "_Arguments":
        """What the functions of a step are called with for one garment, in a kernel."""
        found = {}
        for k, (name, wish) in enumerate(self.arrays.items()):
            place = [local(subscript(table, (garment * len(self.arrays) + k) * 3 + c)) for c in range(1 + wish.ndim)]
            found[name] = Part(pools[_KINDS.index(_kind(wish))], *place)
        real, whole = 0, 0
        for name, wish in self.numbers.items():
            if wish is ti.i32:
                found[name] = local(subscript(wholes, garment, whole))
                whole += 1
            elif wish is ti.f32:
                found[name] = local(subscript(reals, garment, real))
                real += 1
            else:
                found[name] = local(ti.Vector([subscript(reals, garment, real + c) for c in range(wish.n)]))
                real += wish.n
        return _Arguments([found[name] for name in self.search], [found[name] for name in self.course])


class _Arguments:
    """What :meth:`_Layout.arguments` finds."""

    _data_oriented = True

    def __init__(self, search: list, course: list) -> None:
        self.search, self.course = search, course


@cache
def _layout(with_patches: bool) -> _Layout:
    return _Layout(with_patches)


@cache
def _crowd_kernel(with_patches: bool, on_cuda: bool) -> Callable[..., None]:
    layout, stride = _layout(with_patches), 1 if on_cuda else BLOCK

    @ti.kernel
    def advance_crowd(
        floats: Float1,
        threes: Vec3,
        fours: Vec4,
        ints: Int1,
        pairs: Int2,
        triples: Int3,
        quads: Int4,
        table: Int1,
        reals: Float2,
        wholes: ti.types.ndarray(dtype=ti.i32, ndim=2),
        meetings: Int1,
        workers: ti.i32,
    ):
        ti.loop_config(block_dim=BLOCK)
        for q in range(meetings.shape[0] * workers * stride):
            if q % stride == 0:
                job = q // stride
                garment, worker, awaited = job // workers, job % workers, 0
                arguments = layout.arguments(
                    garment, [floats, threes, fours, ints, pairs, triples, quads], table, reals, wholes
                )
                team = Team(worker, workers, meetings, garment, awaited)
                if team.first():
                    find_of_garment(*arguments.search)
                team.meet()
                advance_garment(team, with_patches, False, *arguments.course)

    return advance_crowd


class Crowd:
    """Steps many garments at once, each as its solver would alone, to the bit.

    Args:
        solvers: of each garment; one solver may stand for several garments.
        threads_each: threads that share a garment. More than one pays for large meshes only, and if no other program
            wants the processor: they wait for each other hundreds of times a frame. On CUDA a block of threads does.

    Raises:
        InputError: no garment, one that collides with itself, or more threads than Taichi has.
    """

    def __init__(self, solvers: Sequence[Solver], threads_each: int = 1) -> None:
        if not solvers:
            raise InputError("crowd without garments", key="solvers", received=0, expected="at least one solver")
        if not 1 <= threads_each <= running_threads():
            raise InputError(
                "bad thread count", key="threads_each", received=threads_each, expected=f"1..{running_threads()}"
            )
        if any(solver.in_contact for solver in solvers):
            raise InputError("garments that collide with themselves", key="solvers", expected="self_collision = false")
        with_patches = any(solver.with_patches for solver in solvers)
        on_cuda = running_arch() == "cuda"
        self._solvers = list(solvers)
        self._workers = MOST_WORKERS if on_cuda else threads_each
        self._layout = _layout(with_patches)
        self._launch = Launch(_crowd_kernel(with_patches, on_cuda))
        self._arrays: list[dict[str, np.ndarray]] = []
        self._pools = [np.zeros(0)] * len(POOLS)
        self._places: list[dict[str, np.ndarray]] = []
        self._table = np.zeros(0, np.int32)
        self._meetings = np.zeros(len(solvers), np.int32)

    def step(
        self,
        states: Sequence[State],
        colliders: Sequence[Colliders],
        dt: float,
        targets: Sequence[np.ndarray | None] | None = None,
        winds: Sequence[tuple[float, float, float] | np.ndarray] | None = None,
        places: Sequence[Places | None] | None = None,
    ) -> None:
        """Advance the states in place.

        Args:
            states, colliders, targets, winds, places: of each garment as in :meth:`pbd.Solver.step`.
            dt: frame time [s]; 0, or below 1e-7, does nothing.

        Raises:
            InputError: as in :meth:`pbd.Solver.step`, or not one of each for every garment.
        """
        if not np.isfinite(dt) or dt < 0:
            raise InputError("bad time step", key="dt", received=dt, expected="a finite number, at least 0 [s]")
        count = len(self._solvers)
        every = {"states": states, "colliders": colliders, "targets": targets, "winds": winds, "places": places}
        for name, given in every.items():
            if given is not None and len(given) != count:
                raise InputError("not one for every garment", key=name, received=len(given), expected=str(count))
        if dt < SHORTEST_FRAME:
            return
        layout = self._layout
        arrays, reals, wholes = [], [], []
        for garment, solver in enumerate(self._solvers):
            target = None if targets is None else targets[garment]
            wind = (0.0, 0.0, 0.0) if winds is None else winds[garment]
            place = None if places is None else places[garment]
            search, course = solver.prepare(states[garment], colliders[garment], dt, target, wind, place)
            found = {**dict(zip(layout.search, search, strict=True)), **dict(zip(layout.course, course, strict=True))}
            arrays.append({name: found[name] for name in layout.arrays})
            numbers = [(wish, found[name]) for name, wish in layout.numbers.items()]
            wholes.append([value for wish, value in numbers if wish is ti.i32])
            reals.append(np.concatenate([np.atleast_1d(value) for wish, value in numbers if wish is not ti.i32]))
        if not self._fits(arrays):
            self._lay_out(arrays)
        for own, there in zip(arrays, self._places, strict=True):
            for name in READ:
                there[name][:] = own[name]
        self._meetings[:] = 0
        self._launch(
            *self._pools,
            self._table,
            np.array(reals, np.float32),
            np.array(wholes, np.int32),
            self._meetings,
            self._workers,
        )
        for own, there in zip(arrays, self._places, strict=True):
            for name in WRITTEN:
                own[name][:] = there[name]

    def _fits(self, arrays: list[dict[str, np.ndarray]]) -> bool:
        """Whether the long arrays were made for these."""
        return len(self._arrays) == len(arrays) and all(
            array.shape == kept[name].shape if name in READ or name in ROOM else array is kept[name]
            for own, kept in zip(arrays, self._arrays, strict=True)
            for name, array in own.items()
        )

    def _lay_out(self, arrays: list[dict[str, np.ndarray]]) -> None:
        """Make the long arrays, and the table that says where in them each array is: start, rows and width."""
        parts: list[list[np.ndarray]] = [[] for _ in POOLS]
        starts = [0] * len(POOLS)
        known: dict[object, int] = {}
        table, where = [], []
        for garment, own in enumerate(arrays):
            for name, wish in self._layout.arrays.items():
                array, key = own[name], (garment, name) if name in READ or name in ROOM else id(own[name])
                whole, size = _kind(wish)
                pool = _KINDS.index((whole, size))
                if key not in known:
                    known[key] = starts[pool]
                    parts[pool].append(array.reshape(-1, size) if size > 1 else array.reshape(-1))
                    starts[pool] += len(parts[pool][-1])
                table.append((known[key], len(array), array.shape[1] if wish.ndim == 2 else 1))
                if name in READ or name in WRITTEN:
                    where.append((garment, name, pool, known[key], array.shape, array.size // size))
        kinds = [((size,) if size > 1 else (), np.int32 if whole else np.float32) for whole, size in _KINDS]
        self._pools = [
            np.concatenate([*part, np.zeros((1, *shape), kind)])
            for part, (shape, kind) in zip(parts, kinds, strict=True)
        ]
        self._places = [{} for _ in arrays]
        for garment, name, pool, start, shape, length in where:
            self._places[garment][name] = self._pools[pool][start : start + length].reshape(shape)
        self._table = np.array(table, np.int32).ravel()
        self._arrays = arrays
