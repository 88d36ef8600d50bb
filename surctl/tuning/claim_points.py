"""Points where a claim failed for some gains: constraints of the next search."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

from surctl.verification import Verdict, claims, evaluate, falsify

__all__ = ["ClaimPoint", "excess", "expected_to_hold", "refuted_claims"]


@dataclass(frozen=True)
class ClaimPoint:
    """A point of a claim's domain where it failed by more than `threshold`, in the claim's unit."""

    name: str
    values: Mapping[str, float]
    threshold: float


@cache
def expected_to_hold() -> tuple[str, ...]:
    """Names of the paper's claims that are expected not to be refuted; those about braking depend on a vehicle too."""
    return tuple(claim.name for claim in claims() if claim.paper and claim.expected != "refuted")


def refuted_claims(gains: Mapping[str, float], *, seed: int = 0) -> tuple[Verdict, ...]:
    """Verdicts of the claims that should hold with these gains and do not."""
    return _refuted(tuple(sorted(gains.items())), seed)


@lru_cache(maxsize=16)
def _refuted(gains: tuple[tuple[str, float], ...], seed: int) -> tuple[Verdict, ...]:
    """Searched once for the gains at which several rounds end: a search takes seconds."""
    verdicts = (falsify(claim, seed=seed) for claim in claims(dict(gains), expected_to_hold()))
    return tuple(v for v in verdicts if v.verdict == "refuted")


def excess(
    points: Sequence[ClaimPoint], base: Mapping[str, float], sets: Mapping[str, NDArray[np.float64]]
) -> NDArray[np.float64]:
    """(n, points): margin over the claim's threshold for each of n gain sets; -1 where the point left its domain."""
    count = len(next(iter(sets.values())))
    table = np.full((count, len(points)), -1.0)
    for k in range(count if points else 0):
        gains = {**base, **{name: float(values[k]) for name, values in sets.items()}}
        for j, point in enumerate(points):
            margin, inside = evaluate(claims(gains, [point.name])[0], point.values)
            if inside:
                table[k, j] = margin - point.threshold
    return table
