"""Cost of each setting of a player and its distance from full detail, measured on held-out motion."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from itertools import combinations, product

import numpy as np
from threadpoolctl import threadpool_limits

from assets.character import Character
from assets.motion import Motion
from pbd import InputError, State
from pbd.distance import BodyDistance
from pbd.wind import Air
from precompute.learning.truth import SETTLE
from precompute.wrinkle_comparison.baselines import PROBE_FRAMES
from runtime.detail.cost_table import CostTable, Setting
from runtime.output.report import machine_description
from runtime.play.level_of_detail import LevelOfDetail
from runtime.play.player import Player
from runtime.setup.playback_inputs import PlaybackInputs
from wrinkles.coarse_filter import CoarseFilter
from wrinkles.database import WrinkleDatabase
from wrinkles.proxy_mesh import proxy_mesh_of

__all__ = ["cost_table_key", "measure_cost_table"]

TEMPOS = (1.0, 1.5)  # that the motion is played at: errors grow with speed
EVERY = (1, 2, 4, 8)
SUBSTEPS = (1.0, 2 / 3, 1 / 2, 1 / 3)  # a tick, shares of the full number
PROXY_SUBSTEPS = (1 / 2, 1 / 3, 1 / 4)  # the same on the mesh below, whose longer edges need fewer
ATOMS = (1.0, 1 / 2, 1 / 6)
MAX_TICKS = 400  # ticks that are played at each tempo
HOLE_CHECKS = 4  # ticks in which unrelaxed cloth is tested for being inside the body
REFERENCE_RUNS = 4  # runs at full detail, whose mutual distance is that of chaos ...
RUNS_EACH = 2  # ... and runs of every other simulation, each started
START_NOISE = 0.05  # with velocities so much at random [m/s]


@threadpool_limits.wrap(limits=1, user_api="blas")
def measure_cost_table(
    database: WrinkleDatabase, inputs: PlaybackInputs, motion: Motion, report: Callable[[str], None] | None = None
) -> CostTable:
    """Measure every setting.

    Each part of a setting is measured on its own, and the squares of their errors add up.

    Decoding, and the motion between two updates, start from the coarse states of full detail. Their error is a distance
    vertex by vertex: the 95th percentile of each tick, below which 99 % of the ticks stay. Where cloth is inside the
    body that is not with full detail, it is at least the size of that hole.

    A changed coarse simulation runs freely, and free folding is chaotic. Its error is therefore one of statistics: the
    2-Wasserstein distance between the Gaussian distributions of each vertex over the run, seen from the body, the 95th
    percentile over vertices. The square is a mean over pairs of such a run and one at full detail, all started a little
    differently, less the mean over pairs of runs at full detail.

    The mesh below the coarse one is simulated without the wrinkle layer only: it has no folds that the dictionary could
    read.

    Args:
        database: of the garment.
        inputs: with what it is played.
        motion: that nothing was learned from; played at several tempos.
        report: called with lines of progress.
    """
    progress = report or (lambda line: None)
    player = Player(database, inputs.body, motion.pose(0.0), inputs.primitives)
    full = player.full
    layers = _layers(full)
    below = proxy_mesh_of(player.levels, database.warp)
    levels = [(0, SUBSTEPS)] if below is None else [(0, SUBSTEPS), (1, PROXY_SUBSTEPS)]
    pairs = [
        LevelOfDetail(every, max(1, round(every * full.substeps * share)), 0, 0, level)
        for level, shares in levels
        for every in EVERY
        for share in shares
    ]
    pairs = list(dict.fromkeys(pairs))
    parts = []
    for number, tempo in enumerate(TEMPOS):
        progress(f"measuring settings: tempo {number + 1} of {len(TEMPOS)}, wrinkle layer")
        poses = _poses(motion, tempo, 1.0 / database.frame_rate)
        parts.append(
            _measure(database, inputs, poses, pairs, layers, lambda line: progress(f"measuring settings: {line}"))
        )
    parts.sort(key=lambda part: part["speed"])
    speeds = tuple(float(part["speed"]) for part in parts)
    costs = {name: np.median([part[name] for part in parts], axis=0) for name in ("step", "rest", "between", "layer")}
    errors = {name: np.array([part[name] for part in parts]) for name in ("layer_error", "going_error", "step_error")}
    errors = {name: np.maximum.accumulate(values, axis=0) for name, values in errors.items()}
    settings = []
    for (p, pair), (k, layer) in product(enumerate(pairs), enumerate(layers)):
        squares = errors["layer_error"][:, k] ** 2 + errors["going_error"][:, EVERY.index(pair.every)] ** 2
        error = np.sqrt(squares + errors["step_error"][:, p] ** 2)
        if not np.isfinite(error).all() or (pair.level and layer[0]):
            continue
        peak = float(costs["step"][p] + costs["rest"][p] + costs["layer"][k])
        cost = (peak + (pair.every - 1) * float(costs["between"][p])) / pair.every
        detail = LevelOfDetail(pair.every, pair.substeps, *layer, pair.level)
        settings.append(Setting(detail, cost, peak, tuple(error.tolist())))
    return CostTable(
        database.garment_name,
        cost_table_key(database),
        machine_description()["cpu"],
        float(np.ptp(database.coarse_vertices[:, 1])),
        speeds,
        tuple(settings),
    )


def cost_table_key(database: WrinkleDatabase) -> str:
    """Text that differs between tables of different databases: version, date, size and fabric."""
    return f"{database.code_version} {database.created} {len(database.coarse_vertices)} {database.fabric_name}"


def _layers(full: LevelOfDetail) -> list[tuple[int, int]]:
    """Atoms and passes, full detail first."""
    atoms = sorted({max(1, round(full.atoms * share)) for share in ATOMS}, reverse=True)
    return [*((count, full.passes) for count in atoms), (full.atoms, 0), (0, full.passes), (0, 0)]


def _poses(motion: Motion, tempo: float, dt: float) -> np.ndarray:
    """A motion faster or slower: poses every ``dt`` [s]."""
    count = min(MAX_TICKS, int(motion.duration / (dt * tempo) + 1e-6))
    return np.stack([motion.pose(i * dt * tempo) for i in range(count + 1)])


def _measure(
    database: WrinkleDatabase,
    inputs: PlaybackInputs,
    poses: np.ndarray,
    pairs: Sequence[LevelOfDetail],
    layers: Sequence[tuple[int, int]],
    progress: Callable[[str], None],
) -> dict[str, np.ndarray]:
    """Errors and costs of all parts on one run of poses."""
    dt = 1.0 / database.frame_rate
    first = min(round(SETTLE / dt), (len(poses) - 1) // 3)
    player = Player(database, inputs.body, poses[0], inputs.primitives)
    start = player.simulation.state.copy()
    found = _decode(player, poses, dt, inputs.wind, layers, first)
    around = [_around(player, every, poses, dt, found["layer"][-1]) for every in EVERY]
    bare = LevelOfDetail(1, player.full.substeps, 0, 0)
    turn = isinstance(inputs.body, Character)

    def runs(detail: LevelOfDetail, seeds: range) -> tuple[list[np.ndarray], float, float]:
        made = [_run(player, start, detail, poses, dt, inputs.wind, turn, first, seed) for seed in seeds]
        return [run[0] for run in made], min(run[1] for run in made), max(run[2] for run in made)

    references, cost, _ = runs(bare, range(REFERENCE_RUNS))
    floor = np.mean([_squares(a, b, first) for a, b in combinations(references, 2)], axis=0)
    step_error, spent = [], []
    for number, detail in enumerate(pairs):
        progress(f"simulation {number + 1} of {len(pairs)}")
        error = 0.0
        if detail != bare:
            coarse, cost, hole = runs(detail, range(REFERENCE_RUNS, REFERENCE_RUNS + RUNS_EACH))
            away = np.mean([_squares(a, b, first) for a in coarse for b in references], axis=0) - floor
            error = max(float(np.percentile(np.sqrt(np.maximum(away, 0.0)), 95)), hole)
        step_error.append(error if np.isfinite(error) else np.inf)
        spent.append(cost)
    return found | {
        "step_error": np.array(step_error),
        "step": np.array(spent),
        "rest": np.array([around[EVERY.index(pair.every)][0] for pair in pairs]),
        "between": np.array([around[EVERY.index(pair.every)][1] for pair in pairs]),
    }


def _decode(
    player: Player, poses: np.ndarray, dt: float, wind: Air, layers: Sequence[tuple[int, int]], first: int
) -> dict[str, np.ndarray]:
    """Play at full detail; every layer decodes every state, and every update goes on for some ticks."""
    details = [LevelOfDetail(1, player.full.substeps, *layer) for layer in layers]
    still = CoarseFilter(player.levels)
    distance, holes = BodyDistance(player.simulation.body.faces), np.zeros(len(layers))
    spacing = float(player.levels.fine.edge_lengths()[1].mean())
    looked_at = set(np.linspace(first + 1, len(poses) - 1, HOLE_CHECKS).astype(int).tolist())
    past: deque[tuple[np.ndarray, np.ndarray]] = deque(maxlen=max(EVERY) - 1)
    spent, away, astray, speeds = [], [], [], []
    for tick, pose in enumerate(poses[1:], 1):
        player.update(pose, dt, wind)
        truth = (player.vertices + player.origin).astype(np.float32)
        velocity = player.simulation.state.velocity
        if tick > first:
            # The error of cloth that went on at its last velocity for 1, 2, ... ticks.
            astray.append([_p95(was + dt * j * going - truth) for j, (was, going) in enumerate(reversed(past), 1)])
            speeds.append(np.mean(velocity.astype(float) ** 2) * 3.0)
            times, distances, top = [], [], player.vertices
            body, hidden = player.body_vertices.astype(float), np.zeros(0, bool)
            for detail in details:
                began = time.process_time()
                made = player.decoded(detail)
                times.append(1e3 * (time.process_time() - began))
                distances.append(_p95(made - top) if distances else 0.0)
                top = made if len(distances) == 1 else top
                if tick in looked_at and (len(distances) == 1 or not detail.passes):
                    inside = distance.signed_distance(made.astype(float), body) < 0.0
                    hidden = inside if len(distances) == 1 else hidden
                    # Cloth inside the body shows the body: a hole as large as all of it together.
                    hole = spacing * np.sqrt(float((inside & ~hidden).sum()))
                    holes[len(distances) - 1] = max(holes[len(distances) - 1], hole)
            spent.append(times)
            away.append(distances)
        going = player.levels.subdivision.upsample(still.matrix @ velocity)
        past.append((truth, going.astype(np.float32)))
    gone = np.array(astray)
    going = [np.concatenate([np.zeros(len(gone)), gone[:, : every - 1].ravel()]) for every in EVERY]
    return {
        "speed": np.sqrt(np.mean(speeds)),
        "layer": np.median(spent, axis=0),
        "layer_error": np.maximum(np.percentile(away, 99, axis=0), holes),
        "going_error": np.array([np.percentile(errors, 99) for errors in going]),
    }


def _around(player: Player, every: int, poses: np.ndarray, dt: float, plain_ms: float) -> tuple[float, float]:
    """Cost of an update besides the simulation and the wrinkle layer, and of a tick without update [ms]."""
    player.change(LevelOfDetail(every, 1, 0, 0))
    update, between = [], []
    for tick, pose in enumerate(poses[1 : PROBE_FRAMES + 1]):
        began = time.process_time()
        player.step(pose, dt)
        stepped = time.process_time()
        player.decode()
        decoded = time.process_time()
        if tick % every:
            between.append(decoded - began)
        else:
            update.append(decoded - stepped)
    rest = max(0.0, 1e3 * float(np.median(update)) - plain_ms)
    return rest, 1e3 * float(np.median(between)) if between else 0.0


def _run(
    player: Player,
    start: State,
    detail: LevelOfDetail,
    poses: np.ndarray,
    dt: float,
    wind: Air,
    turn: bool,
    first: int,
    seed: int,
) -> tuple[np.ndarray, float, float]:
    """The coarse garment running freely at a detail.

    Returns:
        vertices in the frame of the body's root [m], shape (f, n, 3), at every tick that all of :data:`EVERY` have;
        processor time of an update [ms]; with the mesh below, the hole that cloth inside the body makes [m].
    """
    player.simulation.state = start.copy()
    player.change(player.full)
    player.simulation.place_body(poses[0])
    stirred = START_NOISE * np.random.default_rng(seed).standard_normal(start.velocity.shape)
    player.simulation.state.velocity += stirred.astype(np.float32)
    player.change(detail, detail.every - 1)
    state, hole = player.simulation.state, 0.0
    coarse, spent = [], []
    often = max(EVERY)
    looked_at = set(
        (often * np.linspace(first // often + 1, (len(poses) - 1) // often, HOLE_CHECKS).astype(int)).tolist()
    )
    distance, spacing = BodyDistance(player.simulation.body.faces), float(player.levels.fine.edge_lengths()[1].mean())
    for tick, pose in enumerate(poses[1:], 1):
        began = time.process_time()
        try:
            player.step(pose, dt, wind)
        except InputError:  # it is no longer finite
            return np.full((1, len(state.position), 3), np.inf), np.inf, np.inf
        if tick % detail.every == 0:
            spent.append(1e3 * (time.process_time() - began))
        if tick % often == 0:
            root = pose[0] if turn else np.eye(3, 4)
            coarse.append((state.world() - root[:, 3]) @ root[:, :3])
        if detail.level and tick in looked_at:
            fine, body = player.decoded(detail).astype(float), player.body_vertices.astype(float)
            inside = distance.signed_distance(fine, body) < 0.0
            hole = max(hole, spacing * float(np.sqrt(inside.sum())))
    return np.array(coarse), float(np.median(spent)), hole


def _squares(one: np.ndarray, other: np.ndarray, first: int) -> np.ndarray:
    """Squared 2-Wasserstein distance of each vertex's Gaussian distribution over the ticks [m2], shape (n,)."""
    if not (np.isfinite(one).all() and np.isfinite(other).all()):
        return np.full(one.shape[1], np.inf)
    one, other = one[first // max(EVERY) :], other[first // max(EVERY) :]
    means = ((one.mean(axis=0) - other.mean(axis=0)) ** 2).sum(axis=1)
    return means + ((one.std(axis=0) - other.std(axis=0)) ** 2).sum(axis=1)


def _p95(offsets: np.ndarray) -> float:
    return float(np.percentile(np.linalg.norm(offsets, axis=1), 95))
