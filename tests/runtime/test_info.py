from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pbd import Fabric
from runtime.cli import command
from runtime.output.database_info import check_database, info_text
from tests.wrinkles.databases import small_database
from tests.wrinkles.delivered import delivered_database, delivered_panels
from wrinkles import patches
from wrinkles.database import WrinkleDatabase, code_version
from wrinkles.database_file import write_database
from wrinkles.features import DYNAMIC_COUNT

QUALITY = {
    "normal_error_deg": 5.51,
    "normal_error_smooth_deg": 11.23,
    "bending_energy_ratio": 1.017,
    "smooth_bending_energy_ratio": 0.131,
    "floor_bending_energy_ratio": 0.988,
    "truth_inside_body_percent": 0.03,
    "inside_body_percent": 0.02,
    "band_ratio_30_to_60_mm": 0.87,
}


def sheet(**changes: Any) -> WrinkleDatabase:
    """Fine enough that its corners, which subdivision rounds, hold little of the area."""
    return small_database(side=9, **changes)


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    def write(**changes: Any) -> Path:
        path = tmp_path / "curtain.h5"
        write_database(path, sheet(**changes))
        return path

    return write


def row(text: str, name: str) -> str:
    return next(line for line in text.splitlines() if line.split()[:1] == [name])


def test_the_text_says_what_the_database_holds(write: Callable[..., Path]) -> None:
    path = write()
    text, figures = info_text(path, everything=True)
    for words in (
        f"{path}: wrinkles of 'curtain č', made 2025-01-31 by gube 0.1.0+0123456789ab",
        "81 vertices, 128 faces, 9 vertices attached",
        "1089 vertices of 2 subdivisions",
        "2.3e-06 N m",
        "0 Pa",
        "60 Hz",
        "5, holding 97.0 %",
        f"{DYNAMIC_COUNT} - 8 - 6 - 5",
        "walk, exploration 0",
        "run, dance",
        "12.5 min on a processor, seed 3",
        f"{path.stat().st_size / 1e6:.2f} MB",
    ):
        assert words in text
    assert figures["fabric_bend_weft"] == 2.3e-6
    assert figures["pressure"] == 0.0
    assert figures["database_mb"] == path.stat().st_size / 1e6


def test_held_out_figures_stand_beside_their_rivals_with_words(write: Callable[..., Path]) -> None:
    text, figures = info_text(write(quality=QUALITY), everything=True)
    header = next(line for line in text.splitlines() if "ours" in line)
    assert re.split(r"\s{2,}", header.strip()) == ["ours", "smooth", "floor", "truth"]
    assert row(text, "normal_error_deg").split()[1:5] == ["5.51", "11.23", "-", "-"]
    assert row(text, "bending_energy_ratio").split()[1:5] == ["1.017", "0.131", "0.988", "-"]
    assert row(text, "inside_body_percent").split()[1:5] == ["0.02", "-", "-", "0.03"]
    assert row(text, "band_ratio_30_to_60_mm").split()[1] == "0.87"
    assert "the truth's coarse state" in row(text, "normal_error_deg")
    assert QUALITY.items() <= figures.items()


def test_other_fabrics_are_said_and_checked(write: Callable[..., Path]) -> None:
    quality = QUALITY | {"denim_normal_error_deg": 6.25, "denim_normal_skill": 0.44}
    path = write(other_fabrics={"denim": Fabric(areal_density=0.4)}, quality=quality)
    text, figures = info_text(path, everything=True)
    assert row(text, "name").split() == ["name", "muslin"]
    words = "held out: normal error 6.25 deg, skill 0.440"
    assert row(text, "denim").split(maxsplit=1) == ["denim", words]
    assert figures["denim_normal_skill"] == 0.44
    assert all(check.passed for check in check_database(path))


def test_nothing_held_out_is_said(write: Callable[..., Path]) -> None:
    text, _ = info_text(write(quality={}, held_out=()), everything=True)
    assert "unknown, nothing was held out" in text


def test_a_database_of_other_code_says_so(write: Callable[..., Path]) -> None:
    assert "its results may differ" in info_text(write(), everything=True)[0]
    assert "its results may differ" not in info_text(write(code_version=code_version()), everything=True)[0]
    assert f"(this is {code_version()})" in info_text(write())[0]


def test_a_delivered_mesh_may_have_another_area_than_its_coarse_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Decimation cuts its corners; the coarse mesh is given the area of the fine one."""
    path = tmp_path / "panels.h5"
    write_database(path, delivered_database(*delivered_panels()[2:]))
    monkeypatch.setattr("runtime.output.database_info.MAX_AREA_CORRECTION", 0.001)
    areas = next(check for check in check_database(path) if check.check == "one rest metric")
    assert areas.passed and abs(float(areas.detail.split()[-1]) - 1.0) > 0.001
    assert [check.check for check in check_database(path) if not check.passed] == []


def test_a_sound_database_passes_every_check(write: Callable[..., Path]) -> None:
    checks = check_database(write())
    assert [check.check for check in checks] == [
        "file",
        "build",
        "held-out motion",
        "one rest metric",
        "coarse model",
        "patches",
        "decoding at rest",
        "decoding a torn garment",
    ]
    assert all(check.passed for check in checks)
    assert "5.50 deg, smooth 11.20 deg" in checks[2].detail


def test_a_check_names_the_build_that_made_the_file(write: Callable[..., Path]) -> None:
    other = check_database(write())[1].detail
    own = check_database(write(code_version=code_version()))[1].detail
    assert other.startswith("made by gube 0.1.0+0123456789ab on ") and other.endswith(f"this is gube {code_version()}")
    assert own.startswith(f"made by gube {code_version()} on ") and own.endswith(", which is this one")


def scaled(factor: float) -> dict[str, Any]:
    mapping = sheet().mapping
    with np.errstate(over="ignore"):
        return {"mapping": replace(mapping, weights_3=np.clip(factor * mapping.weights_3, -3e38, 3e38))}


def with_bump() -> dict[str, Any]:
    """A coarse vertex pulled so far out that coarse and fine cloth cannot have one area."""
    vertices = sheet().coarse_vertices.copy()
    vertices[40, 1] += 0.5
    return {"coarse_vertices": vertices}


def test_patches_that_do_not_add_up_are_found(write: Callable[..., Path], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(patches, "_blend", lambda place: np.full_like(place, 0.3))
    bad = [check for check in check_database(write()) if not check.passed]
    assert [check.check for check in bad] == ["patches"]
    assert "within 0.1" in bad[0].detail


@pytest.mark.parametrize(
    ("changes", "failed", "detail"),
    [
        ({"quality": {"normal_error_deg": 9.0, "normal_error_smooth_deg": 8.0}}, ["held-out motion"], "9.00 deg"),
        (scaled(1e38), ["decoding at rest", "decoding a torn garment"], "cut-off 400 mm"),  # overflows
        (scaled(1e9), ["decoding at rest", "decoding a torn garment"], "cut-off 400 mm"),
        ({"coarse_faces": sheet().coarse_faces[1:]}, ["garment"], "vertex 0: vertex in no face"),
        (with_bump(), ["one rest metric"], "coarse area over fine area"),
    ],
)
def test_a_check_can_fail(write: Callable[..., Path], changes: dict[str, Any], failed: list[str], detail: str) -> None:
    checks = check_database(write(**changes))
    bad = [check for check in checks if not check.passed]
    assert [check.check for check in bad] == failed
    assert detail in bad[-1].detail


def test_gube_info_prints_and_keeps_every_figure(
    write: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "info.json"
    assert command.main(["info", str(write(quality=QUALITY)), "--all", "--json", str(out)]) == 0
    figures = json.loads(out.read_text(encoding="utf-8"))["figures"]
    printed = capsys.readouterr().out
    body = printed[printed.index("Garment") :].replace("hash a1a1a1a1a1a1", "")
    numbers = {float(word) for word in re.findall(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?(?![\w.])", body)}
    assert len(numbers) > 30
    known = [*figures.values(), 100.0 * figures["atoms_kept"], 100.0 * figures["rest_area_ratio"], 0.0]
    named = {30.0, 60.0, 0.0, 10.0, 20.0}  # of the clip "exploration 0", a band, and stiffening at 10 and 20 %
    for number in numbers - named:
        assert any(abs(number - value) <= max(6e-3 * abs(value), 6e-3) for value in known), number


def test_gube_check_has_a_row_for_every_check_and_its_status(
    write: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "check.json"
    assert command.main(["check", str(write()), "--json", str(out)]) == 0
    rows = json.loads(out.read_text(encoding="utf-8"))["rows"]
    assert [row["passed"] for row in rows] == [True] * 8
    assert set(rows[0]) == {"check", "passed", "detail"}
    bad = write(**scaled(1e9))
    assert command.main(["check", str(bad)]) == 1
    assert "FAILED  decoding at rest" in capsys.readouterr().out
    bad.write_bytes(bad.read_bytes()[:-100])
    for name in ("check", "info"):
        assert command.main([name, str(bad)]) == 2
        assert "truncated" in (error := capsys.readouterr().err) and "curtain.h5" in error
    assert command.main(["info", str(tmp_path / "absent.h5")]) == 2
    assert "absent.h5: no such file" in capsys.readouterr().err
