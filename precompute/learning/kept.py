"""What was fitted or chosen, kept on disk: a precompute that was ended goes on after its last stage."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

import assets
import pbd
import precompute.learning
import runtime
import wrinkles
from assets.io.scene import Scene, scene_text
from pbd.fingerprint import source_fingerprint
from pbd.storage import BROKEN_NPZ, replacing
from precompute.learning.options import LearningOptions
from precompute.learning.run_recording import Run

__all__ = ["Kept"]

Kind = TypeVar("Kind", bound=Any)  # a data class


class Kept:
    """Results of the stages of one precompute, found again by all that they depend on.

    Args:
        cache: folder of simulated runs.
        scene: that is learned.
        runs: that are learned from.
        options: how much is done.
    """

    def __init__(self, cache: Path, scene: Scene, runs: Sequence[Run], options: LearningOptions) -> None:
        code = source_fingerprint(pbd, assets, wrinkles, runtime, precompute.learning)
        learned = replace(scene, training=replace(scene.training, held_out=()))  # nothing is learned from these
        content = [code, scene_text(learned), repr(options), *(run.key() for run in runs)]
        self._folder = cache / "learned" / hashlib.sha256("\n".join(content).encode()).hexdigest()[:24]

    def instance(self, kind: type[Kind], name: str, compute: Callable[[], Kind]) -> Kind:
        """A data class of arrays and numbers, computed where it is not kept or its file is broken."""
        path = self._folder / f"{name}.npz"
        with suppress(OSError, KeyError, *BROKEN_NPZ):
            return _read(kind, path)
        found = compute()
        with replacing(path) as beside, open(beside, "wb") as file:
            np.savez(file, allow_pickle=False, **{one.name: getattr(found, one.name) for one in fields(kind)})
        return _read(kind, path)


def _read(kind: type[Kind], path: Path) -> Kind:
    with np.load(path, allow_pickle=False) as file:  # checks the sum of each array that is read
        values = {one.name: file[one.name] for one in fields(kind)}
    return kind(**{name: value if value.ndim else value.item() for name, value in values.items()})
