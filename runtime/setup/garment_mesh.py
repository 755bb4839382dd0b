"""The mesh of a scene's garment as it is simulated: in its size, decimated or subdivided, with the vertices held."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from assets.bands import REACH, distances, taut_bands
from assets.ease import eased
from assets.fabrics import PRESETS
from assets.garment import Garment, boundary_loops, highest_loop
from assets.io.scene import GarmentSettings, Scene
from assets.loading import load_garment
from assets.seams import load_seams
from assets.texture import joined
from pbd import ClothMesh, InputError, Limits
from pbd.mesh import MAX_STRETCH
from wrinkles.binding import Binding
from wrinkles.coarsening import bind
from wrinkles.levels import held_between
from wrinkles.surface import SewnRest, Subdivision, cut_corners

__all__ = [
    "coarse_garment",
    "carried_bands",
    "fastened_vertices",
    "garment_of",
    "held_vertices",
    "in_size",
    "pattern_of",
    "rest_of",
    "sewn_rest",
    "subdivided",
    "texture_of",
    "with_subdivisions",
]

EDGE_SHARE = 0.6  # mean edge over the gravity length of the fabric, at which folds of a skirt have converged [-]
MOST_SUBDIVISIONS = 3  # that a scene gets without naming them
MOST_COARSE_SUBDIVISIONS = 3  # of a mesh before it is simulated: 64 times its faces
DELIVERED_SUBDIVISIONS = 2  # of the coarse mesh under a delivered fine mesh


def carried_bands(
    garment: Garment, settings: GarmentSettings, body: tuple[np.ndarray, np.ndarray], below: list[Garment]
) -> GarmentSettings:
    """The settings with the numbers of the boundary loops that "bands" stands for, as :func:`taut_bands` finds them.

    What is fastened to a garment below is not carried by the body as well. A mesh that is decimated has no bands.

    Args:
        garment: as it lies on the body.
        settings: its own.
        body: vertices [m] and faces.
        below: the garments between this one and the body.
    """
    if settings.attach != "bands":
        return settings
    rest, loops = sewn_rest(garment), []
    if rest is not None and settings.fasten == "none" and not (settings.fasten_vertices or settings.coarse_vertices):
        found = taut_bands(garment.vertices, garment.faces, rest.pattern, rest.max_stretch, body)
        lower = [(one.vertices, one.faces) for one in below]
        # An outer band that lies on a garment below is not on the body.
        loops = [n for n, loop in found if all(distances(garment.vertices[loop], *one).min() > REACH for one in lower)]
    return replace(settings, attach=tuple(loops) or "none")


def held_vertices(garment: Garment, settings: GarmentSettings) -> np.ndarray:
    """Vertices that the scene attaches to the body: int, shape (p,).

    Raises:
        InputError: a loop or a vertex that the garment does not have.
    """
    return _chosen_vertices(garment, settings, "attach")


def fastened_vertices(garment: Garment, settings: GarmentSettings) -> np.ndarray:
    """Vertices that the scene fastens to the garments below: int, shape (k,).

    Raises:
        InputError: a loop or a vertex that the garment does not have.
    """
    return _chosen_vertices(garment, settings, "fasten")


def _chosen_vertices(garment: Garment, settings: GarmentSettings, key: str) -> np.ndarray:
    """Vertices of the boundary loops that a key of the settings names, and those of ``KEY_vertices``."""
    loops, chosen = boundary_loops(garment.faces), getattr(settings, key)
    found: list[np.ndarray] = [np.asarray(getattr(settings, f"{key}_vertices"), np.int64)]
    if chosen == "top":
        found.append(highest_loop(garment.vertices, garment.faces))
    elif chosen not in ("bands", "none"):
        for number in chosen:
            if not 0 <= int(number) < len(loops):
                raise InputError(
                    "no such boundary loop",
                    file=garment.source,
                    key=key,
                    received=number,
                    expected=f"0..{len(loops) - 1}",
                )
            found.append(loops[int(number)])
    vertices = np.unique(np.concatenate(found))
    if vertices.size and vertices[-1] >= len(garment.vertices):
        raise InputError(
            "no such vertex",
            file=garment.source,
            key=f"{key}_vertices",
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
    return replace(
        garment, vertices=vertices, faces=subdivision.coarse_faces, pattern=None, texture=None
    ), subdivision.binding


def subdivided(
    garment: Garment, held: np.ndarray, limits: Limits | None, times: int, fastened: np.ndarray | None = None
) -> tuple[Garment, np.ndarray, Limits | None, np.ndarray]:
    """A garment whose faces are cut in four so many times, on its smooth surface.

    Args:
        garment: its mesh.
        held, fastened: vertices, int, ascending; None are none.
        limits: of its vertices, or None.
        times: how often.

    Returns:
        the garment with its held vertices, limits and fastened vertices.

    Raises:
        InputError: more times than MOST_COARSE_SUBDIVISIONS.
    """
    fastened = np.zeros(0, np.int64) if fastened is None else fastened
    if not times:
        return garment, held, limits, fastened
    if times > MOST_COARSE_SUBDIVISIONS:
        expected = f"0..{MOST_COARSE_SUBDIVISIONS}"
        raise InputError("too fine a mesh to simulate", key="coarse_subdivisions", received=times, expected=expected)
    finer, sewn = Subdivision.of(garment.faces, len(garment.vertices), times), sewn_rest(garment)
    vertices = finer.upsample(garment.vertices)
    pattern, texture = finer.flat_corners(garment.pattern), finer.flat_corners(garment.texture)
    cut = replace(garment, vertices=vertices, faces=finer.faces, pattern=pattern, texture=texture)
    if sewn is not None:
        sewn = sewn.subdivided(times)
        cut = replace(cut, layers=sewn.layers, max_stretch=sewn.max_stretch)
    limits = None if limits is None else limits.between(finer.matrix)
    return cut, held_between(finer, held), limits, held_between(finer, fastened)


def sewn_rest(garment: Garment) -> SewnRest | None:
    """How a sewn garment rests; None for any other."""
    if garment.layers is None or garment.pattern is None:
        return None
    unlimited = np.full(len(garment.faces), MAX_STRETCH)
    return SewnRest(garment.pattern, garment.layers, unlimited if garment.max_stretch is None else garment.max_stretch)


def rest_of(garment: Garment) -> SewnRest:
    """How a garment rests beside a sewn one: as it was sewn, or else face by face as its mesh."""
    sewn = sewn_rest(garment)
    if sewn is not None:
        return sewn
    pattern, count = garment.pattern, len(garment.faces)
    if pattern is None:
        sides = ClothMesh.from_surface(garment.vertices, garment.faces).flat.swapaxes(1, 2)
        pattern = np.concatenate([np.zeros((count, 1, 2)), sides], axis=1)
    return SewnRest(pattern, np.ones(count), np.full(count, MAX_STRETCH))


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
    """Place of each corner of each face that is simulated in the flat patterns of a scene's garments [m].

    Returns:
        shape (m, 3, 2); None where a garment has no pattern, or has that of a delivered fine mesh.

    Raises:
        InputError: a garment that cannot be loaded.
    """
    found = []
    for settings in scene.garments:
        pattern = load_garment(settings.mesh, pattern=settings.pattern).pattern
        if pattern is None or settings.coarse_vertices is not None:
            return None
        for _ in range(settings.coarse_subdivisions):
            pattern = cut_corners(pattern)
        found.append(pattern)
    return np.concatenate(found)


def texture_of(scene: Scene, fine: bool = False) -> np.ndarray | None:
    """Texture coordinates of each corner of each face that is simulated.

    Args:
        scene: names the garments.
        fine: of the fine meshes instead of the coarse ones.

    Returns:
        shape (m, 3, 2), NaN at faces of a garment without; None without any, and for the coarse mesh under a delivered
        fine one.

    Raises:
        InputError: a garment that cannot be loaded.
    """
    more = max(garment.subdivision_count for garment in with_subdivisions(scene).garments) if fine else 0
    found = []
    for settings in scene.garments:
        garment = load_garment(settings.mesh, pattern=settings.pattern)
        cuts = settings.coarse_subdivisions + more
        if settings.coarse_vertices is not None:
            if not fine:
                return None
            cuts = 0
        texture = garment.texture
        for _ in range(cuts):
            texture = None if texture is None else cut_corners(texture)
        found.append((texture, len(garment.faces) * 4**cuts))
    return joined(found)


def with_subdivisions(scene: Scene) -> Scene:
    """The scene with the subdivisions that the folds of its fabrics need, where a garment does not name them.

    Folds of a skirt change by less than 10 % with a finer mesh where the mean edge is at most ``EDGE_SHARE`` of the
    fabric's gravity length; crumpled cloth needs more. The softest of the fabrics that the
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


def in_size(garment: Garment, settings: GarmentSettings, body_vertices: np.ndarray, body_faces: np.ndarray) -> Garment:
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
