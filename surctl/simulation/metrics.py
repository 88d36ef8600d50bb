"""What a run is judged by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Metrics", "path_error", "settled_avoidance"]

TUBE = 0.10  # [m] |y_e| below which an avoidance interval has ended (*chosen*)


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
        stopped_because: `reached`, `collision`, `time limit` or `fault`.
    """

    reached: bool
    time_s: float
    min_clearance_m: float
    path_error_m: float
    deviation_m: float
    length_m: float
    effort_n: float
    stopped_because: str


def settled_avoidance(
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
    kept = ~excluded
    if not kept.any():
        return float("nan")
    return float(np.sqrt(np.mean(horizontal[kept] ** 2 + vertical[kept] ** 2)))
