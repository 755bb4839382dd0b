"""What every energy of cloth can do, and how elements become one energy."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.linalg import factorized, splu

__all__ = ["ElementEnergy", "Energy", "QuadraticElements", "Sum", "clamped"]

SETTLINGS = 50  # steps in which hidden points of elements that are not quadratic settle
LEAST_DECREASE = 1e-14  # of the energy, with which they are content [-]
HALVINGS = 30  # of a step at most
ROUNDING = 1e-13  # part of the energy that rounding may add


class Energy(Protocol):
    """An energy [J] of vertex positions [m], float64, shape (n, 3)."""

    def energy(self, x: np.ndarray) -> float:
        """[J]."""
        ...

    def gradient(self, x: np.ndarray) -> np.ndarray:
        """[N], shape (n, 3)."""
        ...

    def hessian(self, x: np.ndarray, positive: bool = False) -> csr_matrix:
        """[N/m], shape (3 n, 3 n), rows 3 v + c; ``positive`` asks for a positive semidefinite neighbour of it."""
        ...


class ElementEnergy(ABC):
    """A sum over elements of a few vertices each.

    Args:
        elements: vertices of each element, int, shape (m, k). A vertex may fill a place that an element does not need.
        vertex_count: n.
    """

    per_element: tuple[str, ...] = ()  # names of further arrays with a row for each element

    def __init__(self, elements: np.ndarray, vertex_count: int) -> None:
        self.elements, self.vertex_count = np.asarray(elements, np.int64), vertex_count

    @abstractmethod
    def values(self, corners: np.ndarray) -> np.ndarray:
        """Energy of each element [J], shape (m,), with its corners at ``corners`` [m], shape (m, k, 3)."""

    @abstractmethod
    def slopes(self, corners: np.ndarray) -> np.ndarray:
        """First derivatives [N], shape (m, k, 3)."""

    @abstractmethod
    def curvatures(self, corners: np.ndarray, positive: bool) -> np.ndarray:
        """Second derivatives [N/m], shape (m, k, 3, k, 3)."""

    def subset(self, rows: np.ndarray) -> ElementEnergy:
        """The same energy of some of its elements, int, shape (r,)."""
        part = copy.copy(self)
        for name in ("elements", *self.per_element):
            setattr(part, name, getattr(self, name)[rows])
        return part

    def energy(self, x: np.ndarray) -> float:
        return float(self.values(x[self.elements]).sum())

    def gradient(self, x: np.ndarray) -> np.ndarray:
        return self.gathered(self.slopes(x[self.elements]))

    def gathered(self, slopes: np.ndarray) -> np.ndarray:
        """Sum of what the elements say of each vertex: shape (m, k, 3) to (n, 3)."""
        flat = self.elements.ravel()
        columns = [np.bincount(flat, slopes[..., c].ravel(), self.vertex_count) for c in range(3)]
        return np.stack(columns, axis=1)

    def hessian(self, x: np.ndarray, positive: bool = False, *, first: int = 0) -> csr_matrix:
        """Of the points from ``first`` on, shape (3 (n - first), 3 (n - first)); see :class:`Energy`."""
        return self.assembled(self.curvatures(x[self.elements], positive), first)

    def assembled(self, blocks: np.ndarray, first: int = 0) -> csr_matrix:
        """Sparse matrix of element matrices, shape (m, k, 3, k, 3), of the points from ``first`` on."""
        rows = np.broadcast_to((3 * (self.elements - first)[:, :, None] + np.arange(3))[..., None, None], blocks.shape)
        columns = rows.transpose(0, 3, 4, 1, 2)
        size = 3 * (self.vertex_count - first)
        if first:
            used = (rows >= 0) & (columns >= 0)
            blocks, rows, columns = blocks[used], rows[used], columns[used]
        return coo_matrix((blocks.ravel(), (rows.ravel(), columns.ravel())), (size, size)).tocsr()


class QuadraticElements(ElementEnergy):
    """E = 1/2 sum over elements and axes of x^T M x: derivatives are linear and constant.

    Args:
        elements, vertex_count: as of :class:`ElementEnergy`.
        matrices: M of each element [N/m], symmetric and positive semidefinite, shape (m, k, k).
    """

    per_element = ("matrices",)

    def __init__(self, elements: np.ndarray, vertex_count: int, matrices: np.ndarray) -> None:
        super().__init__(elements, vertex_count)
        self.matrices = matrices
        self._constant: csr_matrix | None = None

    def values(self, corners: np.ndarray) -> np.ndarray:
        return 0.5 * np.einsum("mai,mai->m", corners, self.slopes(corners))

    def slopes(self, corners: np.ndarray) -> np.ndarray:
        # Counted from its first corner an element loses no digits far from the origin.
        return np.einsum("mab,mbi->mai", self.matrices, corners - corners[:, :1])

    def curvatures(self, corners: np.ndarray, positive: bool) -> np.ndarray:
        return np.einsum("mab,ij->maibj", self.matrices, np.eye(3))

    def hessian(self, x: np.ndarray, positive: bool = False, *, first: int = 0) -> csr_matrix:
        if first:
            return super().hessian(x, positive, first=first)
        if self._constant is None:
            self._constant = super().hessian(x, positive)
        return self._constant


class Sum:
    """Several energies of a cloth as one.

    Some parts may have points of their own beside the vertices, counted after them. Hidden points have no mass: they
    stand where they cost least. Only parts that are quadratic or convex in them may have any, and the first of those
    must be quadratic. Methods that are given n vertices add them by themselves; derivatives over all points want all
    points (:meth:`completed`).

    Args:
        parts: taken over; all count the hidden points from now on.
        vertex_count: n; None where no part has points of its own.
    """

    def __init__(self, parts: Sequence[ElementEnergy], vertex_count: int | None = None) -> None:
        self.parts = list(parts)
        self.point_count = max(part.vertex_count for part in self.parts)
        self.vertex_count = self.point_count if vertex_count is None else vertex_count
        for part in self.parts:
            part.vertex_count = self.point_count
        # Of the hidden points: solution by the quadratic parts, their matrix; how far others moved them [m].
        self._relax: Callable[[np.ndarray], np.ndarray] | None = None
        self._stiffness = csr_matrix((0, 0))
        self._offset: np.ndarray | None = None

    def completed(self, x: np.ndarray) -> np.ndarray:
        """Vertices [m], shape (n, 3), with hidden points where they cost least: shape (all, 3)."""
        if len(x) == self.point_count:
            return x
        hidden = slice(self.vertex_count, None)
        # Starting from points close by loses no digits far from the origin.
        points = np.concatenate([x, np.broadcast_to(x[0], (self.point_count - len(x), 3))])
        parts = [part for part in self.parts if isinstance(part, QuadraticElements)]
        relax = self._relax
        if relax is None:
            first, *more = [part.hessian(points, first=self.vertex_count) for part in parts]
            self._stiffness = sum(more, first)
            relax = self._relax = factorized(self._stiffness[::3, ::3].tocsc())
        force = np.sum([part.gradient(points)[hidden] for part in parts], axis=0)
        points[hidden] -= np.stack([relax(force[:, c].copy()) for c in range(3)], axis=1)
        others = [part for part in self.parts if not isinstance(part, QuadraticElements)]
        convex = [part for part in others if part.elements.max(initial=0) >= self.vertex_count]
        return self._settled(points, parts, convex) if convex else points

    def _settled(
        self, points: np.ndarray, quadratic: Sequence[QuadraticElements], convex: Sequence[ElementEnergy]
    ) -> np.ndarray:
        """Hidden points moved to where parts that are convex in them cost least (Newton's method, halved steps).

        They start where the quadratic parts alone have them, or as far from there as they were the last time.
        """
        parts, hidden = [*quadratic, *convex], slice(self.vertex_count, None)
        relaxed, value = points, sum(part.energy(points) for part in parts)
        if self._offset is not None:
            near = points.copy()
            near[hidden] += self._offset
            found = sum(part.energy(near) for part in parts)
            if found < value:
                points, value = near, found
        for _ in range(SETTLINGS):
            force = np.sum([part.gradient(points) for part in parts], axis=0)[hidden].ravel()
            if not np.isfinite(force).all():
                return points  # of a step that has failed, which the caller finds
            matrix = self._stiffness
            for part in convex:
                matrix = matrix + part.hessian(points, True, first=self.vertex_count)
            move = np.zeros_like(points)
            factors = splu(matrix.tocsc(), "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
            move[hidden] = -factors.solve(force).reshape(-1, 3)
            slope = float(force @ move[hidden].ravel())
            if -slope <= LEAST_DECREASE * abs(value):
                points = points + move
                break
            for _ in range(HALVINGS):
                found = sum(part.energy(points + move) for part in parts)
                if found <= value + ROUNDING * abs(value):
                    break
                move *= 0.5
            else:
                break  # downhill leads nowhere but into rounding
            points, value = points + move, found
        self._offset = (points - relaxed)[hidden]
        return points

    def energy(self, x: np.ndarray) -> float:
        points = self.completed(x)
        return sum(part.energy(points) for part in self.parts)

    def gradient(self, x: np.ndarray) -> np.ndarray:
        points = self.completed(x)
        return np.sum([part.gradient(points) for part in self.parts], axis=0)[: len(x)]

    def hessian(self, x: np.ndarray, positive: bool = False) -> csr_matrix:
        """Over all points, shape (3 all, 3 all)."""
        points = self.completed(x)
        first, *others = [part.hessian(points, positive) for part in self.parts]
        return sum(others, first)


def clamped(blocks: np.ndarray) -> np.ndarray:
    """Symmetric matrices with their negative eigenvalues set to zero, shape (m, k, k)."""
    values, vectors = np.linalg.eigh(blocks)
    return np.einsum("mik,mk,mjk->mij", vectors, np.maximum(values, 0.0), vectors)
