"""Where the time of a frame goes, part by part, beside the limit of each part on this machine.

Ours is played as a game plays it. Plain cloth is simulated on each mesh of the chain from the coarse to the fine one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pbd import Colliders, InputError, Solver
from pbd.geometry import surface_normals
from pbd.taichi_internals import Launch
from precompute.benchmarks.frame_limits import (
    MachineSpeed,
    cloth_bytes,
    layer_bytes,
    machine_speed,
    network_products,
    normal_bytes,
)
from precompute.benchmarks.stopwatch import PARTS, Stopwatch, stopwatch
from precompute.learning.run_recording import Run
from precompute.learning.truth import database_run
from precompute.wrinkle_comparison.baselines import Cloth, coarse_cloth, fine_cloth, middle_cloth
from runtime.play.player import Player
from runtime.play.simulation import Simulation, body_source
from runtime.setup.playback_inputs import PlaybackInputs, open_database
from wrinkles.database import WrinkleDatabase
from wrinkles.levels import levels_of

__all__ = ["FrameBench", "FrameCost", "bench_frame", "frame_text"]

SKIPPED = 10  # frames that get going
LIMIT_EVERY = 3  # the constraints alone are measured in every third frame
PLAIN_S = {"plain_coarse": 2.0, "plain_middle": 1.0, "plain_middle_6_substeps": 1.0, "plain_fine": 0.5}  # played [s]
FEW_SUBSTEPS = 6
GROWTH_SUBSTEPS, GROWTH_FRAMES, GROWTH_SKIPPED = 24, 12, 3


@dataclass(frozen=True)
class FrameCost:
    """Times of one way to make a frame.

    Attributes:
        name: ``ours`` or ``plain_MESH``.
        vertex_count: of the simulated mesh.
        substeps: of a frame.
        times: of each part in each frame [ms], shape (f,); a part that did not run is left out. ``frame`` is the sum.
        limits: of the parts that have one [ms].
    """

    name: str
    vertex_count: int
    substeps: int
    times: Mapping[str, np.ndarray]
    limits: Mapping[str, float]

    def figures(self) -> dict[str, float]:
        """``PART_ms``, ``PART_p99_ms``, ``PART_limit_ms``, ``PART_over_limit`` of each part and of the frame."""
        found = {}
        for part, times in self.times.items():
            found |= {f"{part}_ms": float(np.median(times)), f"{part}_p99_ms": float(np.percentile(times, 99))}
            if part in self.limits:
                found |= {
                    f"{part}_limit_ms": self.limits[part],
                    f"{part}_over_limit": found[f"{part}_ms"] / self.limits[part],
                }
        return found

    def sum_ms(self, *parts: str) -> float:
        """Median time of several parts together [ms]."""
        return float(np.median(sum(self.times.get(part, np.zeros(1)) for part in parts)))


@dataclass(frozen=True)
class FrameBench:
    """All that was measured.

    Attributes:
        costs: of ours, and of plain cloth on each mesh.
        speed: of this machine.
        growth: time of a frame of the fine mesh subdivided once more, over that of the fine mesh, with equal substeps;
            None for a delivered mesh, whose pleats are in no subdivided one.
    """

    costs: Sequence[FrameCost]
    speed: MachineSpeed
    growth: float | None

    def figures(self) -> dict[str, float]:
        """Figures by name: ours without a prefix, plain cloth with its name before."""
        ours, *plain = self.costs
        frame = ours.times["frame"]
        p50, p99 = (float(np.percentile(frame, share)) for share in (50, 99))
        return {
            "frame_ms_p50": p50,
            "frame_ms_p99": p99,
            "frame_p99_over_p50": p99 / p50,
            "frame_without_network_ms": float(np.median(frame - ours.times.get("network", 0.0))),
            "skin_ms_p50": ours.sum_ms("skinning"),
            "coarse_ms_p50": ours.sum_ms("preparation", "search", "coarse_step"),
            "decode_ms_p50": ours.sum_ms("network", "surface"),
            "relax_ms_p50": ours.sum_ms("relaxation"),
            "normals_ms_p50": ours.sum_ms("normals"),
            **ours.figures(),
            **{f"{cost.name}_{name}": value for cost in plain for name, value in cost.figures().items()},
            **({} if self.growth is None else {"growth_of_four_times_the_vertices": self.growth}),
            **self.speed.figures(),
        }

    def rows(self) -> list[dict[str, Any]]:
        """One row for each part of each way."""
        return [
            {
                "cloth": cost.name,
                "vertex_count": cost.vertex_count,
                "substeps": cost.substeps,
                "part": part,
                "p50_ms": float(np.median(times)),
                "p99_ms": float(np.percentile(times, 99)),
                "limit_ms": cost.limits.get(part),
                "over_limit": float(np.median(times)) / cost.limits[part] if part in cost.limits else None,
            }
            for cost in self.costs
            for part, times in cost.times.items()
        ]


def bench_frame(path: Path, seconds: float, report: Callable[[str], None] = lambda line: None) -> FrameBench:
    """Measure a database on its own body and first held-out motion. All times are processor times.

    Args:
        path: the database.
        seconds: of motion that ours is played for.
        report: called with a line of progress.

    Raises:
        InputError: as :func:`runtime.setup.playback_inputs.open_database`, or fewer frames than get going.
    """
    database, inputs = open_database(path)
    motion = inputs.motions[0]
    run = database_run(database, inputs, motion)
    least = (SKIPPED + 2 * LIMIT_EVERY) / database.frame_rate
    if min(seconds, motion.duration) < least:
        raise InputError("nothing to measure", key="--seconds", received=seconds, expected=f"at least {least:.2g} [s]")
    report("ours")
    player = Player(database, inputs.body, run.poses[0], inputs.primitives)
    speed = machine_speed(len(database.coarse_vertices))
    costs = [_ours(player, run, inputs, speed, round(seconds * database.frame_rate))]
    clothes: dict[str, Cloth | None] = {"plain_coarse": coarse_cloth(database, run)}
    middle = middle_cloth(database, run)
    clothes |= {
        "plain_middle": middle,
        "plain_middle_6_substeps": None if middle is None else middle.with_substeps(FEW_SUBSTEPS),
        "plain_fine": fine_cloth(run),
    }
    for name, cloth in clothes.items():
        if cloth is not None:
            report(name.replace("_", " "))
            costs.append(_plain(name, cloth, speed, round(PLAIN_S[name] * database.frame_rate)))
    if database.binding is not None:
        return FrameBench(costs, speed, None)
    report("four times the vertices")
    return FrameBench(costs, speed, _growth(database, run))


def _ours(player: Player, run: Run, inputs: PlaybackInputs, speed: MachineSpeed, count: int) -> FrameCost:
    """Times of the player, and limits of its parts."""
    simulation, alone = player.simulation, _Constraints(player.simulation)
    frames: list[dict[str, float]] = []
    with stopwatch() as watch:
        for number in range(1, min(count, run.frame_count) + 1):
            before = simulation.state.copy()
            watch.take()
            player.update(run.poses[number], run.dt, inputs.wind)
            frames.append(watch.take())
            if number % LIMIT_EVERY == 0:
                alone.measure(before, run.dt, watch)
    times = _table(frames)
    limits = _memory_limits(
        {**cloth_bytes(simulation.model, simulation.body), **layer_bytes(player.levels, simulation.body)}, speed
    )
    limits |= {
        "coarse_step": alone.typical_ms,
        "network": network_products(player.database) / speed.products_per_ms,
    }
    limits = {part: limits[part] for part in times if part in limits}
    limits["frame"] = sum(limits.values())
    return FrameCost("ours", simulation.model.vertex_count, player.full.substeps, times, limits)


def _plain(name: str, cloth: Cloth, speed: MachineSpeed, count: int) -> FrameCost:
    """Times of plain cloth with normals of its own mesh, and limits of its parts."""
    simulation = cloth.simulation(cloth.options)
    alone, faces = _Constraints(simulation), cloth.model.mesh.faces.astype(np.int32)
    vertices, normals = np.zeros((2, cloth.model.vertex_count, 3), np.float32)
    shade, frames = Launch(surface_normals), []
    with stopwatch() as watch:
        for number in range(1, min(max(count, SKIPPED + 2 * LIMIT_EVERY), cloth.run.frame_count) + 1):
            before = simulation.state.copy()
            watch.take()
            simulation.step(cloth.run.poses[number], cloth.run.dt, cloth.run.wind)
            with watch.part("normals"):
                vertices[:] = simulation.state.position[:, :3]
                shade(vertices, faces, normals)
            frames.append(watch.take())
            if number % LIMIT_EVERY == 0:
                alone.measure(before, cloth.run.dt, watch)
    limits = _memory_limits(cloth_bytes(cloth.model, simulation.body), speed)
    limits |= _memory_limits({"normals": normal_bytes(len(vertices), len(faces))}, speed)
    limits["coarse_step"] = alone.typical_ms
    times = _table(frames)
    limits = {part: limits[part] for part in times if part in limits}
    limits["frame"] = sum(limits.values())
    return FrameCost(name, cloth.model.vertex_count, cloth.substeps, times, limits)


class _Constraints:
    """Times the constraints alone: a garment's step from the same state, without a body or other colliders."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._solver = Solver(simulation.model, simulation.solver.options)
        self._colliders = Colliders()
        self._times: list[float] = []

    def measure(self, before: Any, dt: float, watch: Stopwatch) -> None:
        """Step a state from before the frame; its held vertices go where the frame brought them."""
        attachment, state = self._simulation.attachment, self._simulation.state
        targets = None if attachment is None else attachment.targets(self._simulation.body.current) + state.origin
        watch.take()
        with watch.part("preparation"):
            self._solver.step(before, self._colliders, dt, targets)
        self._times.append(watch.take()["coarse_step"])

    @property
    def typical_ms(self) -> float:
        """Median time of the step's kernel [ms]."""
        return float(np.median(self._times[len(self._times) // 4 :]))


def _memory_limits(sizes: Mapping[str, float], speed: MachineSpeed) -> dict[str, float]:
    return {part: size / speed.copy_bytes_per_ms for part, size in sizes.items()}


def _table(frames: Sequence[Mapping[str, float]]) -> dict[str, np.ndarray]:
    """Times by part [ms], and of the whole frame; the frames that get going are left out."""
    frames = frames[SKIPPED:]
    times = {part: np.array([frame.get(part, 0.0) for frame in frames]) for part in PARTS}
    times = {part: row for part, row in times.items() if row.any()}
    return times | {"frame": np.array([sum(frame.values()) for frame in frames])}


def _growth(database: WrinkleDatabase, run: Run) -> float:
    """See :attr:`FrameBench.growth`."""
    source, simulations = body_source(run.body), []
    options = replace(run.solver, substep=run.dt / GROWTH_SUBSTEPS)
    for subdivisions in (database.subdivisions, database.subdivisions + 1):
        levels = levels_of(
            database.coarse_vertices, database.coarse_faces, database.held, source.vertices, source.faces,
            subdivisions, database.warp, limits=database.limits, sewn=database.sewn, layers=database.layers,
        )  # fmt: skip
        # The time does not depend on the stiffness of the hinges, which takes long to calibrate.
        model = levels.model(run.fabric, run.options, bend_factor=run.bend_factor, fine=True)
        attachment = levels.fine_attachment
        simulations.append(Simulation(model, attachment, source, run.poses[0], options, run.primitives))
    frames = []
    with stopwatch() as watch:
        for pose in run.poses[1 : GROWTH_FRAMES + 1]:
            frames.append([])
            for simulation in simulations:  # in turns, so that both meet the same other programs
                watch.take()
                simulation.step(pose, run.dt, run.wind)
                frames[-1].append(sum(watch.take().values()))
    small, large = np.median(frames[GROWTH_SKIPPED:], axis=0)
    return float(large / small)


def frame_text(bench: FrameBench) -> str:
    """The tables and single figures in words."""
    lines = []
    for cost in bench.costs:
        lines.append(f"{cost.name.replace('_', ' ')}: {cost.vertex_count} vertices, {cost.substeps} substeps")
        lines.append(f"    {'part':12} {'p50 [ms]':>9} {'p99 [ms]':>9} {'limit [ms]':>10} {'over limit':>10}")
        for row in (row for row in bench.rows() if row["cloth"] == cost.name):
            limit = "" if row["limit_ms"] is None else f" {row['limit_ms']:10.3f} {row['over_limit']:10.1f}"
            name = row["part"].replace("_", " ")
            lines.append(f"    {name:12} {row['p50_ms']:9.3f} {row['p99_ms']:9.3f}{limit}")
    figures = bench.figures()
    lines += [
        f"without the network: {figures['frame_without_network_ms']:.2f} ms, p99 over p50: "
        f"{figures['frame_p99_over_p50']:.2f}",
        *([] if bench.growth is None else [f"four times the vertices take {bench.growth:.2f} times as long"]),
        f"this machine copies {figures['memory_copy_gb_s']:.1f} GB/s (read and written) and multiplies at "
        f"{figures['blas_gflop_s']:.0f} GFLOP/s",
    ]
    return "\n".join(lines)
