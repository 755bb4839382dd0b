"""A direct solver for sparse symmetric systems on a mesh with very many right-hand sides.

It uses nested dissection (George 1973, "Nested dissection of a regular finite element mesh"): a small separator parts
the unknowns into two halves, each half is parted again, and the halves are eliminated before their separator. Each part
is eliminated as one dense block, so that all work is in large matrix products. A general sparse solver is several times
slower here, because it works on single entries.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix
from scipy.sparse.csgraph import breadth_first_order

__all__ = ["BlockSolver", "Dissection"]

_MAX_LEAF_SIZE = 96  # unknowns of a part that is not split: larger blocks cost more products, smaller ones more calls


@dataclass(frozen=True)
class _Block:
    """Unknowns that are eliminated together.

    Attributes:
        start, end: their range in the order of elimination.
        after: positions in that order of the later unknowns that they are coupled to, ascending, int, shape (b,).
        children: blocks whose elimination changes this one.
    """

    start: int
    end: int
    after: np.ndarray
    children: tuple[int, ...]


class Dissection:
    """Order of elimination for all matrices with one sparsity pattern.

    Args:
        pattern: sparse and symmetric, shape (n, n); stored entries count, zeros too.

    Attributes:
        order: unknown at each position of the order, int, shape (n,).
        blocks: in the order of elimination, children before parents.
    """

    def __init__(self, pattern: csc_matrix) -> None:
        graph = csr_matrix((np.ones(pattern.nnz, np.int8), pattern.indices, pattern.indptr), pattern.shape)
        parts: list[tuple[np.ndarray, tuple[int, ...]]] = []
        _part(graph, np.arange(graph.shape[0]), parts)
        self.order = np.concatenate([unknowns for unknowns, _ in parts])
        position = np.argsort(self.order)
        self.blocks: list[_Block] = []
        start = 0
        for unknowns, children in parts:
            end = start + len(unknowns)
            coupled = [position[graph[unknowns].indices], *(self.blocks[child].after for child in children)]
            after = np.unique(np.concatenate(coupled))
            self.blocks.append(_Block(start, end, after[after >= end], children))
            start = end


class BlockSolver:
    """Solves A x = b for a complex symmetric (not Hermitian) matrix A, without pivoting between blocks.

    No pivoting is needed if the real part of A, or of A times a complex number, is positive definite. The multifrontal
    method (Duff and Reid 1983, "The multifrontal solution of indefinite sparse symmetric linear equations") eliminates
    each block in a dense frontal matrix and passes the remaining Schur complement to the parent block.

    Args:
        matrix: A, shape (n, n), with the pattern of the dissection.
        dissection: of its pattern.
        dtype: complex type of the solutions; the factors are computed in double precision and then converted.
    """

    def __init__(self, matrix: csc_matrix, dissection: Dissection, dtype: type) -> None:
        self._order, self._blocks = dissection.order, dissection.blocks
        ordered = csr_matrix(matrix)[self._order][:, self._order]
        self._inverse: list[np.ndarray] = []
        self._onward: list[np.ndarray] = []
        schur_complements: dict[int, np.ndarray] = {}  # of eliminated blocks whose parents are not eliminated yet
        for number, block in enumerate(self._blocks):
            size, own = block.end - block.start, np.arange(block.start, block.end)
            indices = np.concatenate([own, block.after])
            frontal_matrix = np.zeros((len(indices), len(indices)), np.complex128)
            frontal_matrix[:size] = ordered[own][:, indices].toarray()
            frontal_matrix[size:, :size] = frontal_matrix[:size, size:].T
            for child in block.children:
                at = np.searchsorted(indices, self._blocks[child].after)
                frontal_matrix[np.ix_(at, at)] += schur_complements.pop(child)
            inverse = np.linalg.inv(frontal_matrix[:size, :size])
            onward = frontal_matrix[size:, :size] @ inverse
            schur_complements[number] = frontal_matrix[size:, size:] - onward @ frontal_matrix[:size, size:]
            self._inverse.append(inverse.astype(dtype))
            self._onward.append(onward.astype(dtype))

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solutions x of A x = b in the solver's type, shape (n, k).

        Args:
            right: right-hand sides b, shape (n, k).
        """
        x = self._eliminated(right)
        for block, inverse, onward in zip(self._blocks[::-1], self._inverse[::-1], self._onward[::-1], strict=True):
            own = slice(block.start, block.end)
            x[own] = inverse @ x[own] - onward.T @ x[block.after]
        out = np.zeros_like(x)
        out[self._order] = x
        return out

    def quadratic(self, right: np.ndarray) -> np.ndarray:
        """b^T A^-1 b of each right-hand side b, complex128, shape (k,), at half the cost of solving.

        Args:
            right: right-hand sides b, shape (n, k).
        """
        x = self._eliminated(right)
        total = np.zeros(x.shape[1], np.complex128)
        for block, inverse in zip(self._blocks, self._inverse, strict=True):
            own = x[block.start : block.end]
            total += np.einsum("ik,ik->k", inverse @ own, own)
        return total

    def _eliminated(self, right: np.ndarray) -> np.ndarray:
        """Right-hand sides after forward elimination, in the order of elimination, shape (n, k)."""
        x = np.ascontiguousarray(right[self._order], self._inverse[0].dtype)
        for block, onward in zip(self._blocks, self._onward, strict=True):
            x[block.after] -= onward @ x[block.start : block.end]
        return x


def _part(graph: csr_matrix, unknowns: np.ndarray, parts: list[tuple[np.ndarray, tuple[int, ...]]]) -> int:
    """Split a set of unknowns and append its parts, each separator after the halves that it separates.

    Args:
        graph: pattern of the whole matrix, shape (n, n).
        unknowns: the set, int, shape (k,).
        parts: receives (unknowns, numbers of the child parts).

    Returns:
        the number of the last part, which is the parent of the others.
    """
    children: tuple[int, ...] = ()
    if len(unknowns) > _MAX_LEAF_SIZE:
        inside = graph[unknowns][:, unknowns]
        order = breadth_first_order(inside, _far_end(inside), directed=False, return_predecessors=False)
        if len(order) < len(unknowns):  # the set is not connected: its component needs no separator
            first, separator = order, np.zeros(0, int)
        else:
            first = order[: len(order) // 2]
            other = np.ones(len(unknowns), bool)
            other[first] = False
            touched = inside @ other.astype(np.int32) > 0
            separator, first = first[touched[first]], first[~touched[first]]
        left = np.ones(len(unknowns), bool)
        left[first] = left[separator] = False
        halves = [half for half in (first, np.flatnonzero(left)) if len(half)]
        children = tuple(_part(graph, unknowns[half], parts) for half in halves)
        unknowns = unknowns[separator]
    parts.append((unknowns, children))
    return len(parts) - 1


def _far_end(graph: csr_matrix) -> int:
    """An unknown at an end of the graph: levels of a search that starts there are small, and so are separators."""
    last = 0
    for _ in range(2):
        last = int(breadth_first_order(graph, last, directed=False, return_predecessors=False)[-1])
    return last
