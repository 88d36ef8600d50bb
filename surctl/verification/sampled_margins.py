"""Margins of any sampled linear system: classical margins of one loop at a time, disk margins of several at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from surctl.system import Linearisation
from surctl.verification.linear.disk import DiskMargin, disk_margin
from surctl.verification.linear.places import OpenLoop
from surctl.verification.margins import LoopMargins

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

__all__ = ["system_disk_margin", "system_margins"]

_SPURIOUS = 1e-6  # a gain factor below this value, or above its inverse, comes from a zero of the loop
_SINGULAR = 1e12  # condition number from which z counts as a pole
_LOWEST, _HIGHEST, _POINTS = 1e-6, 1e4, 2000  # grid of tan(ω dt/2)
_AROUND = np.concatenate([1 - np.geomspace(1e-4, 0.1, 16), 1 + np.geomspace(1e-4, 0.1, 16)])
_HALVINGS = 44
_EDGE = 1e-9  # a pole this near to the unit circle counts as on it


def system_margins(linear: Linearisation, *openings: str) -> tuple[LoopMargins, ...]:
    """Return the margins of every loop of a linearised system; one loop is opened at a time, all others stay closed.

    Args:
        linear: the linear loop, see `surctl.system.linearise`.
        openings: labels of the signals at which a loop is opened, commands or measured outputs; by default every
            command, then every measured output.

    Raises:
        InputError: an entry of `openings` is not the label of a command or of a measured output.

    Example:
        >>> from surctl.ir import Layout, Port
        >>> from surctl.system import Controller, Plant, System, linearise
        >>> from surctl.verification import system_margins
        >>> speed, force = Port("speed", (1,), "m/s", "of the cart"), Port("force", (1,), "m/s^2", "over the mass")
        >>> cart = Plant("cart", Layout((speed,)), Layout((force,)), lambda x, f, d, p: {"speed": f["force"]})
        >>> hold = Controller("hold", 0.1, Layout((speed,)), Layout((force,)), lambda x, u, p: -2 * u["speed"])
        >>> (margins,) = system_margins(linearise(System(cart, hold)), "force")
        >>> f"{margins.gain_margin:.1f}, {margins.phase_margin_deg:.1f} deg, {margins.delay_margin_s:.2f} s"
        '10.0, 84.3 deg, 0.73 s'
    """
    chosen = openings or linear.channels()
    stable = _stable(linear)
    return tuple(_margins(linear, name) if stable else LoopMargins.unstable(name) for name in chosen)


def system_disk_margin(linear: Linearisation, *openings: str) -> DiskMargin:
    """Return the disk margin of a linearised system that is opened at several signals at once.

    The frequency in the result lies below the Nyquist frequency π/dt.

    Args:
        linear: the linear loop, see `surctl.system.linearise`.
        openings: labels of the signals at which the loops are opened, commands or measured outputs; by default all of
            them.

    Raises:
        InputError: an entry of `openings` is not the label of a command or of a measured output.

    Example:
        >>> from surctl.ir import Layout, Port
        >>> from surctl.system import Controller, Plant, System, linearise
        >>> from surctl.verification import system_disk_margin
        >>> speed, force = Port("speed", (1,), "m/s", "of the cart"), Port("force", (1,), "m/s^2", "over the mass")
        >>> cart = Plant("cart", Layout((speed,)), Layout((force,)), lambda x, f, d, p: {"speed": f["force"]})
        >>> hold = Controller("hold", 0.1, Layout((speed,)), Layout((force,)), lambda x, u, p: -2 * u["speed"])
        >>> margin = system_disk_margin(linearise(System(cart, hold)), "force", "speed")
        >>> margin.stable, round(margin.guaranteed, 2)
        (True, 0.76)
    """
    chosen = openings or linear.channels()
    place = ", ".join(chosen)
    if not _stable(linear):
        return DiskMargin.unstable(place)
    margin = disk_margin(_continuous(linear, *chosen), place)
    return replace(margin, frequency_rad_s=float(2 * np.arctan(margin.frequency_rad_s) / linear.system.dt))


def _stable(linear: Linearisation) -> bool:
    return bool(np.abs(linear.poles()).max(initial=0.0) < 1 - _EDGE)


def _margins(linear: Linearisation, opening: str) -> LoopMargins:
    """Compute the margins of one loop from all crossings of its frequency response; without gain they are infinite.

    The response comes from the state-space matrices. The polynomials of a transfer function of this order have lost
    the digits in which poles and zeros cancel, and their roots give crossings that do not exist.
    """
    loop = _continuous(linear, opening)
    phase = _response(loop, _crossings(loop, lambda value: np.where(value.real < 0, value.imag, np.nan)))
    gains = np.concatenate([1 / np.abs(phase), _at_ends(*linear.opened(opening))])
    gains = gains[(gains > _SPURIOUS) & (gains < 1 / _SPURIOUS)]
    at = _crossings(loop, lambda value: np.abs(value) - 1)
    lags = np.remainder(np.rad2deg(np.angle(-_response(loop, at))), 360.0)  # a lead counts as a lag of 360° less
    crossings = 2 * np.arctan(at) / linear.system.dt
    disk = disk_margin(loop, opening)
    return LoopMargins(
        opening,
        True,
        float(min(gains[gains > 1], default=np.inf)),
        float(min(lags, default=np.inf)),
        float(min(np.deg2rad(lags) / crossings, default=np.inf)),
        disk.guaranteed,
        float(max(crossings, default=0.0)),
        float(max(gains[gains < 1], default=0.0)),
    )


def _crossings(loop: OpenLoop, value: Callable[[Complex], Array]) -> Array:
    """Return the frequencies of the transformed loop at which a function of its response changes sign.

    The grid is finer near the natural frequencies of the open and of the closed loop, where the response has its peaks.
    """
    poles = np.concatenate([np.linalg.eigvals(A) for A in (loop.A, loop.complementary().A)])
    near = np.outer(np.abs(poles[np.abs(poles) > _LOWEST]), _AROUND).ravel()
    grid = np.unique(np.concatenate([np.geomspace(_LOWEST, _HIGHEST, _POINTS), near]))

    def side(omega: Array) -> Array:
        values = value(_response(loop, omega))
        return np.where(np.isnan(values), np.nan, np.where(values < 0, -1.0, 1.0))

    sides = side(grid)
    at = np.flatnonzero(sides[:-1] * sides[1:] < 0)  # not a number, which is no crossing, compares as false
    low, high = np.log(grid[at]), np.log(grid[at + 1])
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        same = side(np.exp(middle)) == sides[at]
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return np.asarray(np.exp((low + high) / 2), dtype=float)


def _response(loop: OpenLoop, omega: Array) -> Complex:
    return loop.response(omega)[:, 0, 0]


def _at_ends(A: Array, B: Array, C: Array, D: Array) -> Array:
    """Return the gain factors that put a closed-loop pole at z = 1 or at z = -1 (the Nyquist frequency)."""
    factors = []
    for z in (1.0, -1.0):
        pencil = z * np.eye(len(A)) - A
        if np.linalg.cond(pencil) < _SINGULAR:
            value = float((D + C @ np.linalg.solve(pencil, B))[0, 0])
            factors += [-1 / value] if value < 0 else []
    return np.array(factors)


def _continuous(linear: Linearisation, *openings: str) -> OpenLoop:
    """Transform the open loop by z = (1 + s)/(1 - s), which maps the unit circle to the imaginary axis.

    The values of the frequency response do not change.
    """
    A, B, C, D = linear.opened(*openings)
    whole = np.linalg.inv(A + np.eye(len(A)))
    root = np.sqrt(2)
    return OpenLoop(whole @ (A - np.eye(len(A))), root * whole @ B, root * C @ whole, D - C @ whole @ B)
