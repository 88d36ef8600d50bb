"""Plots of linear loops: Bode, Nyquist and steps, margins over speed, and the root locus."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray

from surctl.marine.vehicle import Vehicle
from surctl.marine.vehicle.specs import AXES
from surctl.marine.verification import Locus, cruise_loop
from surctl.marine.verification.cruise_loop import TRACKING_LAW
from surctl.marine.verification.linear import open_loop
from surctl.report.theme import (
    AVOIDING,
    BAD,
    CYCLE,
    GOOD,
    INK,
    MUTED,
    ROBOT,
    curve,
    dress,
    legend_above,
    new_axes,
    new_figure,
    printable,
)
from surctl.verification import LoopMargins
from surctl.verification.linear import DiskMargin, OpenLoop, Sensitivity, disk_profile, sensitivity_of

__all__ = [
    "LoopResponse",
    "loop_responses",
    "plot_bode",
    "plot_disk_margins",
    "plot_locus",
    "plot_marked_bode",
    "plot_nyquist",
    "plot_poles",
    "plot_s_and_t",
    "sensitivities",
]

_MEASURED = ("along_track", "cross_track", "depth", "heading")
_SLOWEST = 1e-2  # [rad/s]
_POINTS = 400
_DELAY_GAP = 6.0  # ratio of two neighbouring pole sizes that separates the dynamics from the delay


@dataclass(frozen=True, eq=False)
class LoopResponse:
    """Frequency response of one loop that is opened at one signal while all other loops stay closed.

    Attributes:
        name: name of the loop, as in `LoopMargins`.
        at: signal at which the loop is opened: `thrust` or `measurement`.
        omega: (k,) frequencies [rad/s], up to the Nyquist frequency of the sampled controller.
        response: (k,) complex loop gain L(jω); the sensitivity is 1/(1 + L).
    """

    name: str
    at: str
    omega: NDArray[np.float64]
    response: NDArray[np.complex128]


def loop_responses(
    vehicle: Vehicle, gains: Mapping[str, float], *, cruise: float, dt: float, law: str = TRACKING_LAW
) -> tuple[LoopResponse, ...]:
    """Return the frequency responses of the eight loops of `loop_margins`, in the order of `loop_margins`.

    Args:
        vehicle: the vehicle.
        gains: gain values by name.
        cruise: cruise speed U [m/s].
        dt: control period [s].
        law: the law that tracks, as in `loop_margins`.

    Raises:
        InputError: a gain is missing or not positive, or the vehicle cannot cruise at that speed.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.report import loop_responses
        >>> from surctl.marine.vehicle import load_vehicle
        >>> gains = load_gains("default").values
        >>> loops = loop_responses(load_vehicle("sur400"), gains, cruise=0.15, dt=0.05)
        >>> [(loop.name, loop.at) for loop in loops][::4]
        [('surge', 'thrust'), ('along_track', 'measurement')]
        >>> omega = loops[0].omega  # up to the Nyquist frequency
        >>> omega.shape, omega[[0, -1]].round(2).tolist()
        ((400,), [0.01, 62.83])
    """
    loop = cruise_loop(vehicle, gains, cruise=cruise, dt=dt, law=law)
    omega = np.geomspace(_SLOWEST, np.pi / dt, _POINTS)
    broken = [(name, "thrust", loop.at_thrust(k)) for k, name in enumerate(AXES[:4])]
    broken += [(name, "measurement", loop.at_output(k)) for k, name in enumerate(_MEASURED)]
    z = np.exp(1j * dt * omega)
    return tuple(LoopResponse(name, at, omega, _frequency_response(*each, z)) for name, at, each in broken)


def _frequency_response(
    A: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64], z: NDArray[np.complex128]
) -> NDArray[np.complex128]:
    # c (z − A)⁻¹ b, (k,)
    pencils = z[:, None, None] * np.eye(len(A)) - A
    response: NDArray[np.complex128] = (c @ np.linalg.solve(pencils, np.broadcast_to(b, (len(z), *b.shape))))[:, 0, 0]
    return response


def plot_bode(loops: Sequence[LoopResponse], ax: tuple[Axes, Axes] | None = None) -> Figure:
    """Plot gain [dB] and phase [deg] of loops over frequency; dots mark where a gain crosses 1.

    `ax` holds the axes of gain and phase; None creates new axes.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.report import loop_responses, plot_bode
        >>> from surctl.marine.vehicle import load_vehicle
        >>> gains = load_gains("default").values
        >>> loops = loop_responses(load_vehicle("sur400"), gains, cruise=0.15, dt=0.05)
        >>> gain, phase = plot_bode(loops).axes[:2]
        >>> gain.get_ylabel(), phase.get_ylabel(), phase.get_xlabel()
        ('gain |L| [dB]', 'phase of L [deg]', 'frequency [rad/s]')
    """
    if ax is None:
        ax = new_figure(5.1, 4.5).subplots(2, 1, sharex=True)
    upper, lower = ax
    dress(upper, y="gain |L| [dB]")
    dress(lower, x="frequency [rad/s]", y="phase of L [deg]")
    for k, loop in enumerate(loops):
        gain, phase = 20 * np.log10(np.abs(loop.response)), _phase(loop.response)
        curve(upper, loop.omega, gain, label=loop.name, k=k)
        curve(lower, loop.omega, phase, label=loop.name, k=k)
        crossing = np.flatnonzero(np.diff(np.sign(gain)))
        for axes, values in ((upper, gain), (lower, phase)):
            axes.plot(loop.omega[crossing], values[crossing], "o", color=CYCLE[k % len(CYCLE)], markersize=5)
    upper.set_xscale("log")
    lower.set_xscale("log")
    upper.axhline(0.0, color=BAD, linewidth=1.0)
    upper.set_ylim(-60, 60)
    lower.axhline(-180.0, color=BAD, linewidth=1.0)
    lower.set_yticks(np.arange(-360, 91, 90))
    lower.set_ylim(-380, 60)
    legend_above(upper, columns=4)
    figure: Figure = upper.figure.figure
    return figure


def _phase(response: NDArray[np.complex128]) -> NDArray[np.float64]:
    # unwrapped [deg], starting in (−270, 90]
    phase = np.rad2deg(np.unwrap(np.angle(response)))
    return np.asarray(phase - 360 * np.ceil((phase[0] - 90) / 360), dtype=float)


def plot_nyquist(loops: Sequence[LoopResponse], ax: Axes | None = None, *, disk_margin: float | None = None) -> Axes:
    """Plot the loop gains L(jω) for ω > 0 around the critical point −1, with the unit circle.

    Args:
        loops: frequency responses of the loops.
        ax: axes to draw in.
        disk_margin: balanced disk margin α; the plot shades the disk that L(jω) must avoid (Seiler, Packard and Gahinet
            2020).

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.report import loop_responses, plot_nyquist
        >>> from surctl.marine.vehicle import load_vehicle
        >>> gains = load_gains("default").values
        >>> loops = loop_responses(load_vehicle("sur400"), gains, cruise=0.15, dt=0.05)
        >>> ax = plot_nyquist(loops[:4], disk_margin=0.6)
        >>> ax.get_xlabel(), ax.get_ylabel(), [text.get_text() for text in ax.get_legend().get_texts()]
        ('real part of L', 'imaginary part of L', ['disk margin 0.60', 'surge', 'sway', 'heave', 'yaw'])
    """
    ax = dress(ax or new_figure(5.1, 4.5).add_subplot(), x="real part of L", y="imaginary part of L")
    ax.add_patch(Circle((0, 0), 1, fill=False, edgecolor=MUTED, linestyle=":", linewidth=1.0))
    if disk_margin is not None and 0 < disk_margin < 2:
        left, right = -(2 + disk_margin) / (2 - disk_margin), -(2 - disk_margin) / (2 + disk_margin)
        disk = Circle(((left + right) / 2, 0), (right - left) / 2)
        disk.set(facecolor=BAD, alpha=0.13, edgecolor="none", label=f"disk margin {disk_margin:.2f}")
        ax.add_patch(disk)
    for k, loop in enumerate(loops):
        curve(ax, loop.response.real, loop.response.imag, label=loop.name, k=k)
    ax.plot(-1, 0, marker="+", color=BAD, markersize=12, markeredgewidth=2, linestyle="none")
    ax.set_xlim(-3.6, 1.6)
    ax.set_ylim(-2.6, 1.6)
    ax.set_aspect("equal")
    legend_above(ax, columns=3)
    return ax


def plot_poles(poles: NDArray[np.complex128], ax: Axes | None = None) -> Axes:
    """Plot the closed-loop poles [rad/s]; fast poles caused only by the delay are counted, not shown.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.report import plot_poles
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification import closed_loop_poles
        >>> poles = closed_loop_poles(load_vehicle("sur400"), load_gains("default").values, cruise=0.15, dt=0.05)
        >>> ax = plot_poles(poles)
        >>> ax.get_xlabel(), ax.get_ylabel()
        ('real part [1/s]', 'imaginary part [rad/s]')
    """
    ax = dress(ax or new_figure(5.1, 4.5).add_subplot(), x="real part [1/s]", y="imaginary part [rad/s]")
    values = np.asarray(poles, dtype=complex)
    shown = _slow(values)
    edge = 1.15 * max(float(np.max(np.abs(shown), initial=0.0)), 1e-3)
    for damping in (0.5, 0.7):
        slope = np.sqrt(1 - damping**2) / damping
        for sign in (1, -1):
            ax.plot([0, -edge], [0, sign * slope * edge], color=MUTED, linestyle=":", linewidth=0.9)
        at = edge / max(1.0, slope)
        ax.annotate(f"ζ {damping:g}", (-at * 0.85, slope * at * 0.85), fontsize=8, color=INK, ha="center", va="bottom")
    ax.axvline(0.0, color=BAD, linewidth=1.0)
    stable = shown.real < 0
    ax.plot(shown[stable].real, shown[stable].imag, "x", color=ROBOT, markersize=8, markeredgewidth=2, label="stable")
    if not stable.all():
        ax.plot(
            shown[~stable].real, shown[~stable].imag, "s", color=AVOIDING, markersize=7, label="unstable"
        )  # fmt: skip
    ax.set_xlim(-edge, max(0.12 * edge, 1.15 * float(np.max(shown.real, initial=0.0))))
    ax.set_ylim(-edge, edge)
    hidden = len(values) - len(shown)
    if hidden:
        ax.plot([], [], linestyle="none", label=f"{hidden} faster poles of the delay are not shown")
    legend_above(ax, columns=3)
    return ax


def _slow(poles: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return the poles below the widest gap in |pole|; all poles if the gap is small or a pole above is unstable."""
    ordered = poles[np.argsort(np.abs(poles), kind="stable")]
    size = np.maximum(np.abs(ordered), 1e-3)
    ratio = size[1:] / size[:-1]
    if ratio.size == 0 or ratio.max() < _DELAY_GAP:
        return ordered
    slow = ordered[: int(np.argmax(ratio)) + 1]
    return slow if np.all(ordered[len(slow) :].real < 0) else ordered


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
    vehicle: Vehicle,
    gains: Mapping[str, float],
    *,
    cruise: Sequence[float],
    dt: float,
    places: Sequence[str],
    law: str = TRACKING_LAW,
) -> list[Sensitivity]:
    """Return sensitivities S and T of the loop opened at each of `places`, at each cruise speed with a stable loop.

    The names in `places` are those of `DISK_PLACES`. If there are several speeds, the attribute `place` of each result
    also contains the speed. `cruise` are the cruise speeds [m/s], `dt` is the control period [s], `law` a law that
    tracks, as in `loop_margins`.
    """
    curves: list[Sensitivity] = []
    for speed in cruise:
        loop = cruise_loop(vehicle, gains, cruise=speed, dt=dt, law=law)
        at = f" at {speed:g} m/s" if len(cruise) > 1 else ""
        shown = places if loop.stable else ()
        curves += [sensitivity_of(open_loop(loop, place), f"{place}{at}", highest=np.pi / dt) for place in shown]
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


_DAMPING = (0.2, 0.4, 0.6, 0.8)
_ASYMPTOTE_GAP = 3.0
_ARC = np.linspace(np.pi / 2, 3 * np.pi / 2, 121)


def plot_locus(
    data: Locus, ax: Axes | None = None, *, unit: str = "", picked: float | None = None, radius: float | None = None
) -> Axes:
    """Plot the closed-loop poles over the swept parameter, in the upper and lower half-plane.

    Args:
        data: closed-loop poles over the swept parameter.
        ax: axes to draw in.
        unit: unit of the swept parameter.
        picked: parameter value whose poles are marked; the nearest computed value is used.
        radius: largest |pole| shown [rad/s]; by default the largest |pole| below the highest gap of a factor of 3
            between sorted |poles|, so that the fast poles caused by the delay are not shown.

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
    edge = radius or 1.15 * _below_the_gap(np.sort(np.abs(data.poles).max(axis=0)))
    _grid(ax, edge)
    colours, norm = mpl.colormaps["viridis"], Normalize(float(data.values.min()), float(data.values.max()))
    middle = (data.values[1:] + data.values[:-1]) / 2
    for pole in data.poles.T:
        points = np.column_stack([pole.real, pole.imag])
        lines = LineCollection(
            list(np.stack([points[:-1], points[1:]], axis=1)), cmap=colours, norm=norm, linewidths=2.2
        )
        lines.set_array(middle)
        ax.add_collection(lines)
    _pole_mark(ax, data.poles[0], "o", INK, f"start: {data.values[0]:.3g}")
    if picked is not None:
        at = int(np.argmin(np.abs(data.values - picked)))
        _pole_mark(ax, data.poles[at], "D", AVOIDING, f"picked: {data.values[at]:.3g}")
    ax.axvline(0.0, color=BAD, linewidth=1.2, label="stability boundary")
    ax.set_xlim(-edge, max(0.12 * edge, min(edge, 1.1 * float(data.poles.real.max()))))
    ax.set_ylim(-edge, edge)
    bar = ax.figure.colorbar(ScalarMappable(norm, colours), ax=ax)
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
