"""A page of the site that the build makes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

__all__ = ["Page", "table"]


@dataclass(frozen=True)
class Page:
    """One page: its address below the site, title and Markdown.

    `source` is the file of the repository whose text it is, or None; a `copied` file is no page, but goes to the site
    unchanged. `index` marks the page of a section's title.
    """

    uri: str
    title: str = ""
    text: str = ""
    source: Path | None = None
    copied: bool = False
    index: bool = False


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """Return a Markdown table; bars in its cells are escaped."""
    lines = [head, tuple("---" for _ in head), *rows]
    return "\n".join("| " + " | ".join(_cell(text) for text in row) + " |" for row in lines)


def _cell(text: str) -> str:
    parts = " ".join(text.split()).split("`")  # a bar in code stays as it is
    return "`".join(part if k % 2 else part.replace("|", "\\|") for k, part in enumerate(parts))
