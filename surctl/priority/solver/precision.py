"""Tolerances of the solver for one number type, and how many rows it processes side by side."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["FLOAT32", "FLOAT64", "LONGEST", "Precision"]

LONGEST = 1e140
"""Largest entry of a normal or a Jacobian in double: squares and their sums must not overflow."""


@dataclass(frozen=True)
class Precision:
    """Tolerances of the solver; those of rows are for rows of length 1 and relative to 1 + max |v|.

    Attributes:
        priced: during the search, a row violated by at most this counts as satisfied.
        rounding: same for a row that depends on the active rows; above this, they are incompatible.
        feasibility: when a solution is checked, a row violated by at most this counts as satisfied.
        parallel: smallest squared component of a normal outside the span of the active normals.
        pushing: smallest decrease rate of a multiplier that counts.
        cutoff: a row of length 1 with this distance from the span of the rows above it counts as dependent.
        short: length up to which a row counts as a row of zeros.
        unit: rows whose squared length differs from 1 by at most this are not scaled.
        never, huge: a number that replaces infinity; the largest entry of a solution.
        delta, shrink: start value and reduction factor of δ in the proximal steps of stage 2.
        sign, noise: tolerances for a multiplier of the wrong sign in stage 2, relative to the task residual and to
            1 + max |v|.
        pull, growth, gap: start value and growth factor of γ in the proximal steps of stage 3, and stop tolerance.
        margin: margin added to the smallest opening.
        lanes: rows processed side by side, 1, 2 or 4; float has 1, for processors without vector units.
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
"""Tolerances for double."""

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
"""Tolerances for float."""
