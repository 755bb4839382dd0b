"""The six maps of `gube stability`: what is varied along each axis, and the small scene of every cell."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache

import numpy as np

from pbd import Capsule, ClothMesh, Fabric, InputError, Model
from pbd.mesh import lattice_faces
from precompute.experiment.sheets import hinge_factor, lattice, level, tilted, untethered

__all__ = ["MAPS", "Axis", "CellScene", "StabilityMap", "chosen_cell", "lattice_model"]

POINTS = 12  # of an axis
EDGES = 16  # along the cloth, where they are not what is varied
DENSITY = 0.15  # [kg/m2]
STIFFNESS, BEND = 2000.0, 1e-5  # E h [N/m] and B [N m], where they are not what is varied
FRAME = 1.0 / 60.0  # [s], where it is not what is varied
TILT = 30.0  # of hanging cloth from the vertical at the start [deg]
NOISE = 1e-2  # out of the plane of cloth that starts compressed, over an edge [-]


@dataclass(frozen=True)
class Axis:
    """What is varied.

    Attributes:
        label: name and unit.
        values: the default map's, rising.
        log: whether they are drawn, and bisected, on a logarithmic scale.
    """

    label: str
    values: tuple[float, ...]
    log: bool = True

    def between(self, low: float, high: float) -> float:
        """The middle of two values."""
        return math.sqrt(low * high) if self.log else 0.5 * (low + high)


@dataclass(frozen=True)
class CellScene:
    """A piece of cloth that is let go, with what drives it.

    Attributes:
        model: the cloth, without tethers.
        start: where it starts [m], shape (n, 3).
        dt: a frame [s].
        passes: iterations a frame; None where they are not what is varied.
        speed: of what holds the cloth and of what it touches, along x from the first frame on [m/s].
        post: upright capsule that moves with it, or None.
        rings: closed loops of vertices around the post, int, shape (r, k).
    """

    model: Model
    start: np.ndarray
    dt: float = FRAME
    passes: int | None = None
    speed: float = 0.0
    post: Capsule | None = None
    rings: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), int))


@dataclass(frozen=True)
class StabilityMap:
    """One map.

    Attributes:
        name: in ``--cell``.
        title: for people.
        x, y: its axes; the border is looked for along y.
        scene: of a cell, by x, y and the lattice that the method needs, "triangles" or "squares".
        column: whether y changes nothing but the time step or the passes, so that one reference serves a column.
    """

    name: str
    title: str
    x: Axis
    y: Axis
    scene: Callable[[float, float, str], CellScene] = field(repr=False)
    column: bool = True


@dataclass(frozen=True)
class _Weighted(ClothMesh):
    """Cloth with things sewn to it: areas, which only masses are made of, are multiplied."""

    weights: np.ndarray = field(default_factory=lambda: np.ones(1))

    @property
    def vertex_areas(self) -> np.ndarray:
        return super().vertex_areas * self.weights


def _flat(length: float, width: float, edges: int, kind: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places across and down [m], faces, and the rows of vertices, the upper one first, shape (r, k)."""
    d = length / edges
    down = d if kind == "squares" else d * math.sqrt(0.75)
    index, i, j = lattice(round(length / down) + 1, max(2, round(width / d)) + 1)
    shift = 0.0 if kind == "squares" else 0.5 * (i % 2)
    return np.stack([d * (j + shift), -down * i], axis=-1), _faces(index, kind), index


def _faces(index: np.ndarray, kind: str) -> np.ndarray:
    """Triangles between rows of vertices; every other row of equilateral ones is moved by half an edge."""
    straight = lattice_faces(index, alternating=False)
    if kind == "squares":
        return straight
    a, b, c, d = (part.reshape(-1) for part in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]))
    leaning = np.stack([a, c, b, b, c, d], axis=1).reshape(-1, 2, 3)
    even = np.repeat(np.arange(len(index) - 1) % 2 == 0, index.shape[1] - 1)
    return np.where(even[:, None, None], leaning, straight.reshape(-1, 2, 3)).reshape(-1, 3)


@cache
def _bend_factor(kind: str) -> float:
    """Hinge factor of the lattice, measured once on a large sheet."""
    return hinge_factor(*_flat(1.0, 1.0, 30, kind)[:2])


def _fabric(stiffness: float = STIFFNESS, bend: float = BEND) -> Fabric:
    """Isotropic, with the Poisson ratio of a lattice of springs, without air."""
    return Fabric(DENSITY, stiffness, stiffness, 1 / 3, 0.375 * stiffness, bend, bend, air_drag=0.0)


@lru_cache(maxsize=4)
def lattice_model(
    length: float,
    width: float,
    edges: int,
    kind: str,
    fabric: Fabric,
    held_rows: int = 1,
    *,
    heavy: float = 1.0,
) -> tuple[Model, np.ndarray]:
    """Cloth on a regular lattice, held by its upper rows.

    Args:
        length, width: down and across [m].
        edges: along the length.
        kind: "triangles" (equilateral) or "squares".
        fabric: SI values.
        held_rows: how many, 0 for none.
        heavy: factor on the masses of the lowest row.

    Returns:
        The model without tethers, and the rows of its vertices, the upper one first.
    """
    flat, faces, index = _flat(length, width, edges, kind)
    mesh = ClothMesh.from_pattern(np.insert(flat, 2, 0.0, axis=1), faces, flat[faces])
    if heavy != 1.0:
        weights = np.ones(len(flat))
        weights[index[-1]] = heavy
        mesh = _Weighted(mesh.vertices, mesh.faces, mesh.flat, weights=weights)
    return untethered(mesh, fabric, index[:held_rows].ravel(), bend_factor=_bend_factor(kind)), index


def _hanging(width: float, edges: int, kind: str, fabric: Fabric, dt: float, *, heavy: float = 1.0) -> CellScene:
    """Cloth of 1 m tilted about its upper side."""
    model, _ = lattice_model(1.0, width, edges, kind, fabric, heavy=heavy)
    x, y, _ = model.mesh.vertices.T
    return CellScene(model, tilted(x, y, TILT), dt)


def _by_stiffness(x: float, y: float, kind: str) -> CellScene:
    return _hanging(1.0, EDGES, kind, _fabric(stiffness=x), y)


def _by_resolution(x: float, y: float, kind: str) -> CellScene:
    return _hanging(0.125, round(x), kind, _fabric(), y)


def _by_bending(x: float, y: float, kind: str) -> CellScene:
    """A square of 30 cm clamped level falls."""
    model, _ = lattice_model(0.3, 0.3, EDGES, kind, _fabric(bend=x), held_rows=2)
    return CellScene(model, level(model.mesh.vertices), y)


def _by_mass(x: float, y: float, kind: str) -> CellScene:
    """A strip swings with its lowest row x times as heavy."""
    scene = _hanging(0.25, EDGES, kind, _fabric(stiffness=1e5), FRAME, heavy=x)
    return replace(scene, passes=max(1, round(y)))


def _by_collider(x: float, y: float, kind: str) -> CellScene:
    """A skirt around a post that dashes off, held at its waist."""
    height, radius, gap, around = 0.4, 0.15, 0.02, 24
    d = 2.0 * radius * math.sin(math.pi / around)
    down = d if kind == "squares" else d * math.sqrt(0.75)
    index, i, j = lattice(round(height / down) + 1, around)
    turn = (2.0 * math.pi / around) * (j + (0.0 if kind == "squares" else 0.5 * (i % 2)))
    vertices = np.stack([radius * np.cos(turn), -down * i, radius * np.sin(turn)], axis=1)
    mesh = ClothMesh.from_surface(vertices, _faces(np.concatenate([index, index[:, :1]], axis=1), kind))
    post = Capsule((0.0, 1.0, 0.0), (0.0, -2.0, 0.0), radius - gap)
    model = untethered(mesh, _fabric(), index[0], bend_factor=_bend_factor(kind))
    return CellScene(model, vertices, y, speed=x, post=post, rings=index)


def _by_compression(x: float, y: float, kind: str) -> CellScene:
    """A square hung by its side, pushed together in its plane in both directions by x percent."""
    model, _ = lattice_model(0.5, 0.5, EDGES, kind, _fabric(bend=y))
    start = model.mesh.vertices * (1.0 - 0.01 * x)
    start[:, 2] = np.random.default_rng(0).normal(0.0, NOISE * 0.5 / EDGES, len(start))
    start[model.held, 2] = 0.0
    return CellScene(model, start)


def _rising(low: float, high: float, spaced: Callable = np.geomspace) -> tuple[float, ...]:
    return tuple(float(f"{value:.6g}") for value in spaced(low, high, POINTS))


_STEP = Axis("time step [s]", _rising(1 / 240, 1 / 10))
_EDGES = Axis("edges along 1 m", tuple(float(round(v)) for v in np.geomspace(16, 128, POINTS)))
_BENDING = Axis("bending stiffness B [N m]", _rising(1e-7, 1e-3))
_HEAVY = Axis("mass of the lowest row over the others [-]", _rising(1.0, 1e4))
_PASSES = Axis("iterations a frame of 1/60 s", (1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0))
_SPEED = Axis("speed [m/s]", _rising(0.0, 50.0, np.linspace), log=False)
_SHORT = Axis("initial compression [%]", _rising(0.0, 90.0, np.linspace), log=False)
MAPS: tuple[StabilityMap, ...] = (
    StabilityMap("stiffness", "Time step and membrane stiffness", Axis("E h [N/m]", _rising(1.0, 1e6)), _STEP,
                 _by_stiffness),
    StabilityMap("resolution", "Time step and resolution", _EDGES, _STEP, _by_resolution),
    StabilityMap("bending", "Time step and bending stiffness", _BENDING, _STEP, _by_bending),
    StabilityMap("mass", "Mass ratio and iterations", _HEAVY, _PASSES, _by_mass),
    StabilityMap("collider", "Collider speed and time step", _SPEED, _STEP, _by_collider),
    StabilityMap("compression", "Initial compression and bending stiffness", _SHORT, _BENDING, _by_compression,
                 column=False),
)  # fmt: skip


def chosen_cell(text: str) -> tuple[StabilityMap, float, float]:
    """Map, x and y from "map:x:y".

    Raises:
        InputError: no such map, no numbers, or numbers outside the map.
    """
    name, *words = text.split(":")
    one = next((one for one in MAPS if one.name == name), None)
    if one is None:
        raise InputError("no such map", key="--cell", received=name, expected=", ".join(one.name for one in MAPS))
    try:
        x, y = (float(word) for word in words)
    except ValueError:
        x = y = math.nan
    (left, right), top = (one.x.values[0], one.x.values[-1]), one.y.values[-1]
    if not (left <= x <= right and 0.0 < y <= top):
        expected = f"{name}:X:Y, X from {left:g} to {right:g} ({one.x.label}), Y above 0 to {top:g} ({one.y.label})"
        raise InputError("no such cell", key="--cell", received=text, expected=expected)
    return one, x, y
