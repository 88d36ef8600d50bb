"""The constraint rows that limit a task, and their multipliers in its least-squares problem, from the solution.

At the minimiser v of ½‖J v − x‖² subject to the constraint rows, the negative gradient Jᵀ(x − J v), here called the
pull, is a combination of the normals of the active constraint rows. The projection of the pull on the cone of feasible
directions is then 0, and the multipliers of this projection are the multipliers of the least-squares problem. A nonzero
projection measures how far v is from optimal.
"""

from __future__ import annotations

import casadi as ca

from surctl.ir import Call, Loop, Program, Routine, lower
from surctl.priority.compiled.sweep import HUGE
from surctl.priority.rowspace import ZERO_ROW
from surctl.priority.solver.dual_step import OPTIMAL, Space
from surctl.priority.solver.kernel import kernel, row_by_row
from surctl.priority.solver.precision import FLOAT64, Precision

__all__ = ["holding", "largest", "merged"]


def holding(n: int, m: int, precision: Precision = FLOAT64) -> Routine:
    """Routine (rows (m·(n + 3),), opening (1,), v (n,), pull (n,), Z (n·n,)) → numbers, multipliers, rest, count.

    numbers (n,): signed numbers, from 1, of the constraint rows that balance the pull (+ at the upper bound), 0 if
    empty; multipliers (n,) for rows of length 1; rest (n,): the part of the pull in the range of the projector Z that
    the constraint rows do not balance; count (1,): number of iterations. The bounds of soft constraint rows are first
    moved outwards by `opening`.
    """
    space = Space(n, n, precision=precision)
    steps = (
        Call(_unit_pull(n, precision), ("pull",), ("base", "size", "go")),
        Loop(_touching(n, precision), m, (), ("cone",), sliced=("rows",), fixed=("opening", "v")),
        Call(
            row_by_row(kernel(space, m), m, precision),
            ("cone", "base", "go", "Z"),
            ("point", "active", "weights", "end", "count"),
        ),
        Call(
            _scaled(n),
            ("point", "active", "weights", "end", "size", "pull"),
            ("numbers", "multipliers", "rest"),
        ),
    )
    inputs = (("rows", m * (n + 3)), ("opening", 1), ("v", n), ("pull", n), ("Z", n * n))
    return Routine("holding", inputs, steps, ("numbers", "multipliers", "rest", "count"))


def largest(vector: ca.SX) -> ca.SX:
    """Return the largest absolute entry of the vector."""
    size = ca.SX(0)
    for i in range(vector.numel()):
        size = ca.fmax(size, ca.fabs(vector[i]))
    return size


def _unit_pull(n: int, precision: Precision) -> Program:
    pull = ca.SX.sym("pull", n)
    size = largest(pull)
    none = ca.logic_not(size > precision.priced)
    unit = pull * ca.if_else(none, 0, 1 / ca.if_else(none, 1, size))
    return lower(ca.Function("unit_pull", [pull], [ca.vertcat(unit, 0), ca.if_else(none, 0, size), none]))


def _touching(n: int, precision: Precision) -> Program:
    """Return a program for a row's bounds on directions from v: 0 at a bound that v touches, otherwise infinite."""
    row, opening, v = ca.SX.sym("row", n + 3), ca.SX.sym("opening"), ca.SX.sym("v", n)
    length = ca.sqrt(ca.sumsqr(row[:n]))
    inverse = 1 / ca.if_else(length <= ZERO_ROW, 1, length)
    value, margin = ca.dot(row[:n], v) * inverse, row[n + 2] * opening - precision.feasibility * (1 + largest(v))
    below = ca.if_else(value <= row[n] * inverse - margin, 0, -HUGE)
    above = ca.if_else(value >= row[n + 1] * inverse + margin, 0, HUGE)
    return lower(ca.Function("touching", [row, opening, v], [ca.vertcat(row[:n] * inverse, below, above, 0)]))


def _scaled(n: int) -> Program:
    # if the solver failed, the rest is the whole pull
    point, active, weights = ca.SX.sym("point", n + 1), ca.SX.sym("active", n), ca.SX.sym("weights", n)
    end, size, pull = ca.SX.sym("end"), ca.SX.sym("size"), ca.SX.sym("pull", n)
    good = ca.eq(end, OPTIMAL)
    outputs = [
        ca.if_else(good, active, 0),
        ca.if_else(good, weights * size, 0),
        ca.if_else(good, point[:n] * size, pull),
    ]
    return lower(
        ca.Function("scaled_weights", [point, active, weights, end, size, pull], list(map(ca.densify, outputs)))
    )


def merged(n: int) -> Program:
    """Instruction list (numbers, multipliers, further numbers, further multipliers), (n,) each → both lists joined.

    A constraint row that the first list already contains is not added again; a row for which no slot is free is
    dropped.
    """
    numbers, multipliers = ca.SX.sym("numbers", n), ca.SX.sym("multipliers", n)
    more, further = ca.SX.sym("more", n), ca.SX.sym("further", n)
    slots, amounts = ca.vertsplit(numbers), ca.vertsplit(multipliers)
    for k in range(n):
        waits = more[k] != 0
        for j in range(n):
            waits = ca.logic_and(waits, ca.fabs(numbers[j]) != ca.fabs(more[k]))
        for j in range(n):
            takes = ca.logic_and(waits, ca.eq(slots[j], 0))
            waits = ca.logic_and(waits, ca.logic_not(takes))
            slots[j], amounts[j] = ca.if_else(takes, more[k], slots[j]), ca.if_else(takes, further[k], amounts[j])
    return lower(
        ca.Function("merged", [numbers, multipliers, more, further], [ca.vertcat(*slots), ca.vertcat(*amounts)])
    )
