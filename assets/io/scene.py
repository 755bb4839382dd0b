"""Scene files: TOML in, frozen settings out.

Lengths are metres, times seconds, masses kilograms, Y up. A path is relative to the scene file, and ``${GUBE_DATA}`` in
it stands for the data folder. Every error of a file is reported at once.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from assets.fabrics import PRESETS, load_fabric
from assets.garment import BUILTIN_GARMENTS
from assets.io.body_settings import CHARACTER_FILE, CharacterSettings, MotionSettings
from assets.io.collider_settings import COLLIDER, ColliderSettings
from assets.io.settings import (
    AllowedValues,
    Reader,
    Refused,
    choice,
    entry,
    file_path,
    indices,
    number,
    pair,
    settings_text,
    several,
    table,
    tables,
    text,
    truth,
    vector,
    whole,
)
from assets.io.view_settings import ViewSettings
from assets.text import read_text
from pbd import Fabric, InputError, SolverOptions
from pbd.wind import Wind

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

__all__ = [
    "CameraSettings",
    "GarmentSettings",
    "Scene",
    "SolverSettings",
    "TrainingSettings",
    "WindSettings",
    "WrinkleSettings",
    "load_scene",
    "parse_scene",
    "scene_of",
    "scene_text",
    "toml_file",
]

Vector = tuple[float, float, float]

_MESH = file_path(".obj", ".glb", ".gltf", ".npz", builtins=[f"builtin:{name}" for name in BUILTIN_GARMENTS])


def _loops(*names: str) -> AllowedValues:
    """Boundary loops: one of some names, or numbers."""

    def read(reader: Reader, value: Any, key: str) -> str | tuple[int, ...]:
        check = indices() if isinstance(value, list) else choice(*names)
        return check.convert(reader, value, key)

    return AllowedValues(f"{', '.join(map(repr, names))} or a list of boundary loop numbers", read)


def _read_fabric(reader: Reader, value: Any, key: str) -> Fabric | None:
    if isinstance(value, dict):
        return reader.table(Fabric, value, key)
    if isinstance(value, str) and value.endswith(".json"):
        return load_fabric(file_path(".json").convert(reader, value, key))
    if isinstance(value, str):
        return PRESETS[choice(*PRESETS).convert(reader, value, key)]
    raise Refused


_FABRIC = AllowedValues(f"one of {', '.join(PRESETS)}, path of a .json file or a table of SI values", _read_fabric)


@dataclass(frozen=True, kw_only=True)
class GarmentSettings:
    """One piece of clothing.

    Attributes:
        name: name in figures and files, unique in the scene.
        mesh: path of the garment's mesh, or a built-in one: "builtin:skirt".
        made_for: the character in whose bind pose the mesh was made, with the joints of the scene's; None for the
            scene's own.
        fit: what becomes of the lengths at rest of a garment that was made for another body: "body" lets the cloth grow
            and shrink as the body does, "lengths" keeps them.
        pattern: whether the mesh's texture coordinates are a flat pattern [m].
        fabric: its fabric; in a file a preset's name, the path of a .json file or a table of SI values.
        ease: shares (around, along) by which the cloth is larger than its mesh, "along" being the vertical laid into
            each face; see :func:`assets.ease.eased`.
        seams: path of the stitches between the mesh's panels: a .csv file with the columns v, a, b, w.
        coarse_vertices: about how many vertices the coarse mesh gets; the mesh is then the fine one, bound to the
            subdivided coarse mesh. None where the mesh itself is the coarse one.
        coarse_subdivisions: how often the mesh is subdivided for the coarse one, which is simulated.
        subdivisions: how often the coarse mesh is subdivided for the fine one; None where the folds of the fabric
            decide, see :func:`runtime.setup.garment_mesh.with_subdivisions`.
        attach: boundary vertices that the body carries: "bands" (rims of taut bands that do not give way, where they
            lie on the body, see :func:`runtime.setup.garment_mesh.carried_bands`), "top" (the highest loop), "none", or
            numbers of loops.
        attach_vertices: more vertices that the body carries.
        fasten: boundary vertices that are fastened to the garments below: "top", "none", or numbers of loops.
        fasten_vertices: more vertices that are fastened to the garments below, like buttons.
        pins: vertices fixed in space.
        limits: path of a .csv file of limits painted on the coarse mesh, about where the body carries its vertices,
            with the columns vertex, maximum_distance, backstop, stiffness; see :class:`pbd.Limits`.
        thickness: distance kept from the body [m]; None for the fabric's own.
        pressure: of the air inside over that outside [Pa].
    """

    name: str = entry(text())
    mesh: Path | str = entry(_MESH)
    made_for: Path | str | None = entry(CHARACTER_FILE, None)
    fit: str = entry(choice("body", "lengths"), "body")
    pattern: bool = entry(truth(), False)
    fabric: Fabric = entry(_FABRIC, Fabric())
    ease: tuple[float, float] = entry(pair(at_least=-0.5, at_most=2.0), (0.0, 0.0))
    seams: Path | None = entry(file_path(".csv"), None)
    coarse_vertices: int | None = entry(whole(at_least=50), None)
    coarse_subdivisions: int = entry(whole(at_least=0), 0)
    subdivisions: int | None = entry(whole(at_least=1), None)
    attach: str | tuple[int, ...] = entry(_loops("bands", "top", "none"), "bands")
    attach_vertices: tuple[int, ...] = entry(indices(), ())
    fasten: str | tuple[int, ...] = entry(_loops("top", "none"), "none")
    fasten_vertices: tuple[int, ...] = entry(indices(), ())
    pins: tuple[int, ...] = entry(indices(), ())
    limits: Path | None = entry(file_path(".csv"), None)
    thickness: float | None = entry(number(above=0, unit="m"), None)
    pressure: float = entry(number(unit="Pa"), 0.0)

    @property
    def subdivision_count(self) -> int:
        """``subdivisions`` of a scene in which they are named or chosen."""
        assert self.subdivisions is not None, "with_subdivisions chooses them"
        return self.subdivisions

    @property
    def subdivisions_of_mesh(self) -> int:
        """How often the mesh is subdivided for the fine one."""
        return self.coarse_subdivisions + self.subdivision_count

    def __post_init__(self) -> None:
        if self.seams is not None and self.coarse_vertices is None:
            raise InputError("seams of a mesh that is not the fine one", key="seams", expected="coarse_vertices beside")
        if self.coarse_vertices is not None and self.coarse_subdivisions:
            key, expected = "coarse_subdivisions", "0: coarse_vertices says how fine the coarse mesh is"
            raise InputError(
                "subdivisions of a fine mesh", key=key, received=self.coarse_subdivisions, expected=expected
            )
        if self.coarse_vertices is not None and not self.pattern:
            expected = "pattern = true: the rest shape of a mesh that is decimated is its pattern"
            raise InputError("no pattern", key="pattern", received=self.pattern, expected=expected)


@dataclass(frozen=True, kw_only=True)
class TrainingSettings:
    """The motions that the wrinkles are learned from and judged on.

    Attributes:
        clips: clips to learn from.
        held_out: clips that nothing is learned from.
        procedural_seconds: length of procedural motion to learn from as well [s].
        fabrics: presets to learn the wrinkles in besides the garment's own fabric.
        substep: of the fine runs on the garment's own mesh [s]; each subdivision to the fine mesh halves it.
    """

    clips: tuple[MotionSettings, ...] = entry(tables(table(MotionSettings)), ())
    held_out: tuple[MotionSettings, ...] = entry(tables(table(MotionSettings)), ())
    procedural_seconds: float = entry(number(at_least=0, unit="s"), 0.0)
    fabrics: tuple[str, ...] = entry(several(choice(*PRESETS)), ())
    substep: float = entry(number(above=0, unit="s"), SolverOptions.substep)


@dataclass(frozen=True, kw_only=True)
class WindSettings:
    """Wind with the mean ``velocity`` [m/s].

    Attributes:
        velocity: mean.
        turbulence: root mean square of each component of the eddies' velocity, over the mean speed [-].
        length: wavelength of the largest eddies [m].
    """

    velocity: Vector = entry(vector(unit="m/s"), (0.0, 0.0, 0.0))
    turbulence: float = entry(number(at_least=0), 0.0)
    length: float = entry(number(above=0, unit="m"), 1.0)

    def air(self) -> Wind:
        """The wind."""
        return Wind(self.velocity, self.turbulence, self.length)


@dataclass(frozen=True, kw_only=True)
class SolverSettings:
    """How a scene is simulated.

    Attributes:
        frame_rate: frames per second [Hz].

    All others are those of :class:`pbd.SolverOptions`, with its defaults but for self-collision, which scenes have on:
    ``substep``, ``gravity``, ``coarse_sweeps``, ``contact_refreshes``, ``self_collision``, ``local_damping``,
    ``linear_inertia``, ``angular_inertia``.
    """

    frame_rate: float = entry(number(above=0, unit="Hz"), 60.0)
    substep: float = entry(number(above=0, unit="s"), SolverOptions.substep)
    gravity: Vector = entry(vector(unit="m/s2"), SolverOptions.gravity)
    coarse_sweeps: int = entry(whole(at_least=0), SolverOptions.coarse_sweeps)
    contact_refreshes: float = entry(number(above=0, unit="Hz"), SolverOptions.contact_refreshes)
    self_collision: bool = entry(truth(), True)
    local_damping: float = entry(number(at_least=0, unit="1/s"), SolverOptions.local_damping)
    linear_inertia: float = entry(number(at_least=0, at_most=1), SolverOptions.linear_inertia)
    angular_inertia: float = entry(number(at_least=0, at_most=1), SolverOptions.angular_inertia)

    def options(self) -> SolverOptions:
        """The same settings as the solver takes them."""
        return SolverOptions(**{one.name: getattr(self, one.name) for one in fields(SolverOptions)})


@dataclass(frozen=True, kw_only=True)
class WrinkleSettings:
    """The size of the network and the dictionary that are learned.

    Attributes:
        hidden_width: width of the network's second hidden layer; the first is eight thirds as wide.
        atoms: atoms of the dictionary.
        seed: seed of every random choice in learning.
    """

    hidden_width: int = entry(whole(at_least=1), 36)
    atoms: int = entry(whole(at_least=1), 48)
    seed: int = entry(whole(at_least=0), 0)


@dataclass(frozen=True, kw_only=True)
class CameraSettings:
    """A camera of 16:9: ``position`` and ``target`` [m], vertical ``field_of_view_deg`` [deg]."""

    position: Vector = entry(vector(unit="m"), (0.0, 1.0, 3.0))
    target: Vector = entry(vector(unit="m"), (0.0, 1.0, 0.0))
    field_of_view_deg: float = entry(number(above=0, below=180, unit="deg"), 40.0)


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A resolved scene: every default filled in, every path absolute. Garments come from the innermost outwards.

    Raises:
        InputError: motions of different files with one name.
    """

    garments: tuple[GarmentSettings, ...] = entry(
        tables(table(GarmentSettings), at_least=1, unique="name"), key="garment"
    )
    character: CharacterSettings | None = entry(table(CharacterSettings, one_of=("file", "sequence")), None)
    training: TrainingSettings = entry(table(TrainingSettings), TrainingSettings())
    colliders: tuple[ColliderSettings, ...] = entry(tables(COLLIDER), (), key="collider")
    wind: WindSettings = entry(table(WindSettings), WindSettings())
    solver: SolverSettings = entry(table(SolverSettings), SolverSettings())
    wrinkles: WrinkleSettings = entry(table(WrinkleSettings), WrinkleSettings())
    camera: CameraSettings = entry(table(CameraSettings), CameraSettings())
    view: ViewSettings | None = entry(table(ViewSettings), None)

    def __post_init__(self) -> None:
        own = self.character.motion if self.character is not None else None
        motions = (*(() if own is None else (own,)), *self.training.clips, *self.training.held_out)
        named = {motion.name: motion for motion in motions}
        for motion in motions:
            files = [str(one.file) for one in (named[motion.name], motion)]
            if files[0] != files[1]:
                expected = 'label = "another name" beside the file of one of them'
                problem = f"two motions with the name {motion.name!r}"
                raise InputError(problem, key="training", received=files, expected=expected)


def load_scene(path: str | Path) -> Scene:
    """Read a scene file.

    Raises:
        InputError: the file cannot be read or is not TOML; or values that cannot be used, with every such place.
    """
    return scene_of(toml_file(path), path)


def parse_scene(text: str, path: str | Path = "scene.toml") -> Scene:
    """Read a scene that is not in a file of its own.

    Args:
        text: TOML.
        path: the file that errors name. Paths in the scene are relative to its folder; by default that is the working
            folder.

    Raises:
        InputError: not TOML, or values that cannot be used, with every such place.
    """
    return scene_of(_toml(text, Path(path)), path)


def toml_file(path: str | Path) -> dict[str, Any]:
    """The tables of a scene file, as they stand.

    Raises:
        InputError: the file cannot be read or is not TOML.
    """
    path = Path(path)
    return _toml(read_text(path, "a scene file (TOML)"), path)


def _toml(text: str, path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(text.removeprefix("\ufeff"))  # a byte order mark
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"not TOML: {error}", file=path) from error


def scene_of(values: dict[str, Any], path: str | Path) -> Scene:
    """The scene that tables of a scene file describe.

    Args:
        values: the tables.
        path: as for :func:`parse_scene`.

    Raises:
        InputError: values that cannot be used, with every such place.
    """
    reader = Reader(Path(path))
    scene = reader.table(Scene, values)
    if reader.errors:
        raise InputError.join(reader.errors)
    return scene


def scene_text(scene: Scene) -> str:
    """The scene as TOML that :func:`parse_scene` reads back to the same settings."""
    return settings_text(scene)
