"""Steady motions of a simulated run: operating points at which a law of any kind is linearised."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.control import Law
from surctl.marine.simulation import Run, Scenario

Array = NDArray[np.float64]

__all__ = ["OperatingPoint", "operating_point", "steadiest", "steady_motion"]

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
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import load_scenario, simulate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification import steady_motion
        >>> run = simulate(load_scenario("tank-static"), load_vehicle("sur400"), gains=load_gains("default"))
        >>> point = steady_motion(run)
        >>> round(point.speed, 2)
        0.22
    """
    record = run.record
    middle = steadiest(record.eta, record.nu, record.tau, law=run.law, scenario=run.scenario, p=record.law_parameters)
    return operating_point(
        run.scenario, record.time[middle], record.eta[middle], record.nu[middle],
        x=record.law_state[middle], u=record.law_input[middle], p=record.parameters_at(middle),
    )  # fmt: skip


def steadiest(eta: Array, nu: Array, tau: Array, *, law: Law, scenario: Scenario, p: Array) -> int:
    """Return the control step in the middle of the steadiest 2 s of a run; see `steady_motion`.

    Args:
        eta, nu, tau: (n, 4) pose, velocity and commanded thrust at each control step.
        law: the law of the run.
        scenario: the scenario of the run.
        p: the law's parameters.

    Raises:
        InputError: as for `steady_motion`.
    """
    from scipy.ndimage import maximum_filter1d, minimum_filter1d

    steps = round(_WINDOW / law.dt)
    limits = np.maximum(p[law.gains.slice("thrust_limit")], 1e-12)
    signals = np.column_stack([nu / _VELOCITY, np.unwrap(eta[:, 3]) / _HEADING, tau / (_THRUST * limits)])
    if len(signals) <= steps:
        raise InputError(f"ended after {(len(signals) - 1) * law.dt:g} s", key=scenario.name, remedy=_REMEDY)
    within = partial(_over_windows, steps + 1)
    ranges = within(maximum_filter1d, signals) - within(minimum_filter1d, signals)  # 1 at the largest steady range
    most = np.abs(tau) >= _FULL * limits  # nothing controls an axis whose thrust is at its limit
    full = within(maximum_filter1d, most.astype(float)) > 0
    worst = np.where(full.any(axis=1), np.inf, ranges.max(axis=1))
    fast = np.hypot(*nu[steps:, :2].T) >= 0.5 * scenario.cruise
    moving = fast & (worst <= 1.0)
    k = int(np.argmin(np.where(moving, worst, np.inf) if moving.any() else worst))
    middle = k + steps // 2  # its end may have left the steady motion
    if not worst[k] <= 1.0:
        which = ("u", "v", "w", "r", "the heading", "surge thrust", "sway thrust", "heave thrust", "yaw thrust")
        k = int(np.argmin(ranges.max(axis=1)))
        if ranges[k].max() <= 1.0 and full[k].any():
            problem = f"has no steady motion that is controlled: {which[5 + int(np.argmax(full[k]))]} is at its limit"
            raise InputError(problem, key=scenario.name, remedy="give a lower speed, or less current")
        varied, by = which[int(np.argmax(ranges[k]))], ranges[k].max()
        problem = f"has no steady motion: in its steadiest {_WINDOW:g} s, {varied} varies {by:.2g} times too much"
        raise InputError(problem, key=scenario.name, remedy=_REMEDY)
    if abs(nu[middle, 3]) > _TURN:
        problem = f"turns at {nu[middle, 3]:.2g} rad/s where it is steady, so its linear loop varies with time"
        raise InputError(problem, key=scenario.name, remedy=_REMEDY)
    return middle


def _over_windows(width: int, extreme: Callable[..., Array], signals: Array) -> Array:
    # (windows, signals) extreme of each signal over each window
    return extreme(signals, width, axis=0)[width // 2 : width // 2 + len(signals) - width + 1]


def operating_point(
    scenario: Scenario, time: float, eta: Array, nu: Array, *, x: Array, u: Array, p: Array
) -> OperatingPoint:
    """Return the steady motion at a time [s] of a run, where the law has x, u and p."""
    heading = float(eta[3])
    moves = ", ".join(f"{name} {value + 0.0:.3g}" for name, value in zip("uvw", np.round(nu[:3], 4), strict=True))
    when = f"at {time:.1f} s of {scenario.name}"
    text = f"the steady motion {when} ({moves} m/s, heading {np.rad2deg(heading):.0f} deg)"
    return OperatingPoint(x, u, p, nu.copy(), heading, text, scenario.disturbance.current_m_per_s)


_REMEDY = "give a scenario with a longer straight part"
