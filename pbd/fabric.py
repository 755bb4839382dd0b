"""Fabrics in SI units, with warp and weft."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from pbd.errors import InputError

__all__ = ["Fabric"]


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
        shear_hysteresis: width of the loop that the shear force per width makes over the shear when the cloth is
            sheared to and fro, Kawabata's 2HG [N/m]: twice the force of its internal friction.

    Raises:
        InputError: a value that is not finite, not positive where it must be, or a Poisson ratio for which the
            elasticity is not positive definite; all of them at once.
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
        if errors:
            raise InputError.join(errors)

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
