"""GarmentCode specifications: curves, places, and which way panels and seams face."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from assets.patterns.curves import signed_area
from assets.patterns.load import load_pattern
from assets.patterns.pattern import EdgeName, edge_length
from tests.data import data_path
from tests.refusals import refuses


def specification() -> dict[str, Any]:
    """A front, and a back whose outline runs clockwise as the format has it, in cm."""
    front = {
        "translation": [0.0, 100.0, 20.0],
        "rotation": [0.0, 0.0, 0.0],
        "vertices": [[0, 0], [40, 0], [40, 50], [0, 50]],
        "edges": [
            {"endpoints": [0, 1], "curvature": {"type": "circle", "params": [20.0, 0, 1]}},
            {"endpoints": [1, 2]},
            {"endpoints": [2, 3], "curvature": {"type": "quadratic", "params": [[0.5, 0.25]]}},
            {"endpoints": [3, 0], "label": "side"},
        ],
    }
    back = {
        "translation": [5.0, 100.0, -20.0],
        "rotation": [0.0, 0.0, 90.0],
        "vertices": [[0, 0], [0, 40], [50, 40], [50, 0]],
        "edges": [{"endpoints": [k, (k + 1) % 4]} for k in range(4)],
    }
    stitches = [[{"panel": "front", "edge": 1}, {"panel": "back", "edge": 1}]]
    return {
        "pattern": {"panels": {"front": front, "back": back}, "stitches": stitches},
        "properties": {"units_in_meter": 100, "curvature_coords": "relative"},
    }


def write(path: Path, document: Any) -> Path:
    file = path / "vest_specification.json"
    file.write_text(json.dumps(document), encoding="utf-8")
    return file


def test_curves_come_in_metres_on_their_side_of_the_edge(tmp_path: Path) -> None:
    pattern = load_pattern(write(tmp_path, specification()))
    assert pattern.name == "vest"
    front = pattern.panel("front")
    hem, neck = front.edges[0], front.edges[2]
    assert edge_length(hem) == pytest.approx(0.2 * math.pi, rel=1e-4)
    assert hem[:, 1].min() == pytest.approx(-0.2, abs=1e-4)  # "right": below an edge to the right
    assert neck[:, 1].min() == pytest.approx(0.5 - 0.25 * 0.4 / 2.0, abs=1e-4)  # left of an edge to the left
    np.testing.assert_allclose(front.placement.apply(hem[:1]), [[0.0, 1.0, 0.2]], atol=1e-12)


def test_a_clockwise_panel_is_mirrored_and_stays_where_it_is(tmp_path: Path) -> None:
    back = load_pattern(write(tmp_path, specification())).panel("back")
    assert signed_area(back.outline) > 0.0
    np.testing.assert_allclose(back.placement.rotation[:, 2], [0.0, 0.0, -1.0], atol=1e-12)
    assert np.linalg.det(back.placement.rotation) == pytest.approx(1.0)
    # A quarter turn takes (0, 40) to (-40, 0) cm, and (50, 40) to (-40, 50).
    expected = [[-0.35, 1.0, -0.2], [-0.35, 1.5, -0.2]]
    np.testing.assert_allclose(back.placement.apply(back.edges[1]), expected, atol=1e-12)


def test_a_stitch_of_a_right_and_a_wrong_side_is_not_reversed(tmp_path: Path) -> None:
    document = specification()
    document["pattern"]["stitches"][0].append("right_wrong")
    (seam,) = load_pattern(write(tmp_path, document)).seams
    assert not seam.reversed and seam.first == EdgeName("front", 1)


@pytest.mark.parametrize(
    ("where", "value", "message"),
    [
        (("pattern", "panels", "front", "edges", 2, "curvature", "type"), "spiral", "edge 2: .*cannot be read"),
        (("pattern", "panels", "front", "edges", 0, "curvature", "params"), [5.0, 0, 1], "edge 0: .*radius below half"),
        (("pattern", "panels", "front", "edges", 1, "endpoints"), [1, 7], "panel 'front': .*vertex 7, of 4"),
        (("pattern", "panels", "front", "edges", 1, "endpoints"), [1, 3], "between edges 1 and 2: an open outline"),
        (("pattern", "panels", "front", "vertices", 0), [0.0, None], "panel 'front'"),
        (("pattern", "stitches", 0), [{"panel": "front"}], "stitch 0: no stitch"),
        (("pattern", "stitches", 0, 0, "edge"), float("inf"), "stitch 0: no stitch"),
        (("pattern", "stitches"), 5, "no GarmentCode specification"),
        (("pattern", "stitches", 0, 0, "panel"), "frnot", "seam 0: no such panel .*did you mean 'front'"),
        (("properties", "units_in_meter"), 1, "a size that no garment has"),
        (("properties", "curvature_coords"), "absolute", "unknown coordinates"),
        (("properties",), {}, "no GarmentCode specification .*units_in_meter"),
        (("pattern", "panels"), {}, "a pattern without panels"),
    ],
)  # fmt: skip
def test_bad_specifications(tmp_path: Path, where: tuple[Any, ...], value: Any, message: str) -> None:
    document = specification()
    entry: Any = document
    for key in where[:-1]:
        entry = entry[key]
    entry[where[-1]] = value
    assert "vest_specification.json" in refuses(message, load_pattern, write(tmp_path, document))


def test_two_panels_of_one_name_are_refused(tmp_path: Path) -> None:
    """JSON keeps the last value of a key that stands twice: the first panel would be lost."""
    file = write(tmp_path, specification())
    file.write_text(file.read_text(encoding="utf-8").replace('"back": {', '"front": {'), encoding="utf-8")
    refuses(r"vest_specification.json: 'front': the same name twice", load_pattern, file)


def test_a_file_that_is_no_json(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("{", encoding="utf-8")
    refuses("a.json: cannot be read", load_pattern, tmp_path / "a.json")
    refuses("unknown kind of pattern .*'.pdf'", load_pattern, tmp_path / "a.pdf")


@pytest.mark.parametrize(("name", "panels", "seams"), [("dress_pencil", 6, 23), ("shirt_mean", 8, 18)])
def test_real_patterns_look_outwards_and_their_seams_run_the_right_way(name: str, panels: int, seams: int) -> None:
    pattern = load_pattern(data_path(f"patterns/{name}_specification.json"))
    assert (len(pattern.panels), len(pattern.seams)) == (panels, seams)
    for panel in pattern.panels:
        middle = panel.placement.apply(panel.outline).mean(axis=0)
        assert panel.placement.rotation[2, 2] * middle[2] > 0.1  # fronts look to +z, backs to -z
    for seam in pattern.seams:
        first, second = (
            pattern.panel(side.panel).placement.apply(pattern.edge(side)[[0, -1]]) for side in (seam.first, seam.second)
        )
        ahead = np.linalg.norm(first - second, axis=1).sum()
        back = np.linalg.norm(first - second[::-1], axis=1).sum()
        assert seam.reversed and back < ahead + 0.002  # a seam of 15 mm from front to back decides by 1 mm
