"""The steered law: for craft without sway force, guidance and avoidance by heading and speed.

Path following gives a desired course and speed. From candidates of course and speed around them, the law chooses the
best one that the craft can follow without contact, and steers the hull to this course minus the crab angle.

Avoidance follows the dynamic window of Fox, Burgard and Thrun (IEEE RAM 1997) and the simulation of candidate courses
of Johansen, Perez and Cristofaro (IEEE T-ITS 2016). Each candidate is predicted over a fixed number of steps with the
yaw moment, the deceleration and the sway drift of the craft (`steering.moved`): an arc onto the course, then a straight
line. Obstacles continue at their present velocity. A disc is predicted as a disc. Of any other body the input holds
only the nearest point, so the law assumes the half-plane behind this point, which contains the whole body if it is
convex. A candidate is admissible if it stays clear for the whole time of prediction, or if the craft can stop by its
surge force before the contact. If no candidate is admissible, the craft stops, and turns to the best course.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from surctl.ir import Port
from surctl.marine.control.baselines.situation import Situation, length
from surctl.marine.control.closing import thrust_bounds
from surctl.marine.control.courses import CLEAR, INADMISSIBLE, SEARCH_PORTS, best_course, sided
from surctl.marine.control.decision import Decision, TaskLevel
from surctl.marine.control.gains import GainSpec
from surctl.marine.control.steering import (
    FIN_STEERAGE,
    SLOWEST,
    Steering,
    drifted,
    planned_yaw_rate,
    steerage,
    yaw_moment,
)
from surctl.tasks import depth_task

__all__ = ["STEERED_GAINS", "STEERED_PORTS", "steered_law", "steered_thrust"]

STEERED_GAINS: Mapping[str, GainSpec] = {
    "sideslip": GainSpec("rad", "largest drift angle in a planned turn", default=0.2, range=(0.1, 0.3)),
    "steerage": GainSpec("1", "least share of the speed kept during a turn", True, 1.0, 0.0, range=(0.0, 0.5)),
    "crab_time": GainSpec("s", "time constant of the filter of the crab angle", default=2.0, range=(0.5, 5.0)),
    "foresight": GainSpec("1", "length of the prediction over the turning radius", default=2.5, range=(1.5, 5.0)),
    "fin_share": GainSpec(
        "1", "share of the largest yaw moment that fins give at the cruise speed", True, 1.0, 0.0, from_vehicle=True
    ),
    "munk": GainSpec("kg", "moment in yaw per surge and sway speed", True, default=0.0, from_vehicle=True),
    "centripetal": GainSpec("kg", "sway force per surge speed and yaw rate", True, default=0.0, from_vehicle=True),
    "ahead_limit": GainSpec("N", "largest surge thrust ahead", True, default=0.0, from_vehicle=True),
}
"""Gains of this law in addition to `GAINS`, and a number that follows from the vehicle."""

STEERED_PORTS = (
    Port("crab", (1,), "rad", "filtered crab angle: course minus heading"),
    Port("sway", (1,), "m/s", "sway speed through the water that the model predicts from surge speed and yaw rate"),
    Port("surge", (1,), "m/s", "surge speed through the water that the model predicts from the thrust"),
    Port("away", (1,), "1", "1 while a craft with fins goes away from a point at rest to turn back to it"),
    *SEARCH_PORTS,
)

_RUN_IN = 2.0  # distance in turning radii to which such a craft goes before it turns back (*chosen*)
_INSIDE = 0.95  # share of the turning radius within which a point at rest is out of reach for a craft with fins
_OUTRUN = 3.0  # least speed at a point at rest over the current from aside (*chosen*): the crab angle is 18 degrees
_TIGHTER = 0.8  # radius of the planned arc to a point at rest over that which just reaches it (*chosen*)
_CHANGED = 1e-3  # [m/s] difference above which a velocity counts as different from the desired velocity


def steered_law(s: Situation) -> Decision:
    """Return the decision: the speed along the hull and the yaw rate that lead to the best admissible course."""
    assert s.steering is not None
    p, psi = s.p, s.eta[3]
    on_path = ca.vertcat(s.desired.tangent[0], s.desired.tangent[1])
    towards, desired_speed = length(s.desired.velocity), _desired_speed(s)
    course = ca.if_else(towards > 1e-6, s.desired.velocity / ca.fmax(towards, 1e-6), on_path)
    hull = ca.vertcat(ca.cos(psi), ca.sin(psi))
    slip = ca.atan2(s.nu[1], ca.fmax(s.nu[0], SLOWEST * p["cruise"]))
    crab = s.x["crab"] + s.dt / (p["crab_time"] + s.dt) * (slip - s.x["crab"])
    away = _leaves(s, hull, s.steering)
    course = ca.if_else(away, _turned(hull, crab), course)  # over ground: along the hull, the drift of a turn goes on
    water = _through_water(s)
    offset, share, cost, searched = best_course(s, course, desired_speed, hull, water, s.steering)
    blocked, clear = cost >= INADMISSIBLE, cost < CLEAR
    course, speed = _turned(course, offset), ca.if_else(blocked, 0, share * desired_speed)

    heading = _turned(course, -crab)
    ahead = ca.dot(hull, heading)
    across = hull[0] * heading[1] - hull[1] * heading[0]
    error = ca.atan2(across, ahead)
    surge = speed * ca.fmax(ahead, steerage(p))
    surge = ca.if_else(s.desired.arriving, ca.fmin(surge, _on_arc(s, ahead, across)), surge)
    # a following current carries a craft with fins on, but only the speed through the water turns it
    steered = s.nu[0] - water + share * FIN_STEERAGE * p["fin_share"] * p["cruise"]
    surge = ca.if_else(ca.logic_and(p["fin_share"] > 0, ca.logic_not(blocked)), ca.fmax(surge, steered), surge)
    yaw_rate = _yaw_rate(error, water, p)
    # the reference follows the drift in a turn: no thruster acts against it, and a current is no drift
    sway = drifted(s.x["sway"], water, s.nu[3], p, s.dt)

    velocity = speed * course
    side = ca.if_else(clear, 0, ca.if_else(sided(offset), ca.if_else(offset > 0, 1, -1), s.x["side"]))
    heaves = p["thrust_limit"][2] > 0
    depth = TaskLevel.of(depth_task(s.eta, p["depth"], gain=p["k2"]))
    return Decision(
        [
            TaskLevel("turn", ca.SX([[0, 0, 0, 1]]), yaw_rate, "rad/s"),
            TaskLevel("speed", ca.SX([[1, 0, 0, 0]]), surge, "m/s"),
            TaskLevel("drift", ca.SX([[0, 1, 0, 0]]), sway, "m/s"),
            depth._replace(J=heaves * depth.J, reference=heaves * depth.reference),
        ],
        velocity=velocity,
        avoiding=length(velocity - s.desired.velocity) > _CHANGED,
        degraded=blocked,
        state={"side": side, "blocker": s.x["blocker"], "last_velocity": velocity, "crab": crab, "sway": sway}
        | {"surge": _propelled(s, surge), "away": away}
        | searched,
    )


def _desired_speed(s: Situation) -> ca.SX:
    """Return the desired speed [m/s]; at a point at rest, the craft keeps more speed than the current.

    At the speed of a stop, a current from aside would need a hull across the course: the craft would turn beside the
    point and not arrive. In a current from ahead, the thrust of so low a speed would only hold the craft in its place.
    A craft with fins cannot turn at rest, and passes the point at its speed of steerage.
    """
    p = s.p
    least = ca.fmin(ca.fmax(_against(s), FIN_STEERAGE * p["fin_share"] * p["cruise"]), p["cruise"])
    speed = length(s.desired.velocity)
    return ca.if_else(s.desired.arriving, ca.fmax(speed, least), speed)


def _against(s: Situation) -> ca.SX:
    """Return the least speed [m/s] with which a craft arrives in the current that its predicted motion leaves over."""
    return ca.fmax(_OUTRUN * ca.fabs(s.nu[1] - s.x["sway"]), s.x["surge"] - s.nu[0])


def _on_arc(s: Situation, ahead: ca.SX, across: ca.SX) -> ca.SX:
    """Return the largest surge speed [m/s] at which the craft turns tightly enough to reach a point at rest.

    The arc from the craft to a point at the distance d and the bearing β has the radius d/(2 sin β); `ahead` is cos β
    and `across` sin β. A faster craft circles the point; with this bound it turns nearly at rest and comes nearer. The
    speed that the current requires is allowed towards a point ahead.
    """
    distance = ca.sqrt(s.desired.x_e**2 + s.desired.y_e**2)
    rate = planned_yaw_rate(s.p, SLOWEST * s.p["cruise"])
    arc = _TIGHTER * rate * distance / ca.fmax(2 * ca.fabs(across), 1e-3)
    return ca.fmax(arc, _against(s) * ahead)


def _through_water(s: Situation) -> ca.SX:
    """Return the surge speed through the water [m/s]: as the model predicts it if fins turn the craft, else measured.

    The moment of fins follows from this speed, and a craft of `fin_share` 0 does not need it.
    """
    return s.nu[0] + s.p["fin_share"] * (s.x["surge"] - s.nu[0])


def _propelled(s: Situation, surge: ca.SX) -> ca.SX:
    """Return the surge speed through the water [m/s] after this step, by the thrust that `surge` causes and the drag.

    The step is implicit in the drag, as in `drifted`. Fins do not share the propeller's thrust, so it is not reduced.
    """
    p, m, u = s.p, s.p["mass"], s.x["surge"]
    reference = ca.vertcat(ca.fmin(surge, p["cap"]), s.x["sway"], 0, 0)
    free, _ = steered_thrust(reference, s.nu, s.x["integral"], p, s.dt)
    least, most = thrust_bounds(p)
    thrust = ca.fmin(ca.fmax(free[0], least[0]), most[0]) + m[1] * s.x["sway"] * s.nu[3]
    damping = (p["linear_drag"][0] + p["quadratic_drag"][0] * ca.fabs(u)) / m[0]
    return (u + s.dt * thrust / m[0]) / (1 + s.dt * damping)


def _leaves(s: Situation, hull: ca.SX, steering: Steering) -> ca.SX:
    """Return whether the craft goes straight on, because fins alone turn it and a point at rest is inside its circle.

    Such a craft would circle the point for ever. It goes straight on to the distance of `_RUN_IN` turning radii, so
    that it has turned before it comes back, and passes the point on a straight course.
    """
    along, across = -s.desired.x_e, -s.desired.y_e
    tangent = s.desired.tangent
    point = ca.vertcat(tangent[0] * along - tangent[1] * across, tangent[1] * along + tangent[0] * across)
    ahead, left = ca.dot(hull, point), hull[0] * point[1] - hull[1] * point[0]
    aside = steering.radius - ca.fabs(left)
    inside = ahead * ahead + aside * aside < (_INSIDE * steering.radius) ** 2
    near = ca.dot(point, point) < (_RUN_IN * steering.radius) ** 2
    leaves = ca.logic_or(inside, ca.logic_and(ca.logic_and(s.x["away"] > 0, near), ahead < 0))
    return ca.logic_and(ca.logic_and(s.desired.arriving, leaves), s.p["fin_share"] > 0.5)


def _yaw_rate(error: ca.SX, speed: ca.SX, p: Mapping[str, ca.SX]) -> ca.SX:
    # slow enough that half the yaw moment can end the turn at the desired heading
    swing = ca.sqrt(yaw_moment(p, speed) / p["mass"][3] * ca.fabs(error))
    most = ca.fmin(planned_yaw_rate(p, speed), swing)
    return ca.fmin(ca.fmax(p["k_psi"] * error, -most), most)


def _turned(unit: ca.SX, angle: ca.SX) -> ca.SX:
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(unit[0] * c - unit[1] * s, unit[0] * s + unit[1] * c)


def steered_thrust(
    reference: ca.SX, nu: ca.SX, integral: ca.SX, p: Mapping[str, ca.SX], dt: float
) -> tuple[ca.SX, ca.SX]:
    """Return thrust and next integral of the surge, heave and yaw loops; sway has no thrust.

    The loops are those of `velocity_control`. In addition, the thrust cancels the moment μ u v (`Vehicle.munk`) and the
    force m22 v r in surge. The sway speed v is that of the reference, which is the drift through the water: the
    measured sway speed also contains the current, which causes no Munk moment.
    """
    m, limit = p["mass"], p["thrust_limit"]
    error = reference - nu
    gain = ca.vertcat(p["k_v"], 0, p["k_v"], p["k_r"])
    drag = p["linear_drag"] * reference + p["quadratic_drag"] * reference * ca.fabs(reference)
    v = reference[1]
    coriolis = ca.vertcat(-m[1] * v * nu[3], 0, 0, p["munk"] * nu[0] * v)
    driven = ca.vertcat(1, 0, limit[2] > 0, 1)
    free = driven * (drag + m * (gain * error + integral) + coriolis)
    least, most = thrust_bounds(p)
    held = ca.logic_or(free > most, free < least)
    return free, ca.if_else(held, integral, integral + driven * dt * p["k_i"] * error)
