"""Decide whether a claim is proved, refuted or unknown: falsifier, then prover, then the independent checker."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck import check_document
from surctl.errors import EmptyDomain, InputError
from surctl.verification.claim import Claim, VerdictWord
from surctl.verification.counterexample import Counterexample, Oracle, build_oracle
from surctl.verification.doubtful import exceeding, special_points, undefined_at
from surctl.verification.falsifier import Search, search, sobol
from surctl.verification.formula import Statement
from surctl.verification.proving import certain_excess, prove
from surctl.verification.verdict import Verdict

_INSIDE = 1e-9  # first distance by which a point is moved into the domain, in the constraint's unit
_MOVES = 6
_TOLERANCES, _HELP = (1e-6, 1e-3), 0.1  # tried for an undecided claim; share of its time limit for each
_SAMPLES = 1024  # in the search for points at which the claim has no value
_MOVED = 16  # number of the worst violating points that are moved


def decide(
    claim: Claim,
    *,
    samples: int = 4096,
    starts: int = 16,
    seed: int = 0,
    time_limit: float = 20.0,
    progress: Callable[[str], None] | None = None,
) -> Verdict:
    """Try to refute and then to prove a claim; if both fail, report the boxes that remain undecided.

    `refuted`: interval arithmetic confirms that the counterexample lies in the domain and that left exceeds right; or
    a side of a claim that was written in the claim grammar has no value at a point of the domain.
    `proved`: `surctl.certcheck` accepts the certificate. The certificate states a slack by which the left side may
    exceed the right side: 0, or the rounding error that the claim's tolerance allows.

    Args:
        claim: the claim.
        samples: number of samples of the falsifier.
        starts: number of local searches of the falsifier.
        seed: seed of the falsifier's samples.
        time_limit: time limit of the prover [s]. For an undecided claim of a file, the reason names a tolerance with
            which it is proved; the search for one takes at most a fifth of the limit.
        progress: function that receives a line of progress from time to time.

    Raises:
        InputError: `falsify` rejects its arguments.

    Example:
        >>> from surctl.marine.verification import claims
        >>> from surctl.verification import decide
        >>> for claim in claims(names=["v1-printed", "v1-corrected"]):
        ...     print(claim.name, decide(claim, samples=256, starts=2).verdict)
        v1-printed refuted
        v1-corrected proved
    """
    verdict = _decide(claim, samples, starts, seed, time_limit, progress)
    if verdict.verdict != "unknown" or claim.exact is None:
        return verdict
    began = time.perf_counter()
    wider = [each for each in _TOLERANCES if each > claim.tolerance]
    for tolerance in wider:
        looser = replace(claim, tolerance=tolerance)
        if _decide(looser, samples, starts, seed, _HELP * time_limit, None).verdict == "proved":
            text = f"proved with tolerance = {tolerance:g}, the share of the larger side by which left may exceed right"
            break
    else:
        text = f"not proved with tolerance = {wider[-1]:g} either" if wider else ""
    reason = "; ".join(filter(None, (verdict.open_ends, text)))
    return replace(verdict, open_ends=reason, seconds=verdict.seconds + time.perf_counter() - began)


def _decide(
    claim: Claim, samples: int, starts: int, seed: int, time_limit: float, progress: Callable[[str], None] | None
) -> Verdict:
    began = time.perf_counter()
    empty: EmptyDomain | None = None
    try:
        outcome = search(claim, samples=samples, starts=starts, seed=seed)
    except EmptyDomain as error:  # it may be shown to be empty
        empty, nothing = error, np.zeros((len(claim.variables), 0))
        outcome = Search(Verdict(claim, "not refuted", None, -math.inf, 0.0, 0.0, 0, 0), nothing, nothing)
    verdict = outcome.verdict
    sure = None
    if verdict.counterexample is not None:
        sure = confirmed(claim, verdict.counterexample, outcome.violating)
    if sure is None and claim.exact is not None:
        sure = _hidden(claim, claim.exact, outcome.points, verdict.threshold, seed)
    if sure is not None:
        word: VerdictWord = "refuted"
        return replace(verdict, verdict=word, counterexample=sure, seconds=time.perf_counter() - began)
    # rounding may explain a violation, or its point may lie outside the domain: the claim may still be true
    verdict = replace(verdict, verdict="not refuted", counterexample=None)
    proof = prove(claim, time_limit=time_limit, slack=verdict.threshold, progress=progress)
    reason = proof.remaining
    if proof.certificate is not None:
        checked = check_document(proof.certificate)
        if checked.accepted:
            return replace(
                verdict, verdict="proved", certificate=proof.certificate, vacuous=checked.vacuous,
                seconds=time.perf_counter() - began,
            )  # fmt: skip
        reason = f"the checker rejects the proof: {checked.reason}"
    if empty is not None:
        raise empty
    seconds = time.perf_counter() - began
    return replace(verdict, verdict="unknown", open_ends=reason, open_boxes=proof.open_boxes, seconds=seconds)


def _hidden(
    claim: Claim, exact: Statement, points: NDArray[np.float64], threshold: float, seed: int
) -> Counterexample | None:
    """Return a counterexample of an exact statement that doubles hide; None if none is found."""
    points = np.column_stack([points, special_points(exact), *(claim.point(w) for w in claim.witnesses)])
    excess = exceeding(exact, points, threshold)
    if excess is not None:
        return Counterexample(excess[0], excess[1], claim.unit)
    lower, width = claim.lower[:, None], (claim.upper - claim.lower)[:, None]
    undefined = undefined_at(exact, np.hstack([points, lower + width * sobol(len(lower), _SAMPLES, seed)]))
    if undefined is None:
        return None
    return Counterexample(undefined[0], math.nan, claim.unit, undefined=undefined[1])


def confirmed(claim: Claim, worst: Counterexample, violating: NDArray[np.float64]) -> Counterexample | None:
    """Return a counterexample that interval arithmetic confirms, or None if no counterexample is confirmed.

    Candidates are the worst point, then the other violating points (n, k), then the worst few violating points, moved
    slightly into the domain. The worst point alone may not suffice: on the branch cut of atan2, interval arithmetic
    yields all angles.
    """
    points = np.column_stack([claim.point(worst.values), violating])
    try:
        excess = certain_excess(claim, points)
    except InputError:  # an operation is missing in the claim grammar: accept the floating-point result
        return worst
    if excess[0] > 0:
        return worst
    best = int(np.argmax(excess))
    if excess[best] > 0:
        return replace(worst, values=claim.values(points[:, best]), margin=float(excess[best]), origin="search")
    oracle = build_oracle(claim)
    for point in points.T[:_MOVED]:
        moved = np.column_stack([_moved(oracle, point, _INSIDE * 10.0**k) for k in range(_MOVES)])
        excess = certain_excess(claim, moved)
        best = int(np.argmax(excess > 0))  # the smallest move that suffices
        if excess[best] > 0:
            return replace(worst, values=claim.values(moved[:, best]), margin=float(excess[best]))
    return None


def _moved(oracle: Oracle, point: NDArray[np.float64], by: float) -> NDArray[np.float64]:
    """Return the point after a move into the domain, so that every constraint holds with margin `by` if possible."""
    claim = oracle.claim
    at = np.clip(point, claim.lower, claim.upper)
    for _ in range(_MOVES):
        values, slopes = oracle.sides(at[:, None])[2][:, 0], oracle.jacobian(at)
        short = np.flatnonzero(values > -by)
        if not short.size:
            break
        rows = slopes[short]
        if not np.all(np.isfinite(rows)):
            break
        step = np.linalg.lstsq(rows, -by - values[short], rcond=None)[0]
        at = np.clip(at + step, claim.lower, claim.upper)
    return at
