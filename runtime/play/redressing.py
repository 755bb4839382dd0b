"""Notices a garment that is hooked through its body and puts it back on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pbd import Body, Model, State
from pbd.attachment import Attachment
from pbd.crossings import SelfCrossings
from pbd.distance import BodyDistance
from pbd.opening import smoothed_apart
from pbd.taichi_internals import Launch
from runtime.play.long_edges import find_longer

__all__ = ["Redressing"]

LONG, TOO_LONG = 1.4, 2.0  # length of an edge over its rest length [-]: contact from outside draws none out twice
THROUGH, DEEP = 0.005, 0.012  # depth of a long edge's middle in the body, with its ends outside, and anyhow [m]
# Time for which the same edge is too long, through the body, and deep in it before the garment is put back: a limb
# pinches less long [s].
PATIENCE = np.array([[0.3], [0.3], [2.5]])
DURATION, PAUSE = 0.4, 0.1  # of putting it back, and between looks for a pose with room for it [s]
MAX_PAUSES = 10  # while it is carried on in poses without room


class Redressing:
    """Puts a garment back on its body where an edge stays far too long, or long and through the body.

    Wind or a pull may hook cloth through a limb. Contact, which knows the nearest surface only, then holds it there for
    ever. The garment is then moved, without contact, to where the body carries it from the bind pose. Cloth that limbs
    pinch has long edges in the body, too, but mostly not for so long. It is left alone where the body would carry more
    edges deep into itself than are long, as below an arm that hangs down and was spread in the bind pose.

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
        self._lengths = lengths
        # Edges a little shorter than long ones count as well, for rounding.
        self._long = np.asarray((0.999 * LONG * lengths) ** 2, np.float32)
        self._found, self._find_longer = np.zeros(1, np.int32), Launch(find_longer)
        self._since = np.zeros((len(PATIENCE), len(lengths)))  # for how long each edge has been so [s]
        self._distance = BodyDistance(body_faces)
        self._mesh, self._layer = model.mesh, model.layer if model.layer.any() else None
        self._bind = model.mesh.vertices, body_vertices, body_faces
        self._carrier: Attachment | None = None
        self._offsets = np.zeros((0, 3))  # from where the body carries the vertices, as it begins [m]
        self._left, self._pauses = 0.0, 0  # of the duration, or of a pause [s], and pauses that there may be yet
        self._crossings = SelfCrossings(model.mesh)
        self.count = 0

    def step(self, state: State, body: Body, dt: float) -> bool:
        """Move the garment by a frame if it is being put back; whether it is.

        Args:
            state: of the garment, at the end of the last frame.
            body: at the end of this frame, about the state's origin.
            dt: frame time [s].
        """
        if dt <= 0.0 or (self._left <= 0.0 and not self._hooked(state, body, dt)):
            return False
        carried = self._carried(body)
        before = state.position[:, :3].copy()
        if self._left <= 0.0:
            self._since[:] = 0.0
            self._left, self._offsets = DURATION, before - carried
            self.count += 1
            self._pauses = MAX_PAUSES
        self._left -= dt
        share = np.clip(self._left / DURATION, 0.0, 1.0)
        state.position[:, :3] = carried + share * share * (3.0 - 2.0 * share) * self._offsets
        if self._left <= 0.0:  # the pose may have less room than the bind pose
            put_back = replace(self._mesh, vertices=state.position[:, :3].astype(float))
            held = np.flatnonzero(state.position[:, 3] == 0.0)
            opened = smoothed_apart(put_back, held, self._layer, body.current.astype(float), self._distance.faces)
            if self._pauses > 0 and len(self._crossings.find(opened)):
                self._left, self._offsets, self._pauses = PAUSE, np.zeros_like(carried), self._pauses - 1
            else:
                state.position[:, :3] = opened
        state.velocity[:] = (state.position[:, :3] - before) / dt
        state.nearest[:], state.contact_faces[:] = -1, -1
        state.forget_self_contact()
        return True

    def _hooked(self, state: State, body: Body, dt: float) -> bool:
        """Whether an edge was too long for too long, nothing pulled, and the body has room for what it carries."""
        self._find_longer(state.position, self._edges, self._long, self._found)
        if not self._found[0]:
            self._since[:] = 0.0
            return False
        x = state.position[:, :3]
        stretch = np.linalg.norm(x[self._edges[:, 0]] - x[self._edges[:, 1]], axis=1) / self._lengths
        pulled = bool((state.position[self._free, 3] == 0.0).any())
        found = np.zeros(self._since.shape, bool)
        found[0] = stretch > TOO_LONG
        rows = np.flatnonzero(stretch > LONG)
        if len(rows):
            first, last = x[self._edges[rows].T].astype(float)
            points = np.concatenate([first, last, 0.5 * (first + last)])
            first, last, middle = self._distance.signed_distance(points, body.current.astype(float)).reshape(3, -1)
            found[1, rows] = (first > 0.0) & (last > 0.0) & (middle < -THROUGH)
            found[2, rows] = middle < -DEEP
        self._since += dt
        self._since[pulled | ~found] = 0.0
        late = (self._since > PATIENCE).any(axis=0)
        if not late.any():
            return False
        self._since[:, late] = 0.0
        middles = self._carried(body)[self._edges].mean(axis=1, dtype=float)
        depth = -self._distance.signed_distance(middles, body.current.astype(float))
        return int(np.count_nonzero(depth > DEEP)) <= len(rows)

    def _carried(self, body: Body) -> np.ndarray:
        """The vertices where the body carries them from its bind pose, shape (n, 3)."""
        if self._carrier is None:
            self._carrier = Attachment.bind(*self._bind)
        return self._carrier.targets(body.current)
