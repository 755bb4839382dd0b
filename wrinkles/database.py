"""A wrinkle database: all data that playing a garment on its character needs.

To add a field, add it to :class:`WrinkleDatabase` (or to a dataclass inside it) and to ``wrinkles.schema.ENTRIES``, and
raise ``SCHEMA_VERSION``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

import pbd
from pbd import Fabric, InputError, Limits, ModelOptions, SolverOptions
from pbd.arrays import floats, integers
from pbd.fingerprint import source_fingerprint
from pbd.mesh import edges_of
from wrinkles.binding import Binding
from wrinkles.dictionary import Atoms, CoefficientNetwork
from wrinkles.levels import Layers, Levels, levels_of
from wrinkles.novelty import NoveltyScore
from wrinkles.rest_shape import RestShapeCorrection
from wrinkles.surface import SewnRest, Subdivision

__all__ = ["CHOICE", "WrinkleDatabase", "body_hash", "code_version"]

CHOICE = (
    "cost_advantage",
    "cost_advantage_is_at_least",
    "plain_frame_ms",
    "plain_substeps",
    "plain_vertex_count",
    "plain_passes",
)
"""Figures of a database's quality by which plain cloth is the better choice or not, for the garment's own fabric."""
# Where cloth is pressed together, a coarse mesh cannot fold as short as it does. It gives way so many times as easily
# instead, and gets fewer dents of one edge.
COARSE_COMPRESSION = 2.0


@dataclass(frozen=True)
class WrinkleDatabase:
    """A garment's wrinkles and the coarse garment that they were learned for.

    Attributes:
        garment_name: name of the garment, for messages.
        coarse_vertices: in the bind pose, already outside the body [m], float64, shape (n, 3).
        coarse_faces: int32, shape (m, 3).
        rest_shape: corrections of the coarse garment's rest shape against its pattern.
        subdivisions: number of times that each coarse face is cut in four.
        held: coarse vertices attached to the body, ascending, int32, shape (p,).
        limits: how far coarse vertices may move from where the body carries them.
        warp: direction of the warp in space.
        binding: binding of a delivered fine mesh; None where the subdivided mesh is the fine one.
        sewn: how the coarse faces of a sewn garment rest; None for any other, which rests as its mesh.
        layers: garments of an outfit; None for one garment.
        fabric_name: name of the garment's own fabric, of an outfit that of the innermost one; so are the next two.
        fabric: the garment's own fabric.
        pressure: that inflates it [Pa].
        other_fabrics: other fabrics that the garment can be played in by their names, see :meth:`in_fabric`.
        bend_factor: hinge factor measured on the coarse mesh [-].
        solver: options of the coarse simulation.
        frame_rate: of the coarse simulation [Hz].
        atoms, mapping: the dictionary.
        novelty: decides where the wrinkles fade.
        cutoff: wavelength of the filter between coarse and fine [m].
        body_hash: hash of the body that the garment was trained on, see :func:`body_hash`.
        body_vertex_count: number of that body's vertices.
        quality: held-out figures by name; figures that are not finite (nothing to measure) are not stored.
        held_out: clips that the figures were measured on.
        trained_on: clips that the wrinkles were learned from.
        training_minutes: duration of the training [min].
        machine: name of the processor that learned and measured it.
        seed: seed of every random choice in learning.
        scene: the resolved scene (TOML).
        code_version: see :func:`code_version`.
        created: ISO date.
        texture: texture coordinates of each corner of the coarse faces, v upwards, float32, shape (m, 3, 2), NaN at
            faces without; None without any. A delivered fine mesh has those of its pattern, see :attr:`fine_texture`.
    """

    garment_name: str
    coarse_vertices: np.ndarray
    coarse_faces: np.ndarray
    rest_shape: RestShapeCorrection
    subdivisions: int
    held: np.ndarray
    limits: Limits
    warp: tuple[float, float, float]
    binding: Binding | None
    sewn: SewnRest | None
    layers: Layers | None
    fabric_name: str
    fabric: Fabric
    pressure: float
    other_fabrics: Mapping[str, Fabric]
    bend_factor: float
    solver: SolverOptions
    frame_rate: float
    atoms: Atoms
    mapping: CoefficientNetwork
    novelty: NoveltyScore
    cutoff: float
    body_hash: str
    body_vertex_count: int
    quality: Mapping[str, float]
    held_out: tuple[str, ...]
    trained_on: tuple[str, ...]
    training_minutes: float
    machine: str
    seed: int
    scene: str
    code_version: str
    created: str
    texture: np.ndarray | None = None

    @property
    def options(self) -> ModelOptions:
        """Options of the model of the coarse mesh."""
        return ModelOptions(COARSE_COMPRESSION, pressure=self.pressure)

    @property
    def fine_vertex_count(self) -> int:
        """Number of vertices of the fine mesh [-]."""
        if self.binding is not None:
            return len(self.binding.face)
        vertices, edges, faces = len(self.coarse_vertices), len(edges_of(self.coarse_faces)[0]), len(self.coarse_faces)
        for _ in range(self.subdivisions):
            vertices, edges, faces = vertices + edges, 2 * edges + 3 * faces, 4 * faces
        return vertices

    @property
    def subdivision(self) -> Subdivision:
        """The subdivision from the coarse to the fine mesh."""
        return Subdivision.of(self.coarse_faces, len(self.coarse_vertices), self.subdivisions, self.binding)

    @property
    def fine_texture(self) -> np.ndarray | None:
        """Texture coordinates of each corner of the faces of :attr:`subdivision`, shape (M, 3, 2), as ``texture``."""
        return self.subdivision.flat_corners(self.texture)

    def levels(self, body_vertices: np.ndarray, body_faces: np.ndarray) -> Levels:
        """Coarse and fine mesh of the garment on its body.

        Args:
            body_vertices: of the bind pose, or of a sequence's first frame [m], shape (b, 3).
            body_faces: int, shape (f, 3); empty without a body.

        Raises:
            InputError: arrays of another shape, values that are not finite, or faces of vertices that are not there.
        """
        body_vertices = floats(body_vertices, "body_vertices", ("b", 3), unit=" [m]")
        body_faces = integers(body_faces, "body_faces", ("f", 3), len(body_vertices))
        return levels_of(
            self.coarse_vertices,
            self.coarse_faces,
            self.held,
            body_vertices,
            body_faces,
            self.subdivisions,
            self.warp,
            binding=self.binding,
            limits=self.limits,
            sewn=self.sewn,
            layers=self.layers,
        )

    @property
    def fabric_names(self) -> tuple[str, ...]:
        """Names of all fabrics that the garment can be played in, its own first."""
        return (self.fabric_name, *self.other_fabrics)

    def in_fabric(self, name: str) -> WrinkleDatabase:
        """The same garment with one fabric, which becomes its own and its only one.

        Args:
            name: one of :attr:`fabric_names`.

        Raises:
            InputError: a fabric in which its wrinkles were not learned.
        """
        if name not in self.fabric_names:
            expected = "one of " + ", ".join(self.fabric_names)
            raise InputError("a fabric that was not learned", key="fabric", received=name, expected=expected)
        if name == self.fabric_name:
            return replace(self, other_fabrics={})
        return replace(
            self,
            fabric_name=name,
            fabric=self.other_fabrics[name],
            other_fabrics={},
            quality={name: value for name, value in self.quality.items() if name not in CHOICE},
        )

    def require_body(self, body: Any) -> None:
        """Refuse another body than the one the garment was trained on.

        Args:
            body: :class:`assets.character.Character` or :class:`assets.io.sequence.Sequence`.

        Raises:
            InputError: another body.
        """
        received = body_hash(body)
        if received != self.body_hash:
            count = body.vertices.shape[-2]
            raise InputError(
                "a database of another character",
                key=getattr(body, "name", "body"),
                received=f"{count} vertices, hash {received[:12]}",
                expected=f"{self.body_vertex_count} vertices, hash {self.body_hash[:12]}",
            )


def body_hash(body: Any) -> str:
    """SHA-256 of a character's bind pose, faces, joints and weights, or of a sequence's first frame and faces.

    Positions and weights are rounded to steps of 2^-16, so that the rounding errors of another linear-algebra library
    do not change the hash.

    Args:
        body: :class:`assets.character.Character` or :class:`assets.io.sequence.Sequence`.
    """
    vertices = body.vertices if body.vertices.ndim == 2 else body.vertices[0]
    digest = hashlib.sha256()
    parts = [_in_steps(vertices), np.asarray(body.faces, np.int64)]
    if hasattr(body, "joint_names"):
        digest.update("\0".join(body.joint_names).encode())
        parts += [np.asarray(body.joint_indices, np.int64), _in_steps(body.joint_weights)]
    for part in parts:
        digest.update(str(part.shape).encode())
        digest.update(np.ascontiguousarray(part).tobytes())
    return digest.hexdigest()


def _in_steps(values: np.ndarray) -> np.ndarray:
    """Values as whole numbers of steps of 2^-16, int64."""
    # The shift by a third of a step keeps usual values (binary or decimal fractions) off the edge between two steps.
    return np.floor(np.asarray(values, np.float64) * 2.0**16 + 1.0 / 3.0).astype(np.int64)


@lru_cache(maxsize=1)
def code_version() -> str:
    """Version of the package and a hash of the source of ``pbd`` and ``wrinkles``: "0.1.0+3f2a9c0d11e4"."""
    try:
        version = metadata.version("gube")
    except metadata.PackageNotFoundError:  # run from a source tree
        version = "0"
    return f"{version}+{source_fingerprint(pbd, Path(__file__).parent)[:12]}"
