"""Plot of the disk margins of all loops at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from surctl.report.theme import INK, curve, dress, legend_above, new_figure
from surctl.verification.linear import DiskMargin, OpenLoop, disk_profile


def plot_disk_margins(loops: Sequence[tuple[OpenLoop, DiskMargin]], *, highest: float) -> Figure:
    """Plot the disk margin α over frequency, and the gain and phase changes that all loops tolerate at once.

    Args:
        loops: each opened loop with its disk margin; unstable loops are left out.
        highest: largest frequency in the plot [rad/s].
    """
    figure = new_figure(9.6, 4.3)
    left, right = figure.subplots(1, 2)
    dress(left, title="Disk margin over frequency", x="frequency [rad/s]", y="disk margin α at that frequency [1]")
    dress(
        right,
        title="Below a line: tolerated by all loops at once",
        x="factor on all gains [1]",
        y="phase on all loops, either sign [deg]",
    )
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
    return figure


def _rim(alpha: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # f = (2 + δ)/(2 − δ) on the upper half of the boundary |δ| = α
    delta = alpha * np.exp(1j * np.linspace(0, np.pi, 181))
    factor = (2 + delta) / (2 - delta)
    return np.abs(factor), np.abs(np.rad2deg(np.angle(factor)))
