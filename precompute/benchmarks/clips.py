"""Real garments on real clips at 60 Hz: whether they stay out of the body, out of each other, and within bounds."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from assets.fabrics import PRESETS
from assets.io.body_settings import MotionSettings
from assets.io.scene import parse_scene
from assets.loading import load_garment
from assets.motion import Motion
from pbd import ClothMesh, InputError, ModelOptions, SolverOptions, build_model
from pbd.crossings import crossings
from pbd.distance import TOLERANCE, BodyDistance
from precompute.experiment.error_classes import LIMITS, longest_run
from precompute.experiment.measures import FRAME_RATE, GRAVITY
from precompute.reporting.tables import write_table
from precompute.workers import Workers, run_jobs
from runtime.draw.picture_content import Drawn, frame_camera
from runtime.draw.pictures import render, save_png, strip
from runtime.play.simulation import Simulation, body_source
from runtime.setup.scene_body import load_body, motion_of
from runtime.setup.scene_simulation import simulation_of

__all__ = ["CLIPS", "MAX_OVER_LIMBS", "clip_rows", "overlapping", "run_clip", "shrinking", "write_clips"]

Picture = Callable[[np.ndarray], None]

# Of coarse garments, half the default [s]: longer ones draw out light cloth between heavier cloth, such as
# straps of 6 mg a vertex that carry a skirt of 96 g, or slivers of a tight sleeve.
SUBSTEP = 1.0 / 1440.0
UNJUDGED_S = 0.5  # the first seconds of a run are not judged [s]
MAX_OVER_LIMBS = 2.0  # that cloth may be faster than the fastest limb of the last half second [m/s]
LAYERS = ((0.31, 0.50, 0.70), (0.74, 0.44, 0.34))
# 1.4 m of the loose dress's skirt on 0.7 m of waist, in edges of 5 cm
GATHERED = ModelOptions(compression_compliance_scale=30.0)
SHRINKING, SETTLING = 32, 12  # steps in which the loose dress goes to its pattern's size, frames of each
SHOWN = 6  # frames in the picture

_MAKEHUMAN = """
[[garment]]
name = "{inner}"
mesh = "${{GUBE_DATA}}/garments/mh_female_{inner}.obj"
fabric = "{inner_fabric}"
attach = "top"
subdivisions = 1
[[garment]]
name = "tshirt"
mesh = "${{GUBE_DATA}}/garments/mh_female_tshirt.obj"
fabric = "jersey"
attach = "top"
subdivisions = 1
[character]
file = "${{GUBE_DATA}}/characters/{character}.glb"
clip = "{clip}"
[solver]
substep = {substep}
"""
_DRESS = """
[[garment]]
name = "cipc_dress"
mesh = "${GUBE_DATA}/garments/cipc_dress_draped.obj"
pattern = true
seams = "${GUBE_DATA}/garments/cipc_dress_stitches.csv"
coarse_vertices = 1000
fabric = "cotton"
[character]
sequence = "${GUBE_DATA}/sequences/cipc_body_rumba_dancing.npz"
"""


def _delivered_dress() -> tuple[Simulation, Motion]:
    """The C-IPC dress, fine, where its file has it: the surface bound to its coarse mesh crowds in the pleats."""
    bound, motion = _of_scene(_DRESS, fine=True)
    garment = load_garment(parse_scene(_DRESS, "clip").garments[0].mesh, pattern=True)
    mesh, made = replace(bound.model.mesh, vertices=garment.vertices), bound.model
    model = build_model(mesh, made.fabric, made.held, options=made.options, bend_factor=made.bend_factor)
    return Simulation(model, None, bound.source, motion.pose(0.0), bound.solver.options), motion


def _of_scene(text: str, fine: bool = False) -> tuple[Simulation, Motion]:
    simulation, motion = simulation_of(parse_scene(text, "clip"), fine)
    assert motion is not None
    return simulation, motion


def _loose_dress() -> tuple[Simulation, Motion]:
    """The ARCSim dress in its pattern's own size; nothing holds it but the shoulders.

    Its file has it stretched up to four times: it starts from what has shrunk to the pattern without speed or weight.
    """
    scene = parse_scene(
        '[[garment]]\nname = "dress"\nmesh = "${GUBE_DATA}/garments/arcsim_dress_yellow_sub2_NC.obj"\npattern = true\n'
        '[character]\nfile = "${GUBE_DATA}/characters/arcsim_female_dance_NC.glb"\n',
        "clip",
    )
    garment = load_garment(scene.garments[0].mesh, pattern=True)
    assert garment.pattern is not None and scene.character is not None and scene.character.file is not None
    mesh = ClothMesh.from_pattern(garment.vertices, garment.faces, garment.pattern)
    body = load_body(scene.character.file)
    motion = motion_of(body, MotionSettings(file=scene.character.file, clip=next(iter(body.clips))))
    pose, source = motion.pose(0.0), body_source(body)
    options = SolverOptions(substep=SUBSTEP, self_collision=True)
    bend_factor = build_model(mesh, PRESETS["cotton"]).bend_factor
    for flat in shrinking(mesh, SHRINKING):
        model = build_model(replace(mesh, flat=flat), PRESETS["cotton"], options=GATHERED, bend_factor=bend_factor)
        simulation = Simulation(model, None, source, pose, replace(options, gravity=(0.0, 0.0, 0.0)))
        for _ in range(SETTLING):
            simulation.step(pose, 1.0 / FRAME_RATE)
            simulation.state.velocity[:] = 0.0
        mesh = replace(mesh, vertices=_unposed(simulation.state.world(), pose))
    model = build_model(mesh, PRESETS["cotton"], options=GATHERED, bend_factor=bend_factor)
    return Simulation(model, None, source, pose, options), motion


def shrinking(mesh: ClothMesh, steps: int) -> list[np.ndarray]:
    """Rest shapes of the faces on the way from the mesh as it stands in space to its pattern, in equal steps.

    Each face's metric C = F^T F goes from that of its start to that of the pattern; the last is the pattern itself. A
    pattern blown up instead and shrunk as a whole crumples what starts less stretched than that.

    Returns:
        As ``flat`` of :class:`ClothMesh` [m], ``steps`` times shape (m, 2, 2).
    """
    corners = mesh.vertices[mesh.faces]
    sides = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
    slopes = sides @ np.linalg.inv(mesh.flat)
    metric = slopes.transpose(0, 2, 1) @ slopes
    shares = np.arange(1, steps) / steps
    # Cholesky's L^T keeps the warp where it is: it only stretches and shears.
    parts = [np.linalg.cholesky((1.0 - share) * metric + share * np.eye(2)).transpose(0, 2, 1) for share in shares]
    return [part @ mesh.flat for part in parts] + [mesh.flat]


def _unposed(world: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Where points of the world are in the bind pose that a pose moves as a whole."""
    return (world - pose[0, :, 3]) @ np.linalg.inv(pose[0, :, :3]).T


def _makehuman(inner: str, inner_fabric: str, character: str, clip: str) -> Callable[[], tuple[Simulation, Motion]]:
    text = _MAKEHUMAN.format(inner=inner, inner_fabric=inner_fabric, character=character, clip=clip, substep=SUBSTEP)
    return lambda: _of_scene(text)


CLIPS: Mapping[str, Callable[[], tuple[Simulation, Motion]]] = {
    "trousers-tshirt-dance": _makehuman("trousers", "denim", "mh_female_cmu_rokoko", "dance_rokoko"),
    "skirt-tshirt-run": _makehuman("skirt_long", "wool", "mh_female_bandai_NC", "run_bandai"),
    "cipc-dress-rumba": _delivered_dress,
    "arcsim-dress-dance": _loose_dress,
}


def run_clip(
    simulation: Simulation, motion: Motion, seconds: float | None = None, *, picture: Picture | None = None
) -> dict[str, float]:
    """Play a clip to its end and judge it.

    A vertex is inside where the body's surface has it inside and winds about it once; where limbs go through one
    another it winds twice, and no place is right. Nor is any length there: edges with an end or their middle in it are
    counted apart.

    Args:
        simulation: at its start.
        motion: of the body.
        seconds: only the start of it.
        picture: called with an image of a few frames, as for :func:`runtime.draw.pictures.save_png`.

    Returns:
        figures by name, see :func:`_clip_figures`; where a run ends early because it is not finite, ``frames``,
        ``vertex_count`` and ``finite`` alone.
    """
    model, count = simulation.model, simulation.model.vertex_count
    duration = motion.duration if seconds is None else min(seconds, motion.duration)
    frames = int(np.floor(duration * FRAME_RATE + 1e-6))
    distance = BodyDistance(simulation.body.faces)
    edges, lengths = model.mesh.edge_lengths()
    box = _diagonal(simulation.state.world())
    height = float(np.ptp(simulation.state.world(), axis=0).max())
    inside = np.zeros((frames, count), bool)
    times, limbs, fastest, moved, boxes = np.zeros((5, frames))
    before = simulation.state.world()
    worst = np.zeros((frames, len(edges)), np.float32)
    drawn, excused = np.zeros((2, frames), bool)  # edges over the limit, and where no length is right
    shown: list[tuple[np.ndarray, np.ndarray]] = []
    for frame in range(frames):
        pose = motion.pose((frame + 1) / FRAME_RATE)
        begin = time.process_time()
        simulation.step(pose, 1.0 / FRAME_RATE)
        times[frame] = time.process_time() - begin
        world, body = simulation.state.world(), simulation.body
        if not (np.isfinite(world).all() and np.isfinite(simulation.state.velocity).all()):
            return {"frames": float(frame + 1), "vertex_count": float(count), "finite": 0.0}
        posed = body.current + body.origin
        depth = distance.signed_distance(world, posed)
        under = np.flatnonzero(depth < -TOLERANCE)
        winding = distance.winding(world[under], posed)
        inside[frame, under] = (winding > 0.5) & (winding < 1.5)
        limbs[frame] = np.linalg.norm(body.current - body.previous, axis=1).max() * FRAME_RATE
        fastest[frame] = np.linalg.norm(simulation.state.velocity, axis=1).max()
        moved[frame], before = np.linalg.norm(world - before, axis=1).max() * FRAME_RATE, world
        worst[frame] = np.linalg.norm(world[edges[:, 1]] - world[edges[:, 0]], axis=1) / lengths - 1.0
        over = np.flatnonzero(worst[frame] > LIMITS["edge_strain_beyond"][2])
        apart = overlapping(distance, world[edges[over]], posed)
        drawn[frame], excused[frame] = not apart.all(), apart.any()
        boxes[frame] = _diagonal(world) / box
        if picture is not None and frame in _moments(frames):
            shown.append((world, posed))
    if picture is not None:
        picture(_drawn(simulation, shown, [f"{(frame + 1) / FRAME_RATE:.1f} s" for frame in _moments(frames)]))
    bound = 3.0 * np.sqrt(2.0 * GRAVITY * height) + limbs
    broken = drawn | (fastest > bound * LIMITS["speed_over_limit"][2]) | (boxes > LIMITS["box_ratio"][2])
    return _clip_figures(simulation, times, limbs, fastest, moved, worst, inside, broken, excused)


def _clip_figures(
    simulation: Simulation,
    times: np.ndarray,
    limbs: np.ndarray,
    fastest: np.ndarray,
    moved: np.ndarray,
    worst: np.ndarray,
    inside: np.ndarray,
    broken: np.ndarray,
    excused: np.ndarray,
) -> dict[str, float]:
    """Figures of a clip that was played to its end.

    Args:
        simulation: at its end.
        times: processor time of each frame [s], shape (f,).
        limbs, fastest, moved: of the fastest body vertex, of the fastest cloth vertex by the state's velocity and from
            frame to frame [m/s], shape (f,).
        worst: strain of every edge [-], shape (f, e).
        inside: vertices inside the body, bool, shape (f, n).
        broken: frames beyond a limit for edges, speed or size, bool, shape (f,).
        excused: frames with such edges only where the body goes through itself, bool, shape (f,).

    Returns:
        ``frames``, ``vertex_count``, ``frame_ms_p50``, ``frame_ms_p99``: processor time of body and garments;
        ``inside_s``: longest time that a vertex is inside the body; ``inside_body_percent``: of vertices, on average;
        ``crossings_layers``, ``crossings_self``: edges that go through faces at the end; ``speed_over_limb``: most that
        cloth is faster than the fastest limb of the last half second, by where it is from frame to frame [m/s];
        ``velocity_over_limb``: the same by the velocities of the state, which tremble within a frame;
        ``edge_strain_p99``, ``edge_strain_max``, and ``edges_beyond_percent``: of edges over twice as long as at rest,
        on average;
        ``catastrophic_frames``: by the limits of
        :mod:`precompute.experiment.error_classes`, the start for the reference;
        ``overlap_frames``: those in which only edges where the body goes through itself are over the limit;
        ``finite``: 1 if all is.
    """
    model, frames = simulation.model, len(times)
    later = min(round(UNJUDGED_S * FRAME_RATE), frames - 1)
    recent = np.array([limbs[max(0, k - round(0.5 * FRAME_RATE)) : k + 1].max() for k in range(frames)])
    catastrophic = broken | _held(inside, round(LIMITS["penetration_s"][2] * FRAME_RATE))
    rows = crossings(simulation.state.world(), model.mesh.faces)
    between = model.layer[rows[:, 0]] != model.layer[model.mesh.faces[rows[:, 2], 0]]
    return {
        "frames": float(frames),
        "vertex_count": float(model.vertex_count),
        "frame_ms_p50": 1e3 * float(np.median(times[1:])),
        "frame_ms_p99": 1e3 * float(np.percentile(times[1:], 99)),
        "inside_s": max(longest_run(column) for column in inside[later:].T) / FRAME_RATE,
        "inside_body_percent": 100.0 * float(inside[later:].mean()),
        "crossings_layers": float(between.sum()),
        "crossings_self": float((~between).sum()),
        "speed_over_limb": float((moved - recent)[later:].max()),
        "velocity_over_limb": float((fastest - recent)[later:].max()),
        "edge_strain_p99": float(np.percentile(worst[later:], 99)),
        "edges_beyond_percent": 100.0 * float((worst[later:] > LIMITS["edge_strain_beyond"][2]).mean()),
        "edge_strain_max": float(worst[later:].max()),
        "catastrophic_frames": float(catastrophic[later:].sum()),
        "overlap_frames": float((excused & ~catastrophic)[later:].sum()),
        "finite": 1.0,
    }


def _held(inside: np.ndarray, frames: int) -> np.ndarray:
    """Frames in which some vertex has been inside for more than so many frames, shape (f,)."""
    row, found = np.zeros(inside.shape[1], int), np.zeros(len(inside), bool)
    for frame, now in enumerate(inside):
        row = np.where(now, row + 1, 0)
        found[frame] = (row > frames).any()
    return found


def overlapping(distance: BodyDistance, ends: np.ndarray, posed: np.ndarray) -> np.ndarray:
    """Edges with an end or their middle where the body goes through itself, from shape (k, 2, 3): bool, shape (k,)."""
    places = np.stack([ends[:, 0], ends[:, 1], ends.mean(axis=1)], axis=1)
    return np.any(distance.winding(places.reshape(-1, 3), posed).reshape(-1, 3) > 1.5, axis=1)


def _diagonal(points: np.ndarray) -> float:
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def _moments(frames: int) -> list[int]:
    return np.linspace(0, frames - 1, SHOWN + 1).astype(int)[1:].tolist()


def _drawn(simulation: Simulation, shown: Sequence, titles: list[str]) -> np.ndarray:
    """A row of frames from before, and one from behind."""
    model = simulation.model
    columns = []
    for world, posed in shown:
        images = []
        for azimuth in (25.0, 205.0):
            (camera,) = frame_camera(posed[None], azimuth_deg=azimuth, aspect=0.75)
            meshes = [Drawn.body(posed, simulation.body.faces)]
            for layer in range(int(model.layer.max()) + 1):
                faces = model.mesh.faces[model.layer[model.mesh.faces[:, 0]] == layer]
                meshes.append(Drawn(world, faces, LAYERS[layer]))
            images.append(render(meshes, camera, (420, 560), floor=None))
        columns.append(images)
    return strip(columns, titles, ["front", "back"])


def _played(name: str, drawn: bool) -> tuple[dict[str, float], list[np.ndarray]]:
    """Figures of a clip, and its picture if it is wanted and the clip came to its end."""
    pictures: list[np.ndarray] = []
    figures = run_clip(*CLIPS[name](), picture=pictures.append if drawn else None)
    return figures, pictures


def clip_rows(
    names: Sequence[str] = (),
    *,
    report: Callable[[str], None] = lambda line: None,
    pictures: Path | None = None,
    workers: Workers | int = 1,
) -> list[dict[str, Any]]:
    """A row of each clip, see :func:`run_clip`; all of :data:`CLIPS` where no name is given.

    Args:
        names: keys of :data:`CLIPS`.
        report: called with a line of progress.
        pictures: folder of a picture of each.
        workers: that play the clips, or how many do; each reads ``GUBE_DATA`` of its own machine.

    Raises:
        InputError: no such clip, or its data are not in ``GUBE_DATA``.
    """
    for name in names:
        if name not in CLIPS:
            raise InputError("no such clip", key="NAME", received=name, expected=", ".join(CLIPS))
    wanted = names or tuple(CLIPS)
    jobs = [partial(_played, name, pictures is not None) for name in wanted]
    found = run_jobs(jobs, workers, done=lambda count, played: report(f"{count} of {len(jobs)} clips"))
    if pictures is not None:
        for name, (_, images) in zip(wanted, found, strict=True):
            for image in images:
                save_png(pictures / f"{name}.png", image)
    return [{"clip": name, **figures} for name, (figures, _) in zip(wanted, found, strict=True)]


def write_clips(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows as CSV with machine and date."""
    write_table(path, rows, digits=4, machine=True)
