"""Cloth hardly stretches and hardly shortens: the edges of the middle mesh are brought back to length after decoding.

What cannot be told is left out by the mapping, and the length of the folds that it leaves out is missing. Edges that
are too short push apart and those that are too long pull together; folds that are there grow by that, as in wrinkle
meshes (Mueller and Chentanez 2010), but from a first guess that is learned. On the fine mesh the same makes zigzags,
edge by edge; the middle mesh has no room for them, and what it moves by is spread to the fine one by Loop's rule.
"""

import numpy as np

from pbd.engine import ensure_initialized, ti
from pbd.geometry import Float1, Int1, Int2, Vec3, vec3
from pbd.mesh import greedy_colors
from pbd.taichi_internals import Launch
from wrinkles.levels import Levels, held_between
from wrinkles.surface import Subdivision, csr_arrays

__all__ = ["Isometry", "middle_edges"]

PASSES = 8


@ti.kernel
def _keep_lengths(vertices: Vec3, inverse_mass: Float1, edges: Int2, lengths: Float1, passes: ti.i32):
    ti.loop_config(serialize=True)
    for _ in range(1):
        for _pass in range(passes):
            for c in range(edges.shape[0]):
                i, j = edges[c][0], edges[c][1]
                d = vertices[j] - vertices[i]
                size = d.norm()
                total = inverse_mass[i] + inverse_mass[j]
                d *= (size - lengths[c]) / ti.max(size * total, 1e-12)
                vertices[i] += inverse_mass[i] * d
                vertices[j] -= inverse_mass[j] * d


@ti.kernel
def _spread(start: Int1, index: Int1, value: Float1, before: Vec3, middle: Vec3, fine: Vec3):
    ti.loop_config(serialize=True)
    for _ in range(1):
        for i in range(middle.shape[0]):
            before[i] = middle[i] - before[i]
        for i in range(fine.shape[0]):
            total = vec3(0.0)
            for q in range(start[i], start[i + 1]):
                total += value[q] * before[index[q]]
            fine[i] += total


class Isometry:
    """Sweeps over the edges of the middle mesh, both ways; held vertices stay.

    A delivered mesh is left as it is: the length that its smooth surface lacks in pleats is in its vertex mean.

    Args:
        levels: of the garment.
    """

    def __init__(self, levels: Levels) -> None:
        ensure_initialized()
        edges, lengths = middle_edges(levels)
        middle = levels.subdivision.middle
        self._delivered = levels.subdivision.binding is not None
        self._inverse_mass = np.ones(middle.fine_count, np.float32)
        self._inverse_mass[held_between(middle, levels.coarse_held)] = 0.0
        free = self._inverse_mass[edges].any(axis=1)
        edges, lengths = edges[free], lengths[free]
        order = np.argsort(greedy_colors(edges, middle.fine_count), kind="stable")
        self._edges = np.ascontiguousarray(edges[order], np.int32)
        self._lengths = lengths[order].astype(np.float32)
        self._from_middle = csr_arrays(levels.subdivision.from_middle)
        self._before = np.zeros((middle.fine_count, 3), np.float32)
        self._keep_lengths, self._spread = Launch(_keep_lengths), Launch(_spread)

    def __call__(self, middle: np.ndarray, fine: np.ndarray, passes: int = PASSES) -> None:
        """Bring the edges of the middle mesh nearer to their lengths, and move the fine mesh along.

        Args:
            middle, fine: [m], float32, shapes (q, 3), (N, 3); changed in place.
            passes: sweeps over all edges.
        """
        if self._delivered:
            return
        self._before[:] = middle
        self._keep_lengths(middle, self._inverse_mass, self._edges, self._lengths, passes)
        self._spread(*self._from_middle, self._before, middle, fine)


def middle_edges(levels: Levels) -> tuple[np.ndarray, np.ndarray]:
    """Edges of the middle mesh, int32, shape (e, 2), and their rest lengths along the fine surface [m], shape (e,)."""
    whole = levels.subdivision
    upper = Subdivision.of(whole.middle.faces, whole.middle.fine_count, len(whole.steps) - 1, whole.binding)
    # Points of the fine surface, so that the smooth surface through them is the fine one.
    vertices = whole.cut_surface(levels.coarse.vertices)[: whole.middle.fine_count]
    return upper.meshes(vertices)[0].edge_lengths()
