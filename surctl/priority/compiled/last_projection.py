"""The last step of priority mode projected: the projection of a velocity w on level 1, restricted to the limits.

If level 1 has one desired value, one call of `safe_step` with this level as its task gives the result. A set-based
level 1 (lower ≤ J v ≤ upper) needs two calls of `safe_step`. The first call finds the velocity nearest to w within the
limits, without a task. If this velocity violates the bounds of the level, the second call takes the nearer bound as the
desired value of J v. If some velocity satisfies limits and bounds, the result is the one nearest to w. Otherwise the
level misses its bounds by as little as the limits allow; a soft limit is never relaxed for the level.

With damping λ, the residual of the task becomes additional variables s = (J v − x)/λ. The point (v, s) nearest to (w,
0) then minimises ‖v − w‖² + ‖J v − x‖²/λ² subject to the limits.
"""

from __future__ import annotations

import math

import casadi as ca

from surctl.ir import Block, Call, Loop, Program, Routine, Step, lower
from surctl.priority.compiled.decomposition import StackShape, attainable, decompose
from surctl.priority.compiled.sweep import holding, largest, longer_row, merged, opened_row
from surctl.priority.settings import ZERO_ROW, Fallback
from surctl.priority.solver.elimination import FLOAT64, LOOPED, Precision, as_matrix
from surctl.priority.solver.fallback import CLAMPED, LIMITED, MET, RELAXED, safe_step

__all__ = ["last_projection"]

_PLAIN = 1e-4  # bound on squared lengths and a squared sine: far above every cut-off, also in single precision

_APART, _SHORT = 1e-14, 1e-18  # squares too: with _PLAIN they exclude each row that `decompose` calls dependent

_SOLUTION = ("v", "active", "multipliers", "opening", "status", "count")


def last_projection(
    shape: StackShape,
    rows: int,
    *,
    damping: float,
    precision: Precision = FLOAT64,
    named: bool = True,
    fallback: Fallback = "exact",
) -> Routine:
    """Return the routine that projects w (n,) on level 1, restricted to the limits.

    Inputs: w; count (1,), number of iterations so far; J, lower, upper, rows and box as in `priority_step`. Outputs: v,
    active, multipliers, opening, status and count, also as in `priority_step`.
    """
    n, named = shape.n, named and fallback == "exact"  # the bounded fallback does not report which rows limit a task
    inputs = (("w", n), ("before", 1), *shape.inputs, ("rows", rows * (n + 3)), ("box", 2 * n))
    steps: tuple[Step, ...]
    if damping > 0.0:
        steps = _damped(shape, rows, damping, precision)
    elif shape.levels[0].is_set:
        steps = _slab(shape, rows, precision, named=named, fallback=fallback)
    else:
        steps = _value(shape, rows, precision, named=named, fallback=fallback)
    outputs = tuple(f"{name}_out" for name in _SOLUTION)
    add = Call(_sum(), ("before", outputs[-1]), ("total",))
    return Routine("last_projection", inputs, (*steps, add), (*outputs[:-1], "total"))


def _sum() -> Program:
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    return lower(ca.Function("sum", [a, b], [a + b]))


def _task(shape: StackShape, fallback: Fallback) -> tuple[Step, ...]:
    """Return the steps that compute the Jacobian of level 1 and its desired value without the unattainable part."""
    # two clearly independent rows of J_1 attain any x_1; the bounded fallback ignores other rows, since their
    # attainable part is costly to compute
    k, stack = shape.levels[0].rows, ("J", "lower", "upper")
    if k != 2:
        return (Call(_first(shape), stack, ("J_1", "x_1")),)
    if fallback != "exact":
        return (Call(_independent(shape), stack, ("J_1", "x_1")),)
    one = lower(ca.Function("done", [ca.SX.sym("plain")], [ca.SX.ones(1)]))
    state = (("J_1", k * shape.n), ("x_1", k), ("plain", 1))
    turn = Routine(
        "reachable",
        (*state, *shape.inputs),
        (Call(_first(shape), stack, ("J_next", "x_next")), Call(one, ("plain",), ("done",))),
        ("J_next", "x_next", "done"),
    )
    return (
        Call(_plain(shape), stack, ("J_raw", "x_raw", "plain")),
        Loop(turn, 1, ("J_raw", "x_raw", "plain"), ("J_1", "x_1", "known"), fixed=stack, until=2),
    )


def _plain(shape: StackShape) -> Program:
    """Return a program for a level 1 with two Jacobian rows, which also tests whether these rows are well conditioned.

    Outputs: the Jacobian; the desired value; whether the rows have similar length and are not parallel.
    """
    flat, levels = shape.symbols()
    J = levels[0].J
    a, b, both = ca.sumsqr(J[0, :]), ca.sumsqr(J[1, :]), ca.dot(J[0, :].T, J[1, :].T)
    plain = ca.logic_and(a > _PLAIN * b, b > _PLAIN * a)
    plain = ca.logic_and(plain, ca.logic_and(a > _PLAIN**3, a * b - both * both > _PLAIN * (a * b)))
    return lower(ca.Function("plain", flat, [ca.densify(ca.vec(J.T)), ca.densify(levels[0].lower), plain]))


def _independent(shape: StackShape) -> Program:
    # two nearly parallel or very unequal rows become zeros
    flat, levels = shape.symbols()
    J, x = levels[0].J, levels[0].lower
    a, b, both = ca.sumsqr(J[0, :]), ca.sumsqr(J[1, :]), ca.dot(J[0, :].T, J[1, :].T)
    fine = ca.logic_and(a > _APART * b, b > _APART * a)
    fine = ca.logic_and(fine, ca.logic_and(a > _SHORT, a * b - both * both > _PLAIN * (a * b)))
    outputs = [ca.if_else(fine, ca.vec(J.T), 0), ca.if_else(fine, x, 0)]
    return lower(ca.Function("independent", flat, list(map(ca.densify, outputs))))


def _first(shape: StackShape) -> Block:
    """Return a block for the Jacobian of level 1 and its desired value without the part that no velocity attains."""
    flat, levels = shape.symbols()
    J, x = levels[0].J, levels[0].lower
    k = J.shape[0]
    if k > 1 and shape.n >= LOOPED:
        take = lower(ca.Function("level_1", flat, [ca.densify(ca.vec(J.T)), ca.densify(x)]))
        names = tuple(name for name, _ in shape.inputs)
        steps = (
            Call(take, names, ("J_raw", "x_raw")),
            Call(attainable(k, shape.n), ("J_raw", "x_raw"), ("J_1", "x_1")),
        )
        return Routine("first", shape.inputs, steps, ("J_1", "x_1"))
    if k > 1:
        parts = decompose(J)
        full = ca.eq(parts.rank, k)
        J, x = ca.if_else(full, J, parts.task()), ca.if_else(full, x, parts.turned(x))
    else:
        x = ca.if_else(largest(J.T) > ZERO_ROW, x, 0)
    return lower(ca.Function("first", flat, [ca.densify(ca.vec(J.T)), ca.densify(x)]))


def _value(shape: StackShape, rows: int, precision: Precision, *, named: bool, fallback: Fallback) -> tuple[Step, ...]:
    raw, outputs = tuple(f"{name}_step" for name in _SOLUTION), tuple(f"{name}_out" for name in _SOLUTION)
    k, inputs = shape.levels[0].rows, ("w", "J_1", "x_1", "rows", "box")
    return (
        *_task(shape, fallback),
        Call(safe_step(shape.n, k, rows, precision=precision, fallback=fallback), inputs, raw if named else outputs),
        *([Call(_named(shape.n, k, rows, precision), ("J_1", "x_1", "rows", *raw), outputs)] if named else []),
    )


def _named(n: int, k: int, rows: int, precision: Precision) -> Routine:
    """Return a routine that adds the constraint rows that limit task 1 at the head of the list of active rows."""
    solution = (("v", n), ("active", n), ("multipliers", n), ("opening", 1), ("status", 1), ("count", 1))
    fixed = (("rows", rows * (n + 3)), ("v", n), ("opening", 1), ("pull", n), ("Z", n * n))
    add = Routine(
        "add_holding",
        (("met", 1), *solution[1:3], ("count", 1), *fixed),
        (
            Call(
                holding(n, rows, precision),
                ("rows", "opening", "v", "pull", "Z"),
                ("numbers", "weights", "rest", "spent"),
            ),
            Call(merged(n), ("numbers", "weights", "active", "multipliers"), ("active_next", "multipliers_next")),
            Call(_sum(), ("count", "spent"), ("total",)),
        ),
        ("met", "active_next", "multipliers_next", "total"),
    )
    state = ("met", "active", "multipliers", "count")
    steps = (
        Call(_pull(n, k), ("J_1", "x_1", "v", "status"), ("met", "pull", "Z")),
        Loop(add, 1, state, tuple(f"{name}_last" for name in state), fixed=tuple(name for name, _ in fixed), until=0),
    )
    inputs = (("J_1", k * n), ("x_1", k), ("rows", rows * (n + 3)), *solution)
    return Routine("named", inputs, steps, ("v", "active_last", "multipliers_last", "opening", "status", "count_last"))


def _pull(n: int, k: int) -> Program:
    J, x, v, status = ca.SX.sym("J", k * n), ca.SX.sym("x", k), ca.SX.sym("v", n), ca.SX.sym("status")
    matrix = as_matrix(J, n)
    met = ca.logic_not(ca.logic_or(ca.eq(status, LIMITED), ca.eq(status, RELAXED)))
    outputs = [met, matrix.T @ (x - matrix @ v), ca.vec(ca.SX.eye(n))]
    return lower(ca.Function("pull_1", [J, x, v, status], list(map(ca.densify, outputs))))


def _slab(shape: StackShape, rows: int, precision: Precision, *, named: bool, fallback: Fallback) -> tuple[Step, ...]:
    n = shape.n
    solution = (("v", n), ("active", n), ("multipliers", n), ("opening", 1), ("status", 1), ("count", 1))
    task = (("J_1", n), ("x_1", 1))
    raw = tuple(f"{name}_step" for name in _SOLUTION)
    fixed = (("w", n), *shape.inputs, ("rows", rows * (n + 3)), ("box", 2 * n))
    state = (*(name for name, _ in task), *_SOLUTION, "done")
    after = tuple(f"{name}_next" for name in state)
    side = Routine(
        "side",
        (*task, *solution, ("done", 1), *fixed),
        (
            Call(
                safe_step(n, 1, rows, precision=precision, fallback=fallback), ("w", "J_1", "x_1", "rows", "box"), raw
            ),
            Call(_side(shape, precision), ("J", "lower", "upper", *state[2:8], *raw), after),
        ),
        after,
    )
    start = ("no_J", "no_x", "no_v", "no_active", "no_multipliers", "no_opening", "no_status", "no_count", "not_done")
    outputs = tuple(f"{name}_out" for name in _SOLUTION)
    last = ("J_last", "x_last", *((f"{name}_slab" for name in _SOLUTION) if named else outputs), "done_last")
    empty = [ca.SX.zeros(size) for size in (n, 1, n, n, n, 1, 1, 1, 1)]
    w = ca.SX.sym("w", n)
    return (
        Call(lower(ca.Function("empty", [w], empty)), ("w",), start),
        Loop(side, 2, start, last, fixed=tuple(name for name, _ in fixed), until=8),
        *([Call(_named(n, 1, rows, precision), ("J_last", "x_last", "rows", *last[2:8]), outputs)] if named else []),
    )


def _side(shape: StackShape, precision: Precision) -> Program:
    """Return a program that chooses between the two solutions for a set-based level 1, and its next desired value."""
    n, (flat, levels) = shape.n, shape.symbols()
    sizes = (n, n, n, 1, 1, 1)
    old = [ca.SX.sym(f"{name}_old", size) for name, size in zip(_SOLUTION, sizes, strict=True)]
    new = [ca.SX.sym(f"{name}_new", size) for name, size in zip(_SOLUTION, sizes, strict=True)]
    J, v = levels[0].J, new[0]
    value, desired = J @ v, levels[0].desired(v)
    met = ca.fabs(value - desired) <= precision.priced * largest(J.T) * (1 + largest(v))
    inside = ca.logic_or(met, ca.logic_not(largest(J.T) > ZERO_ROW))
    second = old[4] != 0
    # if the second step overflows, the solution of the first is returned, which satisfies the rows
    failed = ca.logic_and(second, ca.eq(new[4], CLAMPED))
    chosen = [ca.if_else(failed, a, b) for a, b in zip(old, new, strict=True)]
    chosen[4] = ca.if_else(failed, ca.fmax(old[4], LIMITED), new[4])
    chosen[5] = old[5] + new[5]
    done = ca.logic_or(ca.logic_or(second, inside), ca.eq(new[4], CLAMPED))
    outputs = [J.T, desired, *chosen, done]
    return lower(ca.Function("choose_side", [*flat, *old, *new], list(map(ca.densify, outputs))))


def _damped(shape: StackShape, rows: int, damping: float, precision: Precision) -> tuple[Step, ...]:
    """Return the steps of the last projection with damping λ, in the variables v and s = (J v − x)/λ."""
    # the first `safe_step`, without a task, opens soft limits if necessary
    n, level = shape.n, shape.levels[0]
    q, wide = level.rows, shape.n + level.rows
    p, m = (1, rows + 1) if level.is_set else (q, rows)
    plain, raw = (tuple(f"{name}_{tag}" for name in _SOLUTION) for tag in ("plain", "wide"))
    w = ca.SX.sym("w", n)
    no_task = lower(ca.Function("no_task", [w], [ca.SX.zeros(n), ca.SX.zeros(1)]))
    return (
        Call(no_task, ("w",), ("no_J", "no_x")),
        Call(safe_step(n, 1, rows, precision=precision), ("w", "no_J", "no_x", "rows", "box"), plain),
        Loop(opened_row(n), rows, (), ("rows_open",), sliced=("rows",), fixed=("opening_plain", "v_plain")),
        Loop(longer_row(n, q), rows, (), ("rows_longer",), sliced=("rows_open",)),
        Call(
            _with_miss(shape, rows, damping),
            ("w", "J", "lower", "upper", "rows_longer", "box"),
            ("w_wide", "J_wide", "x_wide", "rows_wide", "box_wide"),
        ),
        Call(safe_step(wide, p, m, precision=precision), ("w_wide", "J_wide", "x_wide", "rows_wide", "box_wide"), raw),
        Call(_narrow(n, wide, rows, damping), (*plain, *raw), tuple(f"{name}_out" for name in _SOLUTION)),
    )


def _with_miss(shape: StackShape, rows: int, damping: float) -> Program:
    """Return a program for the inputs of `safe_step` in variables (v, s); a set-based level becomes a row."""
    n, (flat, levels) = shape.n, shape.symbols()
    level = levels[0]
    q = level.J.shape[0]
    w, limits, box = ca.SX.sym("w", n), ca.SX.sym("rows", rows * (n + q + 3)), ca.SX.sym("box", 2 * n)
    J, x, more = ca.horzcat(level.J, -damping * ca.SX.eye(q)), level.lower, ca.SX(0, 1)
    if level.is_set:
        more = ca.vertcat(J.T, level.lower, level.upper, 0)
        J, x = ca.SX.zeros(1, n + q), ca.SX.zeros(1)
    far = math.inf * ca.SX.ones(q)
    outputs = [
        ca.vertcat(w, ca.SX.zeros(q)),
        ca.vec(ca.densify(J).T),
        x,
        ca.vertcat(limits, more),
        ca.vertcat(box[:n], -far, box[n:], far),
    ]
    return lower(ca.Function("with_miss", [w, *flat, limits, box], list(map(ca.densify, outputs))))


def _narrow(n: int, wide: int, rows: int, damping: float) -> Program:
    """Return a program for the final v, from the solution (v, s) or, if that failed, from the solution without task."""
    # at most n active rows are independent, so n slots are enough; the multipliers belong to the damped problem
    plain = [ca.SX.sym(f"{name}_plain", size) for name, size in zip(_SOLUTION, (n, n, n, 1, 1, 1), strict=True)]
    full = [ca.SX.sym(f"{name}_wide", size) for name, size in zip(_SOLUTION, (wide,) * 3 + (1, 1, 1), strict=True)]
    slots, multipliers = [ca.SX(0)] * n, [ca.SX(0)] * n
    for number, multiplier in zip(ca.vertsplit(full[1]), ca.vertsplit(full[2]), strict=True):
        waits = ca.logic_and(number != 0, ca.fabs(number) <= rows)
        for j in range(n):
            takes = ca.logic_and(waits, ca.eq(slots[j], 0))
            waits = ca.logic_and(waits, ca.logic_not(takes))
            slots[j] = ca.if_else(takes, number, slots[j])
            multipliers[j] = ca.if_else(takes, damping**2 * multiplier, multipliers[j])
    good = ca.logic_and(ca.eq(full[4], MET), plain[4] != CLAMPED)
    better = (full[0][:n], ca.vertcat(*slots), ca.vertcat(*multipliers))
    outputs = [
        *(ca.if_else(good, a, b) for a, b in zip(better, plain[:3], strict=True)),
        plain[3],
        ca.if_else(good, plain[4], ca.fmax(plain[4], LIMITED)),
        plain[5] + full[5],
    ]
    return lower(ca.Function("narrow", [*plain, *full], list(map(ca.densify, outputs))))
