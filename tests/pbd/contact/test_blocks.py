"""Faces eight beside each other: the same answers as one by one."""

import numpy as np

from pbd.contact.blocks import (
    CORNERS,
    DISPLACEMENTS,
    HIGH,
    LANES,
    LOW,
    NORMAL,
    Blocks,
    empty_blocks,
    facing,
    features,
    overlapping,
    sides,
    take,
)  # fmt: skip
from pbd.engine import ensure_initialized, ti
from pbd.geometry import Int2

REACH, EDGE_REACH = 0.1, 0.2


@ti.kernel
def ask(blocks: Blocks, answers: Int2):
    """What each face of the first block is told of the second: two rows of answers, then one for each other face."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        for a in range(LANES):
            low, high = take(blocks, 0, LOW, a), take(blocks, 0, HIGH, a)
            answers[10 * a] = ti.Vector(
                [overlapping(blocks, 1, low, high), facing(blocks, 1, take(blocks, 0, NORMAL, a))]
            )
            beside, uncut = sides(blocks, 0, a, 1, REACH)
            answers[10 * a + 1] = ti.Vector([beside, uncut])
            near = features(blocks, 0, a, 1, REACH, EDGE_REACH)
            for b in range(LANES):
                answers[10 * a + 2 + b] = ti.Vector([near[b], 0])


def box(*points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.min(points, axis=0), np.max(points, axis=0)


def apart(one: tuple, other: tuple) -> float:
    return float(max((one[0] - other[1]).max(), (other[0] - one[1]).max()))


def test_eight_faces_at_once_are_told_as_one_by_one() -> None:
    random = np.random.default_rng(3)
    ensure_initialized()
    corners = (random.normal(size=(2, LANES, 3, 3)) * 0.5).astype(np.float32)
    ways = (random.normal(size=(2, LANES, 3, 3)) * 0.1).astype(np.float32)
    normals = np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    ends = corners + ways
    lows, highs = np.minimum(corners, ends), np.maximum(corners, ends)
    blocks = empty_blocks(2, True)
    for first, parts in ((LOW, lows.min(axis=2)), (HIGH, highs.max(axis=2)), (NORMAL, normals)):
        blocks[:, first : first + 3] = parts.swapaxes(1, 2)
    for first, parts in ((CORNERS, corners), (DISPLACEMENTS, ways)):
        blocks[:, first : first + 9] = parts.reshape(2, LANES, 9).swapaxes(1, 2)
    answers = np.zeros((10 * LANES, 2), np.int32)
    ask(blocks, answers)
    found = answers.reshape(LANES, 10, 2)
    for a in range(LANES):
        for b in range(LANES):
            told = [bool(word >> b & 1) for word in (*found[a, 0], *found[a, 1])]
            faces = [box(lows[k, c].min(axis=0), highs[k, c].max(axis=0)) for k, c in ((0, a), (1, b))]
            beside = uncut = False
            for (k, c), (m, d) in (((0, a), (1, b)), ((1, b), (0, a))):
                heights = (corners[m, d] - corners[k, c, 0]) @ normals[k, c]
                over = heights + (ways[m, d] - ways[k, c, 0]) @ normals[k, c]
                lowest, highest = box(heights, over)
                beside |= bool(lowest.min() > REACH or highest.max() < -REACH)
                uncut |= bool(heights.min() >= 0.0 or heights.max() <= 0.0)
            assert told == [apart(*faces) <= 0.0, bool(normals[0, a] @ normals[1, b] > 0.5), beside, uncut]
            vertices = [[(lows[k, c, n], highs[k, c, n]) for n in range(3)] for k, c in ((0, a), (1, b))]
            edges = [[box(*vertices[k][n], *vertices[k][(n + 1) % 3]) for n in range(3)] for k in range(2)]
            wanted = [apart(vertex, faces[1]) <= REACH for vertex in vertices[0]]
            wanted += [apart(vertex, faces[0]) <= REACH for vertex in vertices[1]]
            for edge in edges[0]:
                wanted += [apart(edge, other) <= EDGE_REACH for other in edges[1]]
            assert found[a, 2 + b, 0] == sum(1 << n for n, near in enumerate(wanted) if near)


def test_empty_lanes_are_near_nothing() -> None:
    ensure_initialized()
    answers = np.zeros((10 * LANES, 2), np.int32)
    blocks = empty_blocks(2, True)
    blocks[0] = 0.0
    ask(blocks, answers)
    assert (answers.reshape(LANES, 10, 2)[:, 0, 0] == 0).all()
