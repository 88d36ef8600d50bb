"""What a run counts in each control step (sums, counts, largest values), and the metrics computed from it."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.ir import Layout
from surctl.marine.control import Law
from surctl.marine.control.closing import thrust_bounds
from surctl.marine.guidance import PASSED
from surctl.marine.simulation.batch.structure import ABSENT
from surctl.marine.simulation.metrics import AT_LIMIT, METRICS, MOVING, NEAR_TARGET, SIGN, STOPS, TUBE

Columns = NDArray[np.float64]

VARIATIONS = ("surge_n", "sway_n", "heave_n", "yaw_n_m")
"""Axes of the thrust and their units, as in the names of the metrics."""

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
    *((f"sum_{name}", "N or N m", "sum of the absolute changes of one thrust command") for name in VARIATIONS),
    *((f"signs_{name}", "1", "number of sign changes of one thrust command") for name in VARIATIONS),
    *((f"limited_{name}", "1", "number of control steps with one thrust command at its limit") for name in VARIATIONS),
    ("sum_energy", "N^1.5", "sum of the magnitudes of the force commands to the power 1.5"),
    ("sum_needed", "N", "sum of the drag along the path"),
    ("count_moving", "1", "number of control steps in which the robot moves"),
    ("count_crab", "1", "number of control steps in which the robot moves and does not avoid an obstacle"),
    ("sum_crab", "rad", "sum of the absolute crab angle in these steps"),
    ("sum_heading", "rad^2", "sum of the squared heading error while the robot moves"),
    ("most_crab", "rad", "largest crab angle in these steps"),
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
    tangent: ca.SX,
    path_depth: ca.SX,
    on_last: ca.SX,
) -> dict[str, ca.SX]:
    """Return the sums, counts and maxima from which the metrics follow, updated for the present control step.

    `metrics.METRICS` defines the metrics. `square` is the squared distance to the path [m²], `tangent` the direction of
    its segment (2, 1), `path_depth` its z [m]. `on_last` is 1 while the robot is on the last segment of its path.
    """
    place, depth = old["plant"][:2], old["plant"][2]
    away = ca.sqrt(square)
    excluded = ca.logic_or(avoiding, ca.logic_and(old["away"], away > TUBE))
    first = old["step"] < 0.5
    thrust, step = tau[:2], place - old["last_place"]
    change = ca.if_else(first, 0, ca.fabs(tau - old["last_thrust"]))
    least, largest = thrust_bounds(w)
    limit = ca.if_else(tau > 0, largest, -least)
    signs = ca.if_else(ca.fabs(tau) > SIGN * limit, ca.if_else(tau > 0, 1, -1), old["last_signs"])
    past = ca.if_else(ca.logic_and(on_last, gap <= NEAR_TARGET), ca.dot(to_target, w["leg"]), 0)
    force = ca.fabs(tau[:3])
    # an axis without a limit of its own has no share: its force is 0, or that of a rudder that turns the craft
    limited = limit > 0
    share = ca.if_else(limited, ca.fabs(tau) / ca.if_else(limited, limit, 1), 0)
    return {
        "away": excluded,
        "last_thrust": tau,
        "last_signs": signs,
        "sum_square": old["sum_square"] + square,
        "sum_error": old["sum_error"] + ca.if_else(excluded, 0, square + (depth - path_depth) ** 2),
        "count_error": old["count_error"] + ca.logic_not(excluded),
        "sum_effort": old["sum_effort"] + ca.sqrt(ca.sumsqr(thrust)),
        "sum_jump": old["sum_jump"] + ca.if_else(first, 0, ca.sumsqr(change[:2])),
        "count_saturated": old["count_saturated"] + (status - 2 * ca.floor(status / 2)),
        "most_away": ca.fmax(old["most_away"], away),
        "most_past": ca.fmax(old["most_past"], past),
        "most_thrust": ca.fmax(old["most_thrust"], ca.mmax(share)),
        "length": old["length"] + ca.if_else(first, 0, ca.sqrt(ca.sumsqr(step))),
        **{f"sum_{name}": old[f"sum_{name}"] + change[k] for k, name in enumerate(VARIATIONS)},
        **{
            f"signs_{n}": old[f"signs_{n}"] + (signs[k] * old["last_signs"][k] < -0.5) for k, n in enumerate(VARIATIONS)
        },
        **{f"limited_{n}": old[f"limited_{n}"] + (share[k] >= AT_LIMIT) for k, n in enumerate(VARIATIONS)},
        "sum_energy": old["sum_energy"] + ca.sum1(force * ca.sqrt(force)),
        **_directions(old, w, tangent, excluded),
    }


def _directions(old: Mapping[str, ca.SX], w: Mapping[str, ca.SX], tangent: ca.SX, excluded: ca.SX) -> dict[str, ca.SX]:
    """Return the sums about crab angle, heading error and drag along the path segment with direction `tangent`."""
    psi, u, v = old["plant"][3], old["plant"][4], old["plant"][5]
    hull = ca.vertcat(ca.cos(psi), ca.sin(psi))
    ahead, left = ca.dot(hull, tangent), tangent[0] * hull[1] - tangent[1] * hull[0]  # cos and sin of the heading error
    speed = ca.fmax(u * ahead - v * left - ca.dot(w["current"], tangent), 0)
    moving = u**2 + v**2 > (MOVING * w["cruise"]) ** 2
    counts = ca.logic_and(moving, ca.logic_not(excluded))
    crab, off = ca.fabs(ca.atan2(v, u)), ca.atan2(left, ahead)
    return {
        "sum_needed": old["sum_needed"] + w["linear_drag"][0] * speed + w["quadratic_drag"][0] * speed**2,
        "count_moving": old["count_moving"] + moving,
        "count_crab": old["count_crab"] + counts,
        "sum_crab": old["sum_crab"] + ca.if_else(counts, crab, 0),
        "sum_heading": old["sum_heading"] + ca.if_else(moving, off**2, 0),
        "most_crab": ca.fmax(old["most_crab"], ca.if_else(counts, crab, 0)),
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
    s = {port.name: final[:, state.slice(port.name)][:, 0] for port in state}
    rows, dt = s["step"] + 1, law.dt
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
        **{f"variation_{k}_per_s": s[f"sum_{k}"] / (np.maximum(rows - 1, 1) * dt) for k in VARIATIONS},
        "sign_changes_per_s": np.sum([s[f"signs_{k}"] for k in VARIATIONS], axis=0) / (rows * dt),
        "axis_sign_changes_per_s": np.max([s[f"signs_{k}"] for k in VARIATIONS], axis=0) / (rows * dt),
        "axis_saturated_share": np.max([s[f"limited_{k}"] for k in VARIATIONS], axis=0) / rows,
        "energy_n15_s": s["sum_energy"] * dt,
        "stopped": s["stop"],
    }
    wasted = np.maximum(s["sum_effort"] - s["sum_needed"], 0.0)
    spent = s["sum_effort"] > 0
    columns["wasted_impulse_n_s"] = wasted * dt
    columns["wasted_share"] = np.divide(wasted, s["sum_effort"], out=np.zeros(len(final)), where=spent)
    return np.column_stack([columns[name] for name in METRICS])
