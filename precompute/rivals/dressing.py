"""What another engine is given of a garment: its mesh, its fabric, and the motion of its body, as plain arrays.

A rival runs in a process of its own, perhaps in another environment: this file needs NumPy alone.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

__all__ = ["Dressing"]


@dataclass(frozen=True)
class Dressing:
    """A garment on a moving body.

    Attributes:
        faces: of the garment, int32, shape (m, 3).
        flat: sides of each face in the pattern, the columns of a matrix [m], shape (m, 2, 2).
        edges: pairs of vertices, int, shape (e, 2); ``lengths``: at rest [m], shape (e,).
        mass: [kg], shape (n,).
        start: vertices at the first pose [m], shape (n, 3).
        rest: a smooth shape on the body with about the lengths of the pattern, for engines that take no pattern [m],
            shape (n, 3).
        held: vertices that the body carries, int, shape (p,); ``targets``: where to [m], shape (f + 1, p, 3).
        stitches: (v, a, b): v is sewn to a point between a and b, int, shape (s, 3).
        stitch_weights: where that point is, 0 at a and 1 at b, shape (s,).
        body_faces: int, shape (k, 3); ``body``: its vertices at each frame [m], float32, shape (f + 1, b, 3).
        fabric: numbers of :class:`pbd.Fabric` by name.
        dt: of a frame [s].
        self_collision: whether the cloth keeps off itself.
    """

    faces: np.ndarray
    flat: np.ndarray
    edges: np.ndarray
    lengths: np.ndarray
    mass: np.ndarray
    start: np.ndarray
    rest: np.ndarray
    held: np.ndarray
    targets: np.ndarray
    stitches: np.ndarray
    stitch_weights: np.ndarray
    body_faces: np.ndarray
    body: np.ndarray
    fabric: dict[str, float]
    dt: float
    self_collision: bool

    @property
    def frame_count(self) -> int:
        """Frames f after the first pose."""
        return len(self.body) - 1

    @property
    def edge(self) -> float:
        """Mean edge [m]."""
        return float(self.lengths.mean())

    def write(self, path: Path) -> None:
        """Write it as an ``.npz`` file."""
        known = asdict(self)
        plain = json.dumps({name: known.pop(name) for name in ("fabric", "dt", "self_collision")})
        with path.open("wb") as file:
            np.savez(file, plain=np.frombuffer(plain.encode(), np.uint8), **known)

    @staticmethod
    def read(path: Path) -> Dressing:
        """Read what :meth:`write` wrote."""
        with np.load(path) as file:
            plain = json.loads(file["plain"].tobytes())
            return Dressing(**plain, **{one.name: file[one.name] for one in fields(Dressing) if one.name not in plain})
