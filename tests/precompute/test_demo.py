"""The demo on a miniature scene: every file, every stage that it announces, and words that its figures bear out."""

from __future__ import annotations

import html
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pygltflib import GLTF2

from assets.io.scene import load_scene
from precompute import demo_run as demo
from precompute.demo_page import duration
from precompute.demo_run import FULL, SHORT, STAGES, WORDS, Demo, DemoResult, introduction, run_demo
from precompute.learning.pipeline import Precomputed, default_cache
from precompute.wrinkle_comparison import baselines
from runtime.export.glb import BYTES_A_VERTEX
from runtime.output.verdict import verdict
from tests.data import ROOT
from tests.precompute.miniature import OPTIONS, SCENE
from wrinkles.database_file import read_database


@dataclass(frozen=True)
class Ran:
    made: DemoResult
    said: list[str]
    told: list[str]


@pytest.fixture(scope="module")
def ran(learned: Precomputed, tmp_path_factory: pytest.TempPathFactory) -> Ran:
    """A demo whose simulated runs are those of the miniature, as far as these go."""
    output = tmp_path_factory.mktemp("demo")
    shutil.copytree(default_cache(learned.path), default_cache(output / "skirt.h5"))
    (output / "scene.toml").write_text(SCENE, encoding="utf-8")
    said: list[str] = []
    told: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(baselines, "PROBE_FRAMES", 16)
        patch.setattr(demo, "PICTURE", (120, 150))
        patch.setattr(demo, "FILM", (60, 70))
        small = Demo(output / "scene.toml", OPTIONS, (1.0,) * len(STAGES), moments=2, brief=True)
        made = run_demo(output, small, workers=1, say=said.append, report=told.append)
    return Ran(made, said, told)


def test_every_stage_is_announced_as_it_begins(ran: Ran) -> None:
    announced = [re.match(r"stage (\d+) of (\d+): (.*) \(about \d+ (?:s|min) left\)$", line) for line in ran.said]
    stages = [found.groups() for found in announced if found]
    assert stages == [(str(k + 1), str(len(STAGES)), WORDS[name]) for k, name in enumerate(STAGES)]
    numbers = [int(line.split()[1]) for line in ran.told if re.match(rf"stage \d+ of {len(STAGES)}: ", line)]
    assert len(numbers) == len(ran.told) and numbers == sorted(numbers)


def test_the_first_picture_is_there_before_anything_is_learned(ran: Ran) -> None:
    (first,) = [k for k, line in enumerate(ran.said) if str(ran.made.first_picture) in line]
    assert ran.said[first - 1].startswith("stage 1") and ran.said[first + 1].startswith("stage 2")
    assert ran.made.first_picture.stat().st_mtime < ran.made.database.stat().st_mtime
    wide, high = Image.open(ran.made.first_picture).size
    full = Image.open(ran.made.picture).size
    assert high == full[1] and 2 * 120 < wide < 2.5 * 120 and 4 * 120 < full[0] < 4.5 * 120
    assert np.asarray(Image.open(ran.made.picture)).std() > 20.0  # something is drawn


def test_every_file_is_made(ran: Ran) -> None:
    made = ran.made
    assert all(path.stat().st_size > 0 for path in (made.page, made.picture, made.first_picture, made.animation))
    assert len(read_database(made.database).held_out) == 1


def test_the_film_shows_coarse_truth_and_ours_moving(ran: Ran) -> None:
    film = Image.open(ran.made.film)
    assert film.n_frames > 5 and 3 * 60 < film.width < 4 * 60
    first = np.asarray(film.convert("RGB"), float)
    film.seek(film.n_frames - 1)
    assert np.abs(np.asarray(film.convert("RGB"), float) - first).max() > 50.0


def test_the_animation_costs_what_it_should(ran: Ran) -> None:
    """Twelve bytes a vertex and frame for the garment, and a mannequin of 1 MB at most."""
    mesh = GLTF2().load(str(ran.made.animation)).meshes[0]
    targets = BYTES_A_VERTEX * ran.made.figures["fine_vertex_count"] * len(mesh.primitives[0].targets)
    assert targets < ran.made.animation.stat().st_size < 1.1 * targets + 1e6
    assert demo.GLB_BYTES + 1e6 <= 15e6


def test_the_page_begins_with_what_a_newcomer_wants_to_know(ran: Ran) -> None:
    page = html.unescape(ran.made.page.read_text(encoding="utf-8"))
    wanted = [*ran.made.words, "<img", "How it was made", "How it was measured", "Beside other ways", "<svg"]
    places = [page.index(words) for words in wanted]
    assert places == sorted(places)
    assert f"{ran.made.figures['normal_error_deg']:.1f} with them" in ran.made.words[1]
    assert "coarse mesh" in page


def test_what_is_said_is_what_the_database_says_of_itself(ran: Ran) -> None:
    assert ran.made.words == verdict(read_database(ran.made.database))


def test_durations_are_said_as_people_say_them() -> None:
    assert [duration(s) for s in (3.0, 44.0, 94.0, 100.0, 170.0)] == ["10 s", "40 s", "90 s", "2 min", "3 min"]


@pytest.mark.parametrize("way", [SHORT, FULL])
def test_both_demos_name_a_scene_with_a_held_out_walk_and_twirl(way: Demo, tmp_path: Path) -> None:
    scene = load_scene(way.scene)
    assert [motion.clip for motion in scene.training.held_out] == ["walk", "twirl"]
    assert len(way.seconds) == len(STAGES)
    text = introduction(way, tmp_path)
    assert f"{sum(way.seconds) / 60.0:.0f} minutes" in text and str(tmp_path) in text


def test_the_readme_says_how_long_the_short_demo_takes() -> None:
    """As measured (docs/lab-notes/data-method-pays.md, "The demo's time")."""
    assert round(sum(SHORT.seconds) / 60.0) == 6
    assert "make demo    # about six minutes on two idle cores" in (ROOT / "README.md").read_text(encoding="utf-8")
