"""Array types, small vectors, triangles and the surface of a body, for all kernels."""

from pbd.engine import ti
from pbd.taichi_internals import same

__all__ = [
    "FAR", "Byte2", "Double1", "Double3", "Double4", "Float1", "Float2", "Int1", "Int2",
    "Int3", "Int4", "Vec2", "Vec3", "Vec4", "Vec4Rows", "between", "closest_in_fan", "closest_on_triangle",
    "descend", "larger", "surface_normals", "vec3", "vec4", "xyz",
]  # fmt: skip

vec3 = ti.math.vec3
Vec4 = ti.types.ndarray(dtype=ti.math.vec4, ndim=1)
Vec4Rows = ti.types.ndarray(dtype=ti.math.vec4, ndim=2)
Vec3 = ti.types.ndarray(dtype=ti.math.vec3, ndim=1)
Double3 = ti.types.ndarray(dtype=ti.types.vector(3, ti.f64), ndim=1)
Double1 = ti.types.ndarray(dtype=ti.f64, ndim=1)
Double4 = ti.types.ndarray(dtype=ti.types.vector(4, ti.f64), ndim=1)
Vec2 = ti.types.ndarray(dtype=ti.math.vec2, ndim=1)
Int4 = ti.types.ndarray(dtype=ti.types.vector(4, ti.i32), ndim=1)
Int3 = ti.types.ndarray(dtype=ti.types.vector(3, ti.i32), ndim=1)
Int2 = ti.types.ndarray(dtype=ti.types.vector(2, ti.i32), ndim=1)
Int1 = ti.types.ndarray(dtype=ti.i32, ndim=1)
Byte2 = ti.types.ndarray(dtype=ti.u8, ndim=2)
Float1 = ti.types.ndarray(dtype=ti.f32, ndim=1)
Float2 = ti.types.ndarray(dtype=ti.f32, ndim=2)

FAR = 0.03  # bodies are looked for up to this distance from the cloth [m]


@ti.func
def larger(a: ti.f32, b: ti.f32) -> ti.f32:
    """The larger of two, b if a is not a number: one instruction, where ``ti.max`` takes four."""
    return ti.select(a > b, a, b)


@ti.func
def xyz(p) -> vec3:
    """The first three components."""
    return vec3(p[0], p[1], p[2])


@ti.func
def vec4(u: vec3, last: ti.f32 = 0.0):
    """U and a fourth component."""
    return ti.math.vec4(u[0], u[1], u[2], last)


@ti.func
def closest_on_triangle(p, a, b, c):
    """Barycentric weights of the closest point of a triangle (Ericson 2005, "Real-Time Collision Detection", 5.1.5).

    A weight is exactly zero where the point lies on an edge or in a corner. For float32 and float64.
    """
    ab, ac, ap, bp, cp = b - a, c - a, p - a, p - b, p - c
    d1, d2, d3, d4, d5, d6 = ab.dot(ap), ac.dot(ap), ab.dot(bp), ac.dot(bp), ab.dot(cp), ac.dot(cp)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    u, v, w = 0 * d1, 0 * d1, 0 * d1  # of the arguments' own type
    if d1 <= 0 and d2 <= 0:
        u = 1.0
    elif d3 >= 0 and d4 <= d3:
        v = 1.0
    elif d6 >= 0 and d5 <= d6:
        w = 1.0
    elif vc <= 0 and d1 >= 0 and d3 <= 0:
        v = d1 / (d1 - d3)
        u = 1.0 - v
    elif vb <= 0 and d2 >= 0 and d6 <= 0:
        w = d2 / (d2 - d6)
        u = 1.0 - w
    elif va <= 0 and d4 - d3 >= 0 and d5 - d6 >= 0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - w
    else:
        # All three are positive but for a sliver's rounding; clamped, the point always stays on the triangle.
        u, v, w = ti.max(va, 0.0), ti.max(vb, 0.0), ti.max(vc, 0.0)
        total = u + v + w
        if total > 0:
            u /= total
            v /= total
            w /= total
        else:
            u = 1.0
    return ti.Vector([u, v, w])


@ti.func
def between(b: ti.i32, t: ti.f32, body: ti.template()) -> vec3:
    """Vertex b of a body (:class:`pbd.contact.body_surface.BodySurface`) at t in [0, 1] of the frame [m]."""
    x = body.body_start[b]
    # Not left to the compiler: in floating-point numbers t * (x - x) need not be 0.
    if ti.static(not same(body.body_start, body.body_end)):
        x += t * (body.body_end[b] - x)
    return x


@ti.func
def descend(p: vec3, start: ti.i32, t: ti.f32, body: ti.template()) -> ti.i32:
    """Body vertex that is reached from ``start`` by walking to nearer neighbours; t in [0, 1] of the frame."""
    best = start
    offset = between(best, t, body) - p
    distance = offset.dot(offset)
    moved = True
    steps = 0
    while moved and steps < 16:
        moved = False
        steps += 1
        here = best
        for q in range(body.ring_start[here], body.ring_start[here + 1]):
            other = body.ring[q]
            offset = between(other, t, body) - p
            candidate = offset.dot(offset)
            if candidate < distance:
                distance = candidate
                best = other
                moved = True
    return best


@ti.func
def closest_in_fan(p: vec3, b: ti.i32, t: ti.f32, body: ti.template()):
    """Closest point to p [m] of the faces around body vertex b at t in [0, 1] of the frame.

    Two products recognise a face whose closest point is b itself.

    Returns:
        the face's other two corners, the weights of its corners from b on, the squared distance [m2].
    """
    x0 = between(b, t, body)
    offset = p - x0
    distance = offset.dot(offset)
    corners = ti.Vector([b, b])
    weights = vec3(1.0, 0.0, 0.0)
    first = True
    for q in range(body.fan_start[b], body.fan_start[b + 1]):
        others = body.fan[q]
        x1 = between(others[0], t, body)
        x2 = between(others[1], t, body)
        if first:
            corners = others
            first = False
        if (x1 - x0).dot(offset) > 0.0 or (x2 - x0).dot(offset) > 0.0:
            w = closest_on_triangle(p, x0, x1, x2)
            away = offset - w[1] * (x1 - x0) - w[2] * (x2 - x0)
            candidate = away.dot(away)
            if candidate < distance:
                distance = candidate
                corners = others
                weights = w
    return corners, weights, distance


@ti.kernel
def surface_normals(vertices: Vec3, faces: Int3, normals: Vec3):
    """Unit vertex normals of a triangle mesh, weighted by area."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        for i in range(normals.shape[0]):
            normals[i] = vec3(0.0)
        for c in range(faces.shape[0]):
            f = faces[c]
            x0 = vertices[f[0]]
            n = (vertices[f[1]] - x0).cross(vertices[f[2]] - x0)
            for a in ti.static(range(3)):
                normals[f[a]] = normals[f[a]] + n
        for i in range(normals.shape[0]):
            normals[i] = normals[i] / ti.max(normals[i].norm(), 1e-20)
