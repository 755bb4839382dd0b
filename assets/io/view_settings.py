"""The part of a scene file that says what `gube view` shows."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from assets.io.settings import choice, entry, file_path, number, several, text, truth

__all__ = ["ViewSettings"]


@dataclass(frozen=True, kw_only=True)
class ViewSettings:
    """What `gube view` shows of a scene, and how; the camera is the scene's.

    Attributes:
        database: wrinkle database that is played; None simulates the garments without wrinkles.
        motion: name of the motion; None takes the first one.
        garments: names of the garments of an outfit that are worn; () wears all.
        fabric: name of a fabric of the database; None takes the garment's own.
        wrinkles: play the wrinkles even where plain cloth is the better choice.
        time: moment that is shown first [s].
        meshes: names of the meshes that are shown; () shows the one that a game would draw.
        overlaid: all meshes in one place; else side by side.
        colors: what the colours say.
        wireframe: edges instead of faces.
        body: show the body.
        follow: keep the body in the middle.
        bending, stretch, weight: factors on the fabric's bending, stretch and mass [-].
    """

    database: Path | None = entry(file_path(".h5"), None)
    motion: str | None = entry(text(), None)
    garments: tuple[str, ...] = entry(several(text()), ())
    fabric: str | None = entry(text(), None)
    wrinkles: bool = entry(truth(), False)
    time: float = entry(number(at_least=0, unit="s"), 0.0)
    meshes: tuple[str, ...] = entry(several(text()), ())
    overlaid: bool = entry(truth(), False)
    colors: str = entry(choice("cloth", "strain", "bending", "contact", "novelty", "level of detail"), "cloth")
    wireframe: bool = entry(truth(), False)
    body: bool = entry(truth(), True)
    follow: bool = entry(truth(), True)
    bending: float = entry(number(above=0), 1.0)
    stretch: float = entry(number(above=0), 1.0)
    weight: float = entry(number(above=0), 1.0)
