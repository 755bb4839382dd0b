"""What a player plays: a simulated garment, the surface that is shown of it, and how much of it is modelled."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from pbd import ModelOptions
from pbd.contact.colliders import Primitive
from runtime.play.detail_control import DetailControl
from runtime.play.fine_garment import FineGarment
from runtime.play.level_of_detail import LevelOfDetail
from runtime.play.moment import Moment
from runtime.play.plain_cloth import PlainCloth, middle_levels, plain_model
from runtime.play.plain_surface import PlainGarment, PlainSurface, SmoothGarment
from runtime.play.proxy_simulation import ProxySimulation
from runtime.play.shown_surface import Surface
from runtime.play.simulation import BodySource, Simulation
from runtime.play.transitions import Interpolation
from wrinkles.database import WrinkleDatabase
from wrinkles.levels import Levels
from wrinkles.proxy_mesh import proxy_mesh_of
from wrinkles.relaxation import PASSES

__all__ = ["PlayedGarment", "played_cloth", "played_scene", "played_wrinkles"]


@dataclass
class PlayedGarment:
    """A garment, or the garments that are worn together.

    Attributes:
        simulation: of the garment.
        surface: what is shown of it.
        between: its last two states.
        control: how much of it is modelled.
        rate_hz: rate of ticks [Hz].
        learned: the database and its meshes; None for the garments of a scene.
        start: the moment at which it begins; the player sets it.
    """

    simulation: Simulation
    surface: Surface
    between: Interpolation
    control: DetailControl
    rate_hz: float
    learned: tuple[WrinkleDatabase, Levels] | None = None
    start: Moment = field(init=False)


def played_wrinkles(
    database: WrinkleDatabase, source: BodySource, start: np.ndarray, primitives: Iterable[Primitive]
) -> PlayedGarment:
    """A garment with the wrinkles that a database has learned.

    Args:
        database: the garment and its wrinkles.
        source: the body that it was learned on.
        start: pose of the body.
        primitives: further colliders.
    """
    levels = database.levels(source.vertices, source.faces)
    rest = database.rest_shape.applied(levels.coarse)
    model = levels.model(database.fabric, database.options, bend_factor=database.bend_factor, mesh=rest)
    simulation = Simulation(model, levels.coarse_attachment, source, start, database.solver, primitives)
    surface, between = FineGarment(database, levels, source), Interpolation(simulation)
    substeps = max(1, int(np.ceil(1.0 / (database.frame_rate * database.solver.substep) - 1e-6)))
    full = LevelOfDetail(1, substeps, len(database.atoms.shapes), PASSES)

    def below() -> ProxySimulation | None:
        proxy = proxy_mesh_of(levels, database.warp)
        if proxy is None:
            return None
        return ProxySimulation(proxy, simulation, database.options, source.vertices, levels.coarse_attachment)

    control = DetailControl(simulation, surface, between, full, database.frame_rate, below)
    return PlayedGarment(simulation, surface, between, control, database.frame_rate, (database, levels))


def played_cloth(
    database: WrinkleDatabase,
    source: BodySource,
    start: np.ndarray,
    primitives: Iterable[Primitive],
    cloth: PlainCloth,
) -> PlayedGarment:
    """The garment of a database as plain cloth.

    The coarse vertices of the database are the first ones of the simulated mesh.

    Args:
        database: the garment.
        source: the body that it was learned on.
        start: pose of the body.
        primitives: further colliders.
        cloth: what is simulated.

    Raises:
        InputError: a plain cloth that is not there.
    """
    cloth.check(database)
    levels = database.levels(source.vertices, source.faces)
    if cloth.cuts == database.subdivisions:
        model = levels.model(database.fabric, ModelOptions(pressure=database.options.pressure), fine=True)
        attachment, surface = levels.fine_attachment, PlainGarment(levels.subdivision, None)
    else:
        simulated = levels if cloth.cuts == 0 else middle_levels(database, source, cloth.cuts)
        assert simulated is not None
        model, attachment = plain_model(database, simulated), simulated.coarse_attachment
        at_rest = PlainSurface(simulated, database.fabric, database.bend_factor, source, cloth.passes)
        surface = PlainGarment(levels.subdivision, simulated.subdivision, at_rest)
    solver = replace(database.solver, substep=1.0 / (database.frame_rate * cloth.substeps))
    simulation = Simulation(model, attachment, source, start, solver, primitives)
    between, full = Interpolation(simulation), LevelOfDetail(1, cloth.substeps, 0, cloth.passes)
    control = DetailControl(simulation, surface, between, full, database.frame_rate)
    return PlayedGarment(simulation, surface, between, control, database.frame_rate, (database, levels))


def played_scene(simulation: Simulation, rate_hz: float) -> PlayedGarment:
    """The garments of a scene as they are simulated, on a body or without one.

    Args:
        simulation: of the garments, at its start.
        rate_hz: rate of ticks [Hz].
    """
    surface, between = SmoothGarment(simulation.model.mesh), Interpolation(simulation)
    substeps = max(1, round(1.0 / (rate_hz * simulation.solver.options.substep)))
    control = DetailControl(simulation, surface, between, LevelOfDetail(1, substeps, 0, 0), rate_hz)
    return PlayedGarment(simulation, surface, between, control, rate_hz)
