"""The desired motion without obstacles: velocity and heading along the path, slowing down for end and corners."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca

from surctl.marine.control.steering import Steering
from surctl.marine.guidance import AT_CORNER, Guidance
from surctl.marine.guidance.path import leg_end, next_leg, path_target, wheel_over
from surctl.marine.guidance.tracking import (
    along_command,
    crosstrack_next,
    crosstrack_shift,
    path_error,
    progress_rate,
    tracking_velocity,
)
from surctl.marine.vehicle import planar_rotation
from surctl.tasks import allowed_closing_speed

_RETURNS = 0.5  # share of LOS cross-track speed above which the robot counts as returning
_SEPARATION = 3.0  # ratio of the bandwidths of the velocity loop and the position loop


@dataclass(frozen=True)
class DesiredMotion:
    """The desired motion without obstacles, as symbolic expressions.

    Attributes:
        velocity: desired velocity (2, 1) [m/s] in {E}.
        heading: ψ_d [rad], the direction of the path.
        progress: arc length of the target point on the path in the next step [m].
        x_e, y_e: along-track and cross-track error, equation (8) of the paper [m].
        along: commanded speed along the path [m/s].
        tangent: (2, 1) unit tangent of the path in {E}.
        arriving: 1 while the robot approaches a target point at rest: the end of the path or a corner to visit.
    """

    velocity: ca.SX
    heading: ca.SX
    progress: ca.SX
    x_e: ca.SX
    y_e: ca.SX
    along: ca.SX
    tangent: ca.SX
    arriving: ca.SX


def path_following(
    eta: ca.SX,
    progress: ca.SX,
    p: Mapping[str, ca.SX],
    *,
    dt: float,
    guidance: Guidance = "los",
    memory: ca.SX | None = None,
    steering: Steering | None = None,
) -> DesiredMotion:
    """Return the desired motion by the tracking law, equations (8)–(12) of the paper.

    Args:
        eta: (4, 1) measured pose in {E}.
        progress: present arc length of the target point on the path [m].
        p: gains, vehicle model and mission by name.
        memory: present disturbance estimate of guidance `ilos` or `alos`; None for `los`.
        steering: abilities of a craft without sway force, if the law steers by heading and speed: the craft stops by
            its surge force alone, and begins its turns before the corners that it passes.
    """
    point, tangent, length = path_target(p["waypoints"], progress)
    x_e, y_e = path_error(eta[:2], point, tangent)
    shift = crosstrack_shift(
        guidance, ca.SX(0) if memory is None else memory, lookahead=p["lookahead"], sigma=p["ilos_sigma"]
    )
    along = along_command(x_e, y_e + shift, speed=p["cruise"], k1=p["k1"], lookahead=p["lookahead"], maximum=p["cap"])
    following = tracking_velocity(along, y_e + shift, tangent, p["lookahead"])
    # past the end, U_d is 0 and (12) no longer stabilises y_e, so the robot approaches the end point
    offset = point - eta[:2]
    distance = ca.sqrt(ca.sumsqr(offset))
    # without this limit, a robot that is heavy for its thrusters would overshoot the end point
    acceleration = _deceleration(p) if steering is None else steering.deceleration
    fastest = allowed_closing_speed(distance, deceleration=acceleration, reaction=p["reaction"])
    fastest = ca.fmin(p["cruise"], fastest)
    closing = offset * ca.fmin(p["k_v"] / _SEPARATION, fastest / ca.fmax(distance, 1e-3))
    rate = progress_rate(x_e, speed=p["cruise"], wait=p["wait"])
    # the robot approaches a corner to visit like the end of the path, and leaves it after the visit
    visits, end = p["visit"] > 0, leg_end(p["waypoints"], progress)
    waits = ca.logic_and(visits, ca.logic_or(progress < end - AT_CORNER, distance > p["visit"]))
    arriving = ca.logic_or(progress >= length, ca.logic_and(waits, progress >= end - AT_CORNER))
    if steering is not None:  # a craft that arrives at cruise speed would pass the end and turn round
        left = ca.fmax(ca.if_else(waits, end, length) - progress - x_e, 0)
        bound = allowed_closing_speed(left, deceleration=acceleration, reaction=p["reaction"])
        following = following * ca.fmin(1, bound / ca.fmax(ca.sqrt(ca.sumsqr(following)), 1e-6))
    velocity = ca.if_else(arriving, closing, following)
    onward = ca.fmin(progress + dt * rate, ca.if_else(waits, end, length))
    ahead = ca.fmax(onward, next_leg(p["waypoints"], progress, eta[:2], near=ca.if_else(visits, -1, p["wait"])))
    if steering is not None:
        lead = p["cruise"] * p["reaction"]
        begun = wheel_over(p["waypoints"], progress, eta[:2], radius=steering.radius, lead=lead)
        ahead = ca.fmax(ahead, ca.if_else(visits, 0, begun))
    heading = ca.atan2(tangent[1], tangent[0])
    return DesiredMotion(velocity, heading, ahead, x_e, y_e, along, tangent, arriving)


def _deceleration(p: Mapping[str, ca.SX]) -> ca.SX:
    # of a robot that may move in any direction, whatever its heading
    return p["brake"] * ca.fmin(p["thrust_limit"][0], p["thrust_limit"][1]) / ca.fmax(p["mass"][0], p["mass"][1])


def learnt(
    guidance: Guidance,
    desired: DesiredMotion,
    memory: ca.SX,
    eta: ca.SX,
    nu: ca.SX,
    avoiding: ca.SX,
    p: Mapping[str, ca.SX],
    *,
    dt: float,
) -> ca.SX:
    """Return the disturbance estimate `memory` of guidance `ilos` or `alos` after one control period.

    The estimate does not change while the robot avoids an obstacle, is far behind the target point, approaches a target
    point at rest, or returns to the path at half the commanded speed or more: then the cross-track error does not come
    from a steady disturbance, and an update would lead to overshoot.
    """
    over_ground = planar_rotation(eta[3]) @ nu[:2]
    across = desired.tangent[0] * over_ground[1] - desired.tangent[1] * over_ground[0]
    returning = -across * desired.y_e > _RETURNS * desired.along * desired.y_e * desired.y_e / p["lookahead"]
    behind = desired.x_e < -p["wait"] / 2
    held = ca.logic_or(ca.logic_or(avoiding, desired.arriving), ca.logic_or(behind, returning))
    return crosstrack_next(
        guidance,
        memory,
        desired.y_e,
        along=desired.along,
        lookahead=p["lookahead"],
        sigma=p["ilos_sigma"],
        gamma=p["alos_gamma"],
        held=held,
        dt=dt,
    )
