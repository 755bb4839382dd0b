"""Errors of a page in a browser."""

from __future__ import annotations

from playwright.sync_api import Page

__all__ = ["errors_of"]


def errors_of(page: Page) -> list[str]:
    """A list that from now on gets every error that the page writes to its console, or that nothing catches."""
    errors: list[str] = []
    page.on("console", lambda said: errors.append(said.text) if said.type == "error" else None)
    page.on("pageerror", lambda error: errors.append(str(error)))
    return errors
