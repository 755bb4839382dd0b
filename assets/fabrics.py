"""Fabrics by name, and from the files of measured fabrics that ARCSim reads."""

from __future__ import annotations

import json
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from assets.text import read_text
from pbd.errors import InputError
from pbd.fabric import MAX_STIFFENING_STRAIN, Fabric

__all__ = ["MEASURED", "PRESETS", "MeasuredFabric", "fitted_tension", "load_fabric", "measured_tension"]

MEASURED_STRAIN = 1.0 / 6.0  # at which the files have their second stiffness [-]
FITTED_STRAINS = np.array([0.02, 0.05, 0.10, 0.17])

# Of 618 measured fabrics (Feng et al. 2022) the middle half weighs 0.10 to 0.29 kg/m2 and bends with 4 to 36 uN m
# along the warp and 3 to 24 along the weft, at a gravity length of 1.5 to 2.3 cm. Silk and jersey lie near the supple
# end of that, cotton in the middle, wool and denim at the stiff end. Jersey is knitted: it stretches easily.
_ROUND = {
    "cotton": Fabric(0.15, 2500.0, 2000.0, 0.2, 60.0, 12e-6, 8e-6, friction=0.3),
    "denim": Fabric(0.40, 5000.0, 3500.0, 0.2, 150.0, 60e-6, 40e-6, friction=0.4),
    "jersey": Fabric(0.18, 150.0, 100.0, 0.3, 40.0, 6e-6, 4e-6, friction=0.4),
    "polyester": Fabric(0.13, 4000.0, 4000.0, 0.1, 20.0, 12e-6, 8e-6, friction=0.2),
    "silk": Fabric(0.06, 1500.0, 1200.0, 0.2, 30.0, 3e-6, 2e-6, friction=0.2),
    "wool": Fabric(0.24, 1000.0, 800.0, 0.25, 50.0, 30e-6, 20e-6, friction=0.4),
}


@dataclass(frozen=True)
class MeasuredFabric:
    """A preset that was measured on one cloth.

    Attributes:
        sample: name of the cloth among the ten of Wang, O'Brien and Ramamoorthi 2011, as ARCSim stores them.
        use: use and fibres, with the shares of their weight.
        fabric: what :func:`load_fabric` makes of the file of the sample, to three significant digits.
    """

    sample: str
    use: str
    fabric: Fabric


_STIFFENING = ("stiffening_warp_10", "stiffening_warp_20", "stiffening_weft_10", "stiffening_weft_20")


def _measured(
    sample: str,
    use: str,
    density: float,
    stretch: tuple[float, float],
    poisson: float,
    shear: float,
    bend: tuple[float, float],
    stiffening: tuple[float, float, float, float],
) -> MeasuredFabric:
    """A preset of values in the order of :class:`pbd.Fabric`, bending in [uN m]."""
    law = dict(zip(_STIFFENING, stiffening, strict=True))
    fabric = Fabric(density, *stretch, poisson, shear, 1e-6 * bend[0], 1e-6 * bend[1], **law)
    return MeasuredFabric(sample, use, fabric)


# Source: the data of Wang, O'Brien and Ramamoorthi, "Data-driven elastic models for cloth: modeling and measurement",
# ACM Transactions on Graphics 30(4), 2011, as ARCSim stores them (Narain, Samii and O'Brien 2012).
# A name is the kind of cloth, or its use where the source names no kind, and its weight in g/m2. The label of the denim
# says 11 oz, which is 373 g/m2 for a square yard; the sample weighs 324 g/m2.
MEASURED = MappingProxyType(
    {
        "blanket_228": _measured(
            "pink-ribbon-brown", "blanket, polyester",
            0.228, (211.0, 341.0), 0.433, 30.3, (29.3, 14.9), (1.57, 2.06, 1.80, 2.75),
        ),
        "denim_11oz": _measured(
            "11oz-black-denim", "jeans, 99 % cotton, 1 % spandex",
            0.324, (410.0, 2030.0), 0.0101, 53.4, (16.0, 24.2), (1.24, 1.51, 1.18, 1.37),
        ),
        "interlock_187": _measured(
            "gray-interlock", "T-shirt, 60 % cotton, 40 % polyester",
            0.187, (33.2, 69.0), 0.0, 36.9, (5.80, 3.57), (2.13, 2.88, 7.85, 14.9),
        ),
        "jacket_113": _measured(
            "tango-red-jet-set", "jacket, polyester",
            0.113, (51.6, 206.0), 0.317, 14.3, (3.57, 5.09), (1.71, 2.56, 3.63, 5.32),
        ),
        "ponte_roma_284": _measured(
            "camel-ponte-roma", "jacket, 60 % polyester, 40 % rayon",
            0.284, (62.3, 88.1), 0.0, 31.9, (9.09, 9.29), (2.18, 3.52, 3.32, 5.80),
        ),
        "rib_knit_276": _measured(
            "ivory-rib-knit", "underwear, 95 % cotton, 5 % spandex",
            0.276, (85.7, 130.0), 0.0, 83.2, (11.6, 8.06), (1.31, 1.66, 3.16, 5.82),
        ),
        "sweater_224": _measured(
            "navy-sparkle-sweat", "sweater, 96 % polyester, 4 % spandex",
            0.224, (25.0, 6.54), 0.0, 17.6, (14.9, 11.4), (1.92, 2.13, 31.7, 32.0),
        ),
        "swimsuit_204": _measured(
            "white-swim-solid", "swimsuit, 87 % nylon, 13 % spandex",
            0.204, (95.0, 207.0), 0.0653, 60.8, (15.1, 12.8), (1.01, 0.982, 1.17, 1.25),
        ),
        "tablecloth_128": _measured(
            "white-dots-on-blk", "tablecloth, polyester",
            0.128, (4000.0, 4050.0), 0.00017, 19.2, (12.9, 7.82), (1.19, 1.40, 1.20, 1.41),
        ),
        "trousers_220": _measured(
            "royal-target", "trousers, 65 % cotton, 35 % polyester",
            0.220, (4030.0, 4070.0), 0.00451, 105.0, (31.4, 31.4), (1.19, 1.39, 1.19, 1.41),
        ),
    }
)  # fmt: skip

PRESETS = MappingProxyType(_ROUND | {name: one.fabric for name, one in MEASURED.items()})


def load_fabric(name_or_path: str | PathLike[str]) -> Fabric:
    """A preset by its name, or a measured fabric from a .json file.

    The files (Wang, O'Brien and Ramamoorthi 2011, as ARCSim stores them) hold ``density`` [kg/m2], ``stretching``, six
    rows of four stiffness values [N/m] (c11, c12, c22, mu: the first row at no strain, five more at 17 % in five
    directions), and ``bending``, three directions (warp, bias, weft) by five curvatures [N m]. One fabric is made of
    them, with the values at no strain and at the least curvature:

    - c11, c12 and c22 of the stress against Green strain are twice the stored values, as ARCSim doubles them; its shear
      stress is 2 mu eps12 with the stored mu, so the shear modulus is mu;
    - negative entries are raised to zero, as ARCSim does;
    - E1 h = c11 - c12^2/c22, E2 h = c22 - c12^2/c11, nu12 = c12/c22;
    - B is a quarter of the stored bending value: ARCSim's hinge is that much softer than the plate it stands for;
    - stiffening along warp and weft follows :func:`measured_tension` up to 17 %.

    Thickness, friction and drag are not in the files and keep their defaults.

    Args:
        name_or_path: a key of :data:`PRESETS`, or the path of a file.

    Raises:
        InputError: no such preset or file, a key that is missing or malformed, or values that make no fabric.
    """
    if isinstance(name_or_path, str) and name_or_path in PRESETS:
        return PRESETS[name_or_path]
    path = Path(name_or_path)
    if path.suffix.lower() != ".json":
        known = ", ".join(PRESETS)
        raise InputError(
            "no such fabric", key="fabric", received=str(name_or_path), expected=f"{known} or a .json file"
        )
    content = _content(path)
    density = float(_array(path, content, "density", ()))
    stretching = _array(path, content, "stretching", (6, 4))
    c11, c12, c22, mu = np.maximum(stretching[0], 0.0) * (2.0, 2.0, 2.0, 1.0)
    warp, _, weft = np.maximum(_array(path, content, "bending", (3, 5))[:, 0], 0.0) / 4.0
    if c11 <= 0.0 or c22 <= 0.0:
        raise InputError("no stretch stiffness at rest", file=path, key="stretching, row 0", received=[c11, c12, c22])
    stretch = {"warp": float(c11 - c12**2 / c22), "weft": float(c22 - c12**2 / c11)}
    try:
        stiffening = {}
        for axis, value in stretch.items():
            tension = _tension(stretching, axis, FITTED_STRAINS)
            _, ten, twenty = fitted_tension(FITTED_STRAINS, tension, value)
            stiffening |= {f"stiffening_{axis}_10": ten, f"stiffening_{axis}_20": twenty}
        return Fabric(
            areal_density=density,
            stretch_warp=stretch["warp"],
            stretch_weft=stretch["weft"],
            poisson=float(c12 / c22),
            shear=float(mu),
            bend_warp=float(warp),
            bend_weft=float(weft),
            **stiffening,
        )
    except InputError as error:
        raise InputError(f"no fabric can be made of it: {error}", file=path) from error


def measured_tension(path: str | PathLike[str], axis: str, strains: np.ndarray) -> np.ndarray:
    """Tension of a measured fabric that is pulled along an axis and free across it [N/m], shape (k,).

    Wang et al. 2011 and ARCSim: the stress is C times Green's strain, the stiffness C a straight line of the greatest
    stretch from its values at rest to those at 1/6, and constant beyond. Negative values count as zero.

    Args:
        path: of the file, see :func:`load_fabric`.
        axis: ``warp`` or ``weft``.
        strains: of the length, above 0 [-], shape (k,).

    Raises:
        InputError: no such file, or a key that is missing or malformed.
    """
    path = Path(path)
    return _tension(_array(path, _content(path), "stretching", (6, 4)), axis, strains)


def _tension(stretching: np.ndarray, axis: str, strains: np.ndarray) -> np.ndarray:
    share = np.minimum(strains / MEASURED_STRAIN, 1.0)[:, None]
    row = stretching[1 if axis == "warp" else 5]
    c11, c12, c22, _ = 2.0 * np.maximum((1.0 - share) * stretching[0] + share * row, 0.0).T
    along, across = (c11, c22) if axis == "warp" else (c22, c11)
    modulus = along - c12**2 / np.maximum(across, 1e-30)
    return (1.0 + strains) * (strains + 0.5 * strains**2) * modulus


def fitted_tension(strain: np.ndarray, tension: np.ndarray, stretch: float | None = None) -> tuple[float, float, float]:
    """The curve of :meth:`pbd.Fabric.stiffening` that is nearest to a measured one: least squares of relative errors.

    Args:
        strain: above 0 [-], shape (k,).
        tension: above 0 [N/m], shape (k,).
        stretch: E h [N/m]; None fits it too.

    Returns:
        E h [N/m], and tension at 10 and at 20 % strain over that of the straight line E h e [-].

    Raises:
        InputError: tension that is not above 0 or does not rise with strain.
    """
    from scipy.optimize import lsq_linear  # takes half a second to load, and playing a database needs none of it

    if not (tension > 0.0).all() or (np.diff(tension[np.argsort(strain)]) <= 0.0).any():
        expected = "above 0, rising with strain"
        raise InputError("bad tension", key="tension", received=np.round(tension, 3).tolist(), expected=expected)
    # The unknowns are E h, its tangent's first growth, E h a, and the tangent at 20 %: E h (1 + 0.4 a + 0.12 b). None
    # is below zero, which keeps tension rising all the way.
    top = MAX_STIFFENING_STRAIN
    cubic = strain**3 / (3.0 * top**2)
    design = np.stack([strain - cubic, strain**2 - 2.0 * top * cubic, cubic], axis=1) / tension[:, None]
    least = 0.01 * float((tension / strain).min())
    low, high = [least if stretch is None else stretch, 0.0, least], [np.inf] * 3
    if stretch is not None:
        solution = lsq_linear(design[:, 1:], 1.0 - stretch * design[:, 0], (low[1:], high[1:]), method="bvls").x
        young, first, steepest = stretch, *solution
    else:
        young, first, steepest = lsq_linear(design, np.ones(len(strain)), (low, high), method="bvls").x
    slope = first / young
    curve = (steepest / young - 1.0 - 2.0 * top * slope) / (3.0 * top**2)
    ten, twenty = (1.0 + slope * e + curve * e**2 for e in (0.1, 0.2))
    return float(young), float(ten), float(twenty)


def _content(path: Path) -> dict[str, Any]:
    """The object in a fabric's file."""
    text = read_text(path, "a fabric's .json")
    try:
        content = json.loads(text)
    except ValueError as error:
        raise InputError(f"not JSON: {error}", file=path) from error
    if not isinstance(content, dict):
        raise InputError("not a fabric", file=path, received=type(content).__name__, expected="an object")
    return content


def _array(path: Path, content: dict[str, Any], key: str, shape: tuple[int, ...]) -> np.ndarray:
    """Finite numbers of that shape under a key."""
    if key not in content:
        raise InputError("a missing key", file=path, key=key, received=sorted(content))
    try:
        values = np.array(content[key], dtype=np.float64)
    except (TypeError, ValueError):  # rows of different lengths, or words
        values = np.full((), np.nan)
    if values.shape != shape or not np.isfinite(values).all():
        wanted = " x ".join(map(str, shape)) + " finite numbers" if shape else "a finite number"
        raise InputError("bad values", file=path, key=key, received=content[key], expected=wanted)
    return values
