"""Figures of methods that were played: against the truth, of contact with the body and of stretch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pbd.distance import penetration_figures
from precompute.learning.evaluation import body_distances, floor_figures, free_figures, mean_figures
from precompute.learning.truth import Truth
from precompute.scratch import UNCOUNTED, Tally
from precompute.wrinkle_comparison.comparison import Method
from precompute.wrinkle_comparison.realism import PatchStatistics, realism
from wrinkles.mesh_measures import edge_stretch

__all__ = ["figures_of", "shared_figures"]


def figures_of(truth: Truth, methods: Sequence[Method], tally: Tally = UNCOUNTED) -> list[Method]:
    """Methods with their figures beside a truth; one that broke has none.

    Args:
        truth: of the motion.
        methods: that were played.
        tally: counts those that are measured.
    """
    statistics = PatchStatistics(truth.levels.fine)
    of_truth = statistics(truth.frames)
    measured = []
    for method in methods:
        if not method.runs:
            measured.append(method)
            continue
        figures, told = {}, None
        if method.prefix != "truth_":
            every = [realism(statistics, of_truth, statistics(frames)) for frames in method.runs]
            of_runs = [
                free_figures(truth, frames) | {"realism": one.auc}
                for frames, one in zip(method.runs, every, strict=True)
            ]
            floor = method.prefix == "floor_"
            figures, told = (
                floor_figures(truth, of_runs) if floor else mean_figures(truth, method.runs, of_runs),
                every[0],
            )
        if not method.mesh:
            figures |= shared_figures(truth, method.runs[0])
        measured.append(replace(method, figures=figures, realism=told))
        tally.add()
    return measured


def shared_figures(truth: Truth, frames: np.ndarray) -> dict[str, float]:
    """What can be asked of any run, the truth's too: contact with the body and stretch.

    Args:
        truth: of the motion.
        frames: fine vertices [m], float32, shape (f, N, 3).
    """
    stretch = edge_stretch(frames, *truth.levels.fine.edge_lengths())
    figures = {name: float(value) for name, value in penetration_figures(*body_distances(truth, frames)).items()}
    return figures | {
        "edge_stretch_p99_percent": 100.0 * stretch.p99,
        "edge_stretch_max_percent": 100.0 * stretch.max,
    }
