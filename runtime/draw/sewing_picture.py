"""The picture of a sewing: the flat pattern, the panels around the body, the draped garment from three sides."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from assets.patterns.pattern import Pattern
from assets.sewing.body import StandingBody
from assets.sewing.sewing import COARSE_EDGE, arranged_pieces
from assets.sewing.sewn_garment import SewnGarment
from runtime.draw.pattern_picture import draw_pattern
from runtime.draw.picture_content import Drawn, frame_camera
from runtime.draw.pictures import render, save_png, strip

__all__ = ["draw_sewing"]

_SIZE = (560, 900)  # of one picture [pixel]
_PANEL_COLORS = ((0.31, 0.50, 0.70), (0.72, 0.45, 0.35), (0.42, 0.60, 0.42), (0.75, 0.65, 0.35), (0.55, 0.42, 0.62))
_SIDES = (("front", 20.0), ("back", 200.0), ("side", 90.0))  # azimuth of the eye [deg]


def draw_sewing(path: Path, pattern: Pattern, body: StandingBody, sewn: SewnGarment | None) -> None:
    """Draw a sewing into a file (.png).

    Args:
        path: the file.
        pattern: what was sewn.
        body: on which it was sewn.
        sewn: the garment; None where it came to none.
    """
    pieces, start = arranged_pieces(pattern, body, COARSE_EDGE)
    placed = [
        Drawn(start, pieces.faces[pieces.piece_of_face == piece], _PANEL_COLORS[piece % len(_PANEL_COLORS)])
        for piece in range(len(pieces.names))
    ]
    columns, titles = [[_fitted(draw_pattern(pattern))], [_seen(body, placed, start, 30.0)]], ["pattern", "placed"]
    if sewn is not None:
        garment = sewn.garment
        for side, azimuth in _SIDES:
            columns.append(
                [
                    _seen(
                        body,
                        [Drawn(garment.vertices, garment.faces, pattern=garment.pattern)],
                        garment.vertices,
                        azimuth,
                    )
                ]
            )
            titles.append(side)
    save_png(path, strip(columns, titles, [""]))


def _seen(body: StandingBody, meshes: list[Drawn], shown: np.ndarray, azimuth: float) -> np.ndarray:
    """The body and meshes from a side; the camera frames the vertices that are shown."""
    camera = frame_camera(shown[None], azimuth_deg=azimuth, aspect=_SIZE[0] / _SIZE[1])[0]
    return render([Drawn.body(body.vertices, body.faces), *meshes], camera, _SIZE, floor=None)


def _fitted(image: np.ndarray) -> np.ndarray:
    """An image on white paper of the size of the others."""
    from PIL import Image

    drawing = Image.fromarray(np.ascontiguousarray(image))
    drawing.thumbnail(_SIZE)
    paper = Image.new("RGB", _SIZE, (255, 255, 255))
    paper.paste(drawing, ((_SIZE[0] - drawing.width) // 2, (_SIZE[1] - drawing.height) // 2))
    return np.asarray(paper)
