"""The decomposition of module `decomposition` as loops, so that the length of the C text grows with k·n, not with k²·n.

Rows and columns that are not yet computed are zero, so the inner loops can always run over all of them.
"""

from __future__ import annotations

import casadi as ca

from surctl.ir import Call, Loop, Program, Routine, lower
from surctl.priority.rowspace import CUTOFF, ZERO_ROW
from surctl.priority.solver.elimination import as_matrix
from surctl.priority.solver.elimination_loops import product

__all__ = ["attainable"]


def attainable(k: int, n: int) -> Routine:
    """Return the routine that removes from J v = x what no velocity attains.

    Inputs: J (k·n,) row by row, k > 1; x (k,). Outputs: both unchanged if the rows of J are linearly independent,
    otherwise the matrix T Q and the vector Pᵀ·scale·x of `Decomposition`.
    """
    T = ca.SX.sym("T", k * k)
    turned = lower(ca.Function("turned_over", [T], [ca.vec(as_matrix(T, k))]))
    steps = (
        Call(_scaled(k, n), ("J", "x"), ("rows", "rest", "Q_none", "P_none")),
        Loop(_direction(k, n), k, ("Q_none",), ("Q",), sliced=("rows",), index=True),
        Loop(_column(k, n), k, (), ("columns",), sliced=("Q",), fixed=("rows",), index=True),
        Loop(_orthonormal(k), k, ("P_none",), ("P", "T_columns", "inverse"), sliced=("columns",), index=True),
        Loop(_outside(k), k, ("rest",), ("left", "b"), sliced=("P",)),
        Call(turned, ("T_columns",), ("T",)),
        Loop(product(k, n), k, (), ("task",), sliced=("T",), fixed=("Q",)),
        Call(_chosen(k, n), ("J", "x", "task", "b", "inverse"), ("J_1", "x_1")),
    )
    return Routine("attainable", (("J", k * n), ("x", k)), steps, ("J_1", "x_1"))


def _scaled(k: int, n: int) -> Program:
    J, x, longest = ca.SX.sym("J", k * n), ca.SX.sym("x", k), ca.SX(0)
    matrix = as_matrix(J, n)
    for i in range(k):
        longest = ca.fmax(longest, ca.sqrt(ca.sumsqr(matrix[i, :])))
    alive = longest > ZERO_ROW
    scale = ca.if_else(alive, 1 / ca.if_else(alive, longest, 1), 0)
    outputs = [scale * J, x * scale, ca.SX.zeros(k * n), ca.SX.zeros(k * k)]
    return lower(ca.Function("scaled_task", [J, x], list(map(ca.densify, outputs))))


def _outside(size: int) -> Program:
    """Return a program that subtracts from a vector its component along q, and returns this component too."""
    vector, q = ca.SX.sym("vector", size), ca.SX.sym("q", size)
    part = ca.dot(q, vector)
    return lower(ca.Function("outside", [vector, q], [vector - part * q, part]))


def _direction(k: int, n: int) -> Routine:
    """Return the routine that computes direction number `turn`, in two passes as in `decomposition`."""
    q, alive = ca.SX.sym("q", n), ca.SX.sym("alive")
    length = ca.sqrt(ca.sumsqr(q))
    long = length > CUTOFF
    first = [q * ca.if_else(long, 1 / ca.if_else(long, length, 1), 0), long]
    second = [q * ca.if_else(alive, 1 / ca.if_else(alive, length, 1), 0)]
    steps = (
        Loop(_outside(n), k, ("row",), ("q_rough", "parts"), sliced=("Q",)),
        Call(lower(ca.Function("first_pass", [q], first)), ("q_rough",), ("q_unit", "alive")),
        Loop(_outside(n), k, ("q_unit",), ("q_clean", "more"), sliced=("Q",)),
        Call(lower(ca.Function("second_pass", [q, alive], second)), ("q_clean", "alive"), ("q",)),
        Loop(_placed(n), k, (), ("Q_next",), sliced=("Q",), fixed=("turn", "q"), index=True),
    )
    return Routine("direction", (("turn", 1), ("Q", k * n), ("row", n)), steps, ("Q_next",))


def _placed(size: int) -> Program:
    at, row, turn, new = ca.SX.sym("at"), ca.SX.sym("row", size), ca.SX.sym("turn"), ca.SX.sym("new", size)
    return lower(ca.Function("placed", [at, row, turn, new], [ca.if_else(ca.eq(at, turn), new, row)]))


def _column(k: int, n: int) -> Program:
    # row i depends on directions 1 … i only; rounding errors in the other entries are dropped
    turn, q, rows = ca.SX.sym("turn"), ca.SX.sym("q", n), ca.SX.sym("rows", k * n)
    values = as_matrix(rows, n) @ q
    return lower(
        ca.Function("column", [turn, q, rows], [ca.vertcat(*(ca.if_else(turn <= i, values[i], 0) for i in range(k)))])
    )


def _orthonormal(k: int) -> Routine:
    """Return the routine that orthonormalises column number `turn`; outputs: P, column of T, 1/diagonal entry of T."""
    turn, p, one, two = ca.SX.sym("turn"), ca.SX.sym("p", k), ca.SX.sym("one", k), ca.SX.sym("two", k)
    length = ca.sqrt(ca.sumsqr(p))
    alive = length > 0
    inverse = ca.if_else(alive, 1 / ca.if_else(alive, length, 1), 0)
    T = ca.vertcat(*(ca.if_else(ca.eq(turn, i), length, one[i] + two[i]) for i in range(k)))
    end = lower(ca.Function("column_end", [turn, p, one, two], [p * inverse, T, inverse]))
    steps = (
        Loop(_outside(k), k, ("column",), ("p_rough", "one"), sliced=("P",)),
        Loop(_outside(k), k, ("p_rough",), ("p_clean", "two"), sliced=("P",)),
        Call(end, ("turn", "p_clean", "one", "two"), ("p", "T", "inverse")),
        Loop(_placed(k), k, (), ("P_next",), sliced=("P",), fixed=("turn", "p"), index=True),
    )
    return Routine("orthonormal", (("turn", 1), ("P", k * k), ("column", k)), steps, ("P_next", "T", "inverse"))


def _chosen(k: int, n: int) -> Program:
    J, x, task, b = (ca.SX.sym(name, size) for name, size in (("J", k * n), ("x", k), ("task", k * n), ("b", k)))
    inverse, rank = ca.SX.sym("inverse", k), ca.SX(0)
    for entry in ca.vertsplit(inverse):
        rank = rank + (entry > 0)
    full = ca.eq(rank, k)
    outputs = [ca.if_else(full, J, task), ca.if_else(full, x, b)]
    return lower(ca.Function("attainable_part", [J, x, task, b, inverse], outputs))
