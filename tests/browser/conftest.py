"""A real browser for pages: Debian's Chromium without a window, which draws WebGL in software."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, sync_playwright

from tests.browser.pages import errors_of

CHROMIUM = Path("/usr/bin/chromium")  # `make browser-test` installs it
OPTIONS = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
WIDTH, HEIGHT = 960, 600  # of a page [pixels]


@pytest.fixture(scope="session")
def chromium() -> Iterator[Browser]:
    assert CHROMIUM.exists(), f"{CHROMIUM} is missing: `make browser-test` installs it"
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=OPTIONS)
        yield browser
        browser.close()


@pytest.fixture
def open_page(chromium: Browser) -> Iterator[Callable[[str], Page]]:
    """Opens a page by its address. An error in any of the test's pages fails the test at its end."""
    context = chromium.new_context(viewport={"width": WIDTH, "height": HEIGHT})
    errors: list[list[str]] = []

    def opened(address: str) -> Page:
        page = context.new_page()
        errors.append(errors_of(page))
        page.goto(address)
        return page

    yield opened
    context.close()
    assert sum(errors, []) == []
