"""The file of a recorded garment: a header in JSON, then arrays of quantised values; see docs/recording-file.md."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pbd import InputError

__all__ = ["MAGIC", "VERSION", "Quantised", "quantised", "read_recording", "recording_bytes"]

MAGIC = b"gube rec"
VERSION = 2


@dataclass(frozen=True)
class Quantised:
    """Numbers that the file stores as whole ones: values = steps * scale.

    Attributes:
        steps: whole numbers, or float32 where the values are stored as they are.
        scale: one float32, or float32 of the shape of ``steps`` without the axis ``along``; None for steps themselves.
        along: axis whose values share a scale; None where all values do.
        differences: how often differences along the first axis are taken before the steps are compressed.
    """

    steps: np.ndarray
    scale: np.ndarray | None = None
    along: int | None = None
    differences: int = 0

    @property
    def values(self) -> np.ndarray:
        """Values as every reader computes them: float32, or the steps themselves if they have no scale."""
        if self.scale is None:
            return self.steps
        scale = self.scale if self.along is None else np.expand_dims(self.scale, self.along)
        return self.steps.astype(np.float32) * scale


def quantised(
    values: np.ndarray,
    kind: type[np.signedinteger],
    along: int | None = None,
    step: float | None = None,
    order: int = 0,
) -> Quantised:
    """Quantise values to whole steps.

    Args:
        values: finite.
        kind: type of the steps.
        along: axis whose values share a scale; None for one scale.
        step: size of a step; None takes the smallest that the largest value allows.
        order: see :attr:`Quantised.differences`.

    Raises:
        OverflowError: values that are too large for a given step.
    """
    largest = np.iinfo(kind).max
    if step is None:
        peak = np.abs(values).max(axis=along, keepdims=along is not None, initial=0.0)
        scale = np.where(peak > 0.0, peak / largest, 1.0).astype(np.float32)
    else:
        scale = np.asarray(step, np.float32)
    steps = np.rint(np.asarray(values, float) / scale)
    if np.abs(steps).max(initial=0.0) > largest:
        if step is not None:
            raise OverflowError(f"{np.abs(values).max():g} in steps of {step:g} needs more than {np.dtype(kind)}")
        steps = np.clip(steps, -largest, largest)
    return Quantised(steps.astype(kind), scale.squeeze(along) if along is not None else scale, along, order)


def recording_bytes(about: Mapping[str, Any], arrays: Mapping[str, Quantised]) -> bytes:
    """The file's bytes.

    Args:
        about: what the header says besides the table of arrays.
        arrays: by name.
    """
    table: dict[str, dict[str, Any]] = {}
    blocks: list[bytes] = []

    def add(name: str, values: np.ndarray, differences: int = 0, **scaled: Any) -> None:
        block = zlib.compress(_planes(values, differences), 9)
        entry = {"type": str(values.dtype), "shape": values.shape, "offset": sum(map(len, blocks)), "size": len(block)}
        table[name] = entry | ({"differences": differences} if differences else {}) | scaled
        blocks.append(block)

    for name, array in arrays.items():
        if array.scale is None:
            add(name, array.steps, array.differences)
        elif array.along is None:
            add(name, array.steps, array.differences, scale=float(array.scale))
        else:  # scales stand before the steps that they belong to
            add(f"{name}_scale", array.scale)
            add(name, array.steps, array.differences, scale=f"{name}_scale", along=array.along)
    header = json.dumps({"version": VERSION, **about, "arrays": table}, separators=(",", ":")).encode()
    return b"".join([MAGIC, struct.pack("<I", len(header)), header, *blocks])


def read_recording(data: bytes) -> tuple[dict[str, Any], dict[str, Quantised]]:
    """Header and arrays of :func:`recording_bytes`.

    Raises:
        InputError: bytes that it did not make.
    """
    try:
        return _read(data)
    except (ValueError, KeyError, TypeError, AttributeError, IndexError, struct.error, zlib.error) as error:
        raise InputError(f"cannot be read: {error}", key="recording", expected="a file of recording_bytes") from error


def _read(data: bytes) -> tuple[dict[str, Any], dict[str, Quantised]]:
    if data[: len(MAGIC)] != MAGIC:
        raise ValueError("another beginning")
    (length,) = struct.unpack_from("<I", data, len(MAGIC))
    start = len(MAGIC) + 4
    about = json.loads(data[start : start + length])
    table, start = about.pop("arrays"), start + length
    plain = {}
    for name, entry in table.items():
        at = start + entry["offset"]
        plain[name] = _from_planes(zlib.decompress(data[at : at + entry["size"]]), entry)
    arrays = {}
    for name, entry in table.items():
        scale, along, order = entry.get("scale"), entry.get("along"), entry.get("differences", 0)
        scale = plain[scale] if isinstance(scale, str) else None if scale is None else np.asarray(scale, np.float32)
        arrays[name] = Quantised(plain[name], scale, along, order)
    return about, arrays


def _planes(values: np.ndarray, order: int) -> bytes:
    """Little-endian bytes, the first bytes of all values before their second ones; whole numbers wrap around."""
    for _ in range(order):
        values = np.diff(values, axis=0, prepend=np.zeros_like(values[:1]))
    data = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
    return data.reshape(-1, 1).view(np.uint8).T.tobytes()


def _from_planes(data: bytes, entry: Mapping[str, Any]) -> np.ndarray:
    dtype = np.dtype(entry["type"]).newbyteorder("<")
    planes = np.frombuffer(data, np.uint8).reshape(dtype.itemsize, -1)
    values = np.ascontiguousarray(planes.T).view(dtype).reshape(entry["shape"]).astype(entry["type"])
    for _ in range(entry.get("differences", 0)):
        values = np.cumsum(values, axis=0, dtype=values.dtype)
    return values
