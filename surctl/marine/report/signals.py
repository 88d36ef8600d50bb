"""Plots of a run over time: clearance, path errors, velocities, yaw rate, thrust and yaw moment."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from surctl.marine.report.plan_view import describe
from surctl.marine.simulation import Run
from surctl.marine.simulation.metrics import avoidance_intervals
from surctl.marine.simulation.record import path_depths
from surctl.marine.vehicle.linearise import command_range
from surctl.report.theme import AVOIDING, BAD, MUTED, curve, dress, head, legend_above, new_figure

__all__ = [
    "plot_clearance",
    "plot_force",
    "plot_moment",
    "plot_path_error",
    "plot_run_signals",
    "plot_velocity",
    "plot_yaw_rate",
    "spans",
]

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
        >>> from surctl.marine.report import plot_run_signals
        >>> from surctl.marine.simulation import load_scenario, simulate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> law, gains = build_law("closed_form"), load_gains("default")
        >>> run = simulate(load_scenario("pool-behind"), load_vehicle("sur400"), gains=gains, law=law)
        >>> [ax.get_ylabel() for ax in plot_run_signals(run).axes][:4]
        ['clearance [m]', 'path error [m]', 'velocity in {B} [m/s]', 'yaw rate [rad/s]']
    """
    if ax is None:
        figure = new_figure(9.5, 7.6)
        head(figure, describe(run))
        ax = figure.subplots(3, 2, sharex=True).ravel().tolist()
    plots = (plot_clearance, plot_path_error, plot_velocity, plot_yaw_rate, plot_force, plot_moment)
    for plot, target in zip(plots, ax, strict=True):
        plot(run, target)
    for target in ax[:-2]:
        target.set_xlabel("")  # the label of the bottom row is valid for the whole column
    return ax[0].figure.figure


def plot_clearance(run: Run, ax: Axes | None = None) -> Axes:
    """Plot the clearance from hull to nearest obstacle or wall [m]: the true value, and the value known to the law."""
    ax = _axes(run, ax, title="clearance", unit="m")
    time = run.record.time
    known = run.telemetry("nearest")[:, 0]
    curve(ax, time, np.where(known < _UNKNOWN, known, np.nan), label="known to the law", k=1, faint=True)
    curve(ax, time, run.record.clearance, label="true", k=0)
    ax.axhline(0.0, color=BAD, linewidth=1.4, label="contact")
    ax.axhline(run.gains["margin"], color=MUTED, linewidth=1.0, linestyle="--", label="stand-off")
    legend_above(ax)
    return ax


def plot_path_error(run: Run, ax: Axes | None = None) -> Axes:
    """Plot path errors [m]: distance in the plane, depth error, and the law's y_e by equation (8) of the paper."""
    ax = _axes(run, ax, title="path error", unit="m")
    record, scenario = run.record, run.scenario
    curve(ax, record.time, run.telemetry("path_error")[:, 1], label="y_e in the law", k=1, faint=True)
    curve(ax, record.time, scenario.follower().track(record.eta[:, :2]), label="distance to path", k=0)
    curve(ax, record.time, record.eta[:, 2] - path_depths(scenario, record.eta[:, :2]), label="z error", k=2)
    legend_above(ax)
    return ax


def plot_velocity(run: Run, ax: Axes | None = None) -> Axes:
    """Plot the ground velocity u, v, w in the body frame {B} and the horizontal speed [m/s], with the speed limit."""
    ax = _axes(run, ax, title="velocity in {B}", unit="m/s")
    nu = run.record.nu
    for k, name in enumerate("uvw"):
        curve(ax, run.record.time, nu[:, k], label=name, k=k)
    curve(ax, run.record.time, np.hypot(nu[:, 0], nu[:, 1]), label="√(u² + v²)", k=3)
    ax.axhline(run.scenario.cap, color=BAD, linewidth=1.0, linestyle="--", label="speed limit")
    legend_above(ax)
    return ax


def plot_yaw_rate(run: Run, ax: Axes | None = None) -> Axes:
    """Plot the yaw rate r [rad/s] of the robot, and the yaw rate that the law commands."""
    ax = _axes(run, ax, title="yaw rate", unit="rad/s")
    curve(ax, run.record.time, run.telemetry("nu_reference")[:, 3], label="r commanded", k=1, faint=True)
    curve(ax, run.record.time, run.record.nu[:, 3], label="r", k=0)
    legend_above(ax)
    return ax


def plot_force(run: Run, ax: Axes | None = None) -> Axes:
    """Plot the commanded forces F_u, F_v, F_w in the body frame {B} [N], with their limits."""
    ax = _axes(run, ax, title="force", unit="N")
    for k, name in reversed([*enumerate(("F_u", "F_v", "F_w"))]):  # surge on top
        curve(ax, run.record.time, run.record.tau[:, k], label=name, k=k, faint=True)
    _limits(ax, command_range(run.vehicle)[:, :3])
    legend_above(ax)
    return ax


def plot_moment(run: Run, ax: Axes | None = None) -> Axes:
    """Plot the commanded yaw moment F_r [N m], with its limit."""
    ax = _axes(run, ax, title="yaw moment", unit="N m")
    curve(ax, run.record.time, run.record.tau[:, 3], label="F_r", k=0, faint=True)
    _limits(ax, command_range(run.vehicle.at_speed(run.scenario.cruise))[:, 3:])
    legend_above(ax)
    return ax


def _limits(ax: Axes, limits: NDArray[np.float64]) -> None:
    for k, limit in enumerate(np.unique(limits)):
        ax.axhline(limit, color=BAD, linewidth=1.0, linestyle="--", label="" if k else "limit")


def _axes(run: Run, ax: Axes | None, *, title: str, unit: str) -> Axes:
    # shaded dark where the law avoids and light where it returns to the path
    if ax is None:
        ax = new_figure(6.0, 3.0).add_subplot()
    dress(ax, x="time [s]", y=f"{title} [{unit}]")
    time = run.record.time
    if time[-1] > 0:
        ax.set_xlim(0.0, float(time[-1]))
    avoiding = run.telemetry("avoiding")[:, 0]
    away = run.scenario.follower().track(run.record.eta[:, :2])
    returning = avoidance_intervals(avoiding, away) & (avoiding <= 0.5)
    for mask, strength in ((avoiding > 0.5, 0.20), (returning, 0.07)):
        for begin, end in spans(time, mask):
            ax.axvspan(begin, end, color=AVOIDING, alpha=strength, linewidth=0.0, zorder=0)
    return ax


def spans(time: NDArray[np.float64], mask: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Return (start, end) of each time interval in which `mask` is true; a sample is valid until the next sample."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(int)))
    ends = np.append(time, time[-1])
    return [(float(ends[a]), float(ends[b])) for a, b in zip(edges[::2], edges[1::2], strict=True)]
