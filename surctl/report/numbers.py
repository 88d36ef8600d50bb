"""Format of numbers and sizes in HTML reports."""

from __future__ import annotations

import math
from pathlib import Path

__all__ = ["file_size", "interval", "number"]


def number(value: float | None, *, digits: int = 4) -> str:
    """Format a value with at most `digits` significant digits; None and NaN give "–", infinities "∞" or "-∞"."""
    if value is None or math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "-∞"
    return f"{value:.{digits}g}"


def interval(lower: float, upper: float) -> str:
    """Format an interval as "a to b", or as a single number if both ends are equal."""
    return number(lower) if lower == upper else f"{number(lower)} to {number(upper)}"


def file_size(path: Path) -> str:
    """Format the size of a file on disk [byte]; "–" if the file does not exist."""
    try:
        return f"{path.stat().st_size:,}".replace(",", "\u202f")
    except OSError:
        return "–"
