"""Tolerances of the solver for the number types double and float, and the elimination of linear equalities.

The elimination uses Householder reflections (Golub and Van Loan 2013, 5.1).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca

LONGEST = 1e140
"""Largest entry of a normal or a Jacobian in double: squares and their sums must not overflow."""

LOOPED = 6
"""Number of unknowns from which the active-set search and the NSB law have loops: the C text of unrolled code takes a
compiler minutes."""


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
        apart: sine of the angle between a row of J and the span of earlier rows from which the rows are eliminated
            before the search. least: length of the row, relative to the longest, from which they are.
        short: largest length at which a constraint row is not scaled.
        unit: largest difference between squared length and 1 at which a constraint row is not scaled.
        never: number that replaces infinity. huge: largest allowed entry of a solution.
        loss: largest loss, relative to the distance and its square, with which a velocity counts as the nearest one.
        error: relative error of the rows that this takes into account.
        lanes: number of constraint rows that one vector instruction evaluates: 1, 2 or 4; 1 for float, which is meant
            for processors without vector instructions.
    """

    priced: float
    rounding: float
    feasibility: float
    parallel: float
    pushing: float
    apart: float
    least: float
    short: float
    unit: float
    never: float
    huge: float
    loss: float
    error: float
    lanes: int


FLOAT64 = Precision(
    priced=1e-12,
    rounding=1e-10,
    feasibility=1e-9,
    parallel=1e-16,
    pushing=1e-12,
    apart=0.1,
    least=1e-8,
    short=1e-15,
    unit=1e-14,
    never=1e300,
    huge=1e300,
    loss=1e-7,
    error=1e-14,
    lanes=4,
)
"""Tolerances for double."""

FLOAT32 = Precision(
    priced=1e-6,
    rounding=2e-5,
    feasibility=1e-4,
    parallel=1e-8,
    pushing=1e-6,
    apart=0.1,
    least=1e-2,
    short=1e-15,
    unit=1e-6,
    never=1e30,
    huge=1e30,
    loss=1e-2,
    error=1e-6,
    lanes=1,
)
"""Tolerances for float."""


def as_matrix(entries: ca.SX, columns: int) -> ca.SX:
    """Return the matrix whose entries are stored row by row."""
    return ca.reshape(entries, columns, entries.numel() // columns).T


class Reflection(NamedTuple):
    """Result of the elimination of p < n independent equalities J x = b from n variables.

    Attributes:
        origin: (n,), the shortest x with J x = b.
        free: (n, n − p), orthonormal columns that span the null space of J.
        start: (n − p,), coordinates of the target in the columns of `free`.
        full: whether the rows of J are clearly independent; if not, the other attributes are invalid.
    """

    origin: ca.SX
    free: ca.SX
    start: ca.SX
    full: ca.SX


def reflect(J: ca.SX, b: ca.SX, target: ca.SX, precision: Precision = FLOAT64) -> Reflection:
    """Eliminate J x = b with p < n independent rows of J (p, n)."""
    p, n = J.shape
    full, normals, weights, solved = ca.SX(1), list[ca.SX](), list[ca.SX](), list[ca.SX]()
    longest = ca.SX(0)
    for k in range(p):
        longest = ca.fmax(longest, ca.sumsqr(J[k, :]))
    for k in range(p):
        y = J[k, :].T
        for normal, weight in zip(normals, weights, strict=True):
            y = _mirror(y, normal, weight)
        square = ca.sumsqr(y[k:])
        usable = square > ca.fmax(precision.apart**2 * ca.sumsqr(y), precision.least**2 * longest)
        full = ca.logic_and(full, usable)
        size = ca.sqrt(ca.if_else(usable, square, 1))
        pivot = ca.if_else(y[k] < 0, size, -size)
        weights.append(1 / (size * (size + ca.fabs(y[k]))))
        normals.append(ca.vertcat(ca.SX.zeros(k, 1), y[k] - pivot, y[k + 1 :, :]))
        solved.append((b[k] - sum((y[i] * solved[i] for i in range(k)), ca.SX(0))) / pivot)
    columns = [ca.vertcat(*solved, ca.SX.zeros(n - p, 1)), *(ca.SX.eye(n)[:, j] for j in range(p, n))]
    for normal, weight in zip(reversed(normals), reversed(weights), strict=True):
        columns = [_mirror(column, normal, weight) for column in columns]
    for normal, weight in zip(normals, weights, strict=True):
        target = _mirror(target, normal, weight)
    return Reflection(columns[0], ca.horzcat(*columns[1:]), target[p:, :], full)


def _mirror(x: ca.SX, normal: ca.SX, weight: ca.SX) -> ca.SX:
    return x - (weight * ca.dot(normal, x)) * normal
