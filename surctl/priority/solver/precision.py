"""Tolerances of the solver for the number types double and float."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["FLOAT32", "FLOAT64", "LONGEST", "Precision"]

LONGEST = 1e140
"""Largest entry of a normal or a Jacobian in double: squares and their sums must not overflow."""


@dataclass(frozen=True)
class Precision:
    """Tolerances of the solver for one number type; those for rows apply to rows of length 1, relative to 1 + max |v|.

    Attributes:
        priced: largest violation at which a constraint row counts as satisfied during the active-set search.
        rounding: largest violation at which a row that is linearly dependent on the active rows counts as satisfied;
            with a larger violation, the rows contradict each other.
        feasibility: largest violation at which a constraint row counts as satisfied in the check of a solution.
        parallel: squared component of a normal outside the span of the active normals below which the normal counts as
            linearly dependent.
        pushing: rate of decrease of a multiplier below which the rate counts as 0.
        cutoff: largest distance from the span of earlier rows of J at which a row of length 1 counts as linearly
            dependent.
        short: largest length at which a row of J counts as a row of zeros.
        unit: largest difference between squared length and 1 at which a constraint row is not scaled.
        never: number that replaces infinity. huge: largest allowed entry of a solution.
        delta: initial value of the weight δ in the proximal steps of stage 2 (module `least_squares`). shrink: factor
            by which δ is reduced in each step.
        sign: tolerance for a multiplier of the wrong sign in stage 2, relative to the task residual. noise: tolerance
            for such a multiplier relative to 1 + max |v|; the larger of both applies.
        pull: initial value of the step size γ in the proximal steps of stage 3 (module `opened`). growth: factor by
            which γ is increased in each step. gap: tolerance at which these steps stop.
        margin: margin for rounding that is added to the smallest opening of the soft rows.
        lanes: number of constraint rows that one vector instruction evaluates: 1, 2 or 4; 1 for float, which is meant
            for processors without vector instructions.
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
