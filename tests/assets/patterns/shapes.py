"""Small patterns that several tests cut."""

from __future__ import annotations

import numpy as np

from assets.patterns.pattern import Band, EdgeName, Panel, Pattern, Seam


def polygon(name: str, corners: list[tuple[float, float]]) -> Panel:
    points = np.array([*corners, corners[0]], float)
    return Panel(name, tuple(points[k : k + 2] for k in range(len(corners))), np.array([0.0, 1.0]))


def pattern(*panels: Panel, seams: tuple[Seam, ...] = (), bands: tuple[Band, ...] = ()) -> Pattern:
    return Pattern("test", panels, seams, bands, "test")


def tube() -> Pattern:
    """A front and a longer back, sewn at both sides; the back is 1.2 times as high and has a round hem."""
    front = polygon("front", [(0.0, 0.0), (0.5, 0.0), (0.5, 0.4), (0.0, 0.4)])
    arc = np.linspace(0.0, np.pi, 91)
    hem = np.stack([0.25 - 0.25 * np.cos(arc), -0.1 * np.sin(arc)], axis=1)
    back = polygon("back", [(0.0, 0.0), (0.5, 0.0), (0.5, 0.48), (0.0, 0.48)])
    back = Panel("back", (hem, *back.edges[1:]), back.grain)
    seams = tuple(Seam(EdgeName("front", k), EdgeName("back", 4 - k)) for k in (1, 3))
    return pattern(front, back, seams=seams)


def darted(depth: float = 0.15, width: float = 0.02) -> Pattern:
    """A rectangle with a dart in its upper edge, sewn."""
    dart = [(0.2 + width / 2.0, 0.3), (0.2, 0.3 - depth), (0.2 - width / 2.0, 0.3)]
    panel = polygon("skirt", [(0.0, 0.0), (0.4, 0.0), (0.4, 0.3), *dart, (0.0, 0.3)])
    return pattern(panel, seams=(Seam(EdgeName("skirt", 3), EdgeName("skirt", 4)),))
