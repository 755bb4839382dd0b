"""How much of a garment is modelled: the parts that a player can leave out while it plays."""

from __future__ import annotations

from dataclasses import dataclass, fields

from pbd.errors import InputError

__all__ = ["Detail"]


@dataclass(frozen=True)
class Detail:
    """How much of a garment is modelled.

    Attributes:
        every: ticks from one update to the next; in between the garment goes on as it went.
        substeps: of the coarse simulation in an update.
        atoms: how many of the dictionary's atoms are used, the most important ones; 0 leaves the wrinkle layer out.
        sweeps: over the edges of the middle mesh that bring lengths back.
        passes: of relaxation on the fine mesh; with 0 the body is not kept out of the fine mesh either.
        level: 0 to simulate the mesh that the dictionary reads; 1 for the one below it, of a third of its vertices,
            on which it then hangs (:mod:`wrinkles.coarser`).

    Raises:
        InputError: a value that is no whole number, or too small or too large.
    """

    every: int
    substeps: int
    atoms: int
    sweeps: int
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
        return f"{every} {self.substeps} substeps{mesh}, {layer}, {self.sweeps} sweeps, {self.passes} relaxation passes"
