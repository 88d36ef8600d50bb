"""Rates at which states move inwards on the faces of the box, for the proof that solutions do not leave it."""

from __future__ import annotations

import numpy as np

from surctl.lyapunov.claims import Safety
from surctl.verification.falsifier import sobol
from surctl.verification.formula import values_of

__all__ = ["inward_speeds", "short"]

_SAMPLES = 2048


def inward_speeds(claim: Safety) -> list[float] | None:
    """Return a rate for each face at which the state moves inwards, as samples with B ≤ 0 show; None if one does not.

    In discrete time, there are no rates: the list is empty, or None if the successor of a sample leaves the box.
    """
    d = claim.dynamics
    low, high = (np.concatenate(ends) for ends in zip(d.box, d.ranges, strict=True))
    names, speeds = [v.name for v in d.variables], list[float]()
    wide = low[:, None] + (high - low)[:, None] * sobol(len(low), _SAMPLES, 0)
    if d.discrete:
        barrier, *after = values_of((claim.function, *d.rates), dict(zip(names, wide, strict=True)))
        ends = zip(after, *d.box, strict=True)
        leaves = np.any([(x < bottom) | (x > top) for x, bottom, top in ends], axis=0)
        return None if np.any(leaves & (barrier <= 0)) else speeds
    for k, rate in enumerate(d.rates):
        for end, sign in ((low[k], 1.0), (high[k], -1.0)):
            points = wide.copy()
            points[k] = end
            barrier, moved = values_of((claim.function, rate), dict(zip(names, points, strict=True)))
            least = float((sign * moved[barrier <= 0]).min(initial=1.0))
            if not least > 0:
                return None
            speeds.append(short(1e-3 * least))
    return speeds


def short(value: float, *, digits: int = 3, up: bool = False) -> float:
    """Return a positive number of few digits, not above `value` (not below it if `up`); 1 for 0."""
    if value == 0:
        return 1.0
    size = 10.0 ** (np.floor(np.log10(value)) - digits + 1)
    count = np.ceil(value / size) if up else np.floor(value / size)
    return float(f"{count * size:.6g}")
