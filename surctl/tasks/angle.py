"""Function that wraps an angle to (−π, π] without atan2."""

from __future__ import annotations

import math

import casadi as ca

__all__ = ["wrap"]


def wrap(angle: ca.SX) -> ca.SX:
    """Return each angle [rad] wrapped to (−π, π], without trigonometric functions; −π becomes π, and π stays π.

    After a wrap with the floor function, a rounding error can leave the angle just outside the interval (an angle just
    above 3π becomes just above π). So two corrections by one turn follow.

    Example:
        >>> import casadi as ca
        >>> from surctl.tasks import wrap
        >>> wrap(ca.SX(4.0))
        SX(-2.28319)
    """
    turn = 2.0 * math.pi
    once = angle + turn * ca.floor((math.pi - angle) / turn)
    return once - turn * (once > math.pi) + turn * (once <= -math.pi)
