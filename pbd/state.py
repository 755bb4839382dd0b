"""The motion of a garment (:class:`State`), with its memory of contact and friction."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field

import numpy as np

from pbd.arrays import floats
from pbd.errors import InputError
from pbd.model import Model
from pbd.storage import BROKEN_NPZ, replacing

__all__ = ["GRID", "State"]

GRID = 1.0  # origins are whole multiples of this power of two [m], so that moving one rounds nothing away


@dataclass
class State:
    """Positions and velocities of a garment about a moving origin, with the memory of its contacts.

    Attributes:
        origin: of the frame in which ``position`` counts [m], float64, shape (3,); whole multiples of 1 m.
        position: [m], float32, shape (n, 4); the last column is the inverse mass [1/kg].
        velocity: in the world [m/s], float32, shape (n, 3).
        nearest: body vertex nearest to each contact sample of the model, -1 for none, int32, shape (s,).
        contact_faces: of each contact sample the body vertex near it, and the corners of the face that it touched,
            when it last looked for one, -1 for none, int32, shape (s, 4).
        contact_weights: barycentric weights of the point that it touched for the second and third corner [-], float32,
            shape (s, 2).
        contact: distance to the body [m], float32, shape (n,); ``pbd.geometry.FAR`` where nothing is near.
        pairs: features of the cloth that touch one another, numbered as in
            :class:`pbd.contact.self_collision.SelfCollision`, int32, shape (c, 4).
        carrier: velocity of the cloth's carrier in the last frame, B x + b at a point x, as (B, b) [1/s], [m/s],
            float64, shape (3, 4); for :func:`pbd.xpbd.inertia.scale_inertial_forces`.
        pair_sides: direction in which the first feature of each lies from the second and how far [m], negative once it
            has gone through, float32, shape (c, 4).
        colliding: vertices that collided with other cloth in the last frame and were kept from going through it, and
            those around them: 1, else 0, uint8, shape (n,); they are watched from the start of the next frame.
        plastic_bends: bend of each hinge at which its internal friction is without force [m], see
            :func:`pbd.xpbd.constraints.rubbing_hinge`, float32, shape (h,); no number where nothing rubs.
        plastic_curvatures: curvatures (11, 22, 12 twice) of each face at which the internal friction of its plate
            element is without force [1/m], see :class:`pbd.models.friction.CurvatureFriction`, float32, shape (m, 3);
            the finite elements write them; no number where nothing rubs.
        plastic_shears: shear of each triangle at which its internal friction is without force [-], see
            :func:`pbd.xpbd.constraints.rubbing_shear`, float32, shape (m,); no number where nothing rubs.
    """

    origin: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    nearest: np.ndarray
    contact_faces: np.ndarray = field(repr=False)
    contact_weights: np.ndarray = field(repr=False)
    contact: np.ndarray = field(repr=False)
    carrier: np.ndarray = field(repr=False)
    pairs: np.ndarray = field(repr=False)
    pair_sides: np.ndarray = field(repr=False)
    colliding: np.ndarray = field(repr=False)
    plastic_bends: np.ndarray = field(repr=False)
    plastic_curvatures: np.ndarray = field(repr=False)
    plastic_shears: np.ndarray = field(repr=False)

    @classmethod
    def at_rest(cls, model: Model, vertices: np.ndarray | None = None) -> State:
        """State without motion at given world positions [m], shape (n, 3); None takes the mesh's own."""
        count = model.vertex_count
        vertices = model.mesh.vertices if vertices is None else vertices
        vertices = np.asarray(floats(vertices, "vertices", (count, 3), "bad start positions", unit=" [m]"), float)
        origin = GRID * np.round(vertices.mean(axis=0) / GRID)
        position = np.concatenate([vertices - origin, model.inverse_mass[:, None]], axis=1).astype(np.float32)
        velocity, contact = np.zeros((count, 3), np.float32), np.zeros(count, np.float32)
        nearest, pairs = np.full(len(model.samples), -1, np.int32), np.zeros((0, 4), np.int32)
        faces, weights = np.full((len(model.samples), 4), -1, np.int32), np.zeros((len(model.samples), 2), np.float32)
        carrier, sides = np.zeros((3, 4)), np.zeros((0, 4), np.float32)
        return cls(
            origin, position, velocity, nearest, faces, weights, contact, carrier, pairs, sides,
            np.zeros(count, np.uint8),
            np.zeros(model.plastic_count, np.float32),
            np.zeros((len(model.mesh.faces) if model.plastic_count else 0, 3), np.float32),
            np.zeros(model.plastic_shear_count, np.float32),
        )  # fmt: skip

    def world(self) -> np.ndarray:
        """World positions [m], float64, shape (n, 3)."""
        return self.position[:, :3] + self.origin

    def move_origin(self, origin: np.ndarray) -> None:
        """Count positions from another origin; both are whole multiples of a power of two."""
        origin = floats(origin, "origin", (3,), unit=" [m]")
        if np.any(origin != self.origin):
            self.position[:, :3] -= (origin - self.origin).astype(np.float32)
            self.carrier[:, 3] += self.carrier[:, :3] @ (origin - self.origin)
            self.origin = np.array(origin, float)

    def forget_self_contact(self) -> None:
        """Drop what is known of where the cloth touches itself, once something else has moved it."""
        self.pairs, self.pair_sides = self.pairs[:0], self.pair_sides[:0]
        self.colliding[:] = 0

    def copy(self) -> State:
        """A state of its own with the same bits."""
        return State(*(getattr(self, name).copy() for name in self._names))

    def restore(self, other: State) -> None:
        """Take the bits of another state of the same model, in the arrays that there are."""
        for name in self._names:
            if getattr(self, name).shape == getattr(other, name).shape:
                getattr(self, name)[:] = getattr(other, name)
            else:
                setattr(self, name, getattr(other, name).copy())

    _names = (
        "origin", "position", "velocity", "nearest", "contact_faces", "contact_weights", "contact", "carrier", "pairs",
        "pair_sides", "colliding", "plastic_bends", "plastic_curvatures", "plastic_shears",
    )  # fmt: skip

    def hash(self) -> str:
        """SHA-256 over every bit of the state."""
        digest = hashlib.sha256()
        for name in self._names:
            digest.update(np.ascontiguousarray(getattr(self, name)).tobytes())
        return digest.hexdigest()

    def save(self, path: str) -> None:
        """Write the state to an ``.npz`` file, beside it first and then renamed."""
        with replacing(path) as temporary, open(temporary, "wb") as file:
            np.savez(file, **{name: getattr(self, name) for name in self._names})

    @classmethod
    def load(cls, path: str) -> State:
        """Read what :meth:`save` wrote, bit by bit the same.

        Raises:
            InputError: no such file, or not a state.
        """
        try:
            with open(path, "rb") as file, np.lib.npyio.NpzFile(file, allow_pickle=False) as data:
                state = cls(*(data[name] for name in cls._names))
        except (OSError, KeyError, *BROKEN_NPZ) as error:
            raise InputError(f"not a saved state: {error}", file=path, expected="a file of State.save") from error
        received = [(array.dtype.name, array.shape) for array in (getattr(state, name) for name in cls._names)]
        count, samples, pairs = (
            len(array) if array.ndim else -1 for array in (state.position, state.nearest, state.pairs)
        )
        shapes = (
            (3,), (count, 4), (count, 3), (samples,), (samples, 4), (samples, 2), (count,), (3, 4), (pairs, 4),
            (pairs, 4), (count,), state.plastic_bends.shape[:1],
            (*state.plastic_curvatures.shape[:1], 3), state.plastic_shears.shape[:1],
        )  # fmt: skip
        kinds = (
            "float64", "float32", "float32", "int32", "int32", "float32", "float32", "float64", "int32", "float32",
            "uint8", "float32", "float32", "float32",
        )  # fmt: skip
        expected = list(zip(kinds, shapes, strict=True))
        if received != expected:
            raise InputError("not a saved state", file=path, received=received, expected=str(expected))
        for name in cls._names:
            if not np.isfinite(getattr(state, name)).all():
                raise InputError("a state that is not finite", file=path, key=name, expected="finite numbers")
        return state
