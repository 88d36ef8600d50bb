"""The solver's tolerances for one type of numbers, and how many of those its processors work on at once."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["FLOAT32", "FLOAT64", "LONGEST", "Precision"]

LONGEST = 1e140
"""Largest entry of a normal or a Jacobian in double: squares and their sums must not overflow."""


@dataclass(frozen=True)
class Precision:
    """Tolerances; those of rows are for rows of length 1 and relative to 1 + max |v|.

    Attributes:
        priced: a row missed by no more than this counts as kept by the search.
        rounding: likewise a row that depends on the active ones; missed by more, no point keeps both.
        kept: a row missed by more than this is missed, when an answer is judged.
        parallel: square of the smallest part of a normal outside the span of the active ones.
        pushing: smallest rate at which a multiplier falls that counts.
        cutoff: a row of length 1 that is this near to the span of the rows above it depends on them.
        short: length up to which a row counts as a row of zeros.
        unit: rows whose squared length is this near to 1 are not scaled.
        never, huge: stand for infinity; the largest entry of an answer.
        delta, shrink: of the proximal steps of rung 2.
        sign, noise: what may be left of a multiplier's sign there: relative to the task's rest, to 1 + max |v|.
        pull, growth, gap: of the proximal steps of rung 3.
        margin: room that an opening gets beyond the least one.
        lanes: rows that are worked on side by side, 1, 2 or 4: floats are for processors without vectors.
    """

    priced: float
    rounding: float
    feasibility: float
    parallel: float
    pushing: float
    cutoff: float
    short: float
    unit: float
    never: float
    huge: float
    delta: float
    shrink: float
    sign: float
    noise: float
    pull: float
    growth: float
    gap: float
    margin: float
    lanes: int


FLOAT64 = Precision(
    priced=1e-12,
    rounding=1e-10,
    feasibility=1e-9,
    parallel=1e-16,
    pushing=1e-12,
    cutoff=1e-10,
    short=1e-15,
    unit=1e-14,
    never=1e300,
    huge=1e300,
    delta=1e-3,
    shrink=0.03,
    sign=1e-12,
    noise=1e-17,
    pull=1e3,
    growth=10.0,
    gap=1e-13,
    margin=1e-11,
    lanes=4,
)
"""Of double."""

FLOAT32 = Precision(
    priced=1e-6,
    rounding=2e-5,
    feasibility=1e-4,
    parallel=1e-8,
    pushing=1e-6,
    cutoff=1e-4,
    short=1e-15,
    unit=1e-6,
    never=1e30,
    huge=1e30,
    delta=3e-2,
    shrink=0.3,
    sign=1e-4,
    noise=1e-6,
    pull=10.0,
    growth=4.0,
    gap=1e-6,
    margin=1e-5,
    lanes=1,
)
"""Of float."""
