"""Many arrays end to end in a few long ones, so that one kernel takes the arrays of many garments.

Taichi's kernels take a fixed number of arrays. Here all arrays of one type of element lie in one pool; a table says
where each of them begins. In the kernel each is seen as an array of its own (:class:`ArraySlice`).
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pbd.engine import ti
from pbd.geometry import Float1, Int1, Int2, Int3, Int4, Vec2, Vec3, Vec4
from pbd.taichi_internals import in_kernel, local, subscript

__all__ = ["POOL_TYPES", "ArraySlice", "ArgumentLayout", "ArrayPools"]

POOL_TYPES = (Float1, Vec2, Vec3, Vec4, Int1, Int2, Int3, Int4)


def _kind(array_type: Any) -> tuple[bool, int]:
    """Whether the numbers of a type of array are integers, and how many make an element."""
    element = array_type.dtype
    return (getattr(element, "dtype", element) == ti.i32, getattr(element, "n", 1))


_KINDS = [_kind(pool) for pool in POOL_TYPES]


@in_kernel
class ArraySlice:
    """Rows of a longer array, used in a kernel as if they were an array of their own.

    Args:
        array: argument of the kernel.
        start: where its first element is.
        rows: number of rows.
        width: elements in a row, None for an array of one dimension.
    """

    _data_oriented = True

    def __init__(self, array: Any, start: Any, rows: Any, width: Any = None) -> None:
        self._array, self._start, self._width = array, start, width
        self.shape = [rows] if width is None else [rows, width]

    def __getitem__(self, index: Any) -> Any:
        if self._width is not None:
            row, column = index
            index = row * self._width + column
        return subscript(self._array, self._start + index)


class ArgumentLayout:
    """How the arguments of kernels for many garments lie in pools and tables.

    Args:
        types: name and type of each argument, see :func:`pbd.taichi_internals.signature`.

    Attributes:
        arrays: name and type of each array.
        numbers: name and type of each argument that is no array.
    """

    def __init__(self, types: Mapping[str, Any]) -> None:
        self.arrays = {name: wish for name, wish in types.items() if isinstance(wish, ti.types.ndarray)}
        self.numbers = {name: wish for name, wish in types.items() if name not in self.arrays}

    def numbers_of(self, arguments: Mapping[str, Any]) -> tuple[list[float], list[int]]:
        """Real numbers and integers among the arguments of a garment, as :meth:`in_kernel` reads them."""
        integers: list[int] = []
        reals: list[float] = []
        for name, wish in self.numbers.items():
            if wish is ti.i32:
                integers.append(arguments[name])
            elif wish is ti.f32:
                reals.append(arguments[name])
            else:
                reals.extend(arguments[name])
        return reals, integers

    @in_kernel
    def read(self, garment: Any, pools: Sequence[Any], table: Any, reals: Any, integers: Any) -> "KernelArguments":
        """Arguments of one garment by their names, in a kernel.

        Args:
            garment: its number.
            pools, table: of :class:`ArrayPools`.
            reals, integers: a row of :meth:`numbers_of` for each garment.
        """
        found = {}
        for k, (name, wish) in enumerate(self.arrays.items()):
            row = (garment * len(self.arrays) + k) * 3
            place = [local(subscript(table, row + c)) for c in range(1 + wish.ndim)]
            found[name] = ArraySlice(pools[_KINDS.index(_kind(wish))], *place)
        real, integer = 0, 0
        for name, wish in self.numbers.items():
            if wish is ti.i32:
                found[name] = local(subscript(integers, garment, integer))
                integer += 1
            elif wish is ti.f32:
                found[name] = local(subscript(reals, garment, real))
                real += 1
            else:
                found[name] = local(ti.Vector([subscript(reals, garment, real + c) for c in range(wish.n)]))
                real += wish.n
        return KernelArguments(found)


class KernelArguments:
    """Arguments of one garment by their names, in a kernel. Taichi hands the object on as it is."""

    _data_oriented = True

    def __init__(self, found: dict[str, Any]) -> None:
        self.found = found


class ArrayPools:
    """The arrays of many garments, end to end.

    Args:
        layout: of their arguments.
        arrays: of each garment by their names.
        own: names of arrays that are copied for each garment; garments may share the others.
        copied: names of arrays to which ``views`` shall lead.

    Attributes:
        pools: one array for each of ``POOL_TYPES``.
        table: start, rows and width of each array, int32.
        views: of each garment, parts of the pools by the name of the array.
    """

    def __init__(
        self,
        layout: ArgumentLayout,
        arrays: Sequence[Mapping[str, np.ndarray]],
        own: Sequence[str],
        copied: Sequence[str],
    ) -> None:
        parts: list[list[np.ndarray]] = [[] for _ in POOL_TYPES]
        starts = [0] * len(POOL_TYPES)
        known: dict[object, int] = {}
        table, where = [], []
        for garment, its in enumerate(arrays):
            for name, wish in layout.arrays.items():
                array, key = its[name], (garment, name) if name in own else id(its[name])
                integer, size = _kind(wish)
                pool = _KINDS.index((integer, size))
                if key not in known:
                    known[key] = starts[pool]
                    parts[pool].append(array.reshape(-1, size) if size > 1 else array.reshape(-1))
                    starts[pool] += len(parts[pool][-1])
                table.append((known[key], len(array), array.shape[1] if wish.ndim == 2 else 1))
                if name in copied:
                    where.append((garment, name, pool, known[key], array.shape, array.size // size))
        kinds = [((size,) if size > 1 else (), np.int32 if integer else np.float32) for integer, size in _KINDS]
        self.pools = [
            np.concatenate([*part, np.zeros((1, *shape), kind)])
            for part, (shape, kind) in zip(parts, kinds, strict=True)
        ]
        self.views: list[dict[str, np.ndarray]] = [{} for _ in arrays]
        for garment, name, pool, start, shape, length in where:
            self.views[garment][name] = self.pools[pool][start : start + length].reshape(shape)
        self.table = np.array(table, np.int32).ravel()
