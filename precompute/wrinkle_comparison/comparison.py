"""What `gube compare` found: methods with their figures, and which of them are as good as ours."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from precompute.learning.evaluation import CHANCE
from precompute.learning.truth import Truth
from precompute.wrinkle_comparison.realism import Realism

__all__ = ["ERRORS", "Advantage", "Comparison", "Method", "MotionComparison"]

ERRORS = {
    "octaves": "octave_error_max",
    "realism": "realism",
    "normals": "free_normal_error_deg",
    "bias": "low_frequency_bias",
    "spread": "low_frequency_spread",
}
"""By what plain cloth must be as good as ours, all at once: names of figures."""
OF_ONE_RUN = ("octaves", "realism", "normals")  # those that one run has: what fails by them is not run again
BEYOND = 2.0  # standard errors that a difference must exceed to be one


@dataclass(frozen=True)
class Method:
    """One way to make the fine garment.

    Attributes:
        prefix: of its figures' names; ours has none.
        name: for people.
        frame_ms: median processor time of a frame, body included [ms]; nan for the floor, which is no method. Of the
            truth in a brief comparison it is the time by the clock that its simulation took.
        figures: by name, without the prefix, see :func:`precompute.learning.evaluation.mean_figures`; none where it
            broke or was too dear to be played.
        settings: everything needed to repeat it.
        runs: fine vertices of each run [m], float32, shape (f, N, 3); none where it has no figures. Where they are
            mapped from files, another process gets the files' names and not the frames.
        broke_at: when it burst, see :class:`precompute.wrinkle_comparison.baselines.Played` [s].
        mesh: that plain cloth is simulated on; empty for what is no plain cloth.
        realism: how well its first run is distinguished from the truth; None for the truth and where it broke.
    """

    prefix: str
    name: str
    frame_ms: float
    figures: Mapping[str, float]
    settings: Mapping[str, float]
    runs: tuple[np.ndarray, ...] = field(default=(), repr=False)
    broke_at: float | None = None
    mesh: str = ""
    realism: Realism | None = field(default=None, repr=False)

    def __getstate__(self) -> dict[str, Any]:
        named = tuple((one.filename, one.shape) if isinstance(one, np.memmap) else one for one in self.runs)
        return self.__dict__ | {"runs": named}

    def __setstate__(self, state: dict[str, Any]) -> None:
        mapped = tuple(
            np.memmap(one[0], np.float32, "r", shape=one[1]) if isinstance(one, tuple) else one for one in state["runs"]
        )
        self.__dict__.update(state | {"runs": mapped})

    @property
    def ours(self) -> bool:
        """Whether it is a setting of the player with wrinkles."""
        return self.prefix == "" or self.prefix.startswith("ours_")

    @property
    def too_dear(self) -> bool:
        """Whether it is plain cloth that was given up for its cost."""
        return bool(self.mesh) and not self.figures and self.broke_at is None

    @property
    def frames(self) -> np.ndarray | None:
        """Of its first run."""
        return self.runs[0] if self.runs else None

    def error(self, name: str) -> float:
        """By one of ERRORS, 0 at best; nan where it is unknown."""
        value = self.figures.get(ERRORS[name], math.nan)
        return abs(math.log(max(value, 1e-9))) if name == "spread" and math.isfinite(value) else value

    def standard_error(self, name: str, alike: Method) -> float:
        """Of that error; of one run, which does not know its own chance, from that of another method."""
        known = CHANCE + ERRORS[name] in self.figures
        chance = (self if known else alike).figures.get(CHANCE + ERRORS[name], 0.0)
        if name == "spread":  # its error is a logarithm
            return chance / max(self.figures.get(ERRORS[name], 1.0), 1e-9)
        return chance if name == "bias" else chance / math.sqrt(len(self.runs) if known else 1)


class Advantage(NamedTuple):
    """What the cheapest plain cloth that is as good as ours costs, over ours.

    Attributes:
        ratio: of both times [-], means over the motions; below 1 plain cloth is the better choice.
        at_least: no plain cloth that was played is as good: the ratio is that of the cheapest that was too dear to be
            played, or of the dearest, a lower bound.
        cloth: the plain cloth, on the first motion.
        frame_ms: its time [ms].
    """

    ratio: float
    at_least: bool
    cloth: Method
    frame_ms: float

    def __str__(self) -> str:
        return f"{'at least ' if self.at_least else ''}{self.ratio:.2f}"


@dataclass(frozen=True)
class MotionComparison:
    """All methods on one motion.

    Attributes:
        motion: its name.
        truth: what is right.
        methods: in the order of the page.
    """

    motion: str
    truth: Truth = field(repr=False)
    methods: tuple[Method, ...]

    def method(self, prefix: str) -> Method:
        """The method whose figures have a prefix."""
        return next(method for method in self.methods if method.prefix == prefix)

    @property
    def plain(self) -> list[Method]:
        """Plain cloth, on all meshes."""
        return [method for method in self.methods if method.mesh]

    @property
    def equal_cost(self) -> Method | None:
        """The plain cloth whose time is nearest to ours, of those that did not break."""
        ours = self.method("").frame_ms
        whole = [method for method in self.plain if method.figures]
        return min(whole, key=lambda method: abs(math.log(method.frame_ms / ours)), default=None)

    def as_good(self, prefix: str, errors: Sequence[str]) -> bool:
        """Whether a method is as good as ours by each of some errors: no worse than ours or the floor, beyond chance.

        Args:
            prefix: of the method.
            errors: names of ERRORS. One that is unknown of the method is not as good.
        """
        return all(self.no_worse(self.method(prefix), self.method(""), name) for name in errors)

    def no_worse(self, one: Method, other: Method, error: str) -> bool:
        """Whether a method is no worse than another or the floor by one of ERRORS, beyond chance."""
        ours, floor = self.method(""), self.method("floor_")
        chance = math.hypot(one.standard_error(error, ours), other.standard_error(error, ours))
        return one.error(error) <= max(other.error(error), floor.error(error)) + BEYOND * chance

    def with_method(self, method: Method) -> MotionComparison:
        """The same where a method is another."""
        return replace(self, methods=tuple(method if one.prefix == method.prefix else one for one in self.methods))


@dataclass(frozen=True)
class Comparison:
    """All methods on all motions.

    Attributes:
        garment: its name.
        motions: the first is the one that figures without a prefix are of.
    """

    garment: str
    motions: tuple[MotionComparison, ...]

    def frame_ms(self, prefix: str = "") -> float:
        """Time of a frame of a method, mean over the motions [ms]."""
        return float(np.mean([motion.method(prefix).frame_ms for motion in self.motions]))

    @property
    def _plain(self) -> list[str]:
        """Prefixes of the plain cloths that held in every motion, the cheapest first."""
        found = [method.prefix for method in self.motions[0].plain]
        held = [one for one in found if all(motion.method(one).figures for motion in self.motions)]
        return sorted(held, key=self.frame_ms)

    @property
    def _too_dear(self) -> list[str]:
        """Prefixes of the plain cloths that were too dear to be played in some motion, the cheapest first."""
        found = {one.prefix for motion in self.motions for one in motion.plain if one.too_dear}
        return sorted(found, key=self.frame_ms)

    @property
    def candidates(self) -> list[str]:
        """Prefixes of the plain cloths that may be as good as ours by what one run tells, the cheapest first."""
        if not all(motion.method("").figures for motion in self.motions):
            return []
        return [one for one in self._plain if all(motion.as_good(one, OF_ONE_RUN) for motion in self.motions)]

    @property
    def as_good(self) -> list[str]:
        """Prefixes of the plain cloths that are as good as ours by all of ERRORS in every motion, cheapest first."""
        several = [one for one in self.candidates if len(self.motions[0].method(one).runs) != 1]
        return [one for one in several if all(motion.as_good(one, list(ERRORS)) for motion in self.motions)]

    @property
    def cost_advantage(self) -> Advantage | None:
        """How much dearer plain cloth is that is as good as ours; None where no plain cloth, or not ours, held."""
        whole, good = self._plain, self.as_good
        if not whole or not all(motion.method("").figures for motion in self.motions):
            return None
        prefix = good[0] if good else next(iter(self._too_dear), whole[-1])
        frame_ms = self.frame_ms(prefix)
        return Advantage(frame_ms / self.frame_ms(), not good, self.motions[0].method(prefix), frame_ms)

    @property
    def choice(self) -> dict[str, float]:
        """The figures that say whether plain cloth is the better choice, as a database keeps them; none if unknown."""
        found = self.cost_advantage
        if found is None:
            return {}
        return {
            "cost_advantage": found.ratio,
            "cost_advantage_is_at_least": float(found.at_least),
            "plain_frame_ms": found.frame_ms,
            "plain_substeps": found.cloth.settings["substeps a frame"],
            "plain_vertex_count": found.cloth.settings["simulated vertices"],
            "plain_passes": found.cloth.settings.get("relaxation passes", 0),
        }

    @property
    def figures(self) -> dict[str, float]:
        """Every figure by its full name; those of the second motion begin with the motion's."""
        found = dict(self.choice)
        for number, one in enumerate(self.motions):
            motion = f"{one.motion.replace(' ', '_')}_" if number else ""
            for method in one.methods:
                start = motion + method.prefix
                found |= {start + name: value for name, value in method.figures.items()}
                if np.isfinite(method.frame_ms):
                    found[f"{start}frame_ms_p50"] = method.frame_ms
                if method.realism is not None:
                    places = method.realism.by_place.items()
                    found |= {f"{start}realism_{name.replace(' ', '_')}": value for name, value in places}
        return found
