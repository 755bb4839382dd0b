"""Wavefront OBJ files: positions, texture coordinates and polygons, with the line of each face.

trimesh reads OBJ files too, but splits vertices at texture seams and then loses either the seam's own texture
coordinates or the order of the vertices, and it drops faces that are too short without a word. A garment needs both
kinds of index and every face.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from assets.polygons import triangulate
from assets.text import read_text
from pbd.errors import InputError

__all__ = ["ObjMesh", "face_lines", "read_obj"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ObjMesh:
    """The surface that an OBJ file describes, with its polygons cut into triangles.

    Attributes:
        vertices: [m], shape (n, 3), float64.
        faces: shape (m, 3), int32.
        texture: texture coordinates of each face corner, shape (m, 3, 2), float64, NaN at faces without; None without
            any.
        lines: line of the file that each face stands on, shape (m,), int32.
    """

    vertices: Floats
    faces: NDArray[np.int32]
    texture: Floats | None
    lines: NDArray[np.int32]


def read_obj(path: Path) -> ObjMesh:
    """Read the surface of an OBJ file; materials, groups, normals and lines are left out.

    Raises:
        InputError: the file cannot be read, a line cannot be parsed, a vertex is not finite, or an index is out of
            range; the message names the line.
    """
    text = read_text(path, "an .obj file", strict=False)
    vertices: list[list[float]] = []
    texture: list[list[float]] = []
    polygons: list[tuple[int, list[int], list[int]]] = []
    for number, line in enumerate(text.replace("\\\n", "  ").splitlines(), start=1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        try:
            if words[0] == "v":
                vertices.append(_numbers(words, 3))
            elif words[0] == "vt":
                texture.append(_numbers(words, 2))
            elif words[0] == "f":
                corners = [_corner(word, len(vertices), len(texture)) for word in words[1:]]
                if len(corners) < 3:
                    raise ValueError("a face with fewer than three corners")
                polygons.append((number, [corner[0] for corner in corners], [corner[1] for corner in corners]))
        except ValueError as error:
            raise InputError(str(error), file=path, key=f"line {number}", received=line[:60]) from error
    positions, coordinates = np.array(vertices).reshape(-1, 3), np.array(texture).reshape(-1, 2)
    for line_number, corners, where in polygons:  # indices may point ahead
        for index, entries, kind in ((max(corners), vertices, "vertex"), (max(where), texture, "texture coordinate")):
            if index >= len(entries):
                raise InputError(
                    f"a face with a {kind} that does not exist",
                    file=path,
                    key=f"line {line_number}",
                    received=index + 1,
                    expected=f"1 to {len(entries)}",
                )
    return _triangles(positions, coordinates, polygons)


def face_lines(faces: NDArray[np.int32], texture: Floats | None = None) -> list[str]:
    """Lines of an OBJ file with texture coordinates, to nine digits, and faces.

    Args:
        faces: shape (m, 3).
        texture: texture coordinates of each face corner, shape (m, 3, 2), NaN at faces without; None without any.
    """
    if texture is None:
        return [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    has = np.isfinite(texture).all(axis=(1, 2))
    places, which = np.unique(texture[has].reshape(-1, 2), axis=0, return_inverse=True)
    index = np.zeros(faces.shape, np.int64)
    index[has] = which.reshape(-1, 3) + 1
    lines = [f"vt {u:.9g} {v:.9g}" for u, v in places.tolist()]
    for a, b, c, i, j, k in np.concatenate([faces + 1, index], axis=1).tolist():
        lines.append(f"f {a}/{i} {b}/{j} {c}/{k}" if i else f"f {a} {b} {c}")
    return lines


def _triangles(positions: Floats, coordinates: Floats, polygons: list[tuple[int, list[int], list[int]]]) -> ObjMesh:
    faces, where, lines = [], [], []
    for line, corners, texture in polygons:
        cuts = [(0, 1, 2)] if len(corners) == 3 else triangulate(positions[corners])
        for cut in cuts:
            faces.append([corners[k] for k in cut])
            where.append([texture[k] for k in cut])
            lines.append(line)
    indices = np.array(where, dtype=np.int64).reshape(-1, 3)
    has = (indices >= 0).all(axis=1)
    of_corners = np.full((len(indices), 3, 2), np.nan)
    of_corners[has] = coordinates[indices[has]]
    return ObjMesh(
        positions,
        np.array(faces, dtype=np.int32).reshape(-1, 3),
        of_corners if has.any() else None,
        np.array(lines, dtype=np.int32),
    )


def _numbers(words: list[str], least: int) -> list[float]:
    numbers = [float(word) for word in words[1 : 1 + least]]
    if len(numbers) < least:
        raise ValueError(f"fewer than {least} numbers")
    if not np.isfinite(numbers).all():
        raise ValueError("a number that is not finite")
    return numbers


def _corner(word: str, vertex_count: int, texture_count: int) -> tuple[int, int]:
    """Vertex and texture index of a face corner ``v/vt/vn``, counted from 0; -1 where there is no texture index."""
    parts = word.split("/")
    indices = []
    for text, count in zip(parts[:2], (vertex_count, texture_count), strict=False):
        if not text and indices:
            break  # v//vn
        index = int(text)
        index = index - 1 if index > 0 else index + count  # negative ones count back from the last so far
        if int(text) == 0 or index < 0:
            raise ValueError(f"index {text} is out of range")
        indices.append(index)
    return indices[0], indices[1] if len(indices) > 1 else -1
