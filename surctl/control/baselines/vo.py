"""Velocity obstacles (Fiorini and Shiller, "Motion planning in dynamic environments using velocity obstacles", IJRR
1998), in the sampled form of van den Berg, Lin and Manocha 2008 (RVO library) without reciprocity.

A velocity is forbidden if the robot, keeping it, would come within the margin of a contact that keeps its own, within
the horizon. Of a fixed fan around the wish the allowed one nearest to the wish is taken; if none is, the one of the
smallest w / t_c + |v − wish|, which is the penalty of that library.
"""

from __future__ import annotations

from math import cos, sin

import casadi as ca
import numpy as np

from surctl.control.baselines.situation import Situation, decided, first_contact, length
from surctl.control.decision import Decision
from surctl.ir import fold, tabulated

__all__ = ["COURSES", "HORIZON", "SAFETY", "SPEEDS", "vo_law"]

HORIZON = 4.0
"""[s] (tuned from 2 to 30): what the heaviest vehicle needs from full speed to rest. A longer one closes the gaps."""

SAFETY = 0.1
"""w [m]: weight of 1 / t_c against the distance to the wish where every velocity is forbidden (tuned from 0.1 to 5)."""

EXTRA = 0.02
"""[m] beyond the gains' margin (tuned from 0 to 0.2): the robot does not follow a velocity at once."""

COURSES = tuple(np.radians([0, *(s * a for a in (8, 16, 24, 32, 45, 60, 75, 90, 110, 135) for s in (1, -1)), 180]))
"""[rad] from the wish; of two equals the first is taken, so that what is met head-on stays on the right (E10)."""

SPEEDS = (1.0, 0.5)
"""Of the wished speed. Standing still is a candidate too, and full speed (the cap) where the wish is slower."""

_FORBIDDEN = 1e3


def vo_law(s: Situation) -> Decision:
    """The allowed velocity nearest to the wish."""
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
