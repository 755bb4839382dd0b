"""The simulation that closes the stitches of pieces around a body and drapes the garment that they become."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from assets.sewing.body import StandingBody
from assets.sewing.pieces import Pieces
from pbd.contact.colliders import Body, Colliders
from pbd.fabric import Fabric
from pbd.mesh import MAX_STRETCH, ClothMesh, vertex_rings
from pbd.model import build_model
from pbd.opening import neighbour_means
from pbd.state import State
from pbd.xpbd.solver import Solver, SolverOptions

__all__ = ["HELD", "Clock", "band_limits", "close_stitches", "drape", "substep_of"]

Floats = NDArray[np.float64]

FRAME = 1.0 / 120.0  # [s]
GRAVITY = (0.0, -9.81, 0.0)
# The substep belongs to the edges of the mesh: stiff cloth of short edges stretches in long substeps.
SUBSTEP, SUBSTEP_EDGE = 1.0 / 1440.0, 0.01  # [s] at this edge length [m], and in proportion below
CLOSING_DAMPING = 4.0  # rate at which velocities die away while the stitches close [1/s]
HELD = 0.05  # for which the stitches are held closed afterwards [s]; weight would open them before they are joined
# So many layers make a band that does not give way; its edges become no longer than this. Membranes alone, in one pass
# a substep, let a skirt's waistband stretch by a fifth and slide over the hips.
BAND_LAYERS, MAX_BAND_STRETCH = 2.5, 1.01
MIN_SHARE = 0.05  # of the work after which the time left is said: kernels are compiled first


class Clock:
    """Counts the work of all stages, and says how much time is left.

    Args:
        work: of all stages together, in vertices times substeps.
        report: called with lines of progress, at most every second; None for none.
    """

    def __init__(self, work: float, report: Callable[[str], None] | None) -> None:
        self._work, self._report, self._done = work, report, 0.0
        self._began = self._reported = time.monotonic()
        self.stage = ""

    def add(self, work: float) -> None:
        """Some work is done."""
        self._done += work
        now = time.monotonic()
        if self._report is not None and now - self._reported > 2.0:
            share = min(self._done / self._work, 1.0)
            left = ""
            if share > MIN_SHARE:
                left = f", {(now - self._began) * (1.0 / share - 1.0):.0f} s left"
            self._report(f"{self.stage}: {100.0 * share:.0f} %{left}")
            self._reported = now


def band_limits(layers: Floats) -> Floats:
    """Greatest length of each face's edges over their rest length [-], shape (m,): bands do not give way.

    Args:
        layers: of cloth in each face, shape (m,).
    """
    return np.where(layers >= BAND_LAYERS, MAX_BAND_STRETCH, MAX_STRETCH)


def substep_of(edge_length: float) -> float:
    """Substep [s] for a mesh with edges of a length [m]."""
    return SUBSTEP * min(1.0, edge_length / SUBSTEP_EDGE)


class _ClothOnBody:
    """A cloth beside a body that stands still."""

    def __init__(
        self,
        mesh: ClothMesh,
        fabric: Fabric,
        body: StandingBody,
        options: SolverOptions,
        bend_factor: float,
        held: NDArray[np.int32] | None = None,
    ) -> None:
        self.model = build_model(mesh, fabric, held, bend_factor=bend_factor)
        self.solver, self.state = Solver(self.model, options), State.at_rest(self.model)
        self._body = Body(body.faces, len(body.vertices))
        self._body.origin = self.state.origin.copy()
        self._body.place((body.vertices - self.state.origin).astype(np.float32))
        self._colliders = Colliders((), self._body)

    def step(self, damping: float, gaps: tuple[Floats, Floats] | None = None, body: Floats | None = None) -> None:
        """A frame, after which velocities have died away at a rate [1/s]; ``body`` [m], where its vertices go."""
        self.solver.follow(self.state, self._colliders)
        current = self._body.current.copy() if body is None else (body - self.state.origin).astype(np.float32)
        self._body.advance(current)
        self.solver.step(self.state, self._colliders, FRAME, stitch_gaps=gaps)
        self.state.velocity *= np.float32(np.exp(-damping * FRAME))


def close_stitches(
    pieces: Pieces,
    positions: Floats,
    body: StandingBody,
    fabric: Fabric,
    bend_factor: float,
    seconds: float,
    clock: Clock,
    smoothings: int,
) -> Floats:
    """Close all stitches in a time, without weight and without friction.

    Each stitch may be open by a share of its first gap, which falls to nothing in equal steps. The cloth keeps off
    itself all the time: panels that start on their own sides of the body stay there.

    Args:
        pieces: to be sewn.
        positions: where they are arranged [m], shape (n, 3).
        body: between them.
        fabric: of the cloth.
        bend_factor: see :func:`pbd.model.build_model`.
        seconds: time from the first moment until no stitch may be open.
        clock: counts the work.
        smoothings: of the body, which make limbs thin, at the start; it grows to its own shape while they close.

    Returns:
        positions afterwards [m], shape (n, 3).
    """
    # Elastic bands pull only once the stitches are closed: before, they would draw a panel off its place.
    plain = ClothMesh.from_pattern(positions, pieces.faces, pieces.flat[pieces.faces], pieces.layers)
    mesh = replace(plain, stitches=_stitch_rows(pieces), stitch_weights=np.zeros(len(pieces.stitches)))
    substep = substep_of(float(mesh.edge_lengths()[1].mean()))
    options = SolverOptions(substep=substep, gravity=(0.0, 0.0, 0.0), self_collision=True)
    thin = _smoothed(body, smoothings)
    cloth = _ClothOnBody(mesh, replace(fabric, friction=0.0), replace(body, vertices=thin), options, bend_factor)
    v, a, _ = cloth.model.stitches.T  # in an order of its own
    gaps = np.linalg.norm(positions[v] - positions[a], axis=1)
    shares = np.clip(1.0 - np.arange(round((seconds + HELD) / FRAME) + 1) * FRAME / seconds, 0.0, 1.0)
    for before, after in zip(shares[:-1], shares[1:], strict=True):
        grown = body.vertices + after * (thin - body.vertices) if smoothings else None
        cloth.step(CLOSING_DAMPING, (before * gaps, after * gaps), grown)
        clock.add(len(positions) * FRAME / substep)
    return cloth.state.world()


def _smoothed(body: StandingBody, times: int) -> Floats:
    """Vertices of the body, each at the mean of its neighbours so many times [m], shape (n, 3)."""
    vertices, (mean, _) = body.vertices, neighbour_means(body.faces, len(body.vertices))
    for _ in range(times):
        vertices = mean @ vertices
    return vertices


def drape(
    mesh: ClothMesh,
    body: StandingBody,
    fabric: Fabric,
    bend_factor: float,
    seconds: float,
    damping: float,
    clock: Clock,
    weight: float,
    held: NDArray[np.int32],
) -> ClothMesh:
    """Simulate a garment on a body for a time.

    Args:
        mesh: the garment; it starts without speed.
        body: that wears it.
        fabric: of the cloth.
        bend_factor: see :func:`pbd.model.build_model`.
        seconds: length of the simulation [s].
        damping: rate at which velocities die away [1/s].
        clock: counts the work.
        weight: share of gravity [-].
        held: vertices that stay where they are, int32, shape (p,).

    Returns:
        the mesh where it hangs.
    """
    substep = substep_of(float(mesh.edge_lengths()[1].mean()))
    options = SolverOptions(substep=substep, gravity=(0.0, weight * GRAVITY[1], 0.0), self_collision=True)
    cloth = _ClothOnBody(mesh, fabric, body, options, bend_factor, held)
    for _ in range(round(seconds / FRAME)):
        cloth.step(damping)
        clock.add(len(mesh.vertices) * FRAME / substep)
    return replace(mesh, vertices=cloth.state.world())


def _stitch_rows(pieces: Pieces) -> NDArray[np.int32]:
    """Stitches (v, a, b) with all the weight at a; b is any neighbour of a other than v: shape (s, 3)."""
    starts, ring = vertex_rings(pieces.faces, len(pieces.flat))
    rows = []
    for v, a in pieces.stitches.tolist():
        around = ring[starts[a] : starts[a + 1]]
        rows.append((v, a, int(around[around != v][0])))
    return np.array(rows, np.int32).reshape(-1, 3)
