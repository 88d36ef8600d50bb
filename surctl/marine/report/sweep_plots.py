"""Plots of sweeps over any number of axes: heat maps and parallel coordinates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from surctl.errors import InputError, nearest
from surctl.marine.tuning import SweepTable, SweptAxis
from surctl.report.cost_map import draw_cells, draw_frame
from surctl.report.theme import AVOIDING, INK, MUTED, OBSTACLE, ROBOT, dress, finite, legend_below, new_axes, printable

__all__ = ["COLUMN_TITLES", "axis_title", "plot_heat_map", "plot_parallel"]

COLUMN_TITLES = {
    "score": "score (low is good)",
    "deviation_m": "deviation from the path over the whole run (low is good)",
    "path_error_m": "path error outside avoidance (low is good)",
    "time_s": "time to the target (low is good)",
    "min_clearance_m_worst": "least clearance (high is good)",
    "effort_n": "mean thrust (low is good)",
    "delay_margin_s": "least delay margin (high is good)",
    "disk_margin": "disk margin at the worst corner (high is good)",
    "feasible": "feasible (1) or not (0)",
}


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
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.report import plot_heat_map
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import build_cases, sweep
        >>> from surctl.tuning import grid, parse_axis
        >>> cases = build_cases([load_scenario("pool-behind")], gains=load_gains("default"), law="closed_form")
        >>> table = sweep(cases, grid([parse_axis("k_v=1,2"), parse_axis("lookahead=0.4,0.8,1.2")]))
        >>> ax = plot_heat_map(table, "disk_margin")
        >>> ax.get_title("left"), ax.get_xlabel(), ax.get_ylabel()
        ('disk margin at the worst corner (high is good)', 'k_v [1/s]', 'lookahead [m]')
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
    dress(ax, title=_column_title(table, column), x=axis_title(one), y=axis_title(other))
    if fixed:
        ax.set_title(f"{ax.get_title(loc='left')}\nat {printable(', '.join(fixed))}", loc="left", parse_math=False)
    draw_cells(ax, values, one.values, other.values, written=measured, hatched=~feasible)
    if table.picked is not None:
        i, j = at[names.index(across)], at[names.index(up)]
        draw_frame(ax, i, j)
    return ax


def axis_title(axis: SweptAxis) -> str:
    """Return the name of a swept parameter with its unit."""
    return axis.name + _in(axis.unit)


def _column_title(table: SweepTable, column: str) -> str:
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


_SHOWN = ("deviation_m", "time_s", "min_clearance_m_worst", "effort_n", "delay_margin_s", "disk_margin", "score")
_LINES = 2000  # largest number of lines drawn, because more lines would merge


def plot_parallel(table: SweepTable, columns: Sequence[str] | None = None, ax: Axes | None = None) -> Axes:
    """Plot a sweep in parallel coordinates: one line for each point, one scale for each parameter and metric.

    Feasible points are drawn over infeasible points, and the selected point on top. The line of a point has a gap at a
    metric without a value. If there are very many points, an evenly spaced selection is drawn.

    Args:
        table: a sweep of any kind.
        columns: names of the columns; by default those columns of a standard list that the sweep contains.
        ax: axes to draw in.

    Raises:
        InputError: the sweep has no such column.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.report import plot_parallel
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import build_cases, sweep
        >>> from surctl.tuning import grid, parse_axis
        >>> cases = build_cases([load_scenario("pool-behind")], gains=load_gains("default"), law="closed_form")
        >>> table = sweep(cases, grid([parse_axis("k_v=1,2"), parse_axis("lookahead=0.4,0.8,1.2")]))
        >>> ax = plot_parallel(table, ["time_s", "disk_margin"])
        >>> ax.get_title("left"), [label.get_text() for label in ax.get_xticklabels()[:2]]
        ('6 points, 6 feasible', ['k_v [1/s]', 'lookahead [m]'])
    """
    names = [name for name in _SHOWN if name in table.columns] if columns is None else list(columns)
    scales, titles = [], []
    for k, axis in enumerate(table.axes):
        place = [1] * len(table.shape)
        place[k if table.is_grid else 0] = len(axis.values)
        scales.append(np.broadcast_to(axis.values.reshape(place), table.shape).reshape(-1))
        titles.append(axis_title(axis))
    for name in names:
        scales.append(table.column(name).reshape(-1))
        titles.append(_column_title(table, name))
    ax = ax or new_axes(1.35 * len(scales) + 1.0, 4.2)
    ends = [_ends(values) for values in scales]
    lines = np.stack([(v - low) / (high - low) for v, (low, high) in zip(scales, ends, strict=True)], axis=1)
    feasible = table.column("feasible").reshape(-1) > 0.5
    shown = np.unique(np.linspace(0, len(lines) - 1, min(len(lines), _LINES)).astype(int))
    good, bad = shown[feasible[shown]], shown[~feasible[shown]]
    dress(ax, title=f"{len(lines)} points, {int(feasible.sum())} feasible")
    ax.grid(visible=False)
    strength = float(np.clip(25 / max(len(shown), 1), 0.06, 0.8))
    for chosen, colour, width in ((bad, OBSTACLE, 0.6), (good, ROBOT, 1.0)):
        ax.add_collection(_collection(lines[chosen], colour, width, strength))
    if table.picked is not None:
        picked = int(np.ravel_multi_index(table.picked, table.shape))
        ax.add_collection(_collection(lines[[picked]], AVOIDING, 2.6, 1.0))
    _upright(ax, titles, ends)
    handles = [Line2D([], [], color=ROBOT, label="feasible"), Line2D([], [], color=OBSTACLE, label="not feasible")]
    if table.picked is not None:
        handles.append(Line2D([], [], color=AVOIDING, linewidth=2.6, label="picked"))
    legend_below(ax, columns=3, handles=handles)
    return ax


def _ends(values: NDArray[np.float64]) -> tuple[float, float]:
    # the ends differ even if all values are equal
    known = values[np.isfinite(values)]
    if known.size == 0:
        return 0.0, 1.0
    low, high = float(known.min()), float(known.max())
    return (low, high) if high > low else (low - 0.5, high + 0.5)


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
