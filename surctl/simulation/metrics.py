"""What a run is judged by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "GONE",
    "LATE",
    "LINK_LOST",
    "METRICS",
    "STANDSTILL",
    "STOPPED_LIMIT",
    "STOPS",
    "MetricSpec",
    "Metrics",
    "avoidance_intervals",
    "path_error",
]

TUBE = 0.10  # [m] |y_e| below which an avoidance interval has ended (*chosen*)
NEAR_TARGET = 1.0  # [m] within which going past the target is overshoot (*chosen*)

STOPPED_LIMIT = 30.0
"""[s] without a break in which a law with senses stands still for want of knowledge, before its run ends (*chosen*)."""

STANDSTILL = 10.0
"""[s] for which a law that gave up in a dead end is watched standing, before its run ends (*chosen*)."""

STOPS = ("time limit", "reached", "collision", "fault", "standstill", "dead end")
"""Why a run can end; a batch gives the position in this tuple."""


LATE, GONE = -10, -11
"""Status of a tick in which a controller outside this process had no command there in time, or is gone for good."""

LINK_LOST = "link lost"
"""Why a run ends whose controller is gone: not among `STOPS`, as no batch has such a controller."""


@dataclass(frozen=True)
class MetricSpec:
    """Unit and meaning of a figure, and which way is better (None: neither)."""

    unit: str
    meaning: str
    better: Literal["low", "high"] | None


METRICS: Mapping[str, MetricSpec] = MappingProxyType(
    {
        "reached": MetricSpec("1", "1 if the run arrived within reach of the target", "high"),
        "collided": MetricSpec("1", "1 if the hull touched something", "low"),
        "time_s": MetricSpec("s", "when the run ended", "low"),
        "min_clearance_m": MetricSpec("m", "least distance hull to obstacle or wall", "high"),
        "path_error_m": MetricSpec(
            "m", "rms distance to the path, three axes, outside avoidance; NaN if all was", "low"
        ),
        "deviation_m": MetricSpec("m", "rms horizontal distance to the path over the whole run", "low"),
        "max_deviation_m": MetricSpec("m", "largest horizontal distance to the path", "low"),
        "missed_corner_m": MetricSpec("m", "largest distance at which the robot passed a corner of the path", "low"),
        "overshoot_m": MetricSpec("m", "largest way past the target along the last leg, within 1 m of it", "low"),
        "length_m": MetricSpec("m", "length of the way flown", "low"),
        "effort_n": MetricSpec("N", "mean of |horizontal thrust command|", "low"),
        "peak_thrust_share": MetricSpec("1", "largest |thrust command| over its limit, any axis", "low"),
        "saturated_share": MetricSpec("1", "share of the ticks with a thrust command at its limit", "low"),
        "thrust_rate_n_per_s": MetricSpec("N/s", "rms rate of change of the horizontal thrust command", "low"),
        "stopped": MetricSpec("1", "why the run ended: " + ", ".join(f"{k} {w}" for k, w in enumerate(STOPS)), None),
    }
)
"""What a batch of runs gives for each run, in the order of its columns."""


@dataclass(frozen=True)
class Metrics:
    """Figures of one run.

    Attributes:
        reached: arrived within the scenario's reach of the target.
        time_s: when the run ended.
        min_clearance_m: smallest distance hull to obstacle, or to a wall once the hull was clear of the walls.
        path_error_m: rms distance to the reference path, all three axes, outside avoidance intervals; NaN if the
            whole run was one.
        deviation_m: rms horizontal distance to the reference path over the whole run, avoidance included.
        length_m: length of the way flown.
        effort_n: mean of |horizontal thrust|.
        stopped_because: one of `STOPS`, or `LINK_LOST`.
        max_deviation_m, missed_corner_m, overshoot_m, peak_thrust_share, saturated_share, thrust_rate_n_per_s: see
            `METRICS`.
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

    def row(self) -> tuple[float, ...]:
        """The figures in the order of `METRICS`."""
        coded = {
            "reached": float(self.reached),
            "collided": float(self.stopped_because == "collision"),
            "stopped": float(STOPS.index(self.stopped_because)),
        }
        return tuple(coded[name] if name in coded else float(getattr(self, name)) for name in METRICS)


def avoidance_intervals(
    avoiding: NDArray[np.float64], distance: NDArray[np.float64], *, tube: float = TUBE
) -> NDArray[np.bool_]:
    """Avoidance intervals (n,): they begin with the command and end only when |y_e| is back within the tube."""
    out = np.zeros(len(avoiding), dtype=bool)
    active = False
    for k, (commanded, away) in enumerate(zip(avoiding > 0.5, distance, strict=True)):
        active = bool(commanded or (active and away > tube))
        out[k] = active
    return out


def path_error(horizontal: NDArray[np.float64], vertical: NDArray[np.float64], excluded: NDArray[np.bool_]) -> float:
    """E_p as rms over the samples that are not excluded: √(mean(Δh² + Δz²)) [m] (E14); NaN if none is left."""
    included = ~excluded
    if not included.any():
        return float("nan")
    return float(np.sqrt(np.mean(horizontal[included] ** 2 + vertical[included] ** 2)))
