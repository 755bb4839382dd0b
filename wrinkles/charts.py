"""Charts of a coarse mesh: flat coordinates (warp, weft) of the cloth around each vertex.

Charts use rest lengths only, so they do not change when the garment moves. A curtain, a skirt and a sleeve have the
same chart coordinates, so that one dictionary of wrinkles serves every part of every garment.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pbd import ClothMesh
from wrinkles.surface import Subdivision

__all__ = ["Charts", "fine_places", "leading_vertices"]


def fine_places(subdivision: Subdivision) -> tuple[np.ndarray, np.ndarray]:
    """Coarse face, int, shape (N,), and barycentric weights, none below 0, shape (N, 3), of each fine vertex."""
    face, place = subdivision.places
    inside = np.clip(place, 0.0, None)  # a delivered vertex may lie beyond the border
    return face, inside / inside.sum(axis=1, keepdims=True)


def leading_vertices(subdivision: Subdivision) -> np.ndarray:
    """The three coarse vertices around each fine vertex, by descending weight: int32, shape (N, 3)."""
    face, place = fine_places(subdivision)
    order = np.argsort(-place, axis=1, kind="stable")
    return np.ascontiguousarray(subdivision.coarse_faces[face[:, None], order], np.int32)


@dataclass(frozen=True)
class Charts:
    """Angles of the faces around each vertex, measured from the warp.

    Attributes:
        mesh: the coarse mesh.
        start: angle at which face f begins around its corner c (the side to the next corner) [rad], shape (m, 3).
        opening: corner angles in the chart [rad], shape (m, 3); around inner vertices they are scaled to a full turn.
        scale: chart angle over true angle of each vertex [-], shape (n,).
        neighbor: face across side s, -1 on the rim, int, shape (m, 3).
    """

    mesh: ClothMesh
    start: np.ndarray
    opening: np.ndarray
    scale: np.ndarray
    neighbor: np.ndarray

    @classmethod
    def of(cls, mesh: ClothMesh) -> Charts:
        """Make the charts of a mesh from its rest metric."""
        faces, count = mesh.faces, len(mesh.vertices)
        corner = np.concatenate([np.zeros((len(faces), 1, 2)), mesh.flat.transpose(0, 2, 1)], axis=1)
        to_next = np.roll(corner, -1, axis=1) - corner
        to_last = np.roll(corner, 1, axis=1) - corner
        angle = lambda v: np.arctan2(v[..., 1], v[..., 0])  # noqa: E731
        true_opening = (angle(to_last) - angle(to_next)) % (2 * np.pi)
        warp_angle = angle(to_next)  # of the side to the next corner, against the face's own warp
        neighbor = _neighbors(faces, count)
        total = np.bincount(faces.ravel(), weights=true_opening.ravel(), minlength=count)
        on_rim = np.zeros(count, bool)
        rim_face, rim_side = np.nonzero(neighbor < 0)
        on_rim[faces[rim_face, rim_side]] = True
        on_rim[faces[rim_face, (rim_side + 1) % 3]] = True
        scale = np.where(on_rim, 1.0, 2 * np.pi / np.maximum(total, 1e-9))
        opening = true_opening * scale[faces]
        start = _fan_angles(faces, neighbor, opening, count)
        # Turn each chart so that its warp agrees on average with the warp of the faces around the vertex.
        difference = warp_angle - start
        sine = np.bincount(faces.ravel(), weights=np.sin(difference).ravel(), minlength=count)
        cosine = np.bincount(faces.ravel(), weights=np.cos(difference).ravel(), minlength=count)
        return cls(mesh, start + np.arctan2(sine, cosine)[faces], opening, scale, neighbor)

    def locate(self, face: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Coordinates of points in the charts of the three corners of their face [m], shape (p, 3 corners, 2).

        Args:
            face: int, shape (p,).
            weights: barycentric weights in the face, shape (p, 3).
        """
        corner = np.concatenate([np.zeros((len(face), 1, 2)), self.mesh.flat[face].transpose(0, 2, 1)], axis=1)
        point = np.einsum("pc,pci->pi", weights, corner)[:, None, :]
        arm, side = point - corner, np.roll(corner, -1, axis=1) - corner
        radius = np.linalg.norm(arm, axis=2)
        turn = np.arctan2(side[..., 0] * arm[..., 1] - side[..., 1] * arm[..., 0], np.einsum("pci,pci->pc", side, arm))
        theta = self.start[face] + np.maximum(turn, 0.0) * self.scale[self.mesh.faces[face]]
        return radius[..., None] * np.stack([np.cos(theta), np.sin(theta)], axis=2)

    def trace(self, vertex: np.ndarray, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Follow a straight line on the cloth from each vertex by a chart offset (the exponential map).

        A vertex on the rim has only a sector of cloth around it. An offset outside the sector is projected onto the
        sector's nearest side, so that the chart follows a curved hem in both directions.

        Args:
            vertex: int, shape (p,).
            offset: (warp, weft) [m], shape (p, 2).

        Returns:
            face of the end point, int, shape (p,); its barycentric weights, shape (p, 3); and whether the line reached
            it without meeting the rim, bool, shape (p,).
        """
        flat = self.mesh.flat
        face, corner, turn, beside = self._first_face(vertex, np.arctan2(offset[:, 1], offset[:, 0]))
        arrived = beside <= 1e-9
        length = np.linalg.norm(offset, axis=1) * np.maximum(np.cos(beside), 0.0)
        local = np.concatenate([np.zeros((len(face), 1, 2)), flat[face].transpose(0, 2, 1)], axis=1)
        rows = np.arange(len(face))
        origin = local[rows, corner]
        side = local[rows, (corner + 1) % 3] - origin
        theta = np.arctan2(side[:, 1], side[:, 0]) + turn / self.scale[vertex]
        direction = np.stack([np.cos(theta), np.sin(theta)], axis=1)
        end = origin + length[:, None] * direction
        entered = np.full(len(face), -1)
        weights = np.zeros((len(face), 3))
        active = np.ones(len(face), bool)
        for _ in range(64):
            weights = np.where(active[:, None], _barycentric(local, end), weights)
            outside = active & (weights.min(axis=1) < -1e-9)
            if not outside.any():
                break
            active = outside
            index = np.flatnonzero(active)
            out = _exit_side(local[index], origin[index], end[index], entered[index])
            across = self.neighbor[face[index], out]
            stop = across < 0
            if stop.any():  # at the rim: keep the crossing point
                here = index[stop]
                end[here] = _crossing(local[here], origin[here], end[here], out[stop])
                weights[here] = np.clip(_barycentric(local[here], end[here]), 0.0, 1.0)
                weights[here] /= weights[here].sum(axis=1, keepdims=True)
                arrived[here] = False
                active[here] = False
            index, out, across = index[~stop], out[~stop], across[~stop]
            if len(index):
                self._unfold(local, face, entered, index, out, across)
        weights = np.clip(weights, 0.0, 1.0)
        return face, weights / weights.sum(axis=1, keepdims=True), arrived

    def _first_face(self, vertex: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, ...]:
        """The face around a vertex that contains a direction, or the nearest one.

        Args:
            vertex: int, shape (p,).
            theta: direction in the vertex's chart [rad], shape (p,).

        Returns:
            face, corner of the face, angle from the face's first side, and angle by which the direction misses the
            face [rad]: shape (p,) each.
        """
        order = np.argsort(self.mesh.faces.ravel(), kind="stable")
        first = np.searchsorted(self.mesh.faces.ravel()[order], np.arange(len(self.mesh.vertices) + 1))
        slot = np.arange(int(np.diff(first).max(initial=1)))  # the largest number of faces around a vertex
        there = slot < np.diff(first)[vertex][:, None]
        around = order[np.where(there, first[vertex][:, None] + slot, 0)]
        into = (theta[:, None] - self.start.ravel()[around]) % (2 * np.pi)
        opening = self.opening.ravel()[around]
        past, before = np.maximum(into - opening, 0.0), 2 * np.pi - into
        best = np.where(there, np.minimum(past, before), np.inf).argmin(axis=1)
        pick = lambda a: a[np.arange(len(vertex)), best]  # noqa: E731
        face, corner = np.divmod(pick(around), 3)
        into, opening, past, before = (pick(a) for a in (into, opening, past, before))
        turn = np.where(past <= before, np.minimum(into, opening), 0.0)
        beside = np.minimum(past, before)
        return face, corner, turn, beside

    def _unfold(
        self,
        local: np.ndarray,
        face: np.ndarray,
        entered: np.ndarray,
        index: np.ndarray,
        out: np.ndarray,
        across: np.ndarray,
    ) -> None:
        """Unfold the next face into the plane of the current one, and step into it, in place.

        Args:
            local: corners of each walk's face in the plane [m], shape (p, 3, 2).
            face: of each walk, int, shape (p,).
            entered: side of the face by which the walk entered, int, shape (p,).
            index: walks that step, int, shape (k,).
            out: side by which they leave, int, shape (k,).
            across: face behind that side, int, shape (k,).
        """
        rows, faces = np.arange(len(index)), self.mesh.faces
        position_a, position_b = local[index, out], local[index, (out + 1) % 3]
        # In the next face the shared side runs from b to a.
        side = np.argmax((faces[across] == faces[face[index], (out + 1) % 3][:, None]), axis=1)
        flat = np.concatenate([np.zeros((len(across), 1, 2)), self.mesh.flat[across].transpose(0, 2, 1)], axis=1)
        b_flat, a_flat = flat[rows, side], flat[rows, (side + 1) % 3]
        from_angle = np.arctan2((a_flat - b_flat)[:, 1], (a_flat - b_flat)[:, 0])
        to = position_a - position_b
        turn = np.arctan2(to[:, 1], to[:, 0]) - from_angle
        rotation = np.stack(
            [np.stack([np.cos(turn), -np.sin(turn)], axis=1), np.stack([np.sin(turn), np.cos(turn)], axis=1)], axis=1
        )
        local[index] = position_b[:, None] + np.einsum("pij,pcj->pci", rotation, flat - b_flat[:, None])
        face[index] = across
        entered[index] = side


def _neighbors(faces: np.ndarray, count: int) -> np.ndarray:
    """Face across each side, -1 on the rim: int, shape (m, 3); ``count`` is the number of vertices."""
    start = faces.astype(np.int64)
    end = np.roll(start, -1, axis=1)
    key, reverse = (start * count + end).ravel(), (end * count + start).ravel()
    order = np.argsort(key)
    at = np.clip(np.searchsorted(key[order], reverse), 0, len(key) - 1)
    found = key[order][at] == reverse
    return np.where(found, order[at] // 3, -1).reshape(-1, 3)


def _fan_angles(faces: np.ndarray, neighbor: np.ndarray, opening: np.ndarray, count: int) -> np.ndarray:
    """Angle at which each face begins around its corners, from the first face of the fan [rad], shape (m, 3)."""
    start = np.zeros(faces.shape)
    done = np.zeros(faces.shape, bool)
    # A fan begins after the rim if it has one: corners whose side to the next corner has no neighbour come first.
    order = np.argsort(neighbor.ravel() >= 0, kind="stable")
    for seed in order.tolist():
        face, corner = seed // 3, seed % 3
        angle = 0.0
        while not done[face, corner]:
            done[face, corner] = True
            start[face, corner] = angle
            angle += opening[face, corner]
            across = neighbor[face, (corner + 2) % 3]  # over the side to the last corner
            if across < 0:
                break
            vertex = faces[face, corner]
            face, corner = across, int(np.argmax(faces[across] == vertex))
    return start


def _barycentric(local: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Barycentric weights of points, shape (p, 2), in triangles of the plane, shape (p, 3, 2): shape (p, 3)."""
    a, b, c = local[:, 0], local[:, 1], local[:, 2]
    cross = lambda u, v: u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]  # noqa: E731
    area = cross(b - a, c - a)
    return (
        np.stack([cross(b - point, c - point), cross(c - point, a - point), cross(a - point, b - point)], 1)
        / (area[:, None])
    )


def _exit_side(local: np.ndarray, origin: np.ndarray, end: np.ndarray, entered: np.ndarray) -> np.ndarray:
    """Side by which each ray leaves its face: the nearest crossing ahead, except the side by which it entered."""
    best, best_t = np.zeros(len(local), np.int64), np.full(len(local), np.inf)
    ray = end - origin
    for side in range(3):
        a, b = local[:, side], local[:, (side + 1) % 3]
        along = b - a
        normal = np.stack([along[:, 1], -along[:, 0]], axis=1)  # points out of a counter-clockwise face
        rate = np.einsum("pi,pi->p", ray, normal)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = np.einsum("pi,pi->p", a - origin, normal) / rate
        ahead = (rate > 1e-15) & (side != entered) & (t < best_t)
        best, best_t = np.where(ahead, side, best), np.where(ahead, t, best_t)
    return best


def _crossing(local: np.ndarray, origin: np.ndarray, end: np.ndarray, side: np.ndarray) -> np.ndarray:
    """Points where segments cross the lines of given sides of their triangles [m], shape (p, 2)."""
    rows = np.arange(len(local))
    a, b = local[rows, side], local[rows, (side + 1) % 3]
    normal = np.stack([(b - a)[:, 1], -(b - a)[:, 0]], axis=1)
    ray = end - origin
    t = np.einsum("pi,pi->p", a - origin, normal) / np.einsum("pi,pi->p", ray, normal)
    return origin + np.clip(t, 0.0, 1.0)[:, None] * ray
