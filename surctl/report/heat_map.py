"""A sweep's grid as a heat map: the picked point marked, infeasible cells hatched, numbers in the cells."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Colormap
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from surctl.report.theme import AVOIDING, INK, dress, finite, new_axes
from surctl.tuning import Axis, Sweep

__all__ = ["COLUMN_TITLES", "plot_heat_map"]

COLUMN_TITLES = {
    "score": "score (low is good)",
    "deviation_m": "deviation from the path (low is good)",
    "path_error_m": "path error outside avoidance (low is good)",
    "time_s": "time to the target (low is good)",
    "min_clearance_m": "least clearance (high is good)",
    "effort_n": "mean thrust (low is good)",
    "delay_margin_s": "least delay margin (high is good)",
    "disk_margin": "least disk margin (high is good)",
    "feasible": "feasible (1) or not (0)",
}
_NUMBERS = 80  # cells with a number in them, at most


def plot_heat_map(sweep: Sweep, column: str, ax: Axes | None = None) -> Axes:
    """One column of a sweep over its two gains.

    Args:
        sweep: the sweep.
        column: name of the column.
        ax: axes to draw in.

    Raises:
        InputError: the sweep has no such column.
    """
    measured = sweep.column(column).T  # (rows = second gain, columns = first gain)
    values = finite(measured)
    feasible = sweep.column("feasible").T > 0.5
    ax = ax or new_axes(5.1, 3.9)
    one, other = sweep.axes
    unit = "" if sweep.units[column] == "1" else f" [{sweep.units[column]}]"
    dress(ax, title=COLUMN_TITLES.get(column, column) + unit, x=_axis_title(one), y=_axis_title(other))
    ax.grid(visible=False)
    colours = mpl.colormaps["cividis"].with_extremes(bad="#E8EAED")
    low, high = _range(values)
    # cells of equal size whatever the spacing of the gains: the ticks name them
    image = ax.imshow(values, origin="lower", aspect="auto", cmap=colours, vmin=low, vmax=high)
    bar = ax.figure.colorbar(image, ax=ax)
    bar.ax.tick_params(labelsize=8.5)
    ax.set_xticks(range(len(one.values)), [f"{v:g}" for v in one.values])
    ax.set_yticks(range(len(other.values)), [f"{v:g}" for v in other.values])
    _hatch(ax, ~feasible)
    if values.size <= _NUMBERS:
        _write_numbers(ax, measured, colours, low, high)
    if sweep.picked is not None:
        i, j = sweep.picked
        ax.add_patch(Rectangle((i - 0.5, j - 0.5), 1, 1, fill=False, edgecolor="white", linewidth=5, zorder=4))
        ax.add_patch(Rectangle((i - 0.5, j - 0.5), 1, 1, fill=False, edgecolor=AVOIDING, linewidth=2.5, zorder=5))
    return ax


def _axis_title(axis: Axis) -> str:
    return f"{axis.name} [{axis.unit}]"


def _range(values: NDArray[np.float64]) -> tuple[float, float]:
    """Colour range; not empty even where every value is the same or none is a number."""
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


def _write_numbers(ax: Axes, values: NDArray[np.float64], colours: Colormap, low: float, high: float) -> None:
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
