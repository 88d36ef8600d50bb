"""A page in real headless Chromium, with what its console complained of."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from tests.tools import _without, need

if TYPE_CHECKING:
    from playwright.sync_api import Page

_ARGUMENTS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
)  # fmt: skip
_OVERFLOW = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
WIDTHS = (1280, 390)  # px; a desk and a telephone


@dataclass
class Opened:
    """A page, what went wrong on it, and what it asked other machines for."""

    page: Page
    errors: list[str] = field(default_factory=list)
    outside: list[str] = field(default_factory=list)

    def overflow(self, width: int) -> int:
        """How far [px] the page goes beyond the right edge of a window of that width."""
        self.page.set_viewport_size({"width": width, "height": 900})
        return int(self.page.evaluate(_OVERFLOW))


@contextmanager
def open_page(url: str, *, width: int = 1280, scheme: str = "light") -> Iterator[Opened]:
    """The page at an address of this machine (file: or http:), which may ask nothing of any other machine.

    Without Chromium or Playwright the test is skipped, or fails where CI=true promises them.
    """
    chromium = need("chromium")
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        _without("playwright is not installed")
        raise
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=list(_ARGUMENTS))
        try:
            page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
            opened = Opened(page)
            page.on("console", lambda m: opened.errors.append(m.text) if m.type == "error" else None)
            page.on("pageerror", lambda error: opened.errors.append(str(error)))

            def route(asked):
                if asked.request.url.startswith(("file:", "data:", "blob:", "http://127.0.0.1", "http://localhost")):
                    asked.continue_()
                else:
                    opened.outside.append(asked.request.url)
                    asked.abort()

            page.route("**/*", route)
            page.goto(url)
            yield opened
        finally:
            browser.close()
