"""Heat map of one column of a parameter sweep over two axes, with a frame around the selected point."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from surctl.errors import InputError, nearest
from surctl.marine.tuning import SweepTable, SweptAxis
from surctl.report.cost_map import draw_cells, draw_frame
from surctl.report.theme import dress, finite, new_axes, printable

__all__ = ["COLUMN_TITLES", "axis_title", "column_title", "plot_heat_map"]

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
    dress(ax, title=column_title(table, column), x=axis_title(one), y=axis_title(other))
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
