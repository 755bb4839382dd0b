"""Garment meshes: loaded, welded and checked, so that a solver can trust them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from assets.weld import check_unit, group_rows, weld
from pbd.errors import InputError
from pbd.mesh import edges_of

__all__ = [
    "BUILTIN_GARMENTS",
    "Garment",
    "StoredSurface",
    "boundary_loops",
    "check_faces",
    "checked_garment",
    "highest_loop",
]

# The clothes that :func:`assets.procedural.builtin.builtin_garment` makes.
BUILTIN_GARMENTS = ("circle_skirt", "flag", "shirt", "skirt", "tablecloth", "trousers", "tshirt")

Floats = NDArray[np.float64]
Faces = NDArray[np.int32]

# A triangle lower than this share of its longest side is a line at the precision of a file.
_MIN_HEIGHT_RATIO = 1e-6
# Median of edges in space over edges of the pattern: a texture atlas is mostly further off than a worn garment.
_EDGE_RATIOS = (0.67, 1.5)


@dataclass(frozen=True, eq=False)
class Garment:
    """A manifold, consistently wound triangle mesh.

    Attributes:
        name: name for messages.
        vertices: [m], shape (n, 3), float64, one vertex for each position.
        faces: shape (m, 3), int32.
        pattern: flat coordinates of each face corner [m], shape (m, 3, 2), float64; None if the rest shape is the mesh.
        source: the file or the function that it came from.
        layers: of cloth in each face [-], shape (m,), float64; None where there is one everywhere. A sewn garment has
            them, and its pattern is in the order (warp, weft).
        max_stretch: greatest length of the edges of each face over their rest length [-], shape (m,), float64; None
            where nothing limits it but the fabric. The waistband of a sewn garment hardly gives way.
        texture: texture coordinates of each face corner, v upwards, shape (m, 3, 2), float64, NaN at faces without;
            None without any. Those of a sewn garment are (weft, warp) in its pattern [m], seen from outside.
    """

    name: str
    vertices: Floats
    faces: Faces
    pattern: Floats | None
    source: str
    layers: Floats | None = None
    max_stretch: Floats | None = None
    texture: Floats | None = None


@dataclass(frozen=True, eq=False)
class StoredSurface:
    """Triangles as a file has them, with neither welds nor checks.

    Attributes:
        path: the file.
        vertices: shape (n, 3), float64.
        faces: shape (m, 3), int32.
        texture: texture coordinates of each face corner, v upwards, shape (m, 3, 2), float64, NaN at faces without;
            None without any.
        label: name of a face in messages.
    """

    path: Path
    vertices: Floats
    faces: Faces
    texture: Floats | None
    label: Callable[[int], str]


def checked_garment(surface: StoredSurface, *, pattern: bool = False) -> Garment:
    """Weld and check a surface in metres; arguments and errors as for :func:`load_garment`."""
    path, vertices, faces, label = surface.path, surface.vertices, surface.faces, surface.label
    if not (pattern and path.suffix.lower() == ".obj"):
        vertices, faces, _ = weld(vertices, faces)
    vertices, faces = _drop_unused(vertices, faces)
    check_unit(vertices, path)
    check_faces(vertices, faces, path, label)
    flipped = _winding(faces, path)
    faces[flipped] = faces[flipped][:, [0, 2, 1]]
    texture = None if surface.texture is None else surface.texture.copy()
    if texture is not None:
        texture[flipped] = texture[flipped][:, [0, 2, 1]]
    flat = _check_pattern(vertices, faces, texture, path, label) if pattern else None
    return Garment(path.stem, vertices, faces, flat, str(path), texture=texture)


def boundary_loops(faces: Faces) -> list[NDArray[np.int32]]:
    """Boundary loops as vertices in order, wound as the faces along them are; the loop of most vertices first.

    Where two parts of a surface touch at a vertex, each loop stays with its own part.

    Args:
        faces: of a manifold, consistently wound mesh, shape (m, 3).

    Raises:
        InputError: two faces run along an edge in the same direction.
    """
    sides = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    third = np.roll(faces, -2, axis=1).reshape(-1)
    opposite = {(a, b): c for (a, b), c in zip(sides.tolist(), third.tolist(), strict=True)}
    if len(opposite) < len(sides):
        unique, counts = np.unique(sides, axis=0, return_counts=True)
        a, b = unique[counts.argmax()]
        raise InputError("faces that run along an edge in the same direction", key=f"edge {a}-{b}")
    left = {side: None for side in opposite if side[::-1] not in opposite}  # a set that keeps its order
    loops = []
    while left:
        side = next(iter(left))
        loop = []
        while side in left:
            del left[side]
            loop.append(side[0])
            # Walk round the end vertex from face to face until a side has no neighbour.
            end, around = side[1], opposite[side]
            while (around, end) in opposite:
                around = opposite[around, end]
            side = (end, around)
        loops.append(np.array(loop, dtype=np.int32))
    return sorted(loops, key=len, reverse=True)


def highest_loop(vertices: Floats, faces: Faces) -> NDArray[np.int32]:
    """The boundary loop whose mean height is greatest: a waistband, a neckline.

    Args:
        vertices: [m], shape (n, 3).
        faces: shape (m, 3).

    Raises:
        InputError: the mesh is closed.
    """
    loops = boundary_loops(faces)
    if not loops:
        raise InputError("a mesh without openings has no highest one")
    return max(loops, key=lambda loop: vertices[loop, 1].mean())


def _drop_unused(vertices: Floats, faces: Faces) -> tuple[Floats, Faces]:
    used, corners = np.unique(faces, return_inverse=True)
    return vertices[used], corners.reshape(-1, 3).astype(np.int32)


def _heights(corners: Floats) -> tuple[Floats, Floats]:
    """Height over the longest side, and that side [m], of triangles, shape (m, 3, 2 or 3)."""
    sides = np.roll(corners, -1, axis=1) - corners
    longest = np.linalg.norm(sides, axis=2).max(axis=1)
    first, second = sides[:, 0], sides[:, 1]
    squares = (first**2).sum(axis=1) * (second**2).sum(axis=1) - (first * second).sum(axis=1) ** 2
    return np.sqrt(np.maximum(squares, 0.0)) / np.maximum(longest, 1e-300), longest


def check_faces(vertices: Floats, faces: Faces, path: Path, label: Callable[[int], str]) -> None:
    """Refuse faces without area, faces that appear twice, and edges of more than two faces."""
    a, b, c = faces.T
    repeated = (a == b) | (b == c) | (c == a)
    height, longest = _heights(vertices[faces])
    bad = np.flatnonzero(repeated | (height <= _MIN_HEIGHT_RATIO * longest))
    if bad.size:
        received, expected = faces[bad[0]].tolist(), "three corners that are not in a line"
        raise InputError("a face without area", file=path, key=label(bad[0]), received=received, expected=expected)
    first, group = group_rows(np.sort(faces, axis=1))
    bad = np.flatnonzero(first[group] != np.arange(len(faces)))
    if bad.size:
        other = label(int(first[group[bad[0]]]))
        received, expected = faces[bad[0]].tolist(), "each face once"
        raise InputError(
            f"the same face as {other}", file=path, key=label(bad[0]), received=received, expected=expected
        )
    edges, side_edge = edges_of(faces)
    counts = np.bincount(side_edge.ravel(), minlength=len(edges))
    if counts.max() > 2:
        edge = int(counts.argmax())
        some = np.flatnonzero((side_edge == edge).any(axis=1))[:3]
        raise InputError(
            f"an edge of {counts[edge]} faces: {', '.join(label(face) for face in some)}",
            file=path,
            key=f"edge {edges[edge, 0]}-{edges[edge, 1]}",
            expected="at most 2",
        )


def _winding(faces: Faces, path: Path) -> NDArray[np.bool_]:
    """Faces to turn so that all neighbours agree, shape (m,): in each piece the fewer.

    Raises:
        InputError: a piece that has only one side, like a Moebius strip.
    """
    sides = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    _, side_edge = edges_of(faces)
    order = np.argsort(side_edge.ravel(), kind="stable")
    shared = np.flatnonzero(np.diff(side_edge.ravel()[order]) == 0)
    one, two = order[shared], order[shared + 1]
    against = sides[one, 0] == sides[two, 0]  # neighbours that agree run along their edge in opposite directions
    flipped = np.zeros(len(faces), dtype=bool)
    if not against.any():
        return flipped
    neighbours: list[list[tuple[int, bool]]] = [[] for _ in range(len(faces))]
    for first, second, turned in zip((one // 3).tolist(), (two // 3).tolist(), against.tolist(), strict=True):
        neighbours[first].append((second, turned))
        neighbours[second].append((first, turned))
    seen = np.zeros(len(faces), dtype=bool)
    for root in range(len(faces)):
        if seen[root]:
            continue
        seen[root], piece, waiting = True, [root], [root]
        while waiting:
            face = waiting.pop()
            for other, turned in neighbours[face]:
                wanted = bool(flipped[face]) != turned
                if not seen[other]:
                    seen[other], flipped[other] = True, wanted
                    piece.append(other)
                    waiting.append(other)
                elif flipped[other] != wanted:
                    edge = sorted(set(faces[face].tolist()) & set(faces[other].tolist()))
                    raise InputError("a surface with one side only", file=path, key=f"edge {edge[0]}-{edge[1]}")
        if flipped[piece].sum() * 2 > len(piece):
            flipped[piece] = ~flipped[piece]
    return flipped


def _check_pattern(
    vertices: Floats,
    faces: Faces,
    flat: Floats | None,
    path: Path,
    label: Callable[[int], str],
) -> Floats:
    """Texture coordinates as a pattern; refused where they cannot be one."""
    if flat is None or np.isnan(flat).any():
        raise InputError("no texture coordinates to take a pattern from", file=path, key="pattern")
    height, longest = _heights(flat)
    bad = np.flatnonzero(height <= _MIN_HEIGHT_RATIO * longest)
    if bad.size:
        raise InputError(
            "a face without area in the pattern", file=path, key=label(bad[0]), received=flat[bad[0]].tolist()
        )
    lengths = [np.linalg.norm(np.roll(x, -1, axis=1) - x, axis=2) for x in (vertices[faces], flat)]
    ratio = float(np.median(lengths[0] / lengths[1]))
    if not _EDGE_RATIOS[0] <= ratio <= _EDGE_RATIOS[1]:
        raise InputError(
            "texture coordinates that are no flat pattern in metres",
            file=path,
            key="pattern",
            received=f"edges {ratio:.3g} times as long in space",
            expected=f"{_EDGE_RATIOS[0]} to {_EDGE_RATIOS[1]}",
        )
    return flat
