"""Plots of a calibration of sonars."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from surctl.marine.sensing import SensorCalibration
from surctl.report.theme import AVOIDING, BAD, INK, MUTED, ROBOT, dress, head, legend_above, new_figure

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
