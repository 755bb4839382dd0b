"""The displacements of patches in float64, for tests."""

import numpy as np

from wrinkles.patches import Patches


def patch_sums(patches: Patches, grids: np.ndarray, frames: np.ndarray) -> np.ndarray:
    """What the patches add to each fine vertex [m], float64, shape (N, 3): turned into space first, read afterwards."""
    count, side = len(grids), patches.grid.side
    spatial = np.einsum("inx,ixy->iny", grids.reshape(count, side**2, 3).astype(float), frames.reshape(count, 3, 3))
    total = np.zeros((len(patches.corners), 3))
    for c in range(3):
        u, v = (patches.within[:, 2 * c + axis, None].astype(float) for axis in (0, 1))
        read = lambda step, c=c: spatial[patches.corners[:, c], patches.cell[:, c] + step]  # noqa: E731
        near = (1 - u) * ((1 - v) * read(0) + v * read(1)) + u * ((1 - v) * read(side) + v * read(side + 1))
        total += patches.blend[:, c, None] * near
    return total
