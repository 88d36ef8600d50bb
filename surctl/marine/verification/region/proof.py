"""Proof of a claim about a cruise, straight or turning: search with its cache, rounding, check, verdict in words."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck import Checked, check_document, seal
from surctl.ir.cache import stored_numbers
from surctl.marine.verification.region.claim import RegionClaim
from surctl.marine.verification.region.heading import HeadingClaim
from surctl.marine.verification.region.loop import Steady, offset_slopes, steady_cruise
from surctl.marine.verification.region.rates import LevelRatios, cruise_loop, level_ratios
from surctl.marine.verification.region.steering import SteeringClaim
from surctl.marine.verification.region.synthesis import Candidate, search
from surctl.marine.verification.region.turning import TurningClaim
from surctl.marine.verification.region.turning_search import turning_search
from surctl.marine.verification.region.turning_shells import certificate_of as turning_certificate
from surctl.marine.verification.region.turning_shells import raised, region_of
from surctl.verification.certified import Certified

_DIGITS = 7
_SHRUNK = 2 / 3  # largest share of the offset within which the motion ends, for a region that is of use
_PROGRAMS = 16  # least number of programs of the turning search, if there are as many attempts
_NOT = "not provable for this vehicle and these gains, because"


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

    claim: RegionClaim | HeadingClaim | TurningClaim | SteeringClaim
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
        x, y = self.ultimate_bound
        if isinstance(self.claim, SteeringClaim):
            low, high = self.claim.speed
            return (
                f"proved: from {self.offset:.3g} m beside the path, cross-track error, heading, sway and yaw rate "
                f"converge to 0 at {self.claim.rate:g}/s, at any surge speed from {low:.3g} to {high:.3g} m/s; "
                f"checked in {self.check_seconds:.2f} s"
            )
        rest = "" if self.rest_offset is None else f" ({self.rest_offset:.3g} m for a start at rest)"
        lead = "proved" if self.useful else "proved, but the region hardly shrinks"
        return (
            f"{lead}: from {self.offset:.3g} m beside the path{rest}, the Lyapunov function decays at "
            f"{self.claim.rate:g}/s until the robot is within {x:.3g} m along and {y:.3g} m across the path; "
            f"checked in {self.check_seconds:.2f} s" + ("" if self.ratios is None else f"; {self.ratios.sentence}")
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


def prove_region(claim: RegionClaim, *, attempts: int = 80, seed: int = 0) -> RegionProof:
    """Search for the largest region in which the claim holds, and let the checker decide.

    The search result is stored in the cache of laws, with a key computed from the claim and the source code. The
    checker checks a stored result again in each call.

    Args:
        claim: the claim.
        attempts: number of start values of the search; the one by cells of headings has a third as many convex
            programs, but at least 16 if there are as many attempts.
        seed: seed of the search.
    """
    began = time.perf_counter()
    result, checked = _stored(claim, attempts, seed)
    document = _document(claim, result)
    if document and checked is None:  # a result from the cache is checked again
        checked = check_document(document)
    if checked is None or not checked.accepted:
        reason = result["reason"] if checked is None else checked.reason
        return RegionProof(claim, "unknown", {}, reason, 0.0, (0.0, 0.0), time.perf_counter() - began, 0.0)
    ratios = None if result["ratios"] is None else LevelRatios(*result["ratios"])
    ultimate_bound = (result["ultimate_bound"][0], result["ultimate_bound"][1])
    took = time.perf_counter() - began
    return RegionProof(
        claim, "proved", document, "", result["offset"], ultimate_bound, took, checked.seconds, result["extent"], ratios
    )


def _stored(claim: RegionClaim, attempts: int, seed: int) -> tuple[dict[str, Any], Checked | None]:
    """Return the search result, new or from the cache, and the checker's result if the search ran in this call."""
    checks: list[Checked | None] = []

    def build() -> dict[str, Any]:
        result, checked = _searched(claim, attempts, seed)
        checks.append(checked)
        return result

    result = stored_numbers(
        ("surctl.marine.verification.region", "surctl.verification.conic", "surctl.certcheck"),
        (version("clarabel"), replace(claim, name="", digests=("", "")), attempts, seed),
        build,
        suffix=".region",
    )
    return result, checks[0] if checks else None


def _searched(claim: RegionClaim, attempts: int, seed: int) -> tuple[dict[str, Any], Checked | None]:
    steady = steady_cruise(claim)
    reason = "the search found no quadratic V with this decay rate"
    for document, P in _proposed(claim, steady, attempts, seed):
        checked = check_document(document)
        if checked.accepted:
            motion = document["claim"]["motion"]
            result = {
                "proof": document["proof"],
                "offset": motion["offset_m"],
                "ultimate_bound": motion["ultimate_bound_m"],
                "extent": float(np.sqrt(np.linalg.inv(P)[1, 1])),
                "ratios": level_ratios(cruise_loop(claim), P, claim.rate) if claim.ideal else None,
            }
            return result, checked
        reason = checked.reason
    return {"reason": reason}, None


def _proposed(
    claim: RegionClaim, steady: Steady, attempts: int, seed: int
) -> Iterator[tuple[dict[str, Any], NDArray[np.float64]]]:
    """Yield certificates and their P: those by cells of headings first, because their regions are larger."""
    turning = claim.turning()
    if turning is not None:
        for shaped in turning_search(
            turning, attempts=max(attempts // 3, min(attempts, _PROGRAMS)), seed=seed, slopes=offset_slopes(claim)
        ):
            for one in raised(shaped):
                region = region_of(turning, one)
                stated = claim.document(offset=region.offset, ultimate_bound=region.ultimate_bound)
                yield seal("region", stated, {"proof": region.proof}), one.P
    for candidate in search(claim, steady, attempts=attempts, seed=seed):
        yield certificate_of(claim, steady, candidate), candidate.P


def _document(claim: RegionClaim, result: Mapping[str, Any]) -> dict[str, Any]:
    if "proof" not in result:
        return {}
    x, y = result["ultimate_bound"]
    return seal("region", claim.document(offset=result["offset"], ultimate_bound=(x, y)), {"proof": result["proof"]})


def certificate_of(claim: RegionClaim, steady: Steady, candidate: Candidate) -> dict[str, Any]:
    """Return the certificate of a candidate, with few decimals; its stated numbers are rounded to the safe side."""
    scale = np.max(np.abs(candidate.P))
    P = np.round(candidate.P / scale, _DIGITS + 2) * scale
    P = np.array([[_short(entry) for entry in row] for row in P])
    away = max(map(abs, steady.omega)) / claim.gains["k1"]
    offset = _offset(P, steady, claim)
    covariance = np.linalg.inv(P) * candidate.levels[0]
    ultimate_bound = tuple(
        float(np.ceil(1e4 * (np.sqrt(covariance[k, k]) * 1.0001 + shift)) / 1e4)
        for k, shift in enumerate((away, steady.aside))
    )
    proof = {
        "P": [[float(P[i, j]) for j in range(i + 1)] for i in range(len(P))],
        "floor": candidate.levels[0],
        "hold": _short(max(candidate.hold, 0.0)) if claim.period else 0.0,
        "shells": [
            {"level": level, "multipliers": [_short(factor, 5) for factor in factors]}
            for level, factors in zip(candidate.levels[1:], candidate.multipliers, strict=True)
        ],
    }
    stated = claim.document(offset=offset, ultimate_bound=(ultimate_bound[0], ultimate_bound[1]))
    return seal("region", stated, {"proof": proof})


def _short(value: float, digits: int = _DIGITS + 1) -> float:
    return float(f"{value:.{digits}g}")


def _offset(P: NDArray[np.float64], steady: Steady, claim: RegionClaim) -> float:
    """Return the largest cross-track error, rounded down, with V ≤ 1 at x_e = 0 and the target's velocity.

    V ≤ 1 holds for every steady cruise in `steady`.
    """
    offsets = []
    for omega in steady.omega:
        x = omega / claim.gains["k1"]
        a, b, c = P[1, 1], -abs(P[0, 1] * x), P[0, 0] * x * x - 1  # the worse sign of y
        offsets.append((b + np.sqrt(b * b - a * c)) / a if c < 0 else 0.0)
    return float(np.floor(1e4 * max(min(offsets) - steady.aside, 0.0) * 0.9999) / 1e4)


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
            document = turning_certificate(claim, one)
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
