"""Results of stages are found again as they were, and computed anew where their file is broken."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from precompute.learning.kept import Kept
from precompute.learning.options import LearningOptions
from precompute.learning.pipeline import Precomputed, precompute
from tests.precompute.miniature import OPTIONS, same, scene


@dataclass(frozen=True)
class Found:
    array: np.ndarray
    number: float


def test_what_was_found_is_found_again(tmp_path: Path) -> None:
    kept, computed = Kept(tmp_path, scene(), [], OPTIONS), []

    def compute() -> Found:
        computed.append(1)
        return Found(np.arange(6, dtype=np.float32).reshape(2, 3), 0.1)

    for _ in range(2):
        found = kept.instance(Found, "found", compute)
        assert found.array.dtype == np.float32 and np.array_equal(found.array, compute().array) and found.number == 0.1
    assert len(computed) == 3  # one of them above
    other = Kept(tmp_path, scene(), [], replace(OPTIONS, epochs=7))
    assert other.instance(Found, "found", lambda: Found(np.zeros(1), 2.0)).number == 2.0


@pytest.mark.parametrize("seed", range(20))
def test_a_broken_file_is_made_anew(seed: int, tmp_path: Path) -> None:
    kept, rng = Kept(tmp_path, scene(), [], LearningOptions()), np.random.default_rng(seed)
    right = Found(np.arange(200.0), 0.5)
    kept.instance(Found, "found", lambda: right)
    for path in (one for one in tmp_path.rglob("*") if one.is_file()):
        data = bytearray(path.read_bytes())
        if seed % 2:
            data = data[: rng.integers(len(data))]
        else:
            data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
        path.write_bytes(data)
    found = kept.instance(Found, "found", lambda: right)
    assert np.array_equal(found.array, right.array) and found.number == right.number


@pytest.mark.proof
def test_a_precompute_goes_on_after_its_last_stage(
    learned: Precomputed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*given: object, **named: object) -> None:
        raise AssertionError("computed again")

    for name in ("fit_layer", "training_set", "fit_novelty"):
        monkeypatch.setattr(f"precompute.learning.pipeline.{name}", never)
    cache = learned.path.parent / ".gube-cache"
    again = precompute(scene(), tmp_path / "skirt.h5", cache=cache, workers=1, options=OPTIONS)
    same(again.database, learned.database)
