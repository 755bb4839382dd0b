"""Makes table and picture of the page of fabrics: python -m docs.site.fabric_presets, which `make fabrics` runs.

Each preset lies in virtual instruments of a textile laboratory. The picture is ``docs/fabric-presets.png``; it and the
table stand between two marks in ``docs/fabrics.md``.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patheffects import withStroke
from PIL import Image

from assets.fabrics import MEASURED, PRESETS
from docs.site.pages import ROOT
from pbd import Fabric
from pbd.fabric import stiffening_stress
from pbd.storage import replacing
from precompute.fabric_lab.fabric_report import PULLED
from precompute.validation.drape_rows import PEDESTAL, drape, drape_coefficient, fold_number
from precompute.validation.laboratory import DIRECTIONS, LoadCurve, bending_curve, shear_curve, tension_curve
from precompute.validation.trial import TrialSetting
from runtime.draw.picture_content import Drawn, frame_camera
from runtime.draw.pictures import render

PAGE, PICTURE = ROOT / "docs" / "fabrics.md", ROOT / "docs" / "fabric-presets.png"
BEGIN, END = "<!-- `make fabrics` writes the lines from here -->", "<!-- to here -->"
SHOWN_PICTURE = f"![each preset as a disc on a pedestal, with its tension, shear and bending]({PICTURE.name})"

# A pull takes the default solver in small substeps, for Newton's method does not find every equilibrium of cloth that
# stiffens; cloth in clamps takes the equilibrium, for the default solver leaves clamped strips too stiff.
CLAMPED = TrialSetting(solver="fem-corotational/quasi-static")
DRAPED = TrialSetting(edges=32, substeps=192)
AXES = {axis: DIRECTIONS[axis] for axis in ("warp", "weft")}
AXIS_COLORS = {"warp": "tab:blue", "weft": "tab:red"}
STRAINS = (0.02, 0.05, 0.10, 0.17)
SHEARS = (0.01, 0.04)  # [rad]
CURVATURES = (50.0, 100.0)  # [1/m]

COLUMNS = 2  # fabrics beside one another
SHOWN = (340, 240)  # a drape [pixel]
HEIGHT = 0.08  # of the pedestal [m]
REACH = 0.14  # of a draped disc, which the picture has room for [m]
COLORS = 128


@dataclass(frozen=True)
class Measured:
    """A preset in the instruments.

    Attributes:
        curves: points by instrument and axis.
        picture: of the draped disc, uint8, shape (height, width, 3).
        coefficient: Cusick's drape coefficient [-].
        folds: of the draped disc.
    """

    curves: Mapping[tuple[str, str], LoadCurve]
    picture: np.ndarray
    coefficient: float
    folds: int


def measure(fabric: Fabric) -> Measured:
    """A fabric in all instruments."""
    curves = {("shear", "warp"): shear_curve(CLAMPED, fabric, AXES["warp"], SHEARS)}
    for axis, angle in AXES.items():
        curves["tension", axis] = tension_curve(PULLED, fabric, angle, STRAINS)
        curves["bending", axis] = bending_curve(CLAMPED, fabric, angle, CURVATURES)
    trial = drape(DRAPED, fabric)
    picture = draped_picture(trial.world(), trial.specimen.faces)
    return Measured(curves, picture, drape_coefficient(trial), fold_number(trial))


def law(fabric: Fabric, instrument: str, axis: str, deformation: np.ndarray) -> np.ndarray:
    """Loads by the numbers of a fabric, in the unit of the instrument."""
    if instrument == "shear":
        return fabric.shear * deformation
    if instrument == "bending":
        return getattr(fabric, f"bend_{axis}") * deformation
    stiffening = fabric.stiffening()[list(AXES).index(axis)]
    return getattr(fabric, f"stretch_{axis}") * (deformation + stiffening_stress(deformation, stiffening)[1])


def draped_picture(cloth: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """A disc on its pedestal, seen from above and aside: uint8, shape (height, width, 3)."""
    turn = np.linspace(0.0, 2.0 * np.pi, 97)[:-1]
    ring = 0.97 * PEDESTAL * np.stack([np.cos(turn), np.zeros(96), -np.sin(turn)], axis=1)
    low, next_low = np.arange(96), np.roll(np.arange(96), -1)
    sides = np.concatenate(
        [np.stack([low, next_low, next_low + 96], axis=1), np.stack([low, next_low + 96, low + 96], axis=1)]
    )
    pedestal = Drawn.body(np.concatenate([ring, ring + [0.0, HEIGHT - 0.003, 0.0]]), sides)
    room = np.concatenate([REACH / PEDESTAL * ring + [0.0, height, 0.0] for height in (0.0, HEIGHT)])
    camera = frame_camera(room[None], azimuth_deg=20.0, elevation_deg=30.0, aspect=SHOWN[0] / SHOWN[1], margin=1.02)[0]
    return render([pedestal, Drawn(cloth + [0.0, HEIGHT, 0.0], faces)], camera, SHOWN)


def draw(found: Mapping[str, Measured]) -> Image.Image:
    """All fabrics on one sheet: drape, tension, shear and bending of each."""
    rows = -(-len(found) // COLUMNS)
    figure = Figure(
        figsize=(8.0 * COLUMNS, 1.7 * rows + 0.4), dpi=100, layout=ConstrainedLayoutEngine(w_pad=0.03, h_pad=0.03)
    )
    grid = figure.subplots(rows, 4 * COLUMNS, squeeze=False, width_ratios=[1.5, 1.0, 1.0, 1.0] * COLUMNS)
    titles = ("tension [N/m], strain [%]", "shear [N/m], angle [rad]", "moment [mN], curvature [1/m]")
    for column in range(COLUMNS):
        for place, title in enumerate(titles):
            grid[0, 4 * column + 1 + place].set_title(title, fontsize=7)
    for number, (name, measured) in enumerate(found.items()):
        row, column = number % rows, number // rows
        shown, *panels = grid[row, 4 * column : 4 * column + 4]
        shown.imshow(measured.picture)
        shown.set_axis_off()
        shown.set_title(name, fontsize=10, fontweight="bold", loc="left", pad=2)
        words = f"drape {100.0 * measured.coefficient:.0f} %, {measured.folds} folds"
        label = shown.text(0.99, 0.02, words, fontsize=7, ha="right", va="bottom", transform=shown.transAxes)
        label.set_path_effects([withStroke(linewidth=2.0, foreground="white")])  # readable on dark cloth
        for panel, instrument in zip(panels, ("tension", "shear", "bending"), strict=True):
            draw_panel(panel, PRESETS[name], instrument, measured.curves)
    for empty in range(len(found), rows * COLUMNS):
        for panel in grid[empty % rows, 4 * (empty // rows) : 4 * (empty // rows) + 4]:
            panel.set_axis_off()
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    image = Image.fromarray(np.asarray(canvas.buffer_rgba())[:, :, :3])
    return image.quantize(COLORS, dither=Image.Dither.NONE)


def draw_panel(panel: Axes, fabric: Fabric, instrument: str, curves: Mapping[tuple[str, str], LoadCurve]) -> None:
    """The points of an instrument, and lines by the fabric's numbers."""
    ends = {"tension": STRAINS[-1], "shear": SHEARS[-1], "bending": CURVATURES[-1]}
    across, up = {"tension": (100.0, 1.0), "shear": (1.0, 1.0), "bending": (1.0, 1000.0)}[instrument]
    line = np.linspace(0.0, 1.05 * ends[instrument], 60)
    for (name, axis), curve in curves.items():
        if name == instrument:
            panel.plot(across * line, up * law(fabric, name, axis, line), color=AXIS_COLORS[axis], linewidth=1.0)
            panel.plot(
                across * curve.deformation, up * curve.load, "o", color=AXIS_COLORS[axis], markersize=3, label=axis
            )
    panel.set_xlim(0.0, 1.08 * across * ends[instrument])
    panel.set_ylim(bottom=0.0)
    panel.tick_params(labelsize=7, pad=1)
    panel.locator_params(nbins=4)
    if instrument == "tension":
        panel.legend(fontsize=6.5, frameon=False, loc="upper left", handletextpad=0.1, borderaxespad=0.1)


def numbers_table() -> str:
    """The presets' numbers and their sources, as Markdown."""
    lines = [
        "| preset | kg/m2 | E h [N/m] | nu12 | G h [N/m] | B [uN m] | 10, 20 % warp | 10, 20 % weft | friction "
        "| l_g [cm] |",
        "|---" * 10 + "|",
    ]
    of = ["| preset | use | source |", "|---" * 3 + "|"]
    for name, one in PRESETS.items():
        measured = MEASURED.get(name)
        warp, weft = (
            tuple(getattr(one, f"stiffening_{axis}_{percent}") for percent in (10, 20)) for axis in ("warp", "weft")
        )
        cells = [
            f"`{name}`",
            f"{one.areal_density:.3g}",
            f"{one.stretch_warp:.4g}, {one.stretch_weft:.4g}",
            f"{one.poisson:.3g}",
            f"{one.shear:.3g}",
            f"{1e6 * one.bend_warp:.3g}, {1e6 * one.bend_weft:.3g}",
            "{:.3g}, {:.3g}".format(*warp),
            "{:.3g}, {:.3g}".format(*weft),
            f"{one.friction:.2g}",
            f"{100.0 * one.gravity_length:.3g}",
        ]
        lines.append("| " + " | ".join(cells) + " |")
        use, source = (measured.use, f"W, {measured.sample}") if measured else ("round numbers", "F")
        of.append(f"| `{name}` | {use} | {source} |")
    return "\n".join([*lines, "", *of])


def main() -> int:
    """Measure all presets, draw them, write the table; print how far points are from the lines."""
    found = {}
    for name, fabric in PRESETS.items():
        found[name] = measure(fabric)
        sys.stdout.write(f"{name:<15} drape {100.0 * found[name].coefficient:.0f} %, {found[name].folds} folds")
        for (instrument, axis), curve in found[name].curves.items():
            off = np.abs(curve.load / law(fabric, instrument, axis, curve.deformation) - 1.0).max()
            sys.stdout.write(f"; {instrument} {axis} {100.0 * off:.1f} % off")
        sys.stdout.write("\n")
        sys.stdout.flush()
    with replacing(PICTURE) as beside:
        draw(found).save(beside, "PNG", optimize=True)
    before, rest = PAGE.read_text(encoding="utf-8").split(BEGIN)
    made = "\n\n".join([BEGIN, SHOWN_PICTURE, numbers_table(), END])
    with replacing(PAGE) as beside:
        beside.write_text(before + made + rest.split(END)[1], encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
