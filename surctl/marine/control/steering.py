"""What a craft without sway force can do: turning radius, yaw rate, sway drift, stopping, motion along an arc.

Such a craft is steered by its heading and its speed. In a turn at the yaw rate r and the surge speed u, no thruster
carries the centripetal force, so the craft drifts outwards at the sway speed v at which the sway drag balances it: Yv v
+ Yvv v² = m u r, with `centripetal` m = m11 + Yur + Yr/U: the fins of a torpedo carry a part of it. Two limits follow
for the yaw rate that a law may plan:

1. The drift angle v/u stays below the gain `sideslip`.
2. The drift causes the moment μ u v, which turns the craft further into the turn: the Munk moment (m22 − m11) u v and
   the lift of body and fins, with `munk` μ = m22 − m11 + Nuv + Nv/U. The yaw moment that ends the turn must exceed it,
   so only the share `_MUNK_SHARE` of the largest yaw moment may be needed for it.

If the fins carry more than the centripetal force (m < 0), the craft drifts inwards, and the moment μ u v acts against
the turn: it counts as further damping in yaw.

The turning radius is the cruise speed divided by the smallest of these yaw rates and the yaw rate that the drag in yaw
allows (`closing.yaw_limit`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca

from surctl.marine.control.closing import yaw_limit
from surctl.marine.vehicle import Vehicle

_MUNK_SHARE = 0.5
"""Share of the largest yaw moment that the Munk moment of a planned turn may reach (*chosen*)."""

SLOWEST = 0.25
"""Share of the cruise speed below which neither drift angle nor yaw-rate limit change with the speed (*chosen*).

At lower speeds the drift angle says little: the craft turns nearly on the spot.
"""

FIN_STEERAGE = 0.6
"""Least share of the speed during a turn for a craft whose yaw moment comes from fins alone (*chosen*)."""

_LEAST_RATE = 1e-3  # [rad/s] a planned yaw rate is at least this, so that the turning radius is finite


@dataclass(frozen=True)
class Steering:
    """Abilities of a craft that is steered by heading and speed, as expressions in the law's parameters.

    Attributes:
        deceleration: deceleration by reverse thrust along the hull, the share `brake` of the limit [m/s²].
        radius: turning radius at the cruise speed [m].
        lookahead: look-ahead distance [m]: the gain `lookahead`, or the turning radius if that is larger. A course
            that changes over a shorter distance than the turning radius cannot be followed.
        wait: distance behind the target point at which the target stops [m], at least the look-ahead distance.
    """

    deceleration: ca.SX
    radius: ca.SX
    lookahead: ca.SX
    wait: ca.SX

    def guided(self, p: Mapping[str, ca.SX]) -> dict[str, ca.SX]:
        """Return the parameters of path following, with look-ahead and waiting distance of this craft.

        The adaptation gain of guidance `alos` is scaled by 1/lookahead², which keeps the damping of its loop.
        """
        longer = p["lookahead"] / self.lookahead
        gamma = p["alos_gamma"] * longer * longer
        return {**p, "lookahead": self.lookahead, "wait": self.wait, "alos_gamma": gamma}


def yaw_moment(p: Mapping[str, ca.SX], speed: ca.SX) -> ca.SX:
    """Return the largest yaw moment [N m] at a surge speed [m/s], at most that at the cruise speed.

    The share `fin_share` of the moment at the cruise speed comes from fins and grows with the square of the speed.
    """
    ratio = ca.fmin(ca.fmax(speed, 0) / p["cruise"], 1)
    return p["thrust_limit"][3] * (1 - p["fin_share"] * (1 - ratio * ratio))


def steerage(p: Mapping[str, ca.SX]) -> ca.SX:
    """Return the least share of the speed that a turn keeps: a craft that steers by fins alone needs speed to turn."""
    return ca.fmax(p["steerage"], FIN_STEERAGE * p["fin_share"])


def planned_yaw_rate(p: Mapping[str, ca.SX], speed: ca.SX) -> ca.SX:
    """Return the largest yaw rate [rad/s] that a law may plan at a surge speed [m/s]; see the module."""
    u = ca.fmax(speed, SLOWEST * p["cruise"])
    munk = ca.fabs(p["munk"]) * u
    moment = yaw_moment(p, u)
    drift = ca.fmin(p["sideslip"] * u, _MUNK_SHARE * moment / ca.fmax(munk, 1e-6))
    sideways = p["linear_drag"][1] * drift + p["quadratic_drag"][1] * drift * drift
    inwards = ca.fmax(-p["centripetal"], 0) * u / ca.fmax(p["linear_drag"][1], 1e-6)
    damping = p["linear_drag"][3] + ca.fmax(p["munk"] * u * inwards, 0)
    linear = ca.vertcat(p["linear_drag"][:3], damping)
    turn = yaw_limit({**p, "linear_drag": linear, "thrust_limit": ca.vertcat(p["thrust_limit"][:3], moment)})
    return ca.fmax(ca.fmin(sideways / ca.fmax(ca.fabs(p["centripetal"]) * u, 1e-6), turn), _LEAST_RATE)


def steering_of(p: Mapping[str, ca.SX]) -> Steering:
    """Return the abilities of the craft in the law's parameters."""
    radius = p["cruise"] / planned_yaw_rate(p, p["cruise"])
    lookahead = ca.fmax(p["lookahead"], radius)
    return Steering(
        p["brake"] * p["thrust_limit"][0] / p["mass"][0], radius, lookahead, ca.fmax(p["wait"], 2 * lookahead)
    )


def turning_radius(vehicle: Vehicle, gains: Mapping[str, float], speed: float) -> float:
    """Return the radius [m] of the turn that a law may plan at a cruise speed u > 0 [m/s]; see the module."""
    vehicle = vehicle.at_speed(speed)
    model = {name: getattr(vehicle, name) for name in ("mass", "quadratic_drag", "thrust_limit")}
    own = {"fin_share": vehicle.fin_share(speed), "munk": vehicle.munk(speed)}
    own |= {"centripetal": vehicle.centripetal(speed)}
    numbers = {**model, **own, "linear_drag": vehicle.drag_at(speed), "sideslip": gains["sideslip"], "cruise": speed}
    p = {name: ca.SX(ca.DM(value)) for name, value in numbers.items()}
    return speed / float(planned_yaw_rate(p, ca.SX(speed)))


@dataclass(frozen=True)
class Moving:
    """Predicted motion of the craft: place relative to its present place, direction of the hull, and velocity.

    Attributes:
        place: (2, 1) [m] in {E}.
        hull: (2, 1) unit vector of the hull in {E}.
        nu: (3, 1) surge speed, sway speed [m/s] and yaw rate [rad/s].
        travelled: distance travelled [m].
        along: part of the surge speed that a current carries [m/s]; the craft turns by the rest.
    """

    place: ca.SX
    hull: ca.SX
    nu: ca.SX
    travelled: ca.SX
    along: ca.SX | float = 0.0


def drifted(v: ca.SX, u: ca.SX, r: ca.SX, p: Mapping[str, ca.SX], step: ca.SX | float) -> ca.SX:
    """Return the sway speed through the water [m/s] after one step [s], from centripetal force and sway drag.

    The step is implicit in the drag, so it is stable for any length.
    """
    damping = (p["linear_drag"][1] + p["quadratic_drag"][1] * ca.fabs(v)) / p["mass"][1]
    return (v - step * p["centripetal"] / p["mass"][1] * u * r) / (1 + step * damping)


def moved(
    now: Moving, course: ca.SX, speed: ca.SX, p: Mapping[str, ca.SX], *, step: ca.SX, gain: ca.SX, stream: ca.SX
) -> Moving:
    """Return the motion after one step of prediction, while the craft turns to a course and takes up a speed.

    The yaw rate follows the heading error within the yaw acceleration that half the yaw moment gives, and within
    `planned_yaw_rate`. The sway speed through the water follows from `drifted`.

    Args:
        course, speed: unit vector (2, 1) in {E}, and speed on it [m/s], that the craft is to reach.
        step, gain: length of the step [s], and heading gain [1/s], at most 1/`step`.
        stream: (2, 1) velocity [m/s] in {E} that is added to the motion through the water.
    """
    u, v, r = now.nu[0], now.nu[1], now.nu[2]
    ahead = ca.dot(now.hull, course)
    aside = now.hull[0] * course[1] - now.hull[1] * course[0]
    error = ca.if_else(ahead > 0, aside, ca.if_else(aside < 0, -1, 1))
    water = u - now.along
    most, swing = planned_yaw_rate(p, water), step * 0.5 * yaw_moment(p, water) / p["mass"][3]
    turn = ca.fmin(ca.fmax(gain * error, -most), most)
    r = ca.fmin(ca.fmax(turn, r - swing), r + swing)
    change = step * p["brake"] * p["thrust_limit"][0] / p["mass"][0]
    u = ca.fmin(ca.fmax(speed * ca.fmax(ahead, steerage(p)), u - change), u + change)
    v = drifted(v, u, r, p, step)
    # a rotation by 2 atan(half) needs no trigonometric function
    half = 0.5 * step * r
    c, s = (1 - half * half) / (1 + half * half), 2 * half / (1 + half * half)
    hull = ca.vertcat(c * now.hull[0] - s * now.hull[1], s * now.hull[0] + c * now.hull[1])
    shift = step * (ca.vertcat(u * hull[0] - v * hull[1], u * hull[1] + v * hull[0]) + stream)
    travelled = now.travelled + step * ca.sqrt(u * u + v * v)
    return Moving(now.place + shift, hull, ca.vertcat(u, v, r), travelled, now.along)
