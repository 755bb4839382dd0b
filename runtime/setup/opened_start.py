"""Garments that start through themselves or through one another, opened before they are simulated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from pbd import ClothMesh, Fabric, SolverOptions
from pbd.crossings import SelfCrossings, seams_of
from pbd.opening import smoothed_apart
from runtime.play.simulation import Simulation
from wrinkles.levels import Levels

__all__ = ["Opening", "opened", "opened_fine"]

MAX_FRAMES = 30  # in which layers come apart
FRAME = 1.0 / 60.0  # [s]
COINCIDENT = 1e-7  # vertices so near one another are in one place [m]


@dataclass(frozen=True)
class Opening:
    """What was opened of the start of one mesh.

    Attributes:
        mesh: "coarse" or "fine".
        before, after: faces that cross another one.
        faces: of the mesh.
        moved: farthest way of a vertex [m].
        left: middle of the crossings that are left [m], shape (3,); None where there are none.
        coincident: faces that lie in another sheet: these have no right side, and are left as they are.
        place: middle of those [m], shape (3,); None where there are none.
    """

    mesh: str
    before: int
    after: int
    faces: int
    moved: float
    left: np.ndarray | None
    coincident: int
    place: np.ndarray | None

    def __str__(self) -> str:
        parts = []
        if self.before:
            parts.append(
                f"the {self.mesh} garment starts through itself in {self.before} of {self.faces} faces: opened by "
                f"moving vertices up to {1e3 * self.moved:.0f} mm, {self.after} are left"
            )
        if self.left is not None:
            parts.append(f"they are around {_metres(self.left)}: part the sheets there in the mesh, or give it ease")
        if self.place is not None:
            parts.append(
                f"{self.coincident} of {self.faces} faces of the {self.mesh} garment lie in another sheet, around "
                f"{_metres(self.place)}: move one sheet off the other by the thickness of the fabric"
            )
        return "; ".join(parts)


def _metres(place: np.ndarray) -> str:
    return f"({', '.join(f'{x:.2f}' for x in place)}) m"


@dataclass
class _Still:
    """A body that stands still, see :class:`runtime.play.simulation.BodySource`."""

    vertices: np.ndarray
    faces: np.ndarray

    @property
    def pose_shape(self) -> tuple[int, ...]:
        return self.vertices.shape

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
    for fine, solver in ((False, options), (True, fine_options)):
        free, opening = _opened_mesh(levels, fine, fabric, solver, _Still(body_vertices, body_faces))
        if opening is not None:
            done.append(opening)
        if free is None:
            continue
        levels = replace(levels, fine=free) if fine else rebuilt(free.vertices)
        if not fine and levels.subdivision.binding is not None:  # its folds are its own
            levels = replace(levels, fine=replace(levels.fine, vertices=delivered))
    return levels, tuple(done)


def opened_fine(
    levels: Levels, fabric: Fabric, options: SolverOptions, body_vertices: np.ndarray, body_faces: np.ndarray
) -> Levels:
    """The levels with the fine mesh that :func:`opened` gives, where the coarse one is open already.

    Args:
        levels, fabric, body_vertices, body_faces: as for :func:`opened`.
        options: of the solver of the fine garment.
    """
    free, _ = _opened_mesh(levels, True, fabric, options, _Still(body_vertices, body_faces))
    return levels if free is None else replace(levels, fine=free)


def _opened_mesh(
    levels: Levels, fine: bool, fabric: Fabric, options: SolverOptions, body: _Still
) -> tuple[ClothMesh | None, Opening | None]:
    """A mesh opened, None where nothing crosses; and what was done, None where there was nothing to say."""
    name = "fine" if fine else "coarse"
    mesh, held = (levels.fine, levels.fine_held) if fine else (levels.coarse, levels.coarse_held)
    crossings = SelfCrossings(mesh)
    rows = crossings.find(mesh.vertices)
    sheet = _coincident(mesh)
    place = mesh.vertices[mesh.faces[sheet]].mean(axis=(0, 1)) if len(sheet) else None
    if not len(rows):
        return None, Opening(name, 0, 0, len(mesh.faces), 0.0, None, len(sheet), place) if len(sheet) else None
    before = len(crossings.faces_of(rows))
    layer = None if levels.layers is None else (levels.fine_layer if fine else levels.layers.layer)
    free = replace(mesh, vertices=smoothed_apart(mesh, held, layer, body.vertices, body.faces))
    rows = crossings.find(free.vertices)
    if layer is not None and len(rows):
        free = _parted(levels, free, fabric, options, fine, body)
        rows = crossings.find(free.vertices)
    after = len(crossings.faces_of(rows))
    if after >= before:
        free, after = mesh, before
    moved = float(np.linalg.norm(free.vertices - mesh.vertices, axis=1).max())
    left = free.vertices[rows[:, 0]].mean(axis=0) if after else None
    return free, Opening(name, before, after, len(mesh.faces), moved, left, len(sheet), place)


def _coincident(mesh: ClothMesh) -> np.ndarray:
    """Numbers of the faces all of whose corners lie on other vertices that they are not stitched to."""
    pairs, seam = cKDTree(mesh.vertices).query_pairs(COINCIDENT, output_type="ndarray"), None
    if len(pairs) and (seam := seams_of(mesh.stitches, len(mesh.vertices))) is not None:
        pairs = pairs[seam[pairs[:, 0]] != seam[pairs[:, 1]]]
    lies = np.zeros(len(mesh.vertices), bool)
    lies[pairs] = True
    return np.flatnonzero(lies[mesh.faces].all(axis=1))


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
