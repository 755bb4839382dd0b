"""Level of detail: which parts of the work a player leaves out while it plays."""

from __future__ import annotations

from dataclasses import dataclass, fields

from pbd.errors import InputError

__all__ = ["LevelOfDetail"]


@dataclass(frozen=True)
class LevelOfDetail:
    """How much of a garment is modelled.

    Attributes:
        every: ticks from one update to the next; in between the garment keeps its velocity.
        substeps: number of substeps of the coarse simulation in an update.
        atoms: number of the dictionary's atoms that are used, the most important ones; 0 leaves the wrinkle layer out.
        passes: number of relaxation passes on the fine mesh; with 0 the fine mesh may enter the body.
        level: 0 simulates the coarse mesh, which the dictionary reads; 1 simulates the mesh below it, which has a third
            of its vertices and carries the coarse mesh (:mod:`wrinkles.proxy_mesh`).

    Raises:
        InputError: a value that is not a whole number or is too small, or a level above 1.
    """

    every: int
    substeps: int
    atoms: int
    passes: int
    level: int = 0

    def __post_init__(self) -> None:
        for field in fields(self):
            value, least = getattr(self, field.name), int(field.name in ("every", "substeps"))
            if not isinstance(value, int) or value < least:
                expected = f"a whole number, at least {least}"
                raise InputError("bad detail", key=field.name, received=value, expected=expected)
        if self.level > 1:
            raise InputError("bad detail", key="level", received=self.level, expected="0 or 1")

    def __str__(self) -> str:
        layer = f"{self.atoms} atoms" if self.atoms else "no wrinkle layer"
        every = "every tick" if self.every == 1 else f"every {self.every} ticks"
        mesh = " on the mesh below" if self.level else ""
        return f"{every} {self.substeps} substeps{mesh}, {layer}, {self.passes} relaxation passes"
