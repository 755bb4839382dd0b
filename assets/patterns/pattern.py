"""A sewing pattern: flat panels, the seams that join their edges, and the bands that finish them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Band", "EdgeName", "Panel", "Pattern", "Placement", "Seam", "edge_length"]

Floats = NDArray[np.float64]


class EdgeName(NamedTuple):
    """An edge of a pattern.

    Attributes:
        panel: name of the panel.
        edge: number of the edge in the panel's outline, from 0.
    """

    panel: str
    edge: int


@dataclass(frozen=True, eq=False)
class Placement:
    """Where a panel stands around the body before it is sewn.

    A point (x, y) of the panel goes to ``rotation @ (x, y, 0) + translation``. With a bend radius R the panel is rolled
    around an axis parallel to its own y axis first: (x, y) becomes (R sin(x / R), y, R cos(x / R) - R), so that the
    line x = 0 stays where it is and both sides go back, away from the panel's outer side.

    Attributes:
        rotation: shape (3, 3). Its third column is where the outer side of the cloth looks at x = 0.
        translation: [m], shape (3,).
        bend_radius: R [m]; negative rolls the sides forward, None leaves the panel flat.
        bow: how far the lines of equal y are moved afterwards, so that a sleeve follows a bent arm: rows of y and the
            move in space [m], by growing y, linear in between, shape (k, 4); None for none.
    """

    rotation: Floats
    translation: Floats
    bend_radius: float | None = None
    bow: Floats | None = None

    def moves(self, y: Floats) -> Floats:
        """Moves of lines of equal y [m], shape (n, 3); see bow."""
        if self.bow is None:
            return np.zeros((len(y), 3))
        return np.stack([np.interp(y, self.bow[:, 0], self.bow[:, k]) for k in (1, 2, 3)], axis=1)

    def moved(self, rotation: Floats, translation: Floats) -> Placement:
        """The placement in a space that was turned, shape (3, 3), and then moved [m], shape (3,)."""
        bow = None if self.bow is None else np.column_stack([self.bow[:, 0], self.bow[:, 1:] @ rotation.T])
        return Placement(rotation @ self.rotation, rotation @ self.translation + translation, self.bend_radius, bow)

    def apply(self, flat: Floats) -> Floats:
        """Points of the panel [m], shape (n, 2), in space [m], shape (n, 3)."""
        x, y = np.asarray(flat, float).T
        if self.bend_radius is None:
            local = np.stack([x, y, np.zeros_like(x)], axis=1)
        else:
            angle = x / self.bend_radius
            local = np.stack(
                [self.bend_radius * np.sin(angle), y, self.bend_radius * (np.cos(angle) - 1.0)],
                axis=1,
            )
        return local @ self.rotation.T + self.translation + self.moves(y)


@dataclass(frozen=True, eq=False)
class Panel:
    """A flat piece of cloth.

    Attributes:
        name: unique in its pattern.
        edges: the outline, counter-clockwise seen from the outer side of the garment: polylines [m], each of shape
            (k, 2) with k >= 2, each from the last point of the one before it to the first of the one after it. Curves
            are polylines whose points lie close together; only the ends of an edge are corners.
        grain: unit direction of the warp in the panel, shape (2,).
        placement: where the panel stands before it is sewn; None if the file does not say.
    """

    name: str
    edges: tuple[Floats, ...]
    grain: Floats
    placement: Placement | None = None

    @property
    def outline(self) -> Floats:
        """All points of the outline in order, none of them twice [m], shape (n, 2)."""
        return np.concatenate([edge[:-1] for edge in self.edges])


class Seam(NamedTuple):
    """Two edges that are sewn together over their whole lengths; the longer one is gathered evenly.

    Attributes:
        first, second: the edges. Both may belong to one panel (a dart, a pleat, a tube).
        reversed: whether the first point of one edge meets the last of the other. This is so for panels that are both
            seen from their outer side.
    """

    first: EdgeName
    second: EdgeName
    reversed: bool = True


class Band(NamedTuple):
    """A strip along an edge with more than one layer of cloth: a hem, a waistband, a cuff, an elastic.

    Attributes:
        edge: the edge along which it lies.
        width: [m].
        layers: of cloth in the strip, at least 1 [-].
        length_ratio: rest length along the edge over its length as cut [-]; below 1 for an elastic.
    """

    edge: EdgeName
    width: float
    layers: float = 2.0
    length_ratio: float = 1.0


@dataclass(frozen=True, eq=False)
class Pattern:
    """A garment as it is cut.

    Attributes:
        name: for messages.
        panels: in any order.
        seams: in any order; an edge belongs to one seam at most.
        bands: in any order.
        source: the file or the draft that it came from.
    """

    name: str
    panels: tuple[Panel, ...]
    seams: tuple[Seam, ...]
    bands: tuple[Band, ...]
    source: str

    def panel(self, name: str) -> Panel:
        """The panel of a name.

        Raises:
            KeyError: there is none.
        """
        return {panel.name: panel for panel in self.panels}[name]

    def edge(self, name: EdgeName) -> Floats:
        """The polyline of an edge [m], shape (k, 2)."""
        return self.panel(name.panel).edges[name.edge]


def edge_length(points: Floats) -> float:
    """Length of a polyline [m]; points of shape (k, 2)."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
