"""Law `dwa`: the dynamic window of velocities within reach (Fox, Burgard and Thrun, IEEE RAM 1997).

Source: "The dynamic window approach to collision avoidance". The robot is holonomic, so the window is a set of
horizontal velocities, and each velocity leads along a straight line. Obstacles are assumed to continue at their present
velocity. A velocity v is admissible if the robot can brake before it meets the first obstacle: |v| ≤ √(2 b s), where b
is the deceleration and s = |v| t_c is the distance travelled until the time of contact t_c. This condition is
equivalent to |v| ≤ 2 b t_c. The law chooses the admissible velocity with the largest α·heading + β·clearance +
γ·velocity, where the terms heading, clearance and velocity are scaled to values between 0 and 1. If no velocity is
admissible, the robot brakes.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
from textbook import decided, first_contact, length, limited, over_ground

from surctl.ir import fold, tabulated
from surctl.marine.control import Decision, LawSource, Situation
from surctl.marine.control.decision import weakest_acceleration

HORIZON = 0.5
"""Time [s]: the window contains the velocities that full acceleration reaches within it (tuned between 0.5 and 3).

The window of a single control period (0.05 s) would be too small, because the speed changes by only 3 mm/s.
"""

GRID = 7
"""Number of candidates along each axis of the window."""

FREE_DISTANCE = 4.0
"""Free distance ahead [m] above which the clearance term no longer grows (tuned between 0.75 and 4)."""

EXTRA = 0.0
"""Distance [m] that is added to the margin (tuned between 0 and 0.2); 0 suffices, because the window is small."""

HEADING, CLEARANCE, VELOCITY = 2.0, 2.0, 1.0
"""The weights α, β, γ of the objective (β tuned between 0.3 and 5, α and γ fixed; Fox et al. use 2, 0.2, 0.2)."""


def decide(s: Situation) -> Decision:
    """Return the decision: in the window around the present velocity, the admissible velocity with the best objective.

    The candidates include the velocity of the window that is nearest to the desired velocity.
    """
    now, brake = over_ground(s), s.p["brake"] * weakest_acceleration(s.p)
    extent = weakest_acceleration(s.p) * HORIZON
    aside = s.desired.velocity - now
    # this candidate is the point of the window nearest to the desired velocity: without contacts the grid adds no error
    nearest_desired = now + ca.vertcat(*(ca.fmin(ca.fmax(aside[k], -extent), extent) for k in range(2)))
    steps = np.linspace(-1, 1, GRID)
    window = [nearest_desired, *(now + extent * ca.DM([a, b]) for a in steps for b in steps)]

    def judged(best: ca.SX, most: ca.SX, any_admissible: ca.SX, velocity: ca.SX) -> list[ca.SX]:
        velocity = limited(velocity, s.p["cap"])
        first = first_contact(s, velocity, extra=EXTRA)
        speed = length(velocity)
        admissible = speed <= 2 * brake * first
        value = ca.if_else(admissible, _value(s, velocity, speed, first), -1.0)
        better = value > most + 1e-9
        return [ca.if_else(better, velocity, best), ca.fmax(value, most), ca.logic_or(any_admissible, admissible)]

    # without an admissible velocity, the robot brakes as hard as it can
    start = [now - limited(now, extent), ca.SX(-1.0), ca.SX(0)]
    best, _, admitted = fold("window", judged, start, tabulated([velocity] for velocity in window))
    return decided(s, best, degraded=ca.logic_not(admitted))


def _value(s: Situation, velocity: ca.SX, speed: ca.SX, first: ca.SX) -> ca.SX:
    desired = s.desired.velocity
    desired_speed = length(desired)
    along = ca.dot(velocity, desired) / ca.fmax(speed * desired_speed, 1e-6)
    # the free distance is measured at no less than the desired speed, so a slow approach does not count as clearance
    free = ca.fmin(first * ca.fmax(speed, desired_speed), FREE_DISTANCE) / FREE_DISTANCE
    fast = 1 - ca.fmin(ca.fabs(speed - desired_speed) / ca.fmax(desired_speed, 1e-3), 1)
    return HEADING * 0.5 * (1 + along) + CLEARANCE * free + VELOCITY * fast


def law() -> LawSource:
    """Return the law."""
    return LawSource("dwa", decide, latches=False)
