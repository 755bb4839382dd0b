"""Exact signed distance from points to a deforming closed triangle mesh, and figures of penetration.

This is a measuring tool. A tree of bounding boxes is built once for the fixed faces, and its boxes are refitted every
frame. Every distance is exact, near and far. The kernels work in float64.
"""

import numpy as np

from pbd.engine import ensure_initialized, ti
from pbd.errors import InputError
from pbd.geometry import closest_on_triangle
from pbd.mesh import edges_of

__all__ = ["TOLERANCE", "BodyDistance", "penetration_figures"]

_MAX_LEAF_FACES = 4  # faces in a leaf of the tree
TOLERANCE = 5e-5  # a point deeper than this is inside; it covers numeric noise and no contact thickness [m]

vec3 = ti.types.vector(3, ti.f64)
array3 = ti.types.ndarray(dtype=vec3, ndim=1)
array1 = ti.types.ndarray(dtype=ti.f64, ndim=1)
index1 = ti.types.ndarray(dtype=ti.i32, ndim=1)
index2 = ti.types.ndarray(dtype=ti.i32, ndim=2)


class BodyDistance:
    """Signed distance to a triangle mesh whose vertices move and whose faces stay.

    The sign is that of the angle-weighted pseudonormal at the closest point (Baerentzen and Aanaes 2005, "Signed
    distance computation using the angle weighted pseudonormal"). Where shells of the body overlap, the nearest
    surface decides: a point deep in one shell but close to the surface of another has its distance from the latter. A
    mesh with holes is accepted; near a hole the sign is that of the faces at its border.

    Args:
        faces: int, counter-clockwise seen from outside, shape (m, 3).

    Raises:
        InputError: no faces.
    """

    def __init__(self, faces: np.ndarray) -> None:
        self.faces = np.ascontiguousarray(faces, np.int32)
        if self.faces.ndim != 2 or self.faces.shape[1] != 3 or not len(self.faces):
            raise InputError("bad body faces", key="faces", received=self.faces.shape, expected="shape (m, 3), m > 0")
        edges, self._side_edge = edges_of(self.faces)
        self._edge_normals = np.zeros((len(edges), 3))
        self._face_normals = np.zeros((len(self.faces), 3))
        self._vertex_normals = np.zeros((int(self.faces.max()) + 1, 3))
        self._nearest = np.zeros(0, np.int32)  # nearest face of each point, where the next frame's search starts
        self._tree: tuple[np.ndarray, ...] | None = None

    def signed_distance(self, points: np.ndarray, body_vertices: np.ndarray) -> np.ndarray:
        """Distance of each point to the body, negative inside [m], shape (n,).

        Args:
            points: [m], shape (n, 3).
            body_vertices: this frame's vertices of the body [m], shape (v, 3).

        Raises:
            InputError: points or vertices of a wrong shape, or not finite.
        """
        points = _finite_points(points, "points", 0)
        vertices = _finite_points(body_vertices, "body_vertices", len(self._vertex_normals))
        ensure_initialized()
        if self._tree is None:
            self._tree = _build_tree(vertices[self.faces])
        order, after, first, count, low, high = self._tree
        _pseudonormals(
            vertices, self.faces, self._side_edge, self._face_normals, self._edge_normals, self._vertex_normals
        )
        _refit(vertices, self.faces, order, after, first, count, low, high)
        if len(self._nearest) != len(points):
            self._nearest = np.zeros(len(points), np.int32)
        return self._search(points, vertices, self._nearest)[0]

    def leaves_room(
        self, points: np.ndarray, distances: np.ndarray, body_vertices: np.ndarray, thickness: float
    ) -> np.ndarray:
        """Whether the cloth could leave the body at each point inside it; true for points that are not inside.

        Where arm and trunk touch or overlap, there is no position outside both. A point has room if the position that
        lies ``thickness`` outside its nearest surface is as far from all other parts of the body and inside none of
        them (winding number 0).

        Args:
            points: [m], shape (n, 3).
            distances: result of the last :meth:`signed_distance`, for the same points [m], shape (n,).
            body_vertices: as for :meth:`signed_distance`.
            thickness: distance that the cloth keeps from a body [m].

        Returns:
            bool, shape (n,).
        """
        has_room = np.ones(len(points), bool)
        inside = np.flatnonzero(distances < -TOLERANCE)
        if len(inside):
            vertices = _finite_points(body_vertices, "body_vertices", len(self._vertex_normals))
            deep = np.ascontiguousarray(points[inside], np.float64)
            distance, closest = self._search(deep, vertices, self._nearest[inside])
            outward = (closest - deep) / -distance[:, None]
            exits = closest + thickness * outward
            exit_distance, _ = self._search(exits, vertices, self._nearest[inside])
            has_room[inside] = (exit_distance > 0.9 * thickness) & (self.winding(exits, vertices) < 0.5)
        return has_room

    def winding(self, points: np.ndarray, body_vertices: np.ndarray) -> np.ndarray:
        """Winding number of the surface about each point: 0 outside, 1 inside, more where limbs overlap.

        The cost is that of every face for every point.

        Args:
            points: [m], shape (n, 3).
            body_vertices: [m], shape (v, 3).

        Returns:
            Shape (n,) [-]; holes in the mesh give fractions.

        Raises:
            InputError: points or vertices of a wrong shape, or not finite.
        """
        ensure_initialized()
        winding = np.zeros(len(points))
        if len(points):
            _winding_numbers(
                _finite_points(points, "points", 0),
                _finite_points(body_vertices, "body_vertices", len(self._vertex_normals)),
                self.faces,
                winding,
            )
        return winding

    def _search(self, points: np.ndarray, vertices: np.ndarray, nearest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Signed distances, shape (n,), and closest points, shape (n, 3) [m].

        Args:
            points, vertices: as for :meth:`signed_distance`.
            nearest: face where each search starts, int32, shape (n,); receives the nearest face.
        """
        assert self._tree is not None
        order, after, first, count, low, high = self._tree
        distance, closest = np.zeros(len(points)), np.zeros((len(points), 3))
        _query(
            points, vertices, self.faces, self._side_edge, self._face_normals, self._edge_normals, self._vertex_normals,
            order, after, first, count, low, high, nearest, distance, closest,
        )  # fmt: skip
        return distance, closest


def penetration_figures(distances: np.ndarray, has_room: np.ndarray) -> dict[str, float]:
    """Figures of the cloth's vertices inside the body: of all, and of those that the body leaves room.

    A vertex is inside if its signed distance is below -0.05 mm; this tolerance covers numeric noise and no contact
    thickness.

    Args:
        distances: signed distances of the cloth's vertices [m], shape (f, n) or (n,).
        has_room: of :meth:`BodyDistance.leaves_room`, same shape.

    Returns:
        ``inside_body_percent``: share of the vertices, mean over the frames [%]; ``deepest_mm``: greatest depth over
        all frames, 0 if no vertex is inside [mm]; and both with ``_with_room``, which leave out vertices where parts
        of the body pinch the cloth.
    """
    distances = np.asarray(distances)
    figures = {}
    for suffix, counted in (("", np.ones_like(has_room)), ("_with_room", has_room)):
        inside = (distances < -TOLERANCE) & counted
        figures[f"inside_body{suffix}_percent"] = 100.0 * float(inside.mean())
        figures[f"deepest{suffix}_mm"] = -1e3 * float(distances[inside].min()) if inside.any() else 0.0
    return figures


def _finite_points(points: np.ndarray, key: str, min_count: int) -> np.ndarray:
    """The points as float64; an InputError if they are fewer, of another shape or not finite."""
    points = np.ascontiguousarray(points, np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < min_count:
        raise InputError("bad positions", key=key, received=points.shape, expected=f"shape (n, 3), n >= {min_count}")
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        raise InputError("position that is not finite", key=f"{key}[{int(np.argmin(finite))}]")
    return points


def _build_tree(corners: np.ndarray) -> tuple[np.ndarray, ...]:
    """Tree of boxes over the faces, split at the median of the longest axis; nodes are in depth-first order.

    Args:
        corners: of the faces [m], shape (m, 3, 3).

    Returns:
        order: faces in the order of the leaves, shape (m,);
        after: the node that follows a node's whole subtree, shape (k,);
        first, count: a leaf's range in ``order``, count 0 for inner nodes, shape (k,) each;
        low, high: arrays for the corners of the boxes, not filled yet, shape (k, 3) each.
    """
    centres = corners.mean(axis=1)
    order = np.arange(len(corners), dtype=np.int32)
    after, first, count = [], [], []

    def split(start: int, end: int) -> None:
        node = len(after)
        after.append(0)
        first.append(start)
        count.append(end - start if end - start <= _MAX_LEAF_FACES else 0)
        if not count[node]:
            part = order[start:end]
            axis = int(np.argmax(np.ptp(centres[part], axis=0)))
            middle = (end - start) // 2
            order[start:end] = part[np.argpartition(centres[part, axis], middle)]
            split(start, start + middle)
            split(start + middle, end)
        after[node] = len(after)

    split(0, len(corners))
    boxes = np.zeros((2, len(after), 3))
    return (order, *(np.array(list_, np.int32) for list_ in (after, first, count)), boxes[0], boxes[1])


@ti.kernel
def _pseudonormals(
    vertices: array3,
    faces: index2,
    side_edge: index2,
    face_normals: array3,
    edge_normals: array3,
    vertex_normals: array3,
):
    """Normals of faces (unit), of edges (sum over their faces) and of vertices (sum weighted by corner angle)."""
    ti.loop_config(serialize=True)
    for e in range(edge_normals.shape[0]):
        edge_normals[e] = vec3(0.0)
    ti.loop_config(serialize=True)
    for v in range(vertex_normals.shape[0]):
        vertex_normals[v] = vec3(0.0)
    ti.loop_config(serialize=True)
    for f in range(faces.shape[0]):
        area = (vertices[faces[f, 1]] - vertices[faces[f, 0]]).cross(vertices[faces[f, 2]] - vertices[faces[f, 0]])
        length = area.norm()
        normal = vec3(0.0)
        if length > 0:
            normal = area / length
        face_normals[f] = normal
        for k in range(3):
            corner = vertices[faces[f, k]]
            a, b = vertices[faces[f, (k + 1) % 3]] - corner, vertices[faces[f, (k + 2) % 3]] - corner
            angle = ti.atan2(a.cross(b).norm(), a.dot(b))
            vertex_normals[faces[f, k]] = vertex_normals[faces[f, k]] + angle * normal
            edge_normals[side_edge[f, k]] = edge_normals[side_edge[f, k]] + normal


@ti.kernel
def _refit(
    vertices: array3,
    faces: index2,
    order: index1,
    after: index1,
    first: index1,
    count: index1,
    low: array3,
    high: array3,
):
    """Fit the boxes to the vertices. Children follow their parent in depth-first order, so nodes go backwards."""
    nodes = after.shape[0]
    ti.loop_config(serialize=True)
    for reverse in range(nodes):
        node = nodes - 1 - reverse
        if count[node] == 0:
            left, right = node + 1, after[node + 1]
            low[node] = ti.min(low[left], low[right])
            high[node] = ti.max(high[left], high[right])
        else:
            lowest = vertices[faces[order[first[node]], 0]]
            highest = lowest
            for slot in range(first[node], first[node] + count[node]):
                for k in range(3):
                    corner = vertices[faces[order[slot], k]]
                    lowest = ti.min(lowest, corner)
                    highest = ti.max(highest, corner)
            low[node] = lowest
            high[node] = highest


@ti.func
def _box_distance_squared(point: vec3, low: vec3, high: vec3):
    """Squared distance of a point from a box, 0 inside [m2]."""
    outside = ti.max(ti.max(low - point, point - high), vec3(0.0))
    return outside.dot(outside)


@ti.kernel
def _query(
    points: array3,
    vertices: array3,
    faces: index2,
    side_edge: index2,
    face_normals: array3,
    edge_normals: array3,
    vertex_normals: array3,
    order: index1,
    after: index1,
    first: index1,
    count: index1,
    low: array3,
    high: array3,
    nearest: index1,
    distance: array1,
    closest: array3,
):
    """Signed distances and closest points: the exact search of :meth:`BodyDistance.signed_distance`.

    Each point writes its own results only, so threads may share the points. There are 16 arguments because a kernel
    takes arrays one by one; grouping them inside the kernel would only repeat the list.
    """
    for q in range(points.shape[0]):
        p = points[q]
        # The nearest face of the last frame gives a close bound. The tree search then skips boxes beyond the bound.
        best_face = nearest[q]
        a, b, c = vertices[faces[best_face, 0]], vertices[faces[best_face, 1]], vertices[faces[best_face, 2]]
        best_weights = closest_on_triangle(p, a, b, c)
        best = (p - (best_weights[0] * a + best_weights[1] * b + best_weights[2] * c)).norm_sqr()
        node = 0
        while node < after.shape[0]:
            if _box_distance_squared(p, low[node], high[node]) >= best:
                node = after[node]
            else:
                for slot in range(first[node], first[node] + count[node]):
                    f = order[slot]
                    a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
                    weights = closest_on_triangle(p, a, b, c)
                    squared = (p - (weights[0] * a + weights[1] * b + weights[2] * c)).norm_sqr()
                    if squared < best:
                        best, best_face, best_weights = squared, f, weights
                node = node + 1
        nearest[q] = best_face
        normal = face_normals[best_face]
        foot = vec3(0.0)
        zeros = 0
        for k in ti.static(range(3)):
            foot += best_weights[k] * vertices[faces[best_face, k]]
            if best_weights[k] == 0:
                zeros += 1
        for k in ti.static(range(3)):
            if zeros == 2 and best_weights[k] != 0:
                normal = vertex_normals[faces[best_face, k]]
            if zeros == 1 and best_weights[k] == 0:
                normal = edge_normals[side_edge[best_face, (k + 1) % 3]]
        sign = ti.cast(-1.0, ti.f64) if normal.dot(p - foot) < 0 else ti.cast(1.0, ti.f64)
        distance[q] = sign * ti.sqrt(best)
        closest[q] = foot


@ti.kernel
def _winding_numbers(points: array3, vertices: array3, faces: index2, winding: array1):
    """Sum of the solid angles of all faces over 4 pi, for each point.

    van Oosterom and Strackee 1983, "The solid angle of a plane triangle". Each point writes its own result only.
    """
    for q in range(points.shape[0]):
        total = ti.cast(0.0, ti.f64)
        for f in range(faces.shape[0]):
            a, b = vertices[faces[f, 0]] - points[q], vertices[faces[f, 1]] - points[q]
            c = vertices[faces[f, 2]] - points[q]
            la, lb, lc = a.norm(), b.norm(), c.norm()
            volume = a.dot(b.cross(c))
            total += ti.atan2(volume, la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb)
        winding[q] = total / (2.0 * np.pi)
