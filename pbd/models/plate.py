"""Bending of thin sheets over the hinges of a mesh: three models.

All start from the hinge's functional |K x| = l theta (:func:`pbd.bending.hinge_rows`).
"""

from __future__ import annotations

import numpy as np

from pbd.bending import hinge_rows
from pbd.errors import InputError
from pbd.fabric import Fabric
from pbd.mesh import ClothMesh, Hinges
from pbd.model import Model
from pbd.models.elements import ElementEnergy, QuadraticElements

__all__ = ["HingeAngles", "angle_bending", "bending_matrix", "isometric_bending", "shape_operator_bending"]

# Six points near one conic do not tell a quadratic surface: directions in which the hinges of a triangle see less
# than this part of what they see most are left to its neighbours.
SEEN = 1e-3


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

    Also Baraff and Witkin's bending condition, with k such that it does not hang on the refinement.

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
                turn[:, :, vertex] = sign * _cross_matrix(side)
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


def shape_operator_bending(model: Model, poisson: float) -> list[ElementEnergy]:
    """Curvature of each triangle from its three hinges: orthotropic, with a Poisson ratio of its own.

    A triangle and the three corners that face it hold a quadratic surface, of which K x is a linear function: K x = G k
    with k = (k11, k22, 2 k12). The triangle's energy A/2 k^T D k at the least k that agrees with its hinges is
    A/2 s^T (G D^-1 G^T)^-1 s, s = K x. Nothing is to be calibrated. Where a hinge is missing (the border) its moment is
    zero by itself. Each axis of space is taken alone: for small curvature over a triangle K x stands along its normal.
    Seams are bent as by :func:`isometric_bending`.

    Args:
        model: the garment.
        poisson: ratio of the bending [-].
    """
    mesh, fabric = model.mesh, model.fabric
    scale = model.options.bend_scale
    parts: list[ElementEnergy] = []
    if fabric.bend_warp * fabric.bend_weft > 0.0:
        rigid = np.asarray(np.isin(mesh.faces, model.held).all(axis=1))
        elements, rows, forms, present = _quadratic_surfaces(mesh, rigid)
        compliance = np.linalg.inv(bending_matrix(fabric, poisson))
        flexibility = np.einsum("mha,ab,mgb->mhg", forms, compliance, forms)
        both = present[:, :, None] & present[:, None]
        matrices = mesh.face_areas[:, None, None] * np.linalg.pinv(
            np.where(both, flexibility, 0.0), rcond=SEEN, hermitian=True
        )
        matrices = scale * np.einsum("mhv,mhg,mgw->mvw", rows, matrices, rows)
        bends = ~rigid & present.any(axis=1)
        parts.append(QuadraticElements(elements[bends], model.vertex_count, matrices[bends]))
    if mesh.seam_hinges is not None:
        parts.append(_quadratic(model, mesh.seam_hinges, _stiffness(model, mesh.seam_hinges)))
    return parts


def _hinges(model: Model) -> Hinges:
    hinges = hinge_rows(model.mesh, model.held)
    if model.mesh.seam_hinges is None:
        return hinges
    return Hinges(*(np.concatenate(pair) for pair in zip(hinges, model.mesh.seam_hinges, strict=True)))


def _stiffness(model: Model, hinges: Hinges) -> np.ndarray:
    """3 c B/(A0 + A1) [N/m], shape (h,), with B across the hinge's edge as in :func:`pbd.build_model`."""
    fabric = model.fabric
    along_warp, along_weft = np.sin(hinges.angle) ** 2, np.cos(hinges.angle) ** 2
    bend = (np.sqrt(fabric.bend_warp) * along_warp + np.sqrt(fabric.bend_weft) * along_weft) ** 2
    stiffness = 3.0 * model.options.bend_scale * model.bend_factor * bend / hinges.areas
    stiffness[np.isin(hinges.vertices, model.held).all(axis=1)] = 0.0
    return stiffness


def _quadratic(model: Model, hinges: Hinges, stiffness: np.ndarray) -> QuadraticElements:
    matrices = stiffness[:, None, None] * hinges.rows[:, :, None] * hinges.rows[:, None]
    return QuadraticElements(hinges.vertices, model.vertex_count, matrices)


def _quadratic_surfaces(mesh: ClothMesh, rigid: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of each triangle: its six vertices (m, 6), rows K on them (m, 3, 6), G (m, 3, 3), which hinges are there (m, 3).

    Args:
        mesh: the cloth.
        rigid: triangles that cannot bend, shape (m,): towards one of them, the surface goes on as its own tangent.
    """
    count, faces = len(mesh.vertices), mesh.faces.astype(np.int64)
    hinges = hinge_rows(mesh)
    i, j, k, other = hinges.vertices.astype(np.int64).T
    # Each directed side that has a face beyond it, and what lies there.
    keys = np.concatenate([i * count + j, j * count + i])
    beyond = np.concatenate([other, k])
    own = np.concatenate([k, other])
    order = np.argsort(keys)
    hinge = np.tile(np.arange(len(i)), 2)
    flat = np.concatenate([np.zeros((len(faces), 1, 2)), mesh.flat.transpose(0, 2, 1)], axis=1)
    face_of = dict(zip(keys.tolist(), [-1] * len(keys), strict=True))
    for side in range(3):
        side_keys = faces[:, side] * count + faces[:, (side + 1) % 3]
        face_of.update(zip(side_keys.tolist(), range(len(faces)), strict=True))
    elements = np.concatenate([faces, faces], axis=1)
    rows, forms = np.zeros((len(faces), 3, 6)), np.zeros((len(faces), 3, 3))
    present = np.zeros((len(faces), 3), bool)
    for side in range(3):
        a, b = faces[:, side], faces[:, (side + 1) % 3]
        key = a * count + b
        place = np.searchsorted(keys[order], key)
        found = keys[order][np.minimum(place, len(keys) - 1)] == key if len(keys) else np.zeros(len(faces), bool)
        here = np.flatnonzero(found)
        entry = order[place[here]]
        h, present[:, side] = hinge[entry], found
        elements[here, 3 + side] = beyond[entry]
        neighbour = np.array([face_of[value] for value in (b[here] * count + a[here]).tolist()], int)
        # K of the hinge, in the order (a, b, own corner, far corner).
        turned = i[h] != a[here]
        k_row = np.where(turned[:, None], hinges.rows[h][:, [1, 0, 3, 2]], hinges.rows[h])
        assert np.all(own[entry] == faces[here, (side + 2) % 3])
        columns = np.stack([np.full(len(here), c) for c in (side, (side + 1) % 3, (side + 2) % 3, 3 + side)], axis=1)
        rows[here[:, None], side, columns] = k_row
        start, end, tip = (flat[here, (side + c) % 3] for c in range(3))
        far = _unfolded(start, end, flat[neighbour], faces[neighbour], a[here], b[here])
        for weight, point in zip(k_row.T, (start, end, tip, far), strict=True):
            monomials = _monomials(point, point)
            if point is far:
                middle = 0.5 * (start + end)
                tangent = _monomials(middle, far) + _monomials(far, middle) - _monomials(middle, middle)
                monomials = np.where(rigid[neighbour][:, None], tangent, monomials)
            forms[here, side] += weight[:, None] * monomials
    return elements, rows, forms, present


def _monomials(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Height over (k11, k22, 2 k12) as a bilinear form of two points; at p = q it is the height itself."""
    cross = 0.5 * (p[:, 0] * q[:, 1] + p[:, 1] * q[:, 0])
    return 0.5 * np.stack([p[:, 0] * q[:, 0], p[:, 1] * q[:, 1], cross], axis=1)


def _unfolded(
    start: np.ndarray, end: np.ndarray, flat: np.ndarray, faces: np.ndarray, a: np.ndarray, b: np.ndarray
) -> np.ndarray:
    """The far corner of the neighbour laid into a triangle's plane across its side a-b, shape (m, 2)."""
    rows = np.arange(len(faces))
    at_b = np.argmax(faces == b[:, None], axis=1)  # the neighbour runs b to a
    p, q, r = (flat[rows, (at_b + c) % 3] for c in range(3))
    side = q - p
    square = (side**2).sum(axis=1)
    along = ((r - p) * side).sum(axis=1) / square
    height = (side[:, 0] * (r - p)[:, 1] - side[:, 1] * (r - p)[:, 0]) / square
    own = start - end
    return end + along[:, None] * own + height[:, None] * np.stack([-own[:, 1], own[:, 0]], axis=1)


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


def _cross_matrix(a: np.ndarray) -> np.ndarray:
    """Matrix of b -> a x b, shape (m, 3, 3)."""
    x, y, z = a.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
