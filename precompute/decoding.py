"""Decoding recorded coarse states, frame by frame, as the player would."""

import numpy as np

from pbd import Body
from precompute.recording import Recording, Run, body_source
from precompute.training import Layer
from wrinkles.charts import leading_vertices
from wrinkles.clearance import clearances, facing
from wrinkles.decoder import Decoder, Relaxation, Upsampler
from wrinkles.dictionary import Atoms, Mapping

__all__ = ["decode_recording"]


def decode_recording(
    layer: Layer, mapping: Mapping, atoms: Atoms, run: Run, recording: Recording
) -> tuple[np.ndarray, np.ndarray]:
    """Smooth and decoded garment for recorded coarse states, as they stand: nothing is filtered here.

    Args:
        layer: of the garment.
        mapping, atoms: the dictionary.
        run: gives body, poses and fabric.
        recording: of this run, or of a coarse run of the same poses.

    Returns:
        [m], float32, shape (f, N, 3) each.
    """
    levels = layer.levels
    upsample = Upsampler(levels.subdivision)
    decoder = Decoder(layer.stencil, layer.patches, mapping, atoms)
    leading = leading_vertices(levels.subdivision)
    source = body_source(run.body)
    spacing = float(levels.fine.edge_lengths()[1].mean())
    clearance = clearances(source.vertices, source.faces, spacing, run.fabric.thickness)
    way = facing(levels.coarse, source.vertices, source.faces)
    relax = Relaxation(levels.fine, levels.fine_held, leading, clearance, way)
    body = Body(source.faces, len(source.vertices))
    smooth = np.zeros((len(recording.frames), levels.subdivision.fine_count, 3), np.float32)
    decoded = np.zeros_like(smooth)
    position = np.zeros((levels.subdivision.coarse_count, 4), np.float32)
    for f, frame in enumerate(recording.frames):
        # The body's frame: positions near the origin keep their digits.
        origin = np.round(recording.coarse[f].mean(axis=0).astype(float))
        source.skin(run.poses[frame], origin, body.current)
        body.finish_pose()
        position[:, :3] = recording.coarse[f] - origin
        upsample(position, smooth[f])
        decoded[f] = smooth[f]
        velocity, contact = np.ascontiguousarray(recording.velocity[f]), np.ascontiguousarray(recording.contact[f])
        decoder.add(position, velocity, contact, decoded[f])
        nearest = np.ascontiguousarray(recording.nearest[f])
        targets = levels.fine_attachment.targets(body.current)
        relax(decoded[f], targets, decoder.frames, nearest, contact, body, body.current)
        smooth[f] += origin.astype(np.float32)
        decoded[f] += origin.astype(np.float32)
    return smooth, decoded
