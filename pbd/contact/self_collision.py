"""Cloth against itself, and one layer against another: pairs of features that may meet in a frame.

A pair is a vertex and a face, or two edges. Pairs are found once a frame, by boxes around patches of faces in a tree
that never changes. Patches that share an edge and are flat enough cannot touch one another and are left out (Volino
and Magnenat-Thalmann 1994). Each feature belongs to one face, so that no pair is found twice (Curtis, Tamstorf,
Manocha 2008). Within the frame a pair remembers the direction from one feature to the other and turns it along with
them. So a feature that has gone through the other differs from one that has gone around it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pbd.contact.impacts import Impacts
from pbd.contact.pair_search import find_pairs
from pbd.contact.pair_sides import DEEP_SLACK, SLACK, turning_kernel
from pbd.contact.pairs import PULL
from pbd.contact.patch_tree import search_memory, search_tree
from pbd.contact.strain_limits import strain_limits
from pbd.contact.untangling import Untangling
from pbd.crossings import seams_of
from pbd.model import Model
from pbd.state import State
from pbd.taichi_internals import Launch

__all__ = ["SelfCollision"]

MAX_RELATIVE_MOTION = 0.01  # of the features of a pair against each other between two searches [m]
SEARCHED = ("position", "velocity", "pairs", "pair_sides")  # of a state: what a search depends on
# Pairs for each vertex at most, and of the garment in any case: cloth that has more goes to and fro by its own size.
MOST_PAIRS, LEAST_PAIRS = 200, 100_000


def same_bits(kept: list[np.ndarray], state: State) -> bool:
    """Whether a state is that of a search; ``kept``: its arrays then."""
    return all(np.array_equal(one, getattr(state, name)) for one, name in zip(kept, SEARCHED, strict=True))


class SelfCollision:
    """The pairs of one model, found anew every frame.

    Args:
        model: the garment, or several layers of garments.
        within: whether pairs of one layer are wanted, and cloth that is through itself is found and pulled back. Else
            pairs of two layers alone are found, at a fraction of the cost.

    Attributes:
        pairs: (vertex, corners of a face), or (a, -b - 1, c, d) for the edges a-b and c-d, int32, shape (c, 4).
        data: see :func:`pbd.contact.pairs.solve_pairs`, float32, shape (c, 2, 4).
        ready: how many of them there are, how many are ready, and which, int32, shape (c + 2,).
        impacts: what keeps faces from going through one another in a motion; None where crossings are not looked for.
        crossings: at the start of the frame the edges that go through faces: their two ends, and the face as
            :attr:`pbd.contact.impacts.Impacts.grid` counts them, int64, shape (k, 3).
        overfull: whether the last search found far too many pairs, and so kept none.
        strain_limits, limit_work: see :func:`pbd.contact.strain_limits.limit_rows`.
    """

    def __init__(self, model: Model, within: bool = True) -> None:
        mesh, count = model.mesh, len(model.mesh.vertices)
        tree = search_tree(mesh, model.layer)
        faces = tree["faces"]
        self._layer = model.layer
        self._chain = np.zeros(count, np.int32)
        self._max_displacement = np.zeros(1, np.float32)
        # Arguments of the search that stay the same arrays.
        self._fixed = {
            **tree,
            **search_memory(tree),
            "layer": self._layer,
            "max_displacement": self._max_displacement,
            "within": int(within),
            "most": max(MOST_PAIRS * count, LEAST_PAIRS),
            "longest": float(np.linalg.norm(np.diff(tree["rest"][tree["edges"]], axis=1), axis=2).max()),
        }
        self._untangling, self._untangles = Untangling(faces, self._layer, mesh.vertex_areas), within
        self._no_crossings = np.zeros((1, 3), np.int32)
        self.impacts = Impacts(faces, count, seams_of(model.stitches, count)) if within else None
        self.crossings = np.zeros((0, 3), np.int64)
        self._find, self._turn_sides = Launch(find_pairs), Launch(turning_kernel())
        self.overfull = False
        self._ahead = 1.0  # how far the last search looked [s]
        self._looked: tuple[dict[str, Any], float] | None = None  # the search that look_ahead made, and its time
        self._seen = [np.zeros(0)] * len(SEARCHED)  # and what the state was then
        self._pulls: tuple[np.ndarray, np.ndarray] | None = None
        self.strain_limits, self.limit_work = strain_limits(mesh, model.fabric.thickness, model.held)
        self._make_room(2 * count)

    def _make_room(self, count: int) -> None:
        self.pairs = np.zeros((count, 4), np.int32)
        self.data = np.zeros((count, 2, 4), np.float32)
        self.ready = np.zeros(count + 2, np.int32)
        self._pair_faces = np.zeros((count, 2), np.int32)

    def arrays(self) -> dict[str, np.ndarray]:
        """Its arguments of :func:`pbd.xpbd.advance.advance_kernel` by their names."""
        return {
            "pairs": self.pairs,
            "pair_data": self.data,
            "ready_pairs": self.ready,
            "strain_limits": self.strain_limits,
            "limit_work": self.limit_work,
        }

    def find(self, state: State, h: float, steps: int, thickness: float, done: int = 0) -> int:
        """Find the pairs that may touch in substeps.

        Args:
            state: of the garment.
            h: substep [s].
            steps: substeps to look ahead.
            thickness: kept between features [m].
            done: substeps of the frame that are behind. At its start all pairs are found; later those alone of cloth
                that has moved otherwise than it seemed to, or that is through itself.

        Returns:
            For how many substeps the pairs are good, at least 1.
        """
        untangling, first = self._untangling, done == 0
        # Cloth that is through itself is looked for at the frame's start, and again while any was found.
        untangles = self._untangles and (first or self._pulls is not None)
        if first and self._looked is not None and self._looked[1] == h * steps and same_bits(self._seen, state):
            arguments = self._looked[0]
        else:
            arguments = self._search(state, first, done * h, h * steps, thickness, untangles)
        self._looked = None
        rows = untangling.rows()
        if first:
            self.crossings = rows if self.impacts is None else self.impacts.grid.unjoined(rows)
        if untangles:
            self._pulls = None
        if untangles and len(rows):
            free = (state.contact > 2.0 * thickness) | (state.nearest[: len(state.contact)] < 0)
            self._pulls = untangling.pulls(state.position[:, :3], free)
            if self._pulls is not None:
                damped = untangling.damp_relative_velocity(state.velocity)
                self._turn_sides.by_name(arguments | {"damped": damped})
        if self._pulls is not None:
            self._append(*self._pulls)
        return self._good_for(steps)

    def look_ahead(self, state: State, h: float, steps: int, thickness: float) -> np.ndarray:
        """Make the search of the next frame, which takes it if neither the state nor the frame time changes until then.

        Args:
            state: of the garment at the end of a frame.
            h: substep of the next frame [s].
            steps: substeps that it has.
            thickness: kept between features [m].

        Returns:
            the crossings that there are now: see :attr:`crossings`.
        """
        assert self.impacts is not None
        arguments = self._search(state, True, 0.0, h * steps, thickness, True)
        for number, name in enumerate(SEARCHED):
            now = getattr(state, name)
            if self._seen[number].shape != now.shape:
                self._seen[number] = np.zeros_like(now)
            self._seen[number][:] = now
        self._looked = arguments, h * steps
        # The search leaves out faces with a common vertex that face one way. Where cloth is crumpled, they may cross.
        grid = self.impacts.grid
        return np.concatenate([grid.unjoined(self._untangling.rows()), grid.fan_crossings(state.position)])

    def around(self, rows: np.ndarray, times: int = 1) -> np.ndarray:
        """Vertices near crossings (``rows``, see :attr:`crossings`): of :meth:`Untangling.around`."""
        if not len(rows):
            return np.zeros(len(self._layer), bool)
        return self._untangling.around(rows, times)

    def spread(self, vertices: np.ndarray) -> np.ndarray:
        """Vertices a few edges from some at most (their numbers), as a mask."""
        return self._untangling.spread(vertices)

    def _good_for(self, steps: int) -> int:
        return max(1, int(steps * min(1.0, MAX_RELATIVE_MOTION / max(float(self._max_displacement[0]), 1e-9))))

    def _search(
        self, state: State, anew: bool, elapsed: float, dt: float, thickness: float, crossings: bool
    ) -> dict[str, Any]:
        """Find the pairs of the next dt [s], and crossings or not, with larger buffers until they take all.

        Where there are far too many pairs, none are found, and no crossings.

        Returns:
            the arguments of the search.
        """
        if len(self._chain) < len(self._layer) + len(state.pairs):
            self._chain = np.zeros(len(self._layer) + 2 * len(state.pairs), np.int32)
        while True:
            arguments = self._fixed | {
                "position": state.position,
                "velocity": state.velocity,
                "wrong_side": self._untangling.wrong_side,
                "old_pairs": state.pairs,
                "old_normals": state.pair_sides,
                "chain": self._chain,
                "pairs": self.pairs,
                "pair_data": self.data,
                "pair_faces": self._pair_faces,
                "ready_pairs": self.ready,
                "crossed": self._untangling.crossed if crossings else self._no_crossings,
                "anew": int(anew),
                "elapsed": elapsed,
                "dt": dt,
                "share": dt / self._ahead,
                "thickness": thickness,
                "tangled": int(self._pulls is not None),
                "slack": SLACK if self._pulls is None and not self._layer.any() else DEEP_SLACK,
            }
            self._find.by_name(arguments)
            self.overfull = int(self.ready[0]) > self._fixed["most"]
            if self.overfull:
                self.ready[0] = self._untangling.crossed[0, 0] = 0
                return arguments
            if self.ready[0] > len(self.pairs):  # pairs found before are lost with the buffers
                anew = True
                self._make_room(int(self.ready[0]) * 3 // 2)
            elif not crossings or self._untangling.has_room():
                self._ahead = dt
                return arguments

    def _append(self, pairs: np.ndarray, data: np.ndarray) -> None:
        """Add pairs that were not searched for."""
        old = int(self.ready[0])
        count = old + len(pairs)
        if count > len(self.pairs):
            known = self.pairs[:old], self.data[:old], self._pair_faces[:old]
            self._make_room(count * 3 // 2)
            self.pairs[:old], self.data[:old], self._pair_faces[:old] = known
        self.pairs[old:count], self.data[old:count], self._pair_faces[old:count] = pairs, data, -1
        self.ready[0] = count

    def remember(self, state: State) -> None:
        """Keep in the state the pairs that touch at the end of the frame, with their directions.

        A pull knows better than a pair of its vertex and face that would keep them where they are.
        """
        count = self.ready[0]
        data = self.data[:count]
        touching = (data[:, 1, 0] < data[:, 0, 3]) & (data[:, 1, 1] != PULL)
        if self._pulls is not None:
            touching &= ~self._opposed(state.position[:, :3], self.pairs[:count], data)
        state.pairs = np.ascontiguousarray(self.pairs[:count][touching])
        state.pair_sides = np.concatenate([self.data[:count, 0, :3], self.data[:count, 1, :1]], axis=1)[touching]

    def _opposed(self, position: np.ndarray, pairs: np.ndarray, data: np.ndarray) -> np.ndarray:
        """Pairs that push a vertex to the side of a face from which a pull brings it back: bool, shape (c,)."""
        pulls = np.flatnonzero(data[:, 1, 1] == PULL)
        if not len(pulls):
            return np.zeros(len(pairs), bool)
        a, b, c = position[pairs[pulls, 1:].T]
        back = data[pulls, 1, 3, None] * np.cross(b - a, c - a)
        keys = np.ascontiguousarray(pairs).view([("", np.int32)] * 4)[:, 0]
        order = np.argsort(keys[pulls])
        place = np.searchsorted(keys[pulls], keys, sorter=order)
        found = order[np.minimum(place, len(pulls) - 1)]
        return (keys[pulls][found] == keys) & ((data[:, 0, :3] * back[found]).sum(axis=1) < 0.0)
