"""Guesses about a garment for a new scene file: unit, axes, kind, what holds it, fabric, and how fine it is."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from assets.fabrics import PRESETS
from assets.garment import Garment, StoredSurface, boundary_loops, checked_garment
from assets.io.converted import write_garment
from assets.loading import load_garment, read_surface
from assets.placement import AS_STORED, UNITS, FilePlacement, Fit, best_placement, fit_of
from assets.seams import load_seams
from pbd import ClothMesh, InputError
from pbd.mesh import edges_of
from runtime.setup.new_body import BodyGuess
from wrinkles.clearance import facing
from wrinkles.levels import CLEARANCE

__all__ = ["GarmentGuess", "guess_garment"]

# Heights over the soles as shares of the stature: Drillis and Contini (1966) have the shoulders at 0.82, the hips at
# 0.53; the crotch lies lower, and the breast between. A dress
# ends below HEM.
SHOULDER, BREAST, CROTCH, HEM = 0.78, 0.67, 0.47, 0.43
FABRICS = {"shirt": "jersey", "dress": "cotton", "skirt": "wool", "trousers": "denim", "overall": "denim"}
WORDS = {"jeans": "denim", "jersey": "jersey", "knit": "jersey", "silk": "silk", "satin": "silk", "nylon": "polyester"}
MAX_COARSE = 3500  # vertices that are simulated, where the mesh leaves the choice
MIN_COARSE_EDGE = 0.012  # of that mesh [m]
DENSE = 8000  # vertices from which on a frame is slow
MAX_HOLE = 0.12  # a boundary loop that is shorter [m], or has so few edges, is a hole rather than an opening
MAX_HOLE_EDGES = 6
MAX_SEAM_GAP = 0.005  # of a stitch between panels that are closed [m]
PATTERN_SPREAD = (0.85, 1.18)  # edges in space over edges of a flat pattern, from the 5th to the 95th percentile [-]
TIGHT = 0.008  # median distance from the body of a garment that lies on it like a skin [m]


@dataclass(frozen=True)
class GarmentGuess:
    """A garment, loaded, with what a scene says about it.

    Attributes:
        garment: the mesh in metres, Y up.
        file: what the scene names: the file itself, one that was written beside the scene, or a built-in garment.
        placement: unit and axes of the file that was given.
        turned: whether its faces pointed at the body and were turned.
        fit: how it lies on the body.
        kind: a key of FABRICS.
        fabric: name of a preset.
        attach: "top", "bands" or "none".
        seams: its stitches; None without.
        coarse_subdivisions: see :class:`assets.io.scene.GarmentSettings`.
        notes: what is doubtful about it, a sentence each.
    """

    garment: Garment
    file: Path | str
    placement: FilePlacement
    turned: bool
    fit: Fit
    kind: str
    fabric: str
    attach: str
    seams: Path | None
    coarse_subdivisions: int
    notes: tuple[str, ...]

    @property
    def area(self) -> float:
        """Of its cloth [m2]."""
        return _area(self.garment)

    @property
    def edge(self) -> float:
        """Mean length of its edges [m]."""
        return float(_edge_lengths(self.garment).mean())


def guess_garment(path: str, body: BodyGuess, folder: Path) -> GarmentGuess:
    """Load a garment and look how the body wears it; where unit, axes or sides are others it is written once more.

    Args:
        path: an .obj, .glb or .gltf file, a sewn garment (.npz), or a built-in one.
        body: that wears it.
        folder: of the scene.

    Raises:
        InputError: as :func:`assets.loading.load_garment`; panels that nothing holds together; or a garment that the
            body does not wear: it lies elsewhere, or starts inside the body.
    """
    if path.startswith("builtin:") or path.lower().endswith(".npz"):
        file: Path | str = path if path.startswith("builtin:") else Path(path).absolute()
        garment, placement, turned, seams = load_garment(file), AS_STORED, False, None
        fit = _worn(fit_of(garment.vertices, garment.faces, body.vertices, body.body.faces), path, body)
    else:
        file = Path(path).absolute()
        garment, placement, fit = _placed(read_surface(file), body, path)
        mesh = ClothMesh.from_surface(garment.vertices, garment.faces)
        turned = facing(mesh, body.vertices, body.body.faces) < 0.0
        if placement != AS_STORED or turned:
            garment, file = _written(garment, turned, folder / f"{file.stem}_metres.obj", f"{file.name}, {placement}")
        seams = _seams_of(garment, Path(path).absolute())
    if not boundary_loops(garment.faces):
        expected = "one surface without thickness, with openings for the body"
        raise InputError("a closed mesh", file=path, key="openings", expected=expected)
    kind = _kind(garment, body.vertices)
    pieces = _piece_count(garment)
    if pieces > 1 and seams is None and garment.layers is None:
        expected = "one piece, or a .csv file of stitches (columns v,a,b,w) beside it"
        raise InputError(f"{pieces} pieces that nothing holds together", file=path, key="pieces", expected=expected)
    on_shoulders = kind in ("shirt", "dress", "overall") and _highest(garment, body.vertices) > SHOULDER
    held = pieces == 1 and not on_shoulders
    return GarmentGuess(
        garment=garment,
        file=file,
        placement=placement,
        turned=turned,
        fit=fit,
        kind=kind,
        fabric=_fabric(garment.name, kind),
        attach="bands" if garment.layers is not None else "top" if held else "none",
        seams=seams,
        coarse_subdivisions=0 if seams is not None or garment.layers is not None else _coarse_subdivisions(garment),
        notes=tuple(_notes(garment, fit, seams)),
    )


def _placed(surface: StoredSurface, body: BodyGuess, path: str) -> tuple[Garment, FilePlacement, Fit]:
    """The garment in the unit and the axes in which the body wears it, checked, with its pattern if it has one."""
    placement, fit = best_placement(surface.vertices, surface.faces, body.vertices, body.body.faces)
    if fit is None:
        raise InputError(
            f"not the size of a garment for {body.body.name}",
            file=path,
            key="bounding box",
            received=", ".join(f"{size:.4g}" for size in np.ptp(surface.vertices, axis=0)),
            expected=f"0.12 to 1.4 times the body's height of {np.ptp(body.vertices[:, 1]):.2f} m, in whatever unit",
        )
    scale = UNITS[placement.unit]
    vertices = surface.vertices @ placement.matrix.T
    garment = checked_garment(replace(surface, vertices=vertices))
    for factor in dict.fromkeys((1.0, scale)):
        texture = None if surface.texture is None else surface.texture * factor
        try:
            flat = checked_garment(replace(surface, vertices=vertices, texture=texture), pattern=True)
        except InputError:
            continue
        if _is_pattern(flat):
            garment = flat
            break
    # Faces that are wound alike have openings, which those of the file need not have.
    fit = fit_of(garment.vertices, garment.faces, body.vertices, body.body.faces)
    return garment, placement, _worn(fit, path, body)


def _worn(fit: Fit, path: str, body: BodyGuess) -> Fit:
    """The fit, refused if the body does not wear the garment."""
    name = body.body.name
    if fit.is_worn:
        return fit
    if not fit.is_around:
        raise InputError(
            f"does not fit {name}: it lies beside the body",
            file=path,
            received=f"openings {fit.opening_gap:.2f} m off the body or more, its surface {max(fit.gap, 0.0):.2f} m",
            expected="a garment around the body in its bind pose",
        )
    received = f"{100.0 * fit.deep_share:.0f} % of it more than 1 cm deep, {-1e3 * fit.gap:.0f} mm at most"
    raise InputError(
        f"starts inside the body of {name}: made for another body or another pose",
        file=path,
        received=received,
        expected="a garment around the body in its bind pose",
    )


def _written(garment: Garment, turned: bool, target: Path, note: str) -> tuple[Garment, Path]:
    """The garment with its faces turned, if they are to be, written to a file of its own."""
    if turned:
        texture = None if garment.texture is None else garment.texture[:, [0, 2, 1]]
        garment = replace(garment, faces=np.ascontiguousarray(garment.faces[:, [0, 2, 1]]), texture=texture)
    write_garment(
        target, garment.vertices, garment.faces, garment.texture, f"{note}; here metres, Y up, faces outwards"
    )
    return load_garment(target, pattern=garment.pattern is not None), target


def _edge_lengths(garment: Garment) -> np.ndarray:
    edges, _ = edges_of(garment.faces)
    return np.linalg.norm(garment.vertices[edges[:, 1]] - garment.vertices[edges[:, 0]], axis=1)


def _area(garment: Garment) -> float:
    corner = garment.vertices[garment.faces]
    normals = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    return 0.5 * float(np.linalg.norm(normals, axis=1).sum())


def _is_pattern(garment: Garment) -> bool:
    """Whether texture coordinates that could be a pattern keep the lengths of edges, which those of an atlas do not."""
    assert garment.pattern is not None
    space, flat = (
        np.linalg.norm(np.roll(x, -1, axis=1) - x, axis=2) for x in (garment.vertices[garment.faces], garment.pattern)
    )
    low, high = np.quantile(space / flat, [0.05, 0.95])
    return bool(PATTERN_SPREAD[0] <= low and high <= PATTERN_SPREAD[1])


def _piece_count(garment: Garment) -> int:
    a, b, c = garment.faces.T
    rows, columns = np.concatenate([a, b]), np.concatenate([b, c])
    count = len(garment.vertices)
    return int(connected_components(coo_matrix((np.ones(len(rows)), (rows, columns)), (count, count)))[0])


def _seams_of(garment: Garment, path: Path) -> Path | None:
    """A file of stitches beside a garment in panels, if its stitches are closed on this mesh."""
    if garment.pattern is None:
        return None
    for file in sorted(path.parent.glob("*.csv")):
        try:
            seams = load_seams(file, len(garment.vertices))
        except InputError:
            continue  # of another garment, or no stitches
        v, a, b = (garment.vertices[seams.vertices[:, k]] for k in range(3))
        w = seams.weights[:, None]
        if np.linalg.norm(v - (1.0 - w) * a - w * b, axis=1).max() <= MAX_SEAM_GAP:
            return file
    return None


def _highest(garment: Garment, body_vertices: np.ndarray) -> float:
    """Height of a garment's highest vertex over the soles, over the body's height [-]."""
    floor, height = body_vertices[:, 1].min(), np.ptp(body_vertices[:, 1])
    return float((garment.vertices[:, 1].max() - floor) / height)


def _kind(garment: Garment, body_vertices: np.ndarray) -> str:
    """The kind of a garment, by the heights of its ends, and by two openings side by side below the crotch."""
    floor, height = body_vertices[:, 1].min(), np.ptp(body_vertices[:, 1])
    low = float((garment.vertices[:, 1].min() - floor) / height)
    high = _highest(garment, body_vertices)
    middles = [garment.vertices[loop].mean(axis=0) for loop in boundary_loops(garment.faces)]
    below = [middle for middle in middles if middle[1] < floor + CROTCH * height]
    legs = len(middles) >= 3 and len(below) == 2 and np.linalg.norm((below[0] - below[1])[[0, 2]]) > 0.05 * height
    if high > SHOULDER:
        return "overall" if legs else "dress" if low < HEM else "shirt"
    if legs:
        return "trousers"
    return "dress" if high > BREAST and low < HEM else "shirt" if high > BREAST else "skirt"


def _fabric(name: str, kind: str) -> str:
    """A preset: one that the garment's name speaks of, else the one of its kind."""
    words = re.split(r"[^a-z]+", name.lower())
    named = [WORDS.get(word, word) for word in words if word in WORDS or word in PRESETS]
    return named[0] if named else FABRICS[kind]


def _coarse_subdivisions(garment: Garment) -> int:
    """How often a mesh can be subdivided for the coarse one."""
    count, edge, times = len(garment.vertices), float(_edge_lengths(garment).mean()), 0
    while times < 2 and 4 ** (times + 1) * count <= MAX_COARSE and edge / 2 ** (times + 1) >= MIN_COARSE_EDGE:
        times += 1
    return times


def _notes(garment: Garment, fit: Fit, seams: Path | None) -> list[str]:
    """What is doubtful about a garment."""
    notes = []
    if fit.gap < -CLEARANCE:
        notes.append(
            f"{100.0 * fit.inside_share:.1f} % of it starts inside the body, {-1e3 * fit.gap:.0f} mm at most; it is "
            "pushed out when it is loaded. Move it out in your modelling program for clean folds."
        )
    if seams is None and garment.layers is None:
        holes = _holes(garment)
        if holes:
            size, place = holes[0]
            notes.append(
                f"{len(holes)} hole{'s' * (len(holes) > 1)} beside its openings, the first of {100.0 * size:.0f} cm "
                f"around at ({', '.join(f'{x:.2f}' for x in place)}) m. Fill what is not meant (Blender: Select, All "
                "by Trait, Non Manifold; Face, Fill)."
            )
    if seams is None and len(garment.vertices) > DENSE:
        notes.append(
            f"{len(garment.vertices)} vertices are simulated as they are, which is slow in a game. Give a coarser mesh."
        )
    if fit.gap_p50 < TIGHT and garment.pattern is None and seams is None and garment.layers is None:
        notes.append("It lies on the body like a skin, and such cloth has hardly any folds: try the `ease` below.")
    return notes


def _holes(garment: Garment) -> list[tuple[float, np.ndarray]]:
    """Boundary loops too short to be openings: length [m] and middle [m]."""
    found = []
    for loop in boundary_loops(garment.faces):
        places = garment.vertices[loop]
        length = float(np.linalg.norm(np.roll(places, -1, axis=0) - places, axis=1).sum())
        if length < MAX_HOLE or len(loop) <= MAX_HOLE_EDGES:
            found.append((length, places.mean(axis=0)))
    return found
