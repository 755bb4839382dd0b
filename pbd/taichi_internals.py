"""The insides of Taichi 1.7 and of Quadrants 1.3 that the project depends on, all in this module.

Another version may have other insides. Then kernels still run: :class:`Launch` calls them in the ordinary way.
"""

from __future__ import annotations

import copyreg
import sys
from collections.abc import Callable, Mapping
from dataclasses import is_dataclass
from functools import lru_cache
from operator import attrgetter
from types import SimpleNamespace
from typing import Any

import numpy as np

from pbd.engine import ensure_initialized, running_program, ti

__all__ = ["Launch", "in_kernel", "local", "same", "subscript", "translations"]

QUADRANTS = ti.__name__ == "quadrants"
impl, kernel_impl = ti.lang.impl, ti.lang.kernel_impl


def _place(self: Any, node: Any) -> str:
    """Stands in for ``get_pos_info``, which also draws the source line with a mark below."""
    return f'File "{self.file}", line {node.lineno + self.lineno_offset}, in {self.func.func.__name__}:\n'


def _inside_class(level_of_class_stackframe: int) -> bool:
    """Whether a function that is decorated now is in a class; stands in for one that reads the source to find out."""
    return "__qualname__" in sys._getframe(level_of_class_stackframe - 1).f_locals


def _make_translation_fast() -> None:
    """Take out of Taichi's translation of Python a third of its time, which is most of that until the first frame.

    It writes the place of every expression that it translates into a message, in case of an error. A function that is
    used several times in a kernel is looked up in its file, cut out and laid out anew each time. And for every function
    that is decorated, the source of the module around it is read.
    """
    kernel_impl._inside_class = _inside_class
    if QUADRANTS:
        return  # has mended the rest itself
    ti.lang.ast.ast_transformer_utils.ASTTransformerContext.get_pos_info = _place
    for name in ("getsourcelines", "getsourcefile"):
        setattr(kernel_impl, name, lru_cache(maxsize=None)(getattr(kernel_impl, name)))
    text = kernel_impl.textwrap
    kernel_impl.textwrap = SimpleNamespace(fill=lru_cache(maxsize=None)(text.fill), dedent=text.dedent)


try:
    _make_translation_fast()
    if QUADRANTS:  # its kernels are objects; like functions, they go to other processes by their names
        copyreg.pickle(ti.lang._quadrants_callable.QuadrantsCallable, attrgetter("__qualname__"))
except AttributeError:  # another version
    pass


def in_kernel(function: Any) -> Any:
    """Mark a Python function or class that kernels call while they are compiled, so that Taichi does not warn of it.

    A dataclass is one no longer: Quadrants would hand on its members as so many arguments.
    """
    setattr(function, f"_is_{ti.__name__}_function", False)  # noqa: B010
    if is_dataclass(function):
        delattr(function, "__dataclass_fields__")  # noqa: B043
    return function


def subscript(array: Any, *index: Any) -> Any:
    """Element of an array in a kernel, to be read or written."""
    return impl.subscript(None, array, *index)


@in_kernel
def same(array: Any, other: Any) -> bool:
    """Whether two arguments of a function in a kernel are one: known while it is compiled."""
    return array is other


def _arguments(kernel: Any) -> list[Any]:
    """Descriptions of a kernel's arguments, each with a name and an annotation."""
    return kernel.arg_metas if QUADRANTS else kernel.arguments


def translations(kernel: Any) -> dict[Any, Any]:
    """What a kernel has been translated to, by its kinds of arguments."""
    return kernel.materialized_kernels if QUADRANTS else kernel.compiled_kernels


def _slot(position: int) -> Any:
    """Place of an argument in a launch context."""
    return position if QUADRANTS else (position,)


def local(value: Any) -> Any:
    """A variable of the kernel with a value, instead of an expression that is worked out again at every use."""
    return impl.expr_init(value)


class Launch:
    """One caller's way of calling one kernel frame after frame: the same result, for a tenth of the overhead.

    An ordinary call looks at every argument anew (10 us an array, 50 us a vector). Here Taichi's launch context is
    kept: an array is handed over when it is another than at the last call, numbers and vectors every time. Arrays that
    were handed over are kept alive and cannot be resized; one that was reshaped in place is handed over again.
    On a GPU, where Taichi's insides are not those of 1.7, and for arguments other than numpy arrays, numbers and
    vectors, every call is an ordinary one. Not for several threads at once.

    Args:
        kernel: a ``ti.kernel`` outside any class, without result.
    """

    def __init__(self, kernel: Callable[..., None]) -> None:
        self._kernel = kernel
        self._ordinary = False
        self._program: Any = None
        self._names: tuple[str, ...] | None = None

    def __reduce__(self) -> tuple:
        return Launch, (self._kernel,)  # bound again where it comes to

    @property
    def module(self) -> str:
        """The module that the kernel was written in."""
        return self._kernel.__module__

    def __call__(self, *arguments: Any) -> None:
        """Run the kernel; arguments and errors are its own."""
        if not self._prepare(arguments):
            ensure_initialized()  # Taichi's own message says nothing to the user
            self._kernel(*arguments)  # compiles it, and reports a wrong argument
            if not self._ordinary:
                self._bind(arguments)
            return
        for position, slot, set_number in self._numbers:
            set_number(slot, arguments[position])
        for position, slots, convert, set_number in self._vectors:
            for slot, value in zip(slots, arguments[position], strict=True):
                set_number(slot, convert(value))
        self._program.launch_kernel(self._compiled, self._context)

    def by_name(self, arguments: Mapping[str, Any]) -> None:
        """Run the kernel with the arguments that have the names of its own; others may be there too."""
        if self._names is None:
            self._names = tuple(argument.name for argument in _arguments(getattr(self._kernel, "_primal")))  # noqa: B009
        self(*(arguments[name] for name in self._names))

    def _prepare(self, arguments: tuple) -> bool:
        """Hand over the arrays that are new; False if that takes an ordinary call."""
        if self._program is None or self._program is not running_program() or len(arguments) != self._count:
            return False
        for entry in self._arrays:
            position, kept, shape, inner = entry
            array = arguments[position]
            if array is kept and array.shape == shape:
                continue
            if (
                type(array) is not np.ndarray
                or array.dtype != kept.dtype
                or array.ndim != len(shape)
                or array.shape[1:] != shape[1:]
                or not array.flags.c_contiguous
            ):
                self._program = None
                return False
            entry[1:3] = array, array.shape
            self._set_array(position, array, inner)
        return True

    def _set_array(self, position: int, array: np.ndarray, inner: int) -> None:
        outer = array.shape[: array.ndim - inner]
        self._context.set_arg_external_array_with_shape(_slot(position), array.ctypes.data, array.nbytes, outer, 0)

    def _bind(self, arguments: tuple) -> None:
        """Make a launch context for these arguments."""
        self._arrays: list[list[Any]] = []
        self._numbers: list[tuple[int, Any, Callable[[Any, Any], None]]] = []
        self._vectors: list[tuple[int, list[tuple[int, int]], Callable[[Any], Any], Callable[..., None]]] = []
        self._count = len(arguments)
        if impl.current_cfg().arch == ti.cuda:  # a launch leaves addresses of the GPU's memory in the context
            self._ordinary = True
            return
        try:
            kernel = getattr(self._kernel, "_primal")  # noqa: B009
            translated = translations(kernel)[kernel.ensure_compiled(*arguments)]
            self._context = translated.make_launch_context()
            for position, (argument, parameter) in enumerate(zip(arguments, _arguments(kernel), strict=True)):
                wish = parameter.annotation
                if isinstance(wish, ti.types.ndarray):
                    if type(argument) is not np.ndarray:
                        self._ordinary = True
                        return
                    if not argument.flags.c_contiguous:
                        return
                    inner = getattr(wish.dtype, "ndim", 0)
                    self._arrays.append([position, argument, argument.shape, inner])
                    self._set_array(position, argument, inner)
                elif wish is ti.f32:
                    self._numbers.append((position, _slot(position), self._context.set_arg_float))
                elif wish is ti.i32:
                    self._numbers.append((position, _slot(position), self._context.set_arg_int))
                elif wish.ndim == 1 and wish.dtype == ti.f32:
                    slots = [(position, i) for i in range(wish.n)]
                    self._vectors.append((position, slots, float, self._context.set_struct_arg_float))
                else:
                    self._ordinary = True
                    return
            program = running_program()
            compiled = program.compile_kernel(program.config(), program.get_device_caps(), translated)
            self._compiled = compiled.compiled_kernel_data if QUADRANTS else compiled
        except (AttributeError, KeyError, TypeError):  # another Taichi
            self._ordinary = True
            return
        self._program = program
