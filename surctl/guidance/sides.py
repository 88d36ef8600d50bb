"""The side on which something that comes head-on is passed: there both ways round are as near to the wish.

Left to the courses alone, the noise of the first message chooses it; and the robot keeps it.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from surctl.guidance.cones import Cone
from surctl.guidance.contacts import FAR, Contact

__all__ = ["MISSED", "MISSED_RATE", "passes_left", "side_costs", "swap_costs"]

MISSED, MISSED_RATE = 10.0, 100.0
"""Cost of a course that is not free, and of each m/s by which it is not."""

_HEAD_ON = 0.03  # [m/s] across, below which an encounter is head-on: three standard deviations of what is told
_RIGHT = 0.15  # cost of having it on the left then; what noise makes of the two courses differs by 0.05
_AMPLE_CLEARANCE = (
    (0.5, 0.3),
    (1.0, 0.05),
)  # share of the way to where it is passed, and clearance there that is enough [m]
_CRAMPED = 5.0  # cost of each metre less
_SWAP = 2.0  # cost of changing sides, by the share of the speed that must be turned round
_AHEAD = 12.0  # [s] before it is met, within which that counts
_REACHED = 0.5  # of the time until it is met, in which the velocity across must have turned
_STANDS = 1e-3  # [m/s] that it nears at the least
_SLOW = 0.05  # [m/s] at which the two come nearer at the least


def side_costs(cone: Cone, desired: ca.SX, walls: Sequence[Contact]) -> tuple[ca.SX, ca.SX]:
    """What passing a cone's contact on the left costs, and on the right, beside 1 less the cosine to the wish.

    Nothing unless it comes head-on. Then it stays on the right (E10), but where the way on the left is cramped: half of
    it lies close to a wall, beside which sonars see little and the robot gets on slowly.

    Args:
        cone: of what moves.
        wish: (2, 1) [m/s] in {E}.
        walls: of the site.
    """
    n, across = cone.ahead, _left_of(cone.ahead)
    speed = ca.sqrt(ca.sumsqr(desired))
    travel = cone.distance * speed / ca.fmax(speed - cone.closing, speed + _SLOW)
    left, right = (_cramped(travel * n + sign * cone.offset * across, walls) for sign in (1, -1))
    head_on = ca.fabs(ca.dot(across, desired) - cone.crossing) < _HEAD_ON
    return ca.if_else(head_on, left, 0), ca.if_else(head_on, right + _RIGHT, 0)


def swap_costs(cone: Cone, now: ca.SX, speed: ca.SX, acceleration: ca.SX) -> tuple[ca.SX, ca.SX]:
    """What it costs to pass a cone's contact on the left, and on the right, for the velocity across that must turn.

    At rest that is the velocity of the contact across: it is passed behind rather than before. What has been begun is
    carried on; and a way that the thrust does not reach in half the time until it is met misses its bound by the rest.
    Nothing while the encounter is head-on: noise is to choose no side.

    Args:
        cone: of what moves.
        now: velocity over ground (2, 1) [m/s] in {E}.
        speed: that is asked for [m/s].
        acceleration: that the thrust gives [m/s²].
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
    """Whether a velocity (2, 1) that does not lead into the cone's contact passes on its left: it is on the right."""
    return ca.dot(_left_of(cone.ahead), velocity) >= cone.crossing


def _left_of(n: ca.SX) -> ca.SX:
    return ca.vertcat(-n[1], n[0])


def _cramped(path: ca.SX, walls: Sequence[Contact]) -> ca.SX:
    """Cost of a straight way (2, 1) [m] from here."""
    cost = ca.SX(0)
    for share, ample in _AMPLE_CLEARANCE:
        clearance = ca.SX(FAR)
        for wall in walls:
            clearance = ca.fmin(clearance, wall.clearance - share * ca.dot(path, wall.normal))
        cost += _CRAMPED * ca.fmax(ample - clearance, 0)
    return cost
