"""Presets within what fabrics are, and measured fabrics as the tables have them."""

import csv
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from assets.fabrics import PRESETS, load_fabric
from pbd.errors import InputError
from tests.data import data_path


@pytest.mark.parametrize("name", PRESETS)
def test_presets_lie_within_measured_fabrics(name: str) -> None:
    """Between the 5 and 95 percentiles of 618 fabrics (Feng et al. 2022)."""
    fabric = load_fabric(name)
    assert fabric is PRESETS[name]
    assert 0.031 <= fabric.areal_density <= 0.488
    assert 1.10e-6 <= fabric.bend_warp <= 110e-6
    assert 0.89e-6 <= fabric.bend_weft <= 49.7e-6
    assert 0.0115 <= fabric.gravity_length <= 0.0279
    assert 0.20 <= min(fabric.bend_warp, fabric.bend_weft) / max(fabric.bend_warp, fabric.bend_weft) <= 0.97


def test_presets_rank_as_the_cloths_do() -> None:
    assert PRESETS["jersey"].stretch_warp < PRESETS["wool"].stretch_warp < PRESETS["denim"].stretch_warp
    length = [PRESETS[name].gravity_length for name in ("jersey", "silk", "cotton", "wool", "denim")]
    assert length == sorted(length)


def test_measured_fabrics_are_what_the_reference_table_says() -> None:
    with data_path("../reference/materials.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["name"].startswith("ARCSim ")]
    assert len(rows) == 10
    for row in rows:
        name = row["name"].removeprefix("ARCSim ")
        fabric = load_fabric(data_path(f"materials/{name}.json"))
        c11, c22, c12, mu = (float(row[key]) for key in ("C11 N/m (0 strain)", "C22", "C12", "mu N/m"))
        expected = [[c11, c12, 0.0], [c12, c22, 0.0], [0.0, 0.0, mu]]
        np.testing.assert_allclose(fabric.membrane_stiffness(), expected, atol=0.06, err_msg=name)
        bending = [float(row[key]) for key in ("B warp N.m (=ke/4)", "B weft N.m")]
        np.testing.assert_allclose([fabric.bend_warp, fabric.bend_weft], bending, rtol=5e-3, err_msg=name)
        assert fabric.areal_density == float(row["rho kg/m2"])
        assert fabric.gravity_length == pytest.approx(float(row["l_g cm"]) / 100, abs=6e-5)


def write(folder: Path, **changes: Any) -> Path:
    content = {"density": 0.2, "stretching": [[100.0, 10.0, 200.0, 30.0]] * 6, "bending": [[4e-5] * 5] * 3} | changes
    path = folder / "cloth.json"
    path.write_text(json.dumps({key: value for key, value in content.items() if value is not None}))
    return path


def test_the_moduli_of_a_file(tmp_path: Path) -> None:
    fabric = load_fabric(write(tmp_path))
    np.testing.assert_allclose(fabric.membrane_stiffness(), [[200, 20, 0], [20, 400, 0], [0, 0, 30]])
    assert fabric.stretch_warp == pytest.approx(200 - 20**2 / 400)
    assert fabric.poisson == pytest.approx(20 / 400)
    assert fabric.bend_warp == pytest.approx(1e-5)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"density": None}, "density: a missing key (received ['bending', 'stretching'])"),
        ({"density": -1.0}, "fabric.areal_density: bad fabric value (received -1.0"),
        ({"density": "heavy"}, "density: bad values (received 'heavy', expected a finite number)"),
        ({"stretching": [[1.0, 2.0, 3.0]] * 6}, "stretching: bad values"),
        ({"stretching": [[1.0, 2.0], [3.0]]}, "stretching: bad values"),
        ({"stretching": [[-1.0, 0.0, 3.0, 1.0]] * 6}, "stretching, row 0: no stretch stiffness at rest"),
        ({"stretching": [[1.0, 5.0, 1.0, 1.0]] * 6}, "no fabric can be made of it"),
        ({"stretching": [[1.0, 0.0, 1.0, -1.0]] * 6}, "fabric.shear: bad fabric value (received 0.0"),
        ({"bending": [[float("nan")] * 5] * 3}, "bending: bad values"),
    ],
)
def test_bad_files_are_refused(changes: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        load_fabric(write(tmp_path, **changes))
    assert "cloth.json" in str(caught.value)


def test_unknown_fabrics_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="fabric: no such fabric .*'velvet', expected cotton, denim, jersey"):
        load_fabric("velvet")
    with pytest.raises(InputError, match=r"absent\.json: cannot be read"):
        load_fabric(tmp_path / "absent.json")
    (tmp_path / "bad.json").write_text("{")
    with pytest.raises(InputError, match=r"bad\.json: not JSON"):
        load_fabric(tmp_path / "bad.json")
    (tmp_path / "list.json").write_text("[]")
    with pytest.raises(InputError, match=r"list\.json: not a fabric"):
        load_fabric(tmp_path / "list.json")
