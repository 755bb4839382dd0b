"""Other engines: those that pip installs with the extra ``rivals``, on the swinging square and on other cloth.

Each takes the same vertices, faces and masses, starts from the same rest and is judged by the same limits. Stiffness
and steps, which every engine defines in its own way, are tried at a few values about the cheapest that gave mean and
worst stretches of 1 % and 5 % elsewhere.
"""

import importlib.util
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from pbd import InputError, Model
from precompute.experiment.measures import FRAME_RATE, GRAVITY
from precompute.experiment.swinging_square import SquareFigures, SquareRun, hanging_square, measure_steps
from precompute.scratch import scratch_folder

__all__ = ["ENGINES", "accurate", "bench_engines", "start_engine"]

SIDE = 64  # vertices along a side
BLENDER = 160.0  # its stiffness for E h = 1e5 N/m at 64 by 64; it has no unit that would give it for another fabric
SPRING = 0.75  # stiffness of an edge over E h, as in the square lattice of natural lengths

Steps = tuple[Callable[[], None], Callable[[], np.ndarray]]


def _position_based_dynamics(garment: Model, substeps: int) -> Steps:
    """Library PositionBasedDynamics, XPBD distances of 1e5 N/m, one iteration a substep."""
    import pypbd as pbd  # pyright: ignore[reportMissingImports]

    simulation = pbd.Simulation.getCurrent()
    simulation.initDefault()
    model = simulation.getModel()
    mesh = garment.mesh
    cloth = model.addTriangleModel(list(mesh.vertices), mesh.faces.ravel().tolist(), [], [], False)
    particles = model.getParticles()
    for i, mass in enumerate(garment.mass):
        particles.setMass(i, 0.0 if garment.inverse_mass[i] == 0 else float(mass))
    model.addClothConstraints(cloth, 4, 1e5, 1.0, 1.0, 1.0, 0.3, 0.3, False, False)
    controller = simulation.getTimeStep()
    controller.setValueUInt(pbd.TimeStepController.NUM_SUB_STEPS, substeps)
    controller.setValueUInt(pbd.TimeStepController.MAX_ITERATIONS, 1)
    pbd.TimeManager.getCurrent().setTimeStepSize(1.0 / FRAME_RATE)
    return lambda: controller.step(model), lambda: np.array(particles.getVertices(), float).reshape(-1, 3)


def _newton_xpbd(cloth: Model, substeps: int, stiffness: float) -> Steps:
    """Newton's XPBD on the processor: springs along all edges, one iteration a substep."""
    import newton  # pyright: ignore[reportMissingImports]
    import warp  # pyright: ignore[reportMissingImports]

    warp.config.quiet = True
    warp.set_device("cpu")
    mesh, inverse_mass = cloth.mesh, cloth.inverse_mass
    builder = newton.ModelBuilder(up_axis=newton.Axis.Y, gravity=(0.0, -GRAVITY, 0.0))
    for x, mass, inverse in zip(mesh.vertices, cloth.mass, inverse_mass, strict=True):
        builder.add_particle(warp.vec3(*x), warp.vec3(0.0), float(mass) if inverse > 0 else 0.0, radius=1e-4)
    for i, j in mesh.edge_lengths()[0]:
        builder.add_spring(int(i), int(j), stiffness, 0.0, 0.0)
    model = builder.finalize(device="cpu")
    solver = newton.solvers.SolverXPBD(model, iterations=1, soft_body_relaxation=0.9)
    states = [model.state(), model.state()]

    def step() -> None:
        for _ in range(substeps):
            states[0].clear_forces()
            solver.step(states[0], states[1], None, None, 1.0 / (FRAME_RATE * substeps))
            states.reverse()

    return step, lambda: states[0].particle_q.numpy().astype(float)


def _mujoco(cloth: Model, young: float, iterations: int) -> Steps:
    """MuJoCo's elastic sheet with one implicit step a frame."""
    import mujoco  # pyright: ignore[reportMissingImports]

    mesh, held = cloth.mesh, cloth.held
    numbers = lambda values: " ".join(f"{value:.9g}" for value in np.ravel(values))  # noqa: E731
    text = f"""<mujoco><option timestep="{1 / FRAME_RATE:.9f}" gravity="0 {-GRAVITY} 0" solver="CG" tolerance="1e-3"
        iterations="{iterations}" integrator="discrete"><flag contact="disable"/></option>
        <size memory="2G"/><worldbody><flexcomp name="cloth" type="direct" dim="2" mass="{cloth.mass.sum():.9g}"
        radius="0.001" point="{numbers(mesh.vertices)}" element="{numbers(mesh.faces)}">
        <pin id="{numbers(held)}"/><contact selfcollide="none"/>
        <elasticity young="{young}" poisson="0.3" thickness="0.001" elastic2d="stretch" damping="1e-4"/>
        </flexcomp></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return lambda: mujoco.mj_step(model, data), lambda: data.flexvert_xpos.reshape(-1, 3).copy()


def _pybullet(garment: Model, substeps: int, stiffness: float) -> Steps:
    """PyBullet's deformable mass-spring cloth."""
    import pybullet  # pyright: ignore[reportMissingImports]

    mesh = garment.mesh
    client = pybullet.connect(pybullet.DIRECT)
    pybullet.resetSimulation(pybullet.RESET_USE_DEFORMABLE_WORLD, physicsClientId=client)
    pybullet.setGravity(0.0, -GRAVITY, 0.0, physicsClientId=client)
    pybullet.setTimeStep(1.0 / (FRAME_RATE * substeps), physicsClientId=client)
    with scratch_folder() as folder:
        path = folder / "cloth.obj"
        lines = [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in mesh.vertices]
        path.write_text("\n".join([*lines, *(f"f {a} {b} {c}" for a, b, c in mesh.faces + 1)]), encoding="utf-8")
        cloth = pybullet.loadSoftBody(
            str(path), mass=float(garment.mass.sum()), useMassSpring=1, useBendingSprings=0, useNeoHookean=0,
            springElasticStiffness=stiffness, springDampingStiffness=0.1, springBendingStiffness=0.0,
            springDampingAllDirections=0, useSelfCollision=0, physicsClientId=client,
        )  # fmt: skip
    for vertex in garment.held:
        pybullet.createSoftBodyAnchor(cloth, int(vertex), -1, -1, physicsClientId=client)

    def step() -> None:
        for _ in range(substeps):
            pybullet.stepSimulation(physicsClientId=client)

    def world() -> np.ndarray:
        data = pybullet.getMeshData(cloth, -1, flags=pybullet.MESH_DATA_SIMULATION_MESH, physicsClientId=client)
        return np.array(data[1], float)

    return step, world


def _blender(garment: Model, steps: int, stiffness: float) -> Steps:
    """Blender's cloth modifier: implicit mass-spring with the mass of a vertex that it comes with.

    Its stiffness goes with that mass; with that of a real vertex its solver stops before the cloth has moved.
    """
    import bpy  # pyright: ignore[reportMissingImports]

    mesh = garment.mesh
    bpy.ops.wm.read_factory_settings(use_empty=True)
    world = bpy.context.scene
    world.render.fps, world.gravity = int(FRAME_RATE), (0.0, -GRAVITY, 0.0)
    shape = bpy.data.meshes.new("cloth")
    shape.from_pydata(mesh.vertices.tolist(), [], mesh.faces.tolist())
    item = bpy.data.objects.new("cloth", shape)
    world.collection.objects.link(item)
    item.vertex_groups.new(name="held").add(garment.held.tolist(), 1.0, "REPLACE")
    cloth = item.modifiers.new("cloth", "CLOTH")
    cloth.point_cache.frame_end = 1_000_000
    cloth.collision_settings.use_collision = False
    settings = cloth.settings
    settings.quality, settings.mass = steps, 0.3
    settings.tension_stiffness = settings.compression_stiffness = settings.shear_stiffness = stiffness
    settings.bending_stiffness = settings.air_damping = settings.bending_damping = 0.01
    settings.tension_damping = settings.compression_damping = settings.shear_damping = 0.1
    settings.vertex_group_mass = "held"
    world.frame_set(1)

    def vertices() -> np.ndarray:
        moved = item.evaluated_get(bpy.context.evaluated_depsgraph_get()).data.vertices
        found = np.zeros(3 * len(moved), np.float32)
        moved.foreach_get("co", found)
        return found.reshape(-1, 3).astype(float)

    return lambda: world.frame_set(world.frame_current + 1), vertices


@dataclass(frozen=True)
class Engine:
    """How an engine is installed and set.

    Attributes:
        name: for people.
        module: that it is imported as.
        start: gives it a cloth.
        settings: that are tried on the swinging square.
        options: of its start for another cloth, from E h [N/m], substeps and passes.
    """

    name: str
    module: str
    start: Callable[..., Steps]
    settings: Sequence[Mapping[str, Any]]
    options: Callable[[float, int, int], Mapping[str, Any]]


# By the names of their packages.
ENGINES = MappingProxyType({
    "newton": Engine(
        "Newton XPBD", "newton", _newton_xpbd, [{"substeps": n, "stiffness": 1e3} for n in (150, 200, 260)],
        lambda modulus, n, k: {"substeps": n, "stiffness": SPRING * modulus},
    ),
    "pypbd": Engine(
        "PositionBasedDynamics", "pypbd", _position_based_dynamics, [{"substeps": n} for n in (80, 110, 140)],
        lambda modulus, n, k: {"substeps": n},
    ),
    "bpy": Engine(
        "Blender", "bpy", _blender, [{"steps": n, "stiffness": k} for n, k in ((1, 160.0), (1, 240.0), (2, 160.0))],
        lambda modulus, n, k: {"steps": n, "stiffness": BLENDER},
    ),
    "mujoco": Engine(
        "MuJoCo, elastic", "mujoco", _mujoco,
        [{"young": e, "iterations": n} for e, n in ((1e6, 100), (2e6, 100), (4e6, 200))],
        lambda modulus, n, k: {"young": modulus / 1e-3, "iterations": k},
    ),
    "pybullet": Engine(
        "PyBullet", "pybullet", _pybullet, [{"substeps": n, "stiffness": 1500.0} for n in (140, 180)],
        lambda modulus, n, k: {"substeps": n, "stiffness": SPRING * modulus},
    ),
})  # fmt: skip
BENCHED = ("pypbd", "newton", "mujoco", "bpy", "pybullet")  # in this order


def accurate(found: SquareFigures) -> bool:
    """Mean stretch below 1 % and worst below 5 %, the limits that the quoted points were found with."""
    return found.mean < 0.01 and found.worst < 0.05


def start_engine(name: str, model: Model, substeps: int | None, passes: int | None) -> Steps:
    """An engine with a cloth: functions that advance it by a frame of 1/60 s and give its vertices [m], shape (n, 3).

    Bending and air are left out; `mujoco` takes one step a frame and reads passes, the others read substeps.

    Raises:
        InputError: the engine is not installed.
    """
    engine = ENGINES[name]
    if importlib.util.find_spec(engine.module) is None:
        raise InputError("not installed", key="--methods", received=name, expected="pip install 'gube[rivals]'")
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    modulus = float(np.sqrt(model.fabric.stretch_warp * model.fabric.stretch_weft))
    return engine.start(model, **engine.options(modulus, substeps or 20, passes or 100))


def bench_engines(report: Callable[[str], None] = lambda line: None) -> list[SquareRun]:
    """Measure the engines on the square; many minutes.

    Args:
        report: called with a line of progress.

    Raises:
        InputError: an engine that is not installed.
    """
    engines = [ENGINES[name] for name in BENCHED]
    missing = [engine.name for engine in engines if importlib.util.find_spec(engine.module) is None]
    if missing:
        raise InputError(
            "engines that are not installed", key="rivals", received=missing, expected="pip install 'gube[rivals]'"
        )
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    cloth, runs = hanging_square(SIDE), []
    for engine in engines:
        for setting in engine.settings:
            words = ", ".join(f"{key} {value:g}" for key, value in setting.items())
            report(f"{engine.name}: {words}")
            found = measure_steps(cloth, *engine.start(cloth, **setting))
            runs.append(SquareRun(engine.name, SIDE, words, found, accurate(found)))
    return runs
