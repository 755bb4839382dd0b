"""Trunk, arms and legs of a standing body, cut apart at armpits and crotch by the shape of its surface alone."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from assets.cross_sections import cross_section
from assets.facing import standing_frame
from pbd.errors import InputError
from pbd.mesh import edges_of

__all__ = ["UP", "BodySegments", "Missing", "NamedSurface", "unit"]

Floats = NDArray[np.float64]
Faces = NDArray[np.int32]

UP = np.array([0.0, 1.0, 0.0])
"""The upright direction in the frame of a body."""

_JOINT_GAP = 0.03  # [m] parts of a jointed figure that lie so near each other hang together
_UPRIGHT = 5.0  # weight of the upright direction in the plane where arms begin [-]


class NamedSurface(Protocol):
    """A body: a character, or any mesh with a name.

    Attributes:
        name: for messages.
        vertices: [m], shape (n, 3), float64.
        faces: shape (m, 3), int32.
    """

    @property
    def name(self) -> str: ...
    @property
    def vertices(self) -> Floats: ...
    @property
    def faces(self) -> Faces: ...


class Missing(Exception):
    """A part of the body that a measure needs is not there; the message names the place."""


class BodySegments:
    """The parts of a body that stands upright: Y up, arms held away from the trunk (A-pose or T-pose), legs apart.

    Where it stands and which way it looks does not matter: it is measured in its own frame. No rig is needed, so that a
    skinned character in its bind pose and a scanned surface are measured alike. Armpits and crotch are saddles: going
    along a direction, the first point where arm and leg, or both legs, hang together.

    Attributes:
        frame: of the body in the world.
        vertices, faces: of the body, in its frame.
        floor, height: [m].
        crotch, armpit: saddles of the surface [m]; the left armpit.
        is_arm: whether a vertex belongs to an arm that the armpit's saddle cuts off.
        trunk: faces without arms.
        leg, arm: faces of the left leg below the crotch, and of the left arm.
        arm_direction: from the armpit to the hand, of unit length.
        shoulder_normal: of the plane through the armpit where the arm begins; its third component is 0.
    """

    def __init__(self, body: NamedSurface) -> None:
        self.name, self.faces = body.name, np.asarray(body.faces, np.int32)
        self.frame = standing_frame(np.asarray(body.vertices, float), self.faces)
        self.vertices = v = self.frame.local(np.asarray(body.vertices, float))
        self.floor = float(v[:, 1].min())
        self.height = float(v[:, 1].max() - self.floor)
        links = _links(v, self.faces)
        feet = [int(np.where(side * v[:, 0] > 0.0, v[:, 1], np.inf).argmin()) for side in (1, -1)]
        crotch, is_leg = self._saddle(links, -v[:, 1], feet[0], feet[1], "the left and the right foot")
        self.crotch = v[crotch] * (0.0, 1.0, 1.0)
        self.is_arm = np.zeros(len(v), bool)
        for side, word in ((1, "left"), (-1, "right")):
            hand = int((side * v[:, 0]).argmax())
            shoulder = np.array([side * 0.1 * self.height, self.floor + 0.81 * self.height, v[hand, 2]])
            direction = unit(v[hand] - shoulder)
            armpit, is_arm = self._saddle(
                links, v @ unit(direction + (0.0, -1.0, 0.0)), hand, feet[0], f"the {word} hand and the foot"
            )
            self.is_arm |= is_arm
            if np.linalg.norm(v[hand] - v[armpit]) < 0.15 * self.height:
                raise self.problem(f"the {word} arm does not stand away from the trunk", self._place(v[hand]))
            if side == 1:
                self.armpit, arm = v[armpit], is_arm
                self.arm_direction = unit((direction[0], direction[1], 0.0))
        if not self.armpit[1] > self.crotch[1] + 0.1 * self.height:
            problem = "the armpits are no higher than the crotch: there is no trunk between them"
            raise self.problem(problem, self._place(self.armpit))
        # The arm begins at a plane between the one across the arm and an upright one.
        across = np.array([-self.arm_direction[1], self.arm_direction[0], 0.0])
        along = unit(across + (0.0, _UPRIGHT, 0.0))
        self.shoulder_normal = np.array([along[1], -along[0], 0.0])
        self.trunk = self.faces[~self.is_arm[self.faces].all(axis=1)]
        self.leg = self.faces[is_leg[self.faces].any(axis=1)]
        outside = ((v - self.armpit) @ self.shoulder_normal > 0.0) & (v[:, 1] > self.armpit[1])
        self.arm = self.faces[(arm | outside)[self.faces].any(axis=1) & (v[self.faces, 0] > 0.0).all(axis=1)]

    def level(self, height: float) -> Floats:
        """Points of the trunk without arms at a height [m], shape (k, 3).

        Raises:
            Missing: there is nothing of it.
        """
        points = self.cut(self.trunk, np.array([0.0, height, 0.0]), UP, "trunk")
        if height < self.armpit[1]:
            return points
        points = points[(np.abs(points) * (1, 0, 0) + points * (0, 1, 1) - self.armpit) @ self.shoulder_normal < 0.0]
        if len(points) < 3:
            raise Missing(f"nothing of the trunk is {height - self.floor:.2f} m above the floor")
        return points

    def cut(self, faces: Faces, point: Floats, normal: Floats, part: str) -> Floats:
        """Points where a plane cuts faces of the body [m], shape (k, 3).

        Args:
            faces: shape (m, 3).
            point, normal: of the plane, shape (3,).
            part: name of the part of the body, for the message.

        Raises:
            Missing: the plane does not cut them.
        """
        points = cross_section(self.vertices, faces, point, normal)
        if len(points) < 3:
            raise Missing(f"nothing of the {part} is {point[1] - self.floor:.2f} m above the floor")
        return points

    def problem(self, problem: str, received: object = None) -> InputError:
        """The error of a body that cannot be measured."""
        return InputError(
            problem,
            key=f"body {self.name}",
            received=received,
            expected="a figure that stands upright (Y up), its arms away from the trunk (A-pose or T-pose) and its "
            "legs apart: pose it so, or leave out clothes that join them",
        )

    def _place(self, point: Floats) -> str:
        x, y, z = self.frame.world(point[None])[0]
        return f"at ({x:.2f}, {y:.2f}, {z:.2f}) m"

    def _saddle(
        self, links: NDArray[np.int32], field: Floats, first: int, second: int, words: str
    ) -> tuple[int, NDArray[np.bool_]]:
        try:
            return _saddle(links, field, first, second)
        except ValueError:
            gap = f"parts that are over {100.0 * _JOINT_GAP:.0f} cm apart"
            raise self.problem(f"{words} do not hang together", gap) from None


def _links(vertices: Floats, faces: Faces) -> NDArray[np.int32]:
    """Edges of the mesh, and pairs of near vertices of different parts of it, shape (e, 2)."""
    edges = edges_of(faces)[0]
    count = len(vertices)
    parts, part = connected_components(coo_matrix((np.ones(len(edges)), edges.T), shape=(count, count)), directed=False)
    if parts == 1:
        return edges
    near = cKDTree(vertices).query_pairs(_JOINT_GAP, output_type="ndarray")
    return np.concatenate([edges, near[part[near[:, 0]] != part[near[:, 1]]].astype(np.int32)])


def _saddle(links: NDArray[np.int32], field: Floats, first: int, second: int) -> tuple[int, NDArray[np.bool_]]:
    """The highest vertex of a field over which two vertices hang together, and the vertices above it beside the first.

    Args:
        links: pairs of vertices that hang together, shape (e, 2).
        field: a value for each vertex, shape (n,).
        first: a vertex.
        second: a vertex.

    Raises:
        ValueError: they do not hang together at all.
    """
    rank = np.zeros(len(field), np.int64)
    rank[np.argsort(-field, kind="stable")] = np.arange(len(field))
    begins = rank[links].max(axis=1)  # a link is there once both of its vertices are
    low, high = int(rank[[first, second]].max()) - 1, len(field) - 1
    parts = _parts(links, begins, high, len(field))
    if parts[first] != parts[second]:
        raise ValueError("two parts")
    while high - low > 1:  # together at high, apart at low
        middle = (low + high) // 2
        parts = _parts(links, begins, middle, len(field))
        low, high = (low, middle) if parts[first] == parts[second] else (middle, high)
    parts = _parts(links, begins, low, len(field))
    return int(np.flatnonzero(rank == high)[0]), (parts == parts[first]) & (rank <= low)


def _parts(links: NDArray[np.int32], begins: NDArray[np.int64], last: int, count: int) -> NDArray[np.int32]:
    used = links[begins <= last]
    return connected_components(coo_matrix((np.ones(len(used)), used.T), shape=(count, count)), directed=False)[1]


def unit(vector: Floats | tuple[float, ...]) -> Floats:
    """A vector's direction, of length 1."""
    vector = np.asarray(vector, float)
    return vector / np.linalg.norm(vector)
