"""Bending of thin sheets over the hinges of a mesh: three models.

Two stand on the hinge's functional |K x| = l theta (:func:`pbd.bending.hinge_rows`), one is a plate element.
"""

from __future__ import annotations

import numpy as np

from pbd.bending import hinge_rows, hinge_stiffness
from pbd.errors import InputError
from pbd.fabric import Fabric
from pbd.mesh import ClothMesh, Hinges, edges_of
from pbd.model import Model
from pbd.models.elements import ElementEnergy, QuadraticElements

__all__ = [
    "HingeAngles",
    "angle_bending",
    "bending_matrix",
    "cross_matrix",
    "isometric_bending",
    "morley_bending",
    "morley_rows",
]


def bending_matrix(fabric: Fabric, poisson: float) -> np.ndarray:
    """Orthotropic plate stiffness for (k11, k22, 2 k12) [N m], shape (3, 3).

    B is the stiffness of a wide strip, bent to a cylinder. The coupling is nu sqrt(B1 B2) and the twist
    (1 - nu)/2 sqrt(B1 B2), as in a homogeneous sheet with equal axes (Huber's estimate between them).

    Args:
        fabric: B of warp and weft.
        poisson: ratio of the bending, its own [-].

    Raises:
        InputError: a ratio that is not between -1 and 1.
    """
    if not -1.0 < poisson < 1.0:
        raise InputError("bad Poisson ratio", key="bend_poisson", received=poisson, expected="between -1 and 1")
    mean = np.sqrt(fabric.bend_warp * fabric.bend_weft)
    coupling, twist = poisson * mean, 0.5 * (1.0 - poisson) * mean
    return np.array([[fabric.bend_warp, coupling, 0.0], [coupling, fabric.bend_weft, 0.0], [0.0, 0.0, twist]])


def isometric_bending(model: Model) -> QuadraticElements:
    """E = 3/2 c B |K x|^2/(A0 + A1) (Bergou et al. 2006), c measured on the mesh: quadratic in x."""
    hinges = _hinges(model)
    return _quadratic(model, hinges, _stiffness(model, hinges))


class HingeAngles(ElementEnergy):
    """Discrete shells (Grinspun et al. 2003), E = k/2 theta^2 with theta the angle between the two normals.

    Also Baraff and Witkin's bending condition, with k such that it does not depend on the refinement.

    Args:
        elements: (i, j, k, l), see :func:`pbd.mesh.hinges_of`, shape (m, 4).
        vertex_count: n.
        stiffness: k [N m], shape (m,).
    """

    per_element = ("stiffness",)

    def __init__(self, elements: np.ndarray, vertex_count: int, stiffness: np.ndarray) -> None:
        super().__init__(elements, vertex_count)
        self.stiffness = stiffness

    def values(self, corners: np.ndarray) -> np.ndarray:
        return 0.5 * self.stiffness * self.angles(corners) ** 2

    def slopes(self, corners: np.ndarray) -> np.ndarray:
        return (self.stiffness * self.angles(corners))[:, None, None] * self.angle_slopes(corners)

    def curvatures(self, corners: np.ndarray, positive: bool) -> np.ndarray:
        slopes = self.angle_slopes(corners)
        curvatures = slopes[:, :, :, None, None] * slopes[:, None, None]
        if not positive:
            curvatures += self.angles(corners)[:, None, None, None, None] * self.angle_curvatures(corners)
        return self.stiffness[:, None, None, None, None] * curvatures

    @staticmethod
    def angles(corners: np.ndarray) -> np.ndarray:
        """Theta [rad], shape (m,)."""
        edge, first, second = _edge_and_normals(corners)
        edge /= np.linalg.norm(edge, axis=1, keepdims=True)
        sine = np.einsum("mi,mi->m", edge, np.cross(first, second))
        return np.arctan2(sine, np.einsum("mi,mi->m", first, second))

    @staticmethod
    def angle_slopes(corners: np.ndarray) -> np.ndarray:
        """First derivatives of theta [1/m], shape (m, 4, 3).

        A face with the apex a over the edge, |edge| = l, unnormalised normal n and foot of its height at p along the
        edge adds n/|n|^2 times -l at the apex, l - p at the edge's start and p at its end.
        """
        edge, *normals = _edge_and_normals(corners)
        slopes = np.zeros_like(corners)
        for apex, normal in zip((2, 3), normals, strict=True):
            arms, _ = _arms(corners, edge, apex)
            slopes += arms[:, :, None] * (normal / (normal**2).sum(axis=1, keepdims=True))[:, None]
        return slopes

    @staticmethod
    def angle_curvatures(corners: np.ndarray) -> np.ndarray:
        """Second derivatives of theta [1/m2], shape (m, 4, 3, 4, 3)."""
        edge, *normals = _edge_and_normals(corners)
        total = np.zeros((len(corners), 4, 3, 4, 3))
        for apex, normal, sign in zip((2, 3), normals, (1.0, -1.0), strict=True):
            arms, arm_slopes = _arms(corners, edge, apex)
            square = (normal**2).sum(axis=1)[:, None, None]
            lever = normal / square[:, 0]
            # d(n/|n|^2) = (I/|n|^2 - 2 n n^T/|n|^4) dn, with dn/dx_a the cross product with the side opposite to a.
            inner = np.eye(3) / square - 2.0 * lever[:, :, None] * lever[:, None, :]
            turn = np.zeros((len(corners), 3, 4, 3))
            start, end, tip = corners[:, 0], corners[:, 1], corners[:, apex]
            for vertex, side in ((0, tip - end), (1, start - tip), (apex, end - start)):
                turn[:, :, vertex] = sign * cross_matrix(side)
            total += arms[:, :, None, None, None] * (inner @ turn.reshape(-1, 3, 12)).reshape(-1, 1, 3, 4, 3)
            total += lever[:, None, :, None, None] * arm_slopes[:, :, None]
        return total


def angle_bending(model: Model) -> list[ElementEnergy]:
    """Discrete shells with 3 c B l^2/(A0 + A1), c measured on the mesh. Seams stay quadratic, as in the default."""
    hinges = hinge_rows(model.mesh, model.held)
    edges, lengths = model.mesh.edge_lengths()
    count = model.vertex_count
    keys = np.sort(hinges.vertices[:, :2], axis=1).astype(np.int64) @ [count, 1]
    length = lengths[np.searchsorted(edges.astype(np.int64) @ [count, 1], keys)]
    parts: list[ElementEnergy] = [HingeAngles(hinges.vertices, count, _stiffness(model, hinges) * length**2)]
    seams = model.mesh.seam_hinges
    if seams is not None:
        parts.append(_quadratic(model, seams, _stiffness(model, seams)))
    return parts


def morley_bending(model: Model, poisson: float) -> list[ElementEnergy]:
    """Morley's triangle (1968): constant curvature, orthotropic, with a Poisson ratio of its own; nothing to calibrate.

    Its unknowns are the vertices and the slope across the middle of each edge. Here that slope is a point p that hangs
    beside the edge: p = middle + l dx/dn, l the edge's length and n the normal of the edge in the cloth. These hidden
    points are counted after the vertices, have no mass and stand where they cost least: see
    :class:`pbd.models.elements.Sum`. The curvature follows from the divergence theorem,

        k_ab = 1/A sum over sides of l (dx/dn n_a n_b + dx/ds t_a n_b),

    and each axis of space is taken alone: A/2 k^T D k summed over them is the curvature's energy where the cloth keeps
    its lengths. Borders are free of moments by themselves. Seams are bent as by :func:`isometric_bending`.

    Args:
        model: the garment.
        poisson: ratio of the bending [-].
    """
    mesh, fabric = model.mesh, model.fabric
    stiffness = bending_matrix(fabric, poisson)
    parts: list[ElementEnergy] = []
    if fabric.bend_warp * fabric.bend_weft > 0.0:
        rigid = np.asarray(np.isin(mesh.faces, model.held).all(axis=1))
        elements, rows, point_count = morley_rows(mesh, rigid)
        matrices = mesh.face_areas[~rigid, None, None] * np.einsum("mai,ab,mbj->mij", rows, stiffness, rows)
        parts.append(QuadraticElements(elements, point_count, matrices))
    if mesh.seam_hinges is not None:
        parts.append(_quadratic(model, mesh.seam_hinges, _stiffness(model, mesh.seam_hinges)))
    return parts


def _hinges(model: Model) -> Hinges:
    hinges = hinge_rows(model.mesh, model.held)
    if model.mesh.seam_hinges is None:
        return hinges
    return Hinges(*(np.concatenate(pair) for pair in zip(hinges, model.mesh.seam_hinges, strict=True)))


def _stiffness(model: Model, hinges: Hinges) -> np.ndarray:
    """3 c B/(A0 + A1) [N/m], shape (h,), with B of :func:`pbd.bending.hinge_stiffness`."""
    bend = hinge_stiffness(model.fabric, hinges.angle)
    stiffness = 3.0 * model.bend_factor * bend / hinges.areas
    stiffness[np.isin(hinges.vertices, model.held).all(axis=1)] = 0.0
    return stiffness


def _quadratic(model: Model, hinges: Hinges, stiffness: np.ndarray) -> QuadraticElements:
    matrices = stiffness[:, None, None] * hinges.rows[:, :, None] * hinges.rows[:, None]
    return QuadraticElements(hinges.vertices, model.vertex_count, matrices)


def morley_rows(mesh: ClothMesh, rigid: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Of each face that bends: its six points (m, 6), (k11, k22, 2 k12) as rows on them (m, 3, 6); all points' number.

    Args:
        mesh: the cloth.
        rigid: faces that cannot bend, shape (m,). Beside one of them the point is its own, by its three vertices.
    """
    edges, side_edge = edges_of(mesh.faces)
    lengths = mesh.edge_lengths()[1]
    rigid_face = np.full(len(edges), -1)
    rigid_face[side_edge[rigid].ravel()] = np.repeat(np.flatnonzero(rigid), 3)
    used = np.zeros(len(edges), bool)
    used[side_edge[~rigid].ravel()] = True
    hidden = np.cumsum(used & (rigid_face < 0)) - 1 + len(mesh.vertices)
    faces, side_edge = mesh.faces[~rigid], side_edge[~rigid]
    flat = np.concatenate([np.zeros((len(mesh.faces), 1, 2)), mesh.flat.transpose(0, 2, 1)], axis=1)
    elements = np.concatenate([faces, hidden[side_edge]], axis=1)
    rows = np.zeros((len(faces), 3, 6))
    every = np.arange(len(faces))
    for side in range(3):
        first, second = side, (side + 1) % 3
        edge, length = side_edge[:, side], lengths[side_edge[:, side]]
        along, normal = _frame(flat[~rigid], side)
        size = np.linalg.norm(flat[~rigid][:, second] - flat[~rigid][:, first], axis=1)
        # Where the two faces of an edge run it the same way round, one outward normal is the other's inward one.
        sign = np.where(faces[:, first] < faces[:, second], 1.0, -1.0)
        slope = _symmetric(normal, normal) * (size * sign / length)[:, None]
        rise = _symmetric(along, normal)
        rows[:, :, 3 + side] += slope
        rows[:, :, first] -= 0.5 * slope + rise
        rows[:, :, second] += rise - 0.5 * slope
        at = np.flatnonzero(rigid_face[edge] >= 0)
        if len(at):
            shares, far = _hanging(mesh, flat, rigid_face[edge[at]], faces[at, first], faces[at, second], length[at])
            for place, share in ((first, shares[:, 0]), (second, shares[:, 1])):
                rows[at, :, place] += share[:, None] * rows[at, :, 3 + side]
            rows[at, :, 3 + side] *= shares[:, 2, None]
            elements[every[at], 3 + side] = far
    return elements, rows / mesh.face_areas[~rigid, None, None], int(hidden.max(initial=len(mesh.vertices) - 1)) + 1


def _hanging(
    mesh: ClothMesh, flat: np.ndarray, faces: np.ndarray, first: np.ndarray, second: np.ndarray, length: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The point beside an edge as a point of the rigid face there: shares of first, second and far corner, and that.

    The edge runs first to second in the other face, second to first in this one. In the order of the vertices' numbers
    its normal points out of the face that runs it upwards.
    """
    start = np.argmax(mesh.faces[faces] == second[:, None], axis=1)
    rows = np.arange(len(faces))
    corner = [flat[faces][rows, (start + c) % 3] for c in range(3)]
    side = corner[1] - corner[0]
    size = np.linalg.norm(side, axis=1)
    normal = np.stack([side[:, 1], -side[:, 0]], axis=1) / size[:, None]
    sign = np.where(second < first, 1.0, -1.0)
    point = 0.5 * (corner[0] + corner[1]) + (sign * length)[:, None] * normal
    basis = np.stack([side, corner[2] - corner[0]], axis=2)
    to_first, to_far = np.linalg.solve(basis, (point - corner[0])[:, :, None])[:, :, 0].T
    far = mesh.faces[faces, (start + 2) % 3]
    return np.stack([to_first, 1.0 - to_first - to_far, to_far], axis=1), far


def _frame(flat: np.ndarray, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Unit tangent and outward normal of a side of flat faces, shape (m, 2) each."""
    along = flat[:, (side + 1) % 3] - flat[:, side]
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    return along, np.stack([along[:, 1], -along[:, 0]], axis=1)


def _symmetric(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(a b^T)_11, _22 and twice its symmetric _12, shape (m, 3)."""
    return np.stack([a[:, 0] * b[:, 0], a[:, 1] * b[:, 1], a[:, 0] * b[:, 1] + a[:, 1] * b[:, 0]], axis=1)


def _edge_and_normals(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x_j - x_i [m], and the normals of the faces of k and l, as long as twice their areas."""
    i, j, k, other = (corners[:, c] for c in range(4))
    return j - i, np.cross(i - k, j - k), np.cross(j - other, i - other)


def _arms(corners: np.ndarray, edge: np.ndarray, apex: int) -> tuple[np.ndarray, np.ndarray]:
    """Levers of :meth:`HingeAngles.angle_slopes` [m], shape (m, 4), and their derivatives, shape (m, 4, 4, 3)."""
    length = np.linalg.norm(edge, axis=1)
    unit = edge / length[:, None]
    offset = corners[:, apex] - corners[:, 0]
    foot = np.einsum("mi,mi->m", offset, unit)
    arms, slopes = np.zeros((len(corners), 4)), np.zeros((len(corners), 4, 4, 3))
    arms[:, 0], arms[:, 1], arms[:, apex] = length - foot, foot, -length
    across = (offset - foot[:, None] * unit) / length[:, None]
    slopes[:, 1, 0], slopes[:, 1, 1], slopes[:, 1, apex] = -across - unit, across, unit
    slopes[:, apex, 0], slopes[:, apex, 1] = unit, -unit
    slopes[:, 0] = -slopes[:, 1] - slopes[:, apex]
    return arms, slopes


def cross_matrix(a: np.ndarray) -> np.ndarray:
    """Matrix of b -> a x b, shape (m, 3, 3)."""
    x, y, z = a.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
