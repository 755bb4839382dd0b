"""Seams of a garment that comes in panels: read from a file, and closed to one surface."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from assets.garment import boundary_loops
from assets.polygons import triangulate
from assets.text import read_words
from pbd.errors import InputError
from pbd.mesh import edges_of

__all__ = ["Seams", "Sewn", "load_seams", "sew", "without_pleats"]

Floats = NDArray[np.float64]
Faces = NDArray[np.int32]

_AT_END = 0.02  # share of an edge from whose ends a stitch counts as at that end: some 0.1 mm
_MAX_SEAM_HOLE = 5  # a hole of so few edges is left by a seam, not by the garment
_MAX_ROUNDS = 10  # of shrinking pleats; a surface that still has some then has too many
_MAX_PASSED_EDGES = 4.0  # neighbours along a seam lie within this many edges of the other side


@dataclass(frozen=True, eq=False)
class Seams:
    """Stitches, each of a vertex to a point of an edge: x_v = (1 - w) x_a + w x_b.

    Attributes:
        vertices: (v, a, b) of each stitch, int32, shape (s, 3).
        weights: w, float64, shape (s,).
    """

    vertices: NDArray[np.int32]
    weights: Floats


@dataclass(frozen=True, eq=False)
class Sewn:
    """Panels closed to one surface.

    Attributes:
        faces: int32, shape (k, 3).
        one: for each vertex of the panels, the vertex that replaces it in ``faces``, shape (n,).
        panel_face: for each face, the face of the panels that it was, or was a part of, shape (k,).
        flat: corners of each face in the pattern [m], shape (k, 3, 2).
    """

    faces: Faces
    one: NDArray[np.int64]
    panel_face: NDArray[np.int64]
    flat: Floats


def load_seams(path: Path, vertex_count: int) -> Seams:
    """Read stitches from a file with the columns ``v,a,b,w`` and a line of these titles; vertices count from 0.

    Args:
        path: the file.
        vertex_count: number of vertices of the mesh.

    Raises:
        InputError: the file cannot be read, has other titles, or a row that is no stitch; the message names row and
            column.
    """
    rows, weights = [], []
    for number, words in read_words(path, ("v", "a", "b", "w")):
        if len(words) != 4:
            received = ",".join(words)[:60]
            raise InputError("no stitch", file=path, key=f"line {number}", received=received, expected="v,a,b,w")
        for column, word in zip("vab", words, strict=False):
            if not word.strip().isdigit() or int(word) >= vertex_count:
                expected = f"a vertex, 0 to {vertex_count - 1}"
                key = f"line {number}, column {column}"
                raise InputError("no such vertex", file=path, key=key, received=word, expected=expected)
        try:
            weight = float(words[3])
        except ValueError:
            weight = np.nan
        if not 0.0 <= weight <= 1.0:
            key = f"line {number}, column w"
            raise InputError("bad weight", file=path, key=key, received=words[3], expected="0 to 1")
        row = [int(word) for word in words[:3]]
        if len(set(row)) < 3:
            raise InputError("not three vertices", file=path, key=f"line {number}", received=row, expected="v, a, b")
        rows.append(row)
        weights.append(weight)
    if not rows:
        raise InputError("no stitches", file=path, expected="a line for each stitch")
    return Seams(np.array(rows, np.int32), np.array(weights))


def sew(faces: Faces, flat: Floats, seams: Seams) -> Sewn:
    """Close seams: faces of one surface over the same vertices. Where pleats are sewn down, edges have more than two.

    Vertices that are stitched to each other are one from now on. Where a vertex is stitched to the inside of an edge,
    the face at that edge is cut there, and so are the edges that run past the vertices of the other side.

    Args:
        faces: of the panels, shape (m, 3).
        flat: place of each vertex in the pattern [m], shape (n, 2).
        seams: the stitches.
    """
    at_end = np.minimum(seams.weights, 1.0 - seams.weights) < _AT_END
    v, a, b = seams.vertices.T.astype(np.int64)
    one = _joined(len(flat), np.stack([v, np.where(seams.weights < 0.5, a, b)], axis=1)[at_end])
    cuts = _cuts(faces, seams, one)
    faces = np.asarray(faces)
    start, end = faces, np.roll(faces, -1, axis=1)
    sides = np.minimum(start, end).astype(np.int64) * len(flat) + np.maximum(start, end)
    cut_sides = np.array([low * len(flat) + high for low, high in cuts], np.int64)
    touched = (np.isin(sides, cut_sides) | (one[start] == one[end])).any(axis=1)
    owner = np.flatnonzero(~touched).tolist()
    sewn, corners = one[faces[~touched]].tolist(), list(flat[faces[~touched]])
    for number in np.flatnonzero(touched).tolist():
        ring, places = _cut_face(faces[number].tolist(), flat, one, cuts)
        solid = np.insert(places, 2, 0.0, axis=1)
        cut = [(0, 1, 2)][: len(ring) - 2] if len(ring) <= 3 else triangulate(solid)
        sewn += [[ring[corner] for corner in triangle] for triangle in cut]
        corners += [places[list(triangle)] for triangle in cut]
        owner += [number] * len(cut)
    order = np.argsort(owner, kind="stable")
    return Sewn(np.array(sewn, np.int32)[order], one, np.array(owner)[order], np.array(corners)[order])


def _cut_face(
    face: list[int], flat: Floats, one: NDArray[np.int64], cuts: dict[tuple[int, int], dict[int, float]]
) -> tuple[list[int], Floats]:
    """Vertices round a face with those that its sides are cut at, and their places in the pattern."""
    ring, places = [], []
    for start, end in zip(face, face[1:] + face[:1], strict=True):
        if one[start] == one[end]:  # a face whose side is sewn together is gone
            continue
        ring.append(int(one[start]))
        places.append(flat[start])
        low, high = min(start, end), max(start, end)
        along = sorted(cuts.get((low, high), {}).items(), key=lambda item: item[1], reverse=start > end)
        for vertex, share in along:
            ring.append(vertex)
            places.append((1.0 - share) * flat[low] + share * flat[high])
    return ring, np.array(places)


def without_pleats(faces: Faces) -> tuple[Faces, NDArray[np.int64]]:
    """A manifold surface from a sewn one: edges of more than two faces and the small holes between them shrink.

    Where cloth is laid in folds and sewn down, several of its edges lie on one. Such an edge shrinks to a point: the
    fold disappears, and the parts that it joined stay joined.

    Args:
        faces: of :func:`sew`, shape (k, 3).

    Returns:
        the faces, shape (j, 3), and for each old vertex the one that replaces it in them, shape (n,), where n is the
        highest vertex + 1.

    Raises:
        InputError: seams that close to no surface.
    """
    stands = np.arange(faces.max() + 1)
    for _ in range(_MAX_ROUNDS):
        edges, side_edge = edges_of(faces)
        short = edges[np.bincount(side_edge.ravel()) > 2].astype(np.int64)
        if not len(short):
            holes = [loop for loop in boundary_loops(faces) if len(loop) <= _MAX_SEAM_HOLE]
            if not holes:
                return faces, stands
            short = np.array([(loop[0], vertex) for loop in holes for vertex in loop[1:]], np.int64)
        joined = _joined(len(stands), short)
        faces = joined[faces].astype(np.int32)
        faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
        _, group, copies = np.unique(np.sort(faces, axis=1), axis=0, return_inverse=True, return_counts=True)
        faces = faces[copies[group.ravel()] == 1]  # both sides of what is folded flat
        stands = joined[stands]
    edge = f"edge {short[0].tolist()}"
    raise InputError("seams that close to no surface", key="seams", received=edge, expected="two faces an edge")


def _joined(count: int, pairs: NDArray[np.int64]) -> NDArray[np.int64]:
    """The lowest vertex of those that pairs, shape (p, 2), join, of each vertex: shape (n,)."""
    ones = np.ones(len(pairs))
    _, group = connected_components(csr_matrix((ones, tuple(pairs.T)), (count, count)), directed=False)
    first = np.full(count, count)
    np.minimum.at(first, group, np.arange(count))
    return first[group]


def _cuts(faces: Faces, seams: Seams, one: NDArray[np.int64]) -> dict[tuple[int, int], dict[int, float]]:
    """Vertices inside the edges (a, b), a < b, of the panels' borders: those stitched there and those passed by."""
    cuts: dict[tuple[int, int], dict[int, float]] = defaultdict(dict)
    loops = boundary_loops(faces)
    stands: dict[int, list[tuple[int, int]]] = defaultdict(list)  # of a vertex: its loops and its number in them
    for number, loop in enumerate(loops):
        for index, vertex in enumerate(loop.tolist()):
            stands[vertex].append((number, index))
    groups: dict[int, list[int]] = defaultdict(list)
    for vertex in stands:
        groups[int(one[vertex])].append(vertex)
    # Where a border vertex comes to lie on the borders of other panels, or on another stretch of its own.
    places: dict[int, list[tuple[int, float]]] = defaultdict(list)
    for vertex in stands:
        for other in groups[int(one[vertex])]:
            if other != vertex:
                places[vertex] += [(number, float(index)) for number, index in stands[other]]
    for (v, a, b), weight in zip(seams.vertices.tolist(), seams.weights.tolist(), strict=True):
        if min(weight, 1.0 - weight) < _AT_END:
            continue
        low, high, share = (a, b, weight) if a < b else (b, a, 1.0 - weight)
        if int(one[v]) not in (int(one[a]), int(one[b])):
            cuts[low, high].setdefault(int(one[v]), share)
        for number, index in stands[a]:
            length = len(loops[number])
            if loops[number][(index + 1) % length] == b:
                places[v].append((number, index + weight))
            elif loops[number][index - 1] == b:
                places[v].append((number, index - weight))
    for loop in loops:
        for start, end in zip(loop.tolist(), np.roll(loop, -1).tolist(), strict=True):
            for vertex, share in _passed(places[start], places[end], loops):
                low, high, along = (start, end, share) if start < end else (end, start, 1.0 - share)
                if int(one[vertex]) not in (int(one[start]), int(one[end])):
                    cuts[low, high].setdefault(int(one[vertex]), along)
    return cuts


def _passed(
    starts: list[tuple[int, float]], ends: list[tuple[int, float]], loops: list[NDArray[np.int32]]
) -> list[tuple[int, float]]:
    """Vertices of the other side between two neighbours' places on it, and at which share of the way."""
    best, passed = _MAX_PASSED_EDGES, []
    for number, first in starts:
        length = len(loops[number])
        for other, last in ends:
            way = (last - first + length / 2.0) % length - length / 2.0
            if other == number and 1e-6 < abs(way) < best:
                best = abs(way)
                inner = np.arange(np.floor(min(first, first + way)) + 1.0, np.ceil(max(first, first + way)))
                passed = [(int(loops[number][int(i) % length]), float((i - first) / way)) for i in inner]
    return passed
