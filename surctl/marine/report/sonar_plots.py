"""Plots of sonars: measurements of a run, a replayed recording, and a calibration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from surctl.marine.sensing import Replay, SensorCalibration
from surctl.report.theme import AVOIDING, BAD, GOOD, INK, MUTED, ROBOT, dress, head, legend_above, new_figure

_DOTS = 4000  # largest number of measurements drawn besides the outliers, because more dots would merge
_NORMAL = 1.96


def plot_calibration(one: SensorCalibration, ax: Sequence[Axes] | None = None) -> Figure:
    """Plot the errors and the studentised residuals of a calibration over the true distance.

    Args:
        one: the calibration of one sensor in one medium.
        ax: two axes, for errors and residuals; None creates new axes.

    Returns:
        The figure that holds the axes.

    Example:
        >>> from surctl.marine.report import plot_calibration
        >>> from surctl.marine.sensing import calibrate_table_ii
        >>> air, water = calibrate_table_ii()
        >>> [ax.get_ylabel() for ax in plot_calibration(water).axes]
        ['measured − true [mm]', 'studentised residual [1]']
    """
    if ax is None:
        figure = new_figure(8.0, 6.4)
        title = f"Calibration, {one.title}: {len(one.calibration.true)} rows"
        head(figure, title)
        ax = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2)).ravel().tolist()
    plot_errors(one, ax[0]).set_xlabel("")
    plot_studentised(one, ax[1])
    return ax[0].figure.figure


def plot_errors(one: SensorCalibration, ax: Axes | None = None) -> Axes:
    """Plot measured − true [mm] over the true distance [m], with the fitted line and the band of 95 % of the noise."""
    fit = one.calibration
    ax = _axes(ax, y="measured − true [mm]")
    ax.axhline(0.0, color=MUTED, linewidth=0.9)
    at = np.linspace(fit.true[0], fit.true[-1], 200)
    line = (fit.scale.value - 1.0) * at + fit.bias.value
    sd = fit.noise_sd.value * np.interp(at, fit.true, fit.relative_sd)
    ax.fill_between(
        at, 1e3 * (line - _NORMAL * sd), 1e3 * (line + _NORMAL * sd), color=ROBOT, alpha=0.12, linewidth=0.0,
        label="line ± 1.96 sd",
    )  # fmt: skip
    shown = _share(fit.true, fit.outliers)
    ax.plot(fit.true[shown], 1e3 * fit.errors[shown], "o", color=ROBOT, label="row", markersize=_size(shown))
    ax.plot(at, 1e3 * line, color=INK, linewidth=1.5, label="fitted line", zorder=3)
    if len(fit.outliers):
        ax.plot(
            fit.true[fit.outliers], 1e3 * fit.errors[fit.outliers], "s", color=AVOIDING, markersize=8,
            fillstyle="none", label="outlier, not in the fit",
        )  # fmt: skip
    legend_above(ax)
    return ax


def plot_studentised(one: SensorCalibration, ax: Axes | None = None) -> Axes:
    """Plot each residual, divided by its standard deviation, over the true distance [m], with the outlier bound."""
    fit = one.calibration
    ax = _axes(ax, y="studentised residual [1]")
    bound = fit.outlier_bound
    values = np.clip(fit.studentised, -3.0 * bound, 3.0 * bound)
    shown = _share(fit.true, fit.outliers)
    ax.axhline(0.0, color=MUTED, linewidth=0.9)
    for sign in (1, -1):
        ax.axhline(sign * bound, color=BAD, linewidth=1.0, linestyle="--", label="outlier bound" if sign > 0 else "")
    ax.plot(fit.true[shown], values[shown], "o", color=ROBOT, markersize=_size(shown))
    if len(fit.outliers):
        beyond = np.abs(fit.studentised[fit.outliers]) > 3.0 * bound
        label = "outlier, not in the fit (clipped to the axis)" if beyond.any() else "outlier, not in the fit"
        ax.plot(
            fit.true[fit.outliers], values[fit.outliers], "s", color=AVOIDING, markersize=8, fillstyle="none",
            label=label,
        )  # fmt: skip
    legend_above(ax)
    return ax


def _share(true: NDArray[np.float64], outliers: NDArray[np.intp]) -> NDArray[np.intp]:
    even = np.linspace(0, len(true) - 1, min(len(true), _DOTS)).astype(np.intp)
    return np.union1d(even, outliers)


def _size(shown: NDArray[np.intp]) -> float:
    return 4.0 if len(shown) <= 400 else 1.5


def _axes(ax: Axes | None, *, y: str) -> Axes:
    return dress(ax or new_figure(7.0, 3.2).add_subplot(), x="true distance [m]", y=y)


_POINTS = 20_000  # largest number of steps and samples drawn
_FAINT_BAD = "#F3C6C1"
_STRIP = 0.04  # height of a strip as a share of the panel's height


def plot_sonar_replay(replayed: Replay, ax: Sequence[Axes] | None = None, *, title: str = "") -> Figure:
    r"""Plot the replayed recording, with one panel for each sensor that sent data.

    Args:
        replayed: the replay.
        ax: one axes for each sensor that sent data; None creates new axes.
        title: title above the panels.

    Returns:
        The figure that holds the axes.

    Example:
        >>> from pathlib import Path
        >>> from surctl.marine.report import plot_sonar_replay
        >>> from surctl.marine.sensing import sonar_array
        >>> from surctl.marine.sensing.replay import read_readings, replay_readings
        >>> rows = ["time_s,sensor,range_m", *(f"{0.1 * k:.1f},0,{2.0 - 0.01 * k:.2f}" for k in range(60))]
        >>> _ = Path("readings.csv").write_text("\n".join(rows))
        >>> replayed = replay_readings(read_readings(Path("readings.csv"), sonar_array(1)).readings)
        >>> figure = plot_sonar_replay(replayed, title="in the tank")
        >>> len(figure.axes), figure.axes[0].get_ylabel()
        (1, 'sensor 0: range [m]')
    """
    sensors = replayed.sensors
    if ax is None:
        figure = new_figure(9.5, 1.0 + 2.5 * len(sensors))
        head(figure, title)
        ax = figure.subplots(len(sensors), 1, sharex=True, squeeze=False).ravel().tolist()
    for k, (sensor, one) in enumerate(zip(sensors, ax, strict=True)):
        plot_replay_sensor(replayed, sensor, one)
        if k == 0:
            legend_above(one)
        if k < len(sensors) - 1:
            one.set_xlabel("")
    return ax[0].figure.figure


def plot_replay_sensor(replayed: Replay, sensor: int, ax: Axes | None = None) -> Axes:
    r"""Plot raw samples, filtered range with bound, and health of one sensor over time."""
    r, t = replayed.readings, replayed.tracked
    ax = dress(ax or new_figure(9.0, 3.0).add_subplot(), x="time [s]", y=f"sensor {sensor}: range [m]")
    steps = np.linspace(0, len(r.time) - 1, min(len(r.time), _POINTS)).astype(np.intp)
    ends = r.first[1:]
    cuts = np.searchsorted(steps, ends)  # interrupt the line where the recording has a gap
    time = np.insert(r.time[steps], cuts, r.time[np.minimum(ends, len(r.time) - 1)])
    value, bound = (np.insert(v[steps, sensor], cuts, np.nan) for v in (t.range, t.bound))
    ax.fill_between(time, value - bound, value + bound, color=ROBOT, alpha=0.18, linewidth=0.0, label="promised bound")
    fired = np.flatnonzero(r.fresh[:, sensor])
    fired = fired[np.linspace(0, len(fired) - 1, min(len(fired), _POINTS // r.samples.shape[2] + 1)).astype(np.intp)]
    raw = r.samples[fired, sensor]
    at = np.repeat(r.time[fired], raw.shape[1])
    few = len(at) < 2000
    ax.plot(
        at, raw.ravel(), "o", color=MUTED, markersize=2.5 if few else 1.2, markeredgewidth=0.0,
        alpha=0.8 if few else 0.5, label="raw sample",
    )  # fmt: skip
    ax.plot(time, value, color=ROBOT, linewidth=1.3, label="filtered range")
    ax.set_ylim(-0.07 * r.array.maximum, 1.04 * r.array.maximum)
    healthy = t.healthy[steps, sensor]
    _strip(ax, r.time[steps], healthy, colour=GOOD, hatch=None, label="healthy")
    _strip(ax, r.time[steps], ~healthy, colour=BAD, hatch="////", label="not healthy")
    if r.time[-1] > r.time[0]:
        ax.set_xlim(float(r.time[0]), float(r.time[-1]))
    return ax


def _strip(
    ax: Axes, time: NDArray[np.float64], where: NDArray[np.bool_], *, colour: str, hatch: str | None, label: str
) -> None:
    # hatching distinguishes the two strips without colour
    ax.fill_between(
        time, 0.0, _STRIP, where=where.tolist(), step="post", transform=ax.get_xaxis_transform(), label=label,
        facecolor=colour if hatch is None else _FAINT_BAD, edgecolor=colour, hatch=hatch, linewidth=0.0, zorder=3,
    )  # fmt: skip
