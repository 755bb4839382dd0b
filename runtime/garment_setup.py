"""Loads a scene with one garment on one body: the garment coarse and fine, the motions, and solids beside the body."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from assets.character import Character
from assets.fabrics import PRESETS
from assets.garment import Garment, load_garment
from assets.io.body_settings import MotionSettings
from assets.io.collider_settings import FieldSettings
from assets.io.scene import GarmentSettings, Scene, parse_scene
from assets.io.sequence import Sequence, SequenceMotion
from assets.limits import load_limits
from assets.motion import ClipMotion, part_of
from assets.procedural.exploration import exploration_clip, exploration_motion
from pbd import Capsule, DistanceField, Fabric, InputError, Plane, SolverOptions, Sphere
from runtime.garment_mesh import (
    coarse_garment,
    garment_of,
    held_vertices,
    in_size,
    sewn_rest,
    subdivided,
    with_subdivisions,
)
from runtime.scene_body import body_of, clip_of, motion_of
from runtime.simulation import Motion
from wrinkles.database import WrinkleDatabase
from wrinkles.field import field_of_mesh
from wrinkles.levels import Levels, build_levels

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
    not hang on the coarse garment's substep: what is learned is no less converged where that is played in few.

    Args:
        scene: what is simulated.
        subdivisions: from the garment's mesh to the fine one.
    """
    return replace(scene.solver.options(), substep=scene.training.substep / 2.0**subdivisions)


@dataclass(frozen=True)
class GarmentSetup:
    """The contents of a scene with one garment on one body, loaded.

    Attributes:
        scene: its settings.
        settings: of its garment.
        garment: the coarse mesh as it came, or as it was made from a fine one.
        body: the character or vertex sequence.
        levels: coarse and fine mesh, outside the body and attached.
    """

    scene: Scene
    settings: GarmentSettings
    garment: Garment
    body: Character | Sequence
    levels: Levels

    @classmethod
    def of(cls, scene: Scene) -> GarmentSetup:
        """Load everything that a scene with one garment on one body names.

        Raises:
            InputError: several garments, no body, or anything that cannot be loaded.
        """
        scene = with_subdivisions(scene)
        settings, garment = garment_of(scene)
        body = body_of(scene)
        if settings.pins:
            expected = "attach or attach_vertices: pins hold a garment without a body"
            raise InputError("pins beside a body", key="garment[0].pins", received=settings.pins, expected=expected)
        vertices = body.vertices if isinstance(body, Character) else body.vertices[0].astype(float)
        garment = in_size(garment, settings, vertices, body.faces)
        garment, binding = coarse_garment(garment, settings)
        held = held_vertices(garment, settings)
        limits = None if settings.limits is None else load_limits(settings.limits, len(garment.vertices))
        garment, held, limits = subdivided(garment, held, limits, settings.coarse_subdivisions)
        levels = build_levels(
            garment.vertices,
            garment.faces,
            held,
            vertices,
            body.faces,
            settings.subdivision_count,
            binding=binding,
            limits=limits,
            sewn=sewn_rest(garment),
        )
        return cls(scene, settings, garment, body, replace(levels, pattern=garment.pattern))

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
        motions: list[Motion] = [self.motion(m) for m in self.scene.training.clips]
        return motions + [exploration_motion(body, seed, length) for body, seed, length in self._procedural()]

    def training_parts(self, seconds: float) -> list[Motion]:
        """The same motions in parts of about so many seconds, each with a lead-in of its own."""
        parts: list[Motion] = []
        for whole in self.scene.training.clips:
            self.motion(whole)  # refuses what does not exist
            end = self._end(whole)
            cuts = _cuts(whole.start, end, seconds * whole.speed)
            pieces = [replace(whole, start=a, end=b) for a, b in cuts] if len(cuts) > 1 else [whole]
            parts += [self.motion(piece) for piece in pieces]
        for body, seed, length in self._procedural():
            clip = exploration_clip(body, seed, length)
            for a, b in _cuts(0.0, clip.duration, seconds):
                part = ClipMotion(body, part_of(clip, a, b), blend=1.0 if a else 0.0)  # it begins in the bind pose
                part.name = f"{clip.name} {a:g}-{b:g} s"
                parts.append(part)
        return parts

    def _end(self, motion: MotionSettings) -> float:
        """End of a clip or of its part, in the clip's own time [s]."""
        if not isinstance(self.body, Character):
            return self.motion(motion).duration * motion.speed
        length = clip_of(self.body, motion).duration
        return length if motion.end is None else min(motion.end, length)

    def _procedural(self) -> Iterator[tuple[Character, int, float]]:
        """Body, seed and length [s] of each piece of procedural motion."""
        rest, seed = self.scene.training.procedural_seconds, self.scene.wrinkles.seed
        if rest and not isinstance(self.body, Character):
            raise InputError(
                "procedural motion needs a skinned character", key="training.procedural_seconds", expected="0"
            )
        while rest >= 2.0 and isinstance(self.body, Character):
            yield self.body, seed, min(rest, PROCEDURAL_PIECE)
            rest, seed = rest - PROCEDURAL_PIECE, seed + 1


def _cuts(start: float, end: float, seconds: float) -> list[tuple[float, float]]:
    """Equal parts of about so many seconds; their ends are whole hundredths."""
    count = max(1, round((end - start) / seconds))
    ends = [start, *(round(start + k * (end - start) / count, 2) for k in range(1, count)), end]
    return list(zip(ends[:-1], ends[1:], strict=True))


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


@cache
def _field(mesh: Path, spacing: float) -> DistanceField:
    solid = load_garment(mesh)
    return field_of_mesh(solid.vertices, solid.faces, spacing)


def fine_substep_of(database: WrinkleDatabase) -> float:
    """Substep of the fine runs that a database was learned from [s]; the files of its scene may be gone."""
    scene = tomllib.loads(database.scene)
    subdivisions = scene.get("garment", [{}])[0].get("coarse_subdivisions", 0) + database.subdivisions
    return scene.get("training", {}).get("substep", SolverOptions.substep) / 2.0**subdivisions


def scene_of(database: WrinkleDatabase) -> Scene:
    """The scene that is stored in a database.

    Raises:
        InputError: a file that the scene names is gone.
    """
    return parse_scene(database.scene, f"scene stored for '{database.garment_name}'")
