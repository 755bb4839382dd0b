"""Decoding recorded coarse states, frame by frame, by whatever gives the coefficients of the patches."""

from collections.abc import Callable

import numpy as np

from pbd import Body
from precompute.recording import Recording, Run, body_source
from precompute.training import Layer
from wrinkles.decoder import Relaxation, Upsampler, add_patches
from wrinkles.dictionary import Atoms
from wrinkles.features import DYNAMIC_COUNT

__all__ = ["Predict", "decode_recording"]

Predict = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Features of one frame, float32, shape (n, DYNAMIC_COUNT), and the body's pose to coefficients, shape (n, K)."""


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
    levels, patches = layer.levels, layer.patches
    upsample = Upsampler(levels.subdivision)
    source = body_source(run.body)
    relax = Relaxation.of(levels, source.vertices, source.faces, run.fabric.thickness)
    body = Body(source.faces, len(source.vertices))
    smooth = np.zeros((len(recording.frames), levels.subdivision.fine_count, 3), np.float32)
    decoded = np.zeros_like(smooth)
    count = levels.subdivision.coarse_count
    position, frames = np.zeros((count, 4), np.float32), np.zeros((count, 9), np.float32)
    features = np.zeros((count, DYNAMIC_COUNT), np.float32)
    for f, frame in enumerate(recording.frames):
        # The body's frame: positions near the origin keep their digits.
        origin = np.round(recording.coarse[f].mean(axis=0).astype(float))
        source.skin(run.poses[frame], origin, body.current)
        body.finish_pose()
        position[:, :3] = recording.coarse[f] - origin
        upsample(position, smooth[f])
        velocity, contact = np.ascontiguousarray(recording.velocity[f]), np.ascontiguousarray(recording.contact[f])
        layer.stencil.gather(position, velocity, contact, frames, features)
        grids = (predict(features, run.poses[frame]) @ atoms.shapes + atoms.mean).astype(np.float32)
        decoded[f] = smooth[f]
        add_patches(grids, frames, patches.corners, patches.blend, patches.cell, patches.within, decoded[f])
        nearest = np.ascontiguousarray(recording.nearest[f])
        targets = levels.fine_attachment.targets(body.current)
        relax(decoded[f], targets, frames, nearest, contact, body, body.current)
        smooth[f] += origin.astype(np.float32)
        decoded[f] += origin.astype(np.float32)
    return smooth, decoded
