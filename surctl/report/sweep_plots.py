"""Plots of sweeps over any number of axes: heat maps and parallel coordinates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from surctl.errors import InputError, check_known
from surctl.report.theme import (
    AVOIDING,
    INK,
    MUTED,
    OBSTACLE,
    ROBOT,
    dress,
    finite,
    legend_below,
    new_axes,
    printable,
)
from surctl.tuning.sweep import SweepTable, SweptAxis

Array = NDArray[np.float64]

_NUMBERS = 80  # largest number of cells in which values are written
_TICKS = 12  # largest number of labels on an axis
_LINES = 2000  # largest number of lines drawn, because more lines would merge
_NO_TITLES: Mapping[str, str] = MappingProxyType({})


def plot_heat_map(
    table: SweepTable,
    column: str,
    ax: Axes | None = None,
    *,
    over: tuple[str, str] | None = None,
    titles: Mapping[str, str] = _NO_TITLES,
) -> Axes:
    """Plot one column of a sweep grid over two axes; all other parameters are fixed at their selected or middle value.

    If a point has several runs, the worst counts. A frame marks the picked point, or the least value if the table has
    no column `score`.

    Args:
        table: a sweep over a grid of two or more axes; infeasible cells are hatched.
        column: name of the column.
        ax: axes to draw in.
        over: (horizontal axis, vertical axis) by name; by default the first two axes with several values.
        titles: title of a column by name.

    Raises:
        InputError: the sweep has no such column or axis, or is not a grid of at least two axes.

    Example:
        >>> from surctl.report import plot_heat_map
        >>> from surctl.testing import cart_system
        >>> from surctl.tuning import SystemSweep, grid, parse_axis, sweep
        >>> design = grid([parse_axis("k=1,2"), parse_axis("start.speed=0.4,0.8,1.2")])
        >>> ax = plot_heat_map(sweep(SystemSweep(cart_system(), 5.0), design), "way")
        >>> ax.get_title("left"), ax.get_xlabel(), ax.get_ylabel()
        ('way [m]', 'k [1/s]', 'start.speed [m/s]')
    """
    names = [axis.name for axis in table.axes]
    if not table.is_grid or len(names) < 2:
        raise InputError("needs a grid of at least two axes", key="heat map", remedy="plot parallel coordinates")
    varied = sorted(names, key=lambda name: table.shape[names.index(name)] == 1)
    across, up = over or (varied[0], varied[1])
    for name in (across, up):
        check_known(name, names, "no such axis", key="heat map")
    if across == up:
        raise InputError(
            "is given for both axes of the plot", key="heat map", value=across, remedy="name two different axes"
        )
    marked = table.picked if "score" in table.columns else table.best(column)
    at = marked or tuple(n // 2 for n in table.shape)
    measured = _slice(table.worst(column), names, at, across, up)  # (rows = vertical axis, columns = horizontal one)
    feasible = _slice(_feasible(table).astype(float), names, at, across, up) > 0.5
    values = finite(measured)
    ax = ax or new_axes(5.1, 3.9)
    one, other = (table.axes[names.index(name)] for name in (across, up))
    fixed = [f"{a.name} = {a.values[k]:.4g}" for a, k in zip(table.axes, at, strict=True) if a.name not in (across, up)]
    dress(ax, title=column_title(table, column, titles), x=axis_title(one), y=axis_title(other))
    if fixed:
        ax.set_title(f"{ax.get_title(loc='left')}\nat {printable(', '.join(fixed))}", loc="left", parse_math=False)
    _draw_cells(ax, values, one.values, other.values, written=measured, hatched=~feasible)
    if marked is not None:
        _draw_frame(ax, at[names.index(across)], at[names.index(up)])
    return ax


def axis_title(axis: SweptAxis) -> str:
    """Return the name of a swept parameter with its unit."""
    return axis.name + _in(axis.unit)


def column_title(table: SweepTable, column: str, titles: Mapping[str, str] = _NO_TITLES) -> str:
    """Return the title of a column of the sweep with its unit, and over how many runs its value is the worst."""
    unit = _in(table.units.get(column, "1"))
    return titles.get(column, column) + unit + f", worst of {table.each} runs" * (table.each > 1)


def _feasible(table: SweepTable) -> NDArray[np.bool_]:
    if "feasible" not in table.columns:
        return np.full(table.shape, True)
    return table.worst("feasible") > 0.5


def _in(unit: str) -> str:
    return "" if unit == "1" else f" [{unit}]"


def _slice(
    values: NDArray[np.float64], names: list[str], at: tuple[int, ...], across: str, up: str
) -> NDArray[np.float64]:
    place = tuple(slice(None) if name in (across, up) else k for name, k in zip(names, at, strict=True))
    plane = values[place]
    return plane.T if names.index(across) < names.index(up) else plane


def plot_parallel(
    table: SweepTable, columns: Sequence[str], ax: Axes | None = None, *, titles: Mapping[str, str] = _NO_TITLES
) -> Axes:
    """Plot a sweep in parallel coordinates: one line for each point, one scale for each parameter and metric.

    Feasible points are drawn over infeasible points, and the selected point on top. The line of a point has a gap at a
    metric without a value. If there are very many points, an evenly spaced selection is drawn.

    Args:
        table: a sweep of any kind.
        columns: names of the columns; if a point has several runs, the worst counts.
        ax: axes to draw in.
        titles: title of a column by name.

    Raises:
        InputError: the sweep has no such column.

    Example:
        >>> from surctl.report import plot_parallel
        >>> from surctl.testing import cart_system
        >>> from surctl.tuning import SystemSweep, grid, parse_axis, sweep
        >>> design = grid([parse_axis("k=1,2"), parse_axis("start.speed=0.4,0.8,1.2")])
        >>> ax = plot_parallel(sweep(SystemSweep(cart_system(), 5.0), design), ["way"])
        >>> ax.get_title("left"), [label.get_text().split() for label in ax.get_xticklabels()[:2]]
        ('6 points', [['k', '[1/s]'], ['start.speed', '[m/s]']])
    """
    scales, words = [], []
    for axis in table.axes:
        scales.append(table.numbers()[axis.name][:: table.each])
        words.append(axis_title(axis))
    for name in columns:
        scales.append(table.worst(name).reshape(-1))
        words.append(column_title(table, name, titles))
    ax = ax or new_axes(1.35 * len(scales) + 1.0, 4.2)
    ends = [_value_range(values) for values in scales]
    lines = np.stack([(v - low) / (high - low) for v, (low, high) in zip(scales, ends, strict=True)], axis=1)
    feasible = _feasible(table).reshape(-1)
    shown = np.unique(np.linspace(0, len(lines) - 1, min(len(lines), _LINES)).astype(int))
    good, bad = shown[feasible[shown]], shown[~feasible[shown]]
    judged = "feasible" in table.columns
    dress(ax, title=f"{len(lines)} points" + f", {int(feasible.sum())} feasible" * judged)
    ax.grid(visible=False)
    strength = float(np.clip(25 / max(len(shown), 1), 0.06, 0.8))
    for chosen, colour, width in ((bad, OBSTACLE, 0.6), (good, ROBOT, 1.0)):
        ax.add_collection(_collection(lines[chosen], colour, width, strength))
    if table.picked is not None:
        picked = int(np.ravel_multi_index(table.picked, table.shape))
        ax.add_collection(_collection(lines[[picked]], AVOIDING, 2.6, 1.0))
    _upright(ax, words, ends)
    handles = [Line2D([], [], color=ROBOT, label="feasible"), Line2D([], [], color=OBSTACLE, label="not feasible")]
    if table.picked is not None:
        handles.append(Line2D([], [], color=AVOIDING, linewidth=2.6, label="picked"))
    if judged:
        legend_below(ax, columns=3, handles=handles)
    return ax


def _collection(lines: NDArray[np.float64], colour: str, width: float, strength: float) -> LineCollection:
    x = np.arange(lines.shape[1], dtype=float)
    segments = [np.column_stack([x, np.where(np.isfinite(line), line, np.nan)]) for line in lines]
    return LineCollection(segments, colors=colour, linewidths=width, alpha=strength)


def _upright(ax: Axes, titles: Sequence[str], ends: Sequence[tuple[float, float]]) -> None:
    # end values on the scale, name below
    ax.set_xlim(-0.3, len(titles) - 0.7)
    ax.set_ylim(-0.09, 1.09)
    ax.set_yticks([])
    ax.spines["left"].set_visible(False)
    ax.spines["bottom"].set_visible(False)
    for k, (low, high) in enumerate(ends):
        ax.axvline(k, 0.09 / 1.18, 1.09 / 1.18, color=MUTED, linewidth=1.0, zorder=0)
        for text, y, side in ((low, -0.015, "top"), (high, 1.015, "bottom")):
            ax.text(k, y, f"{text:.3g}", ha="center", va=side, fontsize=8, color=INK)
    ax.set_xticks(range(len(titles)), [_lines(title) for title in titles], fontsize=8)
    ax.tick_params(length=0)


def _lines(text: str) -> str:
    # short enough to fit beside the neighbouring titles
    words, lines = text.split(), [""]
    for word in words:
        if lines[-1] and len(lines[-1]) + 1 + len(word) > 15:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return "\n".join(printable(line) for line in lines)


def _draw_cells(
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
    low, high = _value_range(values)
    image = ax.imshow(values, origin="lower", aspect="auto", cmap=colours, vmin=low, vmax=high)
    bar = ax.figure.colorbar(image, ax=ax)
    bar.ax.tick_params(labelsize=8.5)
    ax.set_xticks(*_ticks(across))
    ax.set_yticks(*_ticks(up))
    if hatched is not None:
        for row, column in np.argwhere(hatched):
            frame = Rectangle((column - 0.5, row - 0.5), 1, 1, fill=False, hatch="xx", linewidth=0.0)
            frame.set(edgecolor="white", alpha=0.75, zorder=3)
            ax.add_patch(frame)
    if values.size <= _NUMBERS and len(across) <= _TICKS:
        _write_numbers(ax, written, colours, low, high)


def _draw_frame(ax: Axes, column: int, row: int) -> None:
    """Draw a frame around the cell of the selected point."""
    for colour, width, order in (("white", 5.0, 4), (AVOIDING, 2.5, 5)):
        frame = Rectangle((column - 0.5, row - 0.5), 1, 1, fill=False, edgecolor=colour, linewidth=width, zorder=order)
        frame.set_clip_on(False)  # also at the border of the plot
        ax.add_patch(frame)


def _ticks(values: Array) -> tuple[list[int], list[str]]:
    # no more labels than are legible
    places = list(range(0, len(values), -(-len(values) // _TICKS)))
    return places, [f"{values[k]:.4g}" for k in places]


def _value_range(values: Array) -> tuple[float, float]:
    """Return the range of the finite values, never empty, even if all are equal or none is finite."""
    known = values[np.isfinite(values)]
    if known.size == 0:
        return 0.0, 1.0
    low, high = float(known.min()), float(known.max())
    return (low, high) if high > low else (low - 0.5, high + 0.5)


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
