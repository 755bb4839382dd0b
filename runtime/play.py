"""Plays a wrinkle database without a window: its inputs, frames, figures, pictures and animations."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from collections.abc import Sequence as Items
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from assets.character import Character
from assets.io.body_settings import MotionSettings
from assets.io.scene import Scene
from assets.io.sequence import Sequence, SequenceMotion, is_sequence, load_sequence
from assets.motion import ClipMotion
from pbd import InputError
from pbd.wind import CALM, Air, Wind
from runtime.bake import bake_glb, bake_mdd, bake_obj, bake_pc2, bake_usd
from runtime.game_loop import GameLoop, LiveInput, ScriptedInput
from runtime.garment_mesh import pattern_of
from runtime.garment_setup import colliders_of, scene_of
from runtime.outputs import check_file
from runtime.plain_player import PlainPlayer, player_of
from runtime.player import Player
from runtime.report import process_age
from runtime.scene_body import body_of, load_body, motion_of
from runtime.shown_body import shown_body
from runtime.simulation import Motion, Simulation, body_source, poses_of
from runtime.strips import draw_strips_apart
from wrinkles.database import WrinkleDatabase
from wrinkles.database_file import read_database

__all__ = [
    "BAKED",
    "PlaybackInputs",
    "Free",
    "baked_frames",
    "clip_begin",
    "playback_inputs",
    "loop_figures",
    "motions_of",
    "open_database",
    "play",
    "play_motion",
    "posed_bodies",
    "simulated_frames",
    "timing_figures",
    "whole_steps",
    "write_baked",
]

TIMINGS = ("frame", "coarse", "skin", "decode", "relax", "normals")
BAKED = (".glb", ".usdc", ".pc2", ".mdd", ".obj")
BAKED_HZ = 30.0  # of a simulated animation [Hz]
DRAWN = 10  # frames from one picture to the next
TOLD = 30  # frames from one line of progress to the next
HASH_FRAME = 120  # the coarse state is hashed after this many frames


@dataclass(frozen=True)
class PlaybackInputs:
    """The inputs with which a database is played.

    Attributes:
        body: the character or vertex sequence.
        motions: motions of the body, played one after the other.
        wind: see :mod:`pbd.wind`.
        primitives: colliders besides the body.
        pattern: place of each corner of each coarse face in the flat pattern, for pictures [m], shape (m, 3, 2); None
            where it is unknown.
        wrinkles: play what was learned even where plain cloth is the better choice.
    """

    body: Character | Sequence
    motions: tuple[Motion, ...]
    wind: Wind = Wind(CALM)
    primitives: tuple = ()
    pattern: np.ndarray | None = None
    wrinkles: bool = False


def playback_inputs(
    database: WrinkleDatabase, character: Path | None = None, *, clip: str | None = None
) -> PlaybackInputs:
    """The body and the motions with which a database is played.

    Args:
        database: the database; without ``character`` the scene stored in it names body and motions.
        character: a file with another source of the body and its clips: a character, or a vertex sequence.
        clip: name of a clip; None takes the held-out clips, or the first one if none is held out.

    Raises:
        InputError: the body is not the database's, the clip does not exist, or a file cannot be loaded.
    """
    if character is None:
        scene = scene_of(database)
        body = body_of(scene)
        database.require_body(body)
        motions = motions_of(body, clip, database.held_out, scene)
        return PlaybackInputs(body, motions, scene.wind.air(), colliders_of(scene), pattern_of(scene))
    body = load_sequence(character) if is_sequence(character) else load_body(character)
    database.require_body(body)
    return PlaybackInputs(body, motions_of(body, clip, database.held_out, None))


def open_database(
    path: Path,
    *,
    character: Path | None = None,
    clip: str | None = None,
    fabric: str | None = None,
    wrinkles: bool = False,
) -> tuple[WrinkleDatabase, PlaybackInputs]:
    """Read a database and the inputs with which it is played.

    Args:
        path: the database.
        character, clip: see :func:`playback_inputs`.
        fabric: name of a fabric of the database; None takes the garment's own.
        wrinkles: see :class:`PlaybackInputs`.

    Raises:
        InputError: the file is no database, it has no such fabric, or as :func:`playback_inputs`.
    """
    database = read_database(path)
    if fabric is not None:
        database = database.in_fabric(fabric)
    return database, replace(playback_inputs(database, character, clip=clip), wrinkles=wrinkles)


def motions_of(
    body: Character | Sequence, clip: str | None, held_out: Items[str], scene: Scene | None
) -> tuple[Motion, ...]:
    """The motions that are played: those held out, or one of another name.

    Args:
        body: that moves.
        clip: name of a clip; None takes the held-out clips, or the first one if none is held out.
        held_out: names of the clips that nothing is learned from.
        scene: that names clips of other files; None knows those of the body alone.

    Raises:
        InputError: the clip does not exist, or a file cannot be loaded.
    """
    character = scene.character if scene is not None else None
    own = (character.motion,) if character is not None and character.motion is not None else ()
    if isinstance(body, Sequence):
        if clip is not None:
            raise InputError("a vertex sequence has no clips", key="--clip", received=clip, expected="none")
        parts = scene.training.held_out or own if scene is not None else ()
        return tuple(motion_of(body, part) for part in parts) or (SequenceMotion(body),)
    known: dict[str, MotionSettings | None] = {}
    if scene is not None:
        known |= {motion.name: motion for motion in (*own, *scene.training.held_out, *scene.training.clips)}
    known |= {name: None for name in body.clips if name not in known}  # the body's own file
    if clip is not None:
        names = [clip]
    else:
        first = character.clip if character is not None else None
        names = [name for name in held_out if name in known] or [first or next(iter(known), "")]
    for name in names:
        if name not in known:
            expected = "one of " + ", ".join(sorted(known)) if known else "a character with clips"
            raise InputError("no such clip", key="--clip", received=name, expected=expected)
    return tuple(
        ClipMotion(body, body.clip(name)) if (settings := known[name]) is None else motion_of(body, settings)
        for name in names
    )


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
    player: Player | PlainPlayer,
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
    if isinstance(player, PlainPlayer):
        columns = {"plain cloth": free.frames}
    draw_strips_apart(folder, motion.name, columns, *garment, bodies, body.faces, free.numbers, dt)
    figures: dict[str, float | str] = {"frame_count": len(poses) - 1, "first_frame_s": first}
    figures |= timing_figures(free, player.simulation.model.vertex_count, subdivision.fine_count)
    return figures | {"attached_off_mm": 1e3 * free.held_off, "state_hash": free.state_hash}


def loop_figures(
    database: WrinkleDatabase, inputs: PlaybackInputs, motion: Motion, seconds: float, rate_hz: float
) -> dict[str, float]:
    """Play by the clock with a scripted gust and pull, see :class:`runtime.game_loop.ScriptedInput`.

    Args:
        database: the database to play.
        inputs: with what it is played.
        motion: one of those of the inputs.
        seconds: length of the play [s].
        rate_hz: rate of frames [Hz].

    Returns:
        figures of :meth:`runtime.game_loop.GameLoop.figures`.
    """
    player = player_of(database, inputs.body, motion.pose(0.0), primitives=inputs.primitives, wrinkles=inputs.wrinkles)
    script = ScriptedInput(player.simulation, motion, seconds)

    def live(t: float) -> LiveInput:
        said = script(t)
        return said._replace(wind=replace(inputs.wind, gust=said.wind))

    return GameLoop(player, live, rate_hz, 1.0 / database.frame_rate).run(seconds)


def posed_bodies(body: Character | Sequence, poses: Iterable[np.ndarray]) -> np.ndarray:
    """Vertices of a body in each of some poses, world [m], float32, shape (f, b, 3)."""
    source, frames = body_source(body), []
    for pose in poses:
        frames.append(np.zeros((len(source.vertices), 3), np.float32))
        source.skin(pose, np.zeros(3), frames[-1])
    return np.array(frames)


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
) -> tuple[Player | PlainPlayer, np.ndarray, np.ndarray, np.ndarray]:
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
        texture: texture coordinates of each face corner, as :func:`runtime.bake.bake_glb` takes them.

    Raises:
        InputError: the extension is unknown, or the file cannot be written.
    """
    check_file(path, *BAKED)
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
