"""Search over the starts of the synthesis: limits of the region, floor, how much of the rate disturbances take."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import numpy as np

from surctl.verification.region.claim import RegionClaim
from surctl.verification.region.loop import Steady
from surctl.verification.region.synthesis import Candidate, Start, synthesise

__all__ = ["search"]

_STARTS = tuple(product((0.5, 1.0, 0.3), (0.02, 0.06), (0.28, 0.15, 0.08), (0.1, 0.3, 0.7)))
_COARSE, _FINE = 2, 6  # shells


def search(claim: RegionClaim, steady: Steady, *, attempts: int, seed: int) -> Iterator[Candidate]:
    """Candidates, the largest first, of that many attempts; the same for the same seed."""
    found: list[Candidate] = []
    draw = np.random.default_rng(seed)
    cruise, cap, ahead = claim.cruise, claim.cap, claim.gains["lookahead"]
    wide = ahead * np.sqrt(max((cap / (cruise + steady.omega[1])) ** 2 - 1, 1e-6))
    best: tuple[float, Start] | None = None

    def attempt(start: Start) -> None:
        nonlocal best
        candidate = synthesise(claim, steady, start, shells=_COARSE, rounds=1)
        if candidate is None:
            return
        found.append(candidate)
        if best is None or candidate.offset > best[0]:
            best = candidate.offset, start

    for share, growth, far, floor in _STARTS:  # what is out of reach is found out soon
        attempt(Start(far * cruise / claim.gains["k1"], 0.46 * wide, share, floor, growth))
        if len(found) >= max(attempts // 3, 1):
            break
    for _ in range(attempts - len(found)):
        if best is None:
            break
        kept = best[1]
        factors = np.exp(draw.normal(scale=(0.2, 0.15, 0.15, 0.3, 0.3)))
        attempt(
            replace(
                kept,
                x=kept.x * factors[0],
                y=min(kept.y * factors[1], 0.98 * wide),
                share=min(kept.share * factors[2], 1.0),
                floor=min(kept.floor * factors[3], 0.8),
                growth=kept.growth * factors[4],
            )
        )
    if best is not None:
        for share in (8, 4, 2, 1):  # a lower floor settles nearer to the path: worth a little of the offset
            fine = synthesise(claim, steady, replace(best[1], floor=best[1].floor / share), shells=_FINE, rounds=4)
            if fine is not None and fine.offset > 0.95 * best[0]:
                yield fine
    yield from sorted(found, key=lambda one: -one.offset)[:5]
