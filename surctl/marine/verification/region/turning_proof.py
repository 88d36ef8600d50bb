"""Proof of a claim about a turning cruise: search, rounding of the numbers, and the decision of the checker."""

from __future__ import annotations

import time

import numpy as np

from surctl.certcheck import check_document
from surctl.marine.verification.region.proof import RegionProof
from surctl.marine.verification.region.turning import TurningClaim
from surctl.marine.verification.region.turning_certificate import certificate_of, raised
from surctl.marine.verification.region.turning_search import turning_search

__all__ = ["prove_turning"]

_NOT = "not provable for this vehicle and these gains, because"


def prove_turning(claim: TurningClaim, *, attempts: int = 40, seed: int = 0) -> RegionProof:
    """Search for the largest region in which the claim holds, and let the checker decide.

    Args:
        claim: the claim.
        attempts: number of convex programs of the search.
        seed: seed of the search.
    """
    began = time.perf_counter()
    reason = f"{_NOT} the search found no quadratic V with this decay rate{_further(claim)}"
    for candidate in turning_search(claim, attempts=attempts, seed=seed):
        for one in raised(candidate):
            document = certificate_of(claim, one)
            checked = check_document(document)
            if checked.accepted:
                break
        if not checked.accepted:
            reason = f"{_NOT} {checked.reason}"
            continue
        stated = document["claim"]
        if (moment := stated["vehicle"]["munk_moment_nm"]) >= claim.yaw_limit:
            reason = f"{_NOT} the Munk moment of {moment:g} N m exceeds the yaw thrust of {claim.yaw_limit:g} N m"
            continue
        if claim.rest and stated["motion"]["rest_offset_m"] is None:
            reason = f"{_NOT} no region that the search found contains a vehicle at rest"
            continue
        x, y = stated["motion"]["ultimate_bound_m"]
        return RegionProof(
            claim, "proved", document, "", stated["motion"]["offset_m"], (x, y), time.perf_counter() - began,
            checked.seconds, float(np.sqrt(np.linalg.inv(candidate.P)[1, 1])),
            rest_offset=stated["motion"]["rest_offset_m"],
        )  # fmt: skip
    return RegionProof(claim, "unknown", {}, reason, 0.0, (0.0, 0.0), time.perf_counter() - began, 0.0)


def _further(claim: TurningClaim) -> str:
    """Return what makes a claim with a current, thrust lag or held commands hard to prove, as a part of a sentence."""
    parts, k_v = [], claim.gains["k_v"]
    if claim.current:
        drag = np.array(claim.linear) + np.array(claim.quadratic) * (2 * claim.cruise + claim.current)
        force = float((claim.drag_factor[1] * claim.current * drag).max())
        parts.append(f"the current changes the drag by up to {force:.2g} N, at any time if the heading turns")
    if claim.lag or claim.period:
        late = claim.lag + claim.period
        parts.append(
            f"thrust comes up to {late:.2g} s after its command, and the velocity loop answers in {1 / k_v:.2g} s"
        )
    return "; " + "; ".join(parts) if parts else ""
