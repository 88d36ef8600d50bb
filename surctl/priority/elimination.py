"""Equalities eliminated by Householder reflections (Golub and Van Loan 2013, 5.1), as symbolic expressions."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

__all__ = ["CUTOFF", "Elimination", "as_matrix", "eliminate", "flat", "pseudo_inverse"]

CUTOFF = 1e-10
"""A row of length 1 whose distance from the span of the rows above it is below this depends on them."""

_ZERO_ROW = 1e-15
"""A row shorter than this is that of an inactive task."""


class Elimination(NamedTuple):
    """What p rows J (p, n) leave of n variables.

    Attributes:
        lift: (n, p): v + lift (b − J v) is the point of J x = b nearest to v. Zero columns for dependent rows.
        basis: (n, n), orthonormal columns; the first `rank` belong to the rows, the others are free.
        rank: number of independent rows.
    """

    lift: ca.SX
    basis: ca.SX
    rank: ca.SX


def as_matrix(entries: ca.SX, columns: int) -> ca.SX:
    """Matrix from its entries, row by row."""
    return ca.reshape(entries, columns, entries.numel() // columns).T


def flat(matrix: ca.SX) -> ca.SX:
    """Entries of a matrix, row by row, as a column."""
    return ca.reshape(ca.densify(matrix).T, -1, 1)


def eliminate(J: ca.SX) -> Elimination:
    """Householder elimination of the rows of J (p, n); dependent rows are passed over, first come first served."""
    p, n = J.shape
    basis, rank = ca.SX.eye(n), ca.SX(0)
    triangle = ca.SX.zeros(n, p)  # column k: what the free variable of row k needs, as a function of b − J v
    for k in range(p):
        length = ca.sqrt(ca.sumsqr(J[k, :]))
        usable = length > _ZERO_ROW
        inverse = ca.if_else(usable, 1 / ca.if_else(usable, length, 1), 0)
        y = basis.T @ (J[k, :].T * inverse)
        first = min(k, n - 1)
        free = [_at_least(i, rank, k) for i in range(n)]
        x = ca.vertcat(*(ca.if_else(free[i], y[i], 0) if i < k else y[i] for i in range(n)))
        here = [_is(i, rank, k) for i in range(n)]
        head = sum((ca.if_else(here[i], y[i], 0) for i in range(first + 1)), ca.SX(0))
        size = ca.sqrt(ca.sumsqr(x))
        alive = ca.logic_and(size > CUTOFF, rank < n) if k >= n else size > CUTOFF
        pivot = ca.if_else(head < 0, size, -size)
        weight = ca.if_else(alive, 1 / ca.if_else(alive, size * (size + ca.fabs(head)), 1), 0)
        normal = ca.vertcat(*(x[i] - ca.if_else(here[i], pivot, 0) for i in range(n)))
        basis = basis - weight * ((basis @ normal) @ normal.T)
        rhs = inverse * ca.SX.eye(p)[k, :] - sum(
            (ca.if_else(free[i], 0, y[i]) * triangle[i, :] for i in range(first + (k >= n))), ca.SX.zeros(1, p)
        )
        scaled = rhs * ca.if_else(alive, 1 / ca.if_else(alive, pivot, 1), 0)
        triangle = ca.vertcat(*(ca.if_else(ca.logic_and(here[i], alive), scaled, triangle[i, :]) for i in range(n)))
        rank = rank + alive
    return Elimination(basis @ triangle, basis, rank)


def pseudo_inverse(J: ca.SX) -> ca.SX:
    """(n, p): Moore-Penrose inverse of J (p, n), by a complete orthogonal decomposition.

    J = L Q.T with orthonormal columns Q of its row space; L, of full column rank, is eliminated in its turn.
    """
    left = eliminate(J)
    Q = ca.horzcat(*(ca.if_else(left.rank > i, left.basis[:, i], 0) for i in range(J.shape[1])))
    return Q @ eliminate((J @ Q).T).lift.T


def _at_least(i: int, rank: ca.SX, k: int) -> ca.SX:
    """Whether variable i is still free before row k; known without looking for i ≥ k."""
    return ca.SX(1) if i >= k else rank <= i


def _is(i: int, rank: ca.SX, k: int) -> ca.SX:
    """Whether row k, if independent, takes variable i."""
    if k == 0:
        return ca.SX(1 if i == 0 else 0)
    return ca.SX(0) if i > k else ca.eq(rank, i)
