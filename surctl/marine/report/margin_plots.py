"""Plots of linear loops: the disk margins of all loops at once, and the root locus."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from surctl.marine.verification.linear_table import Locus
from surctl.report.theme import AVOIDING, BAD, INK, MUTED, curve, dress, legend_above, new_axes, new_figure, printable
from surctl.verification.linear import DiskMargin, OpenLoop, disk_profile


def plot_disk_margins(loops: Sequence[tuple[OpenLoop, DiskMargin]], *, highest: float) -> Figure:
    """Plot the disk margin α over frequency, and the gain and phase changes that all loops tolerate at once.

    Args:
        loops: each opened loop with its disk margin; unstable loops are left out.
        highest: largest frequency in the plot [rad/s].
    """
    figure = new_figure(9.6, 4.3)
    left, right = figure.subplots(1, 2)
    dress(left, x="frequency [rad/s]", y="disk margin α at that frequency [1]")
    dress(right, x="factor on all gains [1]", y="phase on all loops, either sign [deg]")
    omega = np.geomspace(1e-2, highest, 300)
    for k, (loop, margin) in enumerate((a, b) for a, b in loops if b.stable):
        judged = np.isfinite(margin.guaranteed)
        label = f"{margin.place}: " + (f"{margin.guaranteed:.2f}" if judged else "not determined")
        curve(left, omega, np.minimum(disk_profile(loop, omega), 2.0), label=label, k=k)
        left.plot(margin.frequency_rad_s, margin.reached, "o", color=INK, markersize=5, zorder=5)
        curve(right, *_rim(margin.guaranteed), label=label, k=k)
    left.set_xscale("log")
    left.set_ylim(0.0, 2.1)
    left.set_xlim(omega[0], omega[-1])
    right.set_xscale("log")
    ticks = [0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0]
    right.set_xticks(ticks, [f"{t:g}" for t in ticks], minor=False)
    right.set_xticks([], minor=True)
    right.set_ylim(bottom=0.0)
    right.plot(1.0, 0.0, "+", color=INK, markersize=10, clip_on=False)
    legend_above(left, columns=3)
    right.set_title("below a line: tolerated by all loops at once", loc="left", fontsize=9, color=INK)
    return figure


def _rim(alpha: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # f = (2 + δ)/(2 − δ) on the upper half of the boundary |δ| = α
    delta = alpha * np.exp(1j * np.linspace(0, np.pi, 181))
    factor = (2 + delta) / (2 - delta)
    return np.abs(factor), np.abs(np.rad2deg(np.angle(factor)))


_DAMPING = (0.2, 0.4, 0.6, 0.8)
_ASYMPTOTE_GAP = 3.0
_ARC = np.linspace(np.pi / 2, 3 * np.pi / 2, 121)


def plot_locus(data: Locus, ax: Axes | None = None, *, unit: str = "", picked: float | None = None) -> Axes:
    """Plot the closed-loop poles over the swept parameter, in the upper and lower half-plane.

    The fast poles caused by the delay are not shown: those beyond the highest gap of a factor of 3 between the sizes of
    all poles.

    Args:
        data: closed-loop poles over the swept parameter.
        ax: axes to draw in.
        unit: unit of the swept parameter.
        picked: parameter value whose poles are marked; the nearest computed value is used.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.report import plot_locus
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification import sweep_locus
        >>> gains = load_gains("default").values
        >>> locus = sweep_locus(load_vehicle("sur400"), gains, "k_psi", [0.2, 0.4, 0.8, 1.6, 3.2], cruise=0.15, dt=0.05)
        >>> ax = plot_locus(locus, unit="1/s", picked=0.8)
        >>> ax.get_xlabel(), ax.get_ylabel(), [line.get_label() for line in ax.lines][-3:]
        ('real part [1/s]', 'imaginary part [rad/s]', ['start: 0.2', 'picked: 0.8', 'stability boundary'])
    """
    ax = dress(ax or new_axes(6.4, 4.9), x="real part [1/s]", y="imaginary part [rad/s]")
    edge = 1.15 * _below_the_gap(np.sort(np.abs(data.poles).max(axis=0)))
    _grid(ax, edge)
    colours = np.repeat(data.values, data.poles.shape[1])
    points = ax.scatter(data.poles.real.ravel(), data.poles.imag.ravel(), s=5, c=colours, cmap="viridis")
    _pole_mark(ax, data.poles[0], "o", INK, f"start: {data.values[0]:.3g}")
    if picked is not None:
        at = int(np.argmin(np.abs(data.values - picked)))
        _pole_mark(ax, data.poles[at], "D", AVOIDING, f"picked: {data.values[at]:.3g}")
    ax.axvline(0.0, color=BAD, linewidth=1.2, label="stability boundary")
    ax.set_xlim(-edge, max(0.12 * edge, min(edge, 1.1 * float(data.poles.real.max()))))
    ax.set_ylim(-edge, edge)
    bar = ax.figure.colorbar(points, ax=ax)
    bar.set_label(
        printable(f"{data.parameter} [{unit}]" if unit else data.parameter), fontsize=9.5, color=INK, parse_math=False
    )
    bar.ax.tick_params(labelsize=8.5)
    legend_above(ax, columns=3)
    return ax


def _below_the_gap(sizes: NDArray[np.float64]) -> float:
    """Return the largest |pole| below the highest gap with a third of all poles below it; without gap, the largest."""
    gaps = 1 + np.flatnonzero(sizes[1:] > _ASYMPTOTE_GAP * sizes[:-1])
    gaps = gaps[gaps >= max(2, len(sizes) / 3)]
    return float(sizes[gaps[-1] - 1] if gaps.size else sizes[-1])


def _pole_mark(ax: Axes, poles: NDArray[np.complex128], marker: str, colour: str, label: str) -> None:
    ax.plot(poles.real, poles.imag, marker, color=colour, markersize=5, fillstyle="none", label=label, zorder=4)


def _grid(ax: Axes, edge: float) -> None:
    # rays of equal damping, circles of equal natural frequency
    ax.grid(visible=False)
    for damping in _DAMPING:
        slope = np.sqrt(1 - damping**2) / damping
        at = edge / max(1.0, slope)
        for sign in (1, -1):
            ax.plot([0, -edge], [0, sign * slope * edge], color=MUTED, linestyle=":", linewidth=0.8)
        ax.annotate(f"ζ {damping:g}", (-at * 0.93, slope * at * 0.93), fontsize=8, color=INK, ha="center")
    for natural in [t for t in ax.yaxis.get_major_locator().tick_values(0, edge) if 0 < t < edge]:
        ax.plot(natural * np.cos(_ARC), natural * np.sin(_ARC), color=MUTED, linestyle=":", linewidth=0.8)
        ax.annotate(f"{natural:g}", (-natural, 0), fontsize=8, color=INK, ha="center", va="bottom")
