"""The C-IPC dress, sewn from its flat pattern and draped by the default solver, against a drape by an IPC solver.

Li, Kaufman, Jiang 2021, "Codimensional Incremental Potential Contact", publish a dress in 14 panels with stitches, the
body that wears it, and the dress as their solver drapes it. Their implicit solver keeps cloth off itself; the panels
here do not touch one another, because pleats that are sewn down have edges of more than two faces.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks
from trimesh import Trimesh
from trimesh.intersections import mesh_plane

from assets.io.sequence import load_sequence
from assets.loading import load_garment
from assets.seams import Seams, load_seams
from pbd import Body, ClothMesh, Colliders, Fabric, Model, Solver, SolverOptions, State
from precompute.experiment.measures import FRAME_RATE, TimedSteps, typical_ms
from precompute.experiment.sheets import untethered
from precompute.validation.trial import Curve, TrialResult, TrialSetting
from precompute.validation.validation_row import Parameter, Row
from wrinkles.spectrum import BandedEnergy

__all__ = ["ROWS", "Drape", "compare_drapes", "folds_of", "outermost_radius"]

Floats = NDArray[np.float64]

# The fabric that the published script gives this dress: wool with 5 % lycra.
DENSITY, YOUNG, POISSON, THICKNESS = 543.293, 0.076e6, 0.071, 0.328e-3  # [kg/m3], [Pa], [-], [m]
BEND_SHARE = 0.1  # of Young's modulus that the script gives to bending [-]
# Its hinges are those of Grinspun et al. 2003, which bend about three times as stiff as the sheet that they stand for.
HINGE_STIFFNESS = 3.0
FRICTION, GAP = 0.2, 0.001  # Coulomb's coefficient; distance at which its contact begins [m]
LIFT = 0.75  # the pattern's file counts heights from here [m]

CLOSING_BEND = 3e-6  # a stiff sheet lays its pleats in order while the seams close [N m]
CLOSING_S, CLOSED_S, DRAPE_S = 2.0, 0.7, 2.0  # [s]
CLOSING_SUBSTEPS = 30  # of a frame of 1/60 s
DAMPING = 0.97  # share of the velocities that a frame leaves

SECTIONS = (0.64, 0.73, 0.82, 0.91)  # heights of the hem and of three sections of the skirt [m]
DIRECTIONS = 720  # around the body
MIN_FOLD = 0.002  # [m]
SAME_PLACE_DEG = 5.0


@dataclass(frozen=True)
class Drape:
    """Figures of a drape beside those of another.

    Attributes:
        folds: number at each section: of the drape and of the reference, shape (sections, 2).
        depth_mm: mean depth of these folds [mm], shape (sections, 2).
        same_place: share of the reference's folds with one of the drape's within 5 deg, shape (sections,).
        octaves: bending energy over the reference's, by band.
        seam_gap_mm: widest seam [mm].
        curve: outermost radius at the hem [mm] over the direction [deg].
    """

    folds: NDArray[np.int64]
    depth_mm: Floats
    same_place: Floats
    octaves: dict[str, float]
    seam_gap_mm: float
    curve: Curve

    @property
    def worst_octave(self) -> float:
        """Largest distance of an octave from 1 [-]."""
        return max(abs(ratio - 1.0) for ratio in self.octaves.values())


def outermost_radius(vertices: Floats, faces: NDArray[np.int32], height: float, center: Floats) -> Floats:
    """How far the cloth reaches from an upright axis in each direction at a height [m], shape (DIRECTIONS,).

    Args:
        vertices: [m], shape (n, 3).
        faces: shape (m, 3).
        height: of the level section [m].
        center: x and z of the axis [m], shape (2,).
    """
    lines = np.asarray(mesh_plane(Trimesh(vertices, faces, process=False), [0.0, 1.0, 0.0], [0.0, height, 0.0]))
    share = np.linspace(0.0, 1.0, 20)[:, None, None]
    points = ((1.0 - share) * lines[:, 0] + share * lines[:, 1]).reshape(-1, 3)[:, [0, 2]] - center
    reach = np.full(DIRECTIONS, np.nan)
    bins = np.floor(np.arctan2(points[:, 1], points[:, 0]) / (2.0 * np.pi) * DIRECTIONS).astype(int) % DIRECTIONS
    for k, radius in zip(bins, np.linalg.norm(points, axis=1), strict=True):
        reach[k] = np.fmax(reach[k], radius)
    known = np.flatnonzero(np.isfinite(reach))
    reach = np.interp(np.arange(DIRECTIONS), known, reach[known], period=DIRECTIONS)
    return gaussian_filter1d(reach, 1.0, mode="wrap")


def folds_of(reach: Floats) -> tuple[Floats, Floats]:
    """Directions of the folds [deg], and their depths [m]: the prominences of the peaks of an outermost radius."""
    count = len(reach)
    peaks, found = find_peaks(np.tile(reach, 3), prominence=MIN_FOLD)
    middle = (peaks >= count) & (peaks < 2 * count)
    return (peaks[middle] - count) * 360.0 / count, found["prominences"][middle]


def compare_drapes(mesh: ClothMesh, drape: Floats, reference: Floats, seam_gap: float) -> Drape:
    """Compare two drapes of one mesh.

    Args:
        mesh: the cloth, whose flat faces set the metric.
        drape, reference: positions [m], shape (n, 3).
        seam_gap: widest seam of the drape [m].
    """
    center = reference[:, [0, 2]].mean(axis=0)
    counts, depths, same, hem = [], [], [], None
    for height in SECTIONS:
        reaches = [outermost_radius(vertices, mesh.faces, height, center) for vertices in (drape, reference)]
        hem = hem or reaches
        (ours, our_depths), (theirs, their_depths) = (folds_of(reach) for reach in reaches)
        apart = np.abs((theirs[:, None] - ours + 180.0) % 360.0 - 180.0)
        counts.append((len(ours), len(theirs)))
        depths.append([1e3 * float(some.mean()) if len(some) else 0.0 for some in (our_depths, their_depths)])
        same.append(float((apart.min(axis=1, initial=360.0) <= SAME_PLACE_DEG).mean()) if len(theirs) else 1.0)
    assert hem is not None
    degrees = np.arange(DIRECTIONS) * 360.0 / DIRECTIONS
    bands = BandedEnergy(mesh)
    octaves = bands.band_ratios(bands.energy(drape[None]), bands.energy(reference[None]))
    curve = Curve(
        "direction [deg]", "outermost radius at the hem [mm]", (degrees, 1e3 * hem[1]), (degrees, 1e3 * hem[0])
    )
    return Drape(np.array(counts), np.array(depths), np.array(same), octaves, 1e3 * seam_gap, curve)


def _drape_cipc(setting: TrialSetting, bend_share: float) -> TrialResult:
    """Sew and drape the dress on the first frame of its body; error: of the worst octave."""
    data = Path(os.environ.get("GUBE_DATA") or "../shared/data")
    garments = data / "garments"
    if not (garments / "cipc_dress_draped.obj").exists():
        return TrialResult.lost(f"the dress is not in {garments} (GUBE_DATA)")
    flat = load_garment(garments / "cipc_dress_pattern_stitches.obj", pattern=True)
    reference = load_garment(garments / "cipc_dress_draped.obj", pattern=True).vertices
    seams = load_seams(garments / "cipc_dress_stitches.csv", len(flat.vertices))
    sequence = load_sequence(data / "sequences" / "cipc_body_rumba_dancing.npz")
    x, y, z = flat.vertices.T
    assert flat.pattern is not None
    mesh = ClothMesh.from_pattern(np.stack([x, z + LIFT, -y], axis=1), flat.faces, flat.pattern)
    mesh = replace(mesh, stitches=seams.vertices, stitch_weights=seams.weights)
    body = np.asarray(sequence.vertices[0], float), sequence.faces
    drape, cost = _sewn(mesh, body, bend_share, setting)
    found = compare_drapes(mesh, drape, reference, _gaps(seams, drape).max())
    figures = {f"octave {name}": ratio for name, ratio in found.octaves.items()}
    for height, folds, depth, same in zip(SECTIONS, found.folds, found.depth_mm, found.same_place, strict=True):
        figures |= {f"folds at {height} m": folds[0], f"reference folds at {height} m": folds[1]}
        figures |= {f"depth at {height} m [mm]": depth[0], f"reference depth at {height} m [mm]": depth[1]}
        figures |= {f"same place at {height} m": same}
    figures["seam gap [mm]"] = found.seam_gap_mm
    reached = TrialResult(float(found.folds[:, 1].sum()), float(found.folds[:, 0].sum()), found.worst_octave, cost)
    picture = _side_by_side(drape, reference, flat.faces, body)
    return replace(reached, curve=found.curve, figures={k: float(v) for k, v in figures.items()}, picture=picture)


def _fabric(bend: float, friction: float) -> Fabric:
    stretch = YOUNG * THICKNESS
    return Fabric(
        areal_density=DENSITY * THICKNESS, stretch_warp=stretch, stretch_weft=stretch, poisson=POISSON,
        shear=0.5 * stretch / (1.0 + POISSON), bend_warp=bend, bend_weft=bend, thickness=GAP, friction=friction,
    )  # fmt: skip


def _gaps(seams: Seams, places: Floats) -> Floats:
    (v, a, b), w = seams.vertices.T, seams.weights[:, None]
    return np.linalg.norm(places[v] - (1.0 - w) * places[a] - w * places[b], axis=1)


def _sewn(
    mesh: ClothMesh, posed: tuple[Floats, NDArray[np.int32]], bend_share: float, setting: TrialSetting
) -> tuple[Floats, float]:
    """Where the dress hangs [m], shape (n, 3), and the processor time of a frame of the last stage, median [ms]."""
    bend = HINGE_STIFFNESS * bend_share * YOUNG * THICKNESS**3 / (12.0 * (1.0 - POISSON**2))
    model = untethered(mesh, _fabric(bend, FRICTION), bend_factor=None)
    stiff = untethered(mesh, _fabric(CLOSING_BEND, 0.0), bend_factor=model.bend_factor)
    state = State.at_rest(model)
    vertices, faces = posed
    body = Body(faces, len(vertices))
    body.move_origin(state.origin)
    body.place((vertices - state.origin).astype(np.float32))
    colliders = Colliders(body=body)
    first = _gaps(Seams(stiff.stitches, stiff.stitch_weights.astype(float)), mesh.vertices)

    def stage(model: Model, seconds: float, substeps: int, weight: float, damping: float, closing: bool) -> float:
        options = SolverOptions(substep=1.0 / (FRAME_RATE * substeps), gravity=(0.0, -9.81 * weight, 0.0))
        steps, frames = TimedSteps(Solver(model, options).step, ()), round(seconds * FRAME_RATE)
        for frame in range(frames):
            open_to = [max(0.0, 1.0 - k / (0.75 * frames)) * first for k in (frame, frame + 1)]
            steps(state, colliders, 1.0 / FRAME_RATE, stitch_gaps=(open_to[0], open_to[1]) if closing else None)
            state.velocity *= np.float32(damping)
        return typical_ms(steps.times)

    stage(stiff, CLOSING_S, CLOSING_SUBSTEPS, 0.0, 0.0, True)
    stage(stiff, CLOSED_S, CLOSING_SUBSTEPS, 1.0, DAMPING, False)
    cost = stage(model, DRAPE_S, setting.substeps, 1.0, DAMPING, False)
    return state.world(), cost


def _side_by_side(
    drape: Floats, reference: Floats, faces: NDArray[np.int32], body: tuple[Floats, NDArray[np.int32]]
) -> NDArray[np.uint8]:
    from runtime.draw.picture_content import Drawn, frame_camera
    from runtime.draw.pictures import render, strip

    columns = []
    for azimuth in (20.0, 110.0, 200.0):
        camera = frame_camera(np.concatenate([drape, reference])[None], azimuth_deg=azimuth)[0]
        columns.append(
            [render([Drawn.body(*body), Drawn(some, faces)], camera, (500, 500)) for some in (drape, reference)]
        )
    return strip(columns, ["front", "side", "back"], ["gube", "IPC"])


ROWS = (
    Row("drape_cipc", "dress sewn from its pattern: octaves of curvature against an IPC solver's drape", _drape_cipc,
        0.25, 0.25, {"bend_share": Parameter("bending over Young's modulus [-]", BEND_SHARE, 0.01, 10.0)},
        best_solvers=("default",), refines=False),
)  # fmt: skip
