"""Plots of a replayed sonar recording, with raw samples, filtered range with bound, and health of each sensor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from surctl.marine.sensing import Replay
from surctl.report.theme import BAD, GOOD, MUTED, ROBOT, dress, head, legend_above, new_figure

__all__ = ["plot_replay_sensor", "plot_sonar_replay"]

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
        >>> from surctl.marine.sensing import read_readings, replay_readings, sonar_array
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
    r"""Plot raw samples, filtered range with bound, and health of one sensor over time.

    Example:
        >>> from pathlib import Path
        >>> from surctl.marine.report import plot_replay_sensor
        >>> from surctl.marine.sensing import read_readings, replay_readings, sonar_array
        >>> rows = ["time_s,sensor,range_m", *(f"{0.1 * k:.1f},0,{2.0 - 0.01 * k:.2f}" for k in range(60))]
        >>> _ = Path("readings.csv").write_text("\n".join(rows))
        >>> replayed = replay_readings(read_readings(Path("readings.csv"), sonar_array(1)).readings)
        >>> ax = plot_replay_sensor(replayed, 0)
        >>> ax.get_ylabel(), [line.get_label() for line in ax.lines]
        ('sensor 0: range [m]', ['raw sample', 'filtered range'])
    """
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
