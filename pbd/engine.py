"""The one module that sets Taichi up.

Every kernel of the project is written against the ``ti`` that this module exports, so that a maintained
fork of Taichi can take its place here. Importing the module is cheap: Taichi itself is loaded, but
no runtime is created before :func:`ensure_initialized`.
"""

from __future__ import annotations

import io
import os
import threading
from collections.abc import Callable
from contextlib import redirect_stdout
from typing import Any

import numpy as np

os.environ.setdefault("TI_ENABLE_TORCH", "0")  # torch, if installed, would add seconds to the import
os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")

import taichi as ti
from taichi.lang import impl
from taichi.lang.ast import ast_transformer_utils

from pbd.errors import InputError

__all__ = [
    "Launch", "cuda_is_here", "ensure_initialized", "in_kernel", "local", "running_arch", "running_threads",
    "same", "signature", "subscript", "ti",
]  # fmt: skip


class _Unwrapped:
    """Stands in for :class:`textwrap.TextWrapper`."""

    def __init__(self, **_: Any) -> None:
        pass

    def wrap(self, text: str) -> list[str]:
        return [text] if text.strip() else []


# Taichi writes the place of every expression that it compiles into a message, in case of an error, and breaks its lines
# to 80 columns: a good part of the time until the first frame.
ast_transformer_utils.TextWrapper = _Unwrapped

_lock = threading.Lock()
_settings: dict[str, object] | None = None


def ensure_initialized(arch: str = "cpu", threads: int | None = None) -> None:
    """Start Taichi once for this process; later calls with the same wishes do nothing.

    ``ti.init`` kills every array of an earlier ``ti.init`` with a bare error, so a call that asks for something
    else than what runs is refused.

    Args:
        arch: "cpu" or "cuda".
        threads: CPU threads; None takes what runs, or ``GUBE_THREADS``, or all cores.

    Raises:
        InputError: unknown arch, a thread count below one, or a conflict with the running set-up.
    """
    global _settings
    if arch not in ("cpu", "cuda"):
        raise InputError("unknown arch", key="arch", received=arch, expected="'cpu' or 'cuda'")
    if threads is not None and threads < 1:
        raise InputError("bad thread count", key="threads", received=threads, expected="at least 1")
    with _lock:
        if _settings is not None:
            same_threads = threads is None or threads == _settings["threads"]
            if arch == _settings["arch"] and same_threads:
                return
            raise InputError(
                "Taichi already runs with other settings in this process",
                received={"arch": arch, "threads": threads},
                expected=f"{_settings}, or a fresh process",
            )
        wish = os.environ.get("GUBE_THREADS", "0")
        if not wish.isdecimal():
            raise InputError(
                "bad thread count", key="GUBE_THREADS", received=wish, expected="a whole number, at least 0"
            )
        count = threads or int(wish) or os.cpu_count() or 1
        with redirect_stdout(io.StringIO()):  # Taichi prints the arch, whatever its log level
            ti.init(
                arch=ti.cpu if arch == "cpu" else ti.cuda,
                cpu_max_num_threads=count,
                default_fp=ti.f32,
                default_ip=ti.i32,
                offline_cache=True,
                log_level=ti.ERROR,
                fast_math=False,  # the same function in two kernels must round alike; costs a tenth of a frame
            )
        _settings = {"arch": arch, "threads": count}


def cuda_is_here() -> bool:
    """Whether there is an NVIDIA GPU with its driver."""
    return bool(ti.lang.impl._ti_core.with_cuda())


def running_arch() -> str:
    """What Taichi was started for: "cpu" or "cuda"."""
    return str(_running()["arch"])


def running_threads() -> int:
    """CPU threads that Taichi was started with."""
    return int(str(_running()["threads"]))


def _running() -> dict[str, object]:
    if _settings is None:
        raise RuntimeError("Taichi does not run yet: call ensure_initialized() first")
    return _settings


def in_kernel(function: Any) -> Any:
    """Mark a Python function or class that kernels call while they are compiled, so that Taichi does not warn of it."""
    setattr(function, "_is_taichi_function", False)  # noqa: B010
    return function


def subscript(array: Any, *index: Any) -> Any:
    """Element of an array in a kernel, to be read or written."""
    return impl.subscript(None, array, *index)


@in_kernel
def same(array: Any, other: Any) -> bool:
    """Whether two arguments of a function in a kernel are one: known while it is compiled."""
    return array is other


def signature(kernel: Callable[..., None]) -> dict[str, Any]:
    """Names and types of the arguments of a ``ti.kernel``."""
    return {argument.name: argument.annotation for argument in getattr(kernel, "_primal").arguments}  # noqa: B009


def local(value: Any) -> Any:
    """A variable of the kernel with a value, instead of an expression that is worked out again at every use."""
    return impl.expr_init(value)


class Launch:
    """One caller's way of calling one kernel frame after frame: the same result, for a tenth of the overhead.

    An ordinary call looks at every argument anew (10 us an array, 50 us a vector). Here Taichi's launch context is
    kept: an array is handed over when it is another than at the last call, numbers and vectors every time. Arrays that
    were handed over are kept alive and cannot be resized; one that was reshaped in place is handed over again.
    Where this Taichi's insides are not those of 1.7, and for arguments other than numpy arrays, numbers and vectors,
    every call is an ordinary one. Not for several threads at once.

    Args:
        kernel: a ``ti.kernel`` outside any class, without result.
    """

    def __init__(self, kernel: Callable[..., None]) -> None:
        self._kernel = kernel
        self._ordinary = False
        self._program: Any = None

    def __reduce__(self) -> tuple:
        return Launch, (self._kernel,)  # bound again where it comes to

    def __call__(self, *arguments: Any) -> None:
        """Run the kernel; arguments and errors are its own."""
        if not self._prepare(arguments):
            if _settings is None:  # Taichi's own message says nothing to the user
                ensure_initialized()
            self._kernel(*arguments)  # compiles it, and says what is wrong with an argument
            if not self._ordinary:
                self._bind(arguments)
            return
        for slot, give in self._numbers:
            give(slot, arguments[slot[0]])
        for position, slots, convert, give in self._vectors:
            for slot, value in zip(slots, arguments[position], strict=True):
                give(slot, convert(value))
        self._program.launch_kernel(self._compiled, self._context)

    def _prepare(self, arguments: tuple) -> bool:
        """Hand over the arrays that are new; False if that takes an ordinary call."""
        if self._program is None or self._program is not impl.get_runtime().prog or len(arguments) != self._count:
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
            self._give_array(position, array, inner)
        return True

    def _give_array(self, position: int, array: np.ndarray, inner: int) -> None:
        outer = array.shape[: array.ndim - inner]
        self._context.set_arg_external_array_with_shape((position,), array.ctypes.data, array.nbytes, outer, 0)

    def _bind(self, arguments: tuple) -> None:
        """Make a launch context for these arguments."""
        self._arrays: list[list[Any]] = []
        self._numbers: list[tuple[tuple[int], Callable[[tuple[int], Any], None]]] = []
        self._vectors: list[tuple[int, list[tuple[int, int]], Callable[[Any], Any], Callable[..., None]]] = []
        self._count = len(arguments)
        try:
            kernel = getattr(self._kernel, "_primal")  # noqa: B009
            compiled = kernel.compiled_kernels[kernel.ensure_compiled(*arguments)]
            self._context = compiled.make_launch_context()
            for position, (argument, parameter) in enumerate(zip(arguments, kernel.arguments, strict=True)):
                wish = parameter.annotation
                if isinstance(wish, ti.types.ndarray):
                    if type(argument) is not np.ndarray:
                        self._ordinary = True
                        return
                    if not argument.flags.c_contiguous:
                        return
                    inner = getattr(wish.dtype, "ndim", 0)
                    self._arrays.append([position, argument, argument.shape, inner])
                    self._give_array(position, argument, inner)
                elif wish is ti.f32:
                    self._numbers.append(((position,), self._context.set_arg_float))
                elif wish is ti.i32:
                    self._numbers.append(((position,), self._context.set_arg_int))
                elif wish.ndim == 1 and wish.dtype == ti.f32:
                    slots = [(position, i) for i in range(wish.n)]
                    self._vectors.append((position, slots, float, self._context.set_struct_arg_float))
                else:
                    self._ordinary = True
                    return
            program = impl.get_runtime().prog
            self._compiled = program.compile_kernel(program.config(), program.get_device_caps(), compiled)
        except (AttributeError, KeyError, TypeError):  # another Taichi
            self._ordinary = True
            return
        self._program = program
