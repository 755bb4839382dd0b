"""How fast the parts of a frame could be on this machine: a memory copy of the bytes that they must read and write.

A network is limited by a matrix product instead. Both speeds are measured.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import numpy as np
from threadpoolctl import threadpool_limits

from pbd import Body, Model
from wrinkles.database import WrinkleDatabase
from wrinkles.levels import Levels
from wrinkles.patches import Grid
from wrinkles.relaxation import PASSES

__all__ = ["MachineSpeed", "cloth_bytes", "layer_bytes", "machine_speed", "network_products", "normal_bytes"]

REPEATS = 24
COPIED = 2**24  # float32 that are copied: 64 MiB, more than the caches hold, which a game uses between two frames
WIDTH = 512  # of the matrix product that is measured
# Bytes of a vertex: position and normal in float32, the state's position and velocity.
POINT, POSITION, VELOCITY = 12, 16, 12
FACE = 12  # three corners
TRIANGLE = FACE + 48  # vertices and twelve numbers
ENTRY = 8  # of a sparse matrix: column and value
PLACE = 24  # of a fine vertex on the coarse mesh: three coarse vertices and their weights


class MachineSpeed:
    """Speeds of this machine on one core.

    Args:
        copy_bytes_per_ms: read and written by a copy [1/ms].
        products_per_ms: multiply-adds of float32 in a matrix product [1/ms].
    """

    def __init__(self, copy_bytes_per_ms: float, products_per_ms: float) -> None:
        self.copy_bytes_per_ms, self.products_per_ms = copy_bytes_per_ms, products_per_ms

    def figures(self) -> dict[str, float]:
        """``memory_copy_gb_s``: read and written; ``blas_gflop_s``: a multiply-add counts as two."""
        return {
            "memory_copy_gb_s": self.copy_bytes_per_ms * 1e-6,
            "blas_gflop_s": 2.0 * self.products_per_ms * 1e-6,
        }


def machine_speed(rows: int) -> MachineSpeed:
    """Measure the speeds.

    Args:
        rows: of the matrix that is multiplied: coarse vertices.
    """
    source, copied = np.ones(COPIED, np.float32), np.zeros(COPIED, np.float32)
    generator = np.random.default_rng(0)
    left = generator.standard_normal((rows, WIDTH)).astype(np.float32)
    product = np.zeros((rows, WIDTH), np.float32)
    right = generator.standard_normal((WIDTH, WIDTH)).astype(np.float32)
    with threadpool_limits(1, user_api="blas"):
        copy_ms = _median_ms(lambda: np.copyto(copied, source))
        product_ms = _median_ms(lambda: np.matmul(left, right, out=product))
    return MachineSpeed(2 * source.nbytes / copy_ms, rows * WIDTH * WIDTH / product_ms)


def _median_ms(run: Callable[[], object]) -> float:
    times = np.zeros(REPEATS)
    for repeat in range(REPEATS):
        begin = time.perf_counter()
        run()
        times[repeat] = time.perf_counter() - begin
    return 1e3 * float(np.median(times[REPEATS // 4 :]))


def cloth_bytes(model: Model, body: Body) -> dict[str, float]:
    """Bytes that the parts of a simulated garment must at least read and write, by part.

    Skinning reads place and faces of each body vertex and writes place and normal; preparation reads and writes the
    state; the search reads the body's places and normals and the cloth, and writes a body vertex for each of its own.
    """
    count, body_count = model.vertex_count, len(body.current)
    return {
        "skinning": 3 * POINT * body_count + FACE * len(body.faces),
        "preparation": 2 * (POSITION + VELOCITY) * count,
        "search": 2 * POINT * body_count + (POSITION + 4) * count,
    }


def layer_bytes(levels: Levels, body: Body) -> dict[str, float]:
    """Bytes that the parts of the wrinkle layer must at least read and write, by part.

    The surface reads coarse vertices, grids, means and the place of each fine vertex, and writes the fine vertices;
    relaxation reads the body, and in each pass the triangles, the bending sweep and the fine vertices, which it writes
    again. The sweep has for each vertex a row of itself, its neighbours and those across from these.
    """
    coarse, fine = levels.subdivision.coarse_count, len(levels.fine.vertices)
    subdivisions, faces = len(levels.subdivision.steps), len(levels.fine.faces)
    edges = len(levels.fine.edge_lengths()[1])
    hinges = 3 * faces - edges  # edges with a face on both sides
    each_pass = TRIANGLE * faces + ENTRY * (fine + 2 * edges + 2 * hinges) + 2 * POSITION * fine
    return {
        "surface": (POSITION + 4 * 3 * Grid.of(subdivisions).nodes) * coarse + (2 * POINT + PLACE) * fine,
        "relaxation": PASSES * each_pass + 2 * POINT * (fine + len(body.current)),
        "normals": normal_bytes(fine, faces),
    }


def normal_bytes(vertex_count: int, face_count: int) -> float:
    """Bytes that normals of a mesh must read and write."""
    return 2.0 * POINT * vertex_count + FACE * face_count


def network_products(database: WrinkleDatabase) -> float:
    """Multiply-adds of the network and its atoms in a frame.

    Bias of places and fabrics is added once for all frames, see :class:`wrinkles.dictionary.CoefficientNetwork`.
    """
    arrays: Mapping[str, np.ndarray] = database.mapping.arrays()
    layers = [array.shape[-2:] for name, array in arrays.items() if name.startswith("weights")]
    each = sum(inputs * outputs for inputs, outputs in layers) + database.atoms.shapes.size
    return float(each * len(database.coarse_vertices))
