"""The wish: what the robot would do if nothing were in its way."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca

from surctl.guidance import along_command, path_error, path_target, progress_rate, tracking_velocity

_SEPARATION = 3.0  # the position loop is this much slower than the velocity loop

__all__ = ["Wish", "path_wish"]


@dataclass(frozen=True)
class Wish:
    """The undisturbed command, symbolic.

    Attributes:
        velocity: (2, 1) [m/s] in {E}.
        heading: ψ_d [rad], the path's direction.
        progress: next arc length of the path's target [m].
        x_e, y_e: path errors of (8) [m].
    """

    velocity: ca.SX
    heading: ca.SX
    progress: ca.SX
    x_e: ca.SX
    y_e: ca.SX


def path_wish(eta: ca.SX, progress: ca.SX, p: Mapping[str, ca.SX], *, dt: float) -> Wish:
    """Tracking law (8)–(12) on the path; at its end, proportional approach to the target.

    Args:
        eta: (4, 1) measured pose in {E}.
        progress: arc length of the path's target [m].
        p: gains `k1`, `lookahead`, `wait`, `k_v` and mission `waypoints`, `cruise`, `cap`.
        dt: control period [s].
    """
    point, tangent, length = path_target(p["waypoints"], progress)
    x_e, y_e = path_error(eta[:2], point, tangent)
    along = along_command(x_e, y_e, speed=p["cruise"], k1=p["k1"], lookahead=p["lookahead"], maximum=p["cap"])
    following = tracking_velocity(along, y_e, tangent, p["lookahead"])
    # past the end U_d is 0 and (12) no longer stabilises y_e: close in on the point itself
    offset = point - eta[:2]
    distance = ca.sqrt(ca.sumsqr(offset))
    closing = offset * ca.fmin(p["k_v"] / _SEPARATION, p["cruise"] / ca.fmax(distance, 1e-3))
    velocity = ca.if_else(progress >= length, closing, following)
    rate = progress_rate(x_e, speed=p["cruise"], wait=p["wait"])
    return Wish(velocity, ca.atan2(tangent[1], tangent[0]), ca.fmin(progress + dt * rate, length), x_e, y_e)
