"""Names, units and meanings of a run's metrics (counted in `batch.counting`), and of the reasons why it ends."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

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


def avoidance_intervals(
    avoiding: NDArray[np.float64], distance: NDArray[np.float64], *, tube: float = TUBE
) -> NDArray[np.bool_]:
    """Return for each of n samples whether it is in an avoidance interval.

    An interval begins when avoidance begins. It ends after avoidance, when the distance to the path is at most `tube`
    [m].
    """
    out = np.zeros(len(avoiding), dtype=bool)
    active = False
    for k, (commanded, away) in enumerate(zip(avoiding > 0.5, distance, strict=True)):
        active = bool(commanded or (active and away > tube))
        out[k] = active
    return out


def path_error(horizontal: NDArray[np.float64], vertical: NDArray[np.float64], excluded: NDArray[np.bool_]) -> float:
    """Return the position error E_p = √(mean(Δh² + Δz²)) [m] over the samples that are not excluded.

    Δh and Δz are the horizontal and the vertical distance to the path; erratum E14 explains the formula. The error is
    NaN if all samples are excluded.
    """
    included = ~excluded
    if not included.any():
        return float("nan")
    return float(np.sqrt(np.mean(horizontal[included] ** 2 + vertical[included] ** 2)))
