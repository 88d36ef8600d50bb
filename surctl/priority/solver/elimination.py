"""Elimination of linear equalities by Householder reflections (Golub and Van Loan 2013, 5.1), in symbolic form.

For a few velocities the unrolled elimination runs faster. From `LOOPED` velocities on, its C text takes a compiler
minutes; then the programs of stages 1 and 2 are built from the loops of this module.

`Precision` holds the tolerances of the solver for the number types double and float.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca

from surctl.ir import Call, Loop, Program, Routine, lower

__all__ = [
    "FLOAT32",
    "FLOAT64",
    "LONGEST",
    "LOOPED",
    "Elimination",
    "Precision",
    "Reflection",
    "as_matrix",
    "corrected",
    "eliminate",
    "elimination",
    "flat",
    "product",
    "pseudo_inverse",
    "pseudo_inverse_of",
    "reflect",
    "split_basis",
]

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


class Elimination(NamedTuple):
    """Result of the elimination of p equalities J x = b, J (p, n), from n variables.

    Attributes:
        lift: (n, p); v + lift (b − J v) is the solution of J x = b nearest to v. Column k of `lift` is zero if row k of
            J depends linearly on the rows above it, or is zero.
        basis: (n, n), orthonormal columns; the first `rank` columns span the row space of J, the others its null space.
        rank: number of linearly independent rows of J.
    """

    lift: ca.SX
    basis: ca.SX
    rank: ca.SX


def as_matrix(entries: ca.SX, columns: int) -> ca.SX:
    """Return the matrix whose entries are stored row by row."""
    return ca.reshape(entries, columns, entries.numel() // columns).T


def flat(matrix: ca.SX) -> ca.SX:
    """Return the entries of a matrix as one column, row by row."""
    return ca.reshape(ca.densify(matrix).T, -1, 1)


class Reflection(NamedTuple):
    """Result of the elimination of p < n independent equalities J x = b from n variables.

    Attributes:
        origin: (n,), the shortest x with J x = b.
        free: (n, n − p), orthonormal columns that span the null space of J.
        start: (n − p,), coordinates of the target in the columns of `free`.
        full: whether the rows of J are linearly independent; if not, the other attributes are invalid.
    """

    origin: ca.SX
    free: ca.SX
    start: ca.SX
    full: ca.SX


def reflect(J: ca.SX, b: ca.SX, target: ca.SX, precision: Precision = FLOAT64) -> Reflection:
    """Eliminate J x = b with p < n independent rows of J (p, n), at a third of the cost of `eliminate`."""
    p, n = J.shape
    full, normals, weights, solved = ca.SX(1), list[ca.SX](), list[ca.SX](), list[ca.SX]()
    for k in range(p):
        y = J[k, :].T
        for normal, weight in zip(normals, weights, strict=True):
            y = _mirror(y, normal, weight)
        square, whole = ca.sumsqr(y[k:]), ca.sumsqr(J[k, :])
        usable = ca.logic_and(square > precision.cutoff**2 * whole, whole > precision.short**2)
        full = ca.logic_and(full, usable)
        size = ca.sqrt(ca.if_else(usable, square, 1))
        pivot = ca.if_else(y[k] < 0, size, -size)
        weights.append(1 / (size * (size + ca.fabs(y[k]))))
        normals.append(ca.vertcat(ca.SX.zeros(k, 1), y[k] - pivot, y[k + 1 :]))
        solved.append((b[k] - sum((y[i] * solved[i] for i in range(k)), ca.SX(0))) / pivot)
    columns = [ca.vertcat(*solved, ca.SX.zeros(n - p, 1)), *(ca.SX.eye(n)[:, j] for j in range(p, n))]
    for normal, weight in zip(reversed(normals), reversed(weights), strict=True):
        columns = [_mirror(column, normal, weight) for column in columns]
    for normal, weight in zip(normals, weights, strict=True):
        target = _mirror(target, normal, weight)
    return Reflection(columns[0], ca.horzcat(*columns[1:]), target[p:], full)


def _mirror(x: ca.SX, normal: ca.SX, weight: ca.SX) -> ca.SX:
    return x - (weight * ca.dot(normal, x)) * normal


def eliminate(J: ca.SX, precision: Precision = FLOAT64) -> Elimination:
    """Eliminate J x = b for any J (p, n); a row that is linearly dependent on earlier rows is skipped."""
    p, n = J.shape
    basis, rank = ca.SX.eye(n), ca.SX(0)
    triangle = ca.SX.zeros(n, p)  # column k: coefficients of b − J v for the variable that row k determines
    for k in range(p):
        length = ca.sqrt(ca.sumsqr(J[k, :]))
        usable = length > precision.short
        inverse = ca.if_else(usable, 1 / ca.if_else(usable, length, 1), 0)
        y = basis.T @ (J[k, :].T * inverse)
        first = min(k, n - 1)
        free = [_at_least(i, rank, k) for i in range(n)]
        x = ca.vertcat(*(ca.if_else(free[i], y[i], 0) if i < k else y[i] for i in range(n)))
        here = [_is(i, rank, k) for i in range(n)]
        head = sum((ca.if_else(here[i], y[i], 0) for i in range(first + 1)), ca.SX(0))
        size = ca.sqrt(ca.sumsqr(x))
        alive = ca.logic_and(size > precision.cutoff, rank < n) if k >= n else size > precision.cutoff
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


def pseudo_inverse(J: ca.SX, precision: Precision = FLOAT64) -> ca.SX:
    """Return the Moore-Penrose inverse (n, p) of J (p, n), by a complete orthogonal decomposition.

    J = L Qᵀ, where the columns of Q are an orthonormal basis of the row space of J, and L has full column rank.
    """
    left = eliminate(J, precision)
    Q = ca.horzcat(*(ca.if_else(left.rank > i, left.basis[:, i], 0) for i in range(J.shape[1])))
    return Q @ eliminate((J @ Q).T, precision).lift.T


def _at_least(i: int, rank: ca.SX, k: int) -> ca.SX:
    """Return whether variable i is still undetermined before row k is eliminated; always true for i ≥ k."""
    return ca.SX(1) if i >= k else rank <= i


def _is(i: int, rank: ca.SX, k: int) -> ca.SX:
    """Return whether row k of J, if linearly independent of earlier rows, determines variable i."""
    if k == 0:
        return ca.SX(1 if i == 0 else 0)
    return ca.SX(0) if i > k else ca.eq(rank, i)


LOOPED = 6
"""Number of velocities from which eliminations are loops."""


def elimination(p: int, n: int, precision: Precision) -> Routine:
    """Return `eliminate` as a routine: it takes J (p·n,) row by row and returns lift (n·p,), basis (n·n,) and rank."""
    state = ("eye", "empty", "none")
    steps = (
        Call(_start(p, n), (), state),
        Loop(_turn(p, n, precision), p, state, ("basis", "triangle", "rank"), sliced=("J",), index=True),
        Loop(product(n, p), n, (), ("lift",), sliced=("basis",), fixed=("triangle",)),
    )
    return Routine(f"eliminate_{p}_{n}", (("J", p * n),), steps, ("lift", "basis", "rank"))


def _start(p: int, n: int) -> Program:
    outputs = [ca.vec(ca.SX.eye(n)), ca.SX.zeros(n * p), ca.SX.zeros(1)]
    return lower(ca.Function("eliminate_start", [], list(map(ca.densify, outputs))))


def _turn(p: int, n: int, precision: Precision) -> Routine:
    """Return the routine for the reflection of row number `turn` of J, with the steps of the loop in `eliminate`."""
    state = (("basis", n * n), ("triangle", n * p), ("rank", 1))
    steps = (
        Call(_unit(n, precision), ("row",), ("unit", "inverse", "y_none")),
        Loop(_add(n, 1), n, ("y_none",), ("y",), sliced=("unit", "basis")),
        Call(
            _reflection(p, n, precision), ("turn", "y", "rank", "inverse"),
            ("normal", "weight", "factors", "here", "rhs_none", "share", "rank_next"),
        ),
        Loop(_mirrored(n), n, (), ("basis_next",), sliced=("basis",), fixed=("normal", "weight")),
        Loop(_add(p, -1), n, ("rhs_none",), ("rhs",), sliced=("factors", "triangle")),
        Loop(_replaced(p), n, (), ("triangle_next",), sliced=("here", "triangle"), fixed=("rhs", "share")),
    )  # fmt: skip
    results = tuple(f"{name}_next" for name, _ in state)
    return Routine(f"eliminate_row_{p}_{n}", (("turn", 1), *state, ("row", n)), steps, results)


def _unit(n: int, precision: Precision) -> Program:
    row = ca.SX.sym("row", n)
    length = ca.sqrt(ca.sumsqr(row))
    usable = length > precision.short
    inverse = ca.if_else(usable, 1 / ca.if_else(usable, length, 1), 0)
    return lower(ca.Function("unit_row_of", [row], [row * inverse, inverse, ca.densify(ca.SX.zeros(n))]))


def _add(size: int, sign: int) -> Program:
    total, factor, row = ca.SX.sym("total", size), ca.SX.sym("factor"), ca.SX.sym("row", size)
    return lower(
        ca.Function("add_row" if sign > 0 else "take_row", [total, factor, row], [total + sign * factor * row])
    )


def _reflection(p: int, n: int, precision: Precision) -> Program:
    turn, y, rank, inverse = ca.SX.sym("turn"), ca.SX.sym("y", n), ca.SX.sym("rank"), ca.SX.sym("inverse")
    free = [rank <= i for i in range(n)]
    here = [ca.eq(rank, i) for i in range(n)]
    x = ca.vertcat(*(ca.if_else(free[i], y[i], 0) for i in range(n)))
    head = sum((ca.if_else(here[i], y[i], 0) for i in range(n)), ca.SX(0))
    size = ca.sqrt(ca.sumsqr(x))
    alive = ca.logic_and(size > precision.cutoff, rank < n)
    pivot = ca.if_else(head < 0, size, -size)
    weight = ca.if_else(alive, 1 / ca.if_else(alive, size * (size + ca.fabs(head)), 1), 0)
    outputs = [
        ca.vertcat(*(x[i] - ca.if_else(here[i], pivot, 0) for i in range(n))),
        weight,
        ca.vertcat(*(ca.if_else(free[i], 0, y[i]) for i in range(n))),
        ca.vertcat(*(ca.logic_and(here[i], alive) for i in range(n))),
        ca.vertcat(*(ca.if_else(ca.eq(turn, k), inverse, 0) for k in range(p))),
        ca.if_else(alive, 1 / ca.if_else(alive, pivot, 1), 0),
        rank + alive,
    ]
    return lower(ca.Function("reflection", [turn, y, rank, inverse], list(map(ca.densify, outputs))))


def _mirrored(n: int) -> Program:
    row, normal, weight = ca.SX.sym("row", n), ca.SX.sym("normal", n), ca.SX.sym("weight")
    return lower(ca.Function("mirrored", [row, normal, weight], [row - weight * (ca.dot(row, normal) * normal)]))


def _replaced(p: int) -> Program:
    here, row, rhs, share = ca.SX.sym("here"), ca.SX.sym("row", p), ca.SX.sym("rhs", p), ca.SX.sym("share")
    return lower(ca.Function("replaced", [here, row, rhs, share], [ca.if_else(here, rhs * share, row)]))


def product(n: int, p: int, *, transposed: bool = False) -> Program:
    """Return a program that multiplies a row (n,) by a matrix (n, p), or by the transpose of a matrix (p, n)."""
    row, entries = ca.SX.sym("row", n), ca.SX.sym("matrix", n * p)
    matrix = as_matrix(entries, n).T if transposed else as_matrix(entries, p)
    name = "times_transposed" if transposed else "times"
    return lower(ca.Function(name, [row, entries], [ca.densify((row.T @ matrix).T)]))


def split_basis(n: int) -> Program:
    """Return a program that splits basis (n·n,) by the rank into row space and null space; other columns are zero."""
    basis, rank = ca.SX.sym("basis", n * n), ca.SX.sym("rank")
    span = [ca.if_else(rank > k % n, basis[k], 0) for k in range(n * n)]
    free = [ca.if_else(rank > k % n, 0, basis[k]) for k in range(n * n)]
    return lower(ca.Function("split_basis", [basis, rank], [ca.vertcat(*span), ca.vertcat(*free)]))


def corrected(n: int, p: int) -> Program:
    """Return a program for v + lift (b − J v), from v (n,), lift (n·p,), J (p·n,) and b (p,)."""
    v, b = ca.SX.sym("v", n), ca.SX.sym("b", p)
    lift, J = ca.SX.sym("lift", n * p), ca.SX.sym("J", p * n)
    return lower(ca.Function("corrected", [v, lift, J, b], [v + as_matrix(lift, p) @ (b - as_matrix(J, n) @ v)]))


def pseudo_inverse_of(p: int, n: int, precision: Precision) -> Routine:
    """Return `pseudo_inverse` as a routine: it takes J (p·n,) row by row and returns its inverse (n·p,)."""
    entries = ca.SX.sym("entries", p * n)
    turned = lower(ca.Function("turned_over", [entries], [ca.vec(as_matrix(entries, n))]))
    steps = (
        Call(elimination(p, n, precision), ("J",), ("lift", "basis", "rank")),
        Call(split_basis(n), ("basis", "rank"), ("Q", "free")),
        Loop(product(n, n), p, (), ("L",), sliced=("J",), fixed=("Q",)),
        Call(turned, ("L",), ("L_columns",)),
        Call(elimination(n, p, precision), ("L_columns",), ("lift_L", "basis_L", "rank_L")),
        Loop(product(n, p, transposed=True), n, (), ("inverse",), sliced=("Q",), fixed=("lift_L",)),
    )
    return Routine("pseudo_inverse", (("J", p * n),), steps, ("inverse",))
