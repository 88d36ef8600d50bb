"""Tolerances of the solver for one number type, and the number of constraint rows processed side by side."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["FLOAT32", "FLOAT64", "LONGEST", "Precision"]

LONGEST = 1e140
"""Largest entry of a normal or a Jacobian in double: squares and their sums must not overflow."""


@dataclass(frozen=True)
class Precision:
    """Tolerances of the solver; tolerances of rows apply to rows of length 1 and are relative to 1 + max |v|.

    Attributes:
        priced: largest violation at which a constraint row counts as satisfied during the search.
        rounding: largest violation at which a row that depends on the active rows counts as satisfied; with a larger
            violation, the rows are incompatible.
        feasibility: largest violation at which a constraint row counts as satisfied when a solution is checked.
        parallel: smallest squared component of a normal outside the span of the active normals.
        pushing: smallest decrease rate of a multiplier that does not count as 0.
        cutoff: largest distance from the span of the rows above at which a row of length 1 counts as dependent.
        short: largest length at which a row counts as a row of zeros.
        unit: largest difference between squared length and 1 at which a constraint row is not scaled.
        never: number that replaces infinity. huge: largest allowed entry of a solution.
        delta: start value of δ in the proximal steps of stage 2. shrink: reduction factor of δ.
        sign: tolerance for a multiplier of the wrong sign in stage 2, relative to the task residual. noise: the
            corresponding tolerance relative to 1 + max |v|.
        pull: start value of γ in the proximal steps of stage 3. growth: growth factor of γ. gap: tolerance at which
            these steps stop.
        margin: margin added to the smallest opening.
        lanes: number of constraint rows processed side by side: 1, 2 or 4; 1 for float, for processors without vector
            units.
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
