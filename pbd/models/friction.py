"""Internal friction of cloth (Miguel et al. 2013): elastoplastic elements beside those of membrane and plate.

A step minimises the energy of the elastic elements and, of each element of friction, Huber's function of its distance
from the strain at which it is without force: a parabola as far as it sticks, a line beyond, where it slips. That is the
implicit return mapping of plasticity. After the step the element follows as far as it has slipped.
"""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from pbd.model import Model
from pbd.models.elements import ElementEnergy
from pbd.models.membrane import Membrane, deformation
from pbd.models.plate import cross_matrix, morley_rows
from pbd.xpbd.constraints import FRICTION_STIFFNESS

__all__ = ["CurvatureFriction", "FrictionElements", "ShearFriction", "friction_elements"]


ROOTS = 40  # steps of Newton's method in which it is found how far an element slips


class FrictionElements(ElementEnergy):
    """Elements that stick and slip.

    Attributes:
        faces: face of the mesh that each belongs to, int, shape (m,).
        plastic: strains at which they are without force, shape (m, s).
        stored: name of the array of :class:`pbd.State` that keeps them, by face.
    """

    faces: np.ndarray
    plastic: np.ndarray
    stored: str

    @abstractmethod
    def slip(self, points: np.ndarray) -> None:
        """Let each element follow the cloth that has come to ``points`` [m] as far as its force is too great."""


class ShearFriction(FrictionElements):
    """An element beside the shear of each triangle, three times as stiff.

    Args:
        membrane: of the cloth.
        shear: stiffness of the shear, G h [N/m].
        force: per width at which an element slips [N/m].
    """

    stored = "plastic_shears"

    def __init__(self, membrane: Membrane, shear: float, force: float) -> None:
        super().__init__(membrane.elements, membrane.vertex_count)
        self.membrane, self.stiffness, self.force = membrane, FRICTION_STIFFNESS * shear, force
        self.faces, self.plastic = np.arange(len(membrane.elements)), np.zeros((len(membrane.elements), 1))

    def off(self, f: np.ndarray) -> np.ndarray:
        """How far the shear is from the element's own [-], shape (m,)."""
        return self.membrane.strain.values(f)[:, 2] - self.plastic[:, 0]

    def values(self, corners: np.ndarray) -> np.ndarray:
        off = np.abs(self.off(deformation(self.membrane.rows, corners)))
        slipping = self.force * (off - 0.5 * self.force / self.stiffness)
        return self.membrane.areas * np.where(self._sticks(off), 0.5 * self.stiffness * off**2, slipping)

    def slopes(self, corners: np.ndarray) -> np.ndarray:
        f = deformation(self.membrane.rows, corners)
        pull = (self.membrane.areas * self._forces(f))[:, None, None] * self.membrane.strain.slopes(f)[:, 2]
        return np.einsum("mca,mia->mci", self.membrane.rows, pull)

    def curvatures(self, corners: np.ndarray, positive: bool) -> np.ndarray:
        f, rows = deformation(self.membrane.rows, corners), self.membrane.rows
        slope = self.membrane.strain.slopes(f)[:, 2]
        sticking = np.where(self._sticks(self.off(f)), self.stiffness, 0.0)
        inner = np.einsum("m,mia,mjb->miajb", sticking, slope, slope)
        if not positive:
            stress = np.zeros((len(f), 3))
            stress[:, 2] = self._forces(f)
            inner += self.membrane.strain.curvatures(f, stress)
        left = np.einsum("m,mca,miajb->mcijb", self.membrane.areas, rows, inner)
        return np.einsum("mcijb,mdb->mcidj", left, rows)

    def slip(self, points: np.ndarray) -> None:
        off = self.off(deformation(self.membrane.rows, points[self.elements]))
        reach = self.force / self.stiffness
        self.plastic[:, 0] += off - np.clip(off, -reach, reach)

    def _sticks(self, off: np.ndarray) -> np.ndarray:
        return self.stiffness * np.abs(off) <= self.force

    def _forces(self, f: np.ndarray) -> np.ndarray:
        return np.clip(self.stiffness * self.off(f), -self.force, self.force)


class CurvatureFriction(FrictionElements):
    """An element beside the plate of each triangle (:func:`pbd.models.plate.morley_bending`).

    It follows the curvatures along the face's normal n, k_a = n . K_a with a of (11, 22, 12 twice). What it loses over
    a change of them is the length of y = (H1 k11, H2 k22, sqrt(H1 H2 / 2) 2 k12): with one moment of friction H for all
    directions that is H |dk| for a bend along any of them.

    Args:
        elements, point_count, rows: of :func:`pbd.models.plate.morley_rows`.
        faces: that they belong to, int, shape (m,).
        areas: of the faces [m2], shape (m,).
        moments: H of warp and weft, half of Kawabata's 2HB [N].
        stiffness: B of warp and weft [N m]. Along each the element is three times as stiff.
    """

    stored = "plastic_curvatures"

    def __init__(
        self,
        elements: np.ndarray,
        point_count: int,
        rows: np.ndarray,
        faces: np.ndarray,
        areas: np.ndarray,
        moments: tuple[float, float],
        stiffness: tuple[float, float],
    ) -> None:
        super().__init__(elements, point_count)
        self.rows, self.faces, self.areas = rows, faces, areas
        warp, weft = moments
        self.scale = np.array([warp, weft, np.sqrt(0.5 * warp * weft)])
        # An element gives by this for a force of 1 that belongs to the scaled strains, shape (3,).
        give = [h**2 / (FRICTION_STIFFNESS * b) if h > 0.0 else 1.0 for h, b in zip(moments, stiffness, strict=True)]
        self.give = np.array([*give, np.sqrt(give[0] * give[1])])
        self.plastic = np.zeros((len(elements), 3))

    def curved(self, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """K [1/m], shape (m, 3, 3); twice the faces' areas [m2]; n; and k - plastic times the scale, shape (m, 3)."""
        bent = np.einsum("mac,mci->mai", self.rows, corners - corners[:, :1])
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        size = np.linalg.norm(normal, axis=1)
        normal /= size[:, None]
        off = self.scale * (np.einsum("mai,mi->ma", bent, normal) - self.plastic)
        return bent, size, normal, off

    def forces(self, off: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forces f of length 1 at most that belong to the scaled strains, shape (m, 3); how far each slips, shape (m,).

        It slips by t f, so that off = (give + t) f: t >= 0 makes f as long as 1. Newton's method for 1/|f| goes up to
        it (More and Sorensen 1983).
        """
        length = np.linalg.norm(off, axis=1)
        slips = np.linalg.norm(off / self.give, axis=1) > 1.0
        slid = np.where(slips, np.maximum(length - self.give.max(), 0.0), 0.0)
        for _ in range(ROOTS):
            force = off / (self.give + slid[:, None])
            size = np.linalg.norm(force, axis=1)
            slope = (force**2 / (self.give + slid[:, None])).sum(axis=1)
            step = np.where(slips, size**2 * (size - 1.0) / np.maximum(slope, 1e-300), 0.0)
            slid += step
            if not (step > 1e-15 * slid).any():
                break
        return off / (self.give + slid[:, None]), slid

    def values(self, corners: np.ndarray) -> np.ndarray:
        force, slid = self.forces(self.curved(corners)[3])
        return self.areas * (0.5 * force**2 @ self.give + slid)

    def slopes(self, corners: np.ndarray) -> np.ndarray:
        bent, size, normal, off = self.curved(corners)
        moment = self.areas[:, None] * self.scale * self.forces(off)[0]
        return np.einsum("ma,maci->mci", moment, self._curvature_slopes(corners, bent, size, normal))

    def curvatures(self, corners: np.ndarray, positive: bool) -> np.ndarray:
        bent, size, normal, off = self.curved(corners)
        slopes = self._curvature_slopes(corners, bent, size, normal) * self.scale[:, None, None]
        force, slid = self.forces(off)
        inner = np.eye(3) / (self.give + slid[:, None])[:, None]
        along = force / (self.give + slid[:, None])
        slipping = along[:, :, None] * along[:, None] / np.maximum((force * along).sum(axis=1), 1e-300)[:, None, None]
        inner -= np.where(slid[:, None, None] > 0.0, slipping, 0.0)
        flat = slopes.reshape(len(slopes), 3, -1)
        total = (flat.swapaxes(1, 2) @ inner @ flat).reshape(len(slopes), 6, 3, 6, 3)
        if not positive:
            total += self._turning(corners, self.scale * force, bent, size, normal)
        return self.areas[:, None, None, None, None] * total

    def slip(self, points: np.ndarray) -> None:
        force, slid = self.forces(self.curved(points[self.elements])[3])
        self.plastic += slid[:, None] * force / np.where(self.scale > 0.0, self.scale, 1.0)

    def moments(self, points: np.ndarray) -> np.ndarray:
        """Moments per width in each face, conjugate to the curvatures (11, 22, 12 twice) [N], shape (m, 3)."""
        return self.scale * self.forces(self.curved(points[self.elements])[3])[0]

    def _curvature_slopes(
        self, corners: np.ndarray, bent: np.ndarray, size: np.ndarray, normal: np.ndarray
    ) -> np.ndarray:
        """First derivatives of n . K, shape (m, 3, 6, 3)."""
        slopes = self.rows[:, :, :, None] * normal[:, None, None]
        across = (bent - np.einsum("mai,mi,mj->maj", bent, normal, normal)) / size[:, None, None]
        slopes[:, :, :3] += np.cross(across[:, :, None], _levers(corners)[:, None])
        return slopes

    def _turning(
        self, corners: np.ndarray, moments: np.ndarray, bent: np.ndarray, size: np.ndarray, normal: np.ndarray
    ) -> np.ndarray:
        """Second derivatives of n . K summed with the moments, shape (m, 6, 3, 6, 3).

        With N = |N| n the cross product of two sides and V the sum of the K: the second derivatives of V . N/|N| by N,
        those of N by the corners, and both K's and N's change.
        """
        total = np.zeros((len(corners), 6, 3, 6, 3))
        pull = np.einsum("ma,mai->mi", moments, bent)
        along = np.einsum("mi,mi->m", pull, normal)
        flat = np.eye(3) - normal[:, :, None] * normal[:, None]
        across = np.einsum("mij,mj->mi", flat, pull)
        mixed = across[:, :, None] * normal[:, None]
        by_normal = -(mixed + mixed.swapaxes(1, 2) + along[:, None, None] * flat) / size[:, None, None] ** 2
        turns = cross_matrix(_levers(corners).reshape(-1, 3)).reshape(-1, 3, 3, 3)  # of N by each corner
        total[:, :3, :, :3] = np.einsum("mcki,mkl,mdlj->mcidj", turns, by_normal, turns)
        twist = cross_matrix(across / size[:, None])
        for first, second in ((0, 2), (1, 0), (2, 1)):
            total[:, first, :, second] += twist
            total[:, second, :, first] -= twist
        weights = np.einsum("ma,mac->mc", moments, self.rows) / size[:, None]
        both = np.einsum("mc,mik,mdkj->mcidj", weights, flat, turns)
        total[:, :, :, :3] += both
        total[:, :3] += both.transpose(0, 3, 4, 1, 2)
        return total


def _levers(corners: np.ndarray) -> np.ndarray:
    """Sides w with dN = sum over the corners of w x dx, for N the cross product of two sides: shape (m, 3, 3)."""
    return np.stack([corners[:, (c + 2) % 3] - corners[:, (c + 1) % 3] for c in range(3)], axis=1)


def friction_elements(model: Model, membrane: Membrane) -> list[ElementEnergy]:
    """The elements of friction that the fabric of a model asks for; none for a fabric without hysteresis."""
    fabric, mesh, found = model.fabric, model.mesh, []
    if fabric.shear_hysteresis > 0.0:
        found.append(ShearFriction(membrane, fabric.shear, 0.5 * fabric.shear_hysteresis))
    moments = 0.5 * fabric.bend_hysteresis_warp, 0.5 * fabric.bend_hysteresis_weft
    if max(moments) > 0.0 and fabric.bend_warp * fabric.bend_weft > 0.0:
        rigid = np.asarray(np.isin(mesh.faces, model.held).all(axis=1))
        elements, rows, point_count = morley_rows(mesh, rigid)
        faces = np.flatnonzero(~rigid)
        stiffness = fabric.bend_warp, fabric.bend_weft
        found.append(CurvatureFriction(elements, point_count, rows, faces, mesh.face_areas[faces], moments, stiffness))
    return found
