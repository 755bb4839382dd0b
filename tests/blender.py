"""What scripts that run inside Blender share."""

from __future__ import annotations

import importlib.util

import pytest

__all__ = ["POSED_VERTICES", "require_blender"]

# For the head of a script: a function that gives an object's vertices as its modifiers and its place in the world leave
# them at the current frame [m], float, shape (n, 3). Blender's z is up, and its importers turn the project's y up.
POSED_VERTICES = """
import bpy
import numpy as np

def posed_vertices(item):
    evaluated = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    local = np.zeros(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", local)
    matrix = np.array(evaluated.matrix_world)
    world = local.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
    return np.stack([world[:, 0], world[:, 2], -world[:, 1]], axis=1)
"""


def require_blender() -> None:
    """Skip the test where Blender is not installed as a module."""
    if importlib.util.find_spec("bpy") is None:
        pytest.skip("Blender is not installed as a module: pip install bpy")
