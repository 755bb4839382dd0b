"""Colours of a garment by what happens to it: strain, bending, contact, novelty, level of detail; and their legends.

A mesh is drawn in bands: each face has one of :data:`BANDS` colours. A viewer's mesh has one colour, so that each band
is a mesh of its own.
"""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle, islice
from typing import Any

import numpy as np

from pbd import ClothMesh
from pbd.mesh import edges_of
from runtime.draw.picture_content import GARMENT_COLORS

__all__ = [
    "BANDS",
    "CLOTH",
    "SCALES",
    "ColorBand",
    "ColorScale",
    "FaceBending",
    "FaceStrain",
    "CLOTH_COLORS",
    "GARMENTS",
    "bands_of",
    "legend",
    "names_legend",
    "place",
    "rgb",
]

Rgb = tuple[int, int, int]

BANDS = 9
CLOTH = "cloth"  # the cloth's own colour, of each garment of an outfit another
PAD_VERTICES, PAD_FACES = 512, 1024  # bands are filled up to multiples, so that their sizes hardly change
_COLD_TO_HOT = ((40, 70, 150), (92, 140, 196), (200, 203, 206), (222, 138, 92), (160, 38, 40))  # about a middle
_DARK_TO_LIGHT = ((52, 38, 92), (56, 92, 140), (48, 146, 136), (132, 192, 88), (246, 222, 74))
_LIGHT_TO_DARK = _DARK_TO_LIGHT[::-1]
_CATEGORIES = (
    (78, 121, 167), (242, 142, 43), (89, 161, 79), (225, 87, 89), (176, 122, 161), (156, 117, 95), (186, 176, 172),
    (237, 201, 72), (118, 183, 178),
)  # fmt: skip


def rgb(color: tuple[float, float, float]) -> Rgb:
    """A colour in parts of 255."""
    red, green, blue = (round(255.0 * part) for part in color)
    return red, green, blue


def _ramp(anchors: Sequence[Rgb]) -> tuple[Rgb, ...]:
    """BANDS colours from the first anchor to the last one."""
    at = np.linspace(0.0, len(anchors) - 1.0, BANDS)
    columns = [np.interp(at, np.arange(len(anchors)), column) for column in np.transpose(anchors)]
    return tuple((int(r), int(g), int(b)) for r, g, b in np.round(np.transpose(columns)))


@dataclass(frozen=True)
class ColorScale:
    """The bands of one way to colour.

    Attributes:
        title: quantity and unit.
        explanation: in a sentence.
        low, high: values at the lower border of the first band and at the upper border of the last one.
        colors: of the bands.
    """

    title: str
    explanation: str
    low: float
    high: float
    colors: tuple[Rgb, ...]

    def band(self, values: np.ndarray) -> np.ndarray:
        """The band of each value, int, the shape of the values; values beyond the ends are in the first or last one."""
        share = (np.asarray(values) - self.low) * (BANDS / (self.high - self.low))
        return np.clip(share, 0.0, BANDS - 1.0).astype(np.int8)


SCALES = {
    "strain": ColorScale(
        "strain [%]",
        "the larger principal strain of each face: blue is shortened, red is stretched",
        -9.0,
        9.0,
        _ramp(_COLD_TO_HOT),
    ),
    "bending": ColorScale(
        "curvature [1/m]",
        "how sharply the cloth turns: 100 /m is a fold with a radius of 1 cm",
        0.0,
        90.0,
        _ramp(_DARK_TO_LIGHT),
    ),
    "contact": ColorScale(
        "distance to the body [mm]",
        "where the simulated garment lies on the body, and where it hangs free",
        0.0,
        18.0,
        _ramp(_LIGHT_TO_DARK),
    ),
    "novelty": ColorScale(
        "expected error [deg]",
        "normal error that the network expects of its own wrinkles: large in states unlike the training data",
        0.0,
        18.0,
        _ramp(_DARK_TO_LIGHT),
    ),
    "level of detail": ColorScale(
        "level of detail", "how much of the garment is modelled now", 0.0, float(BANDS), _CATEGORIES
    ),
}
"""Scales by the name of what they colour, beside :data:`CLOTH`."""
CLOTH_COLORS: tuple[Rgb, ...] = tuple(rgb(color) for color in GARMENT_COLORS)
GARMENTS = ColorScale(
    "garment", "the garments of the outfit", 0.0, float(BANDS), tuple(islice(cycle(CLOTH_COLORS), BANDS))
)
"""The scale of :data:`CLOTH` for an outfit; garments beyond the last band have the last one's colour."""


class FaceStrain:
    """Strain of the faces of a mesh.

    Args:
        cloth: gives faces and rest shape.
    """

    def __init__(self, cloth: ClothMesh) -> None:
        self._corners = np.ascontiguousarray(cloth.faces.T)
        self._inverse = np.linalg.inv(cloth.flat).astype(np.float32)

    def __call__(self, vertices: np.ndarray) -> np.ndarray:
        """The principal strain of each face that is larger without its sign [%], float32, shape (m,).

        With F the deformation gradient, the principal stretches are the roots of the eigenvalues of F^T F.

        Args:
            vertices: [m], float32, shape (n, 3).
        """
        first = vertices[self._corners[0]]
        side_1, side_2 = vertices[self._corners[1]] - first, vertices[self._corners[2]] - first
        gram = [np.einsum("ij,ij->i", a, b) for a, b in ((side_1, side_1), (side_1, side_2), (side_2, side_2))]
        (a, b), (c, d) = self._inverse.transpose(1, 2, 0)
        xx = a * a * gram[0] + 2.0 * a * c * gram[1] + c * c * gram[2]
        yy = b * b * gram[0] + 2.0 * b * d * gram[1] + d * d * gram[2]
        xy = a * b * gram[0] + (a * d + b * c) * gram[1] + c * d * gram[2]
        middle, radius = 0.5 * (xx + yy), np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
        longest = np.sqrt(middle + radius) - 1.0
        shortest = np.sqrt(np.maximum(middle - radius, 0.0)) - 1.0
        return 100.0 * np.where(longest > -shortest, longest, shortest)


class FaceBending:
    """Curvature of a mesh at its faces.

    Args:
        cloth: gives faces and rest shape.
    """

    def __init__(self, cloth: ClothMesh) -> None:
        faces = cloth.faces
        self._corners = np.ascontiguousarray(faces.T)
        _, side_edge = edges_of(faces)
        order = np.argsort(side_edge.ravel(), kind="stable")
        edge = side_edge.ravel()[order]
        same = np.flatnonzero(edge[:-1] == edge[1:])
        one, two = order[same], order[same + 1]  # the sides of the two faces at each inner edge
        self._first, self._second = one // 3, two // 3
        sides = np.stack([cloth.flat[:, :, 0], cloth.flat[:, :, 1] - cloth.flat[:, :, 0], cloth.flat[:, :, 1]], axis=1)
        self._length = np.linalg.norm(sides, axis=2).ravel()[one].astype(np.float32)
        self._inverse_area = (1.0 / np.abs(np.linalg.det(cloth.flat))).astype(np.float32)  # half of 1 / area
        self._around = np.full((len(faces), 3), len(same), np.int32)  # the inner edge at each side, or none
        self._around.ravel()[one] = self._around.ravel()[two] = np.arange(len(same))

    def __call__(self, vertices: np.ndarray) -> np.ndarray:
        """Curvature at each face, the sum of both principal ones without their signs [1/m], float32, shape (m,).

        The turn of the surface over an edge times the edge's length is the curvature's integral over the two faces at
        it, and each of them takes half. The turn is taken as twice the sine of its half.

        Args:
            vertices: [m], float32, shape (n, 3).
        """
        first = vertices[self._corners[0]]
        normal = np.cross(vertices[self._corners[1]] - first, vertices[self._corners[2]] - first)
        normal /= np.maximum(np.sqrt(np.einsum("ij,ij->i", normal, normal)), 1e-20)[:, None]
        step = normal[self._first] - normal[self._second]
        turn = np.zeros(len(step) + 1, np.float32)
        turn[:-1] = np.sqrt(np.einsum("ij,ij->i", step, step)) * self._length
        return turn[self._around].sum(axis=1) * self._inverse_area


@dataclass(frozen=True)
class ColorBand:
    """The faces of one colour.

    Attributes:
        vertices: of these faces and some besides [m], float32, shape (k, 3).
        faces: indices into them, uint32, shape (j, 3); those that fill up have no area.
    """

    vertices: np.ndarray
    faces: np.ndarray


def bands_of(vertices: np.ndarray, faces: np.ndarray, band: np.ndarray) -> list[ColorBand]:
    """Cut a mesh into one mesh for each band.

    Args:
        vertices: [m], float32, shape (n, 3).
        faces: int, shape (m, 3).
        band: of each face, int8, shape (m,).
    """
    order = np.argsort(band, kind="stable")
    ends = np.searchsorted(band[order], np.arange(BANDS + 1))
    return [_band(vertices, faces[order[begin:end]]) for begin, end in zip(ends[:-1], ends[1:], strict=True)]


def _band(vertices: np.ndarray, faces: np.ndarray) -> ColorBand:
    used = np.zeros(len(vertices), bool)
    used[faces] = True
    kept = np.flatnonzero(used)
    number = np.cumsum(used, dtype=np.uint32) - np.uint32(1)
    padded = np.zeros((_padded(len(kept), PAD_VERTICES), 3), np.float32)
    padded[: len(kept)] = vertices[kept]
    padded[len(kept) :] = vertices[kept[0]] if len(kept) else 0.0
    filled = np.zeros((_padded(len(faces), PAD_FACES), 3), np.uint32)
    filled[: len(faces)] = number[faces]
    return ColorBand(padded, filled)


def _padded(count: int, step: int) -> int:
    return max(1, -(-count // step)) * step


def place(index: Any) -> Any:
    """The value, or an array of them, that puts a face into a band of a scale of kinds."""
    return index + 0.5


def legend(scale: ColorScale, names: Sequence[str] = ()) -> str:
    """The legend of a scale as HTML.

    Args:
        scale: the scale.
        names: of its bands, where they are kinds and no numbers.
    """
    if names:
        return _box(scale.title, _rows(zip(names, scale.colors, strict=False)), scale.explanation)
    boxes = "".join(f'<span style="flex:1;height:1.1em;background:rgb{color}"></span>' for color in scale.colors)
    marks = np.linspace(scale.low, scale.high, 4)
    numbers = "".join(f"<span>{'+' if mark > 0 > scale.low else ''}{mark:g}</span>" for mark in marks)
    return _box(
        scale.title,
        f'<div style="display:flex">{boxes}</div>'
        f'<div style="display:flex;justify-content:space-between">{numbers}</div>',
        scale.explanation,
    )


def names_legend(colors: Mapping[str, Rgb]) -> str:
    """A legend as HTML that names colours."""
    return _box("", _rows(colors.items()), "")


def _rows(colors: Iterable[tuple[str, Rgb]]) -> str:
    return "".join(
        '<div style="display:flex;align-items:center;gap:0.5em;margin:0.15em 0"><span style="width:1.4em;height:1em;'
        f'background:rgb{color}"></span>{html.escape(name)}</div>'
        for name, color in colors
    )


def _box(title: str, content: str, explanation: str) -> str:
    return (
        '<div style="font-size:0.85em;line-height:1.35;padding:0.2em 0.9em 0.6em">'
        f"<b>{html.escape(title)}</b>{content}"
        f'<div style="opacity:0.75">{html.escape(explanation)}</div></div>'
    )
