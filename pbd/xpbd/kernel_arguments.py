"""Arguments of the kernels that a solver makes once for its model, and those that carry internal friction."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pbd.contact.body_search import MAX_CELLS
from pbd.contact.strain_limits import strain_limits
from pbd.model import BLOCK, Model
from pbd.state import State
from pbd.xpbd.multigrid import Multigrid
from pbd.xpbd.stiff_bending import bending_factor, bounded_hinge_data, no_factor

__all__ = ["load_friction", "model_arrays", "multigrid_arrays", "store_friction", "workspace_arrays"]


def model_arrays(model: Model, substep: float, stiff: bool) -> dict[str, np.ndarray]:
    """Arguments of the kernels that belong to the model.

    Args:
        model: the garment.
        substep: the longest [s].
        stiff: whether all hinges are solved at once, see :func:`pbd.xpbd.stiff_bending.is_stiff`.
    """
    names = (
        "triangles", "triangle_blocks", "block_colors", "hinges", "hinge_colors",
        "stitches", "tethers", "tether_lengths", "held", "pressure", "samples", "sample_colors",
    )  # fmt: skip
    if model.plastic_count:
        kept = np.zeros((len(model.hinges), 1, 4), np.float32)  # what the state remembers of friction
        hinge_data = np.concatenate([model.hinge_data, kept], axis=1)
    else:
        hinge_data = model.hinge_data
    factor = no_factor()
    if stiff:
        hinge_data = bounded_hinge_data(model, substep)
        factor = bending_factor(model, hinge_data, substep)
    triangle_data = model.triangle_data
    if model.plastic_shear_count:
        triangle_data = np.pad(triangle_data, ((0, 1), (0, 0)))
    stitch_data = np.zeros((len(model.stitches), 4), np.float32)
    stitch_data[:, 0] = model.stitch_weights
    return {name: getattr(model, name) for name in names} | {
        "stitch_data": stitch_data,
        "hinge_data": hinge_data,
        "bending_factor": factor,
        "triangle_data": triangle_data,
    }


def multigrid_arrays(model: Model, levels: Multigrid, stiff: bool) -> dict[str, np.ndarray]:
    """Arguments of the kernels that belong to the coarser levels.

    Args:
        model: the garment.
        levels: its coarser levels.
        stiff: see :func:`model_arrays`.
    """
    patches = len(levels.inverse_mass)
    names = (
        "parent", "mass_share", "level_starts", "springs", "spring_colors", "color_starts", "spring_data",
        "spring_shares",
    )  # fmt: skip
    written = ("displacement", "patch_centers", "predicted_displacement", "coarse_strain")
    # Made one by one: an array that is the same object as at the last call need not be handed over again.
    arrays = {name: np.zeros((max(1, patches), 4), np.float32) for name in written}
    arrays["displacement"][:patches, 3] = levels.inverse_mass
    workspace = np.zeros((9, len(levels.springs) + BLOCK), np.float32)
    if stiff:
        arrays["patch_centers"] = np.zeros((max(patches, 2 * model.vertex_count), 4), np.float32)
    arrays |= {"children": levels.children(), "spring_workspace": workspace}
    return arrays | {name: getattr(levels, name) for name in names}


def workspace_arrays(model: Model) -> dict[str, np.ndarray]:
    """Arguments of the kernels that hold nothing between two frames."""
    count, samples = model.vertex_count, len(model.samples)
    limits, limit_work = strain_limits(model.mesh, model.fabric.thickness, model.held, True)
    return {
        **{name: np.zeros((count, 4), np.float32) for name in ("position_delta", "velocity_delta", "normals")},
        "contact_points": np.zeros((samples, 3, 4), np.float32),
        "active_samples": np.zeros(2 * samples, np.int32),
        "active_counts": np.zeros((len(model.sample_colors) - 1, 2), np.int32),
        "cell_start": np.zeros(MAX_CELLS + 2, np.int32),
        # Where the cloth does not collide with itself, the bands that nothing carries have limits of stretch:
        "pairs": np.zeros((1, 4), np.int32),
        "pair_data": np.zeros((1, 2, 4), np.float32),
        "ready_pairs": np.zeros(2, np.int32),
        "strain_limits": limits,
        "limit_work": limit_work,
    }


def load_friction(model: Model, state: State, arguments: Mapping[str, Any]) -> None:
    """Hand the kernels what the state remembers of internal friction; they change it as they advance.

    Args:
        model: the garment.
        state: of this model.
        arguments: of the kernels, with those of :func:`model_arrays`.
    """
    if model.plastic_count:
        arguments["hinge_data"][:, 2, 0] = state.plastic_bends[model.hinge_numbers]
    if model.plastic_shear_count:
        arguments["triangle_data"][-1, : len(model.triangles)] = state.plastic_shears[model.triangle_numbers]


def store_friction(model: Model, state: State, arguments: Mapping[str, Any]) -> None:
    """Let the state remember what the kernels made of internal friction; see :func:`load_friction`."""
    if model.plastic_count:
        state.plastic_bends[model.hinge_numbers] = arguments["hinge_data"][:, 2, 0]
    if model.plastic_shear_count:
        state.plastic_shears[model.triangle_numbers] = arguments["triangle_data"][-1, : len(model.triangles)]
