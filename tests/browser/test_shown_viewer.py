"""`gube view` in a real browser: pictures that move, a garment that the mouse drags, sliders, colours, other pages."""

from __future__ import annotations

import io
import math
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest
import viser
from PIL import Image
from playwright.sync_api import Browser, Locator, Page, expect

from tests.browser.pages import errors_of
from tests.browser.running import Running, Told

pytestmark = pytest.mark.browser

WIDTH, HEIGHT = 960, 600  # of the page [pixels]
PANEL = 340  # pixels at the right, which the controls cover
# viser calls preventDefault in a listener that the browser takes to be passive, at every press on a thing to drag.
HARMLESS = "Unable to preventDefault inside passive event listener invocation."
PATIENCE_S = 120.0  # WebGL in software takes both cores


@pytest.fixture(scope="module")
def viewer(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    running = Running(tmp_path_factory.mktemp("saved"))
    yield running
    running.close()


@pytest.fixture(scope="module")
def page(chromium: Browser, viewer: Running) -> Iterator[Page]:
    """The viewer's page; an error in it fails the last of the tests."""
    page = chromium.new_page(viewport={"width": WIDTH, "height": HEIGHT})
    page.set_default_timeout(1e3 * PATIENCE_S)
    errors = errors_of(page)
    page.goto(viewer.address)
    page.bring_to_front()
    expect(page.get_by_text("skirt (skirt.h5)")).to_be_visible(timeout=1e3 * PATIENCE_S)
    until(lambda: len(np.unique(picture(page).reshape(-1, 3), axis=0)) > 500)  # the garment is there
    yield page
    page.close()
    assert [error for error in errors if error != HARMLESS] == []


def until(happened: Callable[[], bool]) -> None:
    """Wait for something."""
    end = time.monotonic() + PATIENCE_S
    while not happened():
        assert time.monotonic() < end, "it does not happen"
        time.sleep(0.05)


def picture(page: Page) -> np.ndarray:
    """The window without the controls: red, green, blue, uint8, shape (h, w, 3)."""
    shot = page.screenshot(clip={"x": 0, "y": 0, "width": WIDTH - PANEL, "height": HEIGHT})
    return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB"))


def row(page: Page, label: str) -> Locator:
    """The row of a control."""
    return page.get_by_text(label, exact=True).locator("xpath=ancestor::div[.//input][1]")


def choose(page: Page, label: str, option: str) -> None:
    page.get_by_label(label, exact=True).click()
    page.get_by_role("option", name=option, exact=True).click()


def on_screen(told: Told, point: np.ndarray) -> tuple[float, float]:
    """Where the camera of the start shows a point in the world [m] [pixels]."""
    eye, target, field_of_view = told.camera
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross([0.0, 1.0, 0.0], back)
    right /= np.linalg.norm(right)
    seen = np.stack([right, np.cross(back, right), back]) @ (point - told.place - eye)
    scale = 0.5 * HEIGHT / math.tan(0.5 * field_of_view) / -seen[2]
    return 0.5 * WIDTH + scale * seen[0], 0.5 * HEIGHT - scale * seen[1]


def test_pictures_are_not_empty_and_differ_between_moments(page: Page, viewer: Running) -> None:
    first, frames = picture(page).astype(int), viewer.told().frame_count
    assert first.std() > 10.0
    until(lambda: viewer.told().frame_count > frames + 30)
    assert (np.abs(picture(page).astype(int) - first).max(axis=2) > 20).sum() > 1000


def test_time_is_paused_stepped_and_scrubbed(page: Page, viewer: Running) -> None:
    page.get_by_role("button", name="Pause").click()
    until(lambda: not viewer.told().playing)
    stood = viewer.told().tick_count
    page.get_by_text("on", exact=True).click()
    until(lambda: viewer.told().tick_count == stood + 1)
    page.get_by_text("back", exact=True).click()
    until(lambda: viewer.told().tick_count == stood)
    time.sleep(0.5)
    still = picture(page)
    time.sleep(0.5)
    assert np.array_equal(picture(page), still)
    rewind(page, viewer)
    page.get_by_role("button", name="Play").click()
    until(lambda: viewer.told().playing)


def rewind(page: Page, viewer: Running) -> None:
    """Scrub to the end and to the start: a slider that stands at the start already would say nothing."""
    slider = row(page, "time [s]").get_by_role("slider")
    slider.press("End")
    until(lambda: not viewer.told().playing)
    slider.press("Home")
    until(lambda: viewer.told().tick_count == 0)


def test_a_drag_with_the_mouse_moves_the_vertex(page: Page, viewer: Running) -> None:
    rewind(page, viewer)
    told = viewer.told()
    world = told.world
    front = world[:, 2] - 2.0 * np.abs(world[:, 0] - world[:, 0].mean()) - np.abs(world[:, 1] - world[:, 1].mean())
    vertex = int(np.argmax(front))
    time.sleep(1.0)  # until that moment is drawn
    x, y = on_screen(told, world[vertex])
    page.mouse.move(x, y)
    page.mouse.down()
    for step in range(1, 9):
        page.mouse.move(x - 8 * step, y)
        time.sleep(0.05)
    until(lambda: viewer.told().dragged is not None)
    page.get_by_role("button", name="Play").focus()
    page.keyboard.press("Enter")  # the mouse goes on holding
    until(lambda: viewer.told().tick_count > 3)
    until(lambda: held_off(viewer.told()) < 0.03)
    held, target = viewer.told().dragged or (-1, np.zeros(3))
    assert np.linalg.norm(world[held] - world[vertex]) < 0.05  # what was under the mouse
    assert np.linalg.norm(target - world[held]) > 0.05  # and is held elsewhere now
    page.mouse.up()
    until(lambda: viewer.told().dragged is None)


def held_off(told: Told) -> float:
    """Distance of the dragged vertex from where it is to be held [m]."""
    assert told.dragged is not None
    return float(np.linalg.norm(told.world[told.dragged[0]] - told.dragged[1]))


def test_sliders_change_fabric_and_wind(page: Page, viewer: Running) -> None:
    before = viewer.told().bend_warp
    row(page, "bending").get_by_role("slider").press("End")
    until(lambda: viewer.told().bend_warp == pytest.approx(10.0 * before))
    row(page, "bending").get_by_role("slider").press("Home")
    until(lambda: viewer.told().bend_warp == pytest.approx(0.1 * before))
    row(page, "wind [m/s]").get_by_role("slider").press("End")
    until(lambda: viewer.told().wind[2] == pytest.approx(12.0))
    row(page, "wind [m/s]").get_by_role("slider").press("Home")
    until(lambda: viewer.told().wind[2] == 0.0)


@pytest.mark.parametrize(
    ("coloring", "legend"),
    [
        ("strain", "strain [%]"),
        ("bending", "curvature [1/m]"),
        ("contact", "distance to the body [mm]"),
        ("novelty", "expected error [deg]"),
        ("level of detail", "a quarter of the atoms"),
    ],
)
def test_each_colour_is_drawn_and_has_a_legend(page: Page, viewer: Running, coloring: str, legend: str) -> None:
    choose(page, "colours", "cloth")
    until(lambda: viewer.told().look.coloring == "cloth")
    shown = page.get_by_text(legend, exact=True).locator("visible=true")
    expect(shown).to_have_count(0)
    time.sleep(0.5)
    cloth = saturated(picture(page))
    choose(page, "colours", coloring)
    expect(shown).to_be_visible(timeout=1e3 * PATIENCE_S)
    until(lambda: abs(saturated(picture(page)) - cloth) > 0.002)


def saturated(image: np.ndarray) -> float:
    """Share of strongly coloured pixels."""
    return float((np.ptp(image.astype(int), axis=2) > 70).mean())


def test_meshes_stand_side_by_side_or_in_one_place(page: Page, viewer: Running) -> None:
    choose(page, "colours", "cloth")
    page.get_by_label("coarse", exact=True).click()
    until(lambda: viewer.told().look.meshes == ("coarse", "ours"))
    choose(page, "arranged", "overlaid")
    until(lambda: viewer.told().look.overlaid)
    page.get_by_label("wireframe", exact=True).click()
    until(lambda: viewer.told().look.wireframe)
    for label in ("coarse", "wireframe"):
        page.get_by_label(label, exact=True).click()
    choose(page, "arranged", "side by side")


def test_picture_clip_and_view_are_saved(page: Page, viewer: Running) -> None:
    page.get_by_text("Save", exact=True).click()
    for button, name in (("Picture", "picture_1.png"), ("Clip", "clip_1.glb"), ("Scene", "view_1.toml")):
        page.get_by_role("button", name=button, exact=True).click()
        until((viewer.folder / name).exists)
    saved = np.asarray(Image.open(viewer.folder / "picture_1.png").convert("RGB"))
    assert saved.shape[:2] == (HEIGHT, WIDTH) and saved.std() > 10.0


def test_a_page_that_goes_away_disturbs_no_other(chromium: Browser, page: Page, viewer: Running) -> None:
    with second_page(chromium, page, viewer):
        pass
    page.get_by_role("button", name="Play").click()
    before, frames = picture(page).astype(int), viewer.told().frame_count
    until(lambda: viewer.told().frame_count > frames + 30)
    assert (np.abs(picture(page).astype(int) - before).max(axis=2) > 20).sum() > 1000


@contextmanager
def second_page(chromium: Browser, page: Page, viewer: Running) -> Iterator[list[str]]:
    """Another page of the viewer, and what it loads; time stands still, since one process draws for all pages."""
    page.get_by_role("button", name="Pause").click()
    other, requests = chromium.new_page(viewport={"width": 500, "height": 400}), []
    other.on("request", lambda request: requests.append(request.url))
    other.goto(viewer.address)
    other.bring_to_front()  # viser connects in the page that has the focus
    expect(other.get_by_text("skirt (skirt.h5)")).to_be_visible(timeout=1e3 * PATIENCE_S)
    yield requests
    other.close()
    page.bring_to_front()


def test_a_page_of_another_origin_gets_no_connection(chromium: Browser, viewer: Running) -> None:
    other = chromium.new_page()
    script = """([address, protocol]) => new Promise(done => {
        const socket = new WebSocket(address, [protocol]);
        socket.onopen = () => done("open");
        socket.onerror = () => done("refused");
    })"""
    address = viewer.address.replace("http", "ws")
    assert other.evaluate(script, [address, f"viser-v{viser.__version__}"]) == "refused"
    other.close()


def test_the_page_loads_nothing_from_elsewhere(chromium: Browser, page: Page, viewer: Running) -> None:
    with second_page(chromium, page, viewer) as requests:
        own = re.compile(rf"(blob:|data:)?{re.escape(viewer.address)}|data:")
        assert len(requests) > 0
        assert [url for url in requests if not own.match(url)] == []
    page.get_by_role("button", name="Play").click()
