"""Small glTF files for tests, written with nothing but the format itself."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

__all__ = ["Glb", "bar_glb", "bend_glb", "turn_z"]

_COMPONENTS = {"int8": 5120, "uint8": 5121, "int16": 5122, "uint16": 5123, "uint32": 5125, "float32": 5126}
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class Glb:
    """A file in the making: ``json`` is open to changes until :meth:`write`."""

    def __init__(self) -> None:
        self.json: dict[str, Any] = {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": [], "buffers": [{}]}
        self.data = bytearray()

    def accessor(self, values: Any, dtype: str = "float32", **extra: Any) -> int:
        array = np.asarray(values, dtype=dtype)
        array = array.reshape(len(array), -1)
        self.json["bufferViews"].append({"buffer": 0, "byteOffset": len(self.data), "byteLength": array.nbytes})
        self.json["accessors"].append(
            {
                "bufferView": len(self.json["bufferViews"]) - 1,
                "componentType": _COMPONENTS[dtype],
                "count": len(array),
                "type": _TYPES[array.shape[1]],
                **extra,
            }
        )
        self.data += array.tobytes()
        self.data += bytes(-len(self.data) % 4)
        return len(self.json["accessors"]) - 1

    def clip(self, name: str, *channels: tuple[int, str, Any, Any, str]) -> None:
        """An animation of channels (node, path, times, values, interpolation)."""
        animation: dict[str, Any] = {"name": name, "samplers": [], "channels": []}
        for node, path, times, values, interpolation in channels:
            sampler = {"input": self.accessor(times), "output": self.accessor(values), "interpolation": interpolation}
            animation["channels"].append(
                {"sampler": len(animation["samplers"]), "target": {"node": node, "path": path}}
            )
            animation["samplers"].append(sampler)
        self.json.setdefault("animations", []).append(animation)

    def bytes(self) -> bytes:
        self.json["buffers"][0]["byteLength"] = len(self.data)
        text = json.dumps(self.json).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        chunks += struct.pack("<I4s", len(self.data), b"BIN\0") + bytes(self.data)
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

    def write(self, path: Path) -> Path:
        path.write_bytes(self.bytes())
        return path


def bar_glb(scale: float = 1.0, texture: np.ndarray | None = None) -> Glb:
    """A flat bar of 2 x 5 vertices, 2 m high, on two joints: "root" at the floor and "tip" 1 m above it.

    Vertices below 1 m hang on the root, those above on the tip, the middle row on both by halves. Node 0 is the root,
    node 1 the tip, node 2 shows the mesh; clip "bend" turns the tip by 90 degrees about Z within 1 s. ``scale`` shrinks
    everything, as a file in other units would. With ``texture``, coordinates of each face corner, v upwards,
    shape (8, 3, 2), each corner is a vertex of its own.
    """
    glb = Glb()
    heights = np.repeat(np.linspace(0.0, 2.0, 5), 2)
    vertices = np.stack([np.tile([-0.25, 0.25], 5), heights, np.zeros(10)], axis=1) * scale
    faces = [[2 * k + a, 2 * k + b, 2 * k + c] for k in range(4) for a, b, c in ((0, 1, 3), (0, 3, 2))]
    share = np.where(heights < 1.0, 1.0, np.where(heights > 1.0, 0.0, 0.5))
    weights = np.stack([share, 1.0 - share, np.zeros(10), np.zeros(10)], axis=1)
    joints = np.tile([0, 1, 0, 0], (10, 1))
    inverse = np.tile(np.eye(4), (2, 1, 1))
    inverse[1, 1, 3] = -scale
    if texture is not None:
        vertices, joints, weights = (values[np.ravel(faces)] for values in (vertices, joints, weights))
        faces = np.arange(24)
    attributes = {
        "POSITION": glb.accessor(vertices),
        "JOINTS_0": glb.accessor(joints, "uint8"),
        "WEIGHTS_0": glb.accessor(weights),
    }
    if texture is not None:
        attributes["TEXCOORD_0"] = glb.accessor(texture.reshape(-1, 2) * [1.0, -1.0] + [0.0, 1.0])
    primitive = {"attributes": attributes, "indices": glb.accessor(np.ravel(faces), "uint16")}
    glb.json |= {
        "scene": 0,
        "scenes": [{"nodes": [0, 2]}],
        "nodes": [
            {"name": "root", "children": [1]},
            {"name": "tip", "translation": [0.0, scale, 0.0]},
            {"name": "bar", "mesh": 0, "skin": 0},
        ],
        "meshes": [{"name": "bar", "primitives": [primitive]}],
        "skins": [{"joints": [0, 1], "inverseBindMatrices": glb.accessor(inverse.swapaxes(1, 2))}],
    }
    half = np.sqrt(0.5)
    glb.clip("bend", (1, "rotation", [0.0, 0.5, 1.0], [[0, 0, 0, 1], turn_z(45), [0, 0, half, half]], "LINEAR"))
    return glb


def bend_glb(scale: float = 1.0) -> Glb:
    """The nodes of :func:`bar_glb` and its clip, without mesh and skin."""
    glb = bar_glb(scale)
    del glb.json["meshes"], glb.json["skins"], glb.json["nodes"][2]["mesh"], glb.json["nodes"][2]["skin"]
    return glb


def turn_z(degrees: float) -> list[float]:
    """Quaternion of a turn about Z."""
    half = np.radians(degrees) / 2
    return [0.0, 0.0, float(np.sin(half)), float(np.cos(half))]
