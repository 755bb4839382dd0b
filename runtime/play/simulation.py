"""A garment, on an animated body or without one: one solver, one state, one body, moved by poses."""

from __future__ import annotations

from collections.abc import Iterable
from copy import copy
from typing import Any, Protocol

import numpy as np

from assets.character import Character
from assets.io.sequence import Sequence, SequenceBody
from assets.motion import Motion
from assets.skinning import SkinnedBody
from pbd import Body, Colliders, InputError, Model, Solver, SolverOptions, State
from pbd.arrays import floats
from pbd.attachment import Attachment
from pbd.contact.colliders import Primitive
from pbd.limits import LimitTargets, SkinnedTargets
from pbd.wind import CALM, Air, Wind
from runtime.play.input_checks import check_drag, check_step
from runtime.play.redressing import Redressing

__all__ = ["BodySource", "Simulation", "body_source", "poses_of"]

CLOSING_SPEED = 0.5  # of stitches that are closed while a garment is played [m/s]
OPEN = 1e3  # gap of a stitch that is open [m]


class BodySource(Protocol):
    """A body that poses move: a skinned character or a vertex sequence.

    Attributes:
        vertices: in the bind pose [m], shape (b, 3).
        faces: int, shape (k, 3).
        pose_shape: shape of a pose.
    """

    vertices: np.ndarray
    faces: np.ndarray

    @property
    def pose_shape(self) -> tuple[int, ...]: ...

    def skin(self, pose: np.ndarray, origin: np.ndarray, out: np.ndarray) -> None:
        """Write the posed vertices, world less origin [m], float32, shape (n, 3)."""
        ...


def body_source(body: Character | Sequence) -> SkinnedBody | SequenceBody:
    """The object that poses a body."""
    return SkinnedBody(body) if isinstance(body, Character) else SequenceBody(body)


def poses_of(motion: Motion, dt: float, seconds: float | None = None) -> np.ndarray:
    """Poses of a motion every ``dt`` [s], from 0 to its end or to ``seconds``: shape (frames + 1, ...)."""
    duration = motion.duration if seconds is None else min(seconds, motion.duration)
    return np.stack([motion.pose(i * dt) for i in range(int(np.floor(duration / dt + 1e-6)) + 1)])


class Simulation:
    """Steps one garment along with the poses of a body, or without a body: held vertices then stay where they are.

    Args:
        model: the garment, coarse or fine.
        attachment: holds the garment's held vertices to the body; None without a body.
        source: the body, or None.
        pose: pose of the body at the start: its bind pose, moved as a whole; None without a body.
        options: options of the solver.
        primitives: further colliders.

    Attributes:
        state: state of the garment.
        body: the mesh that the garment collides with; without a body it has no faces.
        time: time since the start, at which turbulent wind is taken [s].
        redressing: puts the garment back on its body where it is hooked through it; None without a body.

    Raises:
        InputError: a body without a pose, or with that of another body.
    """

    def __init__(
        self,
        model: Model,
        attachment: Attachment | None = None,
        source: BodySource | None = None,
        pose: np.ndarray | None = None,
        options: SolverOptions | None = None,
        primitives: Iterable[Primitive] = (),
    ) -> None:
        if source is not None and pose is None:
            raise InputError("a body without a pose", key="pose", expected="where the body is at the start")
        if source is None and pose is not None:
            raise InputError("a pose without a body", key="pose", expected="a body")
        if source is not None:
            pose = floats(pose, "pose", source.pose_shape, "bad pose")
        self.model, self.attachment, self.source = model, attachment, source
        self.solver = Solver(model, options)
        vertices = model.mesh.vertices
        if pose is not None and pose.shape[1:] == (3, 4):  # from the bind pose, moved along with the root
            vertices = vertices @ pose[0, :, :3].T + pose[0, :, 3]
        self.state = State.at_rest(model, vertices)
        self.body = Body(source.faces, len(source.vertices)) if source else Body(np.zeros((0, 3), np.int32), 1)
        self.colliders = Colliders(tuple(primitives), self.body if source else None)
        self.time = 0.0
        self._stitch_gaps, self._opened = model.stitch_gaps.copy(), np.zeros(len(model.stitch_gaps), bool)
        self._before, self._alpha = self.state.world(), 1.0
        self._skinned_targets = self._bind(model)
        self.redressing = Redressing(model, source.vertices, source.faces) if source else None
        if pose is not None:
            self.place_body(pose)

    def beside(self, model: Model, attachment: Attachment | None) -> Simulation:
        """Another model of the garment on the same body, which both move."""
        other = copy(self)
        other.model, other.attachment = model, attachment
        other.solver, other.state = Solver(model, self.solver.options), State.at_rest(model)
        other._before, other._alpha = other.state.world(), 1.0
        other._stitch_gaps, other._opened = model.stitch_gaps.copy(), np.zeros(len(model.stitch_gaps), bool)
        other._skinned_targets = self._bind(model)
        if self.source is not None:
            other.redressing = Redressing(model, self.source.vertices, self.source.faces)
        return other

    def _bind(self, model: Model) -> SkinnedTargets | None:
        if self.source is None or not len(model.limits.vertices):
            return None
        return SkinnedTargets(
            model.limits, model.mesh.vertices, model.mesh.faces, self.source.vertices, self.source.faces
        )

    def place_body(self, pose: np.ndarray) -> None:
        """Put the body into a pose without motion, about the garment's origin.

        Raises:
            InputError: no body, or a pose of another one or not finite.
        """
        if self.source is None:
            raise InputError("a pose without a body", key="pose", expected="a body")
        pose = floats(pose, "pose", self.source.pose_shape, "bad pose")
        self.body.origin = self.state.origin.copy()
        self.source.skin(pose, self.state.origin, self.body.current)
        self.body.place(self.body.current.copy())

    @property
    def vertices(self) -> np.ndarray:
        """The garment in the world [m], float64, shape (n, 3): after the last step, or as :meth:`decode` chose."""
        world = self.state.world()
        return world if self._alpha == 1.0 else self._before + self._alpha * (world - self._before)

    def decode(self, alpha: float = 1.0) -> None:
        """Choose the moment that :attr:`vertices` shows: a :class:`runtime.play.game_loop.GameLoop` can play this.

        Args:
            alpha: 0 for the state before the last step, 1 for the one after it, in between interpolated.
        """
        self._alpha = alpha

    def step(self, pose: np.ndarray | None = None, dt: float = 1.0 / 60.0, wind: Air = CALM) -> None:
        """Bring body and garment to the end of a frame.

        Args:
            pose: of the body at the end of the frame; None without a body.
            dt: frame time [s].
            wind: velocity of the air [m/s].

        Raises:
            InputError: a body without a pose, a pose of another body or not finite, and as :meth:`pbd.Solver.step`.
        """
        check_step(None, (), dt)
        self._before, self._alpha = self.state.world(), 1.0
        self.pose_body(pose)
        self.step_cloth(dt, wind)

    def pose_body(self, pose: np.ndarray | None) -> None:
        """Skin the body to ``pose``; its last pose becomes the start of the frame.

        Raises:
            InputError: a body without a pose, or a pose of another body or not finite; then nothing has changed.
        """
        if self.source is None:
            self.solver.follow(self.state, self.colliders)
            return
        if pose is None:
            raise InputError("a body without a pose", key="pose", expected="where the body is at the end of the frame")
        pose = floats(pose, "pose", self.source.pose_shape, "bad pose")
        origin = self.solver.follow(self.state, self.colliders)
        body = self.body
        body.begin_pose()
        self.source.skin(pose, origin, body.current)
        body.finish_pose()

    def step_cloth(self, dt: float, wind: Air = CALM) -> None:
        """Advance the garment while the body goes from its last pose to the current one."""
        if self.redressing is not None and self.redressing.step(self.state, self.body, dt):
            self.time += dt
            return
        self.solver.step(
            self.state, self.colliders, dt, *self._carried(dt, wind), stitch_gaps=self._next_stitch_gaps(dt)
        )

    def fasten(self, number: int, closed: bool) -> None:
        """Close or open what fastens a garment of an outfit to those below it.

        The two sides of a closing come together at :data:`CLOSING_SPEED`.

        Args:
            number: of the garment, from the innermost, 0, outwards.
            closed: whether it is fastened from now on.
        """
        layer, (v, a, b) = self.model.layer, self.model.stitches.T
        rows = (layer[v] == number) & (layer[a] != number)
        self._opened[rows] = not closed
        if closed:
            x, w = self.state.position[:, :3], self.model.stitch_weights[rows, None]
            apart = (1.0 - w) * x[a[rows]] + w * x[b[rows]] - x[v[rows]]
            self._stitch_gaps[rows] = np.maximum(np.linalg.norm(apart, axis=1), self.model.stitch_gaps[rows])

    @property
    def any_open(self) -> bool:
        """Whether anything that fastens a garment to those below it is open."""
        return bool(self._opened.any())

    def _next_stitch_gaps(self, dt: float) -> tuple[np.ndarray, np.ndarray] | None:
        """How far stitches may be open at the start and at the end of a step; None where all are as in the model."""
        before, closed = self._stitch_gaps, self.model.stitch_gaps
        if not self.any_open and np.array_equal(before, closed):
            return None
        after = np.maximum(before - np.float32(CLOSING_SPEED * dt), closed)
        after[self._opened] = OPEN
        self._stitch_gaps = after
        return np.where(self._opened, after, before), after

    def _carried(self, dt: float, wind: Air = CALM) -> tuple[np.ndarray | None, Any, LimitTargets | None]:
        """What carries the garment in a step that ends at the body's current pose; the time goes on by it.

        Returns:
            targets, wind and limit targets, as :meth:`pbd.Solver.step` takes them.
        """
        targets = None
        if self.attachment is not None:
            targets = self.attachment.targets(self.body.current) + self.state.origin
        limit_targets = None
        if self._skinned_targets is not None:
            previous = self.body.previous if dt > 0.0 else self.body.current
            limit_targets = self._skinned_targets.targets(previous, self.body.current, self.state.origin)
        self.time += dt
        if isinstance(wind, Wind):  # without turbulence it is the same everywhere
            wind = wind.at(self.state.world() if wind.turbulence else np.zeros((1, 3)), self.time)
        return targets, wind, limit_targets

    def drag(self, vertex: int, target: np.ndarray | None) -> None:
        """Hold a vertex at a point in the world [m], shape (3,); None lets it go.

        Raises:
            InputError: no such vertex, or a bad target.
        """
        vertex = check_drag(vertex, target, self.model.vertex_count)
        if target is None:
            self.state.position[vertex, 3] = self.model.inverse_mass[vertex]
            return
        self.state.position[vertex, 3] = 0.0
        self.state.position[vertex, :3] = np.asarray(target, float) - self.state.origin
        self.state.velocity[vertex] = 0.0
