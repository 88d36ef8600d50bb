"""Plots of margins: Bode plots with marked margins, disk margins, gain-phase regions, and sensitivities S and T."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from surctl.marine.report.loops import LoopResponse
from surctl.marine.vehicle import Vehicle
from surctl.marine.verification import build_cascade
from surctl.marine.verification.linear import open_loop
from surctl.report.theme import AVOIDING, BAD, GOOD, INK, MUTED, ROBOT, curve, dress, legend_above, new_figure
from surctl.verification import LoopMargins
from surctl.verification.linear import DiskMargin, OpenLoop, Sensitivity, disk_profile, sensitivity_of

__all__ = ["plot_disk_margins", "plot_marked_bode", "plot_s_and_t", "sensitivities"]


def plot_marked_bode(loop: LoopResponse, margins: LoopMargins) -> Figure:
    """Plot gain and phase of one loop, with its gain, phase and delay margins marked."""
    figure = new_figure(5.6, 5.0)
    upper, lower = figure.subplots(2, 1, sharex=True)
    dress(upper, title=f"Loop {loop.name}, broken at the {loop.at}", y="gain |L| [dB]")
    dress(lower, x="frequency [rad/s]", y="phase of L [deg]")
    gain = 20 * np.log10(np.abs(loop.response))
    phase = np.rad2deg(np.unwrap(np.angle(loop.response)))
    phase = phase - 360 * np.ceil((phase[0] - 90) / 360)
    for ax, values in ((upper, gain), (lower, phase)):
        ax.semilogx(loop.omega, values, color=ROBOT, linewidth=1.6)
    upper.axhline(0.0, color=BAD, linewidth=0.9)
    upper.set_ylim(-50, 50)
    turn = _nearest_turn(loop, phase, margins)
    lower.axhline(turn, color=BAD, linewidth=0.9)
    lines = []
    if np.isfinite(margins.gain_margin):
        at = _crossing(loop.omega, phase - turn, np.abs(gain + 20 * np.log10(margins.gain_margin)))
        depth = -20 * float(np.log10(margins.gain_margin))
        _mark(upper, at, depth, 0.0, AVOIDING)
        lower.plot(at, turn, "o", color=AVOIDING, markersize=5)
        lines.append(f"gain margin {margins.gain_margin:.2f} ({-depth:.1f} dB)")
    if np.isfinite(margins.phase_margin_deg) and margins.crossover_rad_s > 0:
        at = _crossing(loop.omega, gain, np.abs(phase - turn - margins.phase_margin_deg))
        _mark(lower, at, float(np.interp(at, loop.omega, phase)), turn, GOOD)
        upper.plot(at, 0.0, "o", color=GOOD, markersize=5)
        lines.append(f"phase margin {margins.phase_margin_deg:.0f}°, delay margin {margins.delay_margin_s:.2f} s")
    upper.text(
        0.02, 0.05, "\n".join(lines), transform=upper.transAxes, fontsize=8.5, color=INK,
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85},
    )  # fmt: skip
    lowest = min(turn, float(phase.min()))
    lower.set_ylim(max(lowest - 40, turn - 220), max(float(phase.max()), turn) + 40)
    return figure


def _nearest_turn(loop: LoopResponse, phase: NDArray[np.float64], margins: LoopMargins) -> float:
    # −180° + k · 360°, nearest to the phase at which the gain crosses 1
    at = margins.crossover_rad_s or float(loop.omega[-1])
    here = float(np.interp(at, loop.omega, phase))
    return -180.0 + 360.0 * round((here + 180.0) / 360.0 - 1e-9)


def _crossing(omega: NDArray[np.float64], value: NDArray[np.float64], miss: NDArray[np.float64]) -> float:
    """Return the frequency at which `value` crosses zero; if there are several, the one with the least `miss`."""
    at = np.flatnonzero(np.diff(np.sign(value)))
    if not at.size:
        return float(omega[int(np.argmin(np.abs(value)))])
    best = int(at[np.argmin(miss[at])])
    share = value[best] / (value[best] - value[best + 1])
    return float(omega[best] * (omega[best + 1] / omega[best]) ** share)


def _mark(ax: Axes, at: float, begin: float, end: float, colour: str) -> None:
    arrow = {"arrowstyle": "<->", "color": colour, "linewidth": 1.6, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", (at, end), (at, begin), arrowprops=arrow)
    ax.axvline(at, color=MUTED, linestyle=":", linewidth=0.9)


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


def sensitivities(
    vehicle: Vehicle, gains: Mapping[str, float], *, cruise: Sequence[float], dt: float, places: Sequence[str]
) -> list[Sensitivity]:
    """Return sensitivities S and T of the loop opened at each of `places`, at each cruise speed with a stable loop.

    The names in `places` are those of `DISK_PLACES`. If there are several speeds, the attribute `place` of each result
    also contains the speed. `cruise` are the cruise speeds [m/s], `dt` is the control period [s].
    """
    curves: list[Sensitivity] = []
    for speed in cruise:
        cascade = build_cascade(vehicle, gains, cruise=speed, dt=dt)
        at = f" at {speed:g} m/s" if len(cruise) > 1 else ""
        shown = places if cascade.stable else ()
        curves += [sensitivity_of(open_loop(cascade, place), f"{place}{at}", highest=np.pi / dt) for place in shown]
    return curves


def plot_s_and_t(curves: Sequence[Sensitivity]) -> Figure:
    """Plot the largest singular values of sensitivities S and T over frequency, one curve for each opened loop."""
    columns = 2 if len(curves) <= 2 else 1  # loop openings at several speeds have long names
    figure = new_figure(9.6, 3.9 + 0.2 * len(curves))
    for ax, which, name in zip(figure.subplots(1, 2), ("S", "T"), ("sensitivity S", "complementary T"), strict=True):
        dress(ax, x="frequency [rad/s]", y=f"largest singular value of {name} [1]")
        for k, data in enumerate(curves):
            value = getattr(data, which)
            curve(ax, data.omega, value, label=f"{data.place}: peak {value.max():.2f}", k=k)
        ax.set_xscale("log")
        ax.set_yscale("log")
        legend_above(ax, columns=columns)
    return figure


def _rim(alpha: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # f = (2 + δ)/(2 − δ) on the upper half of the boundary |δ| = α
    delta = alpha * np.exp(1j * np.linspace(0, np.pi, 181))
    factor = (2 + delta) / (2 - delta)
    return np.abs(factor), np.abs(np.rad2deg(np.angle(factor)))
