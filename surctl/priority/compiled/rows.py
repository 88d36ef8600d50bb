"""Programs that change one constraint row lower ≤ a·v ≤ upper, stored as normal a (n,), lower, upper, soft."""

from __future__ import annotations

import casadi as ca

from surctl.ir import Program, lower
from surctl.priority.compiled.sweep import HUGE
from surctl.priority.rowspace import ZERO_ROW
from surctl.priority.solver.elimination import as_matrix

__all__ = ["holding_row", "longer_row", "opened_row", "reduced_row"]

_FLAT = 1e-12  # if N leaves less than this of a row of length 1, the row does not bound y


def opened_row(n: int) -> Program:
    """Return a program that scales a row to length 1, moves its bounds outwards if soft, and makes the row hard.

    The program takes the row, the amount `opening` by which soft bounds move, and a velocity v. It also widens the
    bounds so that v satisfies the row exactly.
    """
    row, opening, v = ca.SX.sym("row", n + 3), ca.SX.sym("opening"), ca.SX.sym("v", n)
    length = ca.sqrt(ca.sumsqr(row[:n]))
    a = row[: n + 2] * (1 / ca.if_else(length <= ZERO_ROW, 1, length))
    value, widening = ca.dot(a[:n], v), row[n + 2] * opening
    low, high = a[n] - widening, a[n + 1] + widening
    low, high = ca.if_else(low <= value, low, value), ca.if_else(high >= value, high, value)
    return lower(ca.Function("opened_row", [row, opening, v], [ca.vertcat(a[:n], low, high, 0)]))


def holding_row(n: int) -> Program:
    """Return a program that widens the bounds of a row so that the velocity v satisfies the row exactly."""
    row, v = ca.SX.sym("row", n + 3), ca.SX.sym("v", n)
    value = ca.dot(row[:n], v)
    bounds = [ca.fmin(row[n], value), ca.fmax(row[n + 1], value)]
    return lower(ca.Function("holding_row", [row, v], [ca.vertcat(row[:n], *bounds, row[n + 2])]))


def reduced_row(n: int) -> Program:
    """Return a program that converts a row of length 1 on v + N y to a constraint row on y.

    The program takes the row, v and N, and widens the bounds so that y = 0 satisfies the new row.
    """
    row, v, N = ca.SX.sym("row", n + 3), ca.SX.sym("v", n), ca.SX.sym("N", n * n)
    a, value = as_matrix(N, n) @ row[:n], ca.dot(row[:n], v)
    flat = ca.sqrt(ca.sumsqr(a)) <= _FLAT
    low, high = ca.fmin(row[n] - value, 0), ca.fmax(row[n + 1] - value, 0)
    outputs = ca.vertcat(ca.if_else(flat, 0, a), ca.if_else(flat, -HUGE, low), ca.if_else(flat, HUGE, high), 0)
    return lower(ca.Function("reduced_row", [row, v, N], [ca.densify(outputs)]))


def longer_row(n: int, more: int) -> Program:
    """Return a program that appends `more` variables with coefficient 0 to a constraint row."""
    row = ca.SX.sym("row", n + 3)
    return lower(ca.Function("longer_row", [row], [ca.densify(ca.vertcat(row[:n], ca.SX.zeros(more), row[n:]))]))
