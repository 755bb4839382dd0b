"""Error classes of a run of cloth beside its converged reference.

Three, unnoticeable, visible but bounded, and catastrophic; visible errors are accepted up to a second limit.
Length changes of 3 % were seen under full attention and over 20 % missed without it (Harrison et al. 2004);
the other limits are this project's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from pbd import InputError
from precompute.experiment.measures import GRAVITY, edge_strain
from wrinkles.mesh_measures import jitter_px, pixel_distance

__all__ = ["LIMITS", "ErrorClass", "Recorded", "classify", "deviations", "longest_run"]

START = 0.5  # the first seconds of a run are not judged [s]
FOLDED = 150.0  # angle from which an edge counts as folded back [deg]


class ErrorClass(IntEnum):
    """Whether anyone sees it, from best to worst."""

    IMPERCEPTIBLE = 0
    ACCEPTED = 1
    VISIBLE = 2
    CATASTROPHIC = 3


# Of each figure of `deviations`: imperceptible up to, accepted up to, catastrophic above.
LIMITS: Mapping[str, tuple[float, float, float]] = {
    "edge_strain_p95": (0.01, 0.10, np.inf),
    "edge_strain_max": (0.03, 0.20, np.inf),
    "edge_strain_beyond": (1.0, 1.0, 1.0),
    "velocity_rms": (0.05, 0.30, np.inf),
    "speed_over_limit": (1.0, 1.0, 1.0),
    "energy_error": (0.02, np.inf, np.inf),
    "energy_growth": (0.0, 0.05, 1.0),
    "penetration_thicknesses": (0.1, 1.0, np.inf),
    "penetration_s": (0.5, 0.5, 1.0),
    "position_px": (1.0, 10.0, np.inf),
    "box_ratio": (2.0, 2.0, 2.0),
    "jitter_px": (0.1, 1.0, 5.0),
    "folded_percent": (0.5, 5.0, np.inf),
    "through_percent": (0.0, 0.0, 0.0),
    "not_finite": (0.0, 0.0, 0.0),
}
ENERGY_NOISE = 1e-3  # growth of energy below this is rounding [-]


@dataclass(frozen=True)
class Recorded:
    """A run of one cloth.

    Attributes:
        position: [m], shape (f, n, 3).
        velocity: [m/s], shape (f, n, 3).
        dt: time between frames [s].
        energy: kinetic and gravity's energy, and the elastic one where a method has one of its own [J], shape (f,);
            None where something drives the cloth.
        depth: deepest vertex under a collider's surface [m], shape (f,); None without colliders.
        at_rest: whether the end is meant to be at rest, so that jitter counts.
        through: part of the layers that a collider has gone through [%], shape (f,); None where none can.
    """

    position: np.ndarray
    velocity: np.ndarray
    dt: float
    energy: np.ndarray | None = None
    depth: np.ndarray | None = None
    at_rest: bool = False
    through: np.ndarray | None = None


def deviations(
    run: Recorded,
    reference: Recorded,
    edges: np.ndarray,
    rest_lengths: np.ndarray,
    thickness: float,
    collider_speed: float = 0.0,
    *,
    chaotic: bool = False,
    energy_scale: float | None = None,
    hinges: np.ndarray | None = None,
) -> dict[str, float]:
    """Figures of a run by the names of :data:`LIMITS`; those that do not apply are absent.

    Args:
        run, reference: at the same times and with the same vertices.
        edges: shape (e, 2).
        rest_lengths: [m], shape (e,).
        thickness: contact thickness [m].
        collider_speed: fastest collider [m/s].
        chaotic: the answer is not unique: strains are compared as distributions over edges and frames, positions and
            velocities not at all.
        energy_scale: divides errors of energy [J]; None takes the range of the reference's energy.
        hinges: both ends of an inner edge and the corners across, shape (h, 4); None leaves out how much of the cloth
            is folded back on itself, more than it is in the reference.

    Raises:
        InputError: runs of different shapes.
    """
    if run.position.shape != reference.position.shape:
        raise InputError(
            "runs do not match", key="position", received=run.position.shape, expected=str(reference.position.shape)
        )
    if not (np.isfinite(run.position).all() and np.isfinite(run.velocity).all()):
        return {"not_finite": 1.0}
    later = slice(min(round(START / run.dt), len(run.position) - 1), None)
    x, truth = run.position[later].astype(float), reference.position[later].astype(float)
    found: dict[str, float] = {"not_finite": 0.0}
    strain, wanted = edge_strain(x, edges, rest_lengths), edge_strain(truth, edges, rest_lengths)
    if chaotic:
        found["edge_strain_p95"] = abs(np.percentile(np.abs(strain), 95) - np.percentile(np.abs(wanted), 95))
        found["edge_strain_max"] = abs(strain.max() - wanted.max())
        found["edge_strain_beyond"] = strain.max() - wanted.max()
    else:
        found["edge_strain_p95"] = float(np.percentile(np.abs(strain - wanted), 95))
        found["edge_strain_max"] = float(np.abs(strain - wanted).max())
        found["edge_strain_beyond"] = float((strain - wanted).max())
        motion = np.sqrt(np.mean(np.sum(reference.velocity[later].astype(float) ** 2, axis=2)))
        off = np.sqrt(np.mean(np.sum((run.velocity[later].astype(float) - reference.velocity[later]) ** 2, axis=2)))
        if motion > 1e-3:
            found["velocity_rms"] = float(off / motion)
        found["position_px"] = float(np.percentile(pixel_distance(x, truth), 95))
    height = np.ptp(reference.position.reshape(-1, 3), axis=0).max()
    fastest = 3.0 * np.sqrt(2.0 * GRAVITY * height) + collider_speed
    found["speed_over_limit"] = float(np.linalg.norm(run.velocity[later], axis=2).max() / fastest)
    found["box_ratio"] = float(np.max(_box(x) / np.maximum(_box(truth), 1e-9)))
    if run.energy is not None and reference.energy is not None:
        scale = max(float(np.ptp(reference.energy)) if energy_scale is None else energy_scale, 1e-12)
        growth, fair = (float((energy - energy[0]).max()) / scale for energy in (run.energy, reference.energy))
        found["energy_growth"] = growth - fair if growth - fair > ENERGY_NOISE else 0.0
        found["energy_error"] = float(np.abs(run.energy - reference.energy)[later].max() / scale)
    if run.depth is not None:
        deep = run.depth[later]
        found["penetration_thicknesses"] = float(max(deep.max(), 0.0) / thickness)
        found["penetration_s"] = run.dt * longest_run(deep > thickness)
    if hinges is not None:
        found["folded_percent"] = max(0.0, float((_folded(x, hinges) - _folded(truth, hinges)).max()))
    if run.through is not None:
        found["through_percent"] = float(run.through[later].max())
    if run.at_rest:
        found["jitter_px"] = jitter_px(x[-max(3, round(0.5 / run.dt)) :])
    return {name: float(value) for name, value in found.items()}


def classify(figures: Mapping[str, float]) -> dict[str, ErrorClass]:
    """Class of each figure; one that is not a number is catastrophic."""
    return {name: _class(value, LIMITS[name]) for name, value in figures.items()}


def _class(value: float, limits: tuple[float, float, float]) -> ErrorClass:
    if np.isnan(value) or value > limits[2]:
        return ErrorClass.CATASTROPHIC
    if value <= limits[0]:
        return ErrorClass.IMPERCEPTIBLE
    return ErrorClass.ACCEPTED if value <= limits[1] else ErrorClass.VISIBLE


def _folded(position: np.ndarray, hinges: np.ndarray) -> np.ndarray:
    """Inner edges whose two faces lie back on each other, further than ``FOLDED``, in each frame [%]."""
    i, j, a, b = (position[:, hinges[:, k]] for k in range(4))
    first, second = np.cross(j - i, a - i), np.cross(b - i, j - i)
    size = np.linalg.norm(first, axis=2) * np.linalg.norm(second, axis=2)
    return 100.0 * np.mean(np.einsum("fhi,fhi->fh", first, second) < np.cos(np.radians(FOLDED)) * size, axis=1)


def _box(position: np.ndarray) -> np.ndarray:
    """Diagonal of the bounding box of each frame [m]."""
    return np.linalg.norm(position.max(axis=1) - position.min(axis=1), axis=1)


def longest_run(flags: np.ndarray) -> int:
    """Most frames in a row that are true."""
    padded = np.concatenate([[0], flags.astype(int), [0]])
    turns = np.flatnonzero(np.diff(padded))
    return int((turns[1::2] - turns[::2]).max(initial=0))
