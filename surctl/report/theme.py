"""How every picture looks: colours that a colour-blind reader can tell apart, and axes that touch nothing global."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from textwrap import fill
from typing import Literal

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ft2font import FT2Font
from matplotlib.transforms import ScaledTranslation
from numpy.typing import NDArray

__all__ = [
    "AVOIDING",
    "BAD",
    "CYCLE",
    "GOOD",
    "INK",
    "MUTED",
    "OBSTACLE",
    "ROBOT",
    "curve",
    "dress",
    "finite",
    "head",
    "legend_above",
    "legend_below",
    "new_axes",
    "new_figure",
    "printable",
]

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


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of width × height [in] that belongs to no window."""
    return Figure(figsize=(width, height), dpi=110, layout="constrained", facecolor="white")


def new_axes(width: float, height: float) -> Axes:
    """The only axes of a new figure of width × height [in]."""
    return new_figure(width, height).add_subplot()


def dress(ax: Axes, *, title: str = "", x: str = "", y: str = "") -> Axes:
    """Set title and axis labels (with units), grid, and frame; the texts are never read as formulas."""
    _title(ax, printable(title))
    ax.set_xlabel(printable(x), fontsize=9.5, color=INK, parse_math=False, wrap=_wraps(x))
    ax.set_ylabel(printable(y), fontsize=9.5, color=INK, parse_math=False, wrap=_wraps(y))
    ax.grid(visible=True, color="#DADCE0", linewidth=0.6)
    ax.set_axisbelow(True)
    ax.tick_params(labelsize=8.5, colors=INK, length=3)
    ax.tick_params(which="minor", labelsize=8.5, colors=INK)  # a logarithmic axis within a decade writes these too
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    for side in ("bottom", "left"):
        ax.spines[side].set_color(MUTED)
    return ax


def head(figure: Figure, text: str, *, x: float = 0.5, ha: Literal["left", "center"] = "center") -> None:
    """Set the title of a whole figure; it is never read as a formula."""
    said = _broken(printable(text), figure, share=0.85)
    figure.suptitle(
        said, x=x, ha=ha, fontsize=_TITLE, fontweight="bold", color=INK, parse_math=False, wrap=_wraps(said)
    )


def _wraps(text: str) -> bool:
    """Whether a title may be broken into lines: matplotlib measures one with a $ as a formula, whatever it is told."""
    return "$" not in text


def _broken(text: str, figure: Figure, *, share: float) -> str:
    """A title that matplotlib must not break, broken here: a share of the figure, by the usual width of a letter."""
    if _wraps(text):
        return text
    return fill(text, width=int(share * 72 * figure.get_size_inches()[0] / (0.75 * _TITLE)))


def _title(ax: Axes, text: str, *, pad: float | None = None) -> None:
    said = _broken(text, ax.figure.figure, share=0.5)  # narrow axes of equal scale begin in the middle
    ax.set_title(
        said, loc="left", pad=pad, fontsize=_TITLE, fontweight="bold", color=INK, parse_math=False, wrap=_wraps(said)
    )


def curve(ax: Axes, x: NDArray[np.float64], y: NDArray[np.float64], *, label: str, k: int, faint: bool = False) -> None:
    """A line in the k-th colour and dash, so that colour alone never tells two lines apart; `faint` for noise."""
    colour, dash = CYCLE[k % len(CYCLE)], _DASHES[(k + k // len(CYCLE)) % len(_DASHES)]
    if faint:
        ax.plot(x, finite(y), color=colour, linewidth=0.9, alpha=0.85, label=label)
    else:
        ax.plot(x, finite(y), color=colour, linestyle=dash, linewidth=1.5, label=label)


def legend_below(ax: Axes, *, columns: int, handles: Sequence[Artist]) -> None:
    """A legend under the axes and their labels, where it covers no data."""
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
    """A legend of the labelled lines on top of the axes, where it covers no data, under the title if there is one."""
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
    """The same numbers with infinities as NaN, which a line leaves out."""
    array = np.asarray(values, dtype=float)
    return np.where(np.isfinite(array), array, np.nan)


def printable(text: str) -> str:
    """One line of characters that the plots' font has; others become '?'."""
    return "".join(c if ord(c) in _glyphs() else "?" for c in " ".join(text.split()))


@cache
def _glyphs() -> frozenset[int]:
    font = Path(mpl.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
    return frozenset(FT2Font(str(font)).get_charmap())
