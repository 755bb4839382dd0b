"""Writes a character or a garment of another unit or other axes once more, in metres, Y up."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from assets.io.gltf import read_document
from assets.io.obj import face_lines
from pbd.storage import replacing

__all__ = ["write_character", "write_garment"]

Floats = NDArray[np.float64]


def write_character(source: Path, target: Path, matrix: Floats) -> None:
    """Write a glTF file again with one more node above its scene, which scales and turns everything.

    Args:
        source: a .glb or .gltf file.
        target: the .glb file to write; pictures that the source keeps in other files stay there.
        matrix: from the file's coordinates to metres, Y up, shape (3, 3).

    Raises:
        InputError: the source cannot be read.
        OSError: the target cannot be written.
    """
    document = read_document(source)
    content = json.loads(json.dumps(document.json))
    nodes = content.setdefault("nodes", [])
    scenes = content.setdefault("scenes", [{}])
    scene = scenes[content.setdefault("scene", 0)]
    tops = scene.get("nodes", [node for node, parent in enumerate(document.parents) if parent < 0])
    placed = np.eye(4)
    placed[:3, :3] = matrix
    nodes.append({"name": "metres, Y up", "matrix": placed.T.ravel().tolist(), "children": tops})
    scene["nodes"] = [len(nodes) - 1]
    data = bytearray()
    begins = []
    for buffer in document.buffers:
        begins.append(len(data))
        data += buffer + bytes(-len(buffer) % 4)
    for view in content.get("bufferViews", []):
        view["byteOffset"] = view.get("byteOffset", 0) + begins[view["buffer"]]
        view["buffer"] = 0
    content["buffers"] = [{"byteLength": len(data)}]
    text = json.dumps(content, ensure_ascii=False).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    with replacing(target) as beside:
        beside.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


def write_garment(target: Path, vertices: Floats, faces: NDArray[np.int32], texture: Floats | None, note: str) -> None:
    """Write a garment as an .obj file.

    Args:
        target: the file to write.
        vertices: [m], shape (n, 3).
        faces: int, shape (m, 3).
        texture: as :func:`assets.io.obj.face_lines` takes it.
        note: for the file's first line.

    Raises:
        OSError: the file cannot be written.
    """
    lines = [f"# {note}", *(f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices), *face_lines(faces, texture)]
    with replacing(target) as beside:
        beside.write_text("\n".join(lines) + "\n", encoding="utf-8")
