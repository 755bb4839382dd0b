"""Opens what `gube view` is asked for: a database, a scene, a saved view, or what there is without a file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import assets
from assets.io.scene import CameraSettings, load_scene
from assets.io.view_settings import ViewSettings
from pbd import InputError
from runtime.setup.playback_inputs import PlaybackInputs, open_database
from runtime.viewer.garments import ShownTruth
from runtime.viewer.sources import DatabaseSource, SceneSource, Source
from wrinkles.database import WrinkleDatabase

__all__ = ["BUILTIN_DATABASE", "DEMO_DATABASE", "Opened", "Truths", "open_source"]

DEMO_DATABASE = Path("out/demo/skirt.h5")  # where `gube demo` writes it
BUILTIN_DATABASE = Path(assets.__file__).parent / "data" / "demo.h5"  # `make database` learns it anew

Truths = Callable[[Path, WrinkleDatabase, PlaybackInputs], Mapping[str, ShownTruth]]
"""Finds recorded fine simulations by the name of the motion."""


class Opened(NamedTuple):
    """What is viewed, and how.

    Attributes:
        source: a database or a scene.
        view: how it is shown first.
        camera: of a saved view, in the world; None for one that sees everything.
    """

    source: Source
    view: ViewSettings = ViewSettings()
    camera: CameraSettings | None = None


def open_source(file: Path | None, truths: Truths | None = None) -> Opened:
    """Open what is viewed.

    Args:
        file: a database (.h5), or a scene or a saved view (.toml); None takes the demo's database, or without one that
            of the package.
        truths: finds the fine simulations that are shown beside a database; None shows none.

    Raises:
        InputError: another kind of file, one that cannot be opened, or truths of a scene without a database.
    """
    if file is None:
        file = DEMO_DATABASE if DEMO_DATABASE.exists() else BUILTIN_DATABASE
    if file.suffix.lower() == ".h5":
        return Opened(_database_source(file, truths))
    if file.suffix.lower() != ".toml":
        expected = "a database (.h5) or a scene (.toml)"
        raise InputError("nothing to view", key="file", received=str(file), expected=expected)
    scene = load_scene(file)
    view = scene.view
    if view is not None and view.database is not None:
        source = _database_source(view.database, truths)
        return Opened(replace(source, inputs=replace(source.inputs, wind=scene.wind.air())), view, scene.camera)
    if truths is not None:
        expected = "a database: a scene is simulated as it is"
        raise InputError("no wrinkles to compare with the truth", key="--truth", received=file, expected=expected)
    source = SceneSource(file, scene)
    return Opened(source) if view is None else Opened(source, view, scene.camera)


def _database_source(path: Path, truths: Truths | None) -> DatabaseSource:
    database, inputs = open_database(path)
    return DatabaseSource(path, database, inputs, {} if truths is None else truths(path, database, inputs))
