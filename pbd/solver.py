"""The default solver: XPBD with small steps and patches from coarse to fine, on the serial fused schedule."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pbd.advance import advance_kernel
from pbd.colliders import Body, Colliders
from pbd.distance_field import MOTION
from pbd.engine import Launch, ensure_initialized
from pbd.errors import InputError
from pbd.hierarchy import Hierarchy, build_hierarchy
from pbd.inertia import damp_locally, relieve
from pbd.limits import Places
from pbd.model import BLOCK, GRID, Model, State
from pbd.pace import Carry, carry_of, fastest_way
from pbd.search import MAX_CELLS, find_nearest
from pbd.self_collision import SelfCollision
from pbd.team import MOST_WORKERS

__all__ = ["Solver", "SolverOptions"]

AIR_DENSITY = 1.2  # [kg/m3]
# Colliders and held vertices that go further than this in a substep cut the frame finer: a share of an edge, but ...
STRIDE = 0.25  # [-]
LEAST_STRIDE = 0.01  # ... at least this [m] ...
MOST_FINER = 8  # ... and no more than so many times as fine
SHORTEST_FRAME = 1e-7  # shorter ones are none [s]: float32 does not hold the square of their inverse


@dataclass(frozen=True)
class SolverOptions:
    """Options of the solver.

    Attributes:
        substep: longest substep [s]; a frame is cut into equal substeps not longer than this, finer where a collider
            or a held vertex is fast.
        gravity: [m/s2].
        coarse_sweeps: passes over each coarser level of the mesh (:mod:`pbd.hierarchy`) in a substep; 0 leaves all out,
            and so does a model of several layers.
        contact_refreshes: times a second that each contact is looked for again along the body's surface [Hz].
        self_collision: whether the cloth keeps its thickness from itself. Layers always keep it from one another. Cloth
            that starts up to 3 cm through itself, with edges of 2 cm, is apart in 0.5 s. Either way edges are drawn out
            to no more than 1.5 times their length (Provot 1995) where the body leaves them room.
        local_damping: rate at which velocities against the garment's motion as a whole die away [1/s].
        linear_inertia, angular_inertia: part that the cloth feels of changes of the motion of what carries it (the held
            vertices, else the body), centrifugal force included [-]: 1 is physical, 0 goes along unmoved.
    """

    substep: float = 1.0 / 720.0
    gravity: tuple[float, float, float] = (0.0, -9.81, 0.0)
    coarse_sweeps: int = 4
    contact_refreshes: float = 240.0
    self_collision: bool = False
    local_damping: float = 0.0
    linear_inertia: float = 1.0
    angular_inertia: float = 1.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.local_damping) and self.local_damping >= 0):
            expected = "a finite number, at least 0 [1/s]"
            raise InputError("bad rate", key="local_damping", received=self.local_damping, expected=expected)
        for name in ("linear_inertia", "angular_inertia"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise InputError("bad part", key=name, received=getattr(self, name), expected="0 to 1")
        if not np.isfinite(self.substep) or self.substep <= 0:
            raise InputError("bad substep", key="substep", received=self.substep, expected="above 0 [s]")
        if len(self.gravity) != 3 or not np.isfinite(self.gravity).all():
            raise InputError("bad gravity", key="gravity", received=self.gravity, expected="three finite numbers")
        if self.coarse_sweeps < 0:
            raise InputError(
                "bad number of passes", key="coarse_sweeps", received=self.coarse_sweeps, expected="at least 0"
            )
        if not self.contact_refreshes > 0:
            raise InputError(
                "bad rate", key="contact_refreshes", received=self.contact_refreshes, expected="above 0 [Hz]"
            )


class Solver:
    """Steps the garment of one model. Owns no scene and no state.

    A garment that starts inside a body, up to 2.5 cm deep, or a layer 1.5 cm through another, is out within 0.5 s.

    Args:
        model: the garment.
        options: see :class:`SolverOptions`.
    """

    def __init__(self, model: Model, options: SolverOptions | None = None) -> None:
        ensure_initialized()
        self.model, self.options = model, options or SolverOptions()
        count, samples, fabric = model.vertex_count, len(model.samples), model.fabric
        self._shift, self._normals, self._gained = np.zeros((3, count, 4), np.float32)
        self._touched = np.zeros((samples, 3, 4), np.float32)
        self._awake = np.zeros(2 * samples, np.int32)
        self._listed = np.zeros((MOST_WORKERS * (len(model.sample_colors) - 1), 2), np.int32)
        area = model.mesh.vertex_areas
        self._air = np.zeros((count, 4), np.float32)
        self._air[:, 3] = 0.5 * AIR_DENSITY * fabric.air_drag * area / model.mass
        self._wind: tuple | None = (0.0, 0.0, 0.0)  # in it, where it is the same everywhere
        self._limits = model.limits.rows(model.mesh.vertex_areas)
        self._unlimited = self._limits[:0]
        self._nobody = Body(np.zeros((0, 3), np.int32), 1)
        self._cells = np.zeros(MAX_CELLS + 2, np.int32)
        self._way = np.zeros(1, np.float32)
        self._items, self._item_cells = np.zeros((2, 1), np.int32)
        levels = Hierarchy.flat(count)
        if self.options.coarse_sweeps and not model.layer.any():  # levels know one fabric
            levels = build_hierarchy(model.mesh, model.mass, model.inverse_mass, model.options.membrane(fabric))
        self._hierarchy, patches = levels, len(levels.inverse_mass)
        self._children = levels.children()
        # Kept one by one: an array that is the same object as at the last call need not be handed over again.
        self._patches = [np.zeros((max(1, patches), 4), np.float32) for _ in range(4)]
        self._patches[0][:patches, 3] = levels.inverse_mass
        self._link_room = np.zeros((9, len(levels.links) + BLOCK), np.float32)
        # Substeps are never longer than this, so that levels that are of no use in it are of none in any.
        self.with_patches = levels.useful(self.options.substep) > 0
        self.in_contact = self.options.self_collision or bool(model.layer.any())
        self._pairs = SelfCollision(model, self.options.self_collision) if self.in_contact else None
        self._no_pairs = (
            np.zeros((1, 4), np.int32),
            np.zeros((1, 2, 4), np.float32),
            np.zeros(2, np.int32),
            np.zeros((0, 4), np.float32),
        )
        self._steps = np.zeros(6, np.int32)
        self._stride = max(LEAST_STRIDE, STRIDE * float(model.mesh.edge_lengths()[1].mean()))
        advance = advance_kernel(self.with_patches, self._pairs is not None)
        self._find_nearest, self._advance = Launch(find_nearest), Launch(advance)

    def step(
        self,
        state: State,
        colliders: Colliders,
        dt: float,
        targets: np.ndarray | None = None,
        wind: tuple[float, float, float] | np.ndarray = (0.0, 0.0, 0.0),
        places: Places | None = None,
    ) -> None:
        """Advance the state in place.

        Args:
            state: of this model.
            colliders: what it collides with; a body's ``origin`` must be the state's.
            dt: frame time [s]; 0, or below 1e-7, does nothing.
            targets: where the held vertices stand at the end of the frame, world [m], shape (p, 3);
                None leaves them where they are.
            wind: velocity of the air [m/s], shape (3,), or at each vertex, shape (n, 3).
            places: where the body carries the vertices that the model limits; None sets them free.

        Raises:
            InputError: dt below zero or not finite, a state of another model or not finite, bad targets, wind or
                places, or a body about another origin.
        """
        if not np.isfinite(dt) or dt < 0:
            raise InputError("bad time step", key="dt", received=dt, expected="a finite number, at least 0 [s]")
        if dt < SHORTEST_FRAME:
            return
        search, course = self.prepare(state, colliders, dt, targets, wind, places)
        if colliders.body is not None:
            self._find_nearest(*search)
        if self._pairs is None:
            self._advance(*course)
        else:
            self._advance_in_contact(state, course, dt)

    def _advance_in_contact(self, state: State, course: tuple, dt: float) -> None:
        """Advance the state with the cloth's own pairs, which are found anew as often as it moves far."""
        assert self._pairs is not None
        where = next(k for k, argument in enumerate(course) if argument is self._no_pairs[0])
        _, _, substeps, refresh, _, _ = self._steps.tolist()
        end = 0
        while end < substeps:
            good = self._pairs.find(state, dt / substeps, substeps - end, self.model.fabric.thickness)
            begin, end = end, min(end + refresh * max(1, good // refresh), substeps)
            self._steps[:2] = begin, end
            self._advance(*course[:where], *self._pairs.arrays(), *course[where + len(self._no_pairs) :])
            self._pairs.remember(state)

    def prepare(
        self,
        state: State,
        colliders: Colliders,
        dt: float,
        targets: np.ndarray | None,
        wind: tuple[float, float, float] | np.ndarray,
        places: Places | None = None,
    ) -> tuple[tuple, tuple]:
        """Arguments of the kernels of a step, see :meth:`step`.

        Returns:
            Those of :func:`pbd.search.find_nearest`, to be called if there is a body, and of
            :func:`pbd.advance.advance_kernel`. They hold until the next call.
        """
        model, options = self.model, self.options
        self._check(state, targets, wind, places)
        rows, fields, field_values, previous, moved = self._keep_up(state, colliders, dt, targets)
        if options.local_damping > 0.0:
            damp_locally(state, model.mass, options.local_damping, dt)
        if np.ndim(wind) > 1 or self._wind != tuple(wind):
            self._air[:, :3] = wind
            self._wind = tuple(wind) if np.ndim(wind) == 1 else None
        held_0 = np.ascontiguousarray(state.position[model.held, :3])
        held_1 = held_0 if targets is None else np.ascontiguousarray(targets - state.origin, np.float32)
        substeps = max(1, int(np.ceil(dt / options.substep - 1e-6)))
        if len(rows) or len(fields) or targets is not None:
            way = fastest_way(rows, fields, held_0, held_1, np.float32(dt) * state.velocity.mean(axis=0))
            substeps = max(substeps, min(int(np.ceil(way / self._stride)), MOST_FINER * substeps))
        refresh = max(1, round(substeps / max(1.0, dt * options.contact_refreshes)))
        levels = self._hierarchy
        thickness = model.fabric.thickness
        limited = self._unlimited
        if places is not None and len(model.limits.vertices):
            limited, start = self._limits, places.start if moved is None else places.end
            limited[:, 0, :3], limited[:, 1, :3] = start - state.origin, places.end - start
            limited[:, 2, :3] = places.normals
        self._steps[:] = 0, substeps, substeps, refresh, levels.useful(dt / substeps), options.coarse_sweeps
        self._way[0] = 0.0
        body = colliders.body or self._nobody
        # What was touched before may be no part of this body: another one, or none.
        state.nearest[state.nearest >= (len(body.current) if colliders.body else 0)] = -1
        if colliders.body is not None:
            if np.any(body.origin != state.origin):
                raise InputError("body and state have other origins", received=body.origin, expected=str(state.origin))
            if len(self._items) < len(body.current) + len(body.probes):
                self._items, self._item_cells = np.zeros((2, len(body.current) + len(body.probes)), np.int32)
        search = (
            state.position,
            state.velocity,
            model.samples,
            model.triangles,
            state.nearest,
            previous,
            body.current,
            body.ring_start,
            body.ring,
            body.surface,
            body.probes,
            body.probe_weights,
            self._cells,
            self._items,
            self._item_cells,
            self._way,
            dt,
            thickness,
        )
        course = (
            state.position,
            state.velocity,
            self._shift,
            self._normals,
            self._gained,
            self._touched,
            self._awake,
            model.samples,
            model.sample_colors,
            self._listed,
            model.triangles,
            model.triangle_blocks,
            model.block_colors,
            model.triangle_data,
            model.hinges,
            model.hinge_colors,
            model.hinge_data,
            model.stitches,
            model.stitch_weights,
            model.tethers,
            model.tether_lengths,
            model.held,
            held_0,
            held_1,
            limited,
            self._air,
            model.pressure,
            rows,
            fields,
            field_values,
            state.nearest,
            state.contact,
            previous,
            body.current,
            body.normals,
            body.ring_start,
            body.ring,
            body.fan_start,
            body.fan,
            levels.parent,
            levels.share,
            *self._patches,
            levels.starts,
            *self._children,
            levels.links,
            levels.link_colors,
            levels.color_starts,
            levels.link_data,
            levels.link_shares,
            self._link_room,
            self._way,
            *self._no_pairs,
            self._steps,
            dt / substeps,
            options.gravity,
            model.options.squeeze,
            (
                thickness,
                model.fabric.friction,
                model.fabric.compression / model.fabric.areal_density,
                float(model.smooth),
            ),
        )
        return search, course

    def _keep_up(
        self, state: State, colliders: Colliders, dt: float, targets: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, Carry | None]:
        """Primitives, fields, their values and the body's pose at the frame's start; how what holds the cloth was put.

        Where it was put elsewhere, the garment goes with it as it is, and they stand still.
        """
        rows, body, options = colliders.rows(state.origin), colliders.body or self._nobody, self.options
        fields, field_values = colliders.fields(state.origin)
        if targets is not None and len(self.model.held):
            before, after = state.position[self.model.held, :3], targets - state.origin
        elif colliders.body is not None and not len(self.model.held):
            before, after = body.previous, body.current
        else:
            return rows, fields, field_values, body.previous, None
        carry = carry_of(before, after, state.velocity.mean(axis=0), dt)
        if carry is None:
            if min(options.linear_inertia, options.angular_inertia) < 1.0:
                relieve(state, before, after, options.linear_inertia, options.angular_inertia, dt)
            return rows, fields, field_values, body.previous, None
        state.position[:, :3] = carry.points(state.position[:, :3])
        state.velocity[:] = state.velocity @ carry.turn.T
        state.pair_sides[:, :3] = state.pair_sides[:, :3] @ carry.turn.T
        rows[:, 2:8] = rows[:, 8:14]
        fields[:, MOTION] = 0.0
        return rows, fields, field_values, body.current, carry

    def _check(
        self,
        state: State,
        targets: np.ndarray | None,
        wind: tuple[float, float, float] | np.ndarray,
        places: Places | None,
    ) -> None:
        """Refuse what the kernels could not take."""
        model = self.model
        received = (len(state.position), len(state.velocity), len(state.nearest), len(state.contact))
        expected = (model.vertex_count, model.vertex_count, len(model.samples), model.vertex_count)
        if received != expected:
            raise InputError("state of another model", key="state", received=received, expected=f"lengths {expected}")
        if not (np.isfinite(state.position).all() and np.isfinite(state.velocity).all()):
            raise InputError("state is not finite", key="state", expected="finite positions and velocities")
        if targets is not None and (np.shape(targets) != (len(model.held), 3) or not np.isfinite(targets).all()):
            raise InputError(
                "bad targets", key="targets", received=np.shape(targets), expected=f"finite, ({len(model.held)}, 3)"
            )
        if np.shape(wind) not in ((3,), (model.vertex_count, 3)) or not np.isfinite(wind).all():
            received = wind if np.size(wind) <= 3 else np.shape(wind)
            expected = f"three finite numbers [m/s], or shape ({model.vertex_count}, 3)"
            raise InputError("bad wind", key="wind", received=received, expected=expected)
        limited = (len(model.limits.vertices), 3)
        for name, points in places._asdict().items() if places is not None else ():
            if np.shape(points) != limited or not np.isfinite(points).all():
                expected = f"finite, {limited}"
                raise InputError("bad places", key=f"places.{name}", received=np.shape(points), expected=expected)

    def follow(self, state: State, colliders: Colliders) -> np.ndarray:
        """Move the origin of state and body to the grid point nearest to the garment, and return it [m], shape (3,)."""
        centre = state.position[:, :3].mean(axis=0)
        # Half a cell of slack keeps the origin from flickering between two grid points.
        if np.abs(centre).max() > GRID and np.isfinite(centre).all():
            state.move_origin(state.origin + GRID * np.round(centre / GRID))
        if colliders.body is not None:
            colliders.body.move_origin(state.origin)
        return state.origin
