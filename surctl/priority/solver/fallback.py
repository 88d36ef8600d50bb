"""The safe step: a velocity nearest to a target within constraints, with fallback stages so that one always exists.

1. Stage 1 finds the velocity nearest to the target that meets the task J v = x and satisfies every constraint row.
2. If stage 1 has no solution, stage 2 meets the task as well as the constraint rows allow. Of all velocities that do
   so, it finds the one nearest to the target.
3. If the constraint rows contradict each other, stage 3 moves the bounds of the soft rows outwards by the smallest
   sufficient amount, called the opening, and repeats stage 2.
4. If the hard constraint rows contradict each other, the velocity is the target clipped to the box.

The velocity of every stage is clipped to the box and checked. Module `stages` describes how stages 1 to 3 are solved.

With the bounded fallback, stage 1 runs for a few iterations only. If stage 1 fails, a method of constant computing cost
replaces the other stages; see module `bounded`.

This fallback runs after stage 1 of module `fallback`, the search for a velocity that meets the task, has failed or
needs too many iterations. It first determines a safe point: the target clipped to the box, or v = 0, whichever
satisfies the hard constraint rows and violates the soft rows less. Then it starts from the velocity at which stage 1
stopped and projects on one violated row after another, in a few sweeps over all constraint rows (Agmon 1954; Motzkin
and Schoenberg 1954). The last sweep makes shorter steps, because constraint rows may contradict each other. Finally v
moves from the safe point towards the projected velocity. This move ends before v violates a hard row, or a soft row by
more than the safe point does.

So v violates the constraint rows no more than the safe point does, but v is not optimal: the fallback may miss a
velocity that satisfies all rows, and it does not reduce the task residual.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeAlias

import casadi as ca

from surctl.ir import Call, Loop, Program, Routine, Step, lower
from surctl.priority.settings import Fallback
from surctl.priority.solver.dual_step import OPTIMAL, SKIPPED, dot
from surctl.priority.solver.elimination import FLOAT64, Precision, as_matrix
from surctl.priority.solver.kernel import Sizes, into, unit_rows
from surctl.priority.solver.stages import LIMITED, RELAXED, exact_stage, lower_stages

__all__ = ["BOUNDED", "CAP", "CLAMPED", "LIMITED", "MET", "RELAXED", "eased", "safe_step"]

CAP = 4
"""Largest number of iterations of stage 1 with the bounded fallback."""

BOUNDED = 5
"""Status of the bounded fallback; the opening is then an upper bound on the violation of any soft row."""

_SWEEPS = (1.0, 0.75)  # fractions of the step to a violated row, one for each sweep
_TOGETHER = 4  # rows in one pass of a loop, which keeps the point in registers meanwhile

_Body: TypeAlias = Callable[[list[ca.SX], ca.SX, list[ca.SX]], list[ca.SX]]
"""A function (state, row, fixed) → the next state."""


def eased(sizes: Sizes) -> Routine:
    """Return the bounded fallback as the body of a loop that runs once if stage 1 of module `fallback` fails.

    The body updates point (n + 1,), which is v and the opening; active (n,) and multipliers (n,), which become 0; and
    status. The number of iterations and the final status of stage 1 stay unchanged. Further inputs are the constraint
    rows, the target and the box. The new status is `BOUNDED`, or 0 if neither the target clipped to the box nor v = 0
    satisfies the hard constraint rows; the point is then the clipped target.
    """
    n = sizes.n
    state = (("point", n + 1), ("active", n), ("multipliers", n), ("status", 1), ("count", 1), ("end", 1))
    fixed = (("unit", sizes.rows), ("target", n), ("box", 2 * n))
    steps: tuple[Step, ...] = (
        Call(_start(sizes), ("point", "end", "target", "box"), ("near", "limits", "worst", "hard", "stands", "first")),
        _over_rows(
            sizes, _compare, (("first", n), ("worst", 2), ("hard", 2)), (("near", n),),
            results=("once", "worst_all", "hard_all"),
        ),
        Call(
            _choose(sizes), ("near", "limits", "stands", "worst_all", "hard_all"),
            ("safe", "slack", "sound", "part", "missed"),
        ),
        _over_rows(sizes, _sweep_again, (("once", n),), (), results=("twice",)),
        Call(_inside(sizes), ("twice", "near", "box"), ("goal",)),
        _over_rows(
            sizes, _step_fraction, (("part", 1), ("missed", 1)), (("safe", n), ("goal", n), ("slack", 2)),
            results=("part_all", "missed_all"),
        ),
        Call(
            _end(sizes), ("near", "safe", "goal", "slack", "sound", "part_all", "missed_all"),
            ("point_next", "none", "status_next"),
        ),
    )  # fmt: skip
    after = ("point_next", "none", "none", "status_next", "count", "end")
    return Routine("eased", (*state, *fixed), steps, after)


def _over_rows(
    sizes: Sizes,
    body: _Body,
    state: tuple[tuple[str, int], ...],
    fixed: tuple[tuple[str, int], ...],
    *,
    results: tuple[str, ...],
) -> Loop:
    """Return a loop that applies `body` to one constraint row after another."""
    width, lanes = sizes.n + 3, sizes.lanes
    together = lanes if lanes > 1 else math.gcd(sizes.m, _TOGETHER)
    block = ca.SX.sym("rows", together * width)
    begun = [ca.SX.sym(key, size) for key, size in state]
    constants = [ca.SX.sym(key, size) for key, size in fixed]
    carried = begun
    for j in range(together):
        row = block[j::lanes] if lanes > 1 else block[j * width : (j + 1) * width]
        carried = body(carried, row, constants)
    name = f"{body.__name__.strip('_')}_rows"
    one = lower(ca.Function(name, [*begun, block, *constants], list(map(ca.densify, carried))))
    names, others = (tuple(key for key, _ in ports) for ports in (state, fixed))
    return Loop(one, sizes.m // together, names, results, sliced=("unit",), fixed=others)


def _start(sizes: Sizes) -> Program:
    """Return a program for the initial values of the bounded fallback.

    Outputs: the target clipped to the box; the largest violation at which a hard row counts as satisfied, for this
    point and for v = 0; initial values 0 for the largest violations of all rows and of the hard rows; whether the box
    contains v = 0; the velocity from which the projections start.
    """
    n, precision = sizes.n, sizes.precision
    point, end = ca.SX.sym("point", n + 1), ca.SX.sym("end")
    target, box = ca.SX.sym("target", n), ca.SX.sym("box", 2 * n)
    near = [into(target[i], box[i], box[n + i]) for i in range(n)]
    stands, size, searched = ca.SX(1), ca.SX(1), end != SKIPPED
    for i in range(n):
        stands = ca.logic_and(stands, ca.logic_and(box[i] <= 0, box[n + i] >= 0))
        size = ca.fmax(size, ca.fabs(near[i]))
        searched = ca.logic_and(searched, ca.fabs(point[i]) <= precision.huge)
    first = [ca.if_else(searched, into(point[i], box[i], box[n + i]), near[i]) for i in range(n)]
    outputs = [
        ca.vertcat(*near),
        ca.vertcat(precision.feasibility * size, precision.feasibility),
        ca.SX.zeros(2),
        ca.SX.zeros(2),
        stands,
        ca.vertcat(*first),
    ]
    return lower(ca.Function("ease", [point, end, target, box], list(map(ca.densify, outputs))))


def _misses(row: ca.SX, value: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the amounts by which `value` is above a row's upper and below its lower bound (negative if not)."""
    return value - row[-2], row[-3] - value


def _compare(state: list[ca.SX], row: ca.SX, fixed: list[ca.SX]) -> list[ca.SX]:
    """Project on one row in the first sweep; update the largest violations by the clipped target and by v = 0."""
    (point, worst, hard), (near,) = state, fixed
    after: list[tuple[ca.SX, ca.SX]] = []
    for k, (above, below) in enumerate((_misses(row, dot(row[:-3], near)), (-row[-2], row[-3]))):
        missed = ca.fmax(above, below)
        after.append((ca.fmax(worst[k], missed), ca.fmax(hard[k], (1 - row[-1]) * missed)))
    return [_moved(point, row, _SWEEPS[0]), *(ca.vertcat(*(entry[k] for entry in after)) for k in range(2))]


def _choose(sizes: Sizes) -> Program:
    """Return a program that chooses the safe point: the clipped target `near` or v = 0.

    Outputs: the safe point; the allowed violation of a soft row (that of the safe point plus rounding) and of a hard
    row (rounding); whether the safe point satisfies the hard rows; the initial values 1 and 0 for `_step_fraction`.
    """
    near, limits, stands = ca.SX.sym("near", sizes.n), ca.SX.sym("limits", 2), ca.SX.sym("stands")
    worst, hard = ca.SX.sym("worst", 2), ca.SX.sym("hard", 2)
    feasible = hard[0] <= limits[0]
    nearer = ca.logic_and(feasible, worst[0] < worst[1])
    still = ca.logic_and(ca.logic_and(stands, hard[1] <= limits[1]), ca.logic_not(nearer))
    least = ca.if_else(still, worst[1], worst[0])
    outputs = [
        ca.if_else(still, 0, near),
        ca.vertcat(least + sizes.precision.priced / sizes.precision.feasibility * limits[0], limits[0]),
        ca.logic_or(feasible, still),
        ca.SX(1),
        ca.SX.zeros(1),
    ]
    return lower(ca.Function("choose_safe", [near, limits, stands, worst, hard], list(map(ca.densify, outputs))))


def _sweep_again(state: list[ca.SX], row: ca.SX, fixed: list[ca.SX]) -> list[ca.SX]:
    return [_moved(state[0], row, _SWEEPS[1])]


def _moved(point: ca.SX, row: ca.SX, part: float) -> ca.SX:
    value = dot(row[:-3], point)
    missed = value - ca.fmin(ca.fmax(value, row[-3]), row[-2])
    return point - (part * missed) * row[:-3]


def _inside(sizes: Sizes) -> Program:
    n = sizes.n
    point, near, box = ca.SX.sym("point", n), ca.SX.sym("near", n), ca.SX.sym("box", 2 * n)
    finite = ca.SX(1)
    for i in range(n):
        finite = ca.logic_and(finite, ca.fabs(point[i]) <= sizes.precision.huge)
    goal = [ca.if_else(finite, into(point[i], box[i], box[n + i]), near[i]) for i in range(n)]
    return lower(ca.Function("goal", [point, near, box], [ca.vertcat(*goal)]))


def _step_fraction(state: list[ca.SX], row: ca.SX, fixed: list[ca.SX]) -> list[ca.SX]:
    """Reduce the fraction of the path from `safe` to `goal` until the row is violated by at most its allowed amount.

    Also update the largest violation of a row by `goal`.
    """
    (part, missed), (safe, goal, slack) = state, fixed
    from_, to = dot(row[:-3], safe), dot(row[:-3], goal)
    above, below = _misses(row, from_)
    change = to - from_
    left = ca.if_else(row[-1] != 0, slack[0], slack[1]) - ca.if_else(change > 0, above, below)
    size = ca.fabs(change)
    sooner = left < part * size
    above, below = _misses(row, to)
    return [ca.if_else(sooner, left / ca.if_else(sooner, size, 1), part), ca.fmax(ca.fmax(missed, above), below)]


def _end(sizes: Sizes) -> Program:
    n = sizes.n
    near, safe, goal = (ca.SX.sym(name, n) for name in ("near", "safe", "goal"))
    slack, sound, part, missed = ca.SX.sym("slack", 2), ca.SX.sym("sound"), ca.SX.sym("part"), ca.SX.sym("missed")
    share = ca.if_else(part > 0, part, 0)
    v = ca.if_else(sound, safe + share * (goal - safe), near)
    # the largest violation is convex along the path, so interpolation between its ends is an upper bound
    opening = slack[0] + share * (missed - slack[0])
    opening = ca.if_else(ca.logic_and(sound, opening > slack[1]), opening, 0)
    outputs = [ca.vertcat(v, opening), ca.SX.zeros(n), ca.if_else(sound, BOUNDED, 0)]
    inputs = [near, safe, goal, slack, sound, part, missed]
    return lower(ca.Function("eased_end", inputs, list(map(ca.densify, outputs))))


MET, CLAMPED = 1, 4
"""Status values besides `LIMITED`, `RELAXED`, `BOUNDED`. MET: task met. CLAMPED: v is only clipped to the box."""


def safe_step(n: int, p: int, m: int, *, precision: Precision = FLOAT64, fallback: Fallback = "exact") -> Routine:
    """Return the routine of a safe step, which finds the velocity v nearest to a target within constraints.

    Inputs: target (n,); J (p·n,) and x (p,) of the task J v = x; rows (m·(n + 3),), m constraint rows lower ≤ a·v ≤
    upper of any length, each stored as a (n,), lower, upper, soft (1 if the row may be relaxed, otherwise 0); box
    (2n,), lower and upper bounds of v. Outputs, always finite: v (n,); active (n,), signed numbers of the active
    constraint rows, from 1 (+ at the upper bound, − at the lower bound, 0 for an unused entry); multipliers (n,),
    Lagrange multipliers of the active rows in min ½‖v − target‖², for rows of length 1; opening (1,), the amount by
    which the bounds of soft rows are moved outwards [row of length 1]; status (1,), `MET`, `LIMITED`, `RELAXED`,
    `BOUNDED` or `CLAMPED`; count (1,), total number of iterations.

    Args:
        n: number of velocities, at least 1.
        p: number of rows of J, at least 1 (for no task, pass a row of zeros with x = 0).
        m: number of constraint rows, at least 1 (an unused row is all zeros with infinite bounds); multiples of 8 are
            fastest.
        precision: tolerances for the number type with which the routine runs.
        fallback: "exact" for stages 2 to 4 of the module docstring, or "bounded" for a velocity that is not optimal, at
            constant computing cost. Both give equal velocities, to the last bit, if stage 1 succeeds within
            `bounded.CAP` iterations. If J has several rows, "bounded" requires linearly independent rows.

    Example:
        >>> import numpy as np
        >>> from surctl.ir import replay
        >>> from surctl.priority import safe_step
        >>> step = safe_step(2, 1, 1)
        >>> wall, box = [1.0, 0.0, -np.inf, 0.1, 1.0], [-1.0, -1.0, 1.0, 1.0]
        >>> v, active, force, *_ = replay(step, [0.3, 0.4], [0.0, 0.0], [0.0], wall, box)
        >>> v.round(3).tolist(), active.tolist(), force.round(3).tolist()
        ([0.1, 0.4], [1.0, 0.0], [0.2, 0.0])
    """
    exact = fallback == "exact"
    sizes = Sizes(n, p, m, precision, cap=None if exact else CAP)
    down = _exact_stages(sizes) if exact else _bounded_stages(sizes)
    steps = (
        *unit_rows(sizes),
        Call(_zero(), (), ("none",)),
        Call(
            exact_stage(sizes), ("unit", "target", "J", "x", "none"),
            ("point", "active", "multipliers", "end", "count"),
        ),
        *down,
        Call(
            _finish(sizes), ("point_down", "status_down", "none_down" if exact else "none", "target", "J", "x", "box"),
            ("v", "opening", "outcome"),
        ),
    )  # fmt: skip
    inputs = (("target", n), ("J", p * n), ("x", p), ("rows", sizes.rows), ("box", 2 * n))
    return Routine(
        "safe_step",
        inputs,
        steps,
        ("v", "active_down", "multipliers_down", "opening", "outcome", "count_down"),
    )


def _exact_stages(sizes: Sizes) -> tuple[Step, ...]:
    """Return the steps that check the velocity of stage 1, and run the other stages if stage 1 failed."""
    carried = ("point", "active", "multipliers", "status", "count", "none")
    after = tuple(f"{name}_down" for name in carried)
    return (
        Call(sizes.certificate, ("unit", "point"), ("feasible",)),
        Call(_judge(sizes), ("point", "end", "feasible", "J", "x"), ("status",)),
        Loop(_down(sizes), 1, carried=carried, results=after, fixed=("unit", "target", "J", "x", "box"), until=3),
    )


def _bounded_stages(sizes: Sizes) -> tuple[Step, ...]:
    """Return the steps that check the velocity of stage 1, and run the bounded fallback if stage 1 failed."""
    end = ca.SX.sym("end")
    failed = lower(ca.Function("failed", [end], [ca.logic_not(ca.eq(end, OPTIMAL))]))
    one = lower(ca.Function("done", [ca.SX.sym("failed")], [ca.SX.ones(1)]))
    look = Routine(
        "look_again",
        (("feasible", 1), ("failed", 1), ("unit", sizes.rows), ("point", sizes.n + 1)),
        (Call(sizes.certificate, ("unit", "point"), ("feasible_next",)), Call(one, ("failed",), ("done",))),
        ("feasible_next", "done"),
    )
    carried = ("point", "active", "multipliers", "status", "count", "end")
    after = tuple(f"{name}_down" for name in carried)
    return (
        Call(failed, ("end",), ("failed",)),
        Loop(look, 1, carried=("none", "failed"), results=("feasible", "looked"), fixed=("unit", "point"), until=1),
        Call(_judge(sizes), ("point", "end", "feasible", "J", "x"), ("status",)),
        Loop(eased(sizes), 1, carried=carried, results=after, fixed=("unit", "target", "box"), until=3),
    )


def _zero() -> Program:
    return lower(ca.Function("zero", [], [ca.SX.zeros(1)]))


def _down(sizes: Sizes) -> Routine:
    """Return the body of a loop that runs once if stage 1 failed; it runs stages 2 and 3 up to two times."""
    n, p = sizes.n, sizes.p
    state = (("point", n + 1), ("active", n), ("multipliers", n), ("status", 1), ("count", 1), ("safe", 1))
    fixed = (("unit", sizes.rows), ("target", n), ("J", p * n), ("x", p), ("box", 2 * n))
    carried = tuple(name for name, _ in state)
    begun = ("closed", *carried[1:])
    results = tuple(f"{name}_next" for name in carried)
    steps = (
        Call(_near(n), ("target", "box"), ("near", "closed")),
        Loop(
            lower_stages(sizes), 2, carried=begun, results=results, fixed=("unit", "target", "near", "J", "x"), until=3
        ),
    )
    return Routine("descend", (*state, *fixed), steps, results)


def _near(n: int) -> Program:
    target, box = ca.SX.sym("target", n), ca.SX.sym("box", 2 * n)
    near = ca.vertcat(*(into(target[i], box[i], box[n + i]) for i in range(n)))
    return lower(ca.Function("near", [target, box], [near, ca.densify(ca.vertcat(near, 0))]))


def _judge(sizes: Sizes) -> Program:
    # MET: every row of J v = x holds to rounding, relative to the length of the row
    n, p = sizes.n, sizes.p
    point, end, feasible = ca.SX.sym("point", n + 1), ca.SX.sym("end"), ca.SX.sym("feasible")
    J, x = ca.SX.sym("J", p * n), ca.SX.sym("x", p)
    matrix, size, short = as_matrix(J, n), ca.SX(1), sizes.precision.short**2
    for i in range(n):
        size = ca.fmax(size, ca.fabs(point[i]))
    good = ca.logic_and(ca.eq(end, OPTIMAL), feasible)
    for k in range(p):
        square = ca.sumsqr(matrix[k, :])
        allowed = (sizes.precision.feasibility * size) ** 2 * ca.if_else(square <= short, 1, square)
        good = ca.logic_and(good, (ca.dot(matrix[k, :].T, point[:n]) - x[k]) ** 2 <= allowed)
    return lower(ca.Function("judge", [point, end, feasible, J, x], [ca.if_else(good, MET, 0)]))


def _finish(sizes: Sizes) -> Program:
    # a point from a non-finite task or target is no solution; if no stage found a solution (status 0), a point of stage
    # 3 that satisfies the opened constraint rows is accepted
    n, p, huge = sizes.n, sizes.p, sizes.precision.huge
    point, status, box = ca.SX.sym("point", n + 1), ca.SX.sym("status"), ca.SX.sym("box", 2 * n)
    target, J, x = ca.SX.sym("target", n), ca.SX.sym("J", p * n), ca.SX.sym("x", p)
    safe, v = ca.SX.sym("safe"), []
    reached = ca.if_else(ca.logic_and(ca.eq(status, 0), safe), RELAXED, status)
    good, size = reached != 0, ca.SX(1)
    for entry in ca.vertsplit(ca.vertcat(target, J, x)):
        good = ca.logic_and(good, ca.fabs(entry) <= huge)
    for i in range(n):
        size = ca.fmax(size, ca.fabs(point[i]))
    for i in range(n):
        inside = into(point[i], box[i], box[n + i])
        finite = ca.if_else(ca.fabs(inside) <= huge, inside, 0)
        good = ca.logic_and(good, ca.fabs(finite - point[i]) <= sizes.precision.feasibility * size)
        v.append(finite)
    opening = ca.if_else(good, point[n], 0)
    outputs = [ca.vertcat(*v), opening, ca.if_else(good, reached, CLAMPED)]
    return lower(ca.Function("finish", [point, status, safe, target, J, x, box], outputs))
