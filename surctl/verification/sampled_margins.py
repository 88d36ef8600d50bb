"""Margins of any sampled linear system: of one loop at a time by python-control, of several loops by disk margins."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from surctl.system import Linearisation
from surctl.verification.linear.disk import DiskMargin, disk_margin
from surctl.verification.linear.places import OpenLoop
from surctl.verification.margins import LoopMargins

Array = NDArray[np.float64]

__all__ = ["system_disk_margin", "system_margins"]

_SPURIOUS = 1e-6  # a gain factor below this value, or above its inverse, comes from a zero of the loop
_SINGULAR = 1e12  # condition number from which z counts as a pole
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
    # a loop without gain has infinite margins
    import control  # takes seconds to import

    loop = linear.loop(opening)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # warnings at z = 1 and z = -1, which `_at_ends` covers
        gains, phases, _, _, crossings, _ = control.stability_margins(loop, returnall=True)
    gains, phases, crossings = (np.atleast_1d(np.asarray(v, dtype=float)) for v in (gains, phases, crossings))
    gains = np.concatenate([gains, _at_ends(*linear.opened(opening))])
    gains = gains[(gains > _SPURIOUS) & (gains < 1 / _SPURIOUS)]
    lags = np.remainder(phases, 360.0)  # a lead counts as a lag of 360° less
    delays = np.deg2rad(lags[crossings > 0]) / crossings[crossings > 0]
    disk = disk_margin(_continuous(linear, opening), opening)
    return LoopMargins(
        opening,
        True,
        float(min(gains[gains > 1], default=np.inf)),
        float(min(lags, default=np.inf)),
        float(min(delays, default=np.inf)),
        disk.guaranteed,
        float(max(crossings, default=0.0)),
        float(max(gains[gains < 1], default=0.0)),
    )


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
