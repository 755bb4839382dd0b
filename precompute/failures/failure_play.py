"""Small scenes of cloth in difficulties, and the error class in which a solver ends them.

They need no reference run: strain counts from the rest shape, speed from a free fall of the garment's height, depth
from the colliders' surfaces.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pbd import (
    ClothMesh,
    Colliders,
    Fabric,
    Model,
    ModelOptions,
    Solver,
    SolverOptions,
    State,
    build_model,
)
from pbd.models.registry import AnySolver, make_solver
from pbd.models.stepping import Options
from precompute.experiment.error_classes import (
    LIMITS,
    START,
    ErrorClass,
    Recorded,
    classify,
    deviations,
)
from precompute.experiment.measures import (
    FRAME_RATE,
    GRAVITY,
    TimedSteps,
    deepest,
    edge_strain,
    mechanical_energy,
    typical_ms,
)

__all__ = ["MAX_RUN_S", "FailureOutcome", "FailureScene", "FrameConditions", "play"]

# Processor time of a run without its first frame, which compiles; one that takes longer is judged up to there [s].
MAX_RUN_S = 30.0
THROUGH_DEPTH = 10.0  # depth of cloth that has gone through something [thicknesses]


@dataclass
class FrameConditions:
    """The conditions of a frame, which a scene may change before it.

    Attributes:
        time: at the frame's start [s].
        dt: of the frame [s].
        targets: of the held vertices [m], shape (p, 3).
        wind: [m/s].
        colliders: that the cloth meets.
        fabric: of the cloth from here on.
    """

    time: float
    dt: float
    targets: np.ndarray
    wind: tuple[float, float, float]
    colliders: Colliders
    fabric: Fabric


@dataclass(frozen=True)
class FailureScene:
    """Cloth in a known difficulty.

    Attributes:
        line: the failure, in the words of the list.
        name: of the scene; a line may have several.
        mesh: whose vertices are its rest shape in space.
        fabric: that it is made of.
        held: vertices that follow targets.
        start: positions [m], shape (n, 3); None starts from the rest shape.
        velocity: of all vertices at the start [m/s].
        seconds: of the run.
        colliders: makes them anew.
        direct: called before every frame.
        quiet: when the disturbance is over [s]; depth counts from then, strain from a second later.
        speed: fastest collider, pin, wind or vertex at the start [m/s].
        gravity: [m/s2].
        truth: exact positions at a time [m], shape (n, 3).
        free: nothing gives energy to the cloth.
        at_rest: the end is meant to be at rest.
        through: whether cloth has gone through something, of positions [m], shape (n, 3).
        build: makes the model; None takes the mesh as it is.
        self_collision: asked of the default solver, the only one that has it.
        default_only: other solvers cannot take the scene.
    """

    line: str
    name: str
    mesh: ClothMesh
    fabric: Fabric = field(default_factory=Fabric)
    held: Sequence[int] = ()
    start: np.ndarray | None = None
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    seconds: float = 2.0
    colliders: Callable[[], Colliders] = Colliders
    direct: Callable[[FrameConditions], None] = lambda stage: None
    quiet: float = 0.0
    speed: float = 0.0
    gravity: float = GRAVITY
    truth: Callable[[float], np.ndarray] | None = None
    free: bool = False
    at_rest: bool = False
    through: Callable[[np.ndarray], bool] | None = None
    build: Callable[[Fabric], Model] | None = None
    self_collision: bool = False
    default_only: bool = False

    def model(self, fabric: Fabric) -> Model:
        """The cloth in a fabric."""
        if self.build is not None:
            return self.build(fabric)
        return build_model(self.mesh, fabric, np.array(self.held, int), options=ModelOptions(), bend_factor=1 / 3)


@dataclass(frozen=True)
class FailureOutcome:
    """How a scene ended.

    Attributes:
        figures: by the names of :data:`precompute.experiment.error_classes.LIMITS`.
        recovered_s: from the end of the disturbance to the last instant that is not acceptable [s]; infinite if that
            is the run's end.
        frame_ms: processor time of a frame, median [ms].
        note: why it stopped before its end, if it did.
    """

    figures: dict[str, float]
    recovered_s: float
    frame_ms: float
    note: str = ""

    @property
    def worst(self) -> tuple[ErrorClass, str]:
        """The class in which it ends, and the figure that says so."""
        classes = classify(self.figures)
        name = max(classes, key=lambda key: (classes[key], self.figures[key] / max(LIMITS[key][0], 1e-3)))
        return classes[name], name

    def cut(self, reached: float, seconds: float) -> FailureOutcome:
        """The same of a run that was so slow that it is judged up to a moment before its end [s]."""
        return replace(self, note=f"{self.worst[1]} (judged up to {reached:.2g} of {seconds:g} s: slow)")


def solver_for(scene: FailureScene, name: str, model: Model) -> AnySolver:
    """A solver by name with its default options."""
    gravity = (0.0, -scene.gravity, 0.0)
    if name == "default":
        return Solver(model, SolverOptions(gravity=gravity, self_collision=scene.self_collision))
    return make_solver(name, model, Options(gravity=gravity))


def play(scene: FailureScene, solver: str = "default") -> FailureOutcome:
    """Run a scene with a solver of :data:`pbd.models.registry.SOLVERS`.

    Raises:
        InputError: no such solver.
    """
    model = scene.model(scene.fabric)
    state = State.at_rest(model, scene.start)
    state.velocity[:] = np.where(model.inverse_mass[:, None] > 0.0, np.array(scene.velocity), 0.0)
    stage = FrameConditions(
        0.0, 1.0 / FRAME_RATE, state.world()[model.held], (0.0, 0.0, 0.0), scene.colliders(), scene.fabric
    )
    frame = TimedSteps(_frame_of(scene, solver, model))
    seen: list[tuple[float, np.ndarray, np.ndarray, float]] = []
    finite = True
    while stage.time < scene.seconds - 1e-9 and finite and not sum(frame.times[1:]) > MAX_RUN_S:
        before = stage.fabric
        scene.direct(stage)
        if stage.fabric is not before:
            model = scene.model(stage.fabric)
            frame.step = _frame_of(scene, solver, model)
        if not frame(state, stage):
            break
        stage.time += max(stage.dt, 1e-4)  # a frame without time passes all the same
        x = state.world()
        finite = bool(np.isfinite(x).all() and np.isfinite(state.velocity).all())
        seen.append((stage.time, x, state.velocity.astype(float), _depth(scene, stage, x) if finite else np.inf))
    note = frame.problem if finite else "not finite"
    frame_ms = typical_ms(frame.times, np.inf)
    if note or not seen:
        return FailureOutcome({"not_finite": 1.0}, np.inf, frame_ms, note)
    cut = stage.time < scene.seconds - 1e-9
    outcome = _judged(replace(scene, at_rest=scene.at_rest and not cut), model, seen, frame_ms)
    return outcome.cut(stage.time, scene.seconds) if cut else outcome


def _frame_of(scene: FailureScene, name: str, model: Model) -> Callable[[State, FrameConditions], None]:
    """A function that makes a frame with a solver."""
    solver = solver_for(scene, name, model)

    def frame(state: State, stage: FrameConditions) -> None:
        solver.follow(state, stage.colliders)
        solver.step(state, stage.colliders, stage.dt, stage.targets, stage.wind)

    return frame


def _depth(scene: FailureScene, stage: FrameConditions, x: np.ndarray) -> float:
    """Deepest vertex under a collider's surface [m]."""
    if stage.time < scene.quiet:
        return 0.0
    if scene.through is not None and scene.through(x):
        return THROUGH_DEPTH * stage.fabric.thickness
    return float(deepest(stage.colliders.primitives, x[None])[0])


def _judged(scene: FailureScene, model: Model, seen: Sequence[tuple], frame_ms: float) -> FailureOutcome:
    """Figures of a run beside cloth that lies in its rest shape."""
    moments = np.array([row[0] for row in seen])
    position, velocity = np.stack([row[1] for row in seen]), np.stack([row[2] for row in seen])
    depth = np.array([row[3] for row in seen])
    dt = 1.0 / FRAME_RATE
    energy = None
    if scene.free:
        energy, _ = mechanical_energy(model.mass, position, velocity, scene.gravity)
    edges, rest_lengths = model.mesh.edge_lengths()
    rest = Recorded(np.broadcast_to(model.mesh.vertices, position.shape), np.zeros_like(velocity), dt, energy)
    run = Recorded(position, velocity, dt, energy, depth, scene.at_rest)
    thickness = model.fabric.thickness
    figures = deviations(run, rest, edges, rest_lengths, thickness, scene.speed, chaotic=True)
    strain = edge_strain(position, edges, rest_lengths)
    # Coarse cloth may shorten instead of buckling, but must not be longer than it is.
    # A gust or a blow stretches any cloth: only when it has been over for a second is the length a mistake.
    judged = moments >= min(max(START, scene.quiet + 1.0 if scene.quiet else 0.0), moments[-1])
    figures["edge_strain_p95"] = float(np.percentile(np.maximum(strain, 0.0)[judged], 95))
    figures["edge_strain_max"] = figures["edge_strain_beyond"] = float(strain[judged].max())
    figures.pop("energy_error", None)
    if scene.truth is not None:
        true = np.stack([scene.truth(moment) for moment in moments])
        figures["position_px"] = deviations(
            replace(run, at_rest=False), replace(rest, position=true), edges, rest_lengths, thickness
        )["position_px"]
    height = np.ptp(model.mesh.vertices, axis=0).max()
    fastest = 3.0 * np.sqrt(2.0 * GRAVITY * height) + scene.speed
    bad = (
        (np.percentile(strain, 95, axis=1) > LIMITS["edge_strain_p95"][1])
        | (strain.max(axis=1) > LIMITS["edge_strain_max"][1])
        | (depth > thickness)
        | (np.linalg.norm(velocity, axis=2).max(axis=1) > fastest)
    ) & (moments > scene.quiet)
    recovered = 0.0
    if bad.any():
        last = int(np.flatnonzero(bad)[-1])
        recovered = np.inf if last == len(bad) - 1 else float(moments[last] - scene.quiet)
    return FailureOutcome(figures, recovered, frame_ms)
