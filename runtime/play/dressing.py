"""Garments of an outfit that are put on or taken off while it is played: what goes over from one set to the next."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pbd import InputError
from pbd.attachment import Attachment
from runtime.play.played_garment import PlayedGarment
from runtime.play.simulation import Simulation
from wrinkles.database import WrinkleDatabase
from wrinkles.levels import Levels
from wrinkles.worn_garments import garment_names

__all__ = ["Stay", "Wardrobe", "place_on_body", "settle", "take_over"]

SETTLING_STEPS = 20  # in which a garment that was put on finds its place on the body and over the garments below it
SETTLING_TIME = 1.0 / 60.0  # of each of them [s]
INTERNAL_FRICTION = (("plastic_bends", "hinges", "hinge_numbers"), ("plastic_shears", "triangles", "triangle_numbers"))
"""What a state remembers of creases, the constraints that have them, and the place of each in the state."""


class Stay(NamedTuple):
    """Vertices of the garments that stay on, and the same ones before.

    Attributes:
        coarse, before: rows of the coarse mesh now and before, int, shape (k,).
        fine, fine_before: rows of the fine mesh now and before, int, shape (K,).
        new: coarse vertices of the garments that were put on, int, shape (p,).
    """

    coarse: np.ndarray
    before: np.ndarray
    fine: np.ndarray
    fine_before: np.ndarray
    new: np.ndarray

    @classmethod
    def between(cls, before: WrinkleDatabase, now: WrinkleDatabase) -> Stay:
        """What stays on from one set of garments to another of the same outfit."""
        both = set(garment_names(before)) & set(garment_names(now))
        (coarse, fine), (coarse_before, fine_before) = (_members(part, both) for part in (now, before))
        new = np.setdiff1d(np.arange(len(now.coarse_vertices)), coarse)
        return cls(coarse, coarse_before, fine, fine_before, new)


def _members(database: WrinkleDatabase, names: set[str]) -> tuple[np.ndarray, np.ndarray]:
    """Coarse and fine vertices of some garments, ascending."""
    if database.layers is None:
        coarse, fine = np.arange(len(database.coarse_vertices)), np.arange(database.fine_vertex_count)
        return (coarse, fine) if database.garment_name in names else (coarse[:0], fine[:0])
    numbers = [number for number, name in enumerate(database.layers.names) if name in names]
    fine = database.layers.subdivided(database.subdivision).layer
    return np.flatnonzero(np.isin(database.layers.layer, numbers)), np.flatnonzero(np.isin(fine, numbers))


def take_over(before: Simulation, now: Simulation, stay: Stay) -> None:
    """Bring a simulation to the place and time of another, on the same body, and the garments that stay on to theirs.

    A dragged vertex is let go, and a garment that is put on has no creases.
    """
    state, old = now.state, before.state
    now.body, now.colliders, now.time = before.body, before.colliders, before.time
    state.origin, state.carrier = old.origin.copy(), old.carrier.copy()
    state.forget_self_contact()
    state.position[:, 3] = now.model.inverse_mass
    state.position[stay.coarse, :3] = old.position[stay.before, :3]
    for name in ("velocity", "contact"):
        getattr(state, name)[stay.coarse] = getattr(old, name)[stay.before]
    for name in ("nearest", "contact_faces", "contact_weights"):  # of vertices, which are the first samples
        getattr(state, name)[stay.coarse] = getattr(old, name)[stay.before]
    for name, constraints, numbers in INTERNAL_FRICTION:
        kept, kept_before = getattr(state, name), getattr(old, name)
        kept[:] = 0.0
        if len(kept) and len(kept_before):
            rows, rows_before = _same_rows(getattr(now.model, constraints), getattr(before.model, constraints), stay)
            kept[getattr(now.model, numbers)[rows]] = kept_before[getattr(before.model, numbers)[rows_before]]


def _same_rows(now: np.ndarray, before: np.ndarray, stay: Stay) -> np.ndarray:
    """Constraints on the garments that stay on, of their vertices now, shape (c, k), and before, shape (b, k).

    Returns:
        the row of each in both, int, shape (2, r).
    """
    number = np.full(1 + max(before.max(initial=0), stay.before.max(initial=0)), -1)
    number[stay.before] = stay.coarse
    rows_before = {tuple(vertices): row for row, vertices in enumerate(number[before].tolist())}
    rows = {row: rows_before.get(tuple(vertices), -1) for row, vertices in enumerate(now.tolist())}
    return np.array([pair for pair in rows.items() if pair[1] >= 0], int).reshape(-1, 2).T


def place_on_body(simulation: Simulation, vertices: np.ndarray, new: np.ndarray) -> None:
    """Put garments where the body carries them from its bind pose.

    Args:
        simulation: whose body is posed.
        vertices: of all garments in the bind pose [m], shape (n, 3).
        new: vertices of the garments, int, shape (p,).
    """
    source = simulation.source
    assert source is not None
    carried = Attachment.bind(vertices[new], source.vertices, source.faces)
    simulation.state.position[new, :3] = carried.targets(simulation.body.current)
    simulation.state.velocity[new] = 0.0


def settle(simulation: Simulation, new: np.ndarray) -> None:
    """Simulate garments that were put on while body and other garments stand still.

    Args:
        simulation: of all garments.
        new: vertices of those that move, int, shape (p,).
    """
    state, body, time = simulation.state, simulation.body, simulation.time
    moving, previous = state.copy(), body.previous.copy()
    body.previous[:] = body.current
    state.position[:, 3] = 0.0
    state.position[new, 3] = simulation.model.inverse_mass[new]
    state.velocity[:] = 0.0
    for _ in range(SETTLING_STEPS):
        simulation.step_cloth(SETTLING_TIME)
    others = np.setdiff1d(np.arange(len(state.position)), new)
    state.position[:, 3] = simulation.model.inverse_mass
    state.position[others], state.velocity[others] = moving.position[others], moving.velocity[others]
    state.velocity[new] = 0.0
    for name, constraints, numbers in INTERNAL_FRICTION:
        if len(getattr(state, name)):
            old = ~np.isin(getattr(simulation.model, constraints)[:, 0], new)
            places = getattr(simulation.model, numbers)[old]
            getattr(state, name)[places] = getattr(moving, name)[places]
    body.previous[:] = previous
    state.carrier, simulation.time = moving.carrier, time


class Wardrobe:
    """The garments of an outfit that can be worn, and what was made for those that were worn together.

    Args:
        outfit: all garments.
        make: makes what is played of some garments of the outfit, given their database.

    Attributes:
        outfit: the argument.
    """

    def __init__(self, outfit: WrinkleDatabase, make: Callable[[WrinkleDatabase], PlayedGarment]) -> None:
        self.outfit, self._make = outfit, make
        self._made: dict[tuple[str, ...], PlayedGarment] = {}
        self._open: set[str] = set()  # what was opened by hand

    def take(self, database: WrinkleDatabase) -> PlayedGarment:
        """What is played of some garments of the outfit."""
        names = garment_names(database)
        if names not in self._made:
            self._made[names] = self._make(database)
        return self._made[names]

    def put_on(self, now: PlayedGarment, before: PlayedGarment) -> Stay:
        """Bring garments of the outfit to the place and time of others; a garment that is put on finds its place.

        Args:
            now: the garments that are worn from now on.
            before: those that were worn.

        Returns:
            what stays on.
        """
        assert now.learned is not None and before.learned is not None
        (database, levels), simulation = now.learned, now.simulation
        stay = Stay.between(before.learned[0], database)
        take_over(before.simulation, simulation, stay)
        if len(stay.new):
            place_on_body(simulation, levels.coarse.vertices, stay.new)
            settle(simulation, stay.new)
        for name in _fastened(levels):
            self._fasten(now, name, name not in self._open)
        now.between.remember()
        now.between.before[stay.coarse, :3] = before.between.before[stay.before, :3]
        simulation.solver.options = before.simulation.solver.options
        now.surface.begin(simulation.state.position)
        now.control.go_on_from(before.control)
        return stay

    def fasten(self, garment: PlayedGarment, name: str, closed: bool) -> None:
        """Fasten one of the garments that are worn to those below it, or open it.

        Raises:
            InputError: a garment that is not worn, or that nothing fastens.
        """
        assert garment.learned is not None
        fastened = _fastened(garment.learned[1])
        if name not in fastened:
            expected = "one of " + ", ".join(fastened) if fastened else "none: nothing is fastened"
            raise InputError("no such fastening", key="name", received=name, expected=expected)
        self._open = self._open - {name} if closed else self._open | {name}
        self._fasten(garment, name, closed)

    def _fasten(self, garment: PlayedGarment, name: str, closed: bool) -> None:
        assert garment.learned is not None and garment.learned[1].layers is not None
        garment.simulation.fasten(garment.learned[1].layers.names.index(name), closed)


def _fastened(levels: Levels) -> list[str]:
    """Names of the garments that the scene fastens to those below them."""
    layers = levels.layers
    return [] if layers is None else sorted({layers.names[k] for k in np.unique(layers.layer[layers.fastened])})
