"""Pictures of this study: filtered range with readings, errors of the filters, prediction errors of the LMS steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from surctl.report.theme import BAD, CYCLE, INK, MUTED, ROBOT, curve, dress, legend_above, new_axes, printable


@dataclass(frozen=True, eq=False, kw_only=True)
class RangeTrace:
    """Readings and filtered range of one sensor over a run.

    Attributes:
        title: title of the plot.
        time: (k,) times [s].
        range: (k,) filtered range [m].
        bound: (k,) bound on the error of the filtered range [m].
        healthy: (k,) 1 if the filter considers the sensor healthy, otherwise 0.
        reading_time: (m,) times of the received readings [s].
        reading: (m,) ranges that the filter uses from these readings [m].
        truth: (k,) true range [m]; None if it is not known.
    """

    title: str
    time: NDArray[np.float64]
    range: NDArray[np.float64]
    bound: NDArray[np.float64]
    healthy: NDArray[np.float64]
    reading_time: NDArray[np.float64]
    reading: NDArray[np.float64]
    truth: NDArray[np.float64] | None = None


@dataclass(frozen=True, kw_only=True)
class FilterErrors:
    """Rms range errors [m] of several filters, for a robot at rest and approaching, and the largest allowed errors."""

    names: tuple[str, ...]
    still: tuple[float, ...]
    closing: tuple[float, ...]
    still_limit: float
    closing_limit: float


@dataclass(frozen=True, eq=False, kw_only=True)
class LmsTrace:
    """Prediction errors |ℜ| [m] at k sonar firings, arrays (k,) by name of the LMS step rule."""

    title: str
    errors: dict[str, NDArray[np.float64]]


def plot_range_trace(trace: RangeTrace, ax: Axes | None = None) -> Axes:
    """Plot filtered range with its bound, readings, and true range; a bar marks when the sensor is not healthy.

    Args:
        trace: readings and filtered range of the sensor.
        ax: axes to draw in.
    """
    ax = dress(ax or new_axes(8.4, 3.4), title=trace.title, x="time [s]", y="range [m]")
    low, high = trace.range - trace.bound, trace.range + trace.bound
    ax.fill_between(trace.time, low, high, color=ROBOT, alpha=0.18, linewidth=0, label="promised")
    ax.plot(trace.reading_time, trace.reading, ".", color=MUTED, markersize=2.5, label="readings")
    if trace.truth is not None:
        ax.plot(trace.time, trace.truth, color=INK, linewidth=1.1, linestyle="--", label="true")
    believed = np.where(trace.healthy > 0.5, trace.range, np.nan)
    ax.plot(trace.time, believed, color=ROBOT, linewidth=1.5, label="filtered, healthy")
    ill = trace.healthy < 0.5
    if ill.any():
        transform = ax.get_xaxis_transform()
        ax.fill_between(
            trace.time, 0.0, 0.035, where=ill.tolist(), step="post", color=BAD, linewidth=0, transform=transform
        )
        ax.plot([], [], color=BAD, linewidth=5, label="not healthy")
    if len(trace.time):
        ax.set_xlim(float(trace.time[0]), float(trace.time[-1]))
    ax.set_ylim(bottom=0.0)
    legend_above(ax, columns=5)
    return ax


def plot_filter_errors(data: FilterErrors, ax: Axes | None = None) -> Axes:
    """Plot rms range errors as bars, at rest and approaching, with limits as lines; too long bars are cut and labelled.

    Args:
        data: the errors.
        ax: axes to draw in.
    """
    ax = dress(ax or new_axes(7.6, 3.6), title="Total ranging error", y="rms error [cm]")
    ax.grid(visible=False, axis="x")
    top = 100.0 * 1.6 * max(data.still_limit, data.closing_limit)
    at = np.arange(len(data.names))
    series = (("still", data.still, data.still_limit, 0), ("closing", data.closing, data.closing_limit, 1))
    for label, values, limit, k in series:
        shown = 100.0 * np.array(values)
        place = at + (k - 0.5) * 0.38
        ax.bar(place, np.minimum(shown, top), 0.34, color=CYCLE[k], label=label)
        ax.axhline(100.0 * limit, color=CYCLE[k], linestyle=":", linewidth=1.3, label=f"{label}: allowed")
        for x, value in zip(place, shown, strict=True):
            ax.text(x, min(value, top) + 0.01 * top, f"{value:.2g}", ha="center", va="bottom", fontsize=8, color=INK)
    ax.set_ylim(0.0, 1.1 * top)
    ax.set_xticks(at, [printable(name) for name in data.names], fontsize=8.5)
    legend_above(ax, columns=4)
    return ax


def plot_lms_trace(data: LmsTrace, ax: Axes | None = None) -> Axes:
    """Plot the prediction errors of the LMS step rules on a logarithmic scale.

    Args:
        data: the errors.
        ax: axes to draw in.
    """
    ax = dress(ax or new_axes(7.6, 3.2), title=data.title, x="firing", y="prediction error [m]")
    for k, (name, values) in enumerate(data.errors.items()):
        curve(ax, np.arange(len(values), dtype=float), np.maximum(values, 1e-16), label=name, k=k)
    ax.set_yscale("log")
    legend_above(ax, columns=max(1, len(data.errors)))
    return ax
