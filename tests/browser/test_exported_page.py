"""The page of `gube export` in a browser, opened from the disk."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from playwright.sync_api import Page

from runtime.export.animation_baking import clip_begin
from runtime.export.page import page_text, write_page
from runtime.export.recording import TRUTH_STEP, RecordedTruth, record
from runtime.play.player import Player
from runtime.play.simulation import poses_of
from runtime.setup.playback_inputs import PlaybackInputs
from tests.runtime.players import skirt_database, skirt_stage

pytestmark = pytest.mark.browser

HOSTILE = "</script><img src=x onerror=\"document.title='hacked'\"><b>č</b>"
SECONDS = 0.5
LIMIT = 0.2e-3  # that the page promises [m]
TRUTH_OFF = 0.01  # of what stands for the truth from ours [m]
# A moment as the page shows it, with fine vertices and truth in base64.
SHOWN = """async (time) => {
    const { base, ours, truth, time: at } = await gubePage.shown(time);
    const letters = (array) => Array.from(new Uint8Array(array.buffer), (byte) => String.fromCharCode(byte)).join("");
    return { at, base, ours: btoa(letters(ours)), truth: btoa(letters(truth)) };
}"""
TIME = "() => gubePage.state.time"
# Ends when the page shows another moment than the given one: its clock follows at the next frame of the browser.
ANOTHER = """async (time) => {
    while (gubePage.state.time === time) await new Promise(requestAnimationFrame);
    await new Promise(requestAnimationFrame);
    return gubePage.state.time;
}"""


class Exported(NamedTuple):
    """A page and the player's vertices of every recorded frame, shape (f, N, 3)."""

    folder: Path
    played: np.ndarray


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Exported:
    quality = {"normal_error_deg": 5.5123, "normal_error_smooth_deg": 11.2, "frame_ms_p50": 7.84, "rmse_mm": 1.1425}
    names = {"garment_name": HOSTILE, "fabric_name": HOSTILE, "trained_on": (HOSTILE,), "held_out": (HOSTILE,)}
    database = replace(skirt_database(subdivisions=2, quality=quality), **names)
    stage = skirt_stage()
    motion, dt = stage.motion(), 1.0 / database.frame_rate
    first = round(clip_begin(motion) / dt)  # before it the body comes from the pose that its clothes lie on
    poses = poses_of(motion, dt, first * dt + SECONDS)
    player = Player(database, stage.body, poses[0])
    played = [player.vertices + player.origin]
    for pose in poses[1:]:
        player.update(pose, dt)
        played.append(player.vertices + player.origin)
    truth = RecordedTruth(np.arange(first, len(poses), 4), np.array(played[first::4]) + TRUTH_OFF)
    about = page_text(database, f"walk {HOSTILE}")
    recording, _ = record(database, PlaybackInputs(stage.body, (motion,)), motion, SECONDS, about, truth=truth)
    folder = tmp_path_factory.mktemp("export") / "page"
    write_page(folder, recording)
    return Exported(folder, np.array(played[first::2]))


@pytest.fixture
def page(exported: Exported, open_page: Callable[[str], Page]) -> Iterator[Page]:
    """The page, paused at its first frame. It asks for nothing but its own files."""
    page = open_page("about:blank")
    page.set_viewport_size({"width": 640, "height": 400})
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto((exported.folder / "index.html").as_uri())
    page.evaluate(SHOWN, 0)
    yield page
    own = exported.folder.as_uri() + "/"
    assert [address for address in asked if not address.startswith(own)] == []


def shown(page: Page, time: float, name: str = "ours") -> np.ndarray:
    """Vertices in the world as the page shows them at a time [frames], shape (N, 3)."""
    moment = page.evaluate(SHOWN, time)
    assert moment["at"] == time
    return np.frombuffer(base64.b64decode(moment[name]), "<f4").reshape(-1, 3) + np.array(moment["base"])


def test_it_shows_the_players_vertices(exported: Exported, page: Page) -> None:
    for number in (0, 7, 15):
        off = np.linalg.norm(shown(page, number) - exported.played[number], axis=1).max()
        assert off < LIMIT
    mixed = 0.5 * (exported.played[7] + exported.played[8])
    assert np.linalg.norm(shown(page, 7.5) - mixed, axis=1).max() < LIMIT
    truth = {2: exported.played[2], 3: (exported.played[2] + exported.played[4]) / 2.0, 15: exported.played[14]}
    for number, vertices in truth.items():  # straight between its frames, and its last one after that
        assert np.abs(shown(page, number, "truth") - vertices - TRUTH_OFF).max() < 0.6 * TRUTH_STEP
    assert page.inner_text("#labels").split() == ["coarse", "ours", "truth"]


def test_it_plays_pauses_and_goes_to_any_moment(exported: Exported, page: Page) -> None:
    last = len(exported.played) - 1
    page.evaluate("() => document.querySelector('#play').click()")
    assert page.evaluate(ANOTHER, page.evaluate(TIME)) > 0
    page.evaluate("() => document.querySelector('#play').click()")
    assert page.inner_text("#play") == "Play"
    page.evaluate(SHOWN, 3)
    page.fill("#scrub", str(last))
    assert page.evaluate(ANOTHER, 3) == last
    assert page.inner_text("#clock") == "0.50 / 0.50 s"
    page.evaluate("() => document.activeElement.blur()")
    page.keyboard.press("ArrowLeft")
    assert page.evaluate(ANOTHER, last) == last - 1


def test_the_picture_is_not_empty_and_moves(page: Page) -> None:
    def picture() -> bytes:
        page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        return page.screenshot(timeout=60_000)

    pictures = [picture()]
    shown(page, 10)
    pictures.append(picture())
    for box in ("wireframe", "body"):
        page.evaluate(f"() => document.querySelector('#{box}').click()")
        pictures.append(picture())
    assert len(set(pictures)) == 4
    assert min(map(len, pictures)) > 20_000  # an empty one is a few kilobytes


def test_names_of_a_file_are_text_and_nothing_else(page: Page) -> None:
    assert page.title() == f"{HOSTILE}: walk {HOSTILE}"
    assert page.inner_text("#title") == f"{HOSTILE}, walk {HOSTILE}"
    assert page.inner_text("#facts").count(HOSTILE) == 4  # motion, fabric, learned from, held out
    assert page.locator("img, b").count() == 0


def test_figures_have_plain_names_and_the_few_that_matter_come_first(page: Page) -> None:
    rows = [row.split("\t") for row in page.locator("#figures tr").all_inner_texts()]
    assert [row[0] for row in rows] == ["Quality", "normal error [deg]", "Cost", "time of a frame [ms]"]
    assert rows[0][1:] == ["ours", "smooth", "Meaning"]
    assert rows[1][1:3] == ["5.5", "11.2"] and "angle between our normals" in rows[1][3]
    more = page.locator("#more-figures tr", has_text="distance of vertices [mm]")
    assert not more.is_visible()
    page.click("summary")
    assert more.is_visible() and more.inner_text().split("\t")[1] == "1.14"
