from __future__ import annotations

from html import unescape
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from assets.io.scene import scene_text
from pbd import InputError
from precompute.learning.pipeline import Precomputed
from precompute.wrinkle_comparison import wrinkle_comparison
from precompute.wrinkle_comparison.wrinkle_comparison import compare_wrinkles_file
from precompute.wrinkle_comparison.wrinkle_page import wrinkle_rows, wrinkle_verdict, write_wrinkles
from runtime.cli import command
from tests.precompute.miniature import SCENE, scene
from tests.runtime.players import skirt_database
from wrinkles.database_file import write_database


@pytest.mark.proof
def test_all_ways_are_judged_on_the_same_states(learned: Precomputed, tmp_path: Path) -> None:
    with patch.object(wrinkle_comparison, "RADII", (0.25,)):
        found = compare_wrinkles_file(learned.path, tmp_path)
    methods = {method.name: method for method in found.methods}
    plain = [f"coarse mesh, {substeps} substeps{rest}" for substeps in (6, 14) for rest in ("", ", at rest")]
    assert list(methods)[0] == "ours" and list(methods)[-6:] == ["smooth", "wrinkle meshes", *plain]
    assert len(methods) == 9
    shown = [method for method in found.methods if method.given]
    assert len({method.given["normal_error_smooth_deg"] for method in shown}) == 1
    assert methods["smooth"].given["normal_skill"] == 0.0 and not any(methods[name].given for name in plain)
    assert all(np.isfinite(list(method.given.values())).all() and method.frame_ms > 0.0 for method in shown)
    assert {method.name for method in found.methods if not method.megabytes} == {
        "smooth", "wrinkle meshes", *plain,
    }  # fmt: skip
    assert learned.evaluation is not None
    quality = learned.evaluation.figures  # of all frames, not of every fourth
    assert methods["ours"].given["normal_error_deg"] == pytest.approx(quality["normal_error_deg"], rel=0.2)
    assert methods["ours"].free["bending_energy_ratio"] == pytest.approx(quality["bending_energy_ratio"], rel=0.2)
    assert methods["smooth"].free["bending_energy_ratio"] == pytest.approx(
        quality["smooth_bending_energy_ratio"], rel=0.2
    )
    # What the atoms can hold is nearer than what any mapping says.
    assert found.limit["normal_error_deg"] < min(method.given["normal_error_deg"] for method in shown)
    assert [row["method"] for row in wrinkle_rows(found)] == [*methods, "floor"]
    page = tmp_path / "wrinkles.html"
    write_wrinkles(page, found)
    text = page.read_text(encoding="utf-8")
    assert all(name in text for name in methods)
    assert all(paragraph in unescape(text) for paragraph in wrinkle_verdict(found).split("\n\n"))


def test_what_cannot_be_compared_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["compare", "x.h5", "--wrinkles", "--clip", "walk", "-o", str(tmp_path)]) == 2
    assert "--clip: cannot be chosen with --wrinkles" in capsys.readouterr().err
    path, text = tmp_path / "skirt.h5", SCENE[: SCENE.index("[[training.held_out]]")] + SCENE[SCENE.index("[solver]") :]
    write_database(path, skirt_database(scene=scene_text(scene(text))))
    with pytest.raises(InputError, match="nothing is held out"):
        compare_wrinkles_file(path, tmp_path)
