"""Contact with planes, spheres and capsules for the float64 solvers: by position and by exact forces."""

from __future__ import annotations

import numpy as np
from scipy.sparse import bsr_matrix, csr_matrix

from pbd.contact.colliders import Colliders, DistanceField
from pbd.errors import InputError

__all__ = ["ContactForces", "Cushion", "Obstacles"]

THINNEST = 0.05  # of the thickness; from there on the law goes on along its slope
PUSH_OUT = 0.5  # cloth that starts a step inside an obstacle comes out no faster than this against its surface [m/s]


class Obstacles:
    """The primitives of one substep, in the world, at its start and end.

    Args:
        rows: as :meth:`pbd.Colliders.rows` gives them, about the world's origin, float64, shape (k, 14).
        start, end: part of the frame that has passed at the substep's start and end [-].
        thickness: kept from each surface [m].
    """

    def __init__(self, rows: np.ndarray, start: float, end: float, thickness: float) -> None:
        self.kinds, self.radii, self.thickness = rows[:, 0].astype(int), rows[:, 1], thickness
        first, second = rows[:, 2:8].reshape(-1, 2, 3), rows[:, 8:].reshape(-1, 2, 3)
        self.before, self.now = first + start * (second - first), first + end * (second - first)
        for pose in (self.before, self.now):  # normals of planes come in float32
            pose[self.kinds == 0, 1] /= np.linalg.norm(pose[self.kinds == 0, 1], axis=1, keepdims=True)

    @classmethod
    def of_frame(cls, colliders: Colliders, origin: np.ndarray) -> np.ndarray:
        """Rows of a frame for the constructor. Called once a frame: the colliders remember where they were.

        Raises:
            InputError: a body or a distance field, which these solvers do not know.
        """
        if colliders.body is not None:
            expected = "planes, spheres and capsules"
            raise InputError("a collider that this solver does not know", key="colliders.body", expected=expected)
        if any(isinstance(primitive, DistanceField) for primitive in colliders.primitives):
            expected = "planes, spheres and capsules"
            raise InputError("a collider that this solver does not know", key="colliders.primitives", expected=expected)
        rows = colliders.rows(origin).astype(float)
        for columns in (slice(2, 5), slice(8, 11)):
            rows[:, columns] += origin
        for columns in (slice(5, 8), slice(11, 14)):
            rows[rows[:, 0] == 2.0, columns] += origin
        return rows

    def gaps(self, x: np.ndarray, at_start: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Distance of each vertex to each surface less the thickness [m], shape (n, k), and normals, (n, k, 3)."""
        gaps, normals = np.zeros((len(x), len(self.kinds))), np.zeros((len(x), len(self.kinds), 3))
        for c, (kind, radius) in enumerate(zip(self.kinds, self.radii, strict=True)):
            a, b = (self.before if at_start else self.now)[c]
            if kind == 0:
                normals[:, c], gaps[:, c] = b, (x - a) @ b - self.thickness
                continue
            offset = x - a
            if kind == 2:
                offset = offset - self._shares(x, c)[:, None] * (b - a)
            size = np.linalg.norm(offset, axis=1)
            safe = np.maximum(size, 1e-12)
            normals[:, c] = np.where(size[:, None] > 1e-12, offset / safe[:, None], [0.0, 1.0, 0.0])
            gaps[:, c] = size - radius - self.thickness
        return gaps, normals

    def carried(self, x: np.ndarray) -> np.ndarray:
        """Motion of the touched points over the substep [m], shape (n, k, 3)."""
        moved = self.now - self.before
        carried = np.zeros((len(x), len(self.kinds), 3))
        for c, kind in enumerate(self.kinds):
            carried[:, c] = moved[c, 0]
            if kind == 2:
                carried[:, c] += self._shares(x, c)[:, None] * (moved[c, 1] - moved[c, 0])
        return carried

    def _shares(self, x: np.ndarray, c: int) -> np.ndarray:
        """Place along a capsule's axis, 0 to 1, shape (n,)."""
        a, b = self.now[c]
        return np.clip((x - a) @ (b - a) / max(float((b - a) @ (b - a)), 1e-20), 0.0, 1.0)

    def correction(self, x: np.ndarray, start: np.ndarray, free: np.ndarray, friction: float, h: float) -> np.ndarray:
        """Positions put out of the obstacles, with Coulomb friction on the way since the substep's start.

        The same law as :func:`pbd.xpbd.constraints.contact_correction`.

        Args:
            x: positions that a step came to [m], shape (n, 3).
            start: positions at its start [m], shape (n, 3).
            free: vertices that may be moved, int, shape (f,).
            friction: Coulomb coefficient [-].
            h: substep [s].

        Returns:
            Corrections [m], shape (n, 3).
        """
        total = np.zeros_like(x)
        for c in range(len(self.kinds)):
            gaps, normals = self.gaps(x + total)
            gap, normal = gaps[:, c], normals[:, c]
            slip = x + total - start - self.carried(x + total)[:, c]
            along = np.einsum("ni,ni->n", slip, normal)
            depth = np.clip(np.minimum(-gap, h * PUSH_OUT - along), 0.0, None)
            tangential = slip - along[:, None] * normal
            size = np.linalg.norm(tangential, axis=1)
            share = np.minimum(depth * friction / np.maximum(size, 1e-20), 1.0)
            pushed = depth[:, None] * normal - share[:, None] * tangential
            total[free] += np.where((gap < 0.0)[:, None], pushed, 0.0)[free]
        return total


class Cushion:
    """Cloth that gives way to pressure through its thickness: van Wyk's law, P = p_c ((T0/T)^3 - 1).

    C. M. van Wyk, Note on the compressibility of wool, Journal of the Textile Institute 37 (1946).

    Args:
        pressure: p_c [Pa], above 0.
        thickness: T0 [m].
        area: of each vertex [m2], shape (n, 1).
    """

    def __init__(self, pressure: float, thickness: float, area: np.ndarray) -> None:
        self.pressure, self.thickness, self.area = pressure, thickness, area

    def _parts(self, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Depth within the law and beyond it [m], and T0/T."""
        pressed = np.clip(depth, 0.0, (1.0 - THINNEST) * self.thickness)
        return pressed, np.maximum(depth - pressed, 0.0), self.thickness / (self.thickness - pressed)

    def force(self, depth: np.ndarray) -> np.ndarray:
        """Of each vertex at a depth under its thickness [N]."""
        _, beyond, ratio = self._parts(depth)
        return self.area * self.pressure * (ratio**3 - 1.0 + 3.0 * ratio**4 * beyond / self.thickness)

    def stiffness(self, depth: np.ndarray) -> np.ndarray:
        """Derivative of the force [N/m]."""
        return self.area * self.pressure * 3.0 * self._parts(depth)[2] ** 4 / self.thickness * (depth > 0.0)

    def depth(self, force: np.ndarray) -> np.ndarray:
        """How far a force [N] presses each vertex in, within the law [m]."""
        ratio = np.cbrt(1.0 + force / np.maximum(self.area * self.pressure, 1e-300))
        return self.thickness * np.minimum(1.0 - 1.0 / ratio, 1.0 - THINNEST)

    def energy(self, depth: np.ndarray) -> np.ndarray:
        """Integral of the force [J]."""
        pressed, beyond, ratio = self._parts(depth)
        within = 0.5 * self.thickness * (ratio**2 - 1.0) - pressed
        more = (ratio**3 - 1.0) * beyond + 1.5 * ratio**4 * beyond**2 / self.thickness
        return self.area * self.pressure * (within + more)


class ContactForces:
    """Contact and Coulomb friction as forces of an implicit step, by an augmented Lagrangian.

    With the normal forces of the last round as friction's limit, all is a convex potential that Newton's method can
    minimise beside the cloth's own; between two minimisations :meth:`update` takes over the forces. At the end gaps are
    closed and what sticks has not moved: nothing is regularised, so nothing creeps (Alart and Curnier 1991; Simo and
    Laursen 1992).

    Args:
        obstacles: of this substep.
        start: positions at the substep's start [m], shape (n, 3).
        free: vertices that feel contact, int, shape (f,).
        stiffness: r of each vertex [N/m], shape (n,); the time to settle depends on it, the result does not.
        friction: Coulomb coefficient [-].
        h: substep [s]; infinite where there is no time.
        memory: what the last substep's contact remembered; None to begin.
        cushion: cloth that gives way through its thickness; None closes gaps exactly.

    Attributes:
        memory: normal forces [N], shape (n, k), and friction [N], shape (n, k, 3).
    """

    def __init__(
        self,
        obstacles: Obstacles,
        start: np.ndarray,
        free: np.ndarray,
        stiffness: np.ndarray,
        friction: float,
        h: float,
        memory: tuple[np.ndarray, np.ndarray] | None,
        cushion: Cushion | None = None,
    ) -> None:
        self.cushion = cushion
        self.obstacles, self.start, self.friction, self.r = obstacles, start, friction, stiffness[:, None]
        self.feels = np.zeros((len(start), 1), bool)
        self.feels[free] = True
        gaps, self.normals = obstacles.gaps(start, at_start=True)
        self.floor = np.zeros_like(gaps) if cushion else np.minimum(0.0, gaps + PUSH_OUT * h)
        self.carried = obstacles.carried(start)
        if memory is None or memory[0].shape != gaps.shape:
            memory = np.zeros_like(gaps), np.zeros_like(self.normals)
        pressed, rubbed = memory
        self.memory = pressed, rubbed - (rubbed * self.normals).sum(axis=2)[..., None] * self.normals

    def energy(self, x: np.ndarray) -> float:
        pressed, tried = self._pressed(x)[0], self._tried(x)
        size = np.linalg.norm(tried, axis=2)
        beyond = np.maximum(0.0, size - self.friction * self.memory[0])
        rubbed = float((0.5 * (size**2 - beyond**2) / self.r).sum())
        if self.cushion:
            return rubbed + float((self.cushion.energy(self._depth(x)) * self.feels).sum())
        return rubbed + float((0.5 * pressed**2 / self.r).sum())

    def gradient(self, x: np.ndarray) -> np.ndarray:
        pressed, normals = self._pressed(x)
        return -(pressed[:, :, None] * normals + self._rubbed(self._tried(x))).sum(axis=1)

    def hessian(self, x: np.ndarray) -> csr_matrix:
        pressed, normals = self._pressed(x)
        rate = self.cushion.stiffness(self._depth(x)) if self.cushion else self.r
        blocks = np.einsum("nk,nki,nkj->nij", rate * (pressed > 0.0), normals, normals)
        tried = self._tried(x)
        size = np.linalg.norm(tried, axis=2)
        limit = self.friction * self.memory[0]
        slides = size > limit
        unit = tried / np.maximum(size, 1e-300)[..., None]
        across = np.eye(3) - self.normals[..., None] * self.normals[:, :, None]
        across -= slides[..., None, None] * unit[..., None] * unit[:, :, None]
        # Without a limit there is no friction at all, neither stuck nor sliding.
        share = np.where(slides, limit / np.maximum(size, 1e-300), limit > 0.0)
        blocks += np.einsum("nk,nkij->nij", self.r * share, across)
        rows = np.arange(len(x))
        return bsr_matrix((blocks, rows, np.arange(len(x) + 1)), shape=(3 * len(x), 3 * len(x))).tocsr()

    def update(self, x: np.ndarray, least: float) -> float:
        """Take over the forces at a minimum. Returns their largest change over the largest of them.

        Forces that a move of ``least`` [m] makes are none.
        """
        rubbed = self._rubbed(self._tried(x))
        pressed, self.normals = self._pressed(x)
        self.carried = self.obstacles.carried(x)
        rubbed -= (rubbed * self.normals).sum(axis=2)[..., None] * self.normals
        # Friction already keeps the limit that the next round has.
        size, limit = np.linalg.norm(rubbed, axis=2), self.friction * pressed
        rubbed *= np.minimum(1.0, limit / np.maximum(size, 1e-300))[..., None]
        change = np.abs(pressed - self.memory[0]) + np.linalg.norm(rubbed - self.memory[1], axis=2)
        self.memory = pressed, rubbed
        return float((change / np.maximum(pressed.max(initial=0.0), self.r * least)).max(initial=0.0))

    def reach(self, least: float) -> np.ndarray:
        """Move of each vertex that changes its forces by the largest [m], shape (n,); infinite where it feels none."""
        pressed, r = self.memory[0], self.r[:, 0]
        if self.cushion:
            depth = self.cushion.depth(pressed.max(axis=1, initial=0.0)[:, None])
            r = np.maximum(r, self.cushion.stiffness(depth)[:, 0])
        return np.where(pressed.max(axis=1, initial=0.0) > r * least, pressed.max(initial=0.0) / r, np.inf)

    def _pressed(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Normal forces [N], shape (n, k), and normals."""
        gaps, normals = self.obstacles.gaps(x)
        if self.cushion:
            return self.cushion.force(self.floor - gaps) * self.feels, normals
        return np.maximum(0.0, self.memory[0] - self.r * (gaps - self.floor)) * self.feels, normals

    def _depth(self, x: np.ndarray) -> np.ndarray:
        """How far each vertex is nearer than its thickness [m], shape (n, k)."""
        return self.floor - self.obstacles.gaps(x)[0]

    def _tried(self, x: np.ndarray) -> np.ndarray:
        """Friction that would hold all [N], shape (n, k, 3)."""
        slip = (x - self.start)[:, None] - self.carried
        slip -= (slip * self.normals).sum(axis=2)[..., None] * self.normals
        tried = self.memory[1] - self.r[..., None] * slip
        return np.where((self.memory[0] > 0.0)[..., None], tried, 0.0)

    def _rubbed(self, tried: np.ndarray) -> np.ndarray:
        """The nearest that Coulomb's law allows [N], shape (n, k, 3)."""
        size = np.linalg.norm(tried, axis=2)
        return tried * np.minimum(1.0, self.friction * self.memory[0] / np.maximum(size, 1e-300))[..., None]
