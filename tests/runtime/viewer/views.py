"""Small databases and scenes that tests view."""

from __future__ import annotations

from functools import cache

from runtime.setup.playback_inputs import playback_inputs
from runtime.viewer.sources import DatabaseSource
from tests.data import ROOT
from tests.runtime.players import outfit_database, skirt_database

__all__ = ["FLAG", "outfit_source", "skirt_source"]

FLAG = """
[[garment]]
name = "flag"
mesh = "builtin:flag"
pins = [0]
"""


@cache
def skirt_source() -> DatabaseSource:
    """The skirt with random wrinkles."""
    database = skirt_database()
    return DatabaseSource(ROOT / "skirt.h5", database, playback_inputs(database), {})


def outfit_source() -> DatabaseSource:
    """A skirt over trousers with random wrinkles."""
    database = outfit_database()
    return DatabaseSource(ROOT / "outfit.h5", database, playback_inputs(database), {})
