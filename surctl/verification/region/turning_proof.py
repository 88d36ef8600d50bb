"""Proof of a claim about a turning cruise: search, rounding of the numbers, and the decision of the checker."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np

from surctl.certcheck import check_document, seal
from surctl.certcheck.turning_terms import other_moment
from surctl.verification.region.proof import RegionProof
from surctl.verification.region.turning import TurningClaim
from surctl.verification.region.turning_loop import corner_factors
from surctl.verification.region.turning_search import turning_search
from surctl.verification.region.turning_shells import TurningCandidate

__all__ = ["prove_turning"]

_PROOF_CELLS = 48
_NOT = "not provable for this vehicle and these gains, because"


def prove_turning(claim: TurningClaim, *, attempts: int = 40, seed: int = 0) -> RegionProof:
    """Search for the largest region in which the claim holds, and let the checker decide.

    Args:
        claim: the claim.
        attempts: number of start values of the search.
        seed: seed of the search.
    """
    began = time.perf_counter()
    reason = f"{_NOT} the search found no quadratic V with this decay rate"
    for candidate in turning_search(claim, attempts=attempts, seed=seed):
        for raised in _raised(candidate):
            document = certificate_of(claim, raised)
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


def _raised(candidate: TurningCandidate) -> Iterator[TurningCandidate]:
    """Yield the candidate, then with a higher floor: between the headings of the search, a low shell may not hold."""
    for inner in range(len(candidate.growths)):
        yield replace(candidate, levels=candidate.levels[inner:], growths=candidate.growths[inner:])


def certificate_of(claim: TurningClaim, candidate: TurningCandidate) -> dict[str, Any]:
    """Return the certificate of a candidate, with few decimals; its stated numbers are rounded to the safe side."""
    P = np.array([[float(f"{entry:.9g}") for entry in row] for row in candidate.P])
    rounded = TurningCandidate(P, candidate.levels, candidate.growths, candidate.cruise)
    covariance = np.linalg.inv(P)
    floor = np.sqrt(np.diag(covariance)[:2] * candidate.levels[0]) * 1.0001
    away = max(map(abs, candidate.cruise.omega)) / claim.gains["k1"]
    fastest = claim.cruise + np.sqrt(np.linalg.eigvalsh(covariance[2:, 2:])[-1])
    apart = np.abs(corner_factors(claim.mass_factor, claim.mass_asymmetry) @ (claim.mass * np.array([1, -1]))).max()
    moment = apart * fastest**2 / 2 + float(other_moment(claim.stated(), Fraction(float(fastest))))
    start, still = (_down(rounded.start(claim, speed)) for speed in (0.0, -claim.cruise))
    stated = claim.document(
        offset=start,
        rest_offset=still if still > 0 else None,
        ultimate_bound=(_up(float(floor[0]) + away), _up(float(floor[1]))),
        munk_moment=_up(float(1.0001 * moment)),
    )
    proof = {
        "P": [[float(P[i, j]) for j in range(i + 1)] for i in range(4)],
        "floor": candidate.levels[0],
        "trim": list(candidate.cruise.slopes),
        "cells": _PROOF_CELLS,
        "shells": [
            {"level": level, "growth": growth}
            for level, growth in zip(candidate.levels[1:], candidate.growths, strict=True)
        ],
    }
    return seal("turning", stated, {"proof": proof})


def _down(value: float) -> float:
    return float(np.floor(1e4 * value * 0.9999) / 1e4)


def _up(value: float) -> float:
    return float(np.ceil(1e4 * value) / 1e4)
