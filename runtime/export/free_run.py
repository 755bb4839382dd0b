"""Plays a wrinkle database without a window: what a free run is, its figures and its pictures."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from assets.character import Character
from assets.io.sequence import Sequence
from assets.motion import Motion
from pbd import InputError
from pbd.wind import CALM, Air
from runtime.draw.shown_body import shown_body
from runtime.draw.strips import draw_strips_apart
from runtime.output.report import process_age
from runtime.play.game_loop import GameLoop, LiveInput, ScriptedInput
from runtime.play.player import Player, player_of
from runtime.play.simulation import body_source, poses_of
from runtime.setup.playback_inputs import PlaybackInputs
from wrinkles.database import WrinkleDatabase

__all__ = ["Free", "loop_figures", "play", "play_motion", "posed_bodies", "timing_figures"]

TIMINGS = ("frame", "coarse", "skin", "decode", "relax", "normals")
DRAWN = 10  # frames from one picture to the next
HASH_FRAME = 120  # the coarse state is hashed after this many frames


@dataclass(frozen=True)
class Free:
    """A free run of the player.

    Attributes:
        numbers: numbers of the kept frames, counted from 1, int, shape (f,).
        frames, smooth: fine vertices of the kept frames with and without wrinkles [m], float32, shape (f, N, 3).
        coarse: coarse vertices of the kept frames [m], float32, shape (f, n, 3).
        timings: processor times of every frame by part [ms].
        held_off: largest distance of an attached vertex from its target [m].
        state_hash: hash of the coarse state after 120 frames, or at the end of a shorter run.
    """

    numbers: np.ndarray
    frames: np.ndarray
    smooth: np.ndarray
    coarse: np.ndarray
    timings: dict[str, np.ndarray]
    held_off: float
    state_hash: str


def play(
    player: Player,
    poses: np.ndarray,
    dt: float,
    wind: Air = CALM,
    *,
    every: int = DRAWN,
    after: float = 0.0,
) -> Free:
    """Play all poses after the first one, at which the player stands.

    Args:
        player: plays the database.
        poses: one pose every ``dt``, shape (frames + 1, ...).
        dt: length of a frame [s].
        wind: velocity of the air [m/s].
        every: frames from one kept frame to the next.
        after: only frames after this time are kept [s].
    """
    rows: dict[str, list] = {"numbers": [], "frames": [], "smooth": [], "coarse": []}
    timings: dict[str, list[float]] = {name: [] for name in TIMINGS}
    held_off, state_hash = 0.0, player.simulation.state.hash()
    count = len(poses) - 1
    for number in range(1, count + 1):
        player.update(poses[number], dt, wind)
        for name in TIMINGS:
            timings[name].append(player.timings[name])
        targets = player.levels.fine_attachment.targets(player.body_vertices)
        off = np.linalg.norm(player.vertices[player.levels.fine_held] - targets, axis=1)
        held_off = max(held_off, float(off.max(initial=0.0)))
        if number == min(HASH_FRAME, count):
            state_hash = player.simulation.state.hash()
        if number % every == 0 and number * dt > after:
            rows["numbers"].append(number)
            rows["frames"].append((player.vertices + player.origin).astype(np.float32))
            coarse = player.simulation.state.world()
            rows["smooth"].append(player.smooth().astype(np.float32))
            rows["coarse"].append(coarse.astype(np.float32))
    arrays = {name: np.array(values) for name, values in rows.items()}
    spent = {name: np.array(values) for name, values in timings.items()}
    return Free(**arrays, timings=spent, held_off=held_off, state_hash=state_hash)


def timing_figures(free: Free, simulated_count: int, count: int) -> dict[str, float]:
    """Median times of the parts of a frame and its 99th percentile [ms], and numbers of vertices.

    Args:
        free: what was played.
        simulated_count, count: numbers of simulated and of shown vertices.
    """
    figures = {f"{name}_ms_p50": float(np.median(free.timings[name])) for name in TIMINGS}
    figures["frame_ms_p99"] = float(np.percentile(free.timings["frame"], 99))
    layer = sum(figures[f"{name}_ms_p50"] for name in ("decode", "relax", "normals"))
    return figures | {
        "us_per_fine_vertex": 1e3 * layer / count,
        "fine_vertex_count": float(count),
        "coarse_vertex_count": float(simulated_count),
    }


def play_motion(
    database: WrinkleDatabase, inputs: PlaybackInputs, motion: Motion, seconds: float | None, folder: Path
) -> dict[str, float | str]:
    """Play a motion and draw every tenth frame: smooth and ours, or plain cloth where that is the better choice.

    Args:
        database: the database to play.
        inputs: with what it is played.
        motion: one of those of the inputs.
        seconds: length of the motion that is played [s]; None plays all of it.
        folder: where the pictures are written.

    Returns:
        figures by name; ``first_frame_s`` counts from the start of the process.

    Raises:
        InputError: the time is too short for a picture.
    """
    dt = 1.0 / database.frame_rate
    poses = poses_of(motion, dt, seconds)
    if len(poses) <= DRAWN:
        raise InputError(
            "nothing to draw", key="--seconds", received=seconds, expected=f"at least {DRAWN * dt:.3g} [s]"
        )
    player = player_of(database, inputs.body, poses[0], primitives=inputs.primitives, wrinkles=inputs.wrinkles)
    first = process_age()
    free = play(player, poses, dt, inputs.wind, every=DRAWN)
    subdivision = player.levels.subdivision
    garment = (subdivision.faces, subdivision.flat_corners(inputs.pattern), player.levels.fine_layer)
    body = shown_body(inputs.body, player.levels)
    bodies = posed_bodies(body, poses[free.numbers])
    columns = {"smooth": free.smooth, "ours": free.frames}
    if player.cloth is not None:
        columns = {"plain cloth": free.frames}
    draw_strips_apart(folder, motion.name, columns, *garment, bodies, body.faces, free.numbers, dt)
    figures: dict[str, float | str] = {"frame_count": len(poses) - 1, "first_frame_s": first}
    figures |= timing_figures(free, player.simulation.model.vertex_count, subdivision.fine_count)
    return figures | {"attached_off_mm": 1e3 * free.held_off, "state_hash": free.state_hash}


def loop_figures(
    database: WrinkleDatabase, inputs: PlaybackInputs, motion: Motion, seconds: float, rate_hz: float
) -> dict[str, float]:
    """Play by the clock with a scripted gust and pull, see :class:`runtime.play.game_loop.ScriptedInput`.

    Args:
        database: the database to play.
        inputs: with what it is played.
        motion: one of those of the inputs.
        seconds: length of the play [s].
        rate_hz: rate of frames [Hz].

    Returns:
        figures of :meth:`runtime.play.game_loop.GameLoop.figures`.
    """
    player = player_of(database, inputs.body, motion.pose(0.0), primitives=inputs.primitives, wrinkles=inputs.wrinkles)
    script = ScriptedInput(player.simulation, motion, seconds)

    def live(t: float) -> LiveInput:
        scripted = script(t)
        return scripted._replace(wind=replace(inputs.wind, gust=scripted.wind))

    return GameLoop(player, live, rate_hz, 1.0 / database.frame_rate).run(seconds)


def posed_bodies(body: Character | Sequence, poses: Iterable[np.ndarray]) -> np.ndarray:
    """Vertices of a body in each of some poses, world [m], float32, shape (f, b, 3)."""
    source, frames = body_source(body), []
    for pose in poses:
        frames.append(np.zeros((len(source.vertices), 3), np.float32))
        source.skin(pose, np.zeros(3), frames[-1])
    return np.array(frames)
