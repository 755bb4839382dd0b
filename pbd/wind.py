"""Wind with turbulence: a mean flow that carries eddies along."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pbd.arrays import floats
from pbd.errors import InputError

__all__ = ["CALM", "Air", "Wind"]

CALM = (0.0, 0.0, 0.0)

MODES = 48  # random waves
SCALE_RANGE = 32.0  # length of the largest eddies over that of the smallest [-]


@dataclass(frozen=True)
class Wind:
    """A mean wind and eddies in it, carried along by it as they are and turning over by themselves.

    The eddies are a sum of random waves, each across its own wave vector, so that the flow has no divergence; their
    sizes are spread evenly on a logarithmic scale, with amplitudes by Kolmogorov's law, u ~ k^(-1/3) (R. H. Kraichnan,
    Diffusion by a random velocity field, Physics of Fluids 13 (1970); frozen flow: G. I. Taylor 1938).

    Attributes:
        velocity: mean [m/s].
        turbulence: root mean square of each component of what the eddies add, over the mean speed [-].
        length: wavelength of the largest eddies [m].
        gust: wind besides, which carries no eddies along [m/s].
        seed: of the eddies.

    Raises:
        InputError: a velocity that is not three finite numbers, turbulence below 0 or a length not above 0.
    """

    velocity: tuple[float, float, float]
    turbulence: float = 0.0
    length: float = 1.0
    gust: tuple[float, float, float] = CALM
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("velocity", "gust"):
            floats(getattr(self, name), name, (3,), "bad wind", unit=" [m/s]")
        if not (np.isfinite(self.turbulence) and self.turbulence >= 0):
            expected = "a finite number, at least 0"
            raise InputError("bad wind", key="turbulence", received=self.turbulence, expected=expected)
        if not (np.isfinite(self.length) and self.length > 0):
            raise InputError("bad wind", key="length", received=self.length, expected="a finite number above 0 [m]")

    @cached_property
    def _waves(self) -> tuple[np.ndarray, ...]:
        """Wave vectors [1/m], amplitudes [m/s], rates [rad/s] and phases of the eddies."""
        rng = np.random.default_rng(self.seed)
        direction, other = rng.normal(size=(2, MODES, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        across = np.cross(direction, other)
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        number = 2.0 * np.pi / self.length * SCALE_RANGE ** ((np.arange(MODES) + 0.5) / MODES)
        size = number ** (-1.0 / 3.0)
        # The mean square of a wave is half its amplitude's; each of three components has the speed's.
        size *= self.turbulence * np.linalg.norm(self.velocity) * np.sqrt(6.0 / (size**2).sum())
        # An eddy turns over in the time in which its own speed covers its length.
        phase = rng.uniform(0.0, 2.0 * np.pi, MODES)
        return number[:, None] * direction, size[:, None] * across, size * number, phase

    def at(self, points: np.ndarray, t: float) -> np.ndarray:
        """Velocity of the air at points [m], shape (n, 3), at a time [s]: [m/s], shape (n, 3); (3,) without eddies."""
        mean = np.add(self.velocity, self.gust)
        if not self.turbulence:
            return mean
        waves, across, rates, phase = self._waves
        carried = floats(points, "points", ("n", 3), unit=" [m]") - t * np.array(self.velocity)
        return mean + np.cos(carried @ waves.T + (phase + t * rates)) @ across


Air = Wind | tuple[float, float, float] | np.ndarray  # wind, or the velocity of the air everywhere [m/s]
