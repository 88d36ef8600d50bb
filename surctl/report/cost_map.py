"""Heat map of a quantity over a grid of two parameters."""

from __future__ import annotations

from collections.abc import Mapping

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Colormap
from matplotlib.patches import Rectangle
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError
from surctl.report.theme import AVOIDING, INK, dress, finite, new_axes

Array = NDArray[np.float64]

_NUMBERS = 80  # largest number of cells in which values are written
_TICKS = 12  # largest number of labels on an axis


def plot_cost_map(axes: Mapping[str, ArrayLike], cost: ArrayLike, title: str, ax: Axes | None = None) -> Axes:
    """Plot a cost over a grid of two parameters of any system, with a frame around the least value.

    Args:
        axes: two parameters by label, which may contain the unit, each with its values (n,) and (m,).
        cost: the cost (n, m) of each pair of values; NaN and infinity are written as signs.
        title: title of the plot, such as the cost with its unit.
        ax: the axes; None creates new ones.

    Raises:
        InputError: there are not two parameters, or the cost has another shape.

    Example:
        >>> from surctl.report import plot_cost_map
        >>> ax = plot_cost_map({"k_p [1/s]": [1, 2, 4], "k_d": [0.5, 1]}, [[3, 2], [2, 1], [4, 3]], "settling [s]")
        >>> ax.get_xlabel(), ax.get_ylabel(), [label.get_text() for label in ax.get_xticklabels()]
        ('k_p [1/s]', 'k_d', ['1', '2', '4'])
    """
    table = np.asarray(cost, dtype=float)
    values = [np.asarray(one, dtype=float) for one in axes.values()]
    if len(values) != 2 or table.shape != tuple(map(len, values)):
        sizes = " and ".join(str(len(one)) for one in values)
        remedy = "give two parameters, and one number for each pair of their values"
        raise InputError(f"has shape {table.shape} over parameters of {sizes} values", key="cost", remedy=remedy)
    across, up = axes
    ax = dress(ax or new_axes(5.1, 3.9), title=title, x=across, y=up)
    draw_cells(ax, finite(table.T), *values, written=table.T)
    if np.isfinite(table).any():
        column, row = divmod(int(np.argmin(np.where(np.isfinite(table), table, np.inf))), table.shape[1])
        draw_frame(ax, column, row)
    return ax


def draw_cells(
    ax: Axes, values: Array, across: Array, up: Array, *, written: Array, hatched: NDArray[np.bool_] | None = None
) -> None:
    """Draw one coloured cell for each pair of values, with a colour bar.

    All cells have the same size, for any spacing of the values; the axis labels give the values.

    Args:
        ax: axes to draw in.
        values: (m, n) finite numbers or NaN; rows are the vertical axis.
        across, up: values (n,) and (m,) of the two axes.
        written: (m, n) numbers to write into the cells if there are few.
        hatched: (m, n), cells to hatch.
    """
    ax.grid(visible=False)
    colours = mpl.colormaps["cividis"].with_extremes(bad="#E8EAED")
    low, high = value_range(values)
    image = ax.imshow(values, origin="lower", aspect="auto", cmap=colours, vmin=low, vmax=high)
    bar = ax.figure.colorbar(image, ax=ax)
    bar.ax.tick_params(labelsize=8.5)
    ax.set_xticks(*_ticks(across))
    ax.set_yticks(*_ticks(up))
    if hatched is not None:
        _hatch(ax, hatched)
    if values.size <= _NUMBERS and len(across) <= _TICKS:
        _write_numbers(ax, written, colours, low, high)


def draw_frame(ax: Axes, column: int, row: int) -> None:
    """Draw a frame around the cell of the selected point."""
    for colour, width, order in (("white", 5.0, 4), (AVOIDING, 2.5, 5)):
        frame = Rectangle((column - 0.5, row - 0.5), 1, 1, fill=False, edgecolor=colour, linewidth=width, zorder=order)
        frame.set_clip_on(False)  # also at the border of the plot
        ax.add_patch(frame)


def _ticks(values: Array) -> tuple[list[int], list[str]]:
    # no more labels than are legible
    places = list(range(0, len(values), -(-len(values) // _TICKS)))
    return places, [f"{values[k]:.4g}" for k in places]


def value_range(values: Array) -> tuple[float, float]:
    """Return the range of the finite values, never empty, even if all are equal or none is finite."""
    known = values[np.isfinite(values)]
    if known.size == 0:
        return 0.0, 1.0
    low, high = float(known.min()), float(known.max())
    return (low, high) if high > low else (low - 0.5, high + 0.5)


def _hatch(ax: Axes, cells: NDArray[np.bool_]) -> None:
    for row, column in np.argwhere(cells):
        frame = Rectangle((column - 0.5, row - 0.5), 1, 1, fill=False, hatch="xx", linewidth=0.0)
        frame.set(edgecolor="white", alpha=0.75, zorder=3)
        ax.add_patch(frame)


def _write_numbers(ax: Axes, values: Array, colours: Colormap, low: float, high: float) -> None:
    for (row, column), value in np.ndenumerate(values):
        if not np.isfinite(value):
            ax.text(column, row, "–" if np.isnan(value) else "∞", ha="center", va="center", fontsize=8.5, color=INK)
            continue
        red, green, blue, _ = colours((value - low) / (high - low))
        dark = 0.299 * red + 0.587 * green + 0.114 * blue < 0.5
        ground = {"facecolor": (red, green, blue), "edgecolor": "none", "boxstyle": "round,pad=0.15"}
        colour = "white" if dark else INK
        ax.text(
            column, row, f"{value:.3g}", ha="center", va="center", fontsize=8.5, color=colour, bbox=ground, zorder=6
        )
