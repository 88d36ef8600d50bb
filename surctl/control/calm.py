"""Calm commands for a law with sonars: measurement noise, and short changes of the map, do not reach the thrusters.

Noise of the estimated velocity enters the thrust through the velocity loop: a standard deviation s becomes m k_v s,
which is 1 N for 95 kg, 1.5 1/s and 0.7 cm/s. `calmed` follows the demanded thrust through a band (hysteresis, or
"play") that is 1.5 times this wide on either side: the command changes only as far as the demand leaves the band. The
command therefore differs from the demand by at most the half width, which for the loop is a bounded disturbance of the
thrust; the linear loop and its margins do not change. A low-pass filter with the same effect would add its delay.

`eased` lets the velocity reference follow the decision with a time constant, unless the decision must be followed at
once to respect the speed bound of an obstacle. Short-lived decisions then do not cause a full thrust reversal.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from surctl.control.stopping import Bounds
from surctl.ir import Port, fold, tabulated

__all__ = ["CALM_PORTS", "EASE", "EVADE", "calmed", "eased"]

EASE = 0.4
"""Time constant [s] of the velocity reference of a law with sonars (*chosen*, see `analysis/12_sonar_loop`)."""

EVADE = 0.1
"""Time constant [s] of the velocity reference while the robot evades a moving obstacle (*chosen*)."""

_WIDTH = 1.5  # standard deviations of the noise in half the width of the band
_WIDEST = 0.3  # share of the thrust limit: largest half width, while the estimate is poor

CALM_PORTS = (
    Port("held", (4,), "N, N m", "thrust command of the step before, which follows the demand in a band", gap="anew"),
)


def calmed(free: ca.SX, held: ca.SX, *, noise: ca.SX, p: Mapping[str, ca.SX]) -> ca.SX:
    """Return the thrust (4, 1) nearest to the command of the step before that lies in the band around the demand.

    Args:
        free: demanded thrust (4, 1) before the limits [N, N m].
        held: thrust command of the step before (4, 1).
        noise: (2, 1) standard deviations of the estimated velocity [m/s] and of the yaw rate [rad/s]; with 0, the
            result is the demand.
        p: parameters by name: `mass`, `k_v`, `k_r`, `thrust_limit`.

    Example:
        >>> import casadi as ca
        >>> from surctl.control.calm import calmed
        >>> p = {"mass": ca.DM([95, 95, 95, 1.5]), "thrust_limit": ca.DM([5, 5, 5, 0.5]), "k_v": 1.5, "k_r": 1.5}
        >>> noise, still = ca.DM([0.005, 0.005]), ca.DM.zeros(4)
        >>> near, far = (calmed(ca.DM([f, 0, 0, 0]), still, noise=noise, p=p)[0] for f in (0.8, 3.0))
        >>> round(float(near), 2), round(float(far), 2)  # the band is 1.07 N wide on either side
        (0.0, 1.93)
    """
    spread = ca.vertcat(noise[0], noise[0], noise[0], noise[1])
    gain = ca.vertcat(p["k_v"], p["k_v"], p["k_v"], p["k_r"])
    width = ca.fmin(_WIDTH * p["mass"] * gain * spread, _WIDEST * p["thrust_limit"])
    return ca.fmin(ca.fmax(held, free - width), free + width)


def eased(velocity: ca.SX, before: ca.SX, bounds: Bounds, *, time: ca.SX | float, dt: float) -> ca.SX:
    """Return a velocity between the reference of the step before and the desired one, within the bounds.

    The reference follows the desired velocity with a time constant. Where it would exceed a speed bound that the
    desired velocity respects, it follows faster, as far as the bound requires.

    Args:
        velocity: desired velocity (2, 1) in {E} [m/s].
        before: velocity reference of the step before (2, 1) in {E} [m/s].
        bounds: speed bounds.
        time: time constant [s].
        dt: control period [s].

    Example:
        >>> import casadi as ca
        >>> from surctl.control.calm import eased
        >>> slow, still = ca.DM([0.2, 0.0]), ca.DM([0.0, 0.0])
        >>> free = eased(still, slow, [(ca.DM([0.0, 1.0]), ca.DM(1.0))], time=0.45, dt=0.05)
        >>> wall = eased(still, slow, [(ca.DM([1.0, 0.0]), ca.DM(0.05))], time=0.45, dt=0.05)
        >>> ca.DM(free).full().ravel().round(3).tolist(), ca.DM(wall).full().ravel().round(3).tolist()
        ([0.18, 0.0], [0.05, 0.0])
    """
    step = velocity - before

    def further(share: ca.SX, row: ca.SX) -> ca.SX:
        along, excess = ca.dot(row[:2], step), ca.dot(row[:2], before) - row[2]
        needed = ca.fmin(excess / ca.fmax(-along, 1e-9), 1)
        return ca.if_else(ca.logic_and(excess > 0, along < 0), ca.fmax(share, needed), share)

    return before + fold("eased", further, ca.SX(dt / (dt + time)), tabulated(bounds, 3)) * step
