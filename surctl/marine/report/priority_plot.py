"""Plots of task priorities over time: how much each level was relaxed, and by which constraint rows of the QP."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from surctl.marine.report.signals import spans
from surctl.priority import PriorityTimeline
from surctl.priority.timeline import NOTICEABLE
from surctl.report.numbers import number
from surctl.report.theme import AVOIDING, BAD, INK, MUTED, ROBOT, dress, head, new_figure, printable

__all__ = ["plot_priority", "relaxation_text"]

_MOST = 8  # largest number of constraint rows shown: those that bind or are violated longest


def plot_priority(timeline: PriorityTimeline, *, title: str = "") -> Figure:
    """Plot the relaxation of each level, highest priority first; a lower plot shows when each constraint row binds.

    Args:
        timeline: the decisions of any stack (`PriorityTimeline.of`), or of a run (`priority_timeline`).
        title: line above the plot.

    Example:
        >>> from dataclasses import replace
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.report import plot_priority
        >>> from surctl.marine.simulation import load_scenario, priority_timeline, simulate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> law, gains = build_law(mode="filter", contacts=1), load_gains("default")
        >>> scenario = replace(load_scenario("pool-behind"), time_limit=2.0)
        >>> run = simulate(scenario, load_vehicle("sur400"), gains=gains, law=law)
        >>> figure = plot_priority(priority_timeline(run))
        >>> [ax.get_ylabel() for ax in figure.axes]
        ['1 velocity [m/s]', '2 depth [m/s]', '3 heading [rad/s]', '']
    """
    rows = _longest(timeline)
    quiet: list[bool] = np.all(timeline.to_levels + timeline.to_rows <= NOTICEABLE, axis=0).tolist()
    heights = [0.3 if one else 0.95 for one in quiet] + [0.26 * max(len(rows), 1) + 0.2]
    figure = new_figure(9.5, 1.4 + sum(heights) + 0.1 * len(heights))
    axes = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights, squeeze=False).ravel().tolist()
    head(figure, title or "priority levels over time")
    for level, ax in enumerate(axes[:-1]):
        _draw_level(ax, timeline, level)
    _draw_rows(axes[-1], timeline, rows)
    end = float(timeline.time[-1]) if timeline.time.size else 0.0
    axes[-1].set_xlim(float(timeline.time[0]) if end else 0.0, end or 1.0)
    handles = [
        Patch(facecolor=ROBOT, alpha=0.55, label="residual due to higher levels"),
        Patch(facecolor=AVOIDING, label="residual due to rows"),
        Line2D([], [], color=INK, linewidth=5, label="row binds"),
        Line2D([], [], color=BAD, linewidth=5, alpha=0.45, label="row is violated"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=8.5, frameon=False)
    return figure


def relaxation_text(timeline: PriorityTimeline) -> str:
    """Describe how much and how long each level was relaxed, by which constraint rows, and which rows were violated."""
    parts = []
    step = float(np.median(np.diff(timeline.time))) if len(timeline.time) > 1 else 0.0
    for level, (name, unit) in enumerate(zip(timeline.levels, timeline.units, strict=True)):
        for lost, guilty in ((timeline.to_rows, True), (timeline.to_levels, False)):
            noticeable = lost[:, level] > NOTICEABLE
            if not noticeable.any():
                continue
            rows = [row for k, row in enumerate(timeline.rows) if timeline.causes[:, level, k].any()]
            to = _listed(rows) if guilty else "the levels above it"
            most = f"{number(float(lost[:, level].max()), digits=2)} {unit}".strip()
            parts.append(
                f"{name} gave up at most {most} because of {to}, "
                f"for {number(step * int(noticeable.sum()), digits=3)} s in total"
            )
    missed = [row for k, row in enumerate(timeline.rows) if (timeline.missed[:, k] > NOTICEABLE).any()]
    if missed:
        parts.append(f"violated by at most {number(float(timeline.missed.max()), digits=2)}: {_listed(missed)}")
    return "; ".join(parts) or "no level gave up anything"


def _listed(rows: list[str]) -> str:
    return f"{', '.join(rows[:4])} and {len(rows) - 4} more rows" if len(rows) > 5 else ", ".join(rows) or "the limits"


def _longest(timeline: PriorityTimeline) -> list[int]:
    # constraint rows (n·v ≤ b), in the law's order
    counts = (timeline.binding | (timeline.missed > NOTICEABLE)).sum(axis=0)
    return sorted(np.argsort(-counts, kind="stable")[:_MOST].tolist())


def _draw_level(ax: Axes, timeline: PriorityTimeline, level: int) -> None:
    dress(ax, y=f"{level + 1} {timeline.levels[level]} [{timeline.units[level] or '1'}]")
    above, rows = timeline.to_levels[:, level], timeline.to_rows[:, level]
    ax.fill_between(timeline.time, 0.0, above, color=ROBOT, alpha=0.55, linewidth=0.0)
    ax.fill_between(timeline.time, above, above + rows, color=AVOIDING, linewidth=0.0)
    most = float(np.max(above + rows, initial=0.0))
    if most <= NOTICEABLE:
        ax.set(ylim=(0.0, 1.0), yticks=[])
        ax.text(0.5, 0.5, "no residual", transform=ax.transAxes, ha="center", va="center", fontsize=8.5, color=MUTED)
    else:
        ax.set_ylim(0.0, 1.15 * most)
    ax.yaxis.label.set(rotation=0, horizontalalignment="right", verticalalignment="center", fontsize=8.5)


def _draw_rows(ax: Axes, timeline: PriorityTimeline, rows: list[int]) -> None:
    dress(ax, x="time [s]")
    ax.set_yticks(range(len(rows)), [printable(timeline.rows[row]) for row in rows])
    ax.set_ylim(max(len(rows), 1) - 0.5, -0.5)
    for place, row in enumerate(rows):
        _bars(ax, timeline.time, timeline.missed[:, row] > NOTICEABLE, place, BAD, 0.45)
        _bars(ax, timeline.time, timeline.binding[:, row], place, INK, 1.0)
    left = len(timeline.rows) - len(rows)
    text = f"{left} more rows" if left else "" if rows else "no row binds or is violated"
    ax.text(0.99, 0.06, text, transform=ax.transAxes, ha="right", fontsize=8, color=MUTED)


def _bars(ax: Axes, time: NDArray[np.float64], on: NDArray[np.bool_], place: int, colour: str, alpha: float) -> None:
    bars = [(begin, max(end - begin, 1e-3)) for begin, end in spans(time, on)]
    ax.broken_barh(bars, (place - 0.32, 0.64), facecolors=colour, alpha=alpha, linewidth=0.0, zorder=2)
