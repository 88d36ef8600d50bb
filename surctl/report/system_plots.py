"""Pictures of runs of any system: one run with limits, fans, phase planes, distributions."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError, check_known
from surctl.report.panel import Curve, Panel, Shade, draw_panel
from surctl.report.theme import (
    AVOIDING,
    BAD,
    CYCLE,
    INK,
    MUTED,
    ROBOT,
    dress,
    grid_of,
    head,
    legend_above,
    legend_below,
    new_axes,
    new_figure,
    printable,
)
from surctl.system import Record, Runs
from surctl.tuning import SobolIndices

Array = NDArray[np.float64]

_NONE: Mapping[str, tuple[float, float]] = MappingProxyType({})


def plot_record(record: Record, *, limits: Mapping[str, tuple[float, float]] = _NONE) -> Figure:
    """Plot all states, commands and references of a run over one time axis; each plot has signals of one unit.

    Args:
        record: the run.
        limits: lower and upper limit of signals by name, which are drawn as lines; what lies outside is shaded. Without
            any, those of the system are drawn.

    Example:
        >>> from surctl.report import plot_record
        >>> from surctl.system import run_system
        >>> from surctl.testing import cart_system
        >>> [ax.get_ylabel() for ax in plot_record(run_system(cart_system(), 2.0)).axes]
        ['speed [m/s]', 'force [m/s^2]']
    """
    panels = run_panels({"": record}, limits=limits)
    figure = new_figure(8.5, 1.0 + 1.8 * len(panels))
    head(figure, f"{record.system.title}, ended after {record.duration:g} s ({record.stopped})")
    axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for ax, panel in zip(axes, panels, strict=True):
        draw_panel(replace(panel, title="", x=panel.x if ax is axes[-1] else ""), ax)
    return figure


def run_panels(
    runs: Mapping[str, Record], *, limits: Mapping[str, tuple[float, float]] = _NONE, most: int = sys.maxsize
) -> list[Panel]:
    """Return a panel for each state, command and reference of runs by name; its entries have one unit.

    `limits` are as in `plot_record`, and `most` is about the largest number of times of a curve.
    """
    groups: dict[tuple[str, str], list[Curve]] = {}
    for run, record in runs.items():
        ports, commands, step = record.ports(), record.ports("command"), max(1, len(record.time) // most)
        for name, label, unit, values in record.entries("state", "command", "reference"):
            curves = groups.setdefault((name, unit), [])
            words = [label] * (ports[name].size > 1) + [run] * (len(runs) > 1)
            kind: Literal["steps", "line"] = "steps" if name in commands else "line"
            curves.append(Curve(record.time[::step], values[::step], ", ".join(words), len(curves), kind))
    panels, known = [], limits or next(iter(runs.values())).system.limits
    for (name, unit), curves in groups.items():
        ends = max((one.x[[0, -1]] for one in curves), key=lambda pair: float(pair[1]))
        sides: tuple[Literal["below", "above"], ...] = ("below", "above")
        shades = [Shade(ends, np.full(2, level), side) for level, side in zip(known.get(name, ()), sides, strict=False)]
        panels.append(Panel(f"Run: {name}", "time [s]", f"{name} [{unit}]", curves, shades))
    return panels


_BANDS = ((5, 95, 0.18), (25, 75, 0.32))  # percentiles and opacity
_BINS = 24


def plot_fan(records: Sequence[Record], signal: str, ax: Axes | None = None) -> Axes:
    """Plot one signal of many runs over time: median, bands of 50 % and 90 % of the runs, and the outermost runs.

    A run that ended early counts until its end.

    Args:
        records: the runs of one system.
        signal: label of one entry of a signal, such as `speed` or `force[1]`.
        ax: the axes; None creates new ones.

    Raises:
        InputError: there is no run or no such signal.

    Example:
        >>> import numpy as np
        >>> from surctl.report import plot_fan
        >>> from surctl.system import run_system
        >>> from surctl.testing import cart_system
        >>> runs = [run_system(cart_system(), 2.0, {"start.speed": v}) for v in np.linspace(0.5, 1.5, 9)]
        >>> plot_fan(runs, "speed").get_title("left")
        'speed, 9 runs'
    """
    if not records:
        raise InputError("has no runs", key="records", remedy="give at least one record")
    longest = max(records, key=lambda record: len(record.time))
    table = np.full((len(records), len(longest.time)), np.nan)
    for row, record in zip(table, records, strict=True):
        values, unit = _signal(record, signal)
        row[: len(values)] = values
    ax = dress(ax or new_axes(6.4, 3.9), title=f"{signal}, {len(records)} runs", x="time [s]", y=f"{signal} [{unit}]")
    time = longest.time
    for low, high, alpha in _BANDS:
        ends = np.nanpercentile(table, [low, high], axis=0)
        ax.fill_between(time, *ends, color=ROBOT, alpha=alpha, linewidth=0, label=f"{high - low} % of the runs")
    ax.plot(time, np.nanmedian(table, axis=0), color=ROBOT, linewidth=1.8, label="median")
    for name, row in (("least", np.nanmin(table, axis=0)), ("greatest", np.nanmax(table, axis=0))):
        ax.plot(time, row, color=MUTED, linewidth=0.9, linestyle="--" if name == "least" else ":", label=name)
    ax.set_xlim(0.0, float(time[-1]) or 1.0)
    legend_above(ax, columns=5)
    return ax


def plot_phase_plane(records: Sequence[Record], x: str, y: str, ax: Axes | None = None) -> Axes:
    """Plot runs in the plane of two signals; a circle marks the start, a square the end, a red one an early end.

    Args:
        records: the runs.
        x, y: labels of two entries of signals, such as `angle` and `rate`.
        ax: the axes; None creates new ones.

    Raises:
        InputError: there is no such signal.

    Example:
        >>> from surctl.report import plot_phase_plane
        >>> from surctl.system import run_system
        >>> from surctl.testing import cart_system
        >>> runs = [run_system(cart_system(), 2.0, {"start.speed": v}) for v in (0.5, 1.0)]
        >>> ax = plot_phase_plane(runs, "speed", "force")
        >>> ax.get_xlabel(), len(ax.lines)
        ('speed [m/s]', 6)
    """
    ax = ax or new_axes(5.4, 4.6)
    units = ("1", "1")
    for k, record in enumerate(records):
        (across, unit), (upwards, other) = _signal(record, x), _signal(record, y)
        units = (unit, other)
        early = record.stopped != "time"
        ax.plot(across, upwards, color=CYCLE[k % len(CYCLE)], linewidth=1.2)
        ax.plot(across[:1], upwards[:1], "o", color=INK, markersize=4, fillstyle="none")
        ax.plot(across[-1:], upwards[-1:], "s", color=BAD if early else INK, markersize=4)
    return dress(ax, title=f"{y} over {x}, {len(records)} runs", x=f"{x} [{units[0]}]", y=f"{y} [{units[1]}]")


def plot_runs(runs: Runs, names: Sequence[str] = ()) -> Figure:
    """Plot how each metric of many runs is distributed, with its mean and its 95th percentile.

    Args:
        runs: the runs.
        names: names of metrics; by default all.

    Raises:
        InputError: there is no such metric, or none at all.

    Example:
        >>> import numpy as np
        >>> from surctl.system import simulate_system
        >>> from surctl.testing import cart_system
        >>> runs = simulate_system(cart_system(), 5.0, {"start.speed": np.linspace(0, 1, 50)})
        >>> runs.plot().axes[0].get_xlabel()
        'way'
    """
    chosen = list(names or runs.figures)
    if not chosen:
        raise InputError("have no metrics", key="runs", remedy="give System(..., costs={...})")
    axes = grid_of(len(chosen), most=2, size=(4.6, 3.2))
    for ax, name in zip(axes, chosen, strict=True):
        values = runs[name]
        known = values[np.isfinite(values)]
        dress(ax, title=f"{name}, {len(known)} of {len(values)} runs", x=name, y="runs")
        if known.size:
            ax.hist(known, bins=_BINS, color=ROBOT, alpha=0.75)
            ax.axvline(float(known.mean()), color=INK, linewidth=1.2, label="mean")
            ax.axvline(float(np.percentile(known, 95)), color=AVOIDING, linestyle="--", linewidth=1.2, label="95 %")
            legend_above(ax, columns=2)
    return axes[0].figure.figure


def plot_dependence(values: Mapping[str, ArrayLike], runs: Runs | Mapping[str, Array], name: str) -> Figure:
    """Plot one metric of many runs over each varied number, ordered by the size of the rank correlation.

    Args:
        values: the numbers (n,) of the runs by name, as given to `simulate_system`; scalars are left out.
        runs: the runs, or metrics (n,) by name.
        name: name of the metric.

    Raises:
        InputError: there is no such metric, or no number varies.

    Example:
        >>> import numpy as np
        >>> from surctl.report import plot_dependence
        >>> from surctl.system import simulate_system
        >>> from surctl.testing import cart_system
        >>> values = {"start.speed": np.linspace(0, 1, 50)}
        >>> runs = simulate_system(cart_system(), 5.0, values)
        >>> plot_dependence(values, runs, "way").axes[0].get_title("left")
        'start.speed: rank correlation 1.00'
    """
    figure_values = runs[name]
    varied = {key: array for key, array in ((k, np.asarray(v, dtype=float)) for k, v in values.items()) if array.ndim}
    numbers = {
        f"{key}[{j}]" if array.ndim == 2 and array.shape[1] > 1 else key: array.reshape(len(array), -1)[:, j]
        for key, array in varied.items()
        for j in range(array.reshape(len(array), -1).shape[1])
        if len(array) == len(figure_values)
    }
    if not numbers:
        raise InputError("vary nothing", key="values", remedy="give one number for each run")
    strength = {key: _rank_correlation(array, figure_values) for key, array in numbers.items()}
    order = sorted(numbers, key=lambda key: -abs(strength[key]))
    axes = grid_of(len(order), most=3, size=(3.7, 2.9), extra=0.5)
    head(axes[0].figure.figure, f"{name} of {len(figure_values)} runs")
    for ax, key in zip(axes, order, strict=True):
        ax.plot(numbers[key], figure_values, ".", color=ROBOT, markersize=3, alpha=0.6)
        dress(ax, title=f"{key}: rank correlation {strength[key]:.2f}", x=key, y=name)
    return axes[0].figure.figure


def _rank_correlation(x: Array, y: Array) -> float:
    known = np.isfinite(x) & np.isfinite(y)
    ranks = [np.argsort(np.argsort(v[known], kind="stable"), kind="stable") for v in (x, y)]
    if known.sum() < 2 or np.ptp(x[known]) == 0 or np.ptp(y[known]) == 0:
        return 0.0
    return float(np.corrcoef(ranks[0], ranks[1])[0, 1])


def _signal(record: Record, label: str) -> tuple[Array, str]:
    known = {one: (values, unit) for _, one, unit, values in record.entries()}
    check_known(label, known, "is not a signal of the run", key="signal")
    return known[label]


# Bars of Sobol' indices


def plot_sobol_indices(result: SobolIndices, ax: Axes | None = None) -> Axes:
    """Plot the first-order and total Sobol' indices of each parameter with their confidence intervals.

    Args:
        result: the Sobol' indices.
        ax: axes to draw in.
    """
    ax = ax or new_axes(6.4, 1.5 + 0.55 * len(result.axes))
    title = f"What {result.column} depends on"
    dress(ax, title=f"{title}: it is constant" if result.constant else title, x="share of the variance [1]")
    at = np.arange(len(result.axes))[::-1]
    series = (
        ("alone (first order)", result.first, result.first_interval, ROBOT, 0.19, None),
        ("with others (total order)", result.total, result.total_interval, AVOIDING, -0.19, "///"),
    )
    for label, values, intervals, colour, offset, hatch in series:
        heights = np.array(values)
        ax.barh(
            at + offset, heights, 0.34, color="white" if hatch else colour, edgecolor=colour, hatch=hatch, label=label
        )
        # a bootstrap interval need not contain the estimate
        errors = np.abs(np.array(intervals).T - heights)
        ax.errorbar(heights, at + offset, xerr=errors, fmt="none", ecolor=INK, elinewidth=1.1, capsize=2.5)
    ax.set_yticks(at, [printable(name) for name in result.axes])
    ends = [v for pair in (*result.first_interval, *result.total_interval) for v in pair]
    ax.set_xlim(min(0.0, *ends) - 0.02, max(1.0, *ends) + 0.02)
    ax.axvline(0.0, color=MUTED, linewidth=0.8)
    handles, _ = ax.get_legend_handles_labels()
    legend_below(ax, columns=2, handles=handles)
    return ax
