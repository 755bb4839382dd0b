"""Position-based dynamics as published, with compliance (XPBD), and on strains; Gauss-Seidel colour by colour."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence

import numpy as np

from pbd.mesh import ClothMesh, greedy_colors
from pbd.model import Model
from pbd.models.elements import Sum
from pbd.models.membrane import ConditionStrain, deformation, deformation_rows
from pbd.models.obstacles import Obstacles
from pbd.models.plate import HingeAngles, angle_bending
from pbd.models.springs import Springs, triangle_springs
from pbd.models.stepping import ClothSolver, Options

__all__ = ["PBD", "XPBD", "StrainBased"]

# What position-based dynamics has in the place of a fabric: the part of an error that one pass takes back [-].
STRETCH, BEND = 0.9, 0.1


class Constraint:
    """Functions C(x) of a few vertices each, all of one kind; those of one colour share no vertex.

    Args:
        elements: vertices, int, shape (m, k).
        vertex_count: n.
    """

    def __init__(self, elements: np.ndarray, vertex_count: int) -> None:
        self.elements = np.asarray(elements, np.int64)
        colors = greedy_colors(self.elements, vertex_count)
        self.colors = [np.flatnonzero(colors == color) for color in range(int(colors.max(initial=-1)) + 1)]

    @abstractmethod
    def values(self, corners: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """C, shape (r,), and its derivatives, shape (r, k, 3), of some of them."""


class Distance(Constraint):
    """C = |x_i - x_j| - l [m]."""

    def __init__(self, springs: Springs) -> None:
        super().__init__(springs.elements, springs.vertex_count)
        self.lengths = springs.lengths

    def values(self, corners: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        offset = corners[:, 0] - corners[:, 1]
        length = np.maximum(np.linalg.norm(offset, axis=1), 1e-12)
        unit = offset / length[:, None]
        return length - self.lengths[rows], np.stack([unit, -unit], axis=1)


class Angle(Constraint):
    """C = theta of a hinge [rad]; see :class:`pbd.models.plate.HingeAngles`."""

    def values(self, corners: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return HingeAngles.angles(corners), HingeAngles.angle_slopes(corners)


class StrainPart(Constraint):
    """C = |w_u| - 1, |w_v| - 1 or w_u . w_v of a triangle [-].

    Args:
        mesh: the cloth.
        part: 0, 1 or 2.
    """

    def __init__(self, mesh: ClothMesh, part: int) -> None:
        super().__init__(mesh.faces, len(mesh.vertices))
        self.rows, self.part = deformation_rows(mesh), part

    def values(self, corners: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        strain, of_f = ConditionStrain(), deformation(self.rows[rows], corners)
        slopes = np.einsum("rca,ria->rci", self.rows[rows], strain.slopes(of_f)[:, self.part])
        return strain.values(of_f)[:, self.part], slopes


class PositionSolver(ClothSolver):
    """Predict, correct positions by one constraint after the other, take velocities from the way."""

    default_iterations = 10

    def __init__(self, model: Model, energy: Sum, options: Options, name: str) -> None:
        super().__init__(model, energy, options, name)
        self.iterations = options.iterations or self.default_iterations
        self._inverse_mass = np.zeros(model.vertex_count)
        self._inverse_mass[self.free] = 1.0 / model.mass[self.free]

    def advance(
        self, x: np.ndarray, v: np.ndarray, h: float, target: np.ndarray, obstacles: Obstacles, wind: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        p = x + h * v + h**2 * self.external(x, v, h, wind)
        p[self.model.held] = target
        self.begin()
        friction = self.model.fabric.friction
        for _ in range(self.iterations):
            self.correct_all(p, h)
            p += obstacles.correction(p, x, self.free, friction, h)
        return p, (p - x) / h

    def begin(self) -> None:
        """Before the first pass of a substep."""
        return

    @abstractmethod
    def correct_all(self, p: np.ndarray, h: float) -> None:
        """One pass over all constraints; changes ``p`` [m], shape (n, 3), in place."""

    def correct_one(
        self, constraint: Constraint, p: np.ndarray, share: float, give: np.ndarray, multipliers: np.ndarray
    ) -> None:
        """One pass over the constraints of a kind, in place.

        Args:
            constraint: of one kind.
            p: [m], shape (n, 3).
            share: part of the correction that is made [-].
            give: compliance over h^2, shape (m,).
            multipliers: sums since the substep's start, shape (m,).
        """
        for rows in constraint.colors:
            elements = constraint.elements[rows]
            value, slopes = constraint.values(p[elements], rows)
            weights = self._inverse_mass[elements][:, :, None]
            answer = (weights * slopes**2).sum(axis=(1, 2)) + give[rows]
            wanted = -(value + give[rows] * multipliers[rows])
            change = share * np.where(answer > 1e-12, wanted / np.maximum(answer, 1e-12), 0.0)
            multipliers[rows] += change
            p[elements] += weights * slopes * change[:, None, None]


class PBD(PositionSolver):
    """Mueller et al. 2007: distances and angles with a stiffness from 0 to 1, k' = 1 - (1 - k)^(1/iterations).

    Neither the fabric nor the step enters: the stiffness of the cloth depends on iterations, step and mesh. It is here
    to show that.
    """

    substep = 1.0 / 60.0

    def __init__(self, model: Model, energy: Sum, options: Options, name: str) -> None:
        super().__init__(model, energy, options, name)
        self._constraints = self.stretching()
        angles = angle_bending(model)[0]
        self._constraints.append((Angle(angles.elements, model.vertex_count), BEND))
        self._rigid = [np.zeros(len(constraint.elements)) for constraint, _ in self._constraints]

    def stretching(self) -> list[tuple[Constraint, float]]:
        """What keeps lengths, with stiffness [-]."""
        return [(Distance(triangle_springs(self.model.mesh, self.model.fabric)), STRETCH)]

    def correct_all(self, p: np.ndarray, h: float) -> None:
        for (constraint, stiffness), rigid in zip(self._constraints, self._rigid, strict=True):
            share = 1.0 - (1.0 - stiffness) ** (1.0 / self.iterations)
            self.correct_one(constraint, p, share, rigid, np.zeros_like(rigid))


class StrainBased(PBD):
    """Mueller et al. 2014: warp, weft and shear of each triangle in the place of distances. Stiffness as in PBD."""

    def stretching(self) -> list[tuple[Constraint, float]]:
        return [(StrainPart(self.model.mesh, part), STRETCH) for part in range(3)]


class XPBD(PositionSolver):
    """Macklin, Mueller, Chentanez 2016, as written: multipliers over several passes of one step, compliance 1/k.

    Distances carry the triangular lattice of springs, angles the hinges of discrete shells.
    """

    def __init__(self, model: Model, energy: Sum, options: Options, name: str) -> None:
        super().__init__(model, energy, options, name)
        springs, angles = triangle_springs(model.mesh, model.fabric), angle_bending(model)[0]
        assert isinstance(angles, HingeAngles)
        bends = np.flatnonzero(angles.stiffness > 0.0)
        self._constraints: Sequence[tuple[Constraint, np.ndarray]] = [
            (Distance(springs), 1.0 / springs.stiffness),
            (Angle(angles.elements[bends], model.vertex_count), 1.0 / angles.stiffness[bends]),
        ]
        self.begin()

    def begin(self) -> None:
        self._multipliers = [np.zeros_like(compliance) for _, compliance in self._constraints]

    def correct_all(self, p: np.ndarray, h: float) -> None:
        for (constraint, compliance), multipliers in zip(self._constraints, self._multipliers, strict=True):
            self.correct_one(constraint, p, 1.0, compliance / h**2, multipliers)
