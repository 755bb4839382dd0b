"""Notices a garment that is hooked through its body and puts it back on."""

from __future__ import annotations

import numpy as np

from pbd import Body, Model, State
from pbd.attachment import Attachment

__all__ = ["Redressing"]

TOO_LONG = 2.0  # length of an edge over its rest length [-]: contact with a body that is outside draws none out so far
PATIENCE = 0.3  # time for which the same edge is too long before the garment is put back [s]: a limb pinches less long
DURATION = 0.4  # of putting it back [s]


class Redressing:
    """Puts a garment back on its body where an edge stays far too long.

    Wind or a pull may hook cloth through a limb. Contact, which knows the nearest surface only, then holds it there for
    ever. The garment is then moved, without contact, to where the body carries it from the bind pose.

    Args:
        model: the garment, in the body's bind pose.
        body_vertices: the body in its bind pose [m], shape (b, 3).
        body_faces: int, shape (k, 3).

    Attributes:
        count: how often the garment was put back.
    """

    def __init__(self, model: Model, body_vertices: np.ndarray, body_faces: np.ndarray) -> None:
        self._free = model.inverse_mass > 0.0
        self._edges, lengths = model.mesh.edge_lengths()
        self._longest = TOO_LONG * lengths
        self._long = np.zeros(len(lengths))  # for how long each edge has been too long [s]
        self._bind = model.mesh.vertices, body_vertices, body_faces
        self._carrier: Attachment | None = None
        self._offsets = np.zeros((0, 3))  # from where the body carries the vertices, as it begins [m]
        self._left = 0.0  # of the duration [s]
        self.count = 0

    def step(self, state: State, body: Body, dt: float) -> bool:
        """Move the garment by a frame if it is being put back; whether it is.

        Args:
            state: of the garment, at the end of the last frame.
            body: at the end of this frame, about the state's origin.
            dt: frame time [s].
        """
        if dt <= 0.0 or (self._left <= 0.0 and not self._hooked(state, dt)):
            return False
        if self._carrier is None:
            self._carrier = Attachment.bind(*self._bind)
        carried = self._carrier.targets(body.current)
        before = state.position[:, :3].copy()
        if self._left <= 0.0:
            self._left, self._offsets = DURATION, before - carried
            self.count += 1
        self._left -= dt
        share = np.clip(self._left / DURATION, 0.0, 1.0)
        state.position[:, :3] = carried + share * share * (3.0 - 2.0 * share) * self._offsets
        state.velocity[:] = (state.position[:, :3] - before) / dt
        state.nearest[:], state.contact_faces[:] = -1, -1
        state.pairs, state.pair_sides = state.pairs[:0], state.pair_sides[:0]
        return True

    def _hooked(self, state: State, dt: float) -> bool:
        """Whether an edge has been too long for too long, while nothing pulled at the garment."""
        x = state.position[:, :3]
        length = np.linalg.norm(x[self._edges[:, 0]] - x[self._edges[:, 1]], axis=1)
        pulled = bool((state.position[self._free, 3] == 0.0).any())
        self._long += dt
        self._long[pulled | (length <= self._longest)] = 0.0
        hooked = bool(self._long.max(initial=0.0) > PATIENCE)
        if hooked:
            self._long[:] = 0.0
        return hooked
