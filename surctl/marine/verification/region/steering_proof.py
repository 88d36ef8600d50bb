"""Proof of a claim about the heading loop of a craft without sway force, by the slope rule."""

from __future__ import annotations

import time

import numpy as np

from surctl.certcheck import PATIENCE
from surctl.lyapunov.claims import Stability
from surctl.lyapunov.decide import prove_by_slopes
from surctl.lyapunov.equilibrium import linearisation
from surctl.lyapunov.rays import hugged
from surctl.lyapunov.slope_search import form_of, slope_candidate
from surctl.marine.verification.region.proof import RegionProof
from surctl.marine.verification.region.steering import SteeringClaim

_SECONDS = 300.0  # limit of the processor time of the search, which ends much earlier
_LEVELS = (0.99, 0.97, 0.94, 0.9, 0.8, 0.65)  # that are tried, relative to the proposed one
_NOT = "not provable for this vehicle and these gains, because"


def prove_steering(claim: SteeringClaim) -> RegionProof:
    """Search for a region that is large across the path, and let the checker decide."""
    began = time.perf_counter()
    d, reason = claim.dynamics(), f"{_NOT} the search found no quadratic V with this decay rate"
    linear = linearisation(d)
    candidate = None
    if linear.verdict == "stable":
        candidate = slope_candidate(d, linear, claim.rate, seconds=_SECONDS, toward="y_e")
    for share in _LEVELS if candidate is not None else ():
        assert candidate is not None
        form = form_of(candidate.function, d.names)
        level = float(np.floor(1e4 * share * claim.largest_level(form)) / 1e4)
        p = form / level
        stated = Stability(hugged(d, candidate.function, level), candidate.function, level, claim.rate)
        tried = time.perf_counter()
        decision = prove_by_slopes(stated, time_limit=PATIENCE, feedbacks=candidate.feedbacks)
        if decision.verdict == "proved":
            offset = float(np.floor(1e4 * 0.9999 / np.sqrt(p[0, 0])) / 1e4)
            now, beside = time.perf_counter(), float(np.sqrt(np.linalg.inv(p)[0, 0]))
            return RegionProof(
                claim, "proved", dict(decision.document), "", offset, (0.0, 0.0), now - began, now - tried, beside
            )
        reason = f"{_NOT} {decision.reason}"
    return RegionProof(claim, "unknown", {}, reason, 0.0, (0.0, 0.0), time.perf_counter() - began, 0.0)
