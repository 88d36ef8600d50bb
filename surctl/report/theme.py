"""The style of all plots: colours, titles, numbers as text; names of picture files, and metadata with the command."""

from __future__ import annotations

import math
import re
import shlex
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from io import BytesIO
from os import PathLike
from pathlib import Path
from textwrap import fill
from typing import IO, Any

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ft2font import FT2Font
from matplotlib.transforms import ScaledTranslation
from numpy.typing import NDArray

import surctl
from surctl.files import write_file


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


# Okabe and Ito (2008), without the hues that are too faint on white
ROBOT = "#0072B2"
AVOIDING = "#D55E00"
GOOD = "#00735C"
BAD = "#B3261E"
OBSTACLE = "#5F6368"
MUTED = "#70757A"
INK = "#1F2328"
CYCLE = ("#0072B2", "#D55E00", "#009E73", "#AA4499", "#1F2328")
_TITLE = 10.5  # [pt] size of titles
_DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)))


# the metadata key for the program that wrote a file, by format
_MAKER = {"png": "Software", "pdf": "Creator", "svg": "Creator", "svgz": "Creator", "ps": "Creator", "eps": "Creator"}


class _Figure(Figure):
    """A figure whose file names the function that plotted it."""

    maker: str = "surctl"

    def savefig(
        self, fname: str | PathLike[Any] | IO[Any], *, metadata: Mapping[str, Any] | None = None, **options: Any
    ) -> None:
        """Save the figure as matplotlib does; metadata of the caller override the name of the function."""
        ending = Path(fname).suffix[1:] if isinstance(fname, (str, PathLike)) else ""
        key = _MAKER.get(str(options.get("format") or ending or mpl.rcParams["savefig.format"]).lower())
        if key is not None:
            options["metadata"] = {key: self.maker, **(metadata or {})}
        elif metadata is not None:
            options["metadata"] = metadata
        super().savefig(fname, **options)


def _plotting_function() -> str:
    # the innermost public function of surctl that asks for a figure, as MODULE.FUNCTION
    frame = sys._getframe(1)
    while (back := frame.f_back) is not None:
        frame, module, name = back, str(back.f_globals.get("__name__")), back.f_code.co_qualname
        if module.startswith("surctl.") and module != __name__ and not name.startswith(("_", "<")):
            return f"{module}.{name.partition('.<locals>')[0]}"
    return _Figure.maker


def png(figure: Figure, **metadata: str | None) -> bytes:
    """Return a figure as a PNG file with these texts; unlike `savefig`, it draws the figure only once."""
    buffer = BytesIO()
    canvas: Any = FigureCanvasAgg(figure)  # its method has no types
    canvas.print_png(buffer, metadata=metadata)
    return buffer.getvalue()


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure of width × height [in] that belongs to no window; its files name the plotting function."""
    figure = _Figure(figsize=(width, height), dpi=110, layout="constrained", facecolor="white")
    figure.maker = _plotting_function()
    return figure


def new_axes(width: float, height: float) -> Axes:
    """Return the only axes of a new figure of width × height [in]."""
    return new_figure(width, height).add_subplot()


def grid_of(count: int, *, most: int, size: tuple[float, float], extra: float = 0.0) -> list[Axes]:
    """Return axes in rows of at most `most`, each of width × height `size` [in], below `extra` [in] for a title."""
    columns = min(count, most)
    rows = -(-count // columns)
    axes = new_figure(size[0] * columns, extra + size[1] * rows).subplots(rows, columns, squeeze=False).ravel().tolist()
    for ax in axes[count:]:
        ax.set_axis_off()
    return list(axes[:count])


def lay_out(ax: Axes) -> None:
    """Arrange the figure of axes with equal scales once: the first layout leaves half of the figure blank."""
    figure = ax.figure.figure
    canvas: Any = FigureCanvasAgg  # has no types; it measures texts
    canvas(figure)
    if (engine := figure.get_layout_engine()) is not None:
        engine.execute(figure)


def dress(ax: Axes, *, title: str = "", x: str = "", y: str = "") -> Axes:
    """Set title, axis labels with units, grid and frame; the texts are never interpreted as formulas."""
    _title(ax, printable(title))
    ax.set_xlabel(printable(x), fontsize=9.5, color=INK, parse_math=False, wrap=_wraps(x))
    ax.set_ylabel(printable(y), fontsize=9.5, color=INK, parse_math=False, wrap=_wraps(y))
    ax.grid(visible=True, color="#DADCE0", linewidth=0.6)
    ax.set_axisbelow(True)
    ax.tick_params(labelsize=8.5, colors=INK, length=3)
    ax.tick_params(which="minor", labelsize=8.5, colors=INK)  # a logarithmic axis within a decade has minor labels
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    for side in ("bottom", "left"):
        ax.spines[side].set_color(MUTED)
    return ax


def head(figure: Figure, text: str) -> None:
    """Set the title of a whole figure; the text is never interpreted as a formula."""
    said = _broken(printable(text), figure, share=0.85)
    figure.suptitle(said, fontsize=_TITLE, fontweight="bold", color=INK, parse_math=False, wrap=_wraps(said))


def _wraps(text: str) -> bool:
    # matplotlib measures any title with a $ as a formula
    return "$" not in text


def _broken(text: str, figure: Figure, *, share: float) -> str:
    if _wraps(text):
        return text
    return fill(text, width=int(share * 72 * figure.get_size_inches()[0] / (0.75 * _TITLE)))


def _title(ax: Axes, text: str, *, pad: float | None = None) -> None:
    said = _broken(text, ax.figure.figure, share=0.5)  # narrow axes of equal scale start in the middle of the figure
    ax.set_title(
        said, loc="left", pad=pad, fontsize=_TITLE, fontweight="bold", color=INK, parse_math=False, wrap=_wraps(said)
    )


def curve(ax: Axes, x: NDArray[np.float64], y: NDArray[np.float64], *, label: str, k: int, faint: bool = False) -> None:
    """Plot a line in the k-th colour and dash, so that lines differ not only in colour; `faint` suits noisy signals."""
    colour, dash = CYCLE[k % len(CYCLE)], _DASHES[(k + k // len(CYCLE)) % len(_DASHES)]
    if faint:
        ax.plot(x, finite(y), color=colour, linewidth=0.9, alpha=0.85, label=label)
    else:
        ax.plot(x, finite(y), color=colour, linestyle=dash, linewidth=1.5, label=label)


def legend_below(ax: Axes, *, columns: int, handles: Sequence[Artist]) -> None:
    """Add a legend below the axes and their labels, where it covers no data."""
    figure = ax.figure.figure
    below = ax.transAxes + ScaledTranslation(0.0, -0.5, figure.dpi_scale_trans)  # half an inch for the labels
    ax.legend(
        handles=list(handles),
        loc="upper center",
        bbox_to_anchor=(0.5, 0.0),
        bbox_transform=below,
        borderaxespad=0.0,
        ncols=columns,
        fontsize=8.5,
        frameon=False,
        handlelength=2.4,
    )


def legend_above(ax: Axes, *, columns: int = 6) -> None:
    """Add a legend of the labelled lines above the axes, where it covers no data, and below the title."""
    if ax.get_title(loc="left"):
        _title(ax, ax.get_title(loc="left"), pad=22.0)
    ax.legend(
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        borderaxespad=0.2,
        ncols=columns,
        fontsize=8,
        frameon=False,
        handlelength=2.2,
        columnspacing=1.1,
    )


def finite(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the values with NaN instead of infinities; a plotted line is interrupted at a NaN."""
    array = np.asarray(values, dtype=float)
    return np.where(np.isfinite(array), array, np.nan)


def printable(text: str) -> str:
    """Return the text as one line of characters that the font of the plots has; others become '?'."""
    return "".join(c if ord(c) in _glyphs() else "?" for c in " ".join(text.split()))


@cache
def _glyphs() -> frozenset[int]:
    font = Path(mpl.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
    return frozenset(FT2Font(str(font)).get_charmap())


def _command() -> dict[str, str]:
    # the command that draws the picture, as text in the file; a script by its name, since its folder is this machine's
    program = Path(sys.argv[0])
    if program.stem == "surctl" or program == Path(surctl.__file__).with_name("__main__.py"):
        words = ["surctl", *sys.argv[1:]]
    elif program.suffix == ".py" and program.name != "__main__.py":
        words = ["python", program.name, *sys.argv[1:]]
    else:
        return {}
    return {"Description": shlex.join(words).encode("ascii", "backslashreplace").decode()}  # a name may be any bytes


def save_figure(plot: Figure | Axes, folder: Path | str, what: tuple[str, ...]) -> Path:
    """Write the figure of a plot as a PNG in the folder, named after its contents; return its path.

    The text `Description` in the file is the command that wrote it, `Software` the function that plotted the figure.
    """
    # names can come from input files: replace characters that could lead out of the folder
    name = "-".join(re.sub(r"[^A-Za-z0-9_.]+", "-", part).strip("-.") or "x" for part in what)
    figure = plot.figure.figure if isinstance(plot, Axes) else plot
    body = png(figure, **{"Software": getattr(figure, "maker", None), **_command()})
    return write_file(Path(folder) / f"{name}.png", body)
