"""Cloth that touches itself: a frame of it is advanced so that it does not go through itself on the way."""

from __future__ import annotations

from typing import Any

import numpy as np

from pbd.contact.self_collision import SelfCollision
from pbd.model import Model
from pbd.state import State
from pbd.taichi_internals import Launch
from pbd.xpbd.kernel_arguments import load_friction
from pbd.xpbd.views import FrameSteps

__all__ = ["CollisionHandling"]

UNTANGLED = 4  # times the few edges around crossings, where curves of crossings may move while they are untangled
MAX_MEND = 0.004  # correction of a vertex over a whole frame by which impacts are kept from happening [m]
# Of edges where colliding cloth is watched from a frame's start: cloth that is pinched needs room [-].
MAX_STRETCH = 1.6
MAX_REPEATS = 6  # of a frame in which cloth went through itself


class CollisionHandling:
    """Advances the garment of one model with contact between its own parts.

    Args:
        model: the garment.
        pairs: finds the pairs of features that may touch, and the crossings.
        advance: launches the kernel of :func:`pbd.xpbd.advance.advance_kernel`.
        steps: the kernel's argument of this name: substeps of the frame, int32; it is written.

    Attributes:
        pairs: finds the pairs of features that may touch, and the crossings.
    """

    def __init__(self, model: Model, pairs: SelfCollision, advance: Launch, steps: np.ndarray) -> None:
        self.model, self.pairs = model, pairs
        self._advance, self._steps = advance, steps
        self._edges = model.mesh.edge_lengths()
        self._before: State | None = None  # workspace: the state at the start of a frame

    def advance(self, state: State, arguments: dict[str, Any], dt: float) -> None:
        """Advance the state so that cloth that was free of crossings is free of them.

        Where it would not be, the frame is done again, and impacts are kept from happening there in each substep. They
        are from the start where cloth collided in the last frame.
        """
        pairs = self.pairs
        steps = FrameSteps(*self._steps.tolist())
        if pairs.impacts is None:
            self._advance_with_pairs(state, arguments, dt, steps)
            return
        self._before = before = self._before or state.copy()
        before.restore(state)
        corners = pairs.impacts.grid.faces
        watched = before.colliding > 0  # what collided in the last frame is likely to collide in this one
        moved = np.zeros_like(watched)
        if watched.any():
            faces = np.flatnonzero(watched[corners].any(axis=1)).astype(np.int32)
            moved = self._advance_by_impacts(state, arguments, dt, steps, faces, steps.refresh)
        if not watched.any() or len(pairs.crossings):  # something else has moved it since
            state.restore(before)
            load_friction(self.model, state, arguments)
            self._advance_with_pairs(state, arguments, dt, steps)
            watched[:] = moved[:] = False
        known = pairs.around(pairs.crossings, UNTANGLED)  # untangling brings these apart
        repeats = 1 if known.any() else MAX_REPEATS  # cloth that is through itself brings forth new crossings
        for repeat in range(repeats):
            if not np.isfinite(state.position).all():
                break
            rows = pairs.look_ahead(state, dt / steps.count, steps.count, self.model.fabric.thickness)
            if len(rows):
                rows = rows[~known[rows[:, 0]]]
            if pairs.overfull or not len(rows):
                break
            if repeat == 0:  # the search leaves some out
                left_out = pairs.impacts.grid.crossings(before.position[:, :3].astype(float))
                known |= pairs.around(left_out, UNTANGLED)
                rows = rows[~known[rows[:, 0]]]
                if not len(rows):
                    break
            added = pairs.around(rows) & ~watched
            everywhere = 0 < repeat == repeats - 1 or (repeat > 1 and not added.any())
            if everywhere and watched.all():  # it would come out the same
                break
            watched |= added | everywhere
            faces = np.flatnonzero((watched & ~known)[corners].any(axis=1)).astype(np.int32)
            if repeat == 0 and self._mend(state, before.position[:, :3].astype(float), faces, dt, len(pairs.crossings)):
                break
            state.restore(before)
            load_friction(self.model, state, arguments)
            moved = self._advance_by_impacts(state, arguments, dt, steps, faces, steps.refresh if repeat == 0 else 1)
        state.colliding[:] = 0
        if moved.any() and not known.any() and self.stretch(state, moved) < MAX_STRETCH:
            state.colliding[:] = pairs.spread(np.flatnonzero(moved))

    def stretch(self, state: State, chosen: np.ndarray) -> float:
        """Length of the edge that is drawn out most, over its rest length, of those between chosen vertices."""
        edges, lengths = self._edges
        rows = np.flatnonzero(chosen[edges].all(axis=1))
        ends = state.position[edges[rows], :3]
        return float((np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) / lengths[rows]).max(initial=0.0))

    def _mend(self, state: State, start: np.ndarray, faces: np.ndarray, dt: float, left: int) -> bool:
        """Keep impacts from happening over the whole frame at once, if that takes small corrections.

        Args:
            state: at the end of the frame.
            start: positions at its start [m], float64, shape (n, 3).
            faces: numbers of those that are kept from going through one another.
            dt: frame time [s].
            left: crossings that there may be elsewhere: as many as at the start.

        Returns:
            whether there are no more crossings now.
        """
        assert self.pairs.impacts is not None
        impacts, proposed = self.pairs.impacts, state.position[:, :3].astype(float)
        end = proposed.copy()
        _, rigid = impacts.keep_apart(start, end, state.position[:, 3].astype(float), faces)
        if rigid or np.abs(end - proposed).max() > MAX_MEND or len(impacts.grid.crossings(end)) > left:
            return False
        state.position[:, :3] = end
        state.velocity += ((end - proposed) / dt).astype(np.float32)
        return True

    def _advance_by_impacts(
        self, state: State, arguments: dict[str, Any], dt: float, steps: FrameSteps, faces: np.ndarray, stride: int
    ) -> np.ndarray:
        """Advance the state by a few substeps at a time, over which none of the given faces goes through another.

        Returns:
            the vertices that were kept from it, as a mask.
        """
        assert self.pairs.impacts is not None
        found, moved = 0, np.zeros(len(state.position), bool)
        for begin in range(0, steps.count, stride):
            if begin >= found:
                good = self.pairs.find(state, dt / steps.count, steps.count - begin, self.model.fabric.thickness, begin)
                found = begin + steps.refresh * max(1, good // steps.refresh)
            end = min(begin + stride, steps.count)
            self._steps[:4] = begin, end, steps.count, min(stride, steps.refresh)
            before = state.position[:, :3].astype(float)
            self._advance.by_name(arguments | self.pairs.arrays())
            after = state.position[:, :3].astype(float)
            if self.pairs.impacts.keep_apart(before, after, state.position[:, 3].astype(float), faces)[0]:
                moved |= (after != state.position[:, :3]).any(axis=1)
                state.position[:, :3] = after
            self.pairs.remember(state)
        return moved

    def _advance_with_pairs(self, state: State, arguments: dict[str, Any], dt: float, steps: FrameSteps) -> None:
        """Advance the state with the cloth's own pairs, which are found anew as often as it moves far."""
        end = 0
        while end < steps.count:
            good = self.pairs.find(state, dt / steps.count, steps.count - end, self.model.fabric.thickness, end)
            begin, end = end, min(end + steps.refresh * max(1, good // steps.refresh), steps.count)
            self._steps[:2] = begin, end
            self._advance.by_name(arguments | self.pairs.arrays())
            self.pairs.remember(state)
