"""Blank pictures, where a test reads no pixel: drawing takes half the time of a command that plots.

The plots are made as ever; their files have name, size and metadata. What is in them `tests/report` reads.
"""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import IO, Any

import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image
from PIL.PngImagePlugin import PngInfo

_drawn = Figure.savefig


def rendered(plot: Axes | Figure) -> Figure:
    """The figure, rendered coarsely, for nobody looks at it: a warning of the renderer is an error in the tests."""
    figure = plot if isinstance(plot, Figure) else plot.figure.figure
    figure.savefig(BytesIO(), format="png", dpi=20)
    return figure


def blank_pictures(patch: pytest.MonkeyPatch) -> None:
    """From now on figures are saved as white PNG files of their size; other formats are drawn."""
    patch.setattr(Figure, "savefig", _saved_blank)
    patch.setattr(FigureCanvasAgg, "print_png", _printed_blank)


def _saved_blank(figure: Figure, fname: str | PathLike[Any] | IO[bytes], **options: Any) -> None:
    ending = Path(fname).suffix[1:] if isinstance(fname, (str, PathLike)) else ""
    if (options.get("format") or ending or "png") != "png":
        _drawn(figure, fname, **options)
        return
    _write(figure, fname, options.get("metadata"))


def _printed_blank(canvas: FigureCanvasAgg, filename: Any, *, metadata: Any = None, **options: Any) -> None:
    _write(canvas.figure, filename, metadata)


def _write(figure: Any, file: Any, metadata: Mapping[str, str | None] | None) -> None:
    told = PngInfo()
    for name, text in (metadata or {}).items():
        if text is not None:
            told.add_text(name, text)
    width, height = (round(side) for side in figure.get_size_inches() * figure.dpi)
    Image.new("RGB", (width, height), "white").save(file, format="png", pnginfo=told)
