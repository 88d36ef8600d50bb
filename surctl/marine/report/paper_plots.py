"""Plots that redraw the paper's figures: x, y and z over time, position errors, and trajectories of several runs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from surctl.errors import InputError
from surctl.marine.simulation import Run
from surctl.marine.simulation.run import path_depths
from surctl.report.theme import BAD, curve, dress, head, legend_above, legend_below, new_axes, new_figure, printable


def plot_coordinates(runs: Sequence[Run], *, title: str) -> Figure:
    """Plot x, y and z in the world frame {E} [m] of each run over time [s].

    Raises:
        InputError: `runs` is empty.
    """
    _some(runs)
    figure = new_figure(9.0, 5.6)
    head(figure, title)
    for k, (ax, name) in enumerate(zip(figure.subplots(3, 1, sharex=True), "xyz", strict=True)):
        dress(ax, x="time [s]" if k == 2 else "", y=f"{name} [m]")
        for j, run in enumerate(runs):
            curve(ax, run.record.time, run.record.eta[:, k], label=_name(run), k=j)
        if k == 0:
            legend_above(ax, columns=4)
    return figure


def plot_position_errors(runs: Sequence[Run], *, title: str, bound: float | None = None) -> Axes:
    """Plot the distance to the path in three axes, √(Δx² + Δy² + Δz²) [m], over time [s], also during avoidance.

    Args:
        runs: the runs to plot.
        title: title of the plot.
        bound: the paper's value of the position error [m], shown as a line.

    Raises:
        InputError: `runs` is empty.
    """
    _some(runs)
    ax = dress(new_axes(9.0, 3.8), title=title, x="time [s]", y="distance to the path [m]")
    for k, run in enumerate(runs):
        away = run.scenario.follower().track(run.record.eta[:, :2])
        above = run.record.eta[:, 2] - path_depths(run.scenario, run.record.eta[:, :2])
        curve(ax, run.record.time, np.hypot(away, above), label=_name(run), k=k)
    if bound is not None:
        ax.axhline(bound, color=BAD, linewidth=1.2, linestyle="--", label="the paper's E_p")
    legend_above(ax, columns=4)
    return ax


def plot_series(runs: Sequence[Run], *, title: str) -> Axes:
    """Plot the trajectories of several runs at one site, in the world frame {E} [m]; the legend has arrival times.

    Raises:
        InputError: `runs` is empty.
    """
    _some(runs)
    length, width, _ = runs[0].scenario.site
    ax = dress(new_axes(9.0, float(np.clip(8.0 * width / length + 1.0, 3.6, 7.0))), title=title, x="x [m]", y="y [m]")
    for k, run in enumerate(runs):
        ended = f"{_name(run)}: {run.metrics.stopped_because} at {run.metrics.time_s:.1f} s"
        curve(ax, run.record.eta[:, 0], run.record.eta[:, 1], label=ended, k=k)
    ax.set_xlim(0, length)
    ax.set_ylim(0, width)
    ax.set_aspect("equal")
    legend_below(ax, columns=2, handles=ax.get_lines())
    return ax


def _name(run: Run) -> str:
    return printable(run.scenario.name)


def _some(runs: Sequence[Run]) -> None:
    if not runs:
        raise InputError("must not be empty", key="runs", remedy="give at least one run to plot")
