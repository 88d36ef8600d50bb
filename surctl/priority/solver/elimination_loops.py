"""The eliminations of module `elimination` as loops, so that the length of the C text grows with n and not with n³.

For a few velocities the unrolled elimination runs faster. From `LOOPED` velocities on, its C text takes a compiler
minutes; then the programs of stages 1 and 2 are built from the loops of this module.
"""

from __future__ import annotations

import casadi as ca

from surctl.ir import Call, Loop, Program, Routine, lower
from surctl.priority.solver.elimination import as_matrix
from surctl.priority.solver.precision import Precision

__all__ = ["LOOPED", "corrected", "elimination", "product", "pseudo_inverse_of", "split_basis"]

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
