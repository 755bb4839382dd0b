"""Membranes of constant-strain triangles: one element, three measures of strain.

The element's energy is A/2 e^T D e with e = (e11, e22, 2 e12) a function of F = [w_u w_v], the images of the warp and
weft axes. The models differ in e(F) alone. A fabric that stiffens adds an energy of e11 alone and one of e22 alone,
each in the model's own strain.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from pbd.fabric import Fabric, stiffening_stress
from pbd.mesh import ClothMesh
from pbd.models.elements import ElementEnergy, clamped

__all__ = [
    "ConditionStrain",
    "CorotationalStrain",
    "GreenStrain",
    "Membrane",
    "Strain",
    "condition_membrane",
    "continuum_membrane",
    "deformation",
    "rotations",
]

MIN_RATIO = 1e-9  # below this a length or area ratio has lost its direction [-]


class Strain(Protocol):
    """A strain measure of F, shape (m, 3, 2)."""

    def values(self, f: np.ndarray) -> np.ndarray:
        """(e11, e22, 2 e12), shape (m, 3)."""
        ...

    def slopes(self, f: np.ndarray) -> np.ndarray:
        """First derivatives, shape (m, 3, 3, 2): strain, row of F, column of F."""
        ...

    def curvatures(self, f: np.ndarray, stress: np.ndarray) -> np.ndarray:
        """Second derivatives summed with ``stress``, shape (m, 3): shape (m, 3, 2, 3, 2)."""
        ...


class GreenStrain:
    """e = (F^T F - I)/2: the St. Venant-Kirchhoff model."""

    def values(self, f: np.ndarray) -> np.ndarray:
        u, v = f[..., 0], f[..., 1]
        return np.stack([0.5 * (_dot(u, u) - 1.0), 0.5 * (_dot(v, v) - 1.0), _dot(u, v)], axis=1)

    def slopes(self, f: np.ndarray) -> np.ndarray:
        slopes = np.zeros((len(f), 3, 3, 2))
        slopes[:, 0, :, 0] = slopes[:, 2, :, 1] = f[..., 0]
        slopes[:, 1, :, 1] = slopes[:, 2, :, 0] = f[..., 1]
        return slopes

    def curvatures(self, f: np.ndarray, stress: np.ndarray) -> np.ndarray:
        return np.einsum("mab,ij->miajb", _tensor(stress), np.eye(3))


class ConditionStrain:
    """e = (|w_u| - 1, |w_v| - 1, w_u . w_v): Baraff and Witkin 1998, section 4.

    With their C = sqrt(A) e, where they write A e, the energy k C^2/2 does not depend on the refinement.
    """

    def values(self, f: np.ndarray) -> np.ndarray:
        u, v = f[..., 0], f[..., 1]
        return np.stack([np.linalg.norm(u, axis=1) - 1.0, np.linalg.norm(v, axis=1) - 1.0, _dot(u, v)], axis=1)

    def slopes(self, f: np.ndarray) -> np.ndarray:
        slopes = np.zeros((len(f), 3, 3, 2))
        slopes[:, 0, :, 0] = f[..., 0] / _lengths(f)[:, None, 0]
        slopes[:, 1, :, 1] = f[..., 1] / _lengths(f)[:, None, 1]
        slopes[:, 2, :, 0], slopes[:, 2, :, 1] = f[..., 1], f[..., 0]
        return slopes

    def curvatures(self, f: np.ndarray, stress: np.ndarray) -> np.ndarray:
        curvatures = np.zeros((len(f), 3, 2, 3, 2))
        lengths = _lengths(f)
        for axis in range(2):
            unit = f[..., axis] / lengths[:, None, axis]
            across = np.eye(3) - unit[:, :, None] * unit[:, None, :]
            curvatures[:, :, axis, :, axis] = across * (stress[:, axis] / lengths[:, axis])[:, None, None]
        curvatures[:, :, 0, :, 1] = curvatures[:, :, 1, :, 0] = stress[:, 2, None, None] * np.eye(3)
        return curvatures


class CorotationalStrain:
    """e = S - I of the polar decomposition F = R S: linear elasticity in a frame that turns with the triangle.

    S solves S S = F^T F =: C. Its derivatives follow from S dS + dS S = dC, a Lyapunov equation whose solution in the
    plane is X(M) = (M + S^-1 M S^-1 det S) / (2 tr S).
    """

    def values(self, f: np.ndarray) -> np.ndarray:
        s = _stretch(f)
        return np.stack([s[:, 0, 0] - 1.0, s[:, 1, 1] - 1.0, 2.0 * s[:, 0, 1]], axis=1)

    def slopes(self, f: np.ndarray) -> np.ndarray:
        change = self._stretch_slopes(f)
        return np.stack([change[..., 0, 0], change[..., 1, 1], 2.0 * change[..., 0, 1]], axis=1)

    def curvatures(self, f: np.ndarray, stress: np.ndarray) -> np.ndarray:
        # stress : X(M) = X(stress) : M, with M = d2C - dS dS' - dS' dS.
        dual = _lyapunov(_stretch(f), _tensor(stress))
        change = self._stretch_slopes(f)
        turned = np.einsum("mpq,miapr->miaqr", dual, change)
        of_squares = np.einsum("miaqr,mjbrq->miajb", turned, change)
        return 2.0 * np.einsum("mab,ij->miajb", dual, np.eye(3)) - of_squares - of_squares.transpose(0, 3, 4, 1, 2)

    @staticmethod
    def _stretch_slopes(f: np.ndarray) -> np.ndarray:
        """dS/dF, shape (m, 3, 2, 2, 2): row and column of F, then of S."""
        half = np.einsum("ac,mib->miacb", np.eye(2), f)
        return _lyapunov(_stretch(f)[:, None, None], half + half.swapaxes(3, 4))


class Membrane(ElementEnergy):
    """Sum of A/2 e^T D e over the triangles of a mesh, and of what stiffening adds along warp and weft.

    Args:
        mesh: the cloth.
        strain: e(F).
        stiffness: D, for (e11, e22, 2 e12) [N/m], shape (3, 3).
        fabric: for its stiffening; None for none.
    """

    per_element = ("rows", "areas")

    def __init__(self, mesh: ClothMesh, strain: Strain, stiffness: np.ndarray, fabric: Fabric | None = None) -> None:
        super().__init__(mesh.faces, len(mesh.vertices))
        # (axis, E h, law) of the axes along which the fabric stiffens.
        self.stiffening: list[tuple[int, float, np.ndarray]] = []
        if fabric is not None:
            laws = zip((fabric.stretch_warp, fabric.stretch_weft), fabric.stiffening(), strict=True)
            self.stiffening = [(axis, young, law) for axis, (young, law) in enumerate(laws) if law.any()]
        self.strain, self.stiffness, self.areas = strain, stiffness, mesh.face_areas
        self.rows = deformation_rows(mesh)

    def strains(self, x: np.ndarray) -> np.ndarray:
        """(e11, e22, 2 e12) of each triangle [-], shape (m, 3)."""
        return self.strain.values(deformation(self.rows, x[self.elements]))

    def values(self, corners: np.ndarray) -> np.ndarray:
        strain = self.strain.values(deformation(self.rows, corners))
        energy = 0.5 * np.einsum("ma,ab,mb->m", strain, self.stiffness, strain)
        for axis, young, law in self.stiffening:
            energy += young * stiffening_stress(strain[:, axis], law)[0]
        return self.areas * energy

    def _stress(self, strain: np.ndarray) -> np.ndarray:
        stress = strain @ self.stiffness
        for axis, young, law in self.stiffening:
            stress[:, axis] += young * stiffening_stress(strain[:, axis], law)[1]
        return stress

    def slopes(self, corners: np.ndarray) -> np.ndarray:
        f = deformation(self.rows, corners)
        stress = self._stress(self.strain.values(f)) * self.areas[:, None]
        pull = np.einsum("ms,msia->mia", stress, self.strain.slopes(f))
        return np.einsum("mca,mia->mci", self.rows, pull)

    def curvatures(self, corners: np.ndarray, positive: bool) -> np.ndarray:
        f = deformation(self.rows, corners)
        strain = self.strain.values(f)
        stress = self._stress(strain)
        slopes = self.strain.slopes(f).reshape(-1, 3, 6)
        inner = slopes.transpose(0, 2, 1) @ self.stiffness @ slopes
        for axis, young, law in self.stiffening:
            tangent = young * stiffening_stress(strain[:, axis], law)[2]
            inner += tangent[:, None, None] * slopes[:, axis, :, None] * slopes[:, axis, None]
        inner += self.strain.curvatures(f, stress).reshape(-1, 6, 6)
        if positive:
            inner = clamped(inner)
        inner *= self.areas[:, None, None]
        # dF_ia/dx_ci = row_ca, the same for all three axes i.
        left = np.einsum("mca,miajb->mcijb", self.rows, inner.reshape(-1, 3, 2, 3, 2))
        return np.einsum("mcijb,mdb->mcidj", left, self.rows)


def deformation_rows(mesh: ClothMesh) -> np.ndarray:
    """Rows b with F = sum of x b^T over the corners [1/m], shape (m, 3, 2)."""
    inverse = np.linalg.inv(mesh.flat)
    return np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)


def deformation(rows: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """F = [w_u w_v] of each triangle, shape (m, 3, 2)."""
    return np.einsum("mci,mca->mia", corners - corners[:, :1], rows)


def rotations(f: np.ndarray) -> np.ndarray:
    """R of the polar decomposition F = R S, shape (m, 3, 2)."""
    left, _, right = np.linalg.svd(f, full_matrices=False)
    return left @ right


def continuum_membrane(mesh: ClothMesh, fabric: Fabric, kind: str) -> Membrane:
    """Orthotropic plane stress by name: ``corotational`` or ``stvk``."""
    strain = {"corotational": CorotationalStrain, "stvk": GreenStrain}[kind]()
    return Membrane(mesh, strain, fabric.membrane_stiffness(), fabric)


def condition_membrane(mesh: ClothMesh, fabric: Fabric) -> Membrane:
    """Baraff and Witkin's stretch and shear: three springs that know nothing of each other, so Poisson's ratio is 0."""
    stiffness = np.diag([fabric.stretch_warp, fabric.stretch_weft, fabric.shear])
    return Membrane(mesh, ConditionStrain(), stiffness, fabric)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("mi,mi->m", a, b)


def _lengths(f: np.ndarray) -> np.ndarray:
    return np.maximum(np.linalg.norm(f, axis=1), MIN_RATIO)


def _tensor(stress: np.ndarray) -> np.ndarray:
    """(s11, s22, s12) as a symmetric matrix, shape (m, 2, 2)."""
    return stress[:, [[0, 2], [2, 1]]]


def _stretch(f: np.ndarray) -> np.ndarray:
    """S = sqrt(F^T F) in closed form, shape (m, 2, 2)."""
    c = np.einsum("mia,mib->mab", f, f)
    root = np.sqrt(np.maximum(np.linalg.det(c), MIN_RATIO**2))
    trace = np.sqrt(np.trace(c, axis1=1, axis2=2) + 2.0 * root)
    return (c + root[:, None, None] * np.eye(2)) / trace[:, None, None]


def _lyapunov(s: np.ndarray, m: np.ndarray) -> np.ndarray:
    """X with S X + X S = M, for symmetric positive definite S and symmetric M, shape (..., 2, 2)."""
    adjugate = np.trace(s, axis1=-2, axis2=-1)[..., None, None] * np.eye(2) - s
    det = np.maximum(np.linalg.det(s), MIN_RATIO)[..., None, None]
    return (m + adjugate @ m @ adjugate / det) / (2.0 * np.trace(s, axis1=-2, axis2=-1)[..., None, None])
