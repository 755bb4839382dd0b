"""The browser can do what the pages under test need, and errors in a page are found."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page

from tests.browser.pages import errors_of

pytestmark = pytest.mark.browser

# Clears a canvas to a colour by WebGL and reads it back.
COLORED = """() => {
    const gl = document.createElement("canvas").getContext("webgl2"), pixel = new Uint8Array(4);
    gl.clearColor(1, 0, 0.2, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    return Array.from(pixel);
}"""


def test_it_draws_with_webgl(open_page: Callable[[str], Page]) -> None:
    assert open_page("about:blank").evaluate(COLORED) == [255, 0, 51, 255]


@pytest.mark.parametrize(
    "script", ["console.error('boom')", "throw new Error('boom')", "Promise.reject(new Error('boom'))"]
)
def test_an_error_in_a_page_is_found(chromium: Browser, tmp_path: Path, script: str) -> None:
    file = tmp_path / "page.html"
    file.write_text(f"<script>{script}</script>", encoding="utf-8")
    page = chromium.new_page()
    errors = errors_of(page)
    page.goto(file.as_uri())
    page.wait_for_timeout(100)
    page.close()
    assert [error for error in errors if "boom" in error]
