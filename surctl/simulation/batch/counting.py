"""The metrics of a run as CasADi expressions, accumulated at each control step."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from surctl.simulation.metrics import NEAR_TARGET, TUBE

__all__ = ["SUMS", "counted", "modulo", "path_square"]

SUMS = (
    ("sum_square", "m^2", "sum of the squared horizontal distance to the path"),
    ("sum_error", "m^2", "sum of the squared distance to the path outside avoidance"),
    ("count_error", "1", "number of control steps outside avoidance"),
    ("sum_effort", "N", "sum of the magnitude of the horizontal thrust command"),
    ("sum_jump", "N^2", "sum of the squared change of the horizontal thrust command"),
    ("count_saturated", "1", "number of control steps with a thrust command at its limit"),
    ("most_away", "m", "largest horizontal distance to the path"),
    ("most_past", "m", "largest overshoot past the target"),
    ("most_thrust", "1", "largest thrust command as a share of its limit"),
    ("length", "m", "length of the path that the robot travelled"),
)
"""State variables of a run for its metrics: name, unit, meaning."""


def counted(
    old: Mapping[str, ca.SX],
    w: Mapping[str, ca.SX],
    tau: ca.SX,
    status: ca.SX,
    avoiding: ca.SX,
    to_target: ca.SX,
    gap: ca.SX,
    square: ca.SX,
    path_depth: ca.SX,
    on_last: ca.SX,
) -> dict[str, ca.SX]:
    """Return the sums, counts and maxima from which the metrics follow, updated for the present control step.

    `metrics.METRICS` defines the metrics. `square` is the squared distance to the path [m²], `path_depth` its z [m].
    `on_last` is 1 while the robot is on the last segment of its path.
    """
    place, depth = old["plant"][:2], old["plant"][2]
    away = ca.sqrt(square)
    excluded = ca.logic_or(avoiding, ca.logic_and(old["away"], away > TUBE))
    first = old["step"] < 0.5
    thrust, step = tau[:2], place - old["last_place"]
    past = ca.if_else(ca.logic_and(on_last, gap <= NEAR_TARGET), ca.dot(to_target, w["leg"]), 0)
    share = ca.fabs(tau) / w["thrust_limit"]
    return {
        "away": excluded,
        "last_thrust": thrust,
        "sum_square": old["sum_square"] + square,
        "sum_error": old["sum_error"] + ca.if_else(excluded, 0, square + (depth - path_depth) ** 2),
        "count_error": old["count_error"] + ca.logic_not(excluded),
        "sum_effort": old["sum_effort"] + ca.sqrt(ca.sumsqr(thrust)),
        "sum_jump": old["sum_jump"] + ca.if_else(first, 0, ca.sumsqr(thrust - old["last_thrust"])),
        "count_saturated": old["count_saturated"] + modulo(status, 2),
        "most_away": ca.fmax(old["most_away"], away),
        "most_past": ca.fmax(old["most_past"], past),
        "most_thrust": ca.fmax(old["most_thrust"], ca.mmax(share)),
        "length": old["length"] + ca.if_else(first, 0, ca.sqrt(ca.sumsqr(step))),
    }


def path_square(waypoints: ca.SX, leg: ca.SX, point: ca.SX) -> ca.SX:
    """Return the squared distance [m²] from `point` to the path near the current segment (number `leg`).

    The distance is the smallest distance to the current segment and its two neighbours. A segment between two equal
    waypoints counts as a point.
    """
    best = ca.SX(1e30)
    for k in range(waypoints.shape[0] - 1):
        a, b = waypoints[k, :].T, waypoints[k + 1, :].T
        chord = b - a
        along = ca.dot(point - a, chord) / ca.fmax(ca.sumsqr(chord), 1e-12)
        square = ca.sumsqr(point - a - ca.fmin(ca.fmax(along, 0), 1) * chord)
        best = ca.fmin(best, ca.if_else(ca.fabs(leg - k) < 1.5, square, 1e30))
    return best


def modulo(number: ca.SX, period: int) -> ca.SX:
    """Return an integer modulo a period."""
    return number - period * ca.floor(number / period)
