"""The side on which something that comes head-on is passed: there both ways round are as near to the wish.

Left to the courses alone, the noise of the first message chooses it; and the robot keeps it.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from surctl.guidance.cones import Cone
from surctl.guidance.contacts import FAR, Contact

__all__ = ["passes_left", "side_costs"]

_HEAD_ON = 0.03  # [m/s] across, below which an encounter is head-on: three standard deviations of what is told
_RIGHT = 0.15  # cost of having it on the left then; what noise makes of the two courses differs by 0.05
_ROOM = ((0.5, 0.3), (1.0, 0.05))  # share of the way to where it is passed, and clearance there that is enough [m]
_CRAMPED = 5.0  # cost of each metre less
_SLOW = 0.05  # [m/s] at which the two come nearer at the least


def side_costs(cone: Cone, wish: ca.SX, walls: Sequence[Contact]) -> tuple[ca.SX, ca.SX]:
    """What passing a cone's contact on the left costs, and on the right, beside 1 less the cosine to the wish.

    Nothing unless it comes head-on. Then it stays on the right (E10), but where the way on the left is cramped: half of
    it lies close to a wall, beside which sonars see little and the robot gets on slowly.

    Args:
        cone: of what moves.
        wish: (2, 1) [m/s] in {E}.
        walls: of the site.
    """
    n, across = cone.ahead, _left_of(cone.ahead)
    speed = ca.sqrt(ca.sumsqr(wish))
    way = cone.distance * speed / ca.fmax(speed - cone.closing, speed + _SLOW)
    left, right = (_cramped(way * n + sign * cone.offset * across, walls) for sign in (1, -1))
    head_on = ca.fabs(ca.dot(across, wish) - cone.crossing) < _HEAD_ON
    return ca.if_else(head_on, left, 0), ca.if_else(head_on, right + _RIGHT, 0)


def passes_left(velocity: ca.SX, cone: Cone) -> ca.SX:
    """Whether a velocity (2, 1) that does not lead into the cone's contact passes on its left: it is on the right."""
    return ca.dot(_left_of(cone.ahead), velocity) >= cone.crossing


def _left_of(n: ca.SX) -> ca.SX:
    return ca.vertcat(-n[1], n[0])


def _cramped(way: ca.SX, walls: Sequence[Contact]) -> ca.SX:
    """Cost of a straight way (2, 1) [m] from here."""
    cost = ca.SX(0)
    for share, ample in _ROOM:
        room = ca.SX(FAR)
        for wall in walls:
            room = ca.fmin(room, wall.clearance - share * ca.dot(way, wall.normal))
        cost += _CRAMPED * ca.fmax(ample - room, 0)
    return cost
