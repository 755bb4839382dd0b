"""The default solver: XPBD with small steps and a multigrid of patches, on the serial fused schedule."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pbd.arrays import floats
from pbd.contact.body_search import find_nearest
from pbd.contact.colliders import Body, Colliders
from pbd.contact.distance_field import MOTION
from pbd.contact.self_collision import SelfCollision
from pbd.engine import ensure_initialized
from pbd.errors import InputError
from pbd.limits import LimitTargets
from pbd.model import Model
from pbd.state import GRID, State
from pbd.taichi_internals import Launch
from pbd.xpbd.advance import advance_kernel
from pbd.xpbd.collision_handling import CollisionHandling
from pbd.xpbd.inertia import damp_locally, scale_inertial_forces
from pbd.xpbd.kernel_arguments import (
    load_friction,
    model_arrays,
    multigrid_arrays,
    store_friction,
    workspace_arrays,
)
from pbd.xpbd.multigrid import Multigrid, build_multigrid
from pbd.xpbd.rigid_motion import RigidTransform, detect_teleport, max_displacement
from pbd.xpbd.state_summary import StateSummary
from pbd.xpbd.stiff_bending import is_stiff
from pbd.xpbd.views import FrameSteps, StepParameters

__all__ = ["Solver", "SolverOptions"]

AIR_DENSITY = 1.2  # [kg/m3]
# A frame is cut into more substeps where a collider or a held vertex moves further than this in one.
STRIDE_SHARE = 0.25  # of the mean edge [-], ...
MIN_STRIDE = 0.01  # ... but at least this [m]
MAX_REFINEMENT = 8  # times as many substeps, at most
MIN_FRAME_TIME = 1e-7  # shorter frames do nothing [s]: float32 does not hold the square of their inverse


@dataclass(frozen=True)
class SolverOptions:
    """Options of the solver.

    Attributes:
        substep: longest substep [s]; a frame is cut into equal substeps not longer than this, finer where a collider
            or a held vertex is fast.
        gravity: [m/s2].
        coarse_sweeps: passes over each coarser level of the mesh (:mod:`pbd.xpbd.multigrid`) in a substep; 0 leaves
            all out, and so does a model of several layers.
        contact_refreshes: how often each contact is searched again along the body's surface [Hz].
        self_collision: whether the cloth keeps its thickness from itself, and stays free of crossings if it starts so:
            a frame that would end with one is done again, see :mod:`pbd.contact.impacts`. Layers always keep their
            thickness from one another. Cloth that starts up to 3 cm through itself, with edges of 2 cm, is apart in
            0.5 s. With self-collision or layers,
            no edge becomes longer than 1.5 times its rest length (Provot 1995), unless the body forces it.
        local_damping: rate at which velocities against the garment's own rigid motion die away [1/s].
        linear_inertia, angular_inertia: share of the inertial forces that the cloth feels when the motion of its
            carrier changes (the held vertices, else the body), centrifugal force included [-]: 1 is physical; at 0 the
            cloth goes along without moving against its carrier.
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
        floats(self.gravity, "gravity", (3,), "bad gravity", unit=" [m/s2]")
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
        count = model.vertex_count
        area = model.mesh.vertex_areas
        self._air = np.zeros((count, 4), np.float32)
        self._air[:, 3] = 0.5 * AIR_DENSITY * model.fabric.air_drag * area / model.mass
        self._wind: tuple | None = (0.0, 0.0, 0.0)  # in it, where it is the same everywhere
        self._limits = model.limits.rows(area)
        self._unlimited = self._limits[:0]
        self._no_body = Body(np.zeros((0, 3), np.int32), 1)
        self._reached, self._items, self._item_cells = np.zeros((3, 1), np.int32)
        self._item_points = np.zeros((1, 4), np.float32)
        levels = Multigrid.none(count)
        if self.options.coarse_sweeps and not model.layer.any():  # levels know one fabric
            levels = build_multigrid(model.mesh, model.mass, model.inverse_mass, model.fabric)
        self._multigrid = levels
        self.stiff = is_stiff(model, self.options.substep)
        self._steps, self._max_approach = np.zeros(len(FrameSteps._fields), np.int32), np.zeros(1, np.float32)
        self._arguments: dict[str, Any] = {
            **model_arrays(model, self.options.substep, self.stiff),
            **multigrid_arrays(model, levels, self.stiff),
            **workspace_arrays(model),
            "max_approach": self._max_approach,
            "air": self._air,
            "steps": self._steps,
        }
        # Substeps are never longer than this: levels that are of no use in it are of none in any.
        with_multigrid = levels.useful(self.options.substep) > 0
        in_contact = self.options.self_collision or bool(model.layer.any())
        self._held_start, self._held_end = (np.zeros((len(model.held), 3), np.float32) for _ in range(2))
        self._expected = self._kinds_of_state()
        self._stride = max(MIN_STRIDE, STRIDE_SHARE * float(model.mesh.edge_lengths()[1].mean()))
        self._summary = StateSummary()
        self._find_nearest = Launch(find_nearest)
        kinds = with_multigrid, in_contact, model.plastic_shear_count > 0, self.stiff
        self._advance = Launch(advance_kernel(*kinds))
        self._collisions: CollisionHandling | None = None
        if in_contact:
            pairs = SelfCollision(model, self.options.self_collision)
            self._collisions = CollisionHandling(model, pairs, self._advance, self._steps)

    def _kinds_of_state(self) -> list[tuple[str, Any, tuple[int, ...]]]:
        """Names of arrays of a state of the model, their types and shapes."""
        model, count, samples = self.model, self.model.vertex_count, len(self.model.samples)
        real, whole = np.dtype(np.float32), np.dtype(np.int32)
        return [
            ("position", real, (count, 4)),
            ("velocity", real, (count, 3)),
            ("nearest", whole, (samples,)),
            ("contact_faces", whole, (samples, 4)),
            ("contact_weights", real, (samples, 2)),
            ("contact", real, (count,)),
            ("plastic_bends", real, (model.plastic_count,)),
            ("plastic_shears", real, (model.plastic_shear_count,)),
        ]

    def step(
        self,
        state: State,
        colliders: Colliders,
        dt: float,
        targets: np.ndarray | None = None,
        wind: tuple[float, float, float] | np.ndarray = (0.0, 0.0, 0.0),
        limit_targets: LimitTargets | None = None,
        stitch_gaps: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> None:
        """Advance the state in place.

        Args:
            state: of this model.
            colliders: what it collides with; a body's ``origin`` must be the state's.
            dt: frame time [s]; 0, or below 1e-7, does nothing.
            targets: where the held vertices stand at the end of the frame, world [m], shape (p, 3);
                None leaves them where they are.
            wind: velocity of the air [m/s], shape (3,), or at each vertex, shape (n, 3).
            limit_targets: where the body carries the vertices that the model limits; None sets them free.
            stitch_gaps: how far each stitch of the model may be open at the start and at the end of the frame [m],
                shape (s,) both; None takes those of the model.

        Raises:
            InputError: dt below zero or not finite, a state of another model or not finite, bad targets, wind or
                limit targets, or a body about another origin.
        """
        if floats(dt, "dt", (), "bad time step", unit=" [s]") < 0:
            raise InputError("bad time step", key="dt", received=dt, expected="a finite number, at least 0 [s]")
        if dt < MIN_FRAME_TIME:
            return
        arguments = self._prepare(state, colliders, dt, targets, wind, limit_targets)
        gaps = (self.model.stitch_gaps,) * 2
        if stitch_gaps is not None:
            gaps = floats(stitch_gaps, "stitch_gaps", (2, len(self.model.stitches)), unit=" [m]")
        arguments["stitch_data"][:, 1], arguments["stitch_data"][:, 2] = gaps
        if colliders.body is not None:
            self._find_nearest.by_name(arguments)
        load_friction(self.model, state, arguments)
        if self._collisions is None:
            self._advance.by_name(arguments)
        else:
            self._collisions.advance(state, arguments, dt)
        store_friction(self.model, state, arguments)

    def _prepare(
        self,
        state: State,
        colliders: Colliders,
        dt: float,
        targets: np.ndarray | None,
        wind: tuple[float, float, float] | np.ndarray,
        limit_targets: LimitTargets | None = None,
    ) -> dict[str, Any]:
        """Arguments of the kernels of a step by their names, see :meth:`step`; they hold until the next call.

        Returns:
            Those of :func:`pbd.contact.body_search.find_nearest`, to be called if there is a body, and of
            :func:`pbd.xpbd.advance.advance_kernel`.
        """
        model, options = self.model, self.options
        self._check(state, targets, wind, limit_targets)
        if colliders.body is not None:  # which may be written in place
            floats(colliders.body.current, "body.current", colliders.body.normals.shape, unit=" [m]")
        primitives, fields, field_values, previous, transform = self._follow_carrier(state, colliders, dt, targets)
        if options.local_damping > 0.0:
            damp_locally(state, model.mass, options.local_damping, dt)
            self._summary.read(state)
        if np.ndim(wind) > 1 or self._wind != tuple(wind):
            self._air[:, :3] = wind
            self._wind = tuple(wind) if np.ndim(wind) == 1 else None
        target_start, target_end = self._held_start, self._held_end
        target_start[:] = target_end[:] = state.position[model.held, :3]
        if targets is not None:
            np.subtract(targets, state.origin, out=target_end, casting="same_kind")
        substeps = max(1, int(np.ceil(dt / options.substep - 1e-6)))
        if len(primitives) or len(fields) or targets is not None:
            drift = np.float32(dt) * self._summary.drift
            furthest = max_displacement(primitives, fields, target_start, target_end, drift)
            substeps = max(substeps, min(int(np.ceil(furthest / self._stride)), MAX_REFINEMENT * substeps))
        refresh = max(1, round(substeps / max(1.0, dt * options.contact_refreshes)))
        levels = self._multigrid.useful(dt / substeps)
        self._steps[:] = tuple(FrameSteps(0, substeps, substeps, refresh, levels, options.coarse_sweeps))
        self._max_approach[0] = 0.0
        self._arguments |= self._state_arrays(state) | self._body_arrays(self._body_of(state, colliders))
        self._arguments |= {
            "target_start": target_start,
            "target_end": target_end,
            "limits": self._limit_rows(limit_targets, transform, state.origin),
            "primitives": primitives,
            "fields": fields,
            "field_values": field_values,
            "body_start": previous,
            "parameters": self._parameters(dt / substeps),
            "dt": dt,
            "thickness": model.fabric.thickness,
        }
        return self._arguments

    @staticmethod
    def _state_arrays(state: State) -> dict[str, np.ndarray]:
        """Arrays of a state by the names that the kernels have for them."""
        return {
            "position": state.position,
            "velocity": state.velocity,
            "nearest": state.nearest,
            "contact_faces": state.contact_faces,
            "contact_weights": state.contact_weights,
            "contact_distance": state.contact,
        }

    def _body_arrays(self, body: Body) -> dict[str, np.ndarray]:
        """Arrays of a body and of the search in it by the names that the kernels have for them."""
        return {
            "body_end": body.current,
            "body_normals": body.normals,
            "ring_start": body.ring_start,
            "ring": body.ring,
            "fan_start": body.fan_start,
            "fan": body.fan,
            "surface": body.surface,
            "probes": body.probes,
            "probe_weights": body.probe_weights,
            "reached": self._reached,
            "cell_items": self._items,
            "cell_points": self._item_points,
            "item_cell": self._item_cells,
        }

    def _parameters(self, h: float) -> StepParameters:
        """Numbers of a step with substeps of h [s]."""
        model, fabric = self.model, self.model.fabric
        return StepParameters(
            h,
            *self.options.gravity,
            model.options.compression_compliance_scale,
            fabric.thickness,
            fabric.friction,
            fabric.compression / fabric.areal_density,
            float(model.smooth),
        )

    def _limit_rows(
        self, targets: LimitTargets | None, transform: RigidTransform | None, origin: np.ndarray
    ) -> np.ndarray:
        """Limits with their targets, as :class:`pbd.xpbd.views.ConstraintArrays` has them; none without targets."""
        if targets is None or not len(self.model.limits.vertices):
            return self._unlimited
        rows, start = self._limits, targets.start if transform is None else targets.end
        rows[:, 0, :3], rows[:, 1, :3] = np.subtract(start, origin), np.subtract(targets.end, start)
        rows[:, 2, :3] = targets.normals
        return rows

    def _body_of(self, state: State, colliders: Colliders) -> Body:
        """The body to collide with, or one without faces; the workspace of its search is made large enough."""
        body = colliders.body or self._no_body
        # A body vertex that was near before may be no vertex of this body: it may be another one, or none.
        known = len(body.current) if colliders.body else 0
        if state.nearest.max(initial=-1) >= known:
            state.nearest[state.nearest >= known] = -1
        if state.contact_faces.max(initial=-1) >= known:
            state.contact_faces[:] = -1
        if colliders.body is not None:
            if body.origin.tolist() != state.origin.tolist():
                raise InputError("body and state have other origins", received=body.origin, expected=str(state.origin))
            if len(self._items) < len(body.current) + len(body.probes):
                size = (3, len(body.current) + len(body.probes))
                self._reached, self._items, self._item_cells = np.zeros(size, np.int32)
                self._item_points = np.zeros((size[1], 4), np.float32)
        return body

    def _follow_carrier(
        self, state: State, colliders: Colliders, dt: float, targets: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, RigidTransform | None]:
        """Let the state go along with what carries the cloth: the held vertices, else the body.

        Where the carrier was teleported, the whole garment goes with it, and colliders stand still in this frame.

        Returns:
            Primitives, fields and their values, the body's pose at the frame's start, and the transform of a teleport.
        """
        primitives, body, options = colliders.rows(state.origin), colliders.body or self._no_body, self.options
        fields, field_values = colliders.fields(state.origin)
        if targets is not None and len(self.model.held):
            before, after = state.position[self.model.held, :3], targets - state.origin
        elif colliders.body is not None and not len(self.model.held):
            before, after = body.previous, body.current
        else:
            return primitives, fields, field_values, body.previous, None
        transform = detect_teleport(before, after, self._summary.drift, dt)
        if transform is None:
            if min(options.linear_inertia, options.angular_inertia) < 1.0:
                scale_inertial_forces(state, before, after, options.linear_inertia, options.angular_inertia, dt)
                self._summary.read(state)
            return primitives, fields, field_values, body.previous, None
        state.position[:, :3] = transform.points(state.position[:, :3])
        state.velocity[:] = state.velocity @ transform.rotation.T
        self._summary.read(state)
        state.pair_sides[:, :3] = state.pair_sides[:, :3] @ transform.rotation.T
        primitives[:, 2:8] = primitives[:, 8:14]
        fields[:, MOTION] = 0.0
        return primitives, fields, field_values, body.current, transform

    def _check(
        self,
        state: State,
        targets: np.ndarray | None,
        wind: tuple[float, float, float] | np.ndarray,
        limit_targets: LimitTargets | None,
    ) -> None:
        """Refuse input that the kernels cannot take."""
        model = self.model
        for name, kind, shape in self._expected:
            array = getattr(state, name)
            if not (isinstance(array, np.ndarray) and array.shape == shape and array.dtype == kind):
                received = (
                    f"{array.dtype}, shape {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
                )
                expected = f"{kind}, shape {shape}"
                raise InputError("state of another model", key=f"state.{name}", received=received, expected=expected)
        self._summary.read(state)
        if not self._summary.is_finite:
            raise InputError("state is not finite", key="state", expected="finite positions and velocities")
        if targets is not None:
            floats(targets, "targets", (len(model.held), 3), "bad targets", unit=" [m]")
        floats(wind, "wind", [(3,), (model.vertex_count, 3)], "bad wind", unit=" [m/s]")
        for name, points in limit_targets._asdict().items() if limit_targets is not None else ():
            shape = (len(model.limits.vertices), 3)
            floats(points, f"limit_targets.{name}", shape, "bad limit targets", unit=" [m]")

    def follow(self, state: State, colliders: Colliders) -> np.ndarray:
        """Move the origin of state and body to the grid point nearest to the garment, and return it [m], shape (3,)."""
        self._summary.read(state)
        centre = self._summary.centre
        # Half a cell of slack keeps the origin from flickering between two grid points.
        if max(map(abs, centre.tolist())) > GRID and np.isfinite(centre).all():
            state.move_origin(state.origin + GRID * np.round(centre / GRID))
        if colliders.body is not None:
            colliders.body.move_origin(state.origin)
        return state.origin
