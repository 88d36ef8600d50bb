"""The gallery: one-file examples with what they print and draw."""

from __future__ import annotations

from typing import Any

from page import Page

__all__ = ["pages"]


def pages(config: Any, files: Any, *, run: bool) -> list[Page]:
    return [Page("gallery/index.md", "Gallery", "# Gallery\n", index=True)]
