"""Records a played garment: its fine and coarse vertices and the body, in whole steps, for any reader to show."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from assets.character import Character
from assets.io.sequence import Sequence
from assets.motion import Motion
from pbd import InputError
from runtime.draw.shown_body import shown_body
from runtime.export.animation_baking import clip_begin, whole_steps
from runtime.export.recording_file import Quantised, links_of, quantised, recording_bytes
from runtime.play.player import Player
from runtime.play.simulation import poses_of
from runtime.setup.playback_inputs import PlaybackInputs
from wrinkles.database import WrinkleDatabase
from wrinkles.levels import Levels

__all__ = ["TRUTH_HZ", "TRUTH_STEP", "RecordedTruth", "record"]

GARMENT_STEP = 2e-4  # of its vertices [m]: one is off by half the diagonal of such a cube at most
TRUTH_STEP = 5e-4  # of the truth's vertices [m]
BODY_STEP = 1e-3  # of the vertices of a body that is a vertex sequence [m]
BIND_STEP = 5e-5  # of a character's vertices in its bind pose [m]
WEIGHT_STEP = 2.0**-15  # of its joint weights [-]
MATRIX_STEP = 2.0**-14  # of the linear part of joints' matrices [-]
PLACE_STEP = 1e-4  # of their translations [m]
RECORDED_HZ = 30.0  # about the rate of recorded frames, between which readers mix [Hz]
TRUTH_HZ = 15.0  # about that of the truth's [Hz]
MAX_SIZE = 4.0e6  # of ten seconds with the truth [bytes]: in base64 and with three.js a page of 6 MB


class RecordedTruth(NamedTuple):
    """Some frames of a fine simulation of the motion that is recorded.

    Attributes:
        numbers: of the player's frames, ascending, int, shape (T,).
        vertices: in the world [m], shape (T, N, 3).
    """

    numbers: np.ndarray
    vertices: np.ndarray


def record(
    database: WrinkleDatabase,
    inputs: PlaybackInputs,
    motion: Motion,
    seconds: float | None,
    about: Mapping[str, Any],
    progress: Callable[[str], None] = lambda line: None,
    *,
    truth: RecordedTruth | None = None,
) -> tuple[bytes, dict[str, float]]:
    """Play a motion with the learned wrinkles and record it from its own first frame on.

    Args:
        database: the database to play.
        inputs: its inputs.
        motion: one of their motions.
        seconds: length of what is recorded [s]; None records all of the motion.
        about: what the file's header says besides what a reader needs.
        progress: gets a line now and then.
        truth: left out where the file would be larger than :data:`MAX_SIZE` for each ten seconds.

    Returns:
        the file's bytes, and figures by name: how far the recorded vertices are from the player's.

    Raises:
        InputError: as :func:`runtime.export.recording_file.quantised`; a truth without a recorded frame.
    """
    dt = 1.0 / database.frame_rate
    begin, every = clip_begin(motion), max(1, round(database.frame_rate / RECORDED_HZ))
    poses = poses_of(motion, dt, None if seconds is None else begin + seconds)
    first = min(whole_steps(begin / dt, every), len(poses) - 1)
    player = Player(database, inputs.body, poses[0], inputs.primitives)
    floor = float(player.body_vertices[:, 1].min() + player.origin[1])
    fine, coarse = [], []
    for number, pose in enumerate(poses):
        if number:
            player.update(pose, dt, inputs.wind)
        if number % 60 == 0:
            progress(f"recording frame {number} of {len(poses) - 1}")
        if number >= first and (number - first) % every == 0:
            fine.append(player.vertices + player.origin)
            coarse.append(player.simulation.state.world())
    moving = _moving("fine", np.array(fine), GARMENT_STEP)
    arrays = _meshes(player.levels) | moving | _moving("coarse", np.array(coarse), GARMENT_STEP)
    arrays |= _body(shown_body(inputs.body, player.levels), poses[first::every])
    header = {"rate_hz": database.frame_rate / every, "frame_count": len(fine), "floor": floor, **about}
    off = np.linalg.norm(moving["frames/fine"].steps * GARMENT_STEP - fine, axis=2).max()
    figures = {
        "frame_count": float(len(fine)),
        "fine_vertex_count": float(len(fine[0])),
        "decoded_off_mm": 1e3 * float(off),
    }
    data = recording_bytes(header, arrays)
    if truth is not None:
        shown = _truth(truth, first, every, len(fine))
        with_truth = recording_bytes(header, arrays | shown)
        fits = len(with_truth) <= MAX_SIZE * max(1.0, (len(poses) - 1 - first) * dt / 10.0)
        figures["truth_frame_count"] = float(len(shown["truth/numbers"].steps) if fits else 0)
        return with_truth if fits else data, figures
    return data, figures


def _truth(truth: RecordedTruth, first: int, every: int, count: int) -> dict[str, Quantised]:
    """What is recorded of the truth: every so many frames of the player from the first on are so many in all."""
    places = truth.numbers - first
    kept = (places >= 0) & (places % every == 0) & (places < every * count)
    if not kept.any():
        expected = f"at least one of frames {first}, {first + every} to {first + every * (count - 1)}"
        raise InputError(
            "no frame of the truth is recorded", key="truth", received=truth.numbers.tolist(), expected=expected
        )
    return {
        "truth/numbers": Quantised(places[kept] // every),
        "frames/truth": quantised("truth", truth.vertices[kept], TRUTH_STEP, differences=1, links="links/fine"),
    }


def _meshes(levels: Levels) -> dict[str, Quantised]:
    subdivision, layer = levels.subdivision, levels.fine_layer
    arrays = {
        "faces/fine": Quantised(subdivision.faces, differences=1),
        "faces/coarse": Quantised(subdivision.coarse_faces, differences=1),
    }
    return arrays if layer is None else arrays | {"garments": Quantised(layer)}


def _moving(name: str, vertices: np.ndarray, step: float) -> dict[str, Quantised]:
    """Vertices of every frame [m], shape (F, N, 3), after the links by which they are coded."""
    links = f"links/{name}"
    frames = quantised(name, vertices, step, differences=1, links=links)
    return {links: links_of(vertices[0]), f"frames/{name}": frames}


def _body(body: Character | Sequence, poses: np.ndarray) -> dict[str, Quantised]:
    """The body and how it moves: matrices of a character's joints, or the vertices of a sequence."""
    arrays = {"body/faces": Quantised(body.faces, differences=1)}
    if not isinstance(body, Character):
        return arrays | _moving("body", np.stack([body.drawn(pose) for pose in poses]), BODY_STEP)
    return arrays | {
        "body/vertices": quantised("body", body.vertices, BIND_STEP, differences=1),
        "body/joints": Quantised(np.where(body.joint_weights > 0.0, body.joint_indices, 0), differences=1),
        "body/weights": quantised("body", body.joint_weights, WEIGHT_STEP),
        "frames/matrices": quantised("body", poses[..., :3], MATRIX_STEP, differences=2),
        "frames/places": quantised("body", poses[..., 3], PLACE_STEP, differences=2),
    }
