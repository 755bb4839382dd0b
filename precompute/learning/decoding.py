"""Decoding recorded coarse states, frame by frame, by any predictor of the coefficients of the patches."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from itertools import groupby

import numpy as np

from pbd import Body, Fabric
from pbd.bending import hinge_calibration
from precompute.learning.run_recording import Recording, Run
from precompute.learning.stages import counted
from precompute.learning.training import Layer, features_of, spread_frames
from precompute.workers import Workers
from runtime.play.simulation import BodySource, body_source
from wrinkles.decoder import Upsampler
from wrinkles.dictionary import Atoms
from wrinkles.features import DYNAMIC_COUNT
from wrinkles.fine_surface import FineSurface
from wrinkles.levels import Levels
from wrinkles.relaxation import PASSES, Relaxation
from wrinkles.spectrum import BandedEnergy
from wrinkles.vertex_mean import mean_from_sums, vertex_mean_sums

__all__ = [
    "BLOCK",
    "MEAN_FRAMES",
    "FrameDecoder",
    "Predictor",
    "bands_of",
    "blocks_of",
    "by_patches",
    "decode_recording",
    "joined",
    "decoded_frames",
    "with_vertex_mean",
]

MEAN_FRAMES = 400  # that the means of vertices are fitted to
BLOCK = 64  # frames that one worker decodes after each other

Predictor = Callable[[np.ndarray], np.ndarray]
"""Features of one frame, float32, shape (n, DYNAMIC_COUNT), to coefficients, shape (n, K)."""

FrameDecoder = Callable[[np.ndarray, Upsampler, np.ndarray, np.ndarray], None]
"""Puts wrinkles on smooth fine vertices [m], float32, shape (N, 3), in place; takes the upsampler that made them, and
features and frames of the coarse vertices, float32, shapes (n, DYNAMIC_COUNT) and (n, 9)."""


def by_patches(layer: Layer, predict: Predictor, atoms: Atoms) -> FrameDecoder:
    """Wrinkles from patches whose coefficients a mapping gives."""
    surface = FineSurface(layer.levels.subdivision, layer.patches, atoms.vertex_mean)

    def lift(fine: np.ndarray, upsample: Upsampler, features: np.ndarray, frames: np.ndarray) -> None:
        grids = (predict(features) @ atoms.shapes + atoms.mean).astype(np.float32)
        surface(upsample.middle, grids, frames, fine)

    return lift


def joined(runs: Sequence[Run], recordings: Sequence[Recording]) -> tuple[Run, Recording]:
    """Recorded frames of several runs of a garment on a body as if they were one run, with a pose for each frame."""
    names = ("positions", "coarse", "contact", "nearest")
    together = {name: np.concatenate([getattr(r, name) for r in recordings]) for name in names}
    poses = np.concatenate([run.poses[r.frames] for run, r in zip(runs, recordings, strict=True)])
    return replace(runs[0], poses=poses), replace(recordings[0], frames=np.arange(len(poses)), **together)


def blocks_of(runs: Sequence[Run], recordings: Sequence[Recording]) -> list[tuple[Run, Recording]]:
    """Recorded frames in blocks of BLOCK in one fabric, for any number of workers that decode them."""
    result = []
    for _, group in groupby(zip(runs, recordings, strict=True), key=lambda pair: pair[0].fabric):
        run, recording = joined(*zip(*group, strict=True))
        for first in range(0, len(recording.frames), BLOCK):
            some = recording.where(slice(first, first + BLOCK))
            part = replace(some, frames=np.arange(len(some.frames)))
            result.append((replace(run, poses=run.poses[some.frames]), part))
    return result


def decode_recording(
    layer: Layer, predict: Predictor, atoms: Atoms, run: Run, recording: Recording
) -> tuple[np.ndarray, np.ndarray]:
    """Smooth and decoded garment for recorded coarse states, as they stand: nothing is filtered here.

    Args:
        layer: of the garment.
        predict: the mapping, see :data:`Predictor`.
        atoms: that its coefficients count.
        run: gives body, poses and fabric.
        recording: of this run, or of a coarse run of the same poses.

    Returns:
        [m], float32, shape (f, N, 3) each.
    """
    smooth = np.zeros((len(recording.frames), layer.levels.subdivision.fine_count, 3), np.float32)
    decoded = np.zeros_like(smooth)
    frames = decoded_frames(layer, by_patches(layer, predict, atoms), run, recording)
    for f, (smooth_frame, decoded_frame, _) in enumerate(frames):
        smooth[f], decoded[f] = smooth_frame, decoded_frame
    return smooth, decoded


def with_vertex_mean(
    layer: Layer,
    predict: Predictor,
    atoms: Atoms,
    runs: Sequence[Run],
    recordings: Sequence[Recording],
    workers: Workers | None = None,
    *,
    frames: int = MEAN_FRAMES,
    report: Callable[[str], None] | None = None,
) -> Atoms:
    """Atoms with the mean of what decoding recorded coarse states lacks at each vertex, relaxation included.

    Args:
        layer: of the garment.
        predict: the mapping, shown ``frames`` spread over the recordings, in order.
        atoms: that its coefficients count; a mean that they have is left out.
        runs, recordings: what is learned from.
        workers: that decode; None decodes here, and needs no mapping that can be sent to another process.
        frames: that the means are fitted to, at most.
        report: called with lines of progress.
    """
    atoms = replace(atoms, vertex_mean=np.zeros_like(atoms.vertex_mean))
    blocks = blocks_of(runs, spread_frames(recordings, frames))
    jobs = [partial(_mean_sums, layer, predict, atoms, *block) for block in blocks]
    sums = (workers or Workers(1)).run(jobs, done=counted(report, "means of vertices: parts", len(jobs)))
    return replace(atoms, vertex_mean=mean_from_sums(sums))


def _mean_sums(
    layer: Layer, predict: Predictor, atoms: Atoms, run: Run, recording: Recording
) -> tuple[np.ndarray, np.ndarray]:
    """Sums over a block of frames for the means of vertices."""
    _, decoded = decode_recording(layer, predict, atoms, run, recording)
    frames = features_of(layer, recording)[1]
    return vertex_mean_sums(layer.patches.turning, frames, recording.positions - decoded)


def decoded_frames(
    layer: Layer, lift: FrameDecoder, run: Run, recording: Recording
) -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
    """The same a frame at a time, by any way to make wrinkles.

    Args:
        layer: of the garment; its stencil reads the features.
        lift: adds the wrinkles, see :data:`FrameDecoder`; called once a frame, in order.
        run, recording: as for :func:`decode_recording`.

    Yields:
        smooth and decoded garment [m], float32, shape (N, 3) each, and the processor time from the smooth surface to
        the relaxed one [ms].
    """
    levels = layer.levels
    upsample = Upsampler(levels.subdivision)
    source = body_source(run.body)
    relax = _relaxation(_Kept.of(levels, source, fabric=run.fabric)).fresh()
    body = Body(source.faces, len(source.vertices))
    count = levels.subdivision.coarse_count
    position, frames = np.zeros((count, 4), np.float32), np.zeros((count, 9), np.float32)
    features = np.zeros((count, DYNAMIC_COUNT), np.float32)
    smooth = np.zeros((levels.subdivision.fine_count, 3), np.float32)
    for f, frame in enumerate(recording.frames):
        # The body's frame: positions near the origin keep their digits.
        origin = np.round(recording.coarse[f].mean(axis=0).astype(float))
        source.skin(run.poses[frame], origin, body.current)
        body.finish_pose()
        position[:, :3] = recording.coarse[f] - origin
        upsample(position, smooth)
        contact = np.ascontiguousarray(recording.contact[f])
        nearest, targets = np.ascontiguousarray(recording.nearest[f]), levels.fine_attachment.targets(body.current)
        decoded, began = smooth.copy(), time.process_time()
        layer.stencil.read(position, contact, frames, features)
        lift(decoded, upsample, features, frames)
        relax(decoded, targets, frames, nearest, contact, body, body.current, PASSES)
        spent = 1e3 * (time.process_time() - began)
        offset = origin.astype(np.float32)
        yield smooth + offset, decoded + offset, spent


@dataclass(frozen=True)
class _Kept:
    """What takes long to set up for a garment on a body, found again by a hash of their shapes."""

    key: str
    levels: Levels = field(compare=False)
    source: BodySource | None = field(default=None, compare=False)
    fabric: Fabric | None = field(default=None)

    @classmethod
    def of(cls, levels: Levels, source: BodySource | None = None, *, fabric: Fabric | None = None) -> _Kept:
        digest = hashlib.sha256()
        arrays = [levels.fine.vertices, levels.fine.faces, levels.fine.flat, levels.fine_held]
        arrays += [levels.coarse.vertices, levels.coarse.faces, levels.coarse_held]
        arrays += [] if source is None else [source.vertices, source.faces]
        for array in arrays:
            digest.update(np.ascontiguousarray(array).tobytes())
        if levels.layers is not None:
            digest.update(levels.layers.layer.tobytes() + repr(levels.layers.fabrics).encode())
        return cls(digest.hexdigest(), levels, source, fabric)


@lru_cache(maxsize=1)
def _relaxation(kept: _Kept) -> Relaxation:
    assert kept.source is not None and kept.fabric is not None
    bend_factor = hinge_calibration(kept.levels.coarse)
    return Relaxation.of(kept.levels, kept.source.vertices, kept.source.faces, kept.fabric, bend_factor)


@lru_cache(maxsize=1)
def _bands(kept: _Kept) -> BandedEnergy:
    return BandedEnergy(kept.levels.fine)


def bands_of(levels: Levels) -> BandedEnergy:
    """Octave bands of a garment's fine mesh; factored once in a process."""
    return _bands(_Kept.of(levels))
