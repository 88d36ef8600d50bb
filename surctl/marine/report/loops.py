"""Linear loops: frequency responses as data, Bode and Nyquist plots, and plots of closed-loop poles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray

from surctl.marine.vehicle import Vehicle
from surctl.marine.verification import build_cascade
from surctl.report.theme import AVOIDING, BAD, CYCLE, INK, MUTED, ROBOT, curve, dress, legend_above, new_figure

__all__ = ["LoopResponse", "loop_responses", "plot_bode", "plot_nyquist", "plot_poles"]

_THRUST = ("surge", "sway", "heave", "yaw")
_MEASURED = ("along_track", "cross_track", "depth", "heading")
_SLOWEST = 1e-2  # [rad/s]
_POINTS = 400
_GAP = 6.0  # ratio of two neighbouring pole sizes that separates the dynamics from the delay


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
    vehicle: Vehicle, gains: Mapping[str, float], *, cruise: float, dt: float
) -> tuple[LoopResponse, ...]:
    """Return the frequency responses of the eight loops of `loop_margins`, in the order of `loop_margins`.

    Args:
        vehicle: the vehicle.
        gains: gain values by name.
        cruise: cruise speed U [m/s].
        dt: control period [s].

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
    cascade = build_cascade(vehicle, gains, cruise=cruise, dt=dt)
    omega = np.geomspace(_SLOWEST, np.pi / dt, _POINTS)
    broken = [(name, "thrust", cascade.at_thrust(k)) for k, name in enumerate(_THRUST)]
    broken += [(name, "measurement", cascade.at_output(k)) for k, name in enumerate(_MEASURED)]
    return tuple(LoopResponse(name, at, omega, _frequency_response(*loop, omega)) for name, at, loop in broken)


def _frequency_response(
    A: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64], omega: NDArray[np.float64]
) -> NDArray[np.complex128]:
    # c (jω − A)⁻¹ b, (k,)
    pencils = 1j * omega[:, None, None] * np.eye(len(A)) - A
    response: NDArray[np.complex128] = (c @ np.linalg.solve(pencils, np.broadcast_to(b, (len(omega), *b.shape))))[
        :, 0, 0
    ]
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
    if ratio.size == 0 or ratio.max() < _GAP:
        return ordered
    slow = ordered[: int(np.argmax(ratio)) + 1]
    return slow if np.all(ordered[len(slow) :].real < 0) else ordered
