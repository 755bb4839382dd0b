"""Decoding recorded coarse states, frame by frame, by whatever gives the coefficients of the patches."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from pbd import Body
from precompute.learning.recording import Recording, Run, body_source
from precompute.learning.training import Layer, features_of, spread_frames
from wrinkles.decoder import MeanWriter, PatchWriter, Upsampler
from wrinkles.dictionary import Atoms, Mapping
from wrinkles.features import DYNAMIC_COUNT
from wrinkles.isometry import Isometry
from wrinkles.relaxation import Relaxation
from wrinkles.vertex_mean import fit_vertex_mean

__all__ = [
    "MEAN_FRAMES",
    "Lift",
    "Predict",
    "by_features",
    "by_patches",
    "decode_recording",
    "lifted_frames",
    "with_vertex_mean",
]

MEAN_FRAMES = 400  # that the means of vertices are fitted to

Predict = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Features of one frame, float32, shape (n, DYNAMIC_COUNT), and the body's pose to coefficients, shape (n, K)."""

Lift = Callable[[np.ndarray, Upsampler, np.ndarray, np.ndarray, np.ndarray], None]
"""Puts wrinkles on smooth fine vertices [m], float32, shape (N, 3), in place; told the upsampler that made them, the
features and frames of the coarse vertices, float32, shapes (n, DYNAMIC_COUNT) and (n, 9), and the body's pose."""


def by_features(mapping: Mapping) -> Predict:
    """What the network says, whatever the pose."""
    return lambda features, pose: mapping.predict(features)


def by_patches(layer: Layer, predict: Predict, atoms: Atoms) -> Lift:
    """Wrinkles from patches whose coefficients a mapping gives."""
    keep_lengths = Isometry(layer.levels)
    add_to_fine, add_to_middle = PatchWriter(layer.patches), PatchWriter(layer.middle_patches)
    add_mean = MeanWriter(layer.patches, atoms.vertex_mean)

    def lift(fine: np.ndarray, upsample: Upsampler, features: np.ndarray, frames: np.ndarray, pose: np.ndarray) -> None:
        grids = (predict(features, pose) @ atoms.shapes + atoms.mean).astype(np.float32)
        add_to_fine(grids, frames, fine)
        add_mean(frames, fine)
        add_to_middle(grids, frames, upsample.middle)
        keep_lengths(upsample.middle, fine)

    return lift


def decode_recording(
    layer: Layer, predict: Predict, atoms: Atoms, run: Run, recording: Recording
) -> tuple[np.ndarray, np.ndarray]:
    """Smooth and decoded garment for recorded coarse states, as they stand: nothing is filtered here.

    Args:
        layer: of the garment.
        predict: the mapping, see :data:`Predict`.
        atoms: that its coefficients count.
        run: gives body, poses and fabric.
        recording: of this run, or of a coarse run of the same poses.

    Returns:
        [m], float32, shape (f, N, 3) each.
    """
    smooth = np.zeros((len(recording.frames), layer.levels.subdivision.fine_count, 3), np.float32)
    decoded = np.zeros_like(smooth)
    frames = lifted_frames(layer, by_patches(layer, predict, atoms), run, recording)
    for f, (smooth_frame, decoded_frame, _) in enumerate(frames):
        smooth[f], decoded[f] = smooth_frame, decoded_frame
    return smooth, decoded


def with_vertex_mean(
    layer: Layer, mappings: Sequence[Predict], atoms: Atoms, runs: Sequence[Run], recordings: Sequence[Recording]
) -> Atoms:
    """Atoms with the mean of what decoding recorded coarse states lacks at each vertex, relaxation included.

    Args:
        layer: of the garment.
        mappings: for the fabric of each run; shown MEAN_FRAMES spread over its recordings, in order.
        atoms: that their coefficients count; a mean that they have is left out.
        runs, recordings: what is learned from.
    """
    atoms = replace(atoms, vertex_mean=np.zeros_like(atoms.vertex_mean))
    frames, left = [], []
    for mapping, run, some in zip(mappings, runs, spread_frames(recordings, MEAN_FRAMES), strict=True):
        _, decoded = decode_recording(layer, mapping, atoms, run, some)
        frames.append(features_of(layer, some)[1])
        left.append(some.positions - decoded)
    mean = fit_vertex_mean(layer.patches.turning, np.concatenate(frames), np.concatenate(left))
    return replace(atoms, vertex_mean=mean)


def lifted_frames(
    layer: Layer, lift: Lift, run: Run, recording: Recording, passes: int = 1
) -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
    """The same a frame at a time, by any way to make wrinkles.

    Args:
        layer: of the garment; its stencil reads the features.
        lift: adds the wrinkles, see :data:`Lift`; called once a frame, in order.
        run, recording: as for :func:`decode_recording`.
        passes: of relaxation.

    Yields:
        smooth and decoded garment [m], float32, shape (N, 3) each, and the processor time from the smooth surface to
        the relaxed one [ms].
    """
    levels = layer.levels
    upsample = Upsampler(levels.subdivision)
    source = body_source(run.body)
    relax = Relaxation.of(levels, source.vertices, source.faces, run.fabric.thickness)
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
        lift(decoded, upsample, features, frames, run.poses[frame])
        relax(decoded, targets, frames, nearest, contact, body, body.current, passes)
        spent = 1e3 * (time.process_time() - began)
        offset = origin.astype(np.float32)
        yield smooth + offset, decoded + offset, spent
