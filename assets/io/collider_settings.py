"""Tables of a scene file about solids besides the body."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from assets.io.settings import AllowedValues, Reader, Refused, choice, entry, file_path, number, vector
from pbd import Capsule, Plane, Sphere

__all__ = ["COLLIDER", "CapsuleSettings", "ColliderSettings", "FieldSettings", "PlaneSettings", "SphereSettings"]

Vector = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class PlaneSettings:
    """A solid half space below a plane through ``point`` [m], with ``normal`` [-] of any length."""

    type: str = entry(choice("plane"), "plane")
    point: Vector = entry(vector(unit="m"), (0.0, 0.0, 0.0))
    normal: Vector = entry(vector(not_zero=True), (0.0, 1.0, 0.0))

    def primitive(self) -> Plane:
        """The collider, a new one each time."""
        return Plane(self.point, self.normal)


@dataclass(frozen=True, kw_only=True)
class SphereSettings:
    """A solid sphere: ``centre`` [m], ``radius`` [m]."""

    type: str = entry(choice("sphere"), "sphere")
    centre: Vector = entry(vector(unit="m"))
    radius: float = entry(number(above=0, unit="m"))

    def primitive(self) -> Sphere:
        """The collider, a new one each time."""
        return Sphere(self.centre, self.radius)


@dataclass(frozen=True, kw_only=True)
class CapsuleSettings:
    """A solid capsule around the segment from ``start`` to ``end`` [m]: ``radius`` [m]."""

    type: str = entry(choice("capsule"), "capsule")
    start: Vector = entry(vector(unit="m"))
    end: Vector = entry(vector(unit="m"))
    radius: float = entry(number(above=0, unit="m"))

    def primitive(self) -> Capsule:
        """The collider, a new one each time."""
        return Capsule(self.start, self.end, self.radius)


@dataclass(frozen=True, kw_only=True)
class FieldSettings:
    """A solid of any shape, given by signed distances on a grid.

    Attributes:
        type: says that it is a field.
        mesh: path of a closed mesh.
        spacing: of the grid [m]; finer detail is smoothed away.
        centre: where the mesh's own origin stands [m].
    """

    type: str = entry(choice("field"), "field")
    mesh: Path = entry(file_path(".obj", ".glb", ".gltf"))
    spacing: float = entry(number(above=0, unit="m"), 0.01)
    centre: Vector = entry(vector(unit="m"), (0.0, 0.0, 0.0))


ColliderSettings = PlaneSettings | SphereSettings | CapsuleSettings | FieldSettings
KINDS = {"plane": PlaneSettings, "sphere": SphereSettings, "capsule": CapsuleSettings, "field": FieldSettings}


def _read_collider(reader: Reader, value: Any, key: str) -> Any:
    if not isinstance(value, dict):
        raise Refused
    kind = reader.value(choice(*KINDS), value.get("type"), f"{key}.type")
    return reader.table(KINDS[kind], value, key) if kind else None


COLLIDER = AllowedValues("a table", _read_collider)
