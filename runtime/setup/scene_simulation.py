"""The simulation of a scene: its garments on their body, or one garment that hangs from its pins."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from assets.io.scene import Scene
from assets.motion import Motion
from pbd import InputError, ModelOptions
from runtime.play.simulation import Simulation, body_source
from runtime.setup.garment_mesh import garment_of, in_size, sewn_rest, subdivided, with_subdivisions
from runtime.setup.garment_setup import GarmentSetup, colliders_of, fabric_of, fine_options
from wrinkles.levels import build_levels

__all__ = ["garments_of", "simulation_of"]


def garments_of(scene: Scene, simulation: Simulation) -> dict[str, np.ndarray] | None:
    """Simulated vertices of each garment of an outfit by its name, int, shapes (k,); None for one garment."""
    if len(scene.garments) < 2:
        return None
    layer = simulation.model.layer
    return {garment.name: np.flatnonzero(layer == number) for number, garment in enumerate(scene.garments)}


def simulation_of(
    scene: Scene, fine: bool = False, *, report: Callable[[str], None] | None = None
) -> tuple[Simulation, Motion | None]:
    """The simulation of a scene at its start: garments on a body, or one garment that hangs from its pins.

    Args:
        scene: with one garment, or on a body with several.
        fine: simulate the subdivided mesh.
        report: called with a line where garments start through themselves; None for none.

    Returns:
        the simulation at its start, and the motion of the body, None without one.

    Raises:
        InputError: as :meth:`GarmentSetup.of`; an attached garment without a body, or one that is pinned at a vertex
            which it lacks.
    """
    scene = with_subdivisions(scene)
    if scene.character is not None:
        setup = GarmentSetup.of(scene)
        if report is not None:
            for opening in setup.openings:
                report(str(opening))
        scene, settings, levels, motion = setup.scene, setup.settings, setup.levels, setup.motion()
        source, pose = body_source(setup.body), motion.pose(0.0)
    else:
        settings, garment = garment_of(scene)
        if settings.attach not in ("bands", "none") or settings.attach_vertices:
            raise InputError("nothing to attach to", key="garment[0].attach", expected="pins, or a [character]")
        if settings.limits is not None:
            expected = "a [character]: limits are about where a body carries vertices"
            raise InputError("nothing to be carried by", key="garment[0].limits", expected=expected)
        if max(settings.pins, default=0) >= len(garment.vertices):
            expected = f"0..{len(garment.vertices) - 1}"
            raise InputError("no such vertex", key="garment[0].pins", received=max(settings.pins), expected=expected)
        nothing = np.zeros((0, 3)), np.zeros((0, 3), np.int32)
        garment = in_size(garment, settings, *nothing)
        pins = np.array(settings.pins, int)
        garment, pins, *_ = subdivided(garment, pins, None, settings.coarse_subdivisions)
        levels = build_levels(
            garment.vertices,
            garment.faces,
            pins,
            *nothing,
            settings.subdivision_count,
            sewn=sewn_rest(garment),
        )
        motion = source = pose = None
    attachment = levels.fine_attachment if fine else levels.coarse_attachment
    cuts = max(garment.subdivisions_of_mesh for garment in scene.garments)
    options = fine_options(scene, cuts) if fine else scene.solver.options()
    model = levels.model(fabric_of(settings), ModelOptions(pressure=settings.pressure), fine=fine)
    return Simulation(model, attachment if source else None, source, pose, options, colliders_of(scene)), motion
