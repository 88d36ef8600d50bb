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
"""

from __future__ import annotations

import casadi as ca

from surctl.ir import Call, Loop, Program, Routine, Step, lower
from surctl.priority.settings import Fallback
from surctl.priority.solver.bounded import BOUNDED, CAP, eased
from surctl.priority.solver.dual_step import OPTIMAL
from surctl.priority.solver.elimination import as_matrix
from surctl.priority.solver.precision import FLOAT64, Precision
from surctl.priority.solver.rows import Sizes, into, unit_rows
from surctl.priority.solver.stages import LIMITED, RELAXED, exact_stage, lower_stages

__all__ = ["BOUNDED", "CLAMPED", "LIMITED", "MET", "RELAXED", "safe_step"]

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
