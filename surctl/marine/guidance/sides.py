"""Costs that decide on which side the robot passes a moving contact (nearby object).

In a head-on encounter, the course left of the contact and the course right of it are equally near to the desired
course. Without these costs, the noise of the first measurement of the contact would choose the side, and the robot
would keep to this side.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from surctl.marine.guidance.cones import Cone
from surctl.marine.guidance.contacts import FAR, Contact

__all__ = ["MISSED", "MISSED_RATE", "passes_left", "side_costs", "swap_costs"]

MISSED, MISSED_RATE = 10.0, 100.0
"""Cost of a course that violates a bound, and additional cost per m/s of violation."""

_HEAD_ON = 0.03  # [m/s] crosswise speed below which an encounter is head-on: three standard deviations of a message
_RIGHT = 0.15  # cost of passing a head-on contact on its right; noise changes the costs of the courses by only 0.05
# share of the path to the place of passing, and sufficient clearance from walls there [m]
_AMPLE_CLEARANCE = ((0.5, 0.3), (1.0, 0.05))
_CRAMPED = 5.0  # cost per metre of missing clearance
_SWAP = 2.0  # cost of changing sides, per share of the speed that must be reversed
_AHEAD = 12.0  # [s] time until the meeting, below which this cost counts
_REACHED = 0.5  # share of the time until the meeting in which the crosswise velocity must be reversed
_STANDS = 1e-3  # [m/s] lower bound of the closing speed
_SLOW = 0.05  # [m/s] least assumed speed of a contact towards the robot


def side_costs(cone: Cone, desired: ca.SX, walls: Sequence[Contact]) -> tuple[ca.SX, ca.SX]:
    """Return the additional costs of passing a moving contact on its left and on its right in a head-on encounter.

    In any other encounter both costs are 0. The robot keeps a head-on contact on its right (erratum E10), unless the
    path left of the contact is too close to a wall: near a wall the sonars detect little and the robot is slow.

    Args:
        cone: collision cone of the moving contact.
        desired: desired velocity (2, 1) [m/s] in {E}.
        walls: walls of the site.
    """
    n, across = cone.ahead, _left_of(cone.ahead)
    speed = ca.sqrt(ca.sumsqr(desired))
    travel = cone.distance * speed / ca.fmax(speed - cone.closing, speed + _SLOW)
    left, right = (_cramped(travel * n + sign * cone.offset * across, walls) for sign in (1, -1))
    head_on = ca.fabs(ca.dot(across, desired) - cone.crossing) < _HEAD_ON
    return ca.if_else(head_on, left, 0), ca.if_else(head_on, right + _RIGHT, 0)


def swap_costs(cone: Cone, now: ca.SX, speed: ca.SX, acceleration: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the costs of passing a moving contact on its left and on its right that a reversal of motion causes.

    To pass on one of the two sides, the robot may have to reverse its crosswise velocity relative to the contact. The
    cost of this side grows with the velocity to be reversed. So the robot completes a manoeuvre that it has begun, and
    from rest it passes behind a crossing contact and not in front of it. If the thrust cannot reverse this velocity in
    half the time until the robot meets the contact, the remaining velocity counts as a violation of a bound. In a
    head-on encounter both costs are 0, so that noise does not choose the side.

    Args:
        cone: collision cone of the moving contact.
        now: velocity over ground (2, 1) [m/s] in {E}.
        speed: commanded speed [m/s].
        acceleration: available acceleration [m/s²].
    """
    across = ca.dot(_left_of(cone.ahead), now) - cone.crossing
    nearing = ca.fmax(ca.dot(cone.ahead, now) - cone.closing, _STANDS)
    turn, time = ca.fabs(across), cone.clearance / nearing
    late = turn - _REACHED * acceleration * time
    cost = _SWAP * turn / speed + ca.if_else(late > 0, MISSED + MISSED_RATE * late, 0)
    counts = ca.logic_and(turn > _HEAD_ON, ca.logic_and(cone.there, time < _AHEAD))
    cost = ca.if_else(counts, cost, 0)
    return ca.if_else(across < 0, cost, 0), ca.if_else(across > 0, cost, 0)


def passes_left(velocity: ca.SX, cone: Cone) -> ca.SX:
    """Return whether a velocity (2, 1) outside the cone passes left of the contact (contact on the robot's right)."""
    return ca.dot(_left_of(cone.ahead), velocity) >= cone.crossing


def _left_of(n: ca.SX) -> ca.SX:
    return ca.vertcat(-n[1], n[0])


def _cramped(path: ca.SX, walls: Sequence[Contact]) -> ca.SX:
    """Return the cost of a straight path (2, 1) [m] from the robot's position, positive if too close to a wall."""
    cost = ca.SX(0)
    for share, ample in _AMPLE_CLEARANCE:
        clearance = ca.SX(FAR)
        for wall in walls:
            clearance = ca.fmin(clearance, wall.clearance - share * ca.dot(path, wall.normal))
        cost += _CRAMPED * ca.fmax(ample - clearance, 0)
    return cost
