"""Units and axes of files that do not say them: guessed by the height of a body, and by where a garment fits it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from assets.bands import distances
from assets.body_checks import HEIGHTS, UNITS
from assets.garment import Garment, boundary_loops
from pbd.distance import BodyDistance
from pbd.errors import InputError
from pbd.mesh import edges_of

__all__ = [
    "AS_STORED",
    "Fit",
    "FilePlacement",
    "best_placement",
    "body_placement",
    "check_worn",
    "fit_of",
]

Floats = NDArray[np.float64]
Faces = NDArray[np.int32]

_UNIT_RATIOS = sorted({ratio for unit in UNITS.values() for ratio in (unit, 1.0 / unit)} - {1.0})
_AXES = {
    "Y up": np.eye(3),
    "Z up": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),  # what faces -Y faces +Z then
}
_USUAL_HEIGHT = 1.7  # [m]
_SIZES = (0.12, 1.4)  # of a garment's longest side, over the body's height [-]
_SAMPLES = 3000  # points of a garment that are looked at
_DEEP = 0.01  # a point deeper in the body is more than the loader's push mends [m]
_MAX_DEEP_SHARE = 0.01  # of a garment's points that may be that deep [-]
_MAX_MEDIAN_GAP = 0.25  # of a worn garment, a wide dress included [m]
_MAX_CARRIED_GAP = 0.5  # from the nearest vertex that the body carries to the body [m]
_MAX_OPENING_GAP = 0.03  # from the middle of some opening of a worn garment to the body [m]


@dataclass(frozen=True)
class FilePlacement:
    """How the numbers of a file lie in the world.

    Attributes:
        unit: a key of UNITS.
        axes: which way is up in the file.
    """

    unit: str
    axes: str

    @property
    def matrix(self) -> Floats:
        """From the file's numbers to metres, Y up: shape (3, 3), acts on columns."""
        return UNITS[self.unit] * _AXES[self.axes]

    def __str__(self) -> str:
        return f"{self.unit}, {self.axes}"


AS_STORED = FilePlacement("metres", "Y up")


@dataclass(frozen=True)
class Fit:
    """How a garment lies on a body.

    Attributes:
        opening_gap: from the middle of the opening that is nearest to the body to the body, below 0 inside it [m].
        gap: least distance of the garment from the body, below 0 inside it [m].
        gap_p50: median distance [m].
        deep_share: part of its points that is more than 1 cm inside the body [-].
        inside_share: part of its points that is more than 1 mm inside [-].
    """

    opening_gap: float
    gap: float
    gap_p50: float
    deep_share: float
    inside_share: float

    @property
    def is_worn(self) -> bool:
        """Whether the garment is around the body and, but for what the loader pushes out, outside it."""
        return self.is_around and self.deep_share <= _MAX_DEEP_SHARE

    @property
    def is_around(self) -> bool:
        """Whether the body is in one of the garment's openings, and most of the garment near the body."""
        return self.opening_gap <= _MAX_OPENING_GAP and self.gap_p50 <= _MAX_MEDIAN_GAP


def body_placement(vertices: Floats) -> FilePlacement | None:
    """Unit and axes of a standing body, by its height: None where no unit makes a body of 0.7 to 2.6 m of it.

    A body is wider and taller than it is deep, so that the shorter of Y and Z is its depth.

    Args:
        vertices: in the file's unit, shape (n, 3).
    """
    size = np.ptp(vertices, axis=0)
    axes = "Z up" if size[2] > 1.2 * size[1] else "Y up"
    height = float(max(size[1], size[2]))
    fitting = [unit for unit, scale in UNITS.items() if HEIGHTS[0] <= scale * height <= HEIGHTS[1]]
    if not fitting:
        return None
    if fitting[0] == "metres":
        return FilePlacement("metres", axes)
    return FilePlacement(min(fitting, key=lambda unit: abs(np.log(UNITS[unit] * height / _USUAL_HEIGHT))), axes)


def fit_of(vertices: Floats, faces: Faces, body_vertices: Floats, body_faces: Faces) -> Fit:
    """How a garment lies on a body.

    Args:
        vertices: of the garment [m], shape (n, 3).
        faces: int, shape (m, 3).
        body_vertices: in the pose that the garment was made for [m], shape (b, 3).
        body_faces: counter-clockwise seen from outside, int, shape (k, 3).
    """
    return _fit(BodyDistance(body_faces), vertices, faces, body_vertices)


def check_worn(
    garment: Garment, carried: NDArray[np.int64], body_vertices: Floats, body_faces: Faces, key: str
) -> None:
    """Refuse a garment that its body cannot wear where the unit or the place of one of them must be wrong.

    A body that is no person's height, a ball or a post, passes unless it would wear the garment as a person: were it
    larger or smaller by the ratio of two units. So does a garment of another size than clothes have for the body.

    Args:
        garment: as the scene has it.
        carried: its vertices that the body carries.
        body_vertices: in the pose that the garment was made for [m], shape (b, 3).
        body_faces: int, shape (k, 3).
        key: of the garment in the scene, for the message.

    Raises:
        InputError: all that the body carries is over 0.5 m away from it, or another unit is what makes the two fit.
    """
    height, size = float(np.ptp(body_vertices[:, 1])), float(np.ptp(garment.vertices, axis=0).max())
    found = _other_unit(garment, body_vertices, body_faces, height, size)
    if found is not None:
        whose, ratio = found
        raise InputError(
            f"a {whose} of another unit",
            file=garment.source,
            key=key,
            received=f"a garment of {size:.3g} m and a body {height:.3g} m tall",
            expected=f"a {whose} {ratio:.4g} times as large: then the garment is worn",
        )
    gap = distances(garment.vertices[carried], body_vertices, body_faces).min() if len(carried) else 0.0
    if gap > _MAX_CARRIED_GAP:
        raise InputError(
            "a garment that is nowhere near the body that carries it",
            file=garment.source,
            key=key,
            received=f"{gap:.2f} m from a body {height:.3g} m tall",
            expected=f"at most {_MAX_CARRIED_GAP:g} m: both in one unit and one place",
        )


def _other_unit(
    garment: Garment, body_vertices: Floats, body_faces: Faces, height: float, size: float
) -> tuple[str, float] | None:
    """Which of the two is of another unit, and how many times as large it fits; None where no unit is known to fit."""
    low, high = (limit * height for limit in _SIZES)
    if not HEIGHTS[0] <= height <= HEIGHTS[1]:
        whose, length, low, high = "body", height, *HEIGHTS
    elif not low <= size <= high:
        whose, length = "garment", size
    else:
        return None
    distance = BodyDistance(body_faces)
    for ratio in _UNIT_RATIOS:
        if low <= ratio * length <= high:
            scales = (1.0, ratio) if whose == "body" else (ratio, 1.0)
            if _fit(distance, scales[0] * garment.vertices, garment.faces, scales[1] * body_vertices).is_worn:
                return whose, ratio
    return None


def _fit(distance: BodyDistance, vertices: Floats, faces: Faces, body_vertices: Floats) -> Fit:
    points = np.concatenate([vertices, vertices[faces].mean(axis=1)])
    points = points[:: 1 + len(points) // _SAMPLES]
    middles = np.array([vertices[loop].mean(axis=0) for loop in _openings(faces)] or [points.mean(axis=0)])
    gaps = distance.signed_distance(np.concatenate([points, middles]), body_vertices)
    own = gaps[: len(points)]
    return Fit(
        float(gaps[len(points) :].min()),
        float(own.min()),
        float(np.median(own)),
        float(np.mean(own < -_DEEP)),
        float(np.mean(own < -0.001)),
    )


def _openings(faces: Faces) -> list[NDArray[np.int32]]:
    """Boundary loops; none of a mesh that is not manifold, which the loader refuses later."""
    edges, side_edge = edges_of(faces)
    if np.bincount(side_edge.ravel(), minlength=len(edges)).max() > 2:
        return []
    try:
        return boundary_loops(faces)
    except ValueError:  # faces that are wound against one another: the loader turns them
        return []


def best_placement(
    vertices: Floats, faces: Faces, body_vertices: Floats, body_faces: Faces
) -> tuple[FilePlacement, Fit | None]:
    """The unit and the axes in which a garment is worn by a body.

    Args:
        vertices: of the garment, in the file's unit, shape (n, 3).
        faces: int, shape (m, 3).
        body_vertices: in the pose that the garment was made for [m], shape (b, 3).
        body_faces: counter-clockwise seen from outside, int, shape (k, 3).

    Returns:
        the first placement in which it is worn, or else the one in which it lies nearest, and its fit; no fit where no
        unit gives the size of a garment for that body.
    """
    distance, found = BodyDistance(body_faces), []
    for placement in _candidates(vertices, float(np.ptp(body_vertices[:, 1]))):
        fit = _fit(distance, vertices @ placement.matrix.T, faces, body_vertices)
        if fit.is_worn:
            return placement, fit
        found.append((placement, fit))
    if not found:
        return AS_STORED, None
    # As it is stored, if that could be: a garment that lies elsewhere looks the same in every other direction.
    return found[0] if found[0][0] == AS_STORED else min(found, key=lambda one: abs(one[1].gap_p50))


def _candidates(vertices: Floats, height: float) -> Iterator[FilePlacement]:
    size = float(np.ptp(vertices, axis=0).max())
    for unit, scale in UNITS.items():
        if _SIZES[0] * height <= scale * size <= _SIZES[1] * height:
            yield from (FilePlacement(unit, axes) for axes in _AXES)
