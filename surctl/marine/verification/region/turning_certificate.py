"""Certificate of a candidate of the turning search: few decimals, and stated numbers rounded to the safe side."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from surctl.certcheck import seal
from surctl.certcheck.turning_terms import other_moment
from surctl.marine.verification.region.turning import TurningClaim
from surctl.marine.verification.region.turning_behind import split_of
from surctl.marine.verification.region.turning_loop import corner_factors
from surctl.marine.verification.region.turning_shells import TurningCandidate

__all__ = ["Region", "certificate_of", "raised", "region_of"]

_CELLS, _HELD = 48, 32  # cells of headings; with held commands, each of them is checked twice


class Region(NamedTuple):
    """Stated numbers of a region: offsets [m], ultimate bound [m], largest speed [m/s], and the proof."""

    offset: float
    rest_offset: float | None
    ultimate_bound: tuple[float, float]
    fastest: float
    proof: dict[str, Any]


def raised(candidate: TurningCandidate) -> Iterator[TurningCandidate]:
    """Yield the candidate, then with a higher floor: between the headings of the search, a low shell may not hold."""
    for inner in range(len(candidate.growths)):
        yield replace(candidate, levels=candidate.levels[inner:], growths=candidate.growths[inner:])


def region_of(claim: TurningClaim, candidate: TurningCandidate) -> Region:
    """Return the numbers of the region and the proof of a candidate, without the slopes of ω."""
    P = np.array([[float(f"{entry:.9g}") for entry in row] for row in candidate.P])
    rounded = TurningCandidate(P, candidate.levels, candidate.growths, candidate.cruise)
    covariance = np.linalg.inv(P)
    floor = np.sqrt(np.diag(covariance)[:2] * candidate.levels[0]) * 1.0001
    cruise = candidate.cruise
    away = max(map(abs, cruise.moved)) / claim.gains["k1"]
    fastest = claim.cruise + claim.current + np.sqrt(np.linalg.eigvalsh(covariance[2:4, 2:4])[-1])
    start, still = (_down(rounded.start(claim, speed)) for speed in (0.0, -claim.cruise))
    proof = {
        "P": [[float(P[i, j]) for j in range(i + 1)] for i in range(4)],
        "floor": candidate.levels[0],
        "cells": _HELD if claim.period else _CELLS,
        "shells": [
            {"level": level, "growth": growth}
            for level, growth in zip(candidate.levels[1:], candidate.growths, strict=True)
        ],
    }
    if claim.current:
        proof["flow"] = cruise.flow.tolist()
    if claim.behind:
        proof["thrust"] = {"weight": float(P[4, 4]), "split": split_of(claim)}
    return Region(
        start,
        still if still > 0 else None,
        (_up(float(floor[0]) + away), _up(float(floor[1]) + cruise.beside)),
        float(fastest),
        proof,
    )


def certificate_of(claim: TurningClaim, candidate: TurningCandidate) -> dict[str, Any]:
    """Return the certificate of a candidate."""
    region = region_of(claim, candidate)
    apart = np.abs(corner_factors(claim.mass_factor, claim.mass_asymmetry) @ (claim.mass * np.array([1, -1]))).max()
    moment = apart * region.fastest**2 / 2 + float(other_moment(claim.stated, Fraction(region.fastest)))
    stated = claim.document(
        offset=region.offset,
        rest_offset=region.rest_offset,
        ultimate_bound=region.ultimate_bound,
        munk_moment=_up(float(1.0001 * moment)),
    )
    return seal("turning", stated, {"proof": {**region.proof, "trim": list(candidate.cruise.slopes)}})


def _down(value: float) -> float:
    return float(np.floor(1e4 * value * 0.9999) / 1e4)


def _up(value: float) -> float:
    return float(np.ceil(1e4 * value) / 1e4)
