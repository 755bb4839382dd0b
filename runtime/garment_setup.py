"""Loads everything that a scene names: its body, its motions, and its garment as a coarse and a fine mesh."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from assets.character import Character, Clip, load_character, with_clips
from assets.ease import eased
from assets.fabrics import PRESETS
from assets.garment import Garment, boundary_loops, highest_loop, load_garment
from assets.io.bvh import read_bvh
from assets.io.scene import FieldSettings, GarmentSettings, MotionSettings, Scene, parse_scene
from assets.io.sequence import Sequence, SequenceMotion, load_sequence
from assets.limits import load_limits
from assets.motion import ClipMotion, part_of
from assets.procedural.exploration import exploration_clip, exploration_motion
from assets.retarget import load_joint_table, retargeted
from assets.seams import load_seams
from pbd import (
    Capsule,
    ClothMesh,
    DistanceField,
    Fabric,
    InputError,
    Limits,
    Model,
    ModelOptions,
    Plane,
    SolverOptions,
    Sphere,
    build_model,
)
from pbd.attachment import Attachment
from pbd.contact.strain_limits import MAX_STRETCH
from pbd.layers import layered
from runtime.simulation import Motion, Simulation, body_source
from wrinkles.binding import Binding, bind
from wrinkles.database import WrinkleDatabase
from wrinkles.field import field_of_mesh
from wrinkles.levels import Levels, build_levels, held_between
from wrinkles.surface import SewnRest, Subdivision, cut_corners

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

__all__ = [
    "PROCEDURAL_PIECE",
    "GarmentSetup",
    "body_of",
    "clip_of",
    "colliders_of",
    "coarse_garment",
    "fabric_of",
    "fabrics_of",
    "fine_options",
    "fine_substep_of",
    "garment_of",
    "held_vertices",
    "load_body",
    "motion_of",
    "pattern_of",
    "scene_of",
    "simulation_of",
    "with_subdivisions",
]

EDGE_SHARE = 0.6  # mean edge over the gravity length of the fabric, at which folds of a skirt have converged [-]
MOST_SUBDIVISIONS = 3  # that a scene gets without naming them
MOST_COARSE_SUBDIVISIONS = 3  # of a mesh before it is simulated: 64 times its faces
DELIVERED_SUBDIVISIONS = 2  # of the coarse mesh under a delivered fine mesh
PROCEDURAL_PIECE = 20.0  # procedural motion is made in pieces of this length [s], each with a seed of its own


@cache
def load_body(file: Path | str) -> Character:
    """A character, loaded once: every call with the same path returns the same object.

    Raises:
        InputError: as :func:`assets.character.load_character`.
    """
    return load_character(file)


@cache
def captured_clip(body: Character, file: Path, joints: Path | None) -> Clip:
    """A captured motion on a character, made once.

    Args:
        body: the character.
        file: the .bvh file.
        joints: table of joints, see :func:`assets.retarget.load_joint_table`; None goes by names.

    Raises:
        InputError: as :func:`assets.io.bvh.read_bvh` and :func:`assets.retarget.retargeted`.
    """
    return retargeted(body, read_bvh(file), None if joints is None else load_joint_table(joints))


def clip_of(body: Character, motion: MotionSettings) -> Clip:
    """The whole clip that a motion is a part of, on this body.

    Raises:
        InputError: no such clip (those that exist are listed), a file with another skeleton, or a captured motion whose
            joints are not found.
    """
    if motion.clip is None:
        return captured_clip(body, Path(motion.file), motion.joints)
    other = load_body(motion.file)
    if motion.clip not in other.clips:
        known = "one of " + ", ".join(sorted(other.clips)) if other.clips else "a file with clips"
        raise InputError("no such clip", key="clip", received=motion.clip, expected=known)
    return (with_clips(body, other) if other is not body else body).clip(motion.clip)


def motion_of(body: Character | Sequence, motion: MotionSettings) -> Motion:
    """A clip of any file on this body, with a lead-in from the bind pose; or a part of a vertex sequence of this body.

    Raises:
        InputError: as :func:`clip_of`, a sequence of another surface, or a part after the end.
    """
    if isinstance(body, Sequence) != motion.is_sequence:
        expected = (
            "a vertex sequence (.npz, .mdd, .pc2, USD)" if isinstance(body, Sequence) else "a clip or a .bvh file"
        )
        raise InputError("a motion of another kind of body", key="file", received=str(motion.file), expected=expected)
    try:
        if isinstance(body, Sequence):
            sequence = load_sequence(motion.file, motion.rate)
            if not np.array_equal(sequence.faces, body.faces):
                received, expected = f"{len(sequence.faces)} faces", "the faces of the scene's body"
                raise InputError("a sequence of another surface", key="faces", received=received, expected=expected)
            made: Motion = SequenceMotion(sequence, motion.start, motion.end, motion.speed)
        else:
            made = ClipMotion(body, part_of(clip_of(body, motion), motion.start, motion.end), speed=motion.speed)
    except InputError as error:
        if error.file is not None:
            raise
        raise InputError(
            error.problem, file=motion.file, key=error.key, received=error.received, expected=error.expected
        ) from error
    made.name = motion.name
    return made


def body_of(scene: Scene) -> Character | Sequence:
    """The body of a scene.

    Raises:
        InputError: the scene has none, or it cannot be loaded.
    """
    character = scene.character
    if character is None:
        raise InputError("no body", key="character", expected="a [character] with file or sequence")
    if character.file is not None:
        return load_body(character.file)
    return load_sequence(str(character.sequence), character.rate)


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


def held_vertices(garment: Garment, settings: GarmentSettings) -> np.ndarray:
    """Vertices that the scene attaches to the body: int, shape (p,).

    Raises:
        InputError: a loop or a vertex that the garment does not have.
    """
    loops = boundary_loops(garment.faces)
    held: list[np.ndarray] = [np.asarray(settings.attach_vertices, np.int64)]
    if settings.attach == "top":
        held.append(highest_loop(garment.vertices, garment.faces))
    elif settings.attach != "none":
        for number in settings.attach:
            if not 0 <= int(number) < len(loops):
                raise InputError(
                    "no such boundary loop",
                    file=garment.source,
                    key="attach",
                    received=number,
                    expected=f"0..{len(loops) - 1}",
                )
            held.append(loops[int(number)])
    vertices = np.unique(np.concatenate(held))
    if vertices.size and vertices[-1] >= len(garment.vertices):
        raise InputError(
            "no such vertex",
            file=garment.source,
            key="attach_vertices",
            received=int(vertices[-1]),
            expected=f"0..{len(garment.vertices) - 1}",
        )
    return vertices


def coarse_garment(garment: Garment, settings: GarmentSettings) -> tuple[Garment, Binding | None]:
    """The coarse mesh of a garment: itself, or one made from it by decimation, to which it is then bound.

    Raises:
        InputError: a vertex with several places in the pattern, a mesh too coarse to decimate, or bad seams.
    """
    if settings.coarse_vertices is None:
        return garment, None
    assert garment.pattern is not None
    count = len(garment.vertices)
    if count < 8 * settings.coarse_vertices:
        raise InputError(
            "too many coarse vertices",
            file=garment.source,
            key="coarse_vertices",
            received=settings.coarse_vertices,
            expected=f"at most an eighth of the mesh's {count}",
        )
    flat = np.zeros((count, 2))
    flat[garment.faces] = garment.pattern
    several = np.flatnonzero((flat[garment.faces] != garment.pattern).any(axis=(1, 2)))
    if several.size:
        expected = "panels that share no vertex, sewn together by seams"
        key = f"face {several[0]}"
        raise InputError("a vertex with several places in the pattern", file=garment.source, key=key, expected=expected)
    seams = None if settings.seams is None else load_seams(settings.seams, count)
    vertices, subdivision = bind(
        garment.vertices, garment.faces, flat, seams, settings.coarse_vertices, settings.subdivision_count
    )
    return replace(garment, vertices=vertices, faces=subdivision.coarse_faces, pattern=None), subdivision.binding


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
        garment = _in_size(garment, settings, vertices, body.faces)
        garment, binding = coarse_garment(garment, settings)
        held = held_vertices(garment, settings)
        limits = None if settings.limits is None else load_limits(settings.limits, len(garment.vertices))
        garment, held, limits = _subdivided(garment, held, limits, settings.coarse_subdivisions)
        levels = build_levels(
            garment.vertices,
            garment.faces,
            held,
            vertices,
            body.faces,
            settings.subdivision_count,
            binding=binding,
            limits=limits,
            sewn=_sewn(garment),
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


def _subdivided(
    garment: Garment, held: np.ndarray, limits: Limits | None, times: int
) -> tuple[Garment, np.ndarray, Limits | None]:
    """A garment whose faces are cut in four so many times, on its smooth surface; with its held vertices and limits.

    Raises:
        InputError: more times than MOST_COARSE_SUBDIVISIONS.
    """
    if not times:
        return garment, held, limits
    if times > MOST_COARSE_SUBDIVISIONS:
        expected = f"0..{MOST_COARSE_SUBDIVISIONS}"
        raise InputError("too fine a mesh to simulate", key="coarse_subdivisions", received=times, expected=expected)
    finer, sewn = Subdivision.of(garment.faces, len(garment.vertices), times), _sewn(garment)
    vertices, pattern = finer.upsample(garment.vertices), finer.flat_corners(garment.pattern)
    cut = replace(garment, vertices=vertices, faces=finer.faces, pattern=pattern)
    if sewn is not None:
        sewn = sewn.subdivided(times)
        cut = replace(cut, layers=sewn.layers, max_stretch=sewn.max_stretch)
    return cut, held_between(finer, held), None if limits is None else limits.between(finer.matrix)


def _sewn(garment: Garment) -> SewnRest | None:
    """How a sewn garment rests; None for any other."""
    if garment.layers is None or garment.pattern is None:
        return None
    unlimited = np.full(len(garment.faces), MAX_STRETCH)
    return SewnRest(garment.pattern, garment.layers, unlimited if garment.max_stretch is None else garment.max_stretch)


def garment_of(scene: Scene) -> tuple[GarmentSettings, Garment]:
    """Settings and mesh of the only garment of a scene.

    Raises:
        InputError: several garments, or one that cannot be loaded.
    """
    if len(scene.garments) != 1:
        names = [garment.name for garment in scene.garments]
        raise InputError("one garment at a time", key="garment", received=names, expected="one [[garment]]")
    settings = scene.garments[0]
    return settings, load_garment(settings.mesh, pattern=settings.pattern)


def pattern_of(scene: Scene) -> np.ndarray | None:
    """Place of each corner of each face that is simulated in the flat pattern of a scene's only garment [m].

    Returns:
        shape (m, 3, 2); None without a pattern, or where it is that of a delivered fine mesh.

    Raises:
        InputError: as :func:`garment_of`.
    """
    settings, garment = garment_of(scene)
    pattern = garment.pattern
    if pattern is None or settings.coarse_vertices is not None:
        return None
    for _ in range(settings.coarse_subdivisions):
        pattern = cut_corners(pattern)
    return pattern


def with_subdivisions(scene: Scene) -> Scene:
    """The scene with the subdivisions that the folds of its fabrics need, where a garment does not name them.

    Folds of a skirt change by less than 10 % with a finer mesh where the mean edge is at most ``EDGE_SHARE`` of the
    fabric's gravity length; crumpled cloth needs more (``gube bench space``). The softest of the fabrics that the
    garment is learned in counts. A delivered fine mesh is as fine as it is.

    Raises:
        InputError: a mesh that cannot be loaded.
    """
    return replace(scene, garments=tuple(_with_subdivisions(scene, garment) for garment in scene.garments))


def _with_subdivisions(scene: Scene, settings: GarmentSettings) -> GarmentSettings:
    if settings.subdivisions is not None:
        return settings
    if settings.coarse_vertices is not None:
        return replace(settings, subdivisions=DELIVERED_SUBDIVISIONS)
    garment = load_garment(settings.mesh, pattern=settings.pattern)
    edge = float(ClothMesh.from_surface(garment.vertices, garment.faces).edge_lengths()[1].mean())
    edge /= 2.0**settings.coarse_subdivisions
    fabrics = [settings.fabric, *(PRESETS[name] for name in scene.training.fabrics)]
    wanted = EDGE_SHARE * min(fabric.gravity_length for fabric in fabrics)
    finest = MOST_SUBDIVISIONS if wanted == 0.0 else math.ceil(math.log2(edge / wanted))
    return replace(settings, subdivisions=min(max(finest, 1), MOST_SUBDIVISIONS))


def _in_size(garment: Garment, settings: GarmentSettings, body_vertices: np.ndarray, body_faces: np.ndarray) -> Garment:
    """The garment with the ease of the scene; vertices that are held on its own mesh stay where they are.

    Raises:
        InputError: as :func:`assets.ease.eased` and :func:`held_vertices`.
    """
    if not any(settings.ease):
        return garment
    seams = None if settings.seams is None else load_seams(settings.seams, len(garment.vertices))
    held = np.zeros(0, np.int64)
    if settings.coarse_vertices is None:  # otherwise numbers of loops and vertices are those of another mesh
        held = np.union1d(held_vertices(garment, settings), settings.pins).astype(np.int64)
    try:
        return eased(garment, settings.ease, held, body_vertices, body_faces, seams)
    except InputError as error:
        size = {"received": error.received, "expected": error.expected}
        raise InputError(error.problem, file=garment.source, key="ease", **size) from error


def simulation_of(scene: Scene, fine: bool = False) -> tuple[Simulation, Motion | None]:
    """The simulation of a scene at its start: garments on a body, or one garment that hangs on its pins.

    Args:
        scene: with one garment, or on a body with several.
        fine: simulate the subdivided mesh.

    Returns:
        the simulation at its start, and the motion of the body, None without one.

    Raises:
        InputError: as :meth:`GarmentSetup.of`; an attached garment without a body, or one that is pinned at a vertex
            which it lacks.
    """
    scene = with_subdivisions(scene)
    if scene.character is not None and len(scene.garments) > 1:
        return _layers_of(scene, fine)
    if scene.character is not None:
        stage = GarmentSetup.of(scene)
        settings, levels, motion = stage.settings, stage.levels, stage.motion()
        source, pose = body_source(stage.body), motion.pose(0.0)
    else:
        settings, garment = garment_of(scene)
        if settings.attach != "none" or settings.attach_vertices:
            raise InputError("nothing to attach to", key="garment[0].attach", expected="pins, or a [character]")
        if settings.limits is not None:
            expected = "a [character]: limits are about where a body carries vertices"
            raise InputError("nothing to be carried by", key="garment[0].limits", expected=expected)
        if max(settings.pins, default=0) >= len(garment.vertices):
            expected = f"0..{len(garment.vertices) - 1}"
            raise InputError("no such vertex", key="garment[0].pins", received=max(settings.pins), expected=expected)
        nothing = np.zeros((0, 3)), np.zeros((0, 3), np.int32)
        garment = _in_size(garment, settings, *nothing)
        pins = np.array(settings.pins, int)
        garment, pins, _ = _subdivided(garment, pins, None, settings.coarse_subdivisions)
        levels = build_levels(
            garment.vertices,
            garment.faces,
            pins,
            *nothing,
            settings.subdivision_count,
            sewn=_sewn(garment),
        )
        motion = source = pose = None
    attachment = levels.fine_attachment if fine else levels.coarse_attachment
    options = fine_options(scene, settings.subdivisions_of_mesh) if fine else scene.solver.options()
    model = _model_of(settings, levels, fine)
    return Simulation(model, attachment if source else None, source, pose, options, colliders_of(scene)), motion


def _model_of(settings: GarmentSettings, levels: Levels, fine: bool) -> Model:
    """A garment of a scene, coarse or fine, in its fabric."""
    mesh, held, limits = levels.coarse, levels.coarse_held, levels.coarse_limits
    if fine:
        mesh, held, limits = levels.fine, levels.fine_held, levels.fine_limits
    return build_model(mesh, fabric_of(settings), held, ModelOptions(pressure=settings.pressure), limits=limits)


def _layers_of(scene: Scene, fine: bool) -> tuple[Simulation, Motion]:
    """All garments of a scene on its body, as one model."""
    stages = [GarmentSetup.of(replace(scene, garments=(garment,))) for garment in scene.garments]
    options = scene.solver.options()
    if fine:
        options = fine_options(scene, max(garment.subdivisions_of_mesh for garment in scene.garments))
    models, attachments = [], []
    for stage in stages:
        levels = stage.levels
        models.append(_model_of(stage.settings, levels, fine))
        attachments.append(levels.fine_attachment if fine else levels.coarse_attachment)
    joined = (
        np.concatenate([getattr(part, name) for part in attachments]) for name in ("corners", "weights", "offset")
    )
    motion = stages[0].motion()
    source, pose = body_source(stages[0].body), motion.pose(0.0)
    return Simulation(layered(models), Attachment(*joined), source, pose, options, colliders_of(scene)), motion


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
