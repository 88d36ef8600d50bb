"""What a run counts in each control step (sums, counts, largest values), and the metrics computed from it."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.ir import Layout, Port
from surctl.marine.control import Law
from surctl.marine.control.closing import thrust_bounds
from surctl.marine.guidance import PASSED
from surctl.marine.simulation.batch.structure import ABSENT
from surctl.marine.simulation.metrics import AT_LIMIT, METRICS, MOVING, NEAR_TARGET, SIGN, STOPS, TUBE

Columns = NDArray[np.float64]

_AXES = ("surge_n", "sway_n", "heave_n", "yaw_n_m")  # of the thrust, as in the names of metrics

COUNTED = (
    Port("sum_square", (1,), "m^2", "sum of the squared horizontal distance to the path"),
    Port("sum_error", (1,), "m^2", "sum of the squared distance to the path outside avoidance"),
    Port("count_error", (1,), "1", "number of control steps outside avoidance"),
    Port("sum_effort", (1,), "N", "sum of the magnitude of the horizontal thrust command"),
    Port("sum_jump", (1,), "N^2", "sum of the squared change of the horizontal thrust command"),
    Port("count_saturated", (1,), "1", "number of control steps with a thrust command at its limit"),
    Port("most_away", (1,), "m", "largest horizontal distance to the path"),
    Port("most_past", (1,), "m", "largest overshoot past the target"),
    Port("most_thrust", (1,), "1", "largest thrust command as a share of its limit"),
    Port("length", (1,), "m", "length of the path that the robot travelled"),
    Port("sum_change", (4,), "N, N m", "sum of the absolute changes of each thrust command"),
    Port("count_signs", (4,), "1", "number of sign changes of each thrust command"),
    Port("count_limited", (4,), "1", "number of control steps with each thrust command at its limit"),
    Port("sum_energy", (1,), "N^1.5", "sum of the magnitudes of the force commands to the power 1.5"),
    Port("sum_needed", (1,), "N", "sum of the drag along the path"),
    Port("count_moving", (1,), "1", "number of control steps in which the robot moves"),
    Port("count_crab", (1,), "1", "number of control steps in which the robot moves and does not avoid an obstacle"),
    Port("sum_crab", (1,), "rad", "sum of the absolute crab angle in these steps"),
    Port("sum_heading", (1,), "rad^2", "sum of the squared heading error while the robot moves"),
    Port("most_crab", (1,), "rad", "largest crab angle in these steps"),
)
"""State variables of a run for its metrics: sums, counts and largest values, 0 at the start."""


def counted(
    old: Mapping[str, ca.SX],
    w: Mapping[str, ca.SX],
    tau: ca.SX,
    status: ca.SX,
    avoiding: ca.SX,
    to_target: ca.SX,
    gap: ca.SX,
    square: ca.SX,
    tangent: ca.SX,
    path_depth: ca.SX,
    on_last: ca.SX,
) -> dict[str, ca.SX]:
    """Return `COUNTED`, from which the metrics follow, and what it needs of the last step, after a control step.

    `metrics.METRICS` defines the metrics. `square` is the squared distance to the path [m²], `tangent` the direction of
    its segment (2, 1), `path_depth` its z [m]. `on_last` is 1 while the robot is on the last segment of its path.
    """
    place = old["plant"][:2]
    depth, psi, u, v = (old["plant"][k] for k in (2, 3, 4, 5))
    away = ca.sqrt(square)
    excluded = ca.logic_or(avoiding, ca.logic_and(old["away"], away > TUBE))
    first = old["step"] < 0.5
    change = ca.if_else(first, 0, ca.fabs(tau - old["last_thrust"]))
    least, largest = thrust_bounds(w)
    limit = ca.if_else(tau > 0, largest, -least)
    signs = ca.if_else(ca.fabs(tau) > SIGN * limit, ca.if_else(tau > 0, 1, -1), old["last_signs"])
    past = ca.if_else(ca.logic_and(on_last, gap <= NEAR_TARGET), ca.dot(to_target, w["leg"]), 0)
    force = ca.fabs(tau[:3])
    # an axis without a limit of its own has no share: its force is 0, or that of a rudder that turns the craft
    limited = limit > 0
    share = ca.if_else(limited, ca.fabs(tau) / ca.if_else(limited, limit, 1), 0)
    hull = ca.vertcat(ca.cos(psi), ca.sin(psi))
    ahead, left = ca.dot(hull, tangent), tangent[0] * hull[1] - tangent[1] * hull[0]  # cos and sin of the heading error
    speed = ca.fmax(u * ahead - v * left - ca.dot(w["current"], tangent), 0)
    moving = u**2 + v**2 > (MOVING * w["cruise"]) ** 2
    straight = ca.logic_and(moving, ca.logic_not(excluded))
    crab = ca.if_else(straight, ca.fabs(ca.atan2(v, u)), 0)
    added = {
        "sum_square": square,
        "sum_error": ca.if_else(excluded, 0, square + (depth - path_depth) ** 2),
        "count_error": ca.logic_not(excluded),
        "sum_effort": ca.sqrt(ca.sumsqr(tau[:2])),
        "sum_jump": ca.if_else(first, 0, ca.sumsqr(change[:2])),
        "count_saturated": status - 2 * ca.floor(status / 2),
        "length": ca.if_else(first, 0, ca.sqrt(ca.sumsqr(place - old["last_place"]))),
        "sum_change": change,
        "count_signs": signs * old["last_signs"] < -0.5,
        "count_limited": share >= AT_LIMIT,
        "sum_energy": ca.sum1(force * ca.sqrt(force)),
        "count_moving": moving,
        "count_crab": straight,
        "sum_crab": crab,
        "sum_heading": ca.if_else(moving, ca.atan2(left, ahead) ** 2, 0),
    }
    most = {"most_away": away, "most_past": past, "most_thrust": ca.mmax(share), "most_crab": crab}
    return {
        "away": excluded,
        "last_thrust": tau,
        "last_signs": signs,
        **{name: old[name] + value for name, value in added.items()},
        **{name: ca.fmax(old[name], value) for name, value in most.items()},
        "sum_needed": old["sum_needed"] + w["linear_drag"][0] * speed + w["quadratic_drag"][0] * speed**2,
    }


def path_tangent(waypoints: ca.SX, leg: ca.SX, along: ca.SX, on_last: ca.SX) -> ca.SX:
    """Return the unit direction (2, 1) of the current segment, or of the next segment past its end.

    `leg` is the number of the segment among the `waypoints`, and `along` the arc length on it [m].
    """
    chords = [waypoints[k + 1, :].T - waypoints[k, :].T for k in range(waypoints.shape[0] - 1)]
    here, following = chords[0], chords[1]
    for k in range(1, len(chords)):
        there = leg > k - 0.5
        here = ca.if_else(there, chords[k], here)
        following = ca.if_else(there, chords[min(k + 1, len(chords) - 1)], following)
    passed = ca.logic_and(ca.logic_not(on_last), along >= ca.sqrt(ca.sumsqr(here)) * PASSED)
    chord = ca.if_else(passed, following, here)
    return chord / ca.sqrt(ca.fmax(ca.sumsqr(chord), 1e-12))


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


def _crab(law: Law, s: Mapping[str, Columns]) -> dict[str, Columns]:
    # NaN if the law turns the hull to scan, or if the robot never moves
    straight = law.perception is None

    def mean(total: str, count: str) -> Columns:
        average: Columns = np.full(len(s[count]), np.nan)
        return np.divide(s[total], s[count], out=average, where=(s[count] > 0) & straight)

    crab = mean("sum_crab", "count_crab")
    return {
        "crab_angle_deg": np.rad2deg(crab),
        "max_crab_angle_deg": np.rad2deg(np.where(np.isnan(crab), np.nan, s["most_crab"])),
        "heading_error_deg": np.rad2deg(np.sqrt(mean("sum_heading", "count_moving"))),
    }


def metrics_table(law: Law, state: Layout, final: Columns) -> Columns:
    """Return the metrics (n, len(METRICS)) of n runs of a law from their final states (n, …) with this layout."""
    parts = {port.name: final[:, state.slice(port.name)] for port in state}
    s = {name: part[:, 0] for name, part in parts.items()}
    rows, dt = s["step"] + 1, law.dt
    variations = parts["sum_change"] / (np.maximum(rows - 1, 1) * dt)[:, None]
    signs, limited = parts["count_signs"], parts["count_limited"]
    error = np.divide(s["sum_error"], s["count_error"], out=np.full(len(final), np.nan), where=s["count_error"] > 0)
    columns = {
        "reached": (s["stop"] == STOPS.index("reached")).astype(float),
        "collided": (s["stop"] == STOPS.index("collision")).astype(float),
        "time_s": np.round(s["step"] * dt, 9),
        "min_clearance_m": np.where(s["least"] < 0.5 * ABSENT, s["least"], np.inf),
        "path_error_m": np.sqrt(error),
        "deviation_m": np.sqrt(s["sum_square"] / rows),
        "max_deviation_m": s["most_away"],
        "missed_corner_m": np.sqrt(np.maximum(s["missed"], s["corner_behind"])),
        "overshoot_m": s["most_past"],
        "length_m": s["length"],
        "effort_n": s["sum_effort"] / rows,
        "peak_thrust_share": s["most_thrust"],
        "saturated_share": s["count_saturated"] / rows,
        "thrust_rate_n_per_s": np.sqrt(s["sum_jump"] / np.maximum(rows - 1, 1)) / dt,
        **_crab(law, s),
        **{f"variation_{name}_per_s": each for name, each in zip(_AXES, variations.T, strict=True)},
        "sign_changes_per_s": signs.sum(axis=1) / (rows * dt),
        "axis_sign_changes_per_s": signs.max(axis=1) / (rows * dt),
        "axis_saturated_share": limited.max(axis=1) / rows,
        "energy_n15_s": s["sum_energy"] * dt,
        "stopped": s["stop"],
    }
    wasted = np.maximum(s["sum_effort"] - s["sum_needed"], 0.0)
    spent = s["sum_effort"] > 0
    columns["wasted_impulse_n_s"] = wasted * dt
    columns["wasted_share"] = np.divide(wasted, s["sum_effort"], out=np.zeros(len(final)), where=spent)
    return np.column_stack([columns[name] for name in METRICS])
