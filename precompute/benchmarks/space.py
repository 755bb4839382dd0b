"""Convergence in space: on which mesh a garment's folds stop changing when the mesh is refined again.

The garment of a scene settles on its body and then moves with it, on meshes that are subdivided once, twice, three
times. All meshes keep their thickness from themselves: a fold that goes through itself is sharper than any cloth. The
energy of bending is compared in octaves of wavelength from the thickness of the fabric up.

Cloth at turned hems, which are modelled into a mesh, is left out: at rest it is bent about a radius of millimetres,
though the fabric has no rest angles, and a finer mesh only draws this bend more sharply.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from assets.fabrics import PRESETS
from assets.io.scene import Scene
from precompute.workers import Workers
from runtime.garment_setup import GarmentSetup, fabric_of, fine_options
from runtime.simulation import Simulation, body_source
from wrinkles.spectrum import BandedEnergy

__all__ = ["Measured", "converged_mesh", "measure_meshes", "space_rows", "space_text"]

SETTLING = 1.5  # in the bind pose, before anything moves [s]
SKIPPED = 1.0  # of the motion: it leads from the bind pose to the clip [s]
EVERY = 6  # frames from one measured frame to the next
MAX_CHANGE = 0.1  # of the energy from a mesh to the next finer one
MIN_SHARE = 0.1  # of the whole energy; the change of an octave with less says little
HEM_RADIUS = 0.015  # cloth that is bent more sharply at rest belongs to a hem [m]
HEM_REACH = 0.02  # so far around hems nothing is counted [m]


@dataclass(frozen=True)
class Measured:
    """One fabric on one mesh.

    Attributes:
        fabric: its name.
        subdivisions: of the coarse mesh.
        vertices: how many.
        edge: mean length at rest [m].
        gravity_length: of the fabric [m].
        counted: share of the area that is not at hems [-].
        bands: names of the octaves.
        settled, moving: bending energy of each octave by area, per unit of bending stiffness [1/m2], shape (b,).
        frame_ms: median time of a frame [ms].
    """

    fabric: str
    subdivisions: int
    vertices: int
    edge: float
    gravity_length: float
    counted: float
    bands: tuple[str, ...]
    settled: np.ndarray
    moving: np.ndarray
    frame_ms: float

    def change_to(self, finer: Measured) -> tuple[float, float]:
        """Change of the whole energy to the finer mesh, and of the octave that changes most, over the finer one's [-].

        Settled and moving cloth are judged apart; the larger change counts.
        """
        total, octave = [], []
        for one, other in ((self.settled, finer.settled), (self.moving, finer.moving)):
            total.append(abs(one.sum() / other.sum() - 1.0))
            much = other > MIN_SHARE * other.sum()
            octave.append(np.abs(one[much] / other[much] - 1.0).max())
        return float(max(total)), float(max(octave))


def measure_meshes(
    scene: Scene,
    fabrics: Sequence[str],
    most: int = 3,
    seconds: float = 2.0,
    workers: int = 1,
    report: Callable[[str], None] | None = None,
) -> list[Measured]:
    """Simulate a scene's garment in each fabric on each mesh; fabrics in their order, the coarsest mesh first.

    Args:
        scene: with one garment on one body.
        fabrics: presets; none takes the scene's own fabric.
        most: subdivisions of the finest mesh.
        seconds: of the motion that are simulated, the lead-in included [s].
        workers: processes at a time.
        report: told a line of progress after each run.

    Raises:
        InputError: as :meth:`runtime.garment_setup.GarmentSetup.of`.
    """
    garment = scene.garments[0]
    worn = {name: replace(garment, fabric=PRESETS[name]) for name in fabrics} or {"own": garment}
    GarmentSetup.of(replace(scene, garments=(replace(garment, subdivisions=1),)))  # refuses what cannot be simulated
    jobs = [
        partial(_measured, replace(scene, garments=(replace(one, subdivisions=level),)), name, seconds)
        for level in range(most, 0, -1)  # the longest runs first
        for name, one in worn.items()
    ]
    tell = report or (lambda line: None)
    with Workers.of(workers) as pool:
        found = pool.run(jobs, done=lambda count, result: tell(f"{count} of {len(jobs)} runs"))
    order = list(worn)
    return sorted(found, key=lambda one: (order.index(one.fabric), one.subdivisions))


def _measured(scene: Scene, fabric: str, seconds: float) -> Measured:
    """Simulate one fabric on one mesh."""
    stage = GarmentSetup.of(scene)
    settings, levels, motion = stage.settings, stage.levels, stage.motion()
    options = replace(fine_options(scene, settings.subdivisions_of_mesh), self_collision=True)
    worn, dt = fabric_of(settings), 1.0 / scene.solver.frame_rate
    model = levels.model(worn, fine=True)
    pose = motion.pose(0.0)
    simulation = Simulation(model, levels.fine_attachment, body_source(stage.body), pose, options)
    still, times = round(SETTLING / dt), []
    settled, moving = [], []
    for frame in range(1, still + round(seconds / dt) + 1):
        began = time.perf_counter()
        simulation.step(motion.pose(max(frame - still, 0) * dt), dt)
        times.append(time.perf_counter() - began)
        if frame % EVERY == 0 and still - 3 * EVERY < frame <= still:
            settled.append(simulation.vertices)
        elif frame % EVERY == 0 and frame > still + SKIPPED / dt:
            moving.append(simulation.vertices)
    octaves = worn.thickness * 2.0 ** np.arange(1, 8)
    energy = BandedEnergy(levels.fine, octaves)
    where = np.ones(len(levels.rest_vertices), bool)
    if levels.sewn is None:  # cloth that was cut flat is bent nowhere at rest
        where = away_from_hems(energy, levels.rest_vertices)
    area = float(energy.areas[where].sum())
    return Measured(
        fabric,
        settings.subdivision_count,
        len(levels.fine.vertices),
        float(levels.fine.edge_lengths()[1].mean()),
        worn.gravity_length,
        area / float(energy.areas.sum()),
        energy.names,
        energy.energy(np.stack(settled), where).mean(axis=0) / area,
        energy.energy(np.stack(moving), where).mean(axis=0) / area,
        1e3 * float(np.median(times)),
    )


def away_from_hems(energy: BandedEnergy, rest_vertices: np.ndarray) -> np.ndarray:
    """Vertices that are not at cloth that is bent sharply at rest: bool, shape (n,)."""
    hem = energy.curvature(rest_vertices) > 1.0 / HEM_RADIUS
    if not hem.any():
        return np.ones(len(rest_vertices), bool)
    return cKDTree(rest_vertices[hem]).query(rest_vertices)[0] > HEM_REACH


def converged_mesh(rows: Sequence[Measured]) -> Measured | None:
    """The coarsest mesh of one fabric from which the next finer one differs by less than 10 %; None without one."""
    for one, finer in zip(rows[:-1], rows[1:], strict=True):
        if max(one.change_to(finer)) < MAX_CHANGE:
            return one
    return None


def space_rows(found: Sequence[Measured]) -> list[dict[str, Any]]:
    """The table: a row for each fabric and mesh, with the change to the next finer mesh of the same fabric."""
    rows = []
    for one, after in zip(found, [*found[1:], None], strict=True):
        row = {
            "fabric": one.fabric,
            "subdivisions": one.subdivisions,
            "vertices": one.vertices,
            "edge_mm": 1e3 * one.edge,
            "edge_over_gravity_length": one.edge / one.gravity_length,
            "settled": float(one.settled.sum()),
            "moving": float(one.moving.sum()),
            "frame_ms": one.frame_ms,
        }
        row |= {f"moving {name}": float(value) for name, value in zip(one.bands, one.moving, strict=True)}
        if after is not None and after.fabric == one.fabric:
            total, octave = one.change_to(after)
            row |= {"change_total_percent": 100.0 * total, "change_octave_percent": 100.0 * octave}
        rows.append(row)
    return rows


def space_text(found: Sequence[Measured]) -> str:
    """The table as text, and for each fabric the mesh from which the next finer one hardly differs."""
    lines = [
        f"{'fabric':10s} vertices  edge  edge/l_g  settled  moving  change: total  octave   a frame",
        *(
            f"{row['fabric']:10s} {row['vertices']:8d} {row['edge_mm']:4.1f} mm {row['edge_over_gravity_length']:6.2f}"
            f" {row['settled']:9.0f} {row['moving']:7.0f} {row.get('change_total_percent', np.nan):12.0f} %"
            f" {row.get('change_octave_percent', np.nan):5.0f} % {row['frame_ms']:6.0f} ms"
            for row in space_rows(found)
        ),
    ]
    for fabric in dict.fromkeys(one.fabric for one in found):
        mesh = converged_mesh([one for one in found if one.fabric == fabric])
        said = "no mesh has converged" if mesh is None else f"converged from {mesh.subdivisions} subdivisions on"
        lines.append(f"{fabric}: {said}")
    return "\n".join(lines)
