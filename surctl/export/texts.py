"""Text in the form that a C comment or a Markdown table needs."""

from __future__ import annotations

__all__ = ["cell", "comment"]


def _one_line(text: str) -> str:
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


def comment(text: str) -> str:
    """Return the text in a form that cannot end, nest or (as a trigraph) escape a C comment."""
    safe = _one_line(text)
    for bad in ("*/", "/*", "??"):
        while bad in safe:
            safe = safe.replace(bad, f"{bad[0]} {bad[1]}")
    return safe


def cell(text: str) -> str:
    """Return the text in a form that fits one cell of a Markdown table."""
    return _one_line(text).replace("|", "\\|")
