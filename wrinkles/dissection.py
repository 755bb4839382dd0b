"""Sparse symmetric systems on a mesh solved for very many right-hand sides at once.

Nested dissection (George 1973, "Nested dissection of a regular finite element mesh"): small separators part the
unknowns in halves again and again, and the halves are eliminated before their separator. Each part is eliminated as one
dense block, so that all the work is in large matrix products; a general sparse solver is several times slower here,
because it goes from entry to entry.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix
from scipy.sparse.csgraph import breadth_first_order

__all__ = ["BlockSolver", "Dissection"]

_LEAF = 96  # unknowns that are not parted further: larger blocks cost more products, smaller ones more calls


@dataclass(frozen=True)
class _Block:
    """Unknowns that are eliminated together.

    Attributes:
        start, end: their places in the order of elimination.
        after: places of later unknowns that they are coupled to, ascending, int, shape (b,).
        children: blocks whose elimination adds to this one.
    """

    start: int
    end: int
    after: np.ndarray
    children: tuple[int, ...]


class Dissection:
    """Order of elimination for all matrices with one pattern.

    Args:
        pattern: sparse and symmetric, shape (n, n); what is stored counts.

    Attributes:
        order: unknown at each place, int, shape (n,).
        blocks: in the order of elimination, children before parents.
    """

    def __init__(self, pattern: csc_matrix) -> None:
        graph = csr_matrix((np.ones(pattern.nnz, np.int8), pattern.indices, pattern.indptr), pattern.shape)
        parts: list[tuple[np.ndarray, tuple[int, ...]]] = []
        _part(graph, np.arange(graph.shape[0]), parts)
        self.order = np.concatenate([unknowns for unknowns, _ in parts])
        place = np.argsort(self.order)
        self.blocks: list[_Block] = []
        start = 0
        for unknowns, children in parts:
            end = start + len(unknowns)
            reached = [place[graph[unknowns].indices], *(self.blocks[child].after for child in children)]
            after = np.unique(np.concatenate(reached))
            self.blocks.append(_Block(start, end, after[after >= end], children))
            start = end


class BlockSolver:
    """Solves A x = b for a complex symmetric matrix (not Hermitian) that needs no pivoting between blocks.

    That holds where the real part, perhaps after a turn in the complex plane, is positive definite.

    Args:
        matrix: shape (n, n), with the pattern of the dissection.
        dissection: of its pattern.
        dtype: of all solving, complex; what is solved with is worked out in double precision.
    """

    def __init__(self, matrix: csc_matrix, dissection: Dissection, dtype: type) -> None:
        self._order, self._blocks = dissection.order, dissection.blocks
        ordered = csr_matrix(matrix)[self._order][:, self._order]
        self._inverse: list[np.ndarray] = []
        self._onward: list[np.ndarray] = []
        rest: dict[int, np.ndarray] = {}  # what children leave for their parents
        for number, block in enumerate(self._blocks):
            size, own = block.end - block.start, np.arange(block.start, block.end)
            places = np.concatenate([own, block.after])
            front = np.zeros((len(places), len(places)), np.complex128)
            front[:size] = ordered[own][:, places].toarray()
            front[size:, :size] = front[:size, size:].T
            for child in block.children:
                at = np.searchsorted(places, self._blocks[child].after)
                front[np.ix_(at, at)] += rest.pop(child)
            inverse = np.linalg.inv(front[:size, :size])
            onward = front[size:, :size] @ inverse
            rest[number] = front[size:, size:] - onward @ front[:size, size:]
            self._inverse.append(inverse.astype(dtype))
            self._onward.append(onward.astype(dtype))

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solutions in the solver's type for right-hand sides, shape (n, k) both."""
        x = self._eliminated(right)
        for block, inverse, onward in zip(self._blocks[::-1], self._inverse[::-1], self._onward[::-1], strict=True):
            own = slice(block.start, block.end)
            x[own] = inverse @ x[own] - onward.T @ x[block.after]
        out = np.zeros_like(x)
        out[self._order] = x
        return out

    def quadratic(self, right: np.ndarray) -> np.ndarray:
        """b^T A^-1 b of each right-hand side b, shape (k,), at half the cost of solving."""
        x = self._eliminated(right)
        total = np.zeros(x.shape[1], np.complex128)
        for block, inverse in zip(self._blocks, self._inverse, strict=True):
            own = x[block.start : block.end]
            total += np.einsum("ik,ik->k", inverse @ own, own)
        return total

    def _eliminated(self, right: np.ndarray) -> np.ndarray:
        x = np.ascontiguousarray(right[self._order], self._inverse[0].dtype)
        for block, onward in zip(self._blocks, self._onward, strict=True):
            x[block.after] -= onward @ x[block.start : block.end]
        return x


def _part(graph: csr_matrix, unknowns: np.ndarray, parts: list[tuple[np.ndarray, tuple[int, ...]]]) -> int:
    """Append the parts of a set of unknowns, separators after what they separate; number of the last one."""
    children: tuple[int, ...] = ()
    if len(unknowns) > _LEAF:
        inside = graph[unknowns][:, unknowns]
        order = breadth_first_order(inside, _far_end(inside), directed=False, return_predecessors=False)
        if len(order) < len(unknowns):  # not connected: nothing separates what was reached from the rest
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
    """An unknown at an end of the graph: from there the separators are short."""
    last = 0
    for _ in range(2):
        last = int(breadth_first_order(graph, last, directed=False, return_predecessors=False)[-1])
    return last
