"""A strict priority level that is not reachable within the limits: met as well as they allow, then fixed.

Let v be a velocity that satisfies the limits, and v + N y the velocities that do not change the higher levels.
`safe_step` minimises the residual ‖J (v + N y) − x‖ of the level over y within the limits; y = 0 is always feasible.
Nearly dependent constraint rows can reduce the accuracy, so `safe_step` is repeated from the resulting velocity until
the optimality conditions hold (module `tangent`). The value of J v is then fixed by elimination.
"""

from __future__ import annotations

import casadi as ca

from surctl.ir import Call, Loop, Program, Routine, lower
from surctl.priority.compiled.rows import holding_row, reduced_row
from surctl.priority.compiled.sweep import HUGE
from surctl.priority.compiled.tangent import holding, largest, merged
from surctl.priority.solver.dual_step import OPTIMAL, Space
from surctl.priority.solver.elimination import as_matrix
from surctl.priority.solver.fallback import LIMITED, safe_step
from surctl.priority.solver.kernel import certificate, kernel, row_by_row

__all__ = ["limited_level"]

_TURNS = 6
_CONVERGED = 1e-15  # allowed remainder of the gradient, relative to 1 + its largest entry
_STILL = 1e-13  # a step of at most this length, relative to 1 + max |v|, counts as no step


def limited_level(n: int, k: int, m: int) -> Routine:
    """Return the routine that meets one level as well as the limits allow and then fixes its value of J v.

    The routine updates these variables: skip, nonzero to do nothing; v, a velocity that satisfies the constraint rows,
    afterwards the one nearest to 0; base and N of the velocities base + N y that are still free; rows (m·(n + 3),), the
    constraint rows, of length 1; held and hold, numbers and multipliers of the rows that limit levels; active and
    multipliers, numbers and multipliers of the rows active at v; count, number of iterations. Further inputs: N with
    and N without the directions of the level; Q, T Q and Pᵀ·scale from the `Decomposition` of J N; J and x; square =
    1/scale², which scales the multipliers.
    """
    row, space = n + 3, Space(n, n)
    state = (
        ("skip", 1), ("v", n), ("base", n), ("N", n * n), ("rows", m * row), ("held", n), ("hold", n), ("active", n),
        ("multipliers", n), ("count", 1),
    )  # fmt: skip
    fixed = (
        ("N_before", n * n), ("N_less", n * n), ("Q", k * n), ("task", k * n), ("turn", k * k), ("J", k * n), ("x", k),
        ("square", 1),
    )  # fmt: skip
    best = ("v_best", "numbers", "u", "count_best", "converged")
    after = (
        "yes",
        "v_next",
        "base_next",
        "N_less",
        "rows_next",
        "held_next",
        "hold_next",
        "active_next",
        "multipliers_next",
    )
    steps = (
        Call(_nothing(n), ("skip",), ("none", "numbers_0", "u_0", "yes")),
        Loop(
            _again(n, k, m),
            _TURNS,
            carried=("v", "numbers_0", "u_0", "count", "none"),
            results=best,
            fixed=("rows", "N_before", "task", "turn", "J", "x", "square"),
            until=4,
        ),
        Loop(holding_row(n), m, (), ("rows_next",), sliced=("rows",), fixed=("v_best",)),
        Call(_frozen(n, k), ("v_best", "base", "Q"), ("base_held",)),
        Call(
            row_by_row(kernel(space, m), m),
            ("rows_next", "base_held", "none", "N_less"),
            ("point", "act", "press", "end", "spent"),
        ),
        Call(row_by_row(certificate(space, m), m), ("rows_next", "point"), ("feasible",)),
        Call(
            _chosen(n),
            ("v_best", "base_held", "N_less", "point", "act", "press", "end", "feasible", "count_best", "spent"),
            ("v_next", "base_next", "active_next", "multipliers_next", "count_next"),
        ),
        Call(merged(n), ("held", "hold", "numbers", "u"), ("held_next", "hold_next")),
    )
    return Routine("limited_level", (*state, *fixed), steps, (*after, "count_next"))


def _nothing(n: int) -> Program:
    skip, zero = ca.SX.sym("skip"), ca.SX.zeros(n)
    return lower(ca.Function("nothing", [skip], [ca.SX.zeros(1), zero, zero, ca.SX(1)]))


def _again(n: int, k: int, m: int) -> Routine:
    """Return a routine for one repetition: `safe_step` from v, the rows that limit the level, a test of optimality."""
    state = (("v", n), ("numbers", n), ("u", n), ("count", 1), ("converged", 1))
    fixed = (
        ("rows", m * (n + 3)), ("N", n * n), ("task", k * n), ("turn", k * k), ("J", k * n), ("x", k), ("square", 1),
    )  # fmt: skip
    after = tuple(f"{name}_next" for name, _ in state)
    solution = ("y", "active", "multipliers", "opening", "status", "spent")
    steps = (
        Loop(reduced_row(n), m, (), ("reduced",), sliced=("rows",), fixed=("v", "N")),
        Call(_lack(n, k), ("v", "turn", "J", "x"), ("lack", "zero", "anywhere", "none")),
        Call(safe_step(n, k, m), ("zero", "task", "lack", "reduced", "anywhere"), solution),
        Call(_moved(n), ("v", "N", "y", "status"), ("point",)),
        Call(row_by_row(certificate(Space(n, n), m), m), ("rows", "point"), ("feasible",)),
        Call(
            _pulled(n, k),
            ("v", "point", "feasible", "task", "turn", "J", "x"),
            ("v_next", "pull", "moved"),
        ),
        Call(holding(n, m), ("rows", "none", "v_next", "pull", "N"), ("numbers_next", "part", "rest", "more")),
        Call(
            _converged(n),
            ("rest", "pull", "part", "square", "moved", "count", "spent", "more"),
            ("u_next", "count_next", "converged_next"),
        ),
    )
    return Routine("limited_level_again", (*state, *fixed), steps, after)


def _lack(n: int, k: int) -> Program:
    # lack: desired value of T Q y
    v, turn, J, x = ca.SX.sym("v", n), ca.SX.sym("turn", k * k), ca.SX.sym("J", k * n), ca.SX.sym("x", k)
    lack = as_matrix(turn, k) @ (x - as_matrix(J, n) @ v)
    anywhere = ca.vertcat(-HUGE * ca.SX.ones(n), HUGE * ca.SX.ones(n))
    return lower(ca.Function("lack", [v, turn, J, x], [lack, ca.SX.zeros(n), anywhere, ca.SX.zeros(1)]))


def _moved(n: int) -> Program:
    # v does not change if `safe_step` found no point
    v, N, y, status = ca.SX.sym("v", n), ca.SX.sym("N", n * n), ca.SX.sym("y", n), ca.SX.sym("status")
    step = ca.if_else(status <= LIMITED, as_matrix(N, n) @ y, 0)
    return lower(ca.Function("moved", [v, N, y, status], [ca.vertcat(v + step, 0)]))


def _pulled(n: int, k: int) -> Program:
    v, point, feasible = ca.SX.sym("v", n), ca.SX.sym("point", n + 1), ca.SX.sym("feasible")
    task, turn, J, x = ca.SX.sym("task", k * n), ca.SX.sym("turn", k * k), ca.SX.sym("J", k * n), ca.SX.sym("x", k)
    chosen = ca.if_else(feasible, point[:n], v)
    lack = as_matrix(turn, k) @ (x - as_matrix(J, n) @ chosen)
    pull = as_matrix(task, n).T @ lack
    moved = largest(chosen - v) > _STILL * (1 + largest(v))
    return lower(ca.Function("pulled", [v, point, feasible, task, turn, J, x], [chosen, pull, moved]))


def _converged(n: int) -> Program:
    rest, pull, part = (ca.SX.sym(name, n) for name in ("rest", "pull", "part"))
    square, moved = ca.SX.sym("square"), ca.SX.sym("moved")
    counts = [ca.SX.sym(name) for name in ("count", "spent", "more")]
    still = ca.logic_or(largest(rest) <= _CONVERGED * (1 + largest(pull)), ca.logic_not(moved))
    outputs = [part * square, sum(counts, ca.SX(0)), still]
    return lower(ca.Function("converged", [rest, pull, part, square, moved, *counts], list(map(ca.densify, outputs))))


def _frozen(n: int, k: int) -> Program:
    """Return a program for the base of the velocities that are still free once the level's value of J v is fixed."""
    v, base, Q = ca.SX.sym("v", n), ca.SX.sym("base", n), ca.SX.sym("Q", k * n)
    directions = as_matrix(Q, n)
    return lower(ca.Function("frozen", [v, base, Q], [ca.vertcat(base + directions.T @ (directions @ (v - base)), 0)]))


def _chosen(n: int) -> Program:
    # the point nearest to 0 with the level's value of J v; v if rounding leaves no such point
    v, base, N = ca.SX.sym("v", n), ca.SX.sym("base", n + 1), ca.SX.sym("N", n * n)
    point, act, press = ca.SX.sym("point", n + 1), ca.SX.sym("act", n), ca.SX.sym("press", n)
    end, feasible, count, spent = (ca.SX.sym(name) for name in ("end", "feasible", "count", "spent"))
    good = ca.logic_and(ca.eq(end, OPTIMAL), feasible)
    own = v - as_matrix(N, n) @ v
    outputs = [
        ca.if_else(good, point[:n], v),
        ca.if_else(good, base[:n], own),
        ca.if_else(good, act, 0),
        ca.if_else(good, press, 0),
        count + spent,
    ]
    inputs = [v, base, N, point, act, press, end, feasible, count, spent]
    return lower(ca.Function("chosen", inputs, list(map(ca.densify, outputs))))
