"""Content, quality and soundness of a wrinkle database: ``gube info`` and ``gube check``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pbd import InputError, State
from pbd.geometry import FAR
from runtime.output.figures import figure_lines
from runtime.output.verdict import first_lines, verdict
from wrinkles.charts import Charts
from wrinkles.database import WrinkleDatabase, code_version
from wrinkles.database_file import database_figures, read_database
from wrinkles.decoder import Decoder
from wrinkles.features import Stencil
from wrinkles.fine_surface import FineSurface
from wrinkles.levels import MAX_AREA_CORRECTION, build_garments, with_area_of
from wrinkles.patches import Patches
from wrinkles.schema import ENTRIES

__all__ = ["DatabaseCheck", "check_database", "info_text"]


def info_text(path: str | Path, *, everything: bool = False) -> tuple[str, dict[str, float]]:
    """What a database is, how good it is on motion from which it has not learned, and what it costs.

    Args:
        path: the database.
        everything: give all that the database holds after the verdict, in place of the first few rows.

    Returns:
        lines to print, and figures by name: all that are known.

    Raises:
        InputError: not a database, or a damaged one.
    """
    database = read_database(path)
    figures = _figures(database) | database_figures(path) | dict(database.quality)
    lines = [*verdict(database), ""]
    if not everything:
        lines += [f"  {label:<36}{text}" for label, text in _origin_rows(database)]
        return "\n".join([*lines, *first_lines(database.quality)]) + "\n", figures
    lines.append(
        f"{path}: wrinkles of '{database.garment_name}', made {database.created} by gube {database.code_version}"
    )
    if database.code_version != code_version():
        lines.append(f"  this is gube {code_version()}: its results may differ from the figures below")
    for title, rows in _sections(database, figures):
        width = max(18, *(len(label) + 2 for label, _ in rows))
        lines += ["", title] + [f"  {label:<{width}}{value}" for label, value in rows]
    lines += ["", *_quality_lines(database)]
    return "\n".join(lines) + "\n", figures


def _origin_rows(database: WrinkleDatabase) -> list[tuple[str, str]]:
    made = f"{database.created} by gube {database.code_version}, on {database.machine}"
    return [
        ("learned from", ", ".join(database.trained_on) or "nothing"),
        ("judged on", ", ".join(database.held_out) or "nothing"),
        ("made and timed", made if database.code_version == code_version() else f"{made} (this is {code_version()})"),
    ]


def _figures(database: WrinkleDatabase) -> dict[str, float]:
    """Single numbers of the database by the names that they have in the file, and its counts."""
    mapping = database.mapping
    area_ratio, bend_deg = database.rest_shape.figures(database.coarse_vertices, database.coarse_faces)
    figures: dict[str, float] = {
        "coarse_vertex_count": len(database.coarse_vertices),
        "coarse_face_count": len(database.coarse_faces),
        "fine_vertex_count": database.fine_vertex_count,
        "held_vertex_count": len(database.held),
        "rest_area_ratio": area_ratio,
        "rest_bend_deg": bend_deg,
        "feature_count": len(mapping.center),
        "hidden_width_1": mapping.weights_2.shape[1],
        "hidden_width_2": mapping.weights_2.shape[2],
        "region_count": len(mapping.weights_2),
        "atom_count": len(database.atoms.shapes),
    }
    values = dict(vars(database))
    for group in ("fabric", "solver", "atoms"):
        values |= {f"{group}_{name}": value for name, value in vars(values[group]).items()}
    values |= {f"solver_gravity_{axis}": g for axis, g in zip("xyz", database.solver.gravity, strict=True)}
    return figures | {name: value for name, value in values.items() if isinstance(value, (int, float))}


def _sections(database: WrinkleDatabase, figures: Mapping[str, float]) -> Iterator[tuple[str, list[tuple[str, str]]]]:
    """Titles, each with its rows of label and value."""
    yield "Garment", _garment_rows(database, figures)
    yield "Fabric", [("name", database.fabric_name), *_scalar_rows(database, "fabric")]
    pressure = ("pressure", f"{database.pressure:g} Pa")
    yield "Coarse model", [pressure, ("bend factor", f"{database.bend_factor:.6g}")]
    if database.other_fabrics:
        others = [(name, _other_fabric(name, database.quality)) for name in database.other_fabrics]
        yield "Other fabrics", others
    yield "Solver", [*_scalar_rows(database, "solver"), ("frame rate", f"{database.frame_rate:g} Hz")]
    yield "Dictionary", _dictionary_rows(database, figures)
    training = [
        ("learned from", ", ".join(database.trained_on) or "nothing"),
        ("held out", ", ".join(database.held_out) or "nothing"),
        ("took", f"{database.training_minutes:.1f} min on {database.machine}, seed {database.seed}"),
    ]
    yield "Training", training
    file = [
        ("size", f"{figures['database_mb']:.2f} MB, of which meshes {figures['mesh_mb']:.2f}"),
        ("beyond meshes", f"{figures['bytes_per_fine_vertex']:.1f} bytes a fine vertex"),
        ("compression", f"{figures['compression_ratio']:.2f}"),
        ("load", f"{figures['load_s']:.3f} s"),
    ]
    yield "File", file


def _scalar_rows(database: WrinkleDatabase, group: str) -> list[tuple[str, str]]:
    """The values of a group of the file, with their units."""
    units = {entry.name: "" if entry.unit == "-" else f" {entry.unit}" for entry in ENTRIES}
    rows = []
    for name, value in vars(getattr(database, group)).items():
        text = " ".join(f"{x:g}" for x in value) if isinstance(value, tuple) else f"{value:.6g}"
        rows.append((name.replace("_", " "), text + units[f"{group}/{name}"]))
    return rows


def _garment_rows(database: WrinkleDatabase, figures: Mapping[str, float]) -> list[tuple[str, str]]:
    coarse, faces, held = len(database.coarse_vertices), len(database.coarse_faces), len(database.held)
    made = " delivered, bound to" if database.binding else " of"
    area, bend = 100.0 * figures["rest_area_ratio"], figures["rest_bend_deg"]
    return [
        ("coarse", f"{coarse} vertices, {faces} faces, {held} vertices attached"),
        ("fine", f"{database.fine_vertex_count} vertices{made} {database.subdivisions} subdivisions"),
        ("coarse at rest", f"{area:.0f} % of the pattern's area, hinges bent by {bend:.1f} deg (RMS)"),
        ("body", f"{database.body_vertex_count} vertices, hash {database.body_hash[:12]}"),
    ]


def _dictionary_rows(database: WrinkleDatabase, figures: Mapping[str, float]) -> list[tuple[str, str]]:
    widths = [figures[name] for name in ("feature_count", "hidden_width_1", "hidden_width_2", "atom_count")]
    return [
        ("atoms", f"{figures['atom_count']}, holding {100.0 * database.atoms.kept:.1f} % of the wrinkles' slopes"),
        ("network", " - ".join(map(str, widths))),
        ("regions", f"{figures['region_count']}, each with a second and third layer of its own"),
        ("cut-off", f"{database.cutoff:.4g} m: the dictionary makes the shorter folds"),
    ]


def _other_fabric(name: str, quality: Mapping[str, float]) -> str:
    error, skill = (quality.get(f"{name}_{figure}") for figure in ("normal_error_deg", "normal_skill"))
    return "" if error is None else f"held out: normal error {error:.2f} deg, skill {skill:.3f}"


def _quality_lines(database: WrinkleDatabase) -> list[str]:
    """Table of figures on the first held-out clip, ours beside those of the baselines."""
    where = database.held_out[0] if database.held_out else "unknown, nothing was held out"
    return [f"Quality on motion from which it has not learned: {where}", *figure_lines(database.quality)]


class DatabaseCheck(NamedTuple):
    """One check: its name, whether it passed, and the values found."""

    check: str
    passed: bool
    detail: str


def check_database(path: str | Path) -> list[DatabaseCheck]:
    """Check all of a database: its file, its meshes and models, and the wrinkles that its dictionary decodes.

    Args:
        path: the database.

    Returns:
        one row for every check; a failed one leaves out the checks that need its result.

    Raises:
        InputError: the file is no database, or is damaged, so that nothing else can be checked.
    """
    figures = database_figures(path)
    database = read_database(path)
    checks = [
        DatabaseCheck("file", True, f"{figures['database_mb']:.2f} MB read in {figures['load_s']:.3f} s; hashes agree"),
        _check_build(database),
        _check_quality(database),
    ]
    try:
        subdivision = database.subdivision
        coarse, fine = subdivision.meshes(database.coarse_vertices, database.warp, sewn=database.sewn)
        coarse, ratio = with_area_of(coarse, fine)
        near = database.binding is not None or abs(ratio - 1.0) <= MAX_AREA_CORRECTION
        checks.append(DatabaseCheck("one rest metric", near, f"coarse area over fine area {ratio:.5f}"))
        model = build_garments(
            database.rest_shape.applied(coarse),
            database.layers,
            database.fabric,
            database.held,
            database.options,
            database.bend_factor,
            database.limits,
        )
        detail = f"{model.vertex_count} vertices, {1e3 * model.mass.sum():.0f} g, {len(model.hinges)} hinges"
        checks.append(DatabaseCheck("coarse model", True, detail))
        charts = Charts.of(coarse)
        patches = Patches.of(subdivision, charts)
        checks.append(_check_patches(patches, subdivision.fine_count))
        layer = None if database.layers is None else database.layers.layer
        stencil = Stencil.of(charts, database.held, layer)
        state, torn = State.at_rest(model), State.at_rest(model)
        rng, edge = np.random.default_rng(0), float(coarse.edge_lengths()[1].mean())
        torn.position[:, :3] += rng.normal(0.0, edge, coarse.vertices.shape)
        decoder = Decoder(stencil, database.mapping, database.atoms, database.novelty)
        surface = FineSurface(subdivision, patches, database.atoms.vertex_mean)
        checks.append(_check_decoding("decoding at rest", database, decoder, surface, state))
        checks.append(_check_decoding("decoding a torn garment", database, decoder, surface, torn))
    except InputError as error:
        checks.append(DatabaseCheck("garment", False, str(error)))
    return checks


def _check_build(database: WrinkleDatabase) -> DatabaseCheck:
    """Names the build that made the file. Files of other builds are good: how they are read follows their schema."""
    made = f"made by gube {database.code_version} on {database.created}"
    same = database.code_version == code_version()
    return DatabaseCheck("build", True, made + (", which is this one" if same else f"; this is gube {code_version()}"))


def _check_quality(database: WrinkleDatabase) -> DatabaseCheck:
    error, smooth = (database.quality.get(name) for name in ("normal_error_deg", "normal_error_smooth_deg"))
    if error is None or smooth is None:
        return DatabaseCheck("held-out motion", True, "not measured")
    return DatabaseCheck("held-out motion", error < smooth, f"normal error {error:.2f} deg, smooth {smooth:.2f} deg")


def _check_patches(patches: Patches, count: int) -> DatabaseCheck:
    """Blending weights of every fine vertex: none below zero, and together one."""
    off = float(np.abs(patches.blend.sum(axis=1) - 1.0).max())
    whole = len(patches.blend) == count and patches.blend.min() >= 0.0 and off < 1e-5
    return DatabaseCheck(
        "patches", bool(whole), f"{len(patches.blend)} fine vertices, weights add up to 1 within {off:.1g}"
    )


def _check_decoding(
    name: str, database: WrinkleDatabase, decoder: Decoder, surface: FineSurface, state: State
) -> DatabaseCheck:
    """Decode a garment far from any body: finite, and no wrinkle higher than the longest is long."""
    state.contact[:] = FAR
    vertices, flat = (
        np.zeros((database.subdivision.fine_count, 3), np.float32),
        np.zeros((database.subdivision.middle.fine_count, 4), np.float32),
    )
    with np.errstate(over="ignore", invalid="ignore"):  # an overflow fails the check below
        decoder.predict(state.position, state.contact)
        surface(flat, decoder.grids, decoder.frames, vertices)
        height = float(np.linalg.norm(vertices, axis=1).max())
    detail = f"wrinkles up to {1e3 * height:.1f} mm, cut-off {1e3 * database.cutoff:.0f} mm"
    return DatabaseCheck(name, bool(height < database.cutoff), detail)
