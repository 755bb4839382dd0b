"""Animations of a garment that is played or simulated: frames at a rate of their own, written to files."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from assets.character import Character
from assets.extras import require_extra
from assets.io.scene import Scene
from assets.io.sequence import Sequence
from assets.motion import ClipMotion, Motion
from pbd import InputError
from runtime.export.animation_files import bake_glb, bake_mdd, bake_obj, bake_pc2, bake_usd
from runtime.output.outputs import check_file
from runtime.play.game_loop import GameLoop, LiveInput
from runtime.play.player import Player, player_of
from runtime.play.simulation import Simulation
from runtime.setup.playback_inputs import PlaybackInputs
from wrinkles.database import WrinkleDatabase

__all__ = ["baked_frames", "check_baked", "clip_begin", "simulated_frames", "whole_steps", "write_baked"]

_BAKED = (".glb", ".usdc", ".pc2", ".mdd", ".obj")
BAKED_HZ = 30.0  # of a simulated animation [Hz]
TOLD = 30  # frames from one line of progress to the next


def clip_begin(motion: Motion) -> float:
    """Time at which a motion itself begins [s]: before that the body comes from the pose that its clothes lie on."""
    return motion.blend if isinstance(motion, ClipMotion) else motion.lead_in


def whole_steps(frames: float, every: int) -> int:
    """The first of every so many frames that is not before a place between frames."""
    return every * int(np.ceil(frames / every - 1e-6))


def baked_frames(
    database: WrinkleDatabase,
    inputs: PlaybackInputs,
    motion: Motion,
    rate_hz: float,
    seconds: float | None = None,
    *,
    report: Callable[[str], None] = lambda line: None,
) -> tuple[Player, np.ndarray, np.ndarray, np.ndarray]:
    """Play a motion and keep the garment at a rate of its own, from the motion's own first frame on.

    What leads to that frame is played and not kept, so that the frames fit the clip that somebody animated.

    Args:
        database: the database to play.
        inputs: with what it is played.
        motion: one of those of the inputs.
        rate_hz: rate of the kept frames [Hz].
        seconds: length of what is kept [s]; None keeps all of the motion.
        report: called with lines of progress.

    Returns:
        the player, and of each frame vertices in the world [m] and unit normals, float32, shape (f, N, 3), and the
        body's poses, shape (f, ...).

    Raises:
        InputError: a rate that is not positive.
    """
    tick = 1.0 / database.frame_rate
    report("baking: setting up the garment")
    player = player_of(database, inputs.body, motion.pose(0.0), primitives=inputs.primitives, wrinkles=inputs.wrinkles)
    ticks = int(np.ceil(database.frame_rate / rate_hz)) + 1 if rate_hz > 0.0 else 1
    loop = GameLoop(player, lambda t: LiveInput(motion.pose(t), inputs.wind), rate_hz, tick, ticks)
    begin = clip_begin(motion)
    duration = motion.duration - begin if seconds is None else min(seconds, motion.duration - begin)
    times = begin + np.arange(int(duration * rate_hz + 1e-6) + 1) / rate_hz
    report("baking: what leads to the first frame")
    steps = int(np.ceil(begin * rate_hz - 1e-6))
    for _ in range(steps):
        loop.advance(begin / steps)
    frames, normals = [], []
    for number in range(len(times)):
        if number:
            loop.advance(1.0 / rate_hz)
        if number % TOLD == 0:
            report(f"baking: {number} of {len(times)} frames")
        frames.append((player.vertices + player.origin).astype(np.float32))
        normals.append(player.normals.copy())
    return player, np.array(frames), np.array(normals), np.array([motion.pose(t) for t in times])


def simulated_frames(
    simulation: Simulation,
    motion: Motion | None,
    scene: Scene,
    seconds: float,
    report: Callable[[str], None] = lambda line: None,
) -> tuple[np.ndarray, np.ndarray | None, float, dict[str, float]]:
    """Simulate a scene and keep about 30 frames a second, from the motion's own first frame on.

    Args:
        simulation: simulation of the scene, at its start.
        motion: motion of its body, None without one.
        scene: gives wind and frame rate.
        seconds: length of what is kept [s].
        report: called with lines of progress.

    Returns:
        vertices in the world [m], float32, shape (f, n, 3); poses of the body, shape (f, ...), None without one; their
        rate [Hz]; and figures by name.

    Raises:
        InputError: the time is shorter than a frame.
    """
    dt = 1.0 / scene.solver.frame_rate
    count = int(seconds / dt + 1e-6)
    begin = 0.0 if motion is None else clip_begin(motion)
    if count < 1 and (motion is None or seconds < motion.duration - begin):  # the clip itself may be a pose
        raise InputError("nothing to simulate", key="--seconds", received=seconds, expected=f"at least {dt:.3g} [s]")
    every = max(1, round(scene.solver.frame_rate / BAKED_HZ))
    first = whole_steps(begin / dt, every)
    spent, frames = [], [] if first else [simulation.state.world()]
    for number in range(1, first + count + 1):
        if number % TOLD == 0:
            report(f"simulating: {number} of {first + count} frames")
        began = time.perf_counter()
        simulation.step(None if motion is None else motion.pose(number * dt), dt, scene.wind.air())
        spent.append(1e3 * (time.perf_counter() - began))
        if number >= first and (number - first) % every == 0:
            frames.append(simulation.state.world())
    figures = {
        "frame_count": float(count),
        "frame_ms_p50": float(np.median(spent)),
        "frame_ms_p99": float(np.percentile(spent, 99)),
        "vertex_count": float(simulation.model.vertex_count),
    }
    poses = None if motion is None else np.array([motion.pose((first + i * every) * dt) for i in range(len(frames))])
    return np.array(frames, np.float32), poses, 1.0 / (every * dt), figures


def check_baked(path: Path) -> None:
    """Refuse a file to which nothing could be baked later.

    Raises:
        InputError: the extension is unknown, the file cannot be written, or it is USD, which is not installed.
    """
    check_file(path, *_BAKED)
    if path.suffix.lower() == ".usdc":
        require_extra("usd", path)


def write_baked(
    path: Path,
    faces: np.ndarray,
    frames: np.ndarray,
    rate_hz: float,
    normals: np.ndarray | None = None,
    *,
    body: Character | Sequence | None = None,
    poses: np.ndarray | None = None,
    garments: Mapping[str, np.ndarray] | None = None,
    texture: np.ndarray | None = None,
) -> None:
    """Bake to the kind of file that the extension names; only .glb and .usdc take more along than the mesh and frames.

    Args:
        path: .glb, .usdc, .pc2, .mdd or .obj.
        faces: of the garment, int, shape (m, 3).
        frames: world [m], shape (f, n, 3).
        rate_hz: [Hz].
        normals: unit, shape (f, n, 3).
        body: what wears the garment.
        poses: of the body, one for each frame, shape (f, ...).
        garments: vertices of each garment of an outfit by its name, int, shapes (k,); None for one garment.
        texture: texture coordinates of each face corner, as :func:`runtime.export.animation_files.bake_glb` takes them.

    Raises:
        InputError: the extension is unknown, or the file cannot be written.
    """
    check_baked(path)
    ending = path.suffix.lower()
    if ending in (".glb", ".usdc"):
        bake = bake_glb if ending == ".glb" else bake_usd
        more = {"normals": normals, "body": body, "poses": poses, "garments": garments, "texture": texture}
        bake(path, faces, frames, rate_hz, **more)
    elif ending == ".pc2":
        bake_pc2(path, faces, frames, texture)
    elif ending == ".mdd":
        bake_mdd(path, faces, frames, rate_hz, texture)
    else:
        bake_obj(path, faces, frames, texture)
