"""Proof of a claim about braking: compute its tables, and let the independent checker decide."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

from surctl.certcheck import check_document, seal
from surctl.marine.guidance.braking import LEAST_THRUST
from surctl.marine.verification.braking.claim import BrakingClaim
from surctl.marine.verification.braking.distance import distance_table, figures, largest_obstacle
from surctl.verification.certified import Certified

__all__ = ["BrakingProof", "prove_braking"]

_SHARES = (LEAST_THRUST, 0.7, 0.55, 0.45, 0.3)  # of the thrust limit, as braking forces to try


@dataclass(frozen=True)
class BrakingProof(Certified):
    """The result of an attempt to prove a claim about braking.

    Attributes:
        claim: the claim.
        range_needed: detection range [m] that is enough at the robot's highest speed in the claim, for the fastest
            obstacle.
        seconds: total time of the attempt [s].
        check_seconds: duration of the check by the independent checker [s].
    """

    claim: BrakingClaim
    range_needed: float
    seconds: float
    check_seconds: float

    @property
    def sentence(self) -> str:
        """Return the verdict in one line."""
        if self.verdict != "proved":
            return f"unknown: {self.reason}"
        claim, quickest = self.claim, max(self.claim.obstacles)
        what = f"obstacles that approach at up to {quickest:g} m/s" if quickest else "obstacles at rest"
        return (
            f"proved: no contact with {what}, provided they are detected at {self.range_needed:.2f} m or more "
            f"(robot at {max(claim.speeds):g} m/s); checked in {self.check_seconds:.2f} s"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain data for JSON."""
        return {
            **self.decided(),
            "range_needed_m": self.range_needed,
            "seconds": self.seconds,
            "check_seconds": self.check_seconds,
        }


def prove_braking(claim: BrakingClaim) -> BrakingProof:
    """Compute the tables of the claim and let the checker decide.

    For a law of a vehicle with unequal masses, smaller braking forces are tried too: the velocity loop commands them at
    a smaller excess over the speed bound, and the proof may count on any force up to the guaranteed one.
    """
    began = time.perf_counter()
    first = _attempt(claim, began)
    if first.verdict == "proved" or claim.law is None or claim.ratio == 1:
        return first
    forces = [share * claim.law.limit for share in _SHARES]
    attempts = (_attempt(claim.braking_with(force), began) for force in forces if force != claim.brakes.least)
    return next((attempt for attempt in attempts if attempt.verdict == "proved"), first)


def _attempt(claim: BrakingClaim, began: float) -> BrakingProof:
    limit = largest_obstacle(claim)
    if max(claim.obstacles) >= limit:
        at = f"obstacles that approach at {limit:.4g} m/s or more" if limit > 0 else "any obstacle, even at rest"
        reason = f"the braking force does not exceed drag and disturbances, so braking guarantees nothing for {at}"
        return BrakingProof(claim, "unknown", {}, reason, 0.0, time.perf_counter() - began, 0.0)
    tables = [distance_table(claim, obstacle) for obstacle in claim.obstacles]
    table = figures(claim, tables)
    distances = [{"knots": t.knots.tolist(), "slopes": t.slopes.tolist()} for t in tables]
    document = seal("braking", claim.document(table, limit), {"proof": {"distances": distances}})
    checked = check_document(document)
    good = checked.accepted
    return BrakingProof(
        claim,
        "proved" if good else "unknown",
        document if good else {},
        checked.reason,
        table["needed_m"][-1][-1] if good else 0.0,
        time.perf_counter() - began,
        checked.seconds,
    )
