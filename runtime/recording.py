"""Records a played garment: all that a reader needs to decode its wrinkles live, and the coarse state of every frame.

The wrinkles are decoded from the recorded states here too, as any reader decodes them. The player also pushes fine
vertices out of the body, which a reader does not; what is left between both is recorded as a correction.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csr_matrix
from threadpoolctl import threadpool_limits

from assets.character import Character
from assets.io.sequence import Sequence
from pbd.errors import InputError
from pbd.geometry import FAR
from runtime.play import PlaybackInputs
from runtime.player import Player
from runtime.recorded_decoder import RecordedDecoder
from runtime.recording_file import Quantised, quantised, recording_bytes
from runtime.simulation import Motion, poses_of
from wrinkles.charts import Charts
from wrinkles.coarse_filter import CoarseFilter
from wrinkles.database import WrinkleDatabase
from wrinkles.dictionary import CLIP, Atoms, CoefficientNetwork
from wrinkles.features import Stencil
from wrinkles.layer_distance import LayerDistance
from wrinkles.levels import Levels
from wrinkles.novelty import FADE_WIDTH, NoveltyScore
from wrinkles.patches import Patches
from wrinkles.vertex_mean import MEAN_STEP

__all__ = ["TRUTH_HZ", "TRUTH_STEP", "RecordedTruth", "record", "stored"]

COARSE_STEP = 1e-4  # of recorded coarse and held vertices [m]
CONTACT_STEP = FAR / 127  # of their distance from the body [m]
CORRECTION_STEP = 2e-4  # of corrections [m]: a vertex is off by half the diagonal of such a cube at most
STATE_STEPS = {"coarse": COARSE_STEP, "contact": CONTACT_STEP, "held": COARSE_STEP}  # what the decoder reads
BODY_STEP = 1e-3  # of the vertices of a body that is a vertex sequence [m]
MATRIX_STEP = 2.0**-14  # of the linear part of joints' matrices, which may scale up to twice [-]
PLACE_STEP = 1e-4  # of their translations [m]
TRUTH_STEP = 5e-4  # of the truth's vertices [m]
RECORDED_HZ = 30.0  # about the rate of recorded frames, between which readers mix [Hz]
TRUTH_HZ = 15.0  # about that of the truth's [Hz]
MAX_SIZE = 4.0e6  # of ten seconds with the truth [bytes]: in base64 and with three.js a page of 6 MB
# Arrays of frames: type, step, and how often differences are taken in time. Those of smooth motion are small, and
# compress well.
FRAMES = {
    "origin": (np.int32, COARSE_STEP, 2),
    "coarse": (np.int16, COARSE_STEP, 2),
    "contact": (np.int8, CONTACT_STEP, 1),
    "held": (np.int16, COARSE_STEP, 2),
    "correction": (np.int16, CORRECTION_STEP, 1),
    "matrices": (np.int16, MATRIX_STEP, 2),
    "places": (np.int32, PLACE_STEP, 2),
    "body": (np.int16, BODY_STEP, 2),
    "truth": (np.int16, TRUTH_STEP, 2),
}


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
    truth: RecordedTruth | None = None,
) -> tuple[bytes, dict[str, float]]:
    """Play a motion with the learned wrinkles and record it.

    Args:
        database: the database to play.
        inputs: its inputs.
        motion: one of their motions.
        seconds: length of the motion that is played [s]; None plays all of it.
        about: what the file's header says besides what decoding needs.
        progress: gets a line now and then.
        truth: left out where the file would be larger than :data:`MAX_SIZE` for each ten seconds.

    Returns:
        the file's bytes, and figures by name: how far the decoded vertices are from the player's.
    """
    dt = 1.0 / database.frame_rate
    poses, every = poses_of(motion, dt, seconds), max(1, round(database.frame_rate / RECORDED_HZ))
    player = Player(database, inputs.body, poses[0], inputs.primitives)
    header, arrays = _garment(player.database, player.levels)
    decoder = RecordedDecoder(header, arrays)
    corners, held, layers = arrays["patches/corners"].values[:, 0], player.levels.fine_held, player.levels.layers
    below = None if layers is None else LayerDistance(player.levels.coarse, layers.layer)
    still = CoarseFilter(player.levels)
    floor = float(player.body_vertices[:, 1].min() + player.origin[1])
    frames: dict[str, list[np.ndarray]] = {name: [] for name in ("origin", "coarse", "contact", "held", "correction")}
    off: list[float] = []
    uncorrected: list[float] = []
    for number, pose in enumerate(poses):
        if number:
            player.update(pose, dt, inputs.wind)
        if number % 60 == 0:
            progress(f"recording frame {number} of {len(poses) - 1}")
        if number % every:
            continue
        cloth = player.simulation.state
        contact = cloth.contact if below is None else below(still(cloth.position), cloth.contact)
        world = cloth.world()
        origin = _steps(world.mean(axis=0), COARSE_STEP)
        about_origin = player.vertices + (player.origin - origin * COARSE_STEP)
        state = {
            "coarse": _steps(world - origin * COARSE_STEP, COARSE_STEP),
            "contact": _steps(contact, CONTACT_STEP),
            "held": _steps(about_origin[held], COARSE_STEP),
        }
        with threadpool_limits(1):  # matrices this small are slower on several threads
            decoded, axes = decoder(*(_values(state[name], step) for name, step in STATE_STEPS.items()))
        missing = np.einsum("ix,iax->ia", about_origin - decoded, axes[corners])
        correction = _steps(missing, CORRECTION_STEP)
        uncorrected.append(float(np.linalg.norm(missing, axis=1).max()))
        off.append(float(np.linalg.norm(missing - correction * CORRECTION_STEP, axis=1).max()))
        for name, steps in {"origin": origin, **state, "correction": correction}.items():
            frames[name].append(steps)
    arrays |= {f"frames/{name}": stored(name, np.array(steps)) for name, steps in frames.items()}
    origins = np.array(frames["origin"]) * COARSE_STEP
    recorded = poses[::every]
    arrays |= _body(inputs.body, recorded, origins)
    header |= {"rate_hz": database.frame_rate / every, "frame_count": len(recorded), "floor": floor, **about}
    figures = {
        "frame_count": float(len(recorded)),
        "fine_vertex_count": float(len(corners)),
        "decoded_off_mm": 1e3 * max(off),
        "uncorrected_off_mm": 1e3 * max(uncorrected),
    }
    data = recording_bytes(header, arrays)
    if truth is not None:
        added = _truth(truth, origins, every)
        with_truth = recording_bytes(header, arrays | added)
        fits = len(with_truth) <= MAX_SIZE * max(1.0, (len(poses) - 1) * dt / 10.0)
        data = with_truth if fits else data
        figures["truth_frame_count"] = float(len(added["truth/numbers"].steps) if fits else 0)
    return data, figures


def _garment(database: WrinkleDatabase, levels: Levels) -> tuple[dict[str, float], dict[str, Quantised]]:
    """Header and arrays that decode any frame."""
    subdivision, charts = levels.subdivision, Charts.of(levels.coarse)
    stencil, patches = Stencil.of(charts, database.held), Patches.of(subdivision, charts)
    arrays = {
        **_matrix("filter", CoarseFilter(levels).matrix),
        **_matrix("middle", subdivision.to_middle),
        **_matrix("surface", subdivision.from_middle),
        "stencil/corners": _indices(stencil.corners),
        "stencil/weights": quantised(stencil.weights, np.int16),
        "patches/corners": _indices(patches.corners),
        "patches/blend": quantised(patches.blend, np.int16),
        "patches/cell": Quantised(patches.cell.astype(np.uint8)),
        "patches/within": quantised(patches.within, np.int16),
        "patches/mean": quantised(database.atoms.vertex_mean, np.int16, step=MEAN_STEP),
        **_network(database.mapping, database.novelty, database.atoms),
        "held": _indices(levels.fine_held),
        "faces/fine": _indices(subdivision.faces),
        "faces/coarse": _indices(subdivision.coarse_faces),
    }
    if patches.smoothing is not None:
        arrays |= _matrix("smoothing", patches.smoothing) | _matrix("turning", patches.turning)
    layer = levels.fine_layer
    if layer is not None:
        arrays["garments"] = Quantised(layer.astype(np.uint8))
    header = {
        "far": FAR,
        "clip": CLIP,
        "spacing": stencil.spacing,
        "novelty_bias": database.novelty.bias_2,
        "fade_end": float(np.log(database.novelty.fade_from) + FADE_WIDTH),
        "fade_width": float(FADE_WIDTH),
    }
    return header, arrays


def _network(mapping: CoefficientNetwork, novelty: NoveltyScore, atoms: Atoms) -> dict[str, Quantised]:
    """The network, its head for the novelty and the atoms; weights in steps of one byte, as the database has them.

    Rows, one for each coarse vertex, stand region by region.
    """
    order = np.argsort(mapping.region, kind="stable")
    first_rows = np.searchsorted(mapping.region[order], np.arange(len(mapping.bias_2) + 1))
    return {
        "network/center": Quantised(mapping.center),
        "network/scale": Quantised(mapping.scale),
        "network/order": _indices(order),
        "network/first_rows": _indices(first_rows),
        "network/place": quantised(mapping.place[order], np.int8, along=0),
        "network/place_weights": quantised(mapping.place_weights, np.int8, along=0),
        "network/weights_1": quantised(mapping.weights_1, np.int8, along=0),
        "network/bias_1": Quantised(mapping.bias_1),
        "network/weights_2": quantised(mapping.weights_2, np.int8, along=1),
        "network/bias_2": Quantised(mapping.bias_2),
        "network/weights_3": quantised(mapping.weights_3, np.int8, along=1),
        "network/bias_3": Quantised(mapping.bias_3),
        "novelty/weights_1": quantised(novelty.weights_1, np.int8, along=0),
        "novelty/bias_1": Quantised(novelty.bias_1),
        "novelty/weights_2": Quantised(novelty.weights_2),
        "atoms/shapes": quantised(atoms.shapes, np.int8, along=1),
        "atoms/mean": Quantised(atoms.mean),
    }


def stored(name: str, steps: np.ndarray) -> Quantised:
    """An array of frames.

    Args:
        name: in :data:`FRAMES`.
        steps: whole numbers, the first axis is time.

    Raises:
        InputError: a number that is too large for the file.
    """
    kind, step, differences = FRAMES[name]
    limit, largest = np.iinfo(kind).max, np.abs(steps).max(initial=0)
    if largest > limit:
        expected = f"at most {limit * step:.3g}"
        raise InputError("too large to be recorded", key=name, received=f"{largest * step:.3g}", expected=expected)
    return Quantised(steps.astype(kind), np.asarray(step, np.float32), None, differences)


def _body(body: Character | Sequence, poses: np.ndarray, origins: np.ndarray) -> dict[str, Quantised]:
    """The body and how it moves: matrices of a character's joints, or the vertices of a sequence about the origins."""
    arrays = {"body/faces": _indices(body.faces)}
    if isinstance(body, Character):
        return arrays | {
            "body/vertices": quantised(body.vertices, np.int16),
            "body/joints": _indices(np.where(body.joint_weights > 0.0, body.joint_indices, 0)),
            "body/weights": quantised(body.joint_weights, np.int16),
            "frames/matrices": stored("matrices", _steps(poses[..., :3], MATRIX_STEP)),
            "frames/places": stored("places", _steps(poses[..., 3], PLACE_STEP)),
        }
    return arrays | {"frames/body": stored("body", _steps(poses - origins[:, None], BODY_STEP))}


def _truth(truth: RecordedTruth, origins: np.ndarray, every: int) -> dict[str, Quantised]:
    """Its vertices about the origins of recorded frames, of which ``every`` player's frame is one."""
    kept = (truth.numbers % every == 0) & (truth.numbers < every * len(origins))
    numbers = truth.numbers[kept] // every
    steps = _steps(truth.vertices[kept] - origins[numbers][:, None], TRUTH_STEP)
    return {"truth/numbers": _indices(numbers), "frames/truth": stored("truth", steps)}


def _matrix(name: str, matrix: csr_matrix) -> dict[str, Quantised]:
    """A sparse matrix: where rows start, columns, values."""
    matrix = matrix.tocsr()
    matrix.sort_indices()
    return {
        f"{name}/start": Quantised(matrix.indptr.astype(np.uint32), differences=1),
        f"{name}/index": _indices(matrix.indices),
        f"{name}/value": quantised(matrix.data, np.int16),
    }


def _indices(indices: np.ndarray) -> Quantised:
    kind = np.uint16 if indices.max(initial=0) <= np.iinfo(np.uint16).max else np.uint32
    return Quantised(indices.astype(kind), differences=1)


def _steps(values: np.ndarray, step: float) -> np.ndarray:
    return np.rint(np.asarray(values, float) / step).astype(np.int32)


def _values(steps: np.ndarray, step: float) -> np.ndarray:
    return steps.astype(np.float32) * np.float32(step)
