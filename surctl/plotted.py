"""Results with a method `plot()`, whose picture is a function of the report, named by text.

Packages below the report do not import matplotlib; the function is imported when `plot()` is called.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any, ClassVar

__all__ = ["Plotted"]


class Plotted:
    """Base class of results that can be plotted."""

    PLOT: ClassVar[str] = ""
    """MODULE:FUNCTION of the function that plots the result."""

    def plot(self, *arguments: Any, **options: Any) -> Any:
        """Return the picture of the result; the arguments are those of the function that `PLOT` names."""
        module, _, function = self.PLOT.partition(":")
        return getattr(import_module(module), function)(self, *arguments, **options)
