"""Proof of a claim about a cruise or a heading loop: search with its cache, rounding, check, verdict in words."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import Any

import numpy as np

from surctl.certcheck import PATIENCE, Checked, check_document, seal
from surctl.ir.cache import stored_numbers
from surctl.lyapunov.claims import Stability
from surctl.lyapunov.decide import prove_by_slopes
from surctl.lyapunov.equilibrium import linearisation
from surctl.lyapunov.rays import hugged
from surctl.lyapunov.slope_search import form_of, slope_candidate
from surctl.marine.verification.region.nominal import LevelRatios, level_ratios
from surctl.marine.verification.region.steering import SteeringClaim
from surctl.marine.verification.region.turning import TurningClaim
from surctl.marine.verification.region.turning_search import turning_search
from surctl.marine.verification.region.turning_shells import certificate_of, raised
from surctl.units import towards
from surctl.verification.certified import Certified

_SHRUNK = 2 / 3  # largest share of the offset within which the motion ends, for a region that is of use
_NOT = "not provable for this vehicle and these gains, because"
_SECONDS = 300.0  # limit of the processor time of the search for a heading loop, which ends much earlier
_LEVELS = (0.99, 0.97, 0.94, 0.9, 0.8, 0.65)  # that are tried, relative to the proposed one


@dataclass(frozen=True)
class RegionProof(Certified):
    """The result of an attempt to prove a region claim.

    Attributes:
        claim: the claim.
        offset: largest |y_e| [m] in the certified region for x_e = 0 and a vehicle with the target's velocity; 0 if the
            verdict is unknown.
        ultimate_bound: |x_e|, |y_e| [m] within which every motion from the region ends.
        seconds: total time of the attempt [s].
        check_seconds: duration of the check by the independent checker [s].
        extent: largest |y_e| [m] of any point of the region.
        ratios: ratio of the certified level to the least level with a counterexample, and ratio of the certified level
            to the level of thrust saturation; None if the falsifier has no model of the claim.
        rest_offset: largest |y_e| [m] in the region for x_e = 0 and a vehicle at rest; None if the claim states none.
        by: name of the stronger claim that the certificate states, if it is not the claim itself.
    """

    claim: TurningClaim | SteeringClaim
    offset: float
    ultimate_bound: tuple[float, float]
    seconds: float
    check_seconds: float
    extent: float = 0.0
    ratios: LevelRatios | None = None
    rest_offset: float | None = None
    by: str = ""

    @property
    def useful(self) -> bool:
        """Whether the claim is proved and the motion ends within two thirds of the distance from which it starts."""
        return self.verdict == "proved" and self.ultimate_bound[1] <= _SHRUNK * self.offset

    @property
    def sentence(self) -> str:
        """Return the verdict in one line."""
        if self.verdict != "proved":
            return f"unknown: {self.reason}"
        if self.by:
            return f"{replace(self, by='').sentence}; by the stronger claim {self.by}"
        beside = f"from {towards(self.offset, up=False)} m beside the path"
        if isinstance(self.claim, SteeringClaim):
            low, high = self.claim.speed
            return (
                f"proved: {beside}, cross-track error, heading, sway and yaw rate "
                f"converge to 0 at {self.claim.rate:g}/s, at any surge speed from {low:.3g} to {high:.3g} m/s; "
                f"checked in {self.check_seconds:.2f} s"
            )
        rest = "not" if self.rest_offset is None else f"{towards(self.rest_offset, up=False)} m"  # missions start so
        rest = f" ({rest} for a start at rest)" if isinstance(self.claim, TurningClaim) else ""
        x, y = (towards(bound, up=True) for bound in self.ultimate_bound)
        lead = "proved" if self.useful else "proved, but the region hardly shrinks"
        return (
            f"{lead}: {beside}{rest}, the Lyapunov function decays at {self.claim.rate:g}/s until the robot is within "
            f"{x} m along and {y} m across the path; checked in {self.check_seconds:.2f} s"
            + ("" if self.ratios is None else f"; {self.ratios.sentence}")
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain data for JSON."""
        return {
            **self.decided(),
            "offset_m": self.offset,
            "rest_offset_m": self.rest_offset,
            "ultimate_bound_m": list(self.ultimate_bound),
            "extent_m": self.extent,
            "level_ratios": None if self.ratios is None else self.ratios._asdict(),
            "rate_per_s": self.claim.rate,
            "useful": self.useful,
            "by_stronger_claim": self.by or None,
            "seconds": self.seconds,
            "check_seconds": self.check_seconds,
        }


def prove_turning(claim: TurningClaim, *, attempts: int = 40, seed: int = 0) -> RegionProof:
    """Search for the largest region in which the claim holds, and let the checker decide.

    The search result is stored in the cache of laws, with a key computed from the claim and the source code. The
    checker checks a stored result again in each call.

    Args:
        claim: the claim.
        attempts: number of convex programs of the search.
        seed: seed of the search.
    """
    began = time.perf_counter()
    checks: list[Checked] = []

    def build() -> dict[str, Any]:
        return _searched(claim, attempts, seed, checks)

    result = stored_numbers(
        ("surctl.marine.verification.region", "surctl.verification.conic", "surctl.certcheck"),
        (version("clarabel"), replace(claim, name="", digests=("", "")), attempts, seed),
        build,
        suffix=".region",
    )
    if "reason" in result:
        return RegionProof(claim, "unknown", {}, result["reason"], 0.0, (0.0, 0.0), time.perf_counter() - began, 0.0)
    document = seal("turning", claim.document(**result["stated"]), {"proof": result["proof"]})
    checked = checks[0] if checks else check_document(document)  # a result from the cache is checked again
    if not checked.accepted:
        return RegionProof(claim, "unknown", {}, checked.reason, 0.0, (0.0, 0.0), time.perf_counter() - began, 0.0)
    x, y = result["stated"]["ultimate_bound"]
    return RegionProof(
        claim, "proved", document, "", result["stated"]["offset"], (x, y), time.perf_counter() - began,
        checked.seconds, result["extent"], None if result["ratios"] is None else LevelRatios(*result["ratios"]),
        rest_offset=result["stated"]["rest_offset"],
    )  # fmt: skip


def _searched(claim: TurningClaim, attempts: int, seed: int, checks: list[Checked]) -> dict[str, Any]:
    """Return the proof and the stated numbers that the checker accepts, or the reason why there are none."""
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
        motion, moment = document["claim"]["motion"], document["claim"]["vehicle"]["munk_moment_nm"]
        if moment and moment >= claim.yaw_limit:
            reason = f"{_NOT} the Munk moment of {moment:g} N m exceeds the yaw thrust of {claim.yaw_limit:g} N m"
            continue
        if claim.rest and motion["rest_offset_m"] is None:
            reason = f"{_NOT} no region that the search found contains a vehicle at rest"
            continue
        checks.append(checked)
        return {
            "proof": document["proof"],
            "stated": {
                "offset": motion["offset_m"], "rest_offset": motion["rest_offset_m"],
                "ultimate_bound": motion["ultimate_bound_m"], "munk_moment": moment,
            },
            "extent": float(np.sqrt(np.linalg.inv(one.P)[1, 1])),
            "ratios": level_ratios(document) if claim.ideal else None,
        }  # fmt: skip
    return {"reason": reason}


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


def prove_steering(claim: SteeringClaim) -> RegionProof:
    """Search for a region that is large across the path, by the slope rule, and let the checker decide."""
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
