"""Proof of a claim about the heading-steered loop: search for a region, round its numbers, let the checker decide."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck import Rejected, check_document, seal
from surctl.certcheck.heading_cells import check_cells
from surctl.certcheck.heading_claim import read_claim
from surctl.marine.verification.region.heading import HeadingClaim
from surctl.marine.verification.region.heading_search import heave_shape, shapes
from surctl.marine.verification.region.proof import RegionProof
from surctl.marine.verification.region.rates import heading_loop
from surctl.marine.verification.region.ratio import level_ratios

__all__ = ["prove_heading"]

Array = NDArray[np.float64]

_SHARES = (1.0, 0.985, 0.97, 0.94, 0.9, 0.85, 0.8, 0.7, 0.6, 0.5)  # factors on a proposed region's semi-axes


def prove_heading(claim: HeadingClaim, *, rounds: int, cells: int) -> RegionProof:
    """Search for a large region in which the claim holds, and let the checker decide.

    Args:
        claim: the claim.
        rounds: number of enlargements of the region.
        cells: largest number of cells of (ψ, y) in the check, which processes about 400 cells a second.
    """
    began = time.perf_counter()
    heave, last, reason = heave_shape(claim), None, "the search found no quadratic V with this decay rate"
    for P in shapes(claim, rounds=rounds):
        last = P
    if heave is not None and last is not None:
        plain = read_claim(
            claim.document(offset=1.0, beside=1.0, extent=(1.0, 1.0, 1.0), depth=1.0, ultimate_bound=1.0)
        )
        for share in _SHARES:
            P = _rounded(last / share**2)
            try:
                check_cells(plain, P, most=cells)
            except Rejected as rejected:
                reason = str(rejected)
                continue
            document = _certificate(claim, P, _rounded(heave))
            checked = check_document(document)
            if checked.accepted:
                took, motion = time.perf_counter() - began, document["claim"]["motion"]
                ratios = level_ratios(heading_loop(claim), P, claim.rate)
                return RegionProof(
                    claim, "proved", document, "", motion["offset_m"], (motion["ultimate_bound_m"], 0.0), took,
                    checked.seconds, motion["extent"][1], ratios,
                )  # fmt: skip
            reason = checked.reason
    return RegionProof(claim, "unknown", {}, reason, 0.0, (0.0, 0.0), time.perf_counter() - began, 0.0)


def _rounded(P: Array) -> Array:
    return np.array([[float(f"{entry:.9g}") for entry in row] for row in (P + P.T) / 2])


def _down(value: float) -> float:
    return float(np.floor(1e4 * value * 0.99999) / 1e4)


def _certificate(claim: HeadingClaim, P: Array, heave: Array) -> dict[str, Any]:
    # stated numbers are rounded to the safe side
    covariance = np.linalg.inv(P)
    away = max(abs(claim.law["cruise"] - command) / claim.law["k1"] for command in claim.command)
    inner = 1 - P[0, 0] * away**2
    stated = claim.document(
        offset=_down(np.sqrt(max(inner, 0.0) / P[1, 1])),
        beside=_down(1 / np.sqrt(P[1, 1])),
        extent=tuple(_down(np.sqrt(covariance[k, k])) for k in range(3)),
        depth=_down(1 / np.sqrt(heave[0, 0])),
        ultimate_bound=float(np.ceil(1e4 * away + 1e-6) / 1e4),
    )
    proof = {name: [row[: i + 1].tolist() for i, row in enumerate(m)] for name, m in (("P", P), ("P_z", heave))}
    return seal("heading", stated, {"proof": proof})
