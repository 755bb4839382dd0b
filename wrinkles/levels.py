"""A garment at two levels of detail: a coarse mesh that the solver moves, and a fine mesh that is drawn.

Both have the same rest area, and both are attached to the same body.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import splu

from pbd import ClothMesh, Fabric, InputError, Limits, Model, ModelOptions, build_model
from pbd.attachment import Attachment, push_outside
from pbd.bending import hinge_rows
from pbd.layers import fastened, layered, parts_of
from wrinkles.binding import Binding
from wrinkles.surface import SewnRest, Subdivision

__all__ = [
    "MAX_AREA_CORRECTION",
    "Layers",
    "Levels",
    "build_garments",
    "build_levels",
    "garment_vertices",
    "held_between",
    "levels_of",
    "with_area_of",
]

# Vertices are pushed this far out of the body [m], so that attached ones start at least 2 mm outside it; the smooth
# surface dips between them.
CLEARANCE = 0.003
MAX_AREA_DIFFERENCE = 0.005  # share by which the rest areas of coarse and fine mesh may differ; more is corrected,
MAX_AREA_CORRECTION = 0.02  # and more than this share is refused: the coarse mesh is then too coarse
# The cut-off between coarse and fine is the shortest fold that a coarse mesh represents well.
CUTOFF_EDGES = 3.0  # in mean coarse edges


@dataclass(frozen=True, eq=False)
class Layers:
    """Garments of one mesh that are worn over one another.

    Attributes:
        names: of the garments, from the innermost outwards.
        fabrics: of the garments over the innermost one.
        layer: number of the garment that each coarse vertex belongs to, 0 for the innermost, int32, shape (n,).
        fastened: vertices that are fastened to the garments below them, ascending, int32, shape (k,).
    """

    names: tuple[str, ...]
    fabrics: tuple[Fabric, ...]
    layer: np.ndarray
    fastened: np.ndarray

    def subdivided(self, subdivision: Subdivision) -> Layers:
        """The same garments on the fine mesh."""
        layer = self.layer[subdivision.coarse_faces[subdivision.places[0], 0]]
        return replace(self, layer=layer, fastened=held_between(subdivision, self.fastened).astype(np.int32))


@dataclass(frozen=True)
class Levels:
    """Coarse and fine mesh of one garment, or of the garments of an outfit.

    Attributes:
        subdivision: from the coarse to the fine mesh.
        coarse, fine: cloth meshes in the bind pose; their rest areas agree to 0.5 %.
        coarse_held, fine_held: attached vertices, int, shapes (p,), (P,).
        coarse_attachment, fine_attachment: bind the attached vertices to the body; empty without a body.
        coarse_limits, fine_limits: how far vertices may move from where the body carries them.
        sewn: how a sewn garment rests; None for any other.
        pattern: place of each corner of each coarse face in the flat pattern, for pictures [m], shape (m, 3, 2); None
            where there is none, or where a delivered fine mesh has it.
        layers: garments that the meshes consist of; None for one garment.
    """

    subdivision: Subdivision
    coarse: ClothMesh
    fine: ClothMesh
    coarse_held: np.ndarray
    fine_held: np.ndarray
    coarse_attachment: Attachment
    fine_attachment: Attachment
    coarse_limits: Limits
    fine_limits: Limits
    sewn: SewnRest | None = None
    pattern: np.ndarray | None = None
    layers: Layers | None = None

    def __getstate__(self) -> dict:
        # The cached factors are left out, because they cannot be sent to a worker process.
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    def cutoff(self) -> float:
        """Wavelength at which the coarse mesh keeps half of a fold's amplitude [m]."""
        return CUTOFF_EDGES * float(self.coarse.edge_lengths()[1].mean())

    @property
    def fine_layer(self) -> np.ndarray | None:
        """Of an outfit the number of the garment of each fine vertex, int32, shape (N,); None for one garment."""
        return None if self.layers is None else self.layers.subdivided(self.subdivision).layer

    @property
    def rest_vertices(self) -> np.ndarray:
        """Fine vertices at rest [m], shape (N, 3): in the bind pose, or in the flat pattern for a delivered mesh."""
        binding = self.subdivision.binding
        return self.fine.vertices if binding is None else np.insert(binding.flat, 2, 0.0, axis=1)

    def model(
        self,
        fabric: Fabric,
        options: ModelOptions | None = None,
        *,
        bend_factor: float | None = None,
        fine: bool = False,
        mesh: ClothMesh | None = None,
    ) -> Model:
        """The garment as a model, coarse or fine; the garments of an outfit in layers.

        Args:
            fabric: of the garment, of an outfit that of the innermost one.
            options, bend_factor: as for :func:`pbd.build_model`.
            fine: which of both meshes.
            mesh: the same mesh with another rest shape; None takes it as it is.
        """
        held, limits = (self.fine_held, self.fine_limits) if fine else (self.coarse_held, self.coarse_limits)
        layers = self.layers.subdivided(self.subdivision) if fine and self.layers is not None else self.layers
        mesh = mesh or (self.fine if fine else self.coarse)
        return build_garments(mesh, layers, fabric, held, options, bend_factor, limits)

    @cached_property
    def _filter(self) -> tuple:
        """Factors of the smoothing spline's normal equations, transpose of its data term, weights of held vertices."""
        matrix, count = self.subdivision.matrix, self.subdivision.coarse_count
        hinges, rows, areas, _ = hinge_rows(self.coarse)
        shape = (len(hinges), count)
        curl = csr_matrix((rows.ravel(), (np.repeat(np.arange(len(hinges)), 4), hinges.ravel())), shape)
        # Sum of |K x|^2 / (A0 + A1) is the integral of the squared curvature: c = 1/3 of the hinge energy.
        bending = curl.T @ curl.multiply((1.0 / areas)[:, None])
        area = diags(self.fine.vertex_areas)
        held = np.zeros(count)
        held[self.coarse_held] = 1.0e3 * self.fine.vertex_areas.mean()
        stiffness = (self.cutoff / (2.0 * np.pi)) ** 4
        normal = matrix.T @ area @ matrix + stiffness * bending + diags(held)
        return splu(normal.tocsc()), (matrix.T @ area).tocsr(), held

    def filter_down(self, fine: np.ndarray) -> np.ndarray:
        """Coarse vertices for fine ones: a smoothing spline that halves folds of the cut-off wavelength.

        The response to a fold of wavelength L is 1 / (1 + (cutoff / L)^4), less below two coarse edges. Held
        vertices keep their positions.

        Args:
            fine: positions of the fine vertices [m], shape (f, N, 3).

        Returns:
            positions of the coarse vertices [m], float64, shape (f, n, 3).
        """
        factor, transpose, held = self._filter
        frames = np.asarray(fine, float)
        columns = np.moveaxis(frames, 1, 0).reshape(frames.shape[1], -1)
        right = transpose @ columns + held[:, None] * columns[self.subdivision.at_coarse]
        return np.moveaxis(factor.solve(right).reshape(len(held), len(frames), 3), 0, 1)


def build_levels(
    vertices: np.ndarray,
    faces: np.ndarray,
    held: np.ndarray,
    body_vertices: np.ndarray,
    body_faces: np.ndarray,
    levels: int = 2,
    *,
    warp: tuple[float, float, float] = (0.0, 1.0, 0.0),
    binding: Binding | None = None,
    limits: Limits | None = None,
    sewn: SewnRest | None = None,
    layers: Layers | None = None,
) -> Levels:
    """Make the two levels of a garment: push it out of the body in the bind pose, refine it and attach it.

    Args:
        vertices: of the garment [m], shape (n, 3).
        faces: int, shape (m, 3).
        held: coarse vertices attached to the body, or fixed in space where there is none, int, shape (p,).
        body_vertices: bind pose [m], shape (b, 3).
        body_faces: int, shape (k, 3); no faces for a garment without a body.
        levels: number of times that each coarse face is cut in four.
        warp: direction of the warp in space, shape (3,).
        binding: of a delivered fine mesh, if there is one.
        limits: how far coarse vertices may move from where the body carries them.
        sewn: how a sewn garment rests; None for any other, which rests as its mesh.
        layers: garments that the mesh consists of; None for one garment.

    Raises:
        InputError: a number of levels outside 1..4, or a subdivided mesh whose area differs by more than 2 %.
    """
    if not 1 <= levels <= 4:
        raise InputError("bad number of subdivisions", key="subdivisions", received=levels, expected="1..4")
    vertices = np.array(vertices, float)
    if len(body_faces):
        # The fine surface is the visible one: it is pushed out, and the coarse vertices are fitted to it, twice.
        subdivision = Subdivision.of(faces, len(vertices), levels, binding)
        for _ in range(2):
            outside = push_outside(subdivision.upsample(vertices), body_vertices, body_faces, CLEARANCE)
            vertices = subdivision.fit(outside)
        vertices = push_outside(vertices, body_vertices, body_faces, CLEARANCE)
    return levels_of(
        vertices,
        faces,
        held,
        body_vertices,
        body_faces,
        levels,
        warp,
        binding=binding,
        limits=limits,
        sewn=sewn,
        layers=layers,
    )


def levels_of(
    vertices: np.ndarray,
    faces: np.ndarray,
    held: np.ndarray,
    body_vertices: np.ndarray,
    body_faces: np.ndarray,
    levels: int,
    warp: tuple[float, float, float] = (0.0, 1.0, 0.0),
    *,
    binding: Binding | None = None,
    limits: Limits | None = None,
    sewn: SewnRest | None = None,
    layers: Layers | None = None,
) -> Levels:
    """Make the levels of a garment that is outside the body already; arguments as for :func:`build_levels`.

    Raises:
        InputError: a subdivided mesh whose area differs by more than 2 %.
    """
    subdivision = Subdivision.of(faces, len(vertices), levels, binding)
    coarse, fine = subdivision.meshes(vertices, warp, sewn=sewn)
    coarse, ratio = with_area_of(coarse, fine)
    if binding is None and abs(ratio - 1.0) > MAX_AREA_CORRECTION:
        expected = f"1 within {100.0 * MAX_AREA_CORRECTION:g} %"
        raise InputError("coarse and fine mesh differ in area", key="subdivisions", received=ratio, expected=expected)
    held = np.unique(np.asarray(held, np.int64))  # ascending, the order in which a model takes its targets
    fine_held = held_between(subdivision, held)
    carried = (coarse.vertices[held], fine.vertices[fine_held]) if len(body_faces) else (np.zeros((0, 3)),) * 2
    attachments = [Attachment.bind(points, body_vertices, body_faces) for points in carried]
    limits = limits or Limits.none()
    fine_limits = limits.between(subdivision.matrix) if len(limits.vertices) else limits
    pattern = None if sewn is None else sewn.pattern
    one, two = attachments
    return Levels(subdivision, coarse, fine, held, fine_held, one, two, limits, fine_limits, sewn, pattern, layers)


def build_garments(
    mesh: ClothMesh,
    layers: Layers | None,
    fabric: Fabric,
    held: np.ndarray,
    options: ModelOptions | None,
    bend_factor: float | None,
    limits: Limits,
) -> Model:
    """Model of a mesh of one garment, or of several in layers; see :func:`pbd.build_model`.

    Args:
        mesh: of all garments.
        layers: which they are; None for one.
        fabric: of the innermost one.
        held, options, bend_factor, limits: as for :func:`pbd.build_model`.
    """
    if layers is None:
        return build_model(mesh, fabric, held, options=options, bend_factor=bend_factor, limits=limits)
    models, numbers = [], []
    for (part, vertices), part_fabric in zip(parts_of(mesh, layers.layer), (fabric, *layers.fabrics), strict=True):
        part_held = np.searchsorted(vertices, held[layers.layer[held] == len(models)])
        models.append(
            build_model(
                part, part_fabric, part_held, options=options, bend_factor=bend_factor, limits=limits.part(vertices)
            )
        )
        numbers.append(vertices)
    return fastened(replace(layered(models, numbers), mesh=mesh), layers.fastened)


def garment_vertices(levels: Levels) -> dict[str, np.ndarray] | None:
    """Fine vertices of each garment of an outfit by its name, int, shapes (k,); None for one garment."""
    if levels.layers is None:
        return None
    fine = levels.fine_layer
    return {name: np.flatnonzero(fine == number) for number, name in enumerate(levels.layers.names)}


def with_area_of(coarse: ClothMesh, fine: ClothMesh) -> tuple[ClothMesh, float]:
    """The coarse mesh with the rest area of the fine one, and the ratio of coarse to fine area before.

    The areas differ because paths on the smooth surface are too long at sharp bends, and because the border of a
    decimated mesh cuts corners.
    """
    ratio = float(coarse.face_areas.sum() / fine.face_areas.sum())
    same = abs(ratio - 1.0) <= MAX_AREA_DIFFERENCE
    return coarse if same else replace(coarse, flat=coarse.flat / np.sqrt(ratio)), ratio


def held_between(subdivision: Subdivision, held: np.ndarray) -> np.ndarray:
    """Fine vertices on coarse edges and faces whose corners are all held: int, ascending, shape (P,).

    Args:
        subdivision: from the coarse to the fine mesh.
        held: coarse vertices, int, shape (p,).
    """
    mark = np.zeros(subdivision.coarse_count)
    mark[held] = 1.0
    if subdivision.binding is not None:
        face, place = subdivision.places
        carried = (place * mark[subdivision.coarse_faces[face]]).sum(axis=1)
        return np.flatnonzero(carried > 0.9)  # a delivered border deviates from the coarse one to both sides
    for step in subdivision.steps:
        new = step[len(mark) :]
        # The two ends of an edge have the large weights (3/8 or 1/2); opposite corners have 1/8.
        ends = new.copy()
        ends.data = (ends.data > 0.2).astype(float)
        mark = np.concatenate([mark, (ends @ mark == 2.0).astype(float)])
    return np.flatnonzero(mark)
