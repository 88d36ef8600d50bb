"""Heat map of one column of a parameter sweep over two axes, with a frame around the selected point."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Colormap
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from surctl.errors import InputError, nearest
from surctl.report.theme import AVOIDING, INK, dress, finite, new_axes, printable
from surctl.tuning import SweepTable, SweptAxis

__all__ = ["COLUMN_TITLES", "axis_title", "column_title", "plot_heat_map"]

COLUMN_TITLES = {
    "score": "score (low is good)",
    "deviation_m": "deviation from the path over the whole run (low is good)",
    "path_error_m": "path error outside avoidance (low is good)",
    "time_s": "time to the target (low is good)",
    "min_clearance_m_worst": "least clearance (high is good)",
    "effort_n": "mean thrust (low is good)",
    "delay_margin_s": "least delay margin (high is good)",
    "disk_margin": "least disk margin (high is good)",
    "feasible": "feasible (1) or not (0)",
}
_NUMBERS = 80  # largest number of cells in which values are written
_TICKS = 12  # largest number of labels on an axis


def plot_heat_map(
    table: SweepTable, column: str, ax: Axes | None = None, *, over: tuple[str, str] | None = None
) -> Axes:
    """Plot one column of a sweep grid over two axes; all other parameters are fixed at their selected or middle value.

    Args:
        table: a parameter sweep over a grid of two or more axes; infeasible cells are hatched.
        column: name of the column.
        ax: axes to draw in.
        over: (horizontal axis, vertical axis) by name; by default the first two axes of the sweep.

    Raises:
        InputError: the sweep has no such column or axis, or is not a grid of at least two axes.

    Example:
        >>> from surctl.control import load_gains
        >>> from surctl.report import plot_heat_map
        >>> from surctl.simulation import load_scenario
        >>> from surctl.tuning import build_cases, grid, parse_axis, sweep
        >>> cases = build_cases([load_scenario("pool-behind")], gains=load_gains("default"), law="closed_form")
        >>> table = sweep(cases, grid([parse_axis("k_v=1,2"), parse_axis("lookahead=0.4,0.8,1.2")]))
        >>> ax = plot_heat_map(table, "disk_margin")
        >>> ax.get_title("left"), ax.get_xlabel(), ax.get_ylabel()
        ('least disk margin (high is good)', 'k_v [1/s]', 'lookahead [m]')
    """
    names = [axis.name for axis in table.axes]
    if not table.is_grid or len(names) < 2:
        raise InputError("needs a grid of at least two axes", key="heat map", remedy="plot parallel coordinates")
    across, up = over or (names[0], names[1])
    for name in (across, up):
        if name not in names:
            raise InputError("no such axis", key="heat map", value=name, remedy=nearest(name, names))
    if across == up:
        raise InputError(
            "is given for both axes of the plot", key="heat map", value=across, remedy="name two different axes"
        )
    at = table.picked or tuple(n // 2 for n in table.shape)
    measured = _slice(table.column(column), names, at, across, up)  # (rows = vertical axis, columns = horizontal one)
    feasible = _slice(table.column("feasible"), names, at, across, up) > 0.5
    values = finite(measured)
    ax = ax or new_axes(5.1, 3.9)
    one, other = (table.axes[names.index(name)] for name in (across, up))
    fixed = [f"{a.name} = {a.values[k]:.4g}" for a, k in zip(table.axes, at, strict=True) if a.name not in (across, up)]
    dress(ax, title=column_title(table, column), x=axis_title(one), y=axis_title(other))
    if fixed:
        ax.set_title(f"{ax.get_title(loc='left')}\nat {printable(', '.join(fixed))}", loc="left", parse_math=False)
    ax.grid(visible=False)
    colours = mpl.colormaps["cividis"].with_extremes(bad="#E8EAED")
    low, high = _range(values)
    # all cells have the same size, for any spacing of the values; the axis labels give the values
    image = ax.imshow(values, origin="lower", aspect="auto", cmap=colours, vmin=low, vmax=high)
    bar = ax.figure.colorbar(image, ax=ax)
    bar.ax.tick_params(labelsize=8.5)
    ax.set_xticks(*_ticks(one))
    ax.set_yticks(*_ticks(other))
    _hatch(ax, ~feasible)
    if values.size <= _NUMBERS and len(one.values) <= _TICKS:
        _write_numbers(ax, measured, colours, low, high)
    if table.picked is not None:
        i, j = at[names.index(across)], at[names.index(up)]
        ax.add_patch(Rectangle((i - 0.5, j - 0.5), 1, 1, fill=False, edgecolor="white", linewidth=5, zorder=4))
        ax.add_patch(Rectangle((i - 0.5, j - 0.5), 1, 1, fill=False, edgecolor=AVOIDING, linewidth=2.5, zorder=5))
    return ax


def axis_title(axis: SweptAxis) -> str:
    """Return the name of a swept parameter with its unit."""
    return axis.name + _in(axis.unit)


def column_title(table: SweepTable, column: str) -> str:
    """Return the title of a column of the sweep with its unit."""
    return COLUMN_TITLES.get(column, column) + _in(table.units.get(column, "1"))


def _in(unit: str) -> str:
    return "" if unit == "1" else f" [{unit}]"


def _slice(
    values: NDArray[np.float64], names: list[str], at: tuple[int, ...], across: str, up: str
) -> NDArray[np.float64]:
    place = tuple(slice(None) if name in (across, up) else k for name, k in zip(names, at, strict=True))
    plane = values[place]
    return plane.T if names.index(across) < names.index(up) else plane


def _ticks(axis: SweptAxis) -> tuple[list[int], list[str]]:
    # no more labels than are legible
    places = list(range(0, len(axis.values), -(-len(axis.values) // _TICKS)))
    return places, [f"{axis.values[k]:.4g}" for k in places]


def _range(values: NDArray[np.float64]) -> tuple[float, float]:
    # never empty, even if all values are equal or none is finite
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
