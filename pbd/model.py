"""The constant data of a garment (:class:`Model`), made from its mesh and fabric."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from pbd.arrays import integers
from pbd.bending import (
    border_share,
    friction_share,
    hinge_calibration,
    hinge_friction,
    hinge_rows,
    hinge_stiffness,
    layer_stiffness,
)  # fmt: skip
from pbd.errors import InputError
from pbd.fabric import Fabric
from pbd.limits import Limits
from pbd.mesh import ClothMesh, greedy_colors

__all__ = ["Model", "ModelOptions", "build_model"]

SAMPLE_SPACING = 0.025  # edges longer than this are tested for contact in their middle too [m]: a foot is narrower
BLOCK = 16  # triangles of one colour that are solved at once
# Compliance under compression over mobility of a triangle [s2]. A softer one has no effect, and float32 holds the
# square of this one over the square of the shortest frame.
MAX_SOFTNESS = 1e4
MASS_ROUNDS = 8  # in which stitches even out masses
# Cloth with a longer gravity length than this is stiff [m]: 95 % of 618 fabrics lie below 2.8 cm (Feng et al. 2022).
STIFF_LENGTH = 0.03


@dataclass(frozen=True)
class ModelOptions:
    """How a model is made from a mesh and a fabric. Units as stated; the defaults are the fabric itself.

    Attributes:
        compression_compliance_scale: factor on the in-plane compliance under compression [-]. A coarse mesh cannot
            buckle where cloth does, so its triangles may shorten instead.
        tether_slack: length of a tether over the geodesic distance [-]; 0 leaves tethers out.
        pressure: of the air behind the cloth over that before it, where its normals point [Pa].
    """

    compression_compliance_scale: float = 1.0
    tether_slack: float = 1.03
    pressure: float = 0.0

    def __post_init__(self) -> None:
        if not np.isfinite(self.pressure):
            expected = "a finite number [Pa]"
            raise InputError("bad model option", key="pressure", received=self.pressure, expected=expected)
        allowed = {
            "compression_compliance_scale": (self.compression_compliance_scale >= 1.0, "at least 1"),
            "tether_slack": (self.tether_slack >= 0.0, "at least 0"),
        }
        for name, (fits, expected) in allowed.items():
            value = getattr(self, name)
            if not np.isfinite(value) or not fits:
                raise InputError("bad model option", key=name, received=value, expected=f"a finite number, {expected}")


@dataclass(frozen=True)
class Model:
    """One garment, ready for a solver. Arrays are float32 or int32, C-contiguous; constraints are sorted by colour.

    Attributes:
        mesh: the cloth mesh.
        fabric: its fabric.
        options: how it was built.
        mass: [kg], float64, shape (n,); vertices that are sewn together share it.
        inverse_mass: [1/kg], 0 where a vertex is held, shape (n,).
        held: vertices that follow targets (pins and attachments), int32, shape (p,).
        triangles: shape (m, 3); ``triangle_data``: inverse flat, gram, unit, compliance, see
            :func:`pbd.xpbd.constraints.membrane_multipliers`, and columns to fill the last block: (12, m + BLOCK).
            Where a fabric stiffens, four rows more: (a, b) of warp and weft, see :meth:`pbd.Fabric.stiffening`.
            With internal friction a last row: the shear at which it slips, see
            :func:`pbd.xpbd.constraints.rubbing_shear`.
        triangle_numbers: place of each triangle in ``State.plastic_shears``, int32, shape (m,).
        plastic_shear_count: how many of these there are: m, or 0 where no shear has internal friction.
        triangle_colors, hinge_colors: offsets of the colours, shape (colours + 1,).
        triangle_blocks: first triangle and size of each block, all of one colour, shape (b, 2).
        block_colors: offsets of the colours of the blocks, shape (colours + 1,).
        hinges: shape (h, 4); ``hinge_data``: K row | sum of w K^2, compliance, bend at rest, and the bend by which the
            compliance alone would bear the force of internal friction [m], 0 without; shape (h, 2, 4). Where the fabric
            is stiff, hinges are stiffer at free borders, see :func:`pbd.bending.border_share`.
        hinge_numbers: place of each hinge in ``State.plastic_bends``, int32, shape (h,).
        plastic_count: how many of these there are: one for each hinge of the mesh, also of held vertices, or 0 where no
            hinge has internal friction.
        stitches: (v, a, b), shape (s, 3); ``stitch_weights``: position of v between a (0) and b (1), shape (s,).
        stitch_gaps: how far v may be from there [m], float32, shape (s,).
        tethers: (vertex, held vertex), shape (t, 2); ``tether_lengths``: [m], shape (t,).
        samples: where contact with a body is tested: the vertices (i, i), then the ends (i, j) of long edges, tested in
            their middle, int32, shape (s, 2).
        sample_colors: offsets of the samples that share no vertex, the vertices first, shape (colours + 1,).
        bend_factor: c of the hinge energy, measured on this mesh [-].
        layer: number of the garment that each vertex belongs to, from the innermost, 0, outwards, int32, shape (n,).
        pressure: at each vertex [Pa], float32, shape (n,); no number where there is none anywhere.
        limits: soft and hard limits about where a body carries vertices.
        smooth: whether middles of edges are tested for contact where the smooth surface passes over them. Long edges
            cut through the inside of a round body.
    """

    mesh: ClothMesh
    fabric: Fabric
    options: ModelOptions
    mass: np.ndarray
    inverse_mass: np.ndarray
    held: np.ndarray
    triangles: np.ndarray
    triangle_data: np.ndarray
    triangle_numbers: np.ndarray
    plastic_shear_count: int
    triangle_colors: np.ndarray
    triangle_blocks: np.ndarray
    block_colors: np.ndarray
    hinges: np.ndarray
    hinge_data: np.ndarray
    hinge_numbers: np.ndarray
    plastic_count: int
    hinge_colors: np.ndarray
    stitches: np.ndarray
    stitch_weights: np.ndarray
    stitch_gaps: np.ndarray
    tethers: np.ndarray
    tether_lengths: np.ndarray
    samples: np.ndarray
    sample_colors: np.ndarray
    bend_factor: float
    layer: np.ndarray
    pressure: np.ndarray
    limits: Limits
    smooth: bool = False

    @property
    def stiff(self) -> bool:
        """Whether the fabric is stiffer than what clothes are made of."""
        return self.fabric.gravity_length > STIFF_LENGTH

    @property
    def vertex_count(self) -> int:
        """Number of vertices n [-]."""
        return len(self.mesh.vertices)


def build_model(
    mesh: ClothMesh,
    fabric: Fabric,
    held: np.ndarray | None = None,
    *,
    options: ModelOptions | None = None,
    bend_factor: float | None = None,
    limits: Limits | None = None,
) -> Model:
    """Model of a mesh in a fabric.

    Args:
        mesh, fabric: the cloth.
        held: vertices that are moved from outside (pins, attachments to a body), int, shape (p,).
        options, bend_factor: reduced-model factors and tethers; the hinge factor c, None measures it.
        limits: about where a body carries vertices.

    Raises:
        InputError: a held or limited vertex outside the mesh.
    """
    options, limits = options or ModelOptions(), limits or Limits.none()
    count, chosen = len(mesh.vertices), [] if held is None else held
    held = np.unique(integers(chosen, "held", ("p",), count, outside="held vertex outside the mesh"))
    if limits.vertices.max(initial=0) >= count:
        received, expected = int(limits.vertices.max()), f"0..{count - 1}"
        raise InputError("limited vertex outside the mesh", key="limits", received=received, expected=expected)
    mass, inverse_mass = _masses(mesh, fabric, held)
    bend_factor = hinge_calibration(mesh) if bend_factor is None else bend_factor
    triangles, triangle_data, triangle_numbers, triangle_colors = _membrane(
        mesh, fabric, inverse_mass, options.compression_compliance_scale
    )
    hinges, hinge_data, hinge_numbers, plastic_count, hinge_colors = _bending(mesh, fabric, inverse_mass, bend_factor)
    tethers, lengths = _tethers(mesh, held, options.tether_slack)
    return Model(
        mesh,
        fabric,
        options,
        mass,
        inverse_mass.astype(np.float32),
        held,
        triangles,
        triangle_data,
        triangle_numbers,
        len(triangles) if fabric.shear_hysteresis > 0.0 else 0,
        triangle_colors,
        *blocks_of(triangle_colors),
        hinges,
        hinge_data,
        hinge_numbers,
        plastic_count,
        hinge_colors,
        *_stitches(mesh),
        tethers,
        lengths,
        *_samples(mesh),
        float(bend_factor),
        np.zeros(count, np.int32),
        np.full(count if options.pressure else 0, options.pressure, np.float32),
        limits,
    )


def _masses(mesh: ClothMesh, fabric: Fabric, held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Masses [kg] and their inverses [1/kg], 0 where a vertex is held, shape (n,)."""
    mass = fabric.areal_density * mesh.vertex_cloth_areas
    if np.any(mass <= 0):
        vertex = int(np.argmin(mass))
        raise InputError("vertex in no face", key=f"vertex {vertex}", expected="every vertex in a face")
    mass = _shared(mass, mesh)
    inverse_mass = 1.0 / mass
    inverse_mass[held] = 0.0
    return mass, inverse_mass


def _stitches(mesh: ClothMesh) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stitches in the order of their colours, their weights, and their gaps, which are closed."""
    order, _ = _by_color(mesh.stitches, len(mesh.vertices))
    stitches = np.ascontiguousarray(mesh.stitches[order], np.int32)
    return stitches, mesh.stitch_weights[order].astype(np.float32), np.zeros(len(order), np.float32)


def _shared(mass: np.ndarray, mesh: ClothMesh) -> np.ndarray:
    """Masses evened out over the stitches; their sum stays [kg], shape (n,).

    Vertices that are sewn together move as one, also with unequal masses. Without this, a light corner of a
    panel that is sewn to heavy cloth would take nearly all of a stitch's correction, and pass on almost no tension.
    """
    if not len(mesh.stitches):
        return mass
    (v, a, b), w = mesh.stitches.T, mesh.stitch_weights
    used = np.bincount(mesh.stitches.ravel(), minlength=len(mass))
    for _ in range(MASS_ROUNDS):
        flow = [
            0.5 * part * (mass[end] - mass[v]) / np.maximum(used[end], used[v]) for part, end in ((1.0 - w, a), (w, b))
        ]
        for vertices, change in ((v, flow[0] + flow[1]), (a, -flow[0]), (b, -flow[1])):
            mass = mass + np.bincount(vertices, change, len(mass))
    return mass


def _by_color(members: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Order of the constraints by colour, and the offsets of the colours.

    Constraints of one colour go through memory in one direction: their order makes no difference to the result.
    """
    colors = greedy_colors(members, count)
    order = np.lexsort((members.max(axis=1), colors))
    offsets = np.concatenate([[0], np.cumsum(np.bincount(colors, minlength=1))])
    return order, offsets.astype(np.int32)


def _membrane(
    mesh: ClothMesh, fabric: Fabric, inverse_mass: np.ndarray, compression_scale: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    inverse = np.linalg.inv(mesh.flat)
    corner_rows = np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)  # (m, 3, 2)
    gram = np.einsum("mc,mca,mcb->mab", inverse_mass[mesh.faces], corner_rows, corner_rows)
    # A small motion changes the strain of small and slim triangles most. They come in later colours: few constraints
    # follow that could undo their solution. Triangles that are much alike stay in the mesh's own order.
    trace = np.trace(gram, axis1=1, axis2=2)
    by_mobility = np.argsort(np.round(4.0 * np.log2(np.maximum(trace, 1e-20))), kind="stable")
    order, offsets = _by_color(mesh.faces[by_mobility], len(mesh.vertices))
    order = by_mobility[order]
    faces, inverse, gram = mesh.faces[order], inverse[order], gram[order]
    softness = np.linalg.inv(fabric.membrane_stiffness()) / mesh.face_cloth_areas[order][:, None, None]
    trace = np.trace(gram, axis1=1, axis2=2)
    unit = np.where(trace > 0, 1.0 / np.where(trace > 0, trace, 1.0), 1.0)  # without a free corner nothing moves
    softest = compression_scale * unit * np.abs(softness).max(axis=(1, 2))
    softness *= (MAX_SOFTNESS / np.maximum(softest, MAX_SOFTNESS))[:, None, None]
    stiffening = fabric.stiffening().ravel()
    slips_at = 0.5 * fabric.shear_hysteresis * mesh.face_cloth_areas[order] * softness[:, 2, 2]
    rows = [
        *inverse.reshape(-1, 4).T,
        *(unit * gram[:, a, b] for a, b in ((0, 0), (0, 1), (1, 1))),
        unit,
        *(unit * softness[:, a, b] for a, b in ((0, 0), (0, 1), (1, 1), (2, 2))),
        *(np.repeat(stiffening[:, None], len(faces), axis=1) if stiffening.any() else []),
        *([slips_at] if fabric.shear_hysteresis > 0.0 else []),
    ]
    data = np.zeros((len(rows), len(faces) + BLOCK), np.float32)
    data[:, : len(faces)] = rows
    return np.ascontiguousarray(faces), data, order.astype(np.int32), offsets


def blocks_of(colors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First constraint and size of each block of at most ``BLOCK`` of one colour, and the offsets of the colours."""
    starts = [np.arange(begin, end, BLOCK) for begin, end in zip(colors[:-1], colors[1:], strict=True)]
    sizes = [np.minimum(BLOCK, end - first) for first, end in zip(starts, colors[1:], strict=True)]
    blocks = np.stack([np.concatenate(starts), np.concatenate(sizes)], axis=1).astype(np.int32)
    return blocks, np.cumsum([0, *(len(first) for first in starts)]).astype(np.int32)


def _bending(
    mesh: ClothMesh, fabric: Fabric, inverse_mass: np.ndarray, factor: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, int, np.ndarray]:
    held = np.flatnonzero(inverse_mass == 0.0)
    hinges, rows, areas, angle = hinge_rows(mesh, held)
    share = border_share(mesh, held) if fabric.gravity_length > STIFF_LENGTH else np.ones(len(hinges))
    rest = np.zeros(len(hinges)) if mesh.rest_bends is None else mesh.rest_bends
    stacked = layer_stiffness(mesh)
    if mesh.seam_hinges is not None:
        pairs = zip((hinges, rows, areas, angle), mesh.seam_hinges, strict=True)
        hinges, rows, areas, angle = (np.concatenate(pair) for pair in pairs)
        rest = np.concatenate([rest, np.zeros(len(hinges) - len(rest))])
        stacked, share = (np.concatenate([some, np.ones(len(hinges) - len(some))]) for some in (stacked, share))
    stiffness = 3.0 * factor * stacked * share * hinge_stiffness(fabric, angle) / areas
    friction = np.zeros(len(hinges))
    if fabric.bend_hysteresis_warp + fabric.bend_hysteresis_weft > 0.0:
        friction = 0.5 * friction_share(mesh) * np.sqrt(stacked) * hinge_friction(fabric, angle)  # of each layer
    sums = (inverse_mass[hinges] * rows**2).sum(axis=1)
    stiffness[sums == 0] = 0.0  # all held
    works = stiffness > 1e-9 * stiffness.max(initial=0.0)
    hinges, rows, stiffness, sums, rest = (some[works] for some in (hinges, rows, stiffness, sums, rest))
    order, offsets = _by_color(hinges, len(mesh.vertices))
    data = np.zeros((len(hinges), 2, 4), np.float32)
    data[:, 0] = rows[order]
    data[:, 1] = np.stack([sums, 1.0 / stiffness, rest, friction[works] / stiffness], axis=1)[order]
    numbers, count = np.flatnonzero(works)[order].astype(np.int32), len(works) if friction.any() else 0
    return np.ascontiguousarray(hinges[order]), data, numbers, count, offsets


def _samples(mesh: ClothMesh) -> tuple[np.ndarray, np.ndarray]:
    edges, lengths = mesh.edge_lengths()
    count = len(mesh.vertices)
    vertices = np.arange(count, dtype=np.int32)
    edges = edges[lengths > SAMPLE_SPACING]
    order, offsets = _by_color(edges, count)
    samples = np.concatenate([np.stack([vertices, vertices], axis=1), edges[order]]).astype(np.int32)
    return samples, np.concatenate([[0], count + offsets]).astype(np.int32)


def _tethers(mesh: ClothMesh, held: np.ndarray, slack: float) -> tuple[np.ndarray, np.ndarray]:
    """Each free vertex to the held vertex that is nearest along the cloth."""
    if not held.size or slack == 0.0:
        return np.zeros((0, 2), np.int32), np.zeros(0, np.float32)
    edges, lengths = mesh.edge_lengths()
    count = len(mesh.vertices)
    graph = csr_matrix((lengths, (edges[:, 0], edges[:, 1])), (count, count))
    distance, _, source = dijkstra(graph, directed=False, indices=held, min_only=True, return_predecessors=True)
    free = np.setdiff1d(np.flatnonzero(np.isfinite(distance)), held)
    tethers = np.stack([free, source[free]], axis=1).astype(np.int32)
    return tethers, (slack * distance[free]).astype(np.float32)
