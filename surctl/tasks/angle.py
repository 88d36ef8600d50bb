"""Wrap an angle to one turn without atan2."""

from __future__ import annotations

import math

import casadi as ca

__all__ = ["wrap"]


def wrap(angle: ca.SX) -> ca.SX:
    """Return each angle [rad] wrapped to (−π, π]; the result is exact at both ends and needs no trigonometry.

    The floor function alone can be wrong by one rounding (an angle just above 3π becomes just above π), so two
    corrections follow.
    """
    turn = 2.0 * math.pi
    once = angle + turn * ca.floor((math.pi - angle) / turn)
    return once - turn * (once > math.pi) + turn * (once <= -math.pi)
