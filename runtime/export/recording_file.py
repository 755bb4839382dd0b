"""The file of a recorded garment: a header in JSON, then arrays of whole numbers; see docs/recording-file.md."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from pbd import InputError

__all__ = ["LARGEST", "MAGIC", "VERSION", "Quantised", "links_of", "quantised", "read_recording", "recording_bytes"]

MAGIC = b"gube rec"
VERSION = 3
LARGEST = 2**27  # number of steps: the sums of a reader then fit into 32 bits
NEAR = 8  # earlier points among which a point's second one is chosen
ROUND = 4  # earlier points to each of a round's


@dataclass(frozen=True)
class Quantised:
    """Numbers that the file stores as whole ones: values = steps * scale.

    Attributes:
        steps: of any integer type; the first axis of an array of frames is time.
        scale: size of a step; 1 for numbers that are whole anyway.
        differences: how often differences along the first axis are taken before the steps are compressed.
        links: name of the array of :func:`links_of` by which the points of each frame predict one another, shape
            (F, N, 3); None where they do not.
    """

    steps: np.ndarray
    scale: float = 1.0
    differences: int = 0
    links: str | None = None


def quantised(
    key: str, values: np.ndarray, step: float, differences: int = 0, *, links: str | None = None
) -> Quantised:
    """Quantise values to whole steps.

    Args:
        key: what a refusal calls them.
        values: any shape.
        step: size of a step.
        differences, links: see :class:`Quantised`.

    Raises:
        InputError: values that are not finite, or larger than :data:`LARGEST` steps.
    """
    values = np.asarray(values, float)
    if not np.all(np.abs(values) <= LARGEST * step):
        expected = f"finite and at most {LARGEST * step:.3g}"
        received = f"{np.abs(values).max():.3g}"
        raise InputError("cannot be recorded", key=key, received=received, expected=expected)
    return Quantised(np.rint(values / step).astype(np.int32), step, differences, links)


def links_of(points: np.ndarray) -> Quantised:
    """An order of points, and two earlier ones on either side of each, whose mean predicts how it moves.

    Points are taken in a random order and in rounds, so that the points of a round lie between those of the rounds
    before. The first of the two earlier points is the nearest, the second is the near one with which the middle is
    closest to the point.

    Args:
        points: shape (N, 3).

    Returns:
        rows (point, first, second), shape (N, 3); the first row has no earlier points and names its own three times.
    """
    order = np.random.default_rng(0).permutation(len(points))
    links, done = np.repeat(order[:, None], 3, axis=1), 1
    while done < len(points):
        end = done + max(done // ROUND, 1)
        batch, earlier = order[done:end], order[:done]
        _, found = cKDTree(points[earlier]).query(points[batch], k=np.arange(1, min(NEAR, done) + 1))
        near = earlier[found]
        off = points[near[:, :1]] + points[near] - 2.0 * points[batch][:, None]
        opposite = (off**2).sum(axis=2).argmin(axis=1)
        links[done:end, 1] = near[:, 0]
        links[done:end, 2] = near[np.arange(len(batch)), opposite]
        done = end
    return Quantised(links.astype(np.int32))


def recording_bytes(about: Mapping[str, Any], arrays: Mapping[str, Quantised]) -> bytes:
    """The file's bytes.

    Args:
        about: what the header says besides the table of arrays.
        arrays: by name; links before the arrays that use them.
    """
    table: dict[str, dict[str, Any]] = {}
    blocks: list[bytes] = []
    for name, array in arrays.items():
        block = _compressed(array, arrays)
        place = {"shape": array.steps.shape, "offset": sum(map(len, blocks)), "size": len(block)}
        table[name] = {**place, "scale": array.scale, "differences": array.differences, "links": array.links}
        blocks.append(block)
    header = json.dumps({"version": VERSION, **about, "arrays": table}, separators=(",", ":")).encode()
    return b"".join([MAGIC, struct.pack("<I", len(header)), header, *blocks])


def _compressed(array: Quantised, arrays: Mapping[str, Quantised]) -> bytes:
    numbers = array.steps.astype(np.int64)
    for _ in range(array.differences):
        numbers = np.diff(numbers, axis=0, prepend=np.zeros_like(numbers[:1]))
    if array.links is not None:
        point, first, second = arrays[array.links].steps.T
        numbers[:, point[1:]] -= (numbers[:, first[1:]] + numbers[:, second[1:]]) >> 1
        numbers = numbers[:, point]
    folded = np.ascontiguousarray((numbers << 1) ^ (numbers >> 63), "<u4")
    packer = zlib.compressobj(9, strategy=zlib.Z_RLE)  # a tenth smaller than with repeated strings, which chance makes
    return packer.compress(folded.reshape(-1, 1).view(np.uint8).T.tobytes()) + packer.flush()


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
    arrays: dict[str, Quantised] = {}
    for name, entry in table.items():
        at = start + entry["offset"]
        planes = np.frombuffer(zlib.decompress(data[at : at + entry["size"]]), np.uint8).reshape(4, -1)
        folded = np.ascontiguousarray(planes.T).view("<u4").astype(np.int64)
        numbers = ((folded >> 1) ^ -(folded & 1)).reshape(entry["shape"])
        links, differences = entry["links"], entry["differences"]
        if links is not None:
            coded, numbers = numbers, np.zeros_like(numbers)
            for row, (point, first, second) in enumerate(arrays[links].steps):
                numbers[:, point] = coded[:, row] + ((numbers[:, first] + numbers[:, second]) >> 1)
        for _ in range(differences):
            numbers = np.cumsum(numbers, axis=0)
        arrays[name] = Quantised(numbers.astype(np.int32), entry["scale"], differences, links)
    return about, arrays
