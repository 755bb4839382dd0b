"""Garments that start through themselves or through one another, opened before they are simulated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from pbd import ClothMesh, Fabric, SolverOptions
from pbd.crossings import SelfCrossings
from pbd.opening import smoothed_apart
from runtime.simulation import Simulation
from wrinkles.levels import Levels

__all__ = ["Opening", "opened"]

MAX_FRAMES = 30  # in which layers come apart
FRAME = 1.0 / 60.0  # [s]


@dataclass(frozen=True)
class Opening:
    """What was opened of the start of one mesh.

    Attributes:
        mesh: "coarse" or "fine".
        before, after: faces that cross another one.
        faces: of the mesh.
        moved: farthest way of a vertex [m].
        left: middle of the crossings that are left [m], shape (3,); None where there are none.
    """

    mesh: str
    before: int
    after: int
    faces: int
    moved: float
    left: np.ndarray | None

    def __str__(self) -> str:
        text = (
            f"the {self.mesh} garment starts through itself in {self.before} of {self.faces} faces: opened by moving "
            f"vertices up to {1e3 * self.moved:.0f} mm, {self.after} are left"
        )
        if self.left is None:
            return text
        place = ", ".join(f"{x:.2f}" for x in self.left)
        return f"{text}, around ({place}) m; part the sheets there in the mesh, or wear the garment less tight"


@dataclass
class _Still:
    """A body that stands still, see :class:`runtime.simulation.BodySource`."""

    vertices: np.ndarray
    faces: np.ndarray

    def skin(self, pose: np.ndarray, origin: np.ndarray, out: np.ndarray) -> None:
        out[:] = pose - origin


def opened(
    levels: Levels,
    fabric: Fabric,
    options: SolverOptions,
    fine_options: SolverOptions,
    body_vertices: np.ndarray,
    body_faces: np.ndarray,
    rebuilt: Callable[[np.ndarray], Levels],
) -> tuple[Levels, tuple[Opening, ...]]:
    """Levels whose meshes do not go through themselves, as far as they can be opened, and what was done.

    A garment is smoothed where it goes through itself. Layers know their sides: the solver brings them apart while body
    and time stand still.

    Args:
        levels: of the garments.
        fabric: of the innermost one.
        options, fine_options: of the solver of the coarse and of the fine garment.
        body_vertices, body_faces: in the bind pose [m], shapes (b, 3) and (k, 3).
        rebuilt: makes the levels of the same garments with other coarse vertices [m], shape (n, 3).
    """
    done, delivered = [], levels.fine.vertices
    for name, solver in (("coarse", options), ("fine", fine_options)):
        fine = name == "fine"
        mesh, held = (levels.fine, levels.fine_held) if fine else (levels.coarse, levels.coarse_held)
        crossings = SelfCrossings(mesh)
        rows = crossings.find(mesh.vertices)
        if not len(rows):
            continue
        before, start = len(crossings.faces_of(rows)), mesh.vertices
        layer = None if levels.layers is None else (levels.fine_layer if fine else levels.layers.layer)
        free = replace(mesh, vertices=smoothed_apart(mesh, held, layer, body_vertices, body_faces))
        rows = crossings.find(free.vertices)
        if layer is not None and len(rows):
            free = _parted(levels, free, fabric, solver, fine, _Still(body_vertices, body_faces))
            rows = crossings.find(free.vertices)
        after = len(crossings.faces_of(rows))
        if after >= before:
            free, after = mesh, before
        moved = float(np.linalg.norm(free.vertices - start, axis=1).max())
        left = free.vertices[rows[:, 0]].mean(axis=0) if after else None
        done.append(Opening(name, before, after, len(mesh.faces), moved, left))
        levels = replace(levels, fine=free) if fine else rebuilt(free.vertices)
        if not fine and levels.subdivision.binding is not None:  # its folds are its own
            levels = replace(levels, fine=replace(levels.fine, vertices=delivered))
    return levels, tuple(done)


def _parted(
    levels: Levels, mesh: ClothMesh, fabric: Fabric, options: SolverOptions, fine: bool, body: _Still
) -> ClothMesh:
    """The mesh after a simulation without weight and speed, in which layers that are through one another part."""
    still = replace(options, gravity=(0.0, 0.0, 0.0))
    attachment = levels.fine_attachment if fine else levels.coarse_attachment
    simulation = Simulation(
        levels.model(fabric, fine=fine, mesh=mesh), attachment, body, np.array(body.vertices, float), still
    )
    crossings = SelfCrossings(mesh)
    for _ in range(MAX_FRAMES):
        simulation.step(body.vertices, FRAME)
        simulation.state.velocity[:] = 0.0
        if not len(crossings.find(simulation.state.world())):
            break
    return replace(mesh, vertices=simulation.state.world())
