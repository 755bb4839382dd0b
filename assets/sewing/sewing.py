"""Sews a pattern on a body: cut, arranged, stitched, draped coarsely, cut finely, draped again, judged.

Seams are closed on a coarse cut of the pattern, where a second of simulation takes seconds. The stitched vertices then
become one, so that the garment is one surface. The fine cut of the same curves takes its place from the coarse one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from assets.bands import taut_bands
from assets.fabrics import load_fabric
from assets.garment import Garment, boundary_loops
from assets.patterns.panel_mesh import cut
from assets.patterns.pattern import Pattern
from assets.sewing import DEFAULT_EDGE
from assets.sewing.arrangement import arranged
from assets.sewing.body import StandingBody
from assets.sewing.pieces import Joined, Pieces, carried_over, join, pieces_of
from assets.sewing.sewing_simulation import HELD, Clock, band_limits, close_stitches, drape, substep_of
from assets.sewing.sewn_garment import SewnGarment, body_crossings, drape_figures, faults_of, faulty_panels
from pbd.attachment import push_outside, smooth_normals
from pbd.bending import hinge_calibration
from pbd.errors import InputError
from pbd.fabric import Fabric
from pbd.mesh import ClothMesh
from pbd.opening import CLEARANCE, smoothed_apart

__all__ = ["COARSE_EDGE", "SewingError", "arranged_pieces", "sew"]

Floats = NDArray[np.float64]

COARSE_EDGE = 0.025  # of the cut on which the stitches are closed [m]
EDGES = (
    0.002,
    0.05,
)  # that can be asked for [m]: below, a garment has over a million vertices; above, a sleeve has no round
# Tried one after the other: seconds for the stitches to close, and smoothings that make the body's limbs thin at first.
CLOSINGS = ((1.0, 0), (2.0, 0), (1.0, 12))
MAX_CLOSING_GAP = 0.02  # between two stitched vertices when they become one [m]
SEAM_ALLOWANCE = 0.01  # of cloth on both sides of a seam that is folded back under it [m]
# Stages of draping: seconds, damping [1/s], share of the fabric's friction, share of gravity.
HANG = (0.4, 2.0, 0.3, 1.0)
# Before the weight comes on, a taut band moves to where it is at home on the body; a little weight makes its rim level.
RELAX = (0.4, 2.0, 0.3, 0.1)
# Shares of an elastic's shortening while it hangs: at once, a cuff snaps into the wrist.
TIGHTENING = (1 / 3, 2 / 3, 1.0)
SETTLE = ((0.6, 2.0, 0.3, 1.0), (1.2, 1.0, 1.0, 1.0))
REMEDY = "other ease or lengths, another edge length, or arms and legs further apart may mend it"
EXTRA, MAX_EXTRA = (0.4, 2.0, 1.0, 1.0), 3  # more of it while something is through cloth or body
LIFT, MAX_LIFTS = 0.0005, 20  # of cloth off the body at a time [m], and how often


class SewingError(Exception):
    """A garment did not come out whole; the message says why.

    Args:
        faults: sentences about what is wrong.
        garment: as it came out, if it is one surface at least.
    """

    def __init__(self, faults: list[str], garment: SewnGarment | None = None) -> None:
        super().__init__("; ".join(faults))
        self.faults, self.garment = faults, garment


def sew(
    pattern: Pattern,
    body: StandingBody,
    fabric: str = "cotton",
    *,
    edge_length: float = DEFAULT_EDGE,
    report: Callable[[str], None] | None = None,
) -> SewnGarment:
    """Sew a pattern on a body and drape it.

    Args:
        pattern: what is sewn.
        body: that wears it.
        fabric: name of a preset, or a file; see :func:`assets.fabrics.load_fabric`.
        edge_length: of the garment's triangles [m].
        report: called with lines of progress.

    Raises:
        InputError: a pattern that cannot be cut, arranged or joined, a bad fabric or edge length.
        SewingError: the garment is not whole.
    """
    if not EDGES[0] <= edge_length <= EDGES[1]:
        expected = f"{EDGES[0]:g} to {EDGES[1]:g} m"
        raise InputError("edges that no garment has", key="edge", received=edge_length, expected=expected)
    cloth = load_fabric(fabric)
    coarse_edge = max(COARSE_EDGE, edge_length)
    coarse, start = arranged_pieces(pattern, body, coarse_edge)
    fine = coarse if edge_length >= coarse_edge else pieces_of(cut(pattern, edge_length))
    surfaces = join(coarse), join(fine)
    error = SewingError(["nothing was tried"])
    for seconds, smoothings in CLOSINGS:
        clock = Clock(_work(coarse, fine, seconds, coarse_edge, edge_length), report)
        try:
            return _sewn(pattern, body, cloth, fabric, (coarse, fine), surfaces, start, (seconds, smoothings), clock)
        except SewingError as failed:
            error = failed
            if report is not None:
                report(f"not whole: {failed}")
    raise error


def arranged_pieces(pattern: Pattern, body: StandingBody, edge_length: float) -> tuple[Pieces, Floats]:
    """The pieces of a pattern, and where they are around the body before they are sewn [m], shape (n, 3).

    Raises:
        InputError: as :func:`assets.patterns.panel_mesh.cut` and :func:`assets.sewing.arrangement.arranged`.
    """
    pieces = pieces_of(cut(pattern, edge_length))
    return pieces, arranged(pieces, [panel.placement for panel in pattern.panels], body)


def _sewn(
    pattern: Pattern,
    body: StandingBody,
    cloth: Fabric,
    fabric: str,
    cuts: tuple[Pieces, Pieces],
    surfaces: tuple[Joined, Joined],
    start: Floats,
    closing: tuple[float, int],
    clock: Clock,
) -> SewnGarment:
    """One attempt, with a row of :data:`CLOSINGS`; see :func:`sew`."""
    coarse, fine = cuts
    top = _top(surfaces[0].means(start), surfaces[0].faces)
    bend_factor = _bend_factor(coarse)
    clock.stage = "closing seams"
    seconds, smoothings = closing
    positions = close_stitches(coarse, start, body, cloth, bend_factor, seconds, clock, smoothings)
    _check_closed(pattern, coarse, positions)
    clock.stage = "draping"
    mesh = _surface(pattern, coarse, surfaces[0], positions, TIGHTENING[0])
    if len(_rims(mesh, body)):
        positions = _drape(mesh, body, cloth, bend_factor, RELAX, clock, hold=False).vertices[surfaces[0].vertex]
    for tightness in TIGHTENING:
        mesh = _surface(pattern, coarse, surfaces[0], positions, tightness)
        mesh = _drape(mesh, body, cloth, bend_factor, HANG, clock)
        positions = mesh.vertices[surfaces[0].vertex]
    if fine is not coarse:
        positions = carried_over(coarse, positions, fine)
        bend_factor = _bend_factor(fine)
    mesh = _surface(pattern, fine, surfaces[1], positions)
    for stage in SETTLE:
        mesh = _drape(mesh, body, cloth, bend_factor, stage, clock)
    sewn = _judged(pattern, body, fabric, fine, surfaces[1], mesh, top)
    for _ in range(MAX_EXTRA):
        if not any(sewn.figures[name] for name in ("crossings", "inside_body", "body_crossings")):
            break
        mesh = _drape(_smoothed(mesh, body), body, cloth, bend_factor, EXTRA, clock)
        sewn = _judged(pattern, body, fabric, fine, surfaces[1], mesh, top)
    if sewn.figures["crossings"]:
        # Gathers in a cuff fold into themselves again and again: their smooth surface is kept as it is, and counted.
        smooth = _smoothed(mesh, body)
        moved = int((smooth.vertices != mesh.vertices).any(axis=1).sum())
        sewn = _judged(pattern, body, fabric, fine, surfaces[1], smooth, top)
        sewn.figures["unsettled"] = moved
    faults = faults_of(sewn.figures)
    if faults:
        panels = ", ".join(faulty_panels(sewn, body))
        raise SewingError([*faults, f"at {panels}: {REMEDY}" if panels else REMEDY], sewn)
    return sewn


def _drape(
    mesh: ClothMesh,
    body: StandingBody,
    cloth: Fabric,
    bend_factor: float,
    stage: tuple[float, float, float, float],
    clock: Clock,
    hold: bool = True,
) -> ClothMesh:
    """A stage of draping; the body holds the rims of taut bands unless ``hold`` is false."""
    seconds, damping, friction, weight = stage
    held = _rims(mesh, body) if hold else np.zeros(0, np.int32)
    cloth = replace(cloth, friction=friction * cloth.friction)
    if len(held):
        vertices = mesh.vertices.copy()
        vertices[held] = push_outside(vertices[held], body.vertices, body.faces, CLEARANCE)
        mesh = replace(mesh, vertices=vertices)
    return drape(mesh, body, cloth, bend_factor, seconds, damping, clock, weight, held)


def _rims(mesh: ClothMesh, body: StandingBody) -> NDArray[np.int32]:
    """Vertices of the rims of bands that are drawn tight around the body, int32, shape (p,)."""
    rest = np.concatenate([np.zeros((len(mesh.faces), 1, 2)), mesh.flat.swapaxes(1, 2)], axis=1)
    assert mesh.max_stretch is not None
    found = taut_bands(mesh.vertices, mesh.faces, rest, mesh.max_stretch, (body.vertices, body.faces))
    return np.concatenate([np.zeros(0, np.int32), *(loop for _, loop in found)]).astype(np.int32)


def _cleared(mesh: ClothMesh, body: StandingBody) -> ClothMesh:
    """The mesh with faces lifted off the body where it comes through between their corners.

    Contact keeps the corners off the body; what is sharper than a face is large comes through it.
    """
    normals, vertices, count = smooth_normals(body.vertices, body.faces), mesh.vertices.copy(), len(mesh.vertices)
    for _ in range(MAX_LIFTS):
        found = body_crossings(vertices, mesh.faces, body)
        if not len(found):
            break
        direction = np.zeros_like(vertices)
        of_body = found[:, 0] >= count
        pushed = mesh.faces[found[of_body, 2]]
        outward = normals[found[of_body, :2] - count].sum(axis=1)
        np.add.at(direction, pushed, outward[:, None, :])
        ends = found[~of_body, :2]
        outward = normals[body.faces[found[~of_body, 2] - len(mesh.faces)]].sum(axis=1)
        np.add.at(direction, ends, outward[:, None, :])
        vertices += LIFT * direction / np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-30)
    return replace(mesh, vertices=vertices)


def _smoothed(mesh: ClothMesh, body: StandingBody) -> ClothMesh:
    """The mesh with cloth smoothed around places where it is through itself; it has to settle afterwards."""
    nothing = np.zeros(0, int)
    return replace(mesh, vertices=smoothed_apart(mesh, nothing, None, body.vertices, body.faces))


def _work(coarse: Pieces, fine: Pieces, seconds: float, coarse_edge: float, edge_length: float) -> float:
    """Work of one attempt as :class:`Clock` counts it."""
    first = seconds + HELD + len(TIGHTENING) * HANG[0]
    return len(coarse.flat) * first / substep_of(coarse_edge) + len(fine.flat) * sum(
        stage[0] for stage in SETTLE
    ) / substep_of(edge_length)


def _bend_factor(pieces: Pieces) -> float:
    """Factor of the hinges, measured on the flat pieces, which stand beside one another."""
    apart = np.zeros((len(pieces.flat), 3))
    apart[:, :2] = pieces.flat
    apart[:, 0] += pieces.piece_of_vertex * (np.ptp(pieces.flat[:, 0]) + 1.0)
    return hinge_calibration(ClothMesh.from_surface(apart, pieces.faces))


def _check_closed(pattern: Pattern, pieces: Pieces, positions: Floats) -> None:
    """Refuse a garment of which a seam was held open.

    Raises:
        SewingError: names the panels of the widest gap.
    """
    gaps = np.linalg.norm(positions[pieces.stitches[:, 0]] - positions[pieces.stitches[:, 1]], axis=1)
    if not np.isfinite(positions).all():
        raise SewingError([f"the simulation that closes the seams burst: {REMEDY}"])
    if gaps.max(initial=0.0) > MAX_CLOSING_GAP:
        ends = pieces.piece_of_vertex[pieces.stitches[gaps.argmax()]]
        names = " and ".join(repr(pieces.names[end]) for end in np.unique(ends))
        raise SewingError([f"a seam at {names} stays open by {1e3 * gaps.max():.0f} mm: {REMEDY}"])


def _surface(pattern: Pattern, pieces: Pieces, surface: Joined, positions: Floats, tightness: float = 1.0) -> ClothMesh:
    """The garment as one surface at given positions of the pieces, its elastics shortened by a share."""
    cut_rest = pieces.flat[pieces.faces]
    rest = _along_grain(pattern, replace(pieces, rest=cut_rest + tightness * (pieces.rest - cut_rest)))
    layers = pieces.layers + _allowance(pieces, surface)
    mesh = ClothMesh.from_pattern(surface.means(positions), surface.faces, rest, layers)
    return replace(mesh, max_stretch=band_limits(pieces.layers))


def _along_grain(pattern: Pattern, pieces: Pieces) -> Floats:
    """Rest shapes in the order (warp, weft) [m], shape (m, 3, 2)."""
    grain = np.array([panel.grain for panel in pattern.panels])[pieces.piece_of_face]
    across = np.stack([-grain[:, 1], grain[:, 0]], axis=1)
    return np.stack([np.einsum("fcx,fx->fc", pieces.rest, axis) for axis in (grain, across)], axis=2)


def _allowance(pieces: Pieces, surface: Joined) -> Floats:
    """Layers that the seam allowances add to each face [-], shape (m,): the share of the face that they lie under."""
    share = np.zeros(len(pieces.faces))
    ends = np.sort(surface.faces[:, [[0, 1], [1, 2], [2, 0]]], axis=2)
    count = surface.count
    sewn = np.isin(
        ends[..., 0].astype(np.int64) * count + ends[..., 1],
        surface.seams[:, 0].astype(np.int64) * count + surface.seams[:, 1],
    )
    corners = pieces.flat[pieces.faces]
    inner = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4]]) / np.array([[3.0], [6.0], [6.0], [6.0]])
    for piece in range(len(pieces.names)):
        own_faces = np.flatnonzero(pieces.piece_of_face == piece)
        face, side = np.nonzero(sewn[own_faces])
        if not len(face):
            continue
        a, b = corners[own_faces[face], side], corners[own_faces[face], (side + 1) % 3]
        steps = int(np.ceil(4.0 * np.linalg.norm(b - a, axis=1).max() / SEAM_ALLOWANCE))
        along = (np.arange(steps + 1) / steps)[:, None, None]
        line = ((1.0 - along) * a + along * b).reshape(-1, 2)
        places = np.einsum("sc,fcx->fsx", inner, corners[own_faces])
        share[own_faces] = (cKDTree(line).query(places)[0] < SEAM_ALLOWANCE).mean(axis=1)
    return share


def _top(vertices: Floats, faces: NDArray[np.int32]) -> float:
    """Mean height of the uppermost opening [m]: a waist, a neckline."""
    return max((float(vertices[loop, 1].mean()) for loop in boundary_loops(faces)), default=float(vertices[:, 1].max()))


def _judged(
    pattern: Pattern, body: StandingBody, fabric: str, pieces: Pieces, surface: Joined, mesh: ClothMesh, top: float
) -> SewnGarment:
    """A draped mesh as a garment with its figures; its upper opening was arranged at a height ``top`` [m]."""
    if not np.isfinite(mesh.vertices).all():
        raise SewingError([f"the simulation that drapes the garment burst: {REMEDY}"])
    mesh = _cleared(mesh, body)
    garment = Garment(
        pattern.name,
        mesh.vertices,
        surface.faces,
        _along_grain(pattern, pieces),
        pattern.source,
        mesh.layers,
        mesh.max_stretch,
    )
    ends = mesh.vertices[surface.vertex[pieces.stitches]]
    gap = float(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).max(initial=0.0))
    slid = 100.0 * (top - _top(mesh.vertices, surface.faces))
    figures = {"seam_gap_mm": 1e3 * gap, "slid_cm": slid} | drape_figures(garment, body)
    return SewnGarment(garment, pieces.names, pieces.piece_of_face, surface.seams, fabric, figures)
