"""The optimum of a priority problem with 60 digits: decides where solutions in doubles do not.

A primal active set, level after level. Near a singularity, limits that a solution exceeds by 1e-11 may be worth 1e-5 of
a residual; with 60 digits nothing is exceeded. Slow (20 ms to seconds a problem), therefore only for what is open.
"""

from __future__ import annotations

from decimal import Decimal, localcontext
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.priority import PriorityProblem

__all__ = ["least_residuals"]

Exact = NDArray[Any]
"""Numbers of type Decimal."""

DIGITS = 60
ZERO = Decimal("1e-40")
"""Far above the rounding of 60 digits, far below every number of a problem in doubles."""

CUTOFF = Decimal("1e-10")
"""Singular values below CUTOFF·‖J‖ count as 0, as in surctl."""

SLACK = Decimal("1e-14")
STEPS = 600


def least_residuals(
    problem: PriorityProblem, strict: int, v: NDArray[np.float64], moved: bool = True
) -> list[float] | None:
    """Return the least residuals of the first `strict` levels, one after the other; the active set begins at v.

    Limits that v violates are moved to v, so that v itself is one of the candidates; or, if not `moved`, all limits
    stay where they are, or are opened by the least amount that leaves a velocity. Either way they are opened by 1e-14,
    so that rounding makes no contradiction of limits that meet. None if the active set does not settle in 600 steps.
    """
    with localcontext() as context:
        context.prec = DIGITS
        y, Z = _exact(v), _exact(np.eye(problem.width))
        G, h = _limits(problem)
        if moved:
            h = np.maximum(h, G @ y)
        else:
            inside = _inside(G, h, y)
            if inside is None:
                return None
            y, h = inside[:-1], h + inside[-1]
        h = h + SLACK
        residuals = []
        for level in problem.levels[:strict]:
            J = _exact(level.J)
            if level.is_goal:
                x = _exact(level.x)
                nearest = _nearest(J, x, y, Z, G, h)
                if nearest is None:
                    return None
                y = nearest
                residuals.append(float(_length(J @ y - x)))
                Z = Z @ _complement(J @ Z, CUTOFF * Decimal(float(np.linalg.norm(level.J, 2))))
                continue
            lower, high, k = _exact(level.lower), _exact(level.high), len(J)
            s = np.maximum(lower - J @ y, Decimal(0)) + np.minimum(high - J @ y, Decimal(0))
            none, one = _exact(np.zeros((k, len(y)))), _exact(np.eye(k))  # s takes J v to its interval
            wide = np.block([[G, _exact(np.zeros((len(G), k)))], [J, one], [-J, -one]])
            both = np.block([[Z, none.T], [_exact(np.zeros((k, Z.shape[1]))), one]])
            nearest = _nearest(
                np.hstack([none, one]), s * 0, np.concatenate([y, s]), both, wide, np.concatenate([h, high, -lower])
            )
            if nearest is None:
                return None
            y = nearest[: len(y)]
            residuals.append(float(_length(nearest[len(y) :])))
            G = np.vstack([G, J, -J])
            h = np.concatenate([h, np.maximum(high, J @ y), -np.minimum(lower, J @ y)])
        return residuals


def _inside(G: Exact, h: Exact, y: Exact) -> Exact | None:
    """Return a y, and behind it the least t >= 0 with G y <= h + t."""
    one = _exact(np.eye(len(y) + 1)[-1:])
    wide = np.vstack([np.hstack([G, -_exact(np.ones((len(G), 1)))]), -one])
    start = np.append(y, max(Decimal(0), *(G @ y - h)))
    return _nearest(one, _exact(np.zeros(1)), start, _exact(np.eye(len(start))), wide, np.append(h, Decimal(0)))


def _nearest(C: Exact, d: Exact, y: Exact, Z: Exact, G: Exact, h: Exact) -> Exact | None:
    """Return the y + Z z that minimises ‖C y − d‖ subject to G y ≤ h, from a feasible y."""
    active: list[int] = []
    for step in range(STEPS):
        N = Z @ _complement(G[active] @ Z, ZERO)
        p = N @ _solve(C @ N, d - C @ y)
        if _length(C @ p) > ZERO:
            rate, room = G @ p, h - G @ y
            ahead = [
                (max(room[i], Decimal(0)) / rate[i], i) for i in range(len(G)) if i not in active and rate[i] > ZERO
            ]
            length, first = min(ahead, default=(Decimal(2), -1))
            y = y + min(length, Decimal(1)) * p
            if length < 1:
                active.append(first)
            continue
        weights = _solve((G[active] @ Z).T, Z.T @ (C.T @ (d - C @ y)))
        wrong = [(w, i) for w, i in zip(weights, active, strict=True) if w < -ZERO]
        if not wrong:
            return y
        active.remove(min(wrong)[1] if step < STEPS // 3 else min(i for _, i in wrong))  # then Bland's rule: no cycles
    return None


def _solve(A: Exact, b: Exact) -> Exact:
    """Return the shortest x that minimises ‖A x − b‖."""
    rows = _basis(A, ZERO)
    if not len(rows):
        return _exact(np.zeros(A.shape[1]))
    M = A @ rows.T
    Q = _basis(M.T, ZERO).T
    R, w = Q.T @ M, Q.T @ b
    x = _exact(np.zeros(len(w)))
    # Q comes in the order of its pivots: R is square, not triangular
    R = np.column_stack([R, w])
    for j in range(len(w)):
        i = j + int(np.argmax(np.abs(R[j:, j])))
        R[[j, i]] = R[[i, j]]
        for row in range(j + 1, len(w)):
            R[row] = R[row] - R[row, j] / R[j, j] * R[j]
    for j in reversed(range(len(w))):
        x[j] = (R[j, -1] - R[j, j + 1 : -1] @ x[j + 1 :]) / R[j, j]
    return np.asarray(rows.T @ x)


def _basis(A: Exact, cut: Decimal) -> Exact:
    """Return an orthonormal basis of the rows of A, by Gram and Schmidt with pivots; rests below `cut` count as 0."""
    rest, basis = [row.copy() for row in A], []
    while rest:
        lengths = [_length(row) for row in rest]
        i = max(range(len(rest)), key=lengths.__getitem__)
        if lengths[i] <= cut:
            break
        q = rest.pop(i) / lengths[i]
        for _ in range(2):
            for other in basis:
                q = q - (other @ q) * other
        q = q / _length(q)
        basis.append(q)
        rest = [row - (q @ row) * q for row in rest]
    return np.array(basis, dtype=object).reshape(len(basis), A.shape[1])


def _complement(A: Exact, cut: Decimal) -> Exact:
    """Return an orthonormal basis, in columns, of the null space of A."""
    n = A.shape[1]
    rows = _basis(A, cut)
    return _basis(_exact(np.eye(n)) - rows.T @ rows, Decimal("1e-15")).T if len(rows) else _exact(np.eye(n))


def _limits(problem: PriorityProblem) -> tuple[Exact, Exact]:
    """Return G and h of G v ≤ h with rows of length 1."""
    G, h = [], []
    for row in problem.rows:
        a = _exact(row.a)
        length = _length(a) or Decimal(1)
        for sign, bound in ((1, row.upper), (-1, -row.lower)):
            if np.isfinite(bound):
                G.append(sign * a / length)
                h.append(Decimal(float(bound)) / length)
    return np.array(G), np.array(h)


def _length(a: Exact) -> Decimal:
    return Decimal(a @ a).sqrt()


def _exact(values: NDArray[np.float64]) -> Exact:
    return np.array([Decimal(float(x)) for x in values.ravel()], dtype=object).reshape(values.shape)
