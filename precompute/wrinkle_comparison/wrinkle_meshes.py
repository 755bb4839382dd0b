"""Wrinkle meshes (Mueller and Chentanez 2010): folds from the fine mesh's own lengths, with no data.

"Wrinkle meshes", Symposium on Computer Animation. A static solver moves the fine vertices of a frame: edges keep their
lengths, corners across an edge their distance, more softly, and no vertex goes further than a radius from its place
on the smooth surface. A frame begins with the last one's displacements.
"""

from dataclasses import dataclass

import numpy as np

from pbd.engine import ensure_initialized, ti
from pbd.geometry import Float1, Int2, Vec3
from pbd.mesh import greedy_colors, hinges_of
from pbd.taichi_internals import Launch
from wrinkles.levels import Levels

__all__ = ["WrinkleMesh", "WrinkleMeshOptions"]


@dataclass(frozen=True)
class WrinkleMeshOptions:
    """Settings that are tuned.

    Attributes:
        radius: that a vertex may go from the smooth surface, in mean edges of the fine mesh.
        bending: share of an error that a bending constraint takes back, 0..1.
        iterations: over all constraints, in a frame.
    """

    radius: float = 0.5
    bending: float = 0.2
    iterations: int = 5


@ti.kernel
def _settle(
    fine: Vec3,
    displacement: Vec3,
    smooth: Vec3,
    inverse_mass: Float1,
    pairs: Int2,
    lengths: Float1,
    stiffness: Float1,
    radius: ti.f32,
    iterations: ti.i32,
):
    ti.loop_config(serialize=True)
    for _ in range(1):
        for i in range(fine.shape[0]):
            smooth[i] = fine[i]
            fine[i] += displacement[i]
        for _iteration in range(iterations):
            for c in range(pairs.shape[0]):
                i, j = pairs[c][0], pairs[c][1]
                d = fine[j] - fine[i]
                size = ti.max(d.norm(), 1e-9)
                d *= stiffness[c] * (size - lengths[c]) / (size * (inverse_mass[i] + inverse_mass[j]))
                fine[i] += inverse_mass[i] * d
                fine[j] -= inverse_mass[j] * d
            for i in range(fine.shape[0]):
                offset = fine[i] - smooth[i]
                size = offset.norm()
                if size > radius:
                    fine[i] = smooth[i] + offset * (radius / size)
        for i in range(fine.shape[0]):
            displacement[i] = fine[i] - smooth[i]


class WrinkleMesh:
    """The wrinkles of one garment, from one frame to the next.

    Args:
        levels: of the garment; held vertices do not move.
        options: see :class:`WrinkleMeshOptions`.
    """

    def __init__(self, levels: Levels, options: WrinkleMeshOptions) -> None:
        ensure_initialized()
        mesh, count = levels.fine, len(levels.fine.vertices)
        edges, lengths = mesh.edge_lengths()
        across = hinges_of(mesh.faces)[:, 2:]
        apart = np.linalg.norm(mesh.vertices[across[:, 0]] - mesh.vertices[across[:, 1]], axis=1)
        inverse_mass = np.ones(count, np.float32)
        inverse_mass[levels.fine_held] = 0.0
        parts = []
        for pairs, rest, share in ((edges, lengths, 1.0), (across, apart, options.bending)):
            free = inverse_mass[pairs].any(axis=1)
            pairs, rest = pairs[free], rest[free]
            order = np.argsort(greedy_colors(pairs, count), kind="stable")
            parts.append((pairs[order], rest[order], np.full(len(pairs), share)))
        pairs, rest, share = (np.concatenate(column) for column in zip(*parts, strict=True))
        self._pairs = np.ascontiguousarray(pairs, np.int32)
        self._lengths, self._stiffness = rest.astype(np.float32), share.astype(np.float32)
        self._inverse_mass = inverse_mass
        self._radius, self._iterations = options.radius * float(lengths.mean()), options.iterations
        self._displacement, self._smooth = np.zeros((2, count, 3), np.float32)
        self._settle = Launch(_settle)

    def __call__(self, fine: np.ndarray) -> None:
        """Move smooth fine vertices to where they settle [m], float32, shape (N, 3), in place."""
        self._settle(
            fine,
            self._displacement,
            self._smooth,
            self._inverse_mass,
            self._pairs,
            self._lengths,
            self._stiffness,
            self._radius,
            self._iterations,
        )
