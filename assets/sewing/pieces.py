"""The pieces of a garment before they are sewn: triangles, stitches between them, and the surface that they become."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from assets.patterns.panel_mesh import CutPattern
from assets.weld import group_rows
from pbd.attachment import closest_points
from pbd.errors import InputError
from pbd.mesh import edges_of

__all__ = ["Joined", "Pieces", "carried_over", "join", "pieces_of", "without_closing_chords"]

Floats = NDArray[np.float64]
Integers = NDArray[np.int32]

_ROUNDS = 6  # of splitting edges; each one leaves fewer


@dataclass(frozen=True, eq=False)
class Pieces:
    """Flat triangles in pieces that share no vertex, and the pairs of vertices that are sewn together.

    Attributes:
        names: of the pieces.
        flat: vertices in the coordinates of their own piece [m], shape (n, 2).
        faces: int32, shape (m, 3), wound alike seen from the outer side of the garment.
        rest: rest shape of each face by corner [m], shape (m, 3, 2).
        layers: of cloth in each face [-], shape (m,).
        piece_of_vertex, piece_of_face: int32, shapes (n,) and (m,).
        stitches: int32, shape (s, 2).
    """

    names: tuple[str, ...]
    flat: Floats
    faces: Integers
    rest: Floats
    layers: Floats
    piece_of_vertex: Integers
    piece_of_face: Integers
    stitches: Integers


@dataclass(frozen=True, eq=False)
class Joined:
    """The surface that pieces become when every stitch is closed.

    Attributes:
        vertex: of each vertex of the pieces the one that it becomes, int32, shape (n,).
        faces: int32, shape (m, 3), in the order of the pieces.
        count: number of vertices k.
        seams: edges of the surface along seams, int32, shape (e, 2).
    """

    vertex: Integers
    faces: Integers
    count: int
    seams: Integers

    def means(self, vertices: Floats) -> Floats:
        """Mean positions of the vertices that become one: shape (k, 3), from shape (n, 3)."""
        counts = np.bincount(self.vertex, minlength=self.count)
        return np.stack([np.bincount(self.vertex, column, self.count) / counts for column in vertices.T], axis=1)


def pieces_of(cut: CutPattern) -> Pieces:
    """The panels of a cut pattern; see :func:`without_closing_chords`."""
    names = tuple(panel.name for panel in cut.pattern.panels)
    pieces = Pieces(
        names, cut.flat, cut.faces, cut.rest, cut.layers, cut.panel_of_vertex, cut.panel_of_face, cut.stitches
    )
    return without_closing_chords(pieces)


def without_closing_chords(pieces: Pieces) -> Pieces:
    """The pieces, of which inner edges that would come to lie on one another are split.

    Two triangles at a corner that is sewn to another one on both sides have all three sides in common with the other
    piece's, so that four faces would share an edge.
    """
    for _ in range(_ROUNDS):
        bad = _closing_chords(pieces)
        if not len(bad):
            break
        pieces = _split(pieces, bad)
    return pieces


def join(pieces: Pieces) -> Joined:
    """Close every stitch.

    Raises:
        InputError: an edge of more than two faces or faces wound against each other; the message names the pieces.
    """
    vertex = _sewn_to(pieces)
    faces = vertex[pieces.faces].astype(np.int32)
    sides = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    first, group = group_rows(sides)
    if len(first) < len(sides):
        bad = int(np.bincount(group).argmax())
        owners = np.unique(pieces.piece_of_face[np.flatnonzero(group == bad) // 3])
        names = " and ".join(pieces.names[owner] for owner in owners)
        expected = "two faces at an edge, both seen from their outer side"
        raise InputError("stitches that close to no surface", key=f"pieces {names}", expected=expected)
    rims = _rim_edges(pieces.faces)
    both, times = np.unique(np.sort(vertex[rims], axis=1), axis=0, return_counts=True)
    return Joined(vertex, faces, int(vertex.max()) + 1, both[times == 2].astype(np.int32))


def carried_over(coarse: Pieces, positions: Floats, fine: Pieces) -> Floats:
    """Where the vertices of a finer cut of the same pieces are, if the coarser one is somewhere.

    Args:
        coarse, fine: of one pattern.
        positions: of the coarse vertices [m], shape (n, 3).

    Returns:
        [m], shape (k, 3): linear in the faces; beyond the chord of a curve the nearest face goes on.
    """
    found = np.zeros((len(fine.flat), 3))
    solid = np.insert(coarse.flat, 2, 0.0, axis=1)
    for piece in range(len(fine.names)):
        own_vertices, faces = fine.piece_of_vertex == piece, coarse.faces[coarse.piece_of_face == piece]
        places = fine.flat[own_vertices]
        face, _ = closest_points(np.insert(places, 2, 0.0, axis=1), solid, faces)
        corners = coarse.flat[faces[face]]
        sides = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
        inner = np.linalg.solve(sides, (places - corners[:, 0])[:, :, None])[:, :, 0]
        weights = np.column_stack([1.0 - inner.sum(axis=1), inner])
        found[own_vertices] = np.einsum("pc,pci->pi", weights, positions[faces[face]])
    return found


def _sewn_to(pieces: Pieces) -> Integers:
    """Number of the vertex that each one becomes; they are numbered by first appearance."""
    count = len(pieces.flat)
    pairs = csr_matrix((np.ones(len(pieces.stitches)), tuple(pieces.stitches.T)), (count, count))
    _, group = connected_components(pairs, directed=False)
    _, vertex = group_rows(group[:, None])
    return vertex.astype(np.int32)


def _rim_edges(faces: Integers) -> Integers:
    edges, side_edge = edges_of(faces)
    return edges[np.bincount(side_edge.ravel(), minlength=len(edges)) == 1]


def _closing_chords(pieces: Pieces) -> Integers:
    """Edges inside a piece that lie on another edge, or shrink to a point, once the stitches are closed: (k, 2)."""
    vertex = _sewn_to(pieces)
    edges, side_edge = edges_of(pieces.faces)
    inner = np.bincount(side_edge.ravel(), minlength=len(edges)) == 2
    sewn = np.sort(vertex[edges], axis=1)
    first, group = group_rows(sewn)
    shared = (np.bincount(group)[group] > 1) | (sewn[:, 0] == sewn[:, 1])
    return edges[inner & shared]


def _split(pieces: Pieces, chords: Integers) -> Pieces:
    """The pieces with a new vertex in the middle of edges; of a face with several of them only one is split."""
    faces, rest = pieces.faces.tolist(), list(pieces.rest)
    owner, flat = list(range(len(faces))), [*pieces.flat]
    beside: dict[tuple[int, int], list[int]] = {}
    for number, face in enumerate(faces):
        for corner in range(3):
            low, high = sorted((face[corner], face[(corner + 1) % 3]))
            beside.setdefault((low, high), []).append(number)
    piece_of_vertex, touched = pieces.piece_of_vertex.tolist(), set()
    for low, high in chords.tolist():
        if touched & set(beside[low, high]):
            continue
        touched |= set(beside[low, high])
        middle = len(flat)
        flat.append((pieces.flat[low] + pieces.flat[high]) / 2.0)
        piece_of_vertex.append(piece_of_vertex[low])
        for number in beside[low, high]:
            face, corners = faces[number], rest[number]
            start = next(k for k in range(3) if {face[k], face[(k + 1) % 3]} == {low, high})
            a, b, c = (face[(start + k) % 3] for k in range(3))
            p, q, r = (corners[(start + k) % 3] for k in range(3))
            faces[number], rest[number] = [a, middle, c], np.array([p, (p + q) / 2.0, r])
            faces.append([middle, b, c])
            rest.append(np.array([(p + q) / 2.0, q, r]))
            owner.append(number)
    order = np.argsort(pieces.piece_of_face[owner], kind="stable")
    return replace(
        pieces,
        flat=np.array(flat),
        faces=np.array(faces, np.int32)[order],
        rest=np.array(rest)[order],
        layers=pieces.layers[owner][order],
        piece_of_vertex=np.array(piece_of_vertex, np.int32),
        piece_of_face=pieces.piece_of_face[owner][order],
    )
