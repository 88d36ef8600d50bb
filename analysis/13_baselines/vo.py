"""Law `vo`: velocity obstacles, which forbid velocities that lead to a contact (Fiorini and Shiller, IJRR 1998).

Source: "Motion planning in dynamic environments using velocity obstacles", in the sampled form of van den Berg, Lin and
Manocha 2008 (RVO library), but without reciprocal avoidance.

A velocity is forbidden if, within the time horizon, a robot at this constant velocity would come closer than the margin
to an obstacle that also moves at constant velocity. From a fixed set of candidate velocities around the desired
velocity v_d, the law chooses the allowed candidate nearest to v_d. If all candidates are forbidden, it chooses the
candidate v with the smallest w / t_c + |v − v_d|, the penalty of the RVO library (t_c is the time to contact and w a
weight).
"""

from __future__ import annotations

from math import cos, sin

import casadi as ca
import numpy as np
from textbook import decided, first_contact, length

from surctl.ir import fold, tabulated
from surctl.marine.control import Decision, LawSource, Situation

HORIZON = 4.0
"""Prediction time [s] (tuned between 2 and 30); the heaviest vehicle needs this time to stop from full speed.

With a longer horizon, the law would treat gaps between obstacles as closed.
"""

SAFETY = 0.1
"""Weight w [m] of 1 / t_c in the penalty that is used if all candidates are forbidden (tuned between 0.1 and 5)."""

EXTRA = 0.02
"""Distance [m] that is added to the margin, because the velocity lags behind the command (tuned between 0 and 0.2)."""

COURSES = tuple(np.radians([0, *(s * a for a in (8, 16, 24, 32, 45, 60, 75, 90, 110, 135) for s in (1, -1)), 180]))
"""Candidate courses [rad] relative to the desired course.

Of two equally good candidates the law chooses the first, so the robot passes a head-on obstacle with the obstacle on
its right (erratum E10).
"""

SPEEDS = (1.0, 0.5)
"""Candidate speeds as shares of the desired speed; zero velocity and the speed cap are candidates too."""

_FORBIDDEN = 1e3


def decide(s: Situation) -> Decision:
    """Return the decision: the allowed candidate velocity nearest to the desired velocity."""
    desired, best = s.desired.velocity, s.desired.velocity
    least_cost = _cost(s, desired)
    ahead = desired / ca.fmax(length(desired), 1e-6)
    speed = ca.fmax(length(desired), 1e-6)
    candidates = [
        share * speed * _turned(ahead, course) for share in SPEEDS for course in COURSES if (share, course) != (1.0, 0)
    ]
    candidates += [ca.SX.zeros(2), *(s.p["cap"] * _turned(ahead, course) for course in COURSES[1:])]

    def judged(best: ca.SX, least: ca.SX, candidate: ca.SX) -> list[ca.SX]:
        cost = _cost(s, candidate)
        return [ca.if_else(cost < least - 1e-9, candidate, best), ca.fmin(cost, least)]

    best, least_cost = fold("fan", judged, [best, least_cost], tabulated([candidate] for candidate in candidates))
    return decided(s, best, degraded=least_cost > _FORBIDDEN)


def _cost(s: Situation, velocity: ca.SX) -> ca.SX:
    first = first_contact(s, velocity, extra=EXTRA)
    forbidden = _FORBIDDEN + SAFETY / ca.fmax(first, 1e-2)
    return length(velocity - s.desired.velocity) + ca.if_else(first < HORIZON, forbidden, 0)


def _turned(unit: ca.SX, angle: float) -> ca.SX:
    return ca.vertcat(unit[0] * cos(angle) - unit[1] * sin(angle), unit[0] * sin(angle) + unit[1] * cos(angle))


def law() -> LawSource:
    """Return the law."""
    return LawSource("vo", decide, latches=False)
