"""A tube of two panels, and a body that it slides down until it fits."""

from __future__ import annotations

import numpy as np

from assets.patterns.pattern import Band, EdgeName, Panel, Pattern, Placement, Seam
from assets.sewing.body import StandingBody
from tests.wrinkles.meshes import icosphere

__all__ = ["egg", "tube_pattern"]


def egg() -> StandingBody:
    """An ellipsoid, 0.8 m high and 0.2 m wide, its middle 0.15 m below the origin."""
    vertices, faces = icosphere(3)
    return StandingBody("egg", vertices * [0.1, 0.4, 0.1] - [0.0, 0.15, 0.0], faces)


def tube_pattern(
    girth: float = 0.6, height: float = 0.1, placed: bool = True, layers: float = 2.0, flare: float = 0.0
) -> Pattern:
    """Front and back of a tube around the egg, the back without a place if not ``placed``; ``layers`` at the top.

    Its girth at the hem is larger by ``flare`` [m].
    """
    half, hem = girth / 4.0, (girth + flare) / 4.0
    corners = np.array([[-hem, 0.0], [hem, 0.0], [half, height], [-half, height]])
    edges = tuple(np.stack([a, b]) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True))
    turned = np.diag([-1.0, 1.0, -1.0])
    panels = [
        Panel("front", edges, np.array([0.0, 1.0]), Placement(np.eye(3), np.array([0.0, 0.0, 0.15]))),
        Panel("back", edges, np.array([0.0, 1.0]), Placement(turned, np.array([0.0, 0.0, -0.15])) if placed else None),
    ]
    seams = [Seam(EdgeName("front", 1), EdgeName("back", 3)), Seam(EdgeName("front", 3), EdgeName("back", 1))]
    bands = [Band(EdgeName(name, 2), 0.02, layers) for name in ("front", "back")]
    return Pattern("tube", tuple(panels), tuple(seams), tuple(bands), "test")
