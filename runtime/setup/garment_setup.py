"""Loads a scene with garments on one body: the garments coarse and fine, the motions, and solids beside the body."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from assets.character import Character
from assets.fabrics import PRESETS
from assets.garment import Garment
from assets.io.body_settings import MotionSettings
from assets.io.collider_settings import FieldSettings
from assets.io.file_cache import kept_while_unchanged
from assets.io.scene import GarmentSettings, Scene, parse_scene
from assets.io.sequence import Sequence, SequenceMotion
from assets.loading import load_garment
from assets.motion import Motion
from assets.painted_limits import load_limits
from assets.placement import check_worn
from assets.procedural.exploration import exploration_motion
from pbd import Capsule, DistanceField, Fabric, InputError, Limits, Plane, SolverOptions, Sphere
from runtime.setup.fitting import fitted
from runtime.setup.garment_mesh import (
    carried_bands,
    coarse_garment,
    fastened_vertices,
    held_vertices,
    in_size,
    rest_of,
    sewn_rest,
    subdivided,
    with_subdivisions,
)
from runtime.setup.layer_order import check_fastened, check_order
from runtime.setup.opened_start import Opening, opened
from runtime.setup.scene_body import body_of, load_body, motion_of
from wrinkles.binding import Binding
from wrinkles.database import WrinkleDatabase
from wrinkles.field import field_of_mesh
from wrinkles.levels import Layers, Levels, build_levels, levels_of

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

__all__ = [
    "PROCEDURAL_PIECE",
    "GarmentSetup",
    "colliders_of",
    "fabric_of",
    "fabrics_of",
    "fine_options",
    "fine_substep_of",
    "scene_of",
]

PROCEDURAL_PIECE = 20.0  # procedural motion is made in pieces of this length [s], each with a seed of its own


def fabric_of(settings: GarmentSettings) -> Fabric:
    """The fabric of a garment; a thickness in the scene replaces the fabric's own."""
    thickness = settings.fabric.thickness if settings.thickness is None else settings.thickness
    return replace(settings.fabric, thickness=thickness)


def fabrics_of(scene: Scene, settings: GarmentSettings) -> dict[str, Fabric]:
    """The fabrics in which a scene learns a garment's wrinkles, by name, the garment's own first.

    Raises:
        InputError: the garment's own fabric is listed again among the others.
    """
    own = next((name for name, preset in PRESETS.items() if preset == settings.fabric), "own")
    others = scene.training.fabrics
    if own in others:
        expected = f"others than the garment's own, {own}"
        raise InputError("the garment's own fabric", key="training.fabrics", received=list(others), expected=expected)
    return {own: fabric_of(settings)} | {name: fabric_of(replace(settings, fabric=PRESETS[name])) for name in others}


def fine_options(scene: Scene, subdivisions: int) -> SolverOptions:
    """Options of the fine simulation: those of the scene with a substep of its own.

    The stretch of small steps depends on substep times number of edges, so each subdivision halves the substep. It does
    not depend on the coarse garment's substep: a garment played with few substeps learns from a run as converged as one
    played with many.

    Args:
        scene: what is simulated.
        subdivisions: from the garment's mesh to the fine one.
    """
    return replace(scene.solver.options(), substep=scene.training.substep / 2.0**subdivisions)


class _Piece(NamedTuple):
    """A garment as it is simulated: its coarse mesh, what binds a delivered fine mesh to it, and what holds it."""

    garment: Garment
    binding: Binding | None
    held: np.ndarray
    limits: Limits | None
    fastened: np.ndarray


def _piece(number: int, settings: GarmentSettings, body: Character | Sequence, below: list[Garment]) -> _Piece:
    """The garment of that number in a scene, over others."""
    body_vertices, body_faces = _bind_vertices(body), body.faces
    if settings.pins:
        expected = "attach or attach_vertices: pins hold a garment without a body"
        key = f"garment[{number}].pins"
        raise InputError("pins beside a body", key=key, received=settings.pins, expected=expected)
    garment = load_garment(settings.mesh, pattern=settings.pattern)
    if settings.made_for is not None:
        if not isinstance(body, Character):
            key, expected = f"garment[{number}].made_for", "a skinned character, whose joints carry the garment"
            raise InputError("a garment of another body", key=key, received="a vertex sequence", expected=expected)
        garment = fitted(garment, load_body(settings.made_for), body, settings.fit)
    settings = carried_bands(garment, settings, (body_vertices, body_faces), below)
    garment = in_size(garment, settings, body_vertices, body_faces)
    garment, binding = coarse_garment(garment, settings)
    held, fastened = held_vertices(garment, settings), fastened_vertices(garment, settings)
    check_worn(garment, held, body_vertices, body_faces, f"garment[{number}].mesh")
    if number == 0 and len(fastened):
        expected = "none: it is the innermost garment, and the body holds by attach"
        key = "garment[0].fasten" if settings.fasten != "none" else "garment[0].fasten_vertices"
        raise InputError("nothing below to fasten to", key=key, received=len(fastened), expected=expected)
    limits = None if settings.limits is None else load_limits(settings.limits, len(garment.vertices))
    times = settings.coarse_subdivisions
    garment, held, limits, fastened = subdivided(garment, held, limits, times, fastened)
    return _Piece(garment, binding, held, limits, fastened)


def _bind_vertices(body: Character | Sequence) -> np.ndarray:
    return body.vertices if isinstance(body, Character) else body.vertices[0].astype(float)


def _outfit(scene: Scene, pieces: list[_Piece]) -> tuple[Scene, _Piece, Layers]:
    """Several garments as one mesh; the scene in which all are subdivided equally often.

    Raises:
        InputError: settings that must be the same for all garments, or that an outfit cannot have.
    """
    garments = scene.garments
    for number, (settings, piece) in enumerate(zip(garments, pieces, strict=True)):
        if piece.binding is not None:
            key, expected = f"garment[{number}].coarse_vertices", "a mesh that is simulated itself"
            raise InputError(
                "a decimated mesh in an outfit", key=key, received=settings.coarse_vertices, expected=expected
            )
        if settings.pressure != garments[0].pressure:
            key, expected = f"garment[{number}].pressure", f"{garments[0].pressure:g}, as garment[0] has"
            raise InputError("another pressure in an outfit", key=key, received=settings.pressure, expected=expected)
    if scene.training.fabrics:
        received, expected = list(scene.training.fabrics), "none: an outfit is learned in its own fabrics"
        raise InputError("other fabrics of an outfit", key="training.fabrics", received=received, expected=expected)
    most = max(garment.subdivision_count for garment in garments)
    alike = replace(scene, garments=tuple(replace(garment, subdivisions=most) for garment in garments))
    counts = [len(piece.garment.vertices) for piece in pieces]
    first = np.cumsum([0, *counts])
    limited = [
        replace(piece.limits, vertices=piece.limits.vertices + n)
        for piece, n in zip(pieces, first, strict=False)
        if piece.limits is not None
    ]
    sewn = [rest_of(piece.garment) for piece in pieces]
    garment = Garment(
        " + ".join(garment.name for garment in garments),
        np.concatenate([piece.garment.vertices for piece in pieces]),
        np.concatenate([p.garment.faces + n for p, n in zip(pieces, first, strict=False)]).astype(np.int32),
        np.concatenate([rest.pattern for rest in sewn]),
        pieces[0].garment.source,
        np.concatenate([rest.layers for rest in sewn]),
        np.concatenate([rest.max_stretch for rest in sewn]),
    )
    held = np.concatenate([piece.held + n for piece, n in zip(pieces, first, strict=False)])
    limits = None
    if limited:
        names = ("vertices", "maximum_distance", "backstop", "stiffness")
        limits = Limits(*(np.concatenate([getattr(one, name) for one in limited]) for name in names))
    layer = np.repeat(np.arange(len(pieces), dtype=np.int32), counts)
    fabrics = tuple(fabric_of(garment) for garment in garments[1:])
    fastened = np.concatenate([piece.fastened + n for piece, n in zip(pieces, first, strict=False)]).astype(np.int32)
    layers = Layers(tuple(garment.name for garment in garments), fabrics, layer, fastened)
    return alike, _Piece(garment, None, held, limits, fastened), layers


@dataclass(frozen=True)
class GarmentSetup:
    """The contents of a scene with one garment, or an outfit of several, on one body, loaded.

    Attributes:
        scene: its settings.
        settings: of its garment, of an outfit those of the innermost one.
        garment: the coarse mesh as it came, or as it was made from a fine one; all of an outfit in one.
        body: the character or vertex sequence.
        levels: coarse and fine mesh, outside the body and attached.
        openings: what was done where they started through themselves.
    """

    scene: Scene
    settings: GarmentSettings
    garment: Garment
    body: Character | Sequence
    levels: Levels
    openings: tuple[Opening, ...] = ()

    @classmethod
    def of(cls, scene: Scene) -> GarmentSetup:
        """Load everything that a scene with garments on one body names.

        Raises:
            InputError: no body, garments that make no outfit, or anything that cannot be loaded.
        """
        scene = with_subdivisions(scene)
        body = body_of(scene)
        vertices = _bind_vertices(body)
        pieces: list[_Piece] = []
        for number, settings in enumerate(scene.garments):
            pieces.append(_piece(number, settings, body, [piece.garment for piece in pieces]))
        piece, layers = pieces[0], None
        if len(pieces) > 1:
            scene, piece, layers = _outfit(scene, pieces)
        shape = {"binding": piece.binding, "limits": piece.limits, "sewn": sewn_rest(piece.garment), "layers": layers}
        arguments = piece.garment.faces, piece.held, vertices, body.faces, scene.garments[0].subdivision_count
        levels, openings = build_levels(piece.garment.vertices, *arguments, **shape), ()
        if layers is not None:
            check_order(levels.coarse.vertices, levels.coarse.faces, layers)
            check_fastened(levels.coarse.vertices, levels.coarse.faces, layers)
        if scene.solver.self_collision:
            cuts = max(garment.subdivisions_of_mesh for garment in scene.garments)
            solvers = scene.solver.options(), fine_options(scene, cuts)
            levels, openings = opened(
                levels,
                fabric_of(scene.garments[0]),
                *solvers,
                vertices,
                body.faces,
                lambda x: levels_of(x, *arguments, **shape),
            )
        levels = replace(levels, pattern=piece.garment.pattern)
        return cls(scene, scene.garments[0], piece.garment, body, levels, openings)

    @property
    def name(self) -> str:
        """Name of the garment, or of all garments of an outfit from the innermost outwards."""
        return " + ".join(garment.name for garment in self.scene.garments)

    @property
    def subdivisions_of_mesh(self) -> int:
        """How often the mesh is subdivided for the fine one; of an outfit the greatest number."""
        return max(garment.subdivisions_of_mesh for garment in self.scene.garments)

    def motion(self, motion: MotionSettings | None = None) -> Motion:
        """A motion of the body: the one given, or the scene's own."""
        if motion is None and self.scene.character is not None:
            motion = self.scene.character.motion
        if motion is None and isinstance(self.body, Sequence):
            return SequenceMotion(self.body)
        if motion is None:
            assert isinstance(self.body, Character)
            assert self.scene.character is not None and self.scene.character.file is not None
            clip = self.scene.character.clip or next(iter(self.body.clips), None)
            if clip is None:
                raise InputError("the character has no clip", key="character.clip", expected="a file with clips")
            motion = MotionSettings(file=self.scene.character.file, clip=clip)
        return motion_of(self.body, motion)

    def training_motions(self) -> list[Motion]:
        """Clips and procedural motion to learn from."""
        return [*(self.motion(m) for m in self.scene.training.clips), *self._procedural()]

    def _procedural(self) -> Iterator[Motion]:
        rest, seed = self.scene.training.procedural_seconds, self.scene.wrinkles.seed
        if rest and not isinstance(self.body, Character):
            raise InputError(
                "procedural motion needs a skinned character", key="training.procedural_seconds", expected="0"
            )
        while rest >= 2.0 and isinstance(self.body, Character):
            yield exploration_motion(self.body, seed, min(rest, PROCEDURAL_PIECE))
            rest, seed = rest - PROCEDURAL_PIECE, seed + 1


def colliders_of(scene: Scene) -> tuple[Plane | Sphere | Capsule | DistanceField, ...]:
    """Colliders of a scene besides the body; each call makes new ones, because they may be moved.

    Raises:
        InputError: a mesh that cannot be loaded, or as :func:`wrinkles.field.field_of_mesh`.
    """
    found = []
    for number, collider in enumerate(scene.colliders):
        if not isinstance(collider, FieldSettings):
            found.append(collider.primitive())
            continue
        try:
            found.append(replace(_field(collider.mesh, collider.spacing), position=collider.centre))
        except InputError as error:
            key = f"collider[{number}].{'spacing' if error.key == 'spacing' else 'mesh'}"
            if error.file is not None:
                raise
            raise InputError(
                error.problem, file=collider.mesh, key=key, received=error.received, expected=error.expected
            ) from error
    return tuple(found)


@kept_while_unchanged
def _field(mesh: Path, spacing: float) -> DistanceField:
    solid = load_garment(mesh)
    return field_of_mesh(solid.vertices, solid.faces, spacing)


def fine_substep_of(database: WrinkleDatabase) -> float:
    """Substep of the fine runs that a database was learned from [s]; the files of its scene may be gone."""
    scene = tomllib.loads(database.scene)
    cuts = max(garment.get("coarse_subdivisions", 0) for garment in scene.get("garment", [{}]))
    subdivisions = cuts + database.subdivisions
    return scene.get("training", {}).get("substep", SolverOptions.substep) / 2.0**subdivisions


def scene_of(database: WrinkleDatabase) -> Scene:
    """The scene that is stored in a database.

    Raises:
        InputError: a file that the scene names is gone.
    """
    return parse_scene(database.scene, f"scene stored for '{database.garment_name}'")
