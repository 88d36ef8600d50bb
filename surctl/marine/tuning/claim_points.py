"""Points at which a claim about the law failed for some gains; there, the claim constrains the next search."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

from surctl.marine.control import PATH_FOLLOWING, law_source
from surctl.marine.simulation import Case
from surctl.marine.verification.library import claims
from surctl.verification.counterexample import evaluate
from surctl.verification.falsifier import falsify
from surctl.verification.verdict import Verdict

__all__ = ["ClaimPoint", "excess", "expected_to_hold", "refuted_claims"]


@dataclass(frozen=True)
class ClaimPoint:
    """A point of a claim's domain at which the claim failed by more than `threshold` (in the unit of the claim)."""

    name: str
    values: Mapping[str, float]
    threshold: float


@cache
def expected_to_hold() -> tuple[str, ...]:
    """Names of the paper's claims that should not be refuted; claims about braking need a vehicle and are omitted."""
    return tuple(claim.name for claim in claims() if claim.paper and claim.expected != "refuted")


def refuted_claims(gains: Mapping[str, float], cases: Sequence[Case], *, seed: int = 0) -> tuple[Verdict, ...]:
    """Return the verdicts of the claims that should hold but are refuted with these gains.

    The claims are about path following by equations (8)-(12): there are none if no case's law contains it.
    """
    if not any(PATH_FOLLOWING in law_source(case.law).parts and case.guidance == "los" for case in cases):
        return ()
    return _refuted(tuple(sorted(gains.items())), seed)


@lru_cache(maxsize=16)
def _refuted(gains: tuple[tuple[str, float], ...], seed: int) -> tuple[Verdict, ...]:
    # cached, because several rounds may end at the same gains and the falsifier takes seconds
    verdicts = (falsify(claim, seed=seed) for claim in claims(dict(gains), expected_to_hold()))
    return tuple(v for v in verdicts if v.verdict == "refuted")


def excess(
    points: Sequence[ClaimPoint], base: Mapping[str, float], sets: Mapping[str, NDArray[np.float64]]
) -> NDArray[np.float64]:
    """Return by how much the claims exceed their thresholds, as an array (n gain sets, points).

    The value is -1 for a point outside the claim's domain.
    """
    count = len(next(iter(sets.values())))
    table = np.full((count, len(points)), -1.0)
    for k in range(count if points else 0):
        gains = {**base, **{name: float(values[k]) for name, values in sets.items()}}
        for j, point in enumerate(points):
            margin, inside = evaluate(claims(gains, [point.name])[0], point.values)
            if inside:
                table[k, j] = margin - point.threshold
    return table
