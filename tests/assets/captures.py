"""Captured motions for tests: BVH files written from positions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

__all__ = ["write_bvh"]


def write_bvh(path: Path, names: Sequence[str], parents: Sequence[int], positions: np.ndarray, rate: float) -> Path:
    """Write a BVH file in which every joint has a position of its own in every frame and no rotation.

    Args:
        path: the file.
        names: of the joints, parents first, one root.
        parents: index of each joint's parent, -1 at the root.
        positions: in any unit, shape (f, joints, 3).
        rate: frames a second [Hz].
    """
    order: list[int] = []

    def block(joint: int, indent: str) -> list[str]:
        order.append(joint)
        head = f"{indent}{'JOINT' if parents[joint] >= 0 else 'ROOT'} {names[joint]}"
        lines = [head, indent + "{", f"{indent}  OFFSET 0 0 0", f"{indent}  CHANNELS 3 Xposition Yposition Zposition"]
        children = [child for child in range(len(names)) if parents[child] == joint]
        for child in children:
            lines += block(child, indent + "  ")
        if not children:
            lines += [f"{indent}  End Site", indent + "  {", f"{indent}    OFFSET 0 1 0", indent + "  }"]
        return [*lines, indent + "}"]

    lines = ["HIERARCHY", *block(0, ""), "MOTION", f"Frames: {len(positions)}", f"Frame Time: {1.0 / rate:.9f}"]
    local = positions.copy()
    for joint, parent in enumerate(parents):
        if parent >= 0:
            local[:, joint] -= positions[:, parent]
    lines += [" ".join(f"{value:.7f}" for value in frame[order].ravel()) for frame in local]
    path.write_text("\n".join(lines) + "\n")
    return path
