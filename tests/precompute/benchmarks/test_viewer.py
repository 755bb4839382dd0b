"""Figures of what reached a client of the viewer. Its protocol is tested with the viewer itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pbd import InputError
from precompute.benchmarks.viewer import Watched, bench_viewer


def test_rate_and_intervals() -> None:
    watched = Watched(np.array([1.0, 1.1, 1.2, 1.5, 2.0]))
    assert watched.rate_hz == pytest.approx(4.0)
    assert watched.interval_ms(50.0) == pytest.approx(200.0)
    assert watched.interval_ms(100.0) == pytest.approx(500.0)
    assert Watched(np.array([3.0])).rate_hz == 0.0
    assert np.isnan(Watched(np.zeros(0)).interval_ms(50.0))


def test_a_scene_has_no_wrinkles_to_send(tmp_path: Path) -> None:
    (tmp_path / "flag.toml").write_text('[[garment]]\nname = "flag"\nmesh = "builtin:flag"\npins = [0]\n')
    with pytest.raises(InputError, match="no database"):
        bench_viewer(tmp_path / "flag.toml", 1.0, lambda line: None)
