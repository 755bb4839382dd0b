"""Whether any edge of a garment is long."""

from pbd.engine import ti
from pbd.geometry import Float1, Int1, Int2, Vec4, xyz

__all__ = ["find_longer"]


@ti.kernel
def find_longer(position: Vec4, edges: Int2, squares: Float1, found: Int1):
    """Write to ``found`` how many edges are not shorter than given lengths, of which it takes the squares [m2]."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        count = 0
        for e in range(edges.shape[0]):
            ends = edges[e]
            side = xyz(position[ends[0]]) - xyz(position[ends[1]])
            count += ti.select(side.dot(side) < squares[e], 0, 1)
        found[0] = count
