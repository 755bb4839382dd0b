"""Comparisons of wrinkles with small networks and few of everything."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from unittest.mock import patch

from precompute.wrinkle_comparison import ablation_experiment, ablations, wrinkle_baselines, wrinkle_comparison

__all__ = ["small_comparison"]


@contextmanager
def small_comparison() -> Iterator[None]:
    """Constants of the comparisons made small."""
    with ExitStack() as stack:
        for module, name, value in (
            (ablation_experiment, "EPOCHS", 2),
            (ablations, "EPOCHS", 2),
            (wrinkle_comparison, "RADII", (0.25,)),
            (wrinkle_baselines, "WIDE", (12, 8)),
            (wrinkle_baselines, "MODES", 32),
        ):
            stack.enter_context(patch.object(module, name, value))
        yield
