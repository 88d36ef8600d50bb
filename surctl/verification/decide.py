"""Proved, refuted or unknown: the falsifier first, then the prover, and the checker has the last word."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck import check_document
from surctl.errors import InputError
from surctl.verification.claim import Claim
from surctl.verification.counterexample import Counterexample
from surctl.verification.falsifier import search
from surctl.verification.oracle import Oracle, build_oracle
from surctl.verification.proving import certain_excess, prove
from surctl.verification.verdict import Verdict

__all__ = ["decide"]

_INSIDE = 1e-9  # how far a point is moved into the domain at first, in a constraint's own unit
_MOVES = 6
_MOVED = 16  # of the worst violating points


def decide(
    claim: Claim,
    *,
    samples: int = 4096,
    starts: int = 16,
    seed: int = 0,
    time_limit: float = 20.0,
    progress: Callable[[str], None] | None = None,
) -> Verdict:
    """Prove or refute a claim, or say what is left open.

    `refuted`: at the counterexample, by interval arithmetic, left exceeds right and the point lies in the domain.
    `proved`: `surctl.certcheck` accepts the certificate; left may exceed right by the slack that the certificate
    names: 0, or what counts as rounding by the claim's tolerance.

    Args:
        claim: the claim.
        samples: of the falsifier.
        starts: local searches of the falsifier.
        seed: of the falsifier.
        time_limit: of the prover [s].
        progress: told a line now and then.

    Raises:
        InputError: as `falsify`.

    Example:
        >>> from surctl.verification import claims, decide
        >>> for claim in claims(names=["v1-printed", "v1-corrected"]):
        ...     print(claim.name, decide(claim, samples=256, starts=2).verdict)
        v1-printed refuted
        v1-corrected proved
    """
    began = time.perf_counter()
    outcome = search(claim, samples=samples, starts=starts, seed=seed)
    verdict = outcome.verdict
    if verdict.counterexample is not None:
        sure = _confirmed(claim, verdict.counterexample, outcome.violating)
        if sure is not None:
            return replace(verdict, counterexample=sure, seconds=time.perf_counter() - began)
        # by rounding alone, or outside by rounding: it does not count, and the claim may still be true
        verdict = replace(verdict, verdict="not refuted", counterexample=None)
    proof = prove(claim, time_limit=time_limit, slack=verdict.threshold, progress=progress)
    reason = proof.remaining
    if proof.certificate is not None:
        checked = check_document(proof.certificate)
        if checked.accepted:
            return replace(
                verdict, verdict="proved", certificate=proof.certificate, seconds=time.perf_counter() - began
            )
        reason = f"the checker rejects the proof: {checked.reason}"
    seconds = time.perf_counter() - began
    return replace(verdict, verdict="unknown", open_ends=reason, open_boxes=proof.open_boxes, seconds=seconds)


def _confirmed(claim: Claim, worst: Counterexample, violating: NDArray[np.float64]) -> Counterexample | None:
    """A counterexample that intervals confirm: the worst one, any other violating point (n, k), or one of the worst few
    moved into the domain by a hair.

    At the worst point alone intervals may say nothing: on the branch cut of atan2 they hold all angles.
    """
    points = np.column_stack([claim.point(worst.values), violating])
    try:
        excess = certain_excess(claim, points)
    except InputError:  # operations that the claim grammar does not have: the numbers stand as they are
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
        best = int(np.argmax(excess > 0))  # the least move that will do
        if excess[best] > 0:
            return replace(worst, values=claim.values(moved[:, best]), margin=float(excess[best]))
    return None


def _moved(oracle: Oracle, point: NDArray[np.float64], by: float) -> NDArray[np.float64]:
    """The point moved into the box and against every constraint that is not met by `by`."""
    claim = oracle.claim
    at = np.clip(point, claim.lower, claim.upper)
    for _ in range(_MOVES):
        values, slopes = np.asarray(oracle.sides(at)[2]).reshape(-1), np.asarray(oracle.slopes(at)[1])
        short = np.flatnonzero(values > -by)
        if not short.size:
            break
        rows = slopes[short]
        if not np.all(np.isfinite(rows)):
            break
        step = np.linalg.lstsq(rows, -by - values[short], rcond=None)[0]
        at = np.clip(at + step, claim.lower, claim.upper)
    return at
