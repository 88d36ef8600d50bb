"""Search over the start values of the synthesis, which `Start` describes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice, product

import numpy as np

from surctl.marine.verification.region.claim import RegionClaim
from surctl.marine.verification.region.loop import Steady
from surctl.marine.verification.region.synthesis import (
    Candidate,
    Proposal,
    Start,
    finished,
    levels_of,
    proposed,
    synthesise,
    widened,
)

__all__ = ["search"]

_STARTS = tuple(product((0.5, 1.0, 0.3), (0.02, 0.06), (0.28, 0.15, 0.08), (0.1, 0.3, 0.7)))
_COARSE, _FINE = 2, 6  # number of shells in a coarse and in a fine proof
_INVARIANT_FLOOR = 0.95  # floor of a region that is invariant but has almost no decay


def search(claim: RegionClaim, steady: Steady, *, attempts: int, seed: int) -> Iterator[Candidate]:
    """Yield candidates from `attempts` start values, the largest region first; equal seeds give equal candidates.

    In a current, the candidate that keeps the vehicle closest to the path comes first; `attempts` and `seed` then have
    no effect.
    """
    if claim.current:
        yield from _holding(claim, steady)
        return
    candidates: list[Candidate] = []
    passed_over: list[Proposal] = []
    draw = np.random.default_rng(seed)
    cruise, cap, ahead = claim.cruise, claim.cap, claim.gains["lookahead"]
    wide = ahead * np.sqrt(max((cap / (cruise + steady.omega[1])) ** 2 - 1, 1e-6))
    best: tuple[float, Start] | None = None
    refining = False

    def attempt(start: Start) -> None:
        nonlocal best
        proposal = proposed(claim, steady, start, shells=_COARSE)
        if proposal is None:
            return
        if refining and best is not None and proposal.offset <= best[0]:
            passed_over.append(proposal)  # it cannot be the best candidate: find its multipliers only if needed
            return
        candidate = finished(claim, steady, proposal)
        if candidate is None:
            return
        candidates.append(candidate)
        if best is None or candidate.offset > best[0]:
            best = candidate.offset, start

    for share, growth, far, floor in _STARTS:  # infeasible starts fail early
        attempt(Start(far * cruise / claim.gains["k1"], 0.46 * wide, share, floor, growth))
        if len(candidates) >= max(attempts // 3, 1):
            break
    refining = True
    for _ in range(attempts - len(candidates)):
        if best is None:
            break
        base = best[1]
        factors = np.exp(draw.normal(scale=(0.2, 0.15, 0.15, 0.3, 0.3)))
        attempt(
            replace(
                base,
                x=base.x * factors[0],
                y=min(base.y * factors[1], 0.98 * wide),
                share=min(base.share * factors[2], 1.0),
                floor=min(base.floor * factors[3], 0.8),
                growth=base.growth * factors[4],
            )
        )
    if best is not None:
        for share in (8, 4, 2, 1):  # a lower floor ends nearer to the path, for a slightly smaller offset
            fine = synthesise(claim, steady, replace(best[1], floor=best[1].floor / share), shells=_FINE, rounds=4)
            if fine is not None and fine.offset > 0.95 * best[0]:
                yield fine
    yield from islice(_largest(claim, steady, [*candidates, *passed_over]), 5)


def _largest(claim: RegionClaim, steady: Steady, candidates: list[Candidate | Proposal]) -> Iterator[Candidate]:
    for one in sorted(candidates, key=lambda one: -one.offset):
        candidate = finished(claim, steady, one) if isinstance(one, Proposal) else one
        if candidate is not None:
            yield candidate


def _holding(claim: RegionClaim, steady: Steady) -> Iterator[Candidate]:
    """Yield regions that keep the vehicle close to the path in a current, in order of rising distance.

    The function first computes the matrix P of the smallest invariant region, which is a few times as large as the
    static deflection by the force error. Then the function tries larger regions with this P.
    """
    velocity_gain = claim.model[0] * claim.gains["k_v"]
    x, y = (
        steady.total / (velocity_gain * claim.gains["k1"]),
        steady.total * claim.gains["lookahead"] / (velocity_gain * claim.cruise),
    )
    regions: list[tuple[float, Candidate]] = []
    for wide, far, growth in product((2.0, 2.3, 2.8), (2.3, 2.6, 3.0), (0.08, 0.1)):
        close = synthesise(
            claim, steady, Start(far * x, wide * y, 1.0, _INVARIANT_FLOOR, growth, 0.05), shells=1, rounds=2
        )
        if close is None:
            continue
        along, across = np.sqrt(np.diag(np.linalg.inv(close.P))[:2] * _INVARIANT_FLOOR)
        away = max(map(abs, steady.omega)) / claim.gains["k1"]
        extent = np.ceil(100 * max(along + away, across + steady.aside))  # of extents in the same cm, the widest region
        for level in (2.0, 3.0, 4.0, 6.0, 9.0):
            wider = widened(claim, steady, close.P / level, levels_of(_INVARIANT_FLOOR / level, _FINE))
            if wider is None:
                break
            regions.append((float(extent - wider.offset), wider))
    yield from (one for _, one in sorted(regions, key=lambda pair: pair[0]))
