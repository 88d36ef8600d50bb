"""Steady motions of a simulated run: operating points at which a law of any kind is linearised."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.simulation import Run

Array = NDArray[np.float64]

__all__ = ["OperatingPoint", "steady_motion"]

_WINDOW = 2.0  # [s] for which a motion must be steady
_VELOCITY = (2e-3, 2e-3, 2e-3, 5e-3)  # largest range of u, v, w [m/s] and r [rad/s] over the window
_HEADING = np.deg2rad(1.0)
_THRUST = 0.02  # largest range of a thrust command, as a share of its limit
_FULL = 0.999  # share of the thrust limit from which a thrust is at its limit
_REST = 0.01  # [m/s] below it, the direction of a motion is noise
_TURN = 5e-3  # [rad/s] a motion that turns faster has no time-invariant linear loop


@dataclass(frozen=True, eq=False)
class OperatingPoint:
    """A steady motion of a run: what the law had as state, inputs and parameters, and how the hull moved.

    Attributes:
        x, u, p: the law's state, inputs and parameters.
        nu: velocity u, v, w [m/s], r [rad/s], over ground.
        heading: ψ [rad].
        text: the place, as text.
        current: horizontal velocity (2,) of the water in {E} [m/s].
    """

    x: Array
    u: Array
    p: Array
    nu: Array
    heading: float
    text: str
    current: tuple[float, float] = (0.0, 0.0)

    @property
    def speed(self) -> float:
        """Horizontal speed [m/s]."""
        return float(np.hypot(*self.nu[:2]))

    @property
    def course(self) -> float:
        """Direction of the motion over ground [rad]; that of the hull at rest."""
        return self.heading + (float(np.arctan2(self.nu[1], self.nu[0])) if self.speed > _REST else 0.0)


def steady_motion(run: Run) -> OperatingPoint:
    """Return the steadiest 2 s of a run, if velocity, heading and thrust are constant there.

    If the robot moves steadily at half the cruise speed or more at some time, this motion is returned and not a rest.

    Args:
        run: a run of a law for exact obstacle positions, on the plant of `surctl`.

    Raises:
        InputError: the run has no steady motion of 2 s; the message states what varied least.

    Example:
        >>> from surctl.control import load_gains
        >>> from surctl.simulation import load_scenario, simulate
        >>> from surctl.vehicle import load_vehicle
        >>> from surctl.verification import steady_motion
        >>> run = simulate(load_scenario("tank-static"), load_vehicle("sur400"), gains=load_gains("default"))
        >>> point = steady_motion(run)
        >>> round(point.speed, 2)
        0.22
    """
    record, steps = run.record, round(_WINDOW / run.law.dt)
    limits = np.maximum(record.law_parameters[run.law.gains.slice("thrust_limit")], 1e-12)
    signals = np.column_stack(
        [record.nu / _VELOCITY, np.unwrap(record.eta[:, 3]) / _HEADING, record.tau / (_THRUST * limits)]
    )
    if len(signals) <= steps:
        raise InputError(f"ended after {record.time[-1]:g} s", key=run.scenario.name, remedy=_REMEDY)
    windows = np.lib.stride_tricks.sliding_window_view(signals, steps + 1, axis=0)
    ranges = np.ptp(windows, axis=2)  # (windows, signals), 1 at the largest steady range
    most = np.abs(record.tau) >= _FULL * limits  # nothing controls an axis whose thrust is at its limit
    full = np.any(np.lib.stride_tricks.sliding_window_view(most, steps + 1, axis=0), axis=2)
    worst = np.where(full.any(axis=1), np.inf, ranges.max(axis=1))
    fast = np.hypot(*record.nu[steps:, :2].T) >= 0.5 * run.scenario.cruise
    moving = fast & (worst <= 1.0)
    k = int(np.argmin(np.where(moving, worst, np.inf) if moving.any() else worst))
    middle = k + steps // 2  # its end may have left the steady motion
    if not worst[k] <= 1.0:
        which = ("u", "v", "w", "r", "the heading", "surge thrust", "sway thrust", "heave thrust", "yaw thrust")
        k = int(np.argmin(ranges.max(axis=1)))
        if ranges[k].max() <= 1.0 and full[k].any():
            problem = f"has no steady motion that is controlled: {which[5 + int(np.argmax(full[k]))]} is at its limit"
            raise InputError(problem, key=run.scenario.name, remedy="give a lower speed, or less current")
        varied, by = which[int(np.argmax(ranges[k]))], ranges[k].max()
        problem = f"has no steady motion: in its steadiest {_WINDOW:g} s, {varied} varies {by:.2g} times too much"
        raise InputError(problem, key=run.scenario.name, remedy=_REMEDY)
    nu = record.nu[middle]
    if abs(nu[3]) > _TURN:
        problem = f"turns at {nu[3]:.2g} rad/s where it is steady, so its linear loop varies with time"
        raise InputError(problem, key=run.scenario.name, remedy=_REMEDY)
    heading = float(record.eta[middle, 3])
    moves = ", ".join(f"{name} {value + 0.0:.3g}" for name, value in zip("uvw", np.round(nu[:3], 4), strict=True))
    when = f"at {record.time[middle]:.1f} s of {run.scenario.name}"
    text = f"the steady motion {when} ({moves} m/s, heading {np.rad2deg(heading):.0f} deg)"
    x, u, p = record.law_state[middle], record.law_input[middle], record.parameters_at(middle)
    return OperatingPoint(x, u, p, nu.copy(), heading, text, run.scenario.disturbance.current_m_per_s)


_REMEDY = "give a scenario with a longer straight part"
