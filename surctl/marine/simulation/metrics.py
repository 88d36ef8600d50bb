"""Metrics of runs: names, units, meanings; what a run counts in each control step for them; the reasons of its end."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.ir import Layout, Port
from surctl.marine.control import Law
from surctl.marine.control.closing import thrust_bounds
from surctl.marine.guidance import PASSED

Columns = NDArray[np.float64]

ABSENT = 1e30  # [m] clearance of an absent obstacle
TUBE = 0.10  # [m] an avoidance interval ends only when |y_e| is at most this (*chosen*)
NEAR_TARGET = 1.0  # [m] distance from the target within which overshoot is measured (*chosen*)

MOVING = 0.25
"""Share of the cruise speed: a crab angle has no meaning at lower speeds (*chosen*)."""

SIGN = 0.01
"""Share of the limit: a thrust command below it has no sign (*chosen*)."""

AT_LIMIT = 1.0 - 1e-9
"""Share of its limit from which a thrust command counts as at its limit."""

STOPPED_LIMIT = 30.0
"""Uninterrupted standstill [s] after which a run ends, if a law with perception lacks map knowledge (*chosen*)."""

STANDSTILL = 10.0
"""Time [s] between the moment at which the law gives up in a dead end and the end of its run (*chosen*)."""

STOPS = ("time limit", "reached", "collision", "fault", "standstill", "dead end")
"""Reasons why a run can end; a batch returns the index in this tuple."""


LATE, GONE = -10, -11
"""Status of a control step whose external controller sent its command too late (LATE) or has disconnected (GONE)."""

LINK_LOST = "link lost"
"""Reason why a run ends if its external controller has disconnected; batches have none, so `STOPS` omits it."""


@dataclass(frozen=True)
class MetricSpec:
    """Definition of a metric: unit, meaning, and whether low or high values are better (None if neither is)."""

    unit: str
    meaning: str
    better: Literal["low", "high"] | None = "low"


METRICS: Mapping[str, MetricSpec] = MappingProxyType(
    {
        "reached": MetricSpec("1", "1 if the robot reached the target", "high"),
        "collided": MetricSpec("1", "1 if the hull touched an obstacle or a wall"),
        "time_s": MetricSpec("s", "time at which the run ended"),
        "min_clearance_m": MetricSpec("m", "smallest distance between the hull and an obstacle or a wall", "high"),
        "path_error_m": MetricSpec(
            "m", "rms distance to the path in three axes outside avoidance; NaN without such samples"
        ),
        "deviation_m": MetricSpec("m", "rms horizontal distance to the path over the whole run"),
        "max_deviation_m": MetricSpec("m", "largest horizontal distance to the path"),
        "missed_corner_m": MetricSpec("m", "largest distance at which the robot passed a path corner"),
        "overshoot_m": MetricSpec("m", "largest overshoot past the target along the last leg, while on this leg"),
        "length_m": MetricSpec("m", "length of the path that the robot travelled"),
        "effort_n": MetricSpec("N", "mean magnitude of the horizontal thrust command"),
        "peak_thrust_share": MetricSpec("1", "largest ratio of a thrust command to its limit, over all axes"),
        "saturated_share": MetricSpec("1", "share of control steps with a thrust command at its limit"),
        "thrust_rate_n_per_s": MetricSpec("N/s", "rms rate of change of the horizontal thrust command"),
        "crab_angle_deg": MetricSpec(
            "deg", "mean angle between hull and velocity, moving and outside avoidance; NaN if the hull scans"
        ),
        "max_crab_angle_deg": MetricSpec(
            "deg", "largest angle between hull and velocity, moving and outside avoidance"
        ),
        "heading_error_deg": MetricSpec("deg", "rms angle between hull and path segment while moving"),
        "variation_surge_n_per_s": MetricSpec("N/s", "total variation of the surge command per second"),
        "variation_sway_n_per_s": MetricSpec("N/s", "total variation of the sway command per second"),
        "variation_heave_n_per_s": MetricSpec("N/s", "total variation of the heave command per second"),
        "variation_yaw_n_m_per_s": MetricSpec("N m/s", "total variation of the yaw command per second"),
        "sign_changes_per_s": MetricSpec("1/s", "sign changes of thrust commands above 1 % of their limit"),
        "axis_sign_changes_per_s": MetricSpec("1/s", "the same for the axis whose command changes sign most often"),
        "axis_saturated_share": MetricSpec(
            "1", "share of control steps at the limit, for the axis that is at its limit most often"
        ),
        "energy_n15_s": MetricSpec(
            "N^1.5 s", "sum of |force|^1.5 over axes and time; the ideal power of a jet is proportional to it"
        ),
        "wasted_impulse_n_s": MetricSpec("N s", "horizontal thrust beyond drag along the path, over time"),
        "wasted_share": MetricSpec("1", "wasted impulse as a share of the impulse of the horizontal thrust"),
        "stopped": MetricSpec("1", "why the run ended: " + ", ".join(f"{k} {w}" for k, w in enumerate(STOPS)), None),
    }
)
"""The metrics that a batch returns for each run, in the order of its columns."""


@dataclass(frozen=True)
class Metrics:
    """The metrics of one run, as `METRICS` defines them.

    Attributes:
        min_clearance_m: negative also for a run that starts inside a wall, which is no collision.
        stopped_because: reason why the run ended, one of `STOPS`, or `LINK_LOST`.
        crab_angle_deg, max_crab_angle_deg, heading_error_deg: while the robot moves; avoidance intervals do not count
            for the crab angle, because the robot avoids obstacles by sway. They are NaN if the law uses sonars,
            because it turns the hull to scan, or if the robot never moves.
        wasted_impulse_n_s: ∫ |τ| dt − ∫ D(s) dt ≥ 0, with the horizontal thrust command τ, the surge drag D of the
            law's model, and the speed s ≥ 0 through the water along the path segment. A robot that starts and ends at
            rest, on the path and with the hull along it, needs just the second integral.
    """

    reached: bool
    time_s: float
    min_clearance_m: float
    path_error_m: float
    deviation_m: float
    length_m: float
    effort_n: float
    stopped_because: str
    max_deviation_m: float
    missed_corner_m: float
    overshoot_m: float
    peak_thrust_share: float
    saturated_share: float
    thrust_rate_n_per_s: float
    crab_angle_deg: float
    max_crab_angle_deg: float
    heading_error_deg: float
    variation_surge_n_per_s: float
    variation_sway_n_per_s: float
    variation_heave_n_per_s: float
    variation_yaw_n_m_per_s: float
    sign_changes_per_s: float
    axis_sign_changes_per_s: float
    axis_saturated_share: float
    energy_n15_s: float
    wasted_impulse_n_s: float
    wasted_share: float

    def row(self) -> tuple[float, ...]:
        """Return the values of the metrics in the order of `METRICS`."""
        coded = {
            "reached": float(self.reached),
            "collided": float(self.stopped_because == "collision"),
            "stopped": float(STOPS.index(self.stopped_because)),
        }
        return tuple(coded[name] if name in coded else float(getattr(self, name)) for name in METRICS)


def avoidance_intervals(avoiding: NDArray[np.float64], distance: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return for each of n samples whether it is in an avoidance interval.

    An interval begins when avoidance begins. It ends after avoidance, when the distance to the path is at most `TUBE`
    [m].
    """
    out = np.zeros(len(avoiding), dtype=bool)
    active = False
    for k, (commanded, away) in enumerate(zip(avoiding > 0.5, distance, strict=True)):
        active = bool(commanded or (active and away > TUBE))
        out[k] = active
    return out


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

    `METRICS` defines the metrics. `square` is the squared distance to the path [m²], `tangent` the direction of
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


def metrics_table(law: Law, state: Layout, final: Columns) -> Columns:
    """Return the metrics (n, len(METRICS)) of n runs of a law from their final states (n, …) with this layout."""
    parts = {port.name: final[:, state.slice(port.name)] for port in state}
    s = {name: part[:, 0] for name, part in parts.items()}
    rows, dt = s["step"] + 1, law.dt
    variations = parts["sum_change"] / (np.maximum(rows - 1, 1) * dt)[:, None]
    signs, limited = parts["count_signs"], parts["count_limited"]

    def mean(total: str, count: str, *, of: bool = True) -> Columns:
        average: Columns = np.full(len(final), np.nan)
        return np.divide(s[total], s[count], out=average, where=(s[count] > 0) & of)

    # the angles are NaN if the law turns the hull to scan, or if the robot never moves
    straight = law.perception is None
    crab = mean("sum_crab", "count_crab", of=straight)
    columns = {
        "reached": (s["stop"] == STOPS.index("reached")).astype(float),
        "collided": (s["stop"] == STOPS.index("collision")).astype(float),
        "time_s": np.round(s["step"] * dt, 9),
        "min_clearance_m": np.where(s["least"] < 0.5 * ABSENT, s["least"], np.inf),
        "path_error_m": np.sqrt(mean("sum_error", "count_error")),
        "deviation_m": np.sqrt(s["sum_square"] / rows),
        "max_deviation_m": s["most_away"],
        "missed_corner_m": np.sqrt(np.maximum(s["missed"], s["corner_behind"])),
        "overshoot_m": s["most_past"],
        "length_m": s["length"],
        "effort_n": s["sum_effort"] / rows,
        "peak_thrust_share": s["most_thrust"],
        "saturated_share": s["count_saturated"] / rows,
        "thrust_rate_n_per_s": np.sqrt(s["sum_jump"] / np.maximum(rows - 1, 1)) / dt,
        "crab_angle_deg": np.rad2deg(crab),
        "max_crab_angle_deg": np.rad2deg(np.where(np.isnan(crab), np.nan, s["most_crab"])),
        "heading_error_deg": np.rad2deg(np.sqrt(mean("sum_heading", "count_moving", of=straight))),
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
