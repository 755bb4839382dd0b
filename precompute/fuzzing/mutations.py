"""Good files made bad: bytes, tokens of text, and the structure that a kind of file has.

A file that is cut anywhere is refused at its first bytes. One whose structure is sound and whose values are not goes
deeper, so that most mutations know the structure: trees of JSON, arrays of NPZ and HDF5, chunks of GLB.
"""

from __future__ import annotations

import io
import json
import random
import re
import struct
from collections.abc import Callable
from typing import Any

import h5py
import numpy as np

__all__ = ["mutated"]

NUMBERS = (
    "0", "-0.0", "-1", "1", "2", "3", "1e-300", "1e300", "1e39", "nan", "inf", "-inf", "2147483647", "2147483648",
    "-2147483649", "18446744073709551616", "0x10", "1e", "", "1.5", "999999999999999999999999",
)  # fmt: skip
TEXTS = ("", " ", "\0", "../../etc/passwd", "builtin:none", "ü" * 300, "<script>", "%s%n", "a/b", "None", "[]", "{")
VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2**31, 2**63, -(2**40), 1e300, -1e300, 0.5, "", "x", [], {}, [0], [[]], {"a": 1},
    float("nan"), float("inf"), [1e300] * 3, "builtin:none",
)  # fmt: skip
ENDINGS_OF_TEXT = (".obj", ".toml", ".csv", ".bvh", ".json", ".gltf", ".svg", ".dxf", ".usda")
MOST = 4  # mutations of one file
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


def mutated(data: bytes, ending: str, chance: random.Random) -> bytes:
    """A file with one to four mutations.

    Args:
        data: of a file, good or mutated before.
        ending: of its name, with the dot: says which structure it has.
        chance: every choice comes from it.
    """
    for _ in range(chance.randint(1, MOST)):
        structured = STRUCTURED.get(ending)
        try:
            if structured is not None and chance.random() < 0.7:
                data = structured(data, chance)
            elif ending in ENDINGS_OF_TEXT and chance.random() < 0.8:
                data = _text(data, chance)
            else:
                data = _bytes(data, chance)
        except Exception:  # noqa: BLE001 - an earlier mutation has broken the structure that this one needs
            data = _bytes(data, chance)
    return data


def _bytes(data: bytes, chance: random.Random) -> bytes:
    """Bits turned, bytes lost, doubled or set, the end cut off."""
    changed = bytearray(data or b"\0")
    at = chance.randrange(len(changed))
    kind = chance.randrange(6)
    if kind == 0:
        changed[at] ^= 1 << chance.randrange(8)
    elif kind == 1:
        del changed[at : at + chance.randint(1, 64)]
    elif kind == 2:
        changed[at:at] = changed[at : at + chance.randint(1, 64)]
    elif kind == 3:
        del changed[at:]
    elif kind == 4:
        width = chance.choice((1, 2, 4, 8))
        value = chance.choice((0, 1, 2 ** (8 * width - 1) - 1, 2 ** (8 * width) - 1, chance.getrandbits(8 * width)))
        changed[at : at + width] = value.to_bytes(width, chance.choice(("little", "big")))
    else:
        changed[at : at + 4] = struct.pack("<f", chance.choice((float("nan"), float("inf"), 1e38, -1.0, 0.0)))
    return bytes(changed)


def _text(data: bytes, chance: random.Random) -> bytes:
    """A number replaced, a line lost, doubled, moved or cut, a word replaced."""
    kind = chance.randrange(5)
    if kind == 0:
        found = list(_NUMBER.finditer(data))
        if found:
            one = chance.choice(found)
            return data[: one.start()] + chance.choice(NUMBERS).encode() + data[one.end() :]
    lines = data.split(b"\n")
    at = chance.randrange(len(lines))
    if kind == 1:
        del lines[at]
    elif kind == 2:
        lines.insert(chance.randrange(len(lines) + 1), lines[at])
    elif kind == 3:
        lines[at] = lines[at][: chance.randint(0, len(lines[at]))]
    else:
        words = lines[at].split(b" ")
        words[chance.randrange(len(words))] = chance.choice((*TEXTS, *NUMBERS)).encode()
        lines[at] = b" ".join(words)
    return b"\n".join(lines)


def _tree(tree: Any, chance: random.Random) -> Any:
    """A tree of dictionaries and lists with one value replaced, lost, doubled or taken from elsewhere."""
    places: list[tuple[Any, Any]] = []

    def visit(node: Any) -> None:
        keys = list(node) if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ()
        for key in keys:
            places.append((node, key))
            visit(node[key])

    visit(tree)
    if not places:
        return chance.choice(VALUES)
    node, key = chance.choice(places)
    kind = chance.randrange(5)
    if kind == 0:
        del node[key]
    elif kind == 1 and isinstance(node[key], (int, float)):
        node[key] = node[key] * chance.choice((-1, 0, 2, 1000)) + chance.choice((-1, 0, 1))
    elif kind == 2 and isinstance(node, list):
        node.append(node[key])
    elif kind == 3:
        other, place = chance.choice(places)
        node[key] = json.loads(json.dumps(other.get(place) if isinstance(other, dict) else None))
    else:
        node[key] = chance.choice(VALUES)
    return tree


def _json(data: bytes, chance: random.Random) -> bytes:
    return json.dumps(_tree(json.loads(data), chance)).encode()


def _glb(data: bytes, chance: random.Random) -> bytes:
    """The tree of a GLB, or its binary chunk, with lengths that fit, mostly."""
    (size,) = struct.unpack_from("<I", data, 12)
    text, rest = data[20 : 20 + size], data[20 + size :]
    if chance.random() < 0.7:
        text = _json(text, chance)
        text += b" " * (-len(text) % 4)
    else:
        rest = rest[:8] + _bytes(rest[8:], chance)
        if chance.random() < 0.5 and len(rest) >= 8:
            rest = struct.pack("<I", len(rest) - 8) + rest[4:]
    whole = len(text) + len(rest) + 20 if chance.random() < 0.95 else chance.getrandbits(32)
    return data[:8] + struct.pack("<II", whole, len(text)) + data[16:20] + text + rest


def _array(array: np.ndarray, chance: random.Random) -> np.ndarray:
    """An array of other values, of another type or of another shape."""
    kind = chance.randrange(6)
    array = np.array(array)
    if kind == 0 and array.size and array.dtype.kind in "fiu":
        array.ravel()[chance.randrange(array.size)] = (
            chance.choice((np.nan, np.inf, 1e30, -1.0, 0.0))
            if array.dtype.kind == "f"
            else chance.choice((0, np.iinfo(array.dtype).max, np.iinfo(array.dtype).min))
        )
    elif kind == 1:
        wanted = chance.choice(("f2", "f4", "f8", "i1", "i4", "i8", "u8", "c16", "S5", "U3", "?"))
        with np.errstate(all="ignore"):
            array = array.astype(wanted)
    elif kind == 2:
        array = array.reshape(-1)[: chance.randint(0, max(1, array.size))]
    elif kind == 3:
        array = array[None] if chance.random() < 0.5 or not array.ndim else array[..., 0]
    elif kind == 4 and array.ndim:
        array = np.concatenate([array, array[:1]]) if len(array) else np.zeros((3, *array.shape[1:]), array.dtype)
    else:
        array = np.zeros_like(array)
    return array


def _npz(data: bytes, chance: random.Random) -> bytes:
    with np.load(io.BytesIO(data), allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    name = chance.choice(sorted(arrays))
    kind = chance.randrange(8)
    if kind == 0:
        del arrays[name]
    elif kind == 1:
        arrays[name + "_"] = arrays.pop(name)
    else:
        arrays[name] = _array(arrays[name], chance)
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


def _hdf5(data: bytes, chance: random.Random) -> bytes:
    """A data set or an attribute of an HDF5 file; the hash of a database's content is made to fit, mostly."""
    out = io.BytesIO(data)
    with h5py.File(out, "r+") as file:
        sets: list[str] = []
        file.visititems(lambda name, item: sets.append(name) if isinstance(item, h5py.Dataset) else None)
        kind = chance.randrange(10)
        if kind == 0:
            name = chance.choice(sorted(file.attrs))
            file.attrs[name] = chance.choice((b"", b"x" * 100, 0, -1, 1.5, np.zeros(3)))
        elif kind == 1:
            del file[chance.choice(sets)]
        else:
            name = chance.choice(sets)
            attributes, value = dict(file[name].attrs), _array(file[name][()], chance)
            del file[name]
            made = file.create_dataset(name, data=value)
            for key, attribute in attributes.items():
                made.attrs[key] = attribute
        if "content_hash" in file.attrs and chance.random() < 0.8:
            from wrinkles.schema import ENTRIES, content_hash

            arrays = {e.name: np.asarray(file.attrs[e.name] if e.in_header else file[e.name][()]) for e in ENTRIES}
            file.attrs["content_hash"] = np.array(content_hash(arrays).encode())
    return out.getvalue()


STRUCTURED: dict[str, Callable[[bytes, random.Random], bytes]] = {
    ".glb": _glb, ".json": _json, ".gltf": _json, ".npz": _npz, ".h5": _hdf5,
}  # fmt: skip
