"""Semidefinite programs solved by Clarabel: identities of polynomials with unknown sums of squares."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.sos.basis import Gram
from surctl.sos.polynomial import Monomial, Polynomial, joined

Array = NDArray[np.float64]


class Proposal(NamedTuple):
    """A numerical solution, which satisfies the identity only up to the solver's tolerance: a proposal, not a proof.

    Attributes:
        least: number t with G ⪰ t I for every Gram matrix G, at most 1.
        grams: the Gram matrix (n, n) of each sum of squares.
        multipliers: the polynomial that multiplies each relation.
    """

    least: float
    grams: list[Array]
    multipliers: list[dict[Monomial, float]]


def best_identity(
    target: Polynomial,
    grams: Sequence[Gram],
    relations: Sequence[Polynomial],
    free: Sequence[Sequence[Monomial]],
    *,
    seconds: float,
) -> Proposal | None:
    """Return the identity target = Σ b' G b · weight + Σ h · relation with the largest t; None if there is none.

    Args:
        target: the polynomial.
        grams: weights and polynomials b of the sums of squares.
        relations: the polynomials that are 0.
        free: the monomials of the multiplier h of each relation.
        seconds: limit of the wall-clock time [s].
    """
    import clarabel

    # unknowns: t, the lower triangle of each G row by row, the coefficients of each h
    rows: dict[Monomial, list[tuple[int, float]]] = {}
    sizes = [len(gram.roots) for gram in grams]
    starts = np.cumsum([1, *(n * (n + 1) // 2 for n in sizes), *map(len, free)]).tolist()
    for gram, at in zip(grams, starts, strict=False):
        square: dict[Monomial, list[tuple[int, float]]] = {}
        terms = [[(m, float(c)) for m, c in p.terms.items()] for p in gram.roots]
        for i, p in enumerate(terms):
            for j, q in enumerate(terms[: i + 1]):
                for (m, c), (o, d) in itertools.product(p, q):
                    square.setdefault(joined(m, o), []).append((at, (1 if i == j else 2) * c * d))
                at += 1
        for m, parts in square.items():
            for w, factor in gram.weight.terms.items():
                rows.setdefault(joined(m, w), []).extend((k, c * float(factor)) for k, c in parts)
    for relation, some, at in zip(relations, free, starts[len(grams) :], strict=False):
        for k, m in enumerate(some, start=at):
            for w, factor in relation.terms.items():
                rows.setdefault(joined(m, w), []).append((k, float(factor)))
    if set(target.terms) - set(rows):
        return None
    sides = [float(target.terms.get(m, 0.0)) for m in rows]
    entries = [(row, at, c) for row, parts in enumerate(rows.values()) for at, c in parts]
    entries.append((len(sides), 0, 1.0))  # t ≤ 1
    sides.append(1.0)
    cones: list[Any] = [clarabel.ZeroConeT(len(rows)), clarabel.NonnegativeConeT(1)]
    for n, at in zip(sizes, starts, strict=False):
        # upper triangle by columns = lower triangle by rows, with off-diagonal entries times √2
        for k, (row, column) in enumerate(zip(*np.tril_indices(n), strict=True)):
            entries.append((len(sides), at + k, -1.0 if row == column else -np.sqrt(2)))
            entries.append((len(sides), 0, float(row == column)))
            sides.append(0.0)
        cones.append(clarabel.PSDTriangleConeT(n) if n > 1 else clarabel.NonnegativeConeT(1))
    cost = np.zeros(starts[-1])
    cost[0] = -1.0
    where, columns, values = np.array(entries).T
    matrix = values, (where.astype(int), columns.astype(int))
    x = solved(cost, matrix, sides, cones, tolerance=1e-8, iterations=100, seconds=seconds)
    if x is None:
        return None
    matrices = []
    for n, at in zip(sizes, starts, strict=False):
        lower = np.zeros((n, n))
        lower[np.tril_indices(n)] = x[at : at + n * (n + 1) // 2]
        matrices.append(lower + np.tril(lower, -1).T)
    polynomials = [
        dict(zip(some, x[at : at + len(some)].tolist(), strict=True))
        for some, at in zip(free, starts[len(grams) :], strict=False)
    ]
    return Proposal(float(x[0]), matrices, polynomials)


def solved(
    cost: Array,
    matrix: Any,
    sides: ArrayLike,
    cones: Sequence[Any],
    *,
    tolerance: float,
    iterations: int,
    seconds: float = 1e9,
) -> Array | None:
    """Return x that minimises cost·x where sides − matrix x lies in the product of Clarabel's cones; None if none.

    Args:
        cost: the cost (n,).
        matrix: the matrix (m, n), as `scipy.sparse.csc_matrix` takes it.
        sides: the right side (m,).
        cones: cones of Clarabel.
        tolerance: tolerance of the solver.
        iterations: most iterations.
        seconds: limit of the wall-clock time [s].
    """
    import clarabel
    from scipy import sparse

    settings: Any = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_iter = iterations
    settings.time_limit = seconds
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    size = len(cost)
    right = np.asarray(sides, dtype=float)
    rows = sparse.csc_matrix(matrix, shape=(len(right), size))
    rows.eliminate_zeros()
    solver = clarabel.DefaultSolver(sparse.csc_matrix((size, size)), cost, rows, right, [*cones], settings)
    solution = solver.solve()
    return np.asarray(solution.x, dtype=float) if str(solution.status) in ("Solved", "AlmostSolved") else None
