"""Arrays that come from outside: refused where they are of another kind than what is read of them."""

from __future__ import annotations

from typing import Any

import numpy as np

from pbd.errors import InputError

__all__ = ["floats", "integers", "numbers"]

Shape = tuple[int | str, ...] | list[tuple[int | str, ...]]


def floats(values: Any, key: str, shape: Shape, problem: str | None = None, *, unit: str = "") -> np.ndarray:
    """Finite numbers as an array of their own type; an array is returned as it is.

    Args:
        values: what was handed over.
        key: its name in the message.
        shape: that it must have, or a list of such; a letter stands for any length.
        problem: the fault in the message; None says what is wrong with the array.
        unit: in the message, such as " [m]".

    Raises:
        InputError: something else than numbers, another shape, or numbers that are not finite.
    """
    array = numbers(values, key, shape, problem, kind=f"finite numbers{unit}")
    finite = np.isfinite(array)
    if not finite.all():
        row = "".join(f"[{k}]" for k in np.argwhere(~finite)[0, :1]) if problem is None else ""
        received, expected = float(array[~finite][0]), _expected(f"finite numbers{unit}", shape)
        raise InputError(problem or "values that are not finite", key=key + row, received=received, expected=expected)
    return array


def integers(
    values: Any, key: str, shape: Shape, below: int | None = None, *, outside: str = "out of range"
) -> np.ndarray:
    """Whole numbers from 0 on as an int32 array, such as vertices; they may come as floating-point numbers.

    Args:
        values: what was handed over.
        key: its name in the message.
        shape: that it must have; a letter stands for any length.
        below: bound of the numbers; None for none.
        outside: the fault in the message if a number is not below this.

    Raises:
        InputError: something else than numbers, another shape, fractions, or numbers out of range.
    """
    array = numbers(values, key, shape, None, kind="whole numbers")
    largest = np.iinfo(np.int32).max if below is None else below - 1
    good = (array >= 0) & (array <= largest)
    if array.dtype.kind == "f":
        good &= array == np.rint(array)
    if not good.all():
        row = "".join(f"[{k}]" for k in np.argwhere(~good)[0, :1])
        value = array[~good][0].item()
        problem = outside if value == np.rint(value) else "no whole number"
        raise InputError(problem, key=key + row, received=value, expected=f"whole numbers, 0 to {largest}")
    return np.asarray(array, np.int32)


def numbers(
    values: Any, key: str, shape: Shape, problem: str | None = None, *, kind: str = "finite numbers"
) -> np.ndarray:
    """Numbers of a shape, finite or not; the arguments are those of :func:`floats`, and what is expected in words.

    Raises:
        InputError: something else than numbers, or another shape.
    """
    try:
        array = np.asarray(values)
    except (ValueError, TypeError):
        fault, received = "no array", f"{type(values).__name__} of rows of different lengths"
    else:
        if array.dtype.kind in "fiu" and (array.shape == shape or _fits(array.shape, shape)):
            return array
        fault, received = "bad shape", array.shape
        if array.dtype.kind not in "fiu":
            fault = "no numbers"
            received = f"{array.dtype}, shape {array.shape}" if array.ndim else type(values).__name__
    raise InputError(problem or fault, key=key, received=received, expected=_expected(kind, shape))


def _expected(kind: str, shape: Shape) -> str:
    shapes = " or ".join(map(str, shape if isinstance(shape, list) else [shape])).replace("'", "")
    return f"{kind}, shape {shapes}" if shape else f"one of {kind}"


def _fits(shape: tuple[int, ...], wanted: Shape) -> bool:
    if isinstance(wanted, list):
        return any(_fits(shape, one) for one in wanted)
    pairs = zip(shape, wanted, strict=False)
    return len(shape) == len(wanted) and all(isinstance(want, str) or size == want for size, want in pairs)
