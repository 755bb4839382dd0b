"""Which mesh is simulated: the finest whose frame takes no longer than a scene's budget.

What is simulated on a finer mesh with more substeps is nearer to the truth, and dearer (`docs/lab-notes/
levels-that-pay.md`), so the finest that fits is the best that fits. The fine mesh is the same for all choices.
"""

from __future__ import annotations

from dataclasses import replace

from assets.io.scene import Scene
from pbd import InputError
from runtime.garment_mesh import with_subdivisions

__all__ = ["choice_of", "choices_within_budget"]


def choices_within_budget(scene: Scene) -> list[Scene]:
    """The scene with each mesh that may be simulated, and its numbers of substeps, the finest first.

    The meshes are those below the fine one. The substep is that of the scene, or halved up to as often as the mesh is
    subdivided before it is simulated.

    Returns:
        the scene itself where it names no budget.

    Raises:
        InputError: a budget without a held-out motion to time it on, or for a garment whose mesh is decimated.
    """
    budget = scene.wrinkles.budget_ms
    if budget is None:
        return [scene]
    key = "wrinkles.budget_ms"
    if not scene.training.held_out:
        raise InputError("a budget without motion to time", key=key, received=budget, expected="training.held_out")
    for garment in scene.garments:
        if garment.coarse_vertices is not None:
            expected = f"none: {garment.name} names the mesh that is simulated by coarse_vertices"
            raise InputError("a budget for a decimated mesh", key=key, received=budget, expected=expected)
    scene = with_subdivisions(scene)
    cuts = [garment.subdivisions_of_mesh for garment in scene.garments]
    choices = []
    for left in range(1, max(cuts) + 1):
        garments = tuple(
            replace(garment, subdivisions=min(left, count), coarse_subdivisions=count - min(left, count))
            for garment, count in zip(scene.garments, cuts, strict=True)
        )
        for halved in range(max(cuts) - left, -1, -1):
            solver = replace(scene.solver, substep=scene.solver.substep / 2.0**halved)
            choices.append(replace(scene, garments=garments, solver=solver))
    return choices


def choice_of(scene: Scene, vertices: int) -> str:
    """What a choice simulates, in words."""
    substeps = max(1, round(1.0 / (scene.solver.frame_rate * scene.solver.substep)))
    return f"{vertices} vertices, {substeps} substeps"
