"""Plots of a run over time: its signals with their limits, and the timeline of the priorities (`--explain`)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from surctl.marine.report.plan_view import describe
from surctl.marine.simulation import Run
from surctl.marine.simulation.metrics import avoidance_intervals
from surctl.marine.simulation.run import path_depths
from surctl.marine.vehicle.linearise import command_range
from surctl.priority import PriorityTimeline
from surctl.priority.solving import NOTICEABLE
from surctl.report.theme import (
    AVOIDING,
    BAD,
    INK,
    MUTED,
    ROBOT,
    curve,
    dress,
    head,
    legend_above,
    new_figure,
    number,
    printable,
)

_UNKNOWN = 50.0  # [m] a larger nearest distance in the telemetry means that the law knows no contact


def plot_run_signals(run: Run, ax: Sequence[Axes] | None = None) -> Figure:
    """Plot six signals of a run over time.

    Args:
        run: the run.
        ax: six axes, in the order clearance, path error, velocity, yaw rate, force, moment; None creates new axes.

    Returns:
        The figure that holds the axes.

    Example:
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.report.signals import plot_run_signals
        >>> from surctl.marine.simulation import load_scenario, simulate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> law, gains = build_law("closed_form"), load_gains("default")
        >>> run = simulate(load_scenario("pool-behind"), load_vehicle("sur400"), gains=gains, law=law)
        >>> [ax.get_ylabel() for ax in plot_run_signals(run).axes][:4]
        ['clearance [m]', 'path error at each time [m]', 'velocity in {B} [m/s]', 'yaw rate [rad/s]']
    """
    if ax is None:
        figure = new_figure(9.5, 7.6)
        head(figure, describe(run))
        figure.set_layout_engine("none")  # its axes are always these: measuring their texts takes longer than drawing
        ends = {"left": 0.08, "right": 0.985, "bottom": 0.065, "top": 0.92, "wspace": 0.21, "hspace": 0.21}
        ax = figure.subplots(3, 2, sharex=True, gridspec_kw=ends).ravel().tolist()
    away = run.scenario.follower().track(run.record.eta[:, :2])
    for (title, unit, curves, bounds), target in zip(_signals(run, away), ax, strict=True):
        _axes(run, away, target, title=title, unit=unit)
        for label, values, k, faint in curves:
            curve(target, run.record.time, values, label=label, k=k, faint=faint)
        for label, level, dashed in bounds:
            colour, width = (MUTED if label == "stand-off" else BAD), 1.0 if dashed else 1.4
            target.axhline(level, color=colour, linewidth=width, linestyle="--" if dashed else "-", label=label)
        legend_above(target)
    for target in ax[:-2]:
        target.set_xlabel("")  # the label of the bottom row is valid for the whole column
    return ax[0].figure.figure


Signal = tuple[str, str, list[tuple[str, NDArray[np.float64], int, bool]], list[tuple[str, float, bool]]]


def run_signals(run: Run) -> list[Signal]:
    """Return title and unit of six plots, their curves (label, values, number, whether faint) and bounds.

    The curves are: clearance from hull to nearest obstacle or wall [m], true and known to the law; path errors [m], in
    the plane, in depth, and the law's y_e by equation (8) of the paper; ground velocity u, v, w in the body frame {B}
    and horizontal speed [m/s]; yaw rate r [rad/s], of the robot and commanded; commanded forces in {B} [N]; commanded
    yaw moment [N m]. A bound is (label, level, whether dashed).
    """
    return _signals(run, run.scenario.follower().track(run.record.eta[:, :2]))


def _signals(run: Run, away: NDArray[np.float64]) -> list[Signal]:
    record, scenario, known = run.record, run.scenario, run.telemetry("nearest")[:, 0]
    depth = path_depths(scenario, record.eta[:, :2])
    error, rate = run.telemetry("path_error")[:, 1], run.telemetry("nu_reference")[:, 3]
    nu, forces = record.nu, [*enumerate(("F_u", "F_v", "F_w"))]
    standoff = [("contact", 0.0, False), ("stand-off", run.gains["margin"], True)]
    return [
        ("clearance", "m", [("known to the law", np.where(known < _UNKNOWN, known, np.nan), 1, True),
                            ("true", record.clearance, 0, False)], standoff),
        ("path error at each time", "m", [("y_e in the law", error, 1, True), ("distance to path", away, 0, False),
                             ("z error", record.eta[:, 2] - depth, 2, False)], []),
        ("velocity in {B}", "m/s", [*((name, nu[:, k], k, False) for k, name in enumerate("uvw")),
                                    ("√(u² + v²)", np.hypot(nu[:, 0], nu[:, 1]), 3, False)],
         [("speed limit", scenario.cap, True)]),
        ("yaw rate", "rad/s", [("r commanded", rate, 1, True), ("r", nu[:, 3], 0, False)], []),
        ("force", "N", [(name, record.tau[:, k], k, True) for k, name in reversed(forces)],  # surge on top
         _limits(command_range(run.vehicle)[:, :3])),
        ("yaw moment", "N m", [("F_r", record.tau[:, 3], 0, True)],
         _limits(command_range(run.vehicle.at_speed(scenario.cruise))[:, 3:])),
    ]  # fmt: skip


def _limits(limits: NDArray[np.float64]) -> list[tuple[str, float, bool]]:
    return [("" if k else "limit", level, True) for k, level in enumerate(np.unique(limits).tolist())]


def _axes(run: Run, away: NDArray[np.float64], ax: Axes, *, title: str, unit: str) -> None:
    # shaded dark where the law avoids and light where it returns to the path
    dress(ax, x="time [s]", y=f"{title} [{unit}]")
    time = run.record.time
    if time[-1] > 0:
        ax.set_xlim(0.0, float(time[-1]))
    avoiding = run.telemetry("avoiding")[:, 0]
    returning = avoidance_intervals(avoiding, away) & (avoiding <= 0.5)
    for mask, strength in ((avoiding > 0.5, 0.20), (returning, 0.07)):
        for begin, end in spans(time, mask):
            ax.axvspan(begin, end, color=AVOIDING, alpha=strength, linewidth=0.0, zorder=0)


def spans(time: NDArray[np.float64], mask: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Return (start, end) of each time interval in which `mask` is true; a sample is valid until the next sample."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(int)))
    ends = np.append(time, time[-1])
    return [(float(ends[a]), float(ends[b])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


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
    bars = [(begin, end - begin) for begin, end in spans(time, on)]  # the edge shows also a bar of one control period
    ax.broken_barh(bars, (place - 0.32, 0.64), color=colour, alpha=alpha, linewidth=1.5, zorder=2)
