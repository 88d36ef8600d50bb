"""Angles without atan2: the difference of two angles, brought to one turn."""

from __future__ import annotations

import math

import casadi as ca

__all__ = ["wrap"]


def wrap(angle: ca.SX) -> ca.SX:
    """The same angle [rad] in (−π, π], entry by entry; exact at both ends, no trigonometry.

    The floor alone can miss by one rounding (an angle just above 3π comes out just above π), hence the two
    corrections.
    """
    turn = 2.0 * math.pi
    once = angle + turn * ca.floor((math.pi - angle) / turn)
    return once - turn * (once > math.pi) + turn * (once <= -math.pi)
