"""Two modern rivals that minimise the energy of implicit Euler: vertex block descent and projective dynamics."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix, diags

from pbd.model import Model
from pbd.models.elements import ElementEnergy, QuadraticElements, Sum
from pbd.models.linear import Cholesky, FreeOrder, NotPositiveDefinite
from pbd.models.membrane import deformation, deformation_rows, rotations
from pbd.models.newton import StepError
from pbd.models.obstacles import Obstacles
from pbd.models.stepping import ClothSolver, Options

__all__ = ["ProjectiveDynamics", "VertexBlockDescent"]


class VertexBlockDescent(ClothSolver):
    """Chen et al. 2024: one vertex after the other takes the Newton step of its own 3 by 3 block, colour by colour."""

    default_iterations = 20

    def __init__(self, model: Model, energy: Sum, options: Options, name: str) -> None:
        super().__init__(model, energy, options, name)
        self.iterations = options.iterations or self.default_iterations
        # Of each colour: its vertices, and of each energy the elements there with corner and vertex that they touch.
        self._colors: list[tuple[np.ndarray, list[tuple[ElementEnergy, np.ndarray, np.ndarray]]]] = []
        colors = vertex_colors(energy, self.free)
        for color in range(int(colors.max(initial=-1)) + 1):
            vertices = np.flatnonzero(colors == color)
            place = np.full(model.vertex_count, -1)
            place[vertices] = np.arange(len(vertices))
            touching = []
            for part in energy.parts:
                local = place[part.elements]
                rows = np.flatnonzero((local >= 0).any(axis=1))
                corner = np.argmax(local[rows] >= 0, axis=1)
                touching.append((part.subset(rows), corner, local[rows, corner]))
            self._colors.append((vertices, touching))

    def advance(
        self, x: np.ndarray, v: np.ndarray, h: float, target: np.ndarray, obstacles: Obstacles, wind: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        aim = x + h * v + h**2 * self.external(x, v, h, wind)
        p = aim.copy()
        p[self.model.held] = target
        for _ in range(self.iterations):
            for vertices, touching in self._colors:
                inertia = self.mass[vertices] / h**2
                force = inertia * (aim - p)[vertices]
                block = inertia[:, :, None] * np.eye(3)
                for part, corner, vertex in touching:
                    corners, rows = p[part.elements], np.arange(len(corner))
                    np.add.at(force, vertex, -part.slopes(corners)[rows, corner])
                    np.add.at(block, vertex, part.curvatures(corners, True)[rows, corner, :, corner])
                p[vertices] += np.linalg.solve(block, force[:, :, None])[:, :, 0]
            p += obstacles.correction(p, x, self.free, self.model.fabric.friction, h)
        return p, (p - x) / h


def vertex_colors(energy: Sum, free: np.ndarray) -> np.ndarray:
    """Colours of the free vertices such that no element has two of one colour; -1 elsewhere. Shape (n,)."""
    count = energy.parts[0].vertex_count
    pairs = [
        np.stack(np.broadcast_arrays(part.elements[:, :, None], part.elements[:, None]), axis=-1).reshape(-1, 2)
        for part in energy.parts
    ]
    row, column = np.concatenate(pairs).T
    graph = coo_matrix((np.ones(len(row)), (row, column)), (count, count)).tocsr()
    colors = np.full(count, -1)
    for vertex in free:
        taken = set(colors[graph.indices[graph.indptr[vertex] : graph.indptr[vertex + 1]]].tolist())
        colors[vertex] = next(color for color in range(len(taken) + 1) if color not in taken)
    return colors


class ProjectiveDynamics(ClothSolver):
    """Bouaziz et al. 2014: each triangle is turned to its rest shape, then one linear system takes all together.

    The matrix is constant and factorised once for a step length. The triangles' energy E h A/2 |F - R|^2 is linear
    elasticity with Poisson's ratio 0 and the shear modulus E/2: warp and weft cannot differ. Bending must be quadratic.

    Args:
        model, energy, options, name: see :class:`pbd.models.ClothSolver`; of the energy only quadratic parts count.
    """

    substep = 1.0 / 120.0
    default_iterations = 20

    def __init__(self, model: Model, energy: Sum, options: Options, name: str) -> None:
        super().__init__(model, energy, options, name)
        self.iterations = options.iterations or self.default_iterations
        mesh, fabric = model.mesh, model.fabric
        self._rows = deformation_rows(mesh)
        self._weights = np.sqrt(fabric.stretch_warp * fabric.stretch_weft) * mesh.face_areas
        matrices = self._weights[:, None, None] * np.einsum("mca,mda->mcd", self._rows, self._rows)
        self._triangles = QuadraticElements(mesh.faces, model.vertex_count, matrices)
        quadratic = [part for part in energy.parts if isinstance(part, QuadraticElements)]
        self._quadratic = Sum([self._triangles, *quadratic])
        self._order = FreeOrder(self._quadratic.parts, self.free)
        self._system: Cholesky | None = None

    def forget(self) -> None:
        self._system = None

    def advance(
        self, x: np.ndarray, v: np.ndarray, h: float, target: np.ndarray, obstacles: Obstacles, wind: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        aim = x + h * v + h**2 * self.external(x, v, h, wind)
        inertia = self.mass / h**2
        if self._system is None:
            matrix = self._quadratic.hessian(x) + diags(np.repeat(inertia[:, 0], 3))
            try:
                self._system = Cholesky(matrix, self._order)
            except NotPositiveDefinite as error:
                raise StepError(f"linear solve failed: {error}") from error
        p = x + h * v
        p[self.model.held] = target
        faces = self.model.mesh.faces
        for _ in range(self.iterations):
            f = deformation(self._rows, p[faces])
            if not np.isfinite(f).all():
                raise StepError("positions are not finite")
            turned = np.einsum("m,mca,mia->mci", self._weights, self._rows, rotations(f))
            force = inertia * (aim - p) - self._quadratic.gradient(p) + self._triangles.gathered(turned)
            p = p + self._system.solve(force)
        there = p + obstacles.correction(p, x, self.free, self.model.fabric.friction, h)
        return there, (there - x) / h
