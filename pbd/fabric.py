"""Fabrics in SI units, with warp and weft."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from pbd.errors import InputError

__all__ = ["MAX_STIFFENING_STRAIN", "Fabric", "stiffening_stress"]

MAX_STIFFENING_STRAIN = 0.2  # up to which tension is a cubic of the strain [-]: fabrics are measured up to 17 %


@dataclass(frozen=True)
class Fabric:
    """An orthotropic fabric in plane stress. Warp is the first material axis, weft the second.

    Attributes:
        areal_density: mass per area rho_A [kg/m2].
        stretch_warp: Young's modulus times thickness along the warp, E1 h [N/m].
        stretch_weft: the same along the weft, E2 h [N/m].
        poisson: nu12, contraction of the weft under tension of the warp [-]; nu21 = nu12 E2/E1.
        shear: in-plane shear modulus times thickness, G h [N/m].
        bend_warp: bending stiffness per width for curvature along the warp [N m].
        bend_weft: the same along the weft [N m].
        thickness: distance kept between the middle surface and a collider, without pressure [m].
        compression: pressure p_c of van Wyk's law, by which the thickness T gives way to a pressure
            P = p_c ((thickness/T)^3 - 1) [Pa]; 0 for a thickness that does not give way.
        friction: Coulomb coefficient against colliders [-].
        air_drag: drag coefficient of the surface for flow along its normal [-].
        bend_hysteresis_warp: width of the loop that the moment per width makes over the curvature along the warp when
            the cloth is bent to and fro, Kawabata's 2HB [N]: twice the moment of its internal friction.
        bend_hysteresis_weft: the same along the weft [N].
        stiffening_warp_10: tension along the warp at 10 % strain, over ``stretch_warp`` times the strain [-]; 1 for a
            straight line. Curves of knits are J-shaped: 2 to 10.
        stiffening_warp_20: the same at 20 % strain. See :meth:`stiffening`.
        stiffening_weft_10, stiffening_weft_20: the same along the weft [-].
        shear_hysteresis: width of the loop that the shear force per width makes over the shear when the cloth is
            sheared to and fro, Kawabata's 2HG [N/m]: twice the force of its internal friction.

    Raises:
        InputError: a value that is not finite, not positive where it must be, a Poisson ratio for which the
            elasticity is not positive definite, or a tension that falls with strain; all of them at once.
    """

    areal_density: float = 0.15
    stretch_warp: float = 2000.0
    stretch_weft: float = 2000.0
    poisson: float = 0.2
    shear: float = 300.0
    bend_warp: float = 1.0e-5
    bend_weft: float = 1.0e-5
    thickness: float = 0.003
    compression: float = 0.0
    friction: float = 0.3
    air_drag: float = 1.0
    bend_hysteresis_warp: float = 0.0
    bend_hysteresis_weft: float = 0.0
    stiffening_warp_10: float = 1.0
    stiffening_warp_20: float = 1.0
    stiffening_weft_10: float = 1.0
    stiffening_weft_20: float = 1.0
    shear_hysteresis: float = 0.0

    def __post_init__(self) -> None:
        errors = []
        may_be_zero = {"poisson", "friction", "air_drag", "bend_warp", "bend_weft", "compression"}
        may_be_zero |= {"bend_hysteresis_warp", "bend_hysteresis_weft", "shear_hysteresis"}
        for field in fields(self):
            value = getattr(self, field.name)
            wanted = "a finite number, at least 0" if field.name in may_be_zero else "a finite number above 0"
            is_number = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
            if not is_number or value < 0 or (value == 0 and field.name not in may_be_zero):
                errors.append(
                    InputError("bad fabric value", key=f"fabric.{field.name}", received=value, expected=wanted)
                )
        if not errors and self.poisson**2 * self.stretch_weft / self.stretch_warp >= 1.0:
            limit = math.sqrt(self.stretch_warp / self.stretch_weft)
            errors.append(
                InputError(
                    "the elasticity is not positive definite",
                    key="fabric.poisson",
                    received=self.poisson,
                    expected=f"below sqrt(E1/E2) = {limit:.3g}",
                )
            )
        if not errors:
            errors += self._falling()
        if errors:
            raise InputError.join(errors)

    def _falling(self) -> list[InputError]:
        """An error for each axis along which tension falls with strain somewhere."""
        strain = np.linspace(0.0, MAX_STIFFENING_STRAIN, 101)
        errors = []
        for axis, (first, second) in zip(("warp", "weft"), self.stiffening(), strict=True):
            if (1.0 + strain * (2.0 * first + 3.0 * second * strain)).min() <= 0.0:
                received = tuple(getattr(self, f"stiffening_{axis}_{percent}") for percent in (10, 20))
                expected = "tension that rises with strain up to 20 %"
                key = f"fabric.stiffening_{axis}_10, _20"
                errors.append(InputError("tension that falls", key=key, received=received, expected=expected))
        return errors

    def stiffening(self) -> np.ndarray:
        """(a, b) of the warp and of the weft [-], shape (2, 2): tension is E h e (1 + a e + b e^2) at a strain e.

        So up to ``MAX_STIFFENING_STRAIN``; beyond it the curve goes on along its tangent. Under compression it is the
        straight line E h e.
        """
        ten = np.array([self.stiffening_warp_10, self.stiffening_weft_10]) - 1.0
        twenty = np.array([self.stiffening_warp_20, self.stiffening_weft_20]) - 1.0
        return np.stack([20.0 * ten - 5.0 * twenty, 50.0 * twenty - 100.0 * ten], axis=1)

    def membrane_stiffness(self) -> np.ndarray:
        """Plane-stress matrix D [N/m], shape (3, 3), for strains (e11, e22, gamma12 = 2 e12).

        c11 = E1/(1 - nu12 nu21), c22 = E2/(1 - nu12 nu21), c12 = nu21 c11 with E1 nu21 = E2 nu12; all times thickness.
        """
        nu21 = self.poisson * self.stretch_weft / self.stretch_warp
        scale = 1.0 / (1.0 - self.poisson * nu21)
        c12 = nu21 * self.stretch_warp * scale
        return np.array(
            [[self.stretch_warp * scale, c12, 0.0], [c12, self.stretch_weft * scale, 0.0], [0.0, 0.0, self.shear]]
        )

    @property
    def gravity_length(self) -> float:
        """l_g = (B / (rho_A g))^(1/3) [m] with B the geometric mean of warp and weft."""
        bend = math.sqrt(self.bend_warp * self.bend_weft)
        return (bend / (self.areal_density * 9.81)) ** (1.0 / 3.0)


def stiffening_stress(strain: np.ndarray, law: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What stiffening adds to the tension of a fabric, over its E h.

    Args:
        strain: along the axis [-], shape (...).
        law: (a, b) of :meth:`Fabric.stiffening`, shape (2,).

    Returns:
        Energy, stress and tangent [-], each like ``strain``; zero under compression.
    """
    first, second = law
    strain = np.maximum(strain, 0.0)
    cubic = np.minimum(strain, MAX_STIFFENING_STRAIN)
    beyond = strain - cubic
    energy = cubic**3 * (first / 3.0 + second * cubic / 4.0)
    stress = cubic**2 * (first + second * cubic)
    tangent = cubic * (2.0 * first + 3.0 * second * cubic)
    return energy + beyond * (stress + 0.5 * beyond * tangent), stress + beyond * tangent, tangent
