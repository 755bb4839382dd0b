"""The built-in scenes of `gube compare`: two whose answer is unique, two that fold chaotically.

Each is a sheet of squares that are cut along alternating diagonals, at any resolution. Between its vertices the sheet
is a cubic spline, so that every resolution is compared at the same points of the cloth.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from types import MappingProxyType

import numpy as np
from scipy.interpolate import make_interp_spline

from assets.fabrics import PRESETS
from pbd import ClothMesh, Colliders, InputError, Model, Plane, Sphere
from pbd.fabric import Fabric
from pbd.mesh import lattice_faces
from precompute.experiment.measures import FRAME_RATE
from precompute.experiment.sheets import hinge_factor, level, tilted, untethered

__all__ = ["SCENES", "CompareScene", "Sheet", "scene_of"]

FELT = Fabric(0.30, 4000.0, 4000.0, 0.2, 1500.0, 2.5e-3, 2.5e-3, friction=0.4)  # of the cantilever, 3 mm thick
TILT = 45.0  # of the swinging sheet at the start [deg]
BALL, TOP = 0.25, 0.6  # radius of the sphere and height of its top [m]
PLEATS, DEPTH = 3, 0.04  # of the curtain along its rail, and their amplitude at the start [m]
SHAKEN, PULSE = 0.08, 1.5  # amplitude [m] and frequency of the rail [Hz]
START_NOISE = 1e-4  # of the start of perturbed references, RMS [m]


@dataclass(frozen=True)
class Sheet:
    """A rectangle of squares.

    Attributes:
        xs, ys: lines of the lattice [m], ascending; vertices are numbered along y first.
    """

    xs: np.ndarray
    ys: np.ndarray

    @classmethod
    def of(cls, length: float, width: float, edges: int, clamped: bool = False) -> Sheet:
        """A sheet with so many edges along its length; with a row of squares before x = 0 for a clamp."""
        step = length / edges
        rows = max(2, round(width / step))
        xs = np.linspace(0.0, length, edges + 1)
        return cls(np.concatenate([[-step], xs]) if clamped else xs, np.linspace(0.0, width, rows + 1))

    @property
    def flat(self) -> np.ndarray:
        """Vertices in the plane [m], shape (n, 2)."""
        return np.stack(np.meshgrid(self.xs, self.ys, indexing="ij"), axis=-1).reshape(-1, 2)

    @property
    def faces(self) -> np.ndarray:
        """Counter-clockwise in the plane, int32, shape (m, 3)."""
        index = np.arange(len(self.xs) * len(self.ys)).reshape(len(self.xs), -1)
        return lattice_faces(index)

    def sampled(self, vertices: np.ndarray, other: Sheet) -> np.ndarray:
        """The spline through vertices at the vertices of another sheet.

        Args:
            vertices: [m], shape (f, n, 3).
            other: whose vertices lie on this sheet.

        Returns:
            [m], float64, shape (f, m, 3).
        """
        grid = np.asarray(vertices, float).reshape(-1, len(self.xs), len(self.ys), 3)
        along = make_interp_spline(self.xs, np.eye(len(self.xs)), min(3, len(self.xs) - 1))(other.xs)
        across = make_interp_spline(self.ys, np.eye(len(self.ys)), min(3, len(self.ys) - 1))(other.ys)
        return np.einsum("ai,fijc,bj->fabc", along, grid, across, optimize=True).reshape(len(grid), -1, 3)


def _still(t: float) -> np.ndarray:
    return np.zeros(3)  # a function by name, as other processes need it


@dataclass(frozen=True)
class CompareScene:
    """A sheet of cloth, what holds it and what it meets.

    Attributes:
        name: for the command line.
        title: what happens, for people.
        unique: whether its answer is: it is then judged by the distance to a converged reference, else by statistics.
        seconds: of motion.
        fabric: SI values.
        size: length and width [m].
        place: from the plane (x along the length, y across) into space [m], shapes (n, 2) and (n, 3).
        held: which vertices of the plane are held: bool, shape (n,).
        rail: where the held vertices have gone after a time [s] from their start: [m], shape (3,).
        colliders: makes what it meets.
        clamped: whether a row of squares before the length is held.
        edges: resolutions that are compared, along the length.
        samples: edges along the length of the sheet at whose vertices runs are compared.
        moment: when pictures are taken [s].
    """

    name: str
    title: str
    unique: bool
    seconds: float
    fabric: Fabric
    size: tuple[float, float]
    place: Callable[[np.ndarray], np.ndarray]
    held: Callable[[np.ndarray], np.ndarray]
    rail: Callable[[float], np.ndarray] = _still
    colliders: Callable[[], list[Plane | Sphere]] = list
    clamped: bool = False
    edges: tuple[int, ...] = (8, 16, 32)
    samples: int = 32
    moment: float = 1.0

    @property
    def frame_count(self) -> int:
        return round(self.seconds * FRAME_RATE)

    @property
    def driven(self) -> bool:
        """Whether its clamp moves."""
        return bool(np.any([self.rail(t) for t in (0.1, 0.37)]))

    def sheet(self, edges: int) -> Sheet:
        """The sheet with so many edges along its length."""
        return Sheet.of(*self.size, edges, self.clamped)

    def compared(self) -> Sheet:
        """The sheet at whose vertices all runs are compared: without the clamp."""
        return Sheet.of(*self.size, self.samples)

    def sampled(self, edges: int, frames: np.ndarray) -> np.ndarray:
        """Vertices of the sheet with so many edges [m], shape (f, n, 3), at those of the compared one."""
        return self.sheet(edges).sampled(frames, self.compared())

    def mesh(self, edges: int, seed: int = 0) -> ClothMesh:
        """The cloth at its start; a seed other than 0 moves what is free by a tenth of a millimetre at random."""
        sheet = self.sheet(edges)
        flat = sheet.flat
        vertices = self.place(flat)
        if seed:
            free = ~self.held(flat)
            vertices[free] += np.random.default_rng(seed).normal(
                0.0, START_NOISE / math.sqrt(3.0), (int(free.sum()), 3)
            )
        return ClothMesh.from_pattern(vertices, sheet.faces, flat[sheet.faces])

    def model(self, edges: int, seed: int = 0) -> Model:
        """Without tethers, which are no part of the fabric's physics."""
        mesh = self.mesh(edges, seed)
        held = np.flatnonzero(self.held(self.sheet(edges).flat))
        return untethered(mesh, self.fabric, held, bend_factor=_bend_factor())

    def scene_colliders(self) -> Colliders:
        """New ones each time: colliders remember where they were."""
        return Colliders(self.colliders())


@cache
def _bend_factor() -> float:
    """Hinge factor of this kind of mesh, measured once on a large sheet."""
    sheet = Sheet.of(1.0, 1.0, 30)
    return hinge_factor(sheet.flat, sheet.faces)


def _hanging(flat: np.ndarray) -> np.ndarray:
    """Tilted about its upper side, x from there on."""
    return tilted(flat[:, 1], -flat[:, 0], TILT)


def _above_ball(flat: np.ndarray) -> np.ndarray:
    """Level, 1 cm over the sphere and not quite in its middle."""
    return np.stack([flat[:, 0] - 0.47, np.full(len(flat), TOP + 0.01), 0.52 - flat[:, 1]], axis=1)


def _pleated(flat: np.ndarray) -> np.ndarray:
    """Upright, x downwards, pleated across by a sine whose length is the sheet's width."""
    turns = 2.0 * math.pi * PLEATS
    fine = np.linspace(0.0, 1.0, 2001)
    slope = turns * DEPTH * np.cos(turns * fine)
    # The width of the rail that leaves the sine as long as the cloth is wide.
    low, high = 0.05, 1.0
    for _ in range(50):
        width = 0.5 * (low + high)
        low, high = (width, high) if np.hypot(slope, width).mean() < 1.0 else (low, width)
    arc = np.concatenate([[0.0], np.cumsum(0.5 * (np.hypot(slope, width)[1:] + np.hypot(slope, width)[:-1]))])
    share = np.interp(flat[:, 1], arc / arc[-1], fine)
    return np.stack([width * share, -flat[:, 0], DEPTH * np.sin(turns * share)], axis=1)


def _upper(flat: np.ndarray) -> np.ndarray:
    return flat[:, 0] < 1e-9


def _nothing(flat: np.ndarray) -> np.ndarray:
    return np.zeros(len(flat), bool)


def _shaken(t: float) -> np.ndarray:
    """To and fro along the rail, from rest."""
    return np.array([0.0, 0.0, SHAKEN * math.sin(2.0 * math.pi * PULSE * t) * min(1.0, 2.0 * t)])


def _ball() -> list[Plane | Sphere]:
    return [Sphere((0.0, TOP - BALL, 0.0), BALL)]


_COTTON = PRESETS["cotton"]
_ALL = (
    CompareScene(
        "swing", "a sheet tilted by 45 deg swings from its upper side", True, 1.5, _COTTON, (1.0, 0.5), _hanging, _upper
    ),
    CompareScene(
        "cantilever", "a strip of felt clamped level is let go", True, 1.0, FELT, (0.3, 0.1), level, _upper,
        clamped=True, edges=(6, 12, 24), samples=24, moment=0.5,
    ),
    CompareScene(
        "drape", "a sheet falls on a sphere with friction", False, 1.5, _COTTON, (1.0, 1.0), _above_ball, _nothing,
        colliders=_ball, moment=1.2,
    ),
    CompareScene(
        "curtain", "a pleated curtain is shaken", False, 1.5, PRESETS["silk"], (1.0, 1.0), _pleated, _upper,
        rail=_shaken, moment=1.2,
    ),
)  # fmt: skip
SCENES = MappingProxyType({scene.name: scene for scene in _ALL})


def scene_of(name: str, seconds: float | None = None) -> CompareScene:
    """A built-in scene.

    Args:
        name: key of ``SCENES``.
        seconds: cut the motion there.

    Raises:
        InputError: no such scene.
    """
    if name not in SCENES:
        expected = f"{', '.join(SCENES)}, or a database (.h5)"
        raise InputError("no such scene", key="SCENE", received=name, expected=expected)
    scene = SCENES[name]
    if seconds is None:
        return scene
    return replace(scene, seconds=seconds, moment=min(scene.moment, seconds))
