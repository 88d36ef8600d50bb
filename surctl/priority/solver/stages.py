"""The first three stages of the safe step, each as a routine that calls the least-distance solver.

1. `exact_stage` finds the velocity nearest to the target that meets the task J v = x and satisfies every constraint
   row.
2. `least_squares` meets the task as well as the constraint rows allow. Stage 1 with J v fixed at the least-squares
   value then finds the velocity nearest to the target.
3. `_opened` finds the smallest amount, the opening, by which the bounds of the soft rows must be moved outwards.
   Stage 2 follows with the moved bounds.

`lower_stages` runs stage 2 and, if stage 2 fails, stage 3; module `fallback` calls it up to two times.

The amount t is called the opening. The minimisation of t over v and t subject to the constraint rows is a linear
programme, which is solved by proximal steps. A proximal step with step size γ finds the feasible point nearest to (v, t
− γ), which is a least-distance problem. Finitely many steps reach a minimiser (Mangasarian and Meyer 1979 for a single
step, Ferris 1991 for several steps). After a step of length s, t is at most s·D/γ above the minimum, where D is the
diameter of the feasible set; the iteration stops when this bound is negligible. γ increases from step to step, since
nearly parallel constraint rows need a large γ. In the last step, γ is small to limit rounding errors.
"""

from __future__ import annotations

import casadi as ca

from surctl.ir import Call, Loop, Program, Routine, Step, lower
from surctl.priority.solver.dual_step import OPTIMAL
from surctl.priority.solver.elimination import (
    LOOPED,
    Precision,
    as_matrix,
    corrected,
    eliminate,
    elimination,
    flat,
    reflect,
    split_basis,
)
from surctl.priority.solver.kernel import Sizes, reduced_kernel
from surctl.priority.solver.least_squares import least_squares

__all__ = ["LIMITED", "RELAXED", "exact_stage", "lower_stages"]

_STEPS = 7


def _opened(sizes: Sizes) -> Routine:
    """Return the routine that finds the smallest opening of the soft constraint rows.

    Inputs: unit, the constraint rows scaled to length 1; near (n,), the initial v; point (n + 1,), velocity and opening
    so far; skip, nonzero to do nothing. Outputs: wide (n + 1,), a velocity and the smallest opening plus a margin for
    rounding, at least the opening so far, or `point` if the search failed; solved, whether the search succeeded;
    feasible, whether wide satisfies the constraint rows with this opening; count, number of iterations.
    """
    n, tight = sizes.n, sizes.precision
    state = ("low", "gamma", "ends", "solved", "count")
    steps = (
        Call(_begin(n, tight), ("near", "skip"), state),
        Loop(
            _turn(sizes), _STEPS, carried=state, results=tuple(f"{k}_last" for k in state),
            fixed=("unit",), until=2,
        ),
        Call(_clean(n, tight), ("low_last", "solved_last"), ("base", "idle")),
        Call(sizes.opening_kernel, ("unit", "base", "idle"), ("cleaned", "numbers", "u", "end", "spent")),
        Call(
            _widened(n, tight),
            ("low_last", "solved_last", "cleaned", "end", "point", "count_last", "spent"),
            ("wide", "solved_any", "count_all"),
        ),
        Call(sizes.opening_certificate, ("unit", "wide"), ("feasible",)),
    )  # fmt: skip
    inputs = (("unit", sizes.rows), ("near", n), ("point", n + 1), ("skip", 1))
    return Routine("opened", inputs, steps, ("wide", "solved_any", "feasible", "count_all"))


def _begin(n: int, precision: Precision) -> Program:
    near, skip = ca.SX.sym("near", n), ca.SX.sym("skip")
    outputs = [ca.vertcat(near, 0), ca.SX(precision.pull), skip, ca.SX.zeros(1), ca.SX.zeros(1)]
    return lower(ca.Function("open_begin", [near, skip], list(map(ca.densify, outputs))))


def _turn(sizes: Sizes) -> Routine:
    """Return a routine for one proximal step; if the step fails, the loop ends and the point stays unchanged."""
    n = sizes.n
    steps = (
        Call(_pull(n), ("low", "gamma"), ("base", "go")),
        Call(sizes.opening_kernel, ("unit", "base", "go"), ("next", "numbers", "u", "end", "spent")),
        Call(
            _judge(n, sizes.precision),
            ("low", "gamma", "ends", "solved", "count", "next", "end", "spent"),
            tuple(f"{k}_next" for k in ("low", "gamma", "ends", "solved", "count")),
        ),
    )
    inputs = (("low", n + 1), ("gamma", 1), ("ends", 1), ("solved", 1), ("count", 1), ("unit", sizes.rows))
    results = tuple(f"{k}_next" for k in ("low", "gamma", "ends", "solved", "count"))
    return Routine("open", inputs, steps, results)


def _size(point: ca.SX) -> ca.SX:
    size = ca.SX(0)
    for entry in ca.vertsplit(point):
        size = ca.fmax(size, ca.fabs(entry))
    return 1 + size


def _pull(n: int) -> Program:
    point, gamma = ca.SX.sym("point", n + 1), ca.SX.sym("gamma")
    base = ca.vertcat(point[:n], point[n] - gamma * _size(point))
    return lower(ca.Function("pull", [point, gamma], [base, ca.SX.zeros(1)]))


def _judge(n: int, precision: Precision) -> Program:
    # the loop stops if t can hardly decrease further, or if the step failed
    low, gamma, ends, solved = ca.SX.sym("low", n + 1), ca.SX.sym("gamma"), ca.SX.sym("ends"), ca.SX.sym("solved")
    count, after, why, spent = ca.SX.sym("count"), ca.SX.sym("after", n + 1), ca.SX.sym("why"), ca.SX.sym("spent")
    good = ca.eq(why, OPTIMAL)
    moved = ca.SX(0)
    for i in range(n + 1):
        moved = ca.fmax(moved, ca.fabs(after[i] - low[i]))
    converged = moved <= precision.gap * gamma * _size(low)
    outputs = [
        ca.if_else(good, after, low),
        precision.growth * gamma,
        ca.logic_or(ca.logic_not(good), converged),
        ca.logic_or(solved, good),
        count + spent,
    ]
    inputs = [low, gamma, ends, solved, count, after, why, spent]
    return lower(ca.Function("open_judge", inputs, list(map(ca.densify, outputs))))


def _clean(n: int, precision: Precision) -> Program:
    # the target of the last step, and whether to skip the last step
    low, solved = ca.SX.sym("low", n + 1), ca.SX.sym("solved")
    base = ca.vertcat(low[:n], low[n] - precision.pull * _size(low))
    return lower(ca.Function("clean", [low, solved], [base, ca.logic_not(solved)]))


def _widened(n: int, precision: Precision) -> Program:
    # the result of the last step, else of the loop, else the input; the opening gets a margin
    low, solved, cleaned = ca.SX.sym("low", n + 1), ca.SX.sym("solved"), ca.SX.sym("cleaned", n + 1)
    end, point = ca.SX.sym("end"), ca.SX.sym("point", n + 1)
    count, spent = ca.SX.sym("count"), ca.SX.sym("spent")
    best = ca.if_else(ca.eq(end, OPTIMAL), cleaned, low)
    wider = best[n] + precision.margin * (1 + ca.fabs(best[n]))
    wide = ca.if_else(solved, ca.vertcat(best[:n], ca.fmax(wider, point[n])), point)
    inputs = [low, solved, cleaned, end, point, count, spent]
    return lower(ca.Function("widened", inputs, [ca.densify(wide), solved, count + spent]))


LIMITED, RELAXED = 2, 3
"""Status of stages 2 and 3: the task is met as well as the constraint rows allow; soft rows are relaxed."""


def exact_stage(sizes: Sizes) -> Routine:
    """Return the routine of stage 1, which meets the task J v = x and satisfies every constraint row.

    Inputs: unit, the constraint rows scaled to length 1; target; J and x; skip, nonzero to do nothing. Outputs: point,
    which is v and the opening 0; numbers and multipliers of the active rows; status; number of iterations. If the p
    rows of J are linearly independent, their elimination leaves n − p unknowns; otherwise there are n unknowns. With
    the bounded fallback, stage 1 ends with status `SKIPPED` if J has several rows and these are linearly dependent.
    """
    n, p, fast = sizes.n, sizes.p, sizes.fast
    outputs = ("point", "active", "multipliers", "status", "count")
    fixed = (("unit", sizes.rows), ("target", n), ("J", p * n), ("x", p), ("skip", 1))
    names = tuple(name for name, _ in fixed)
    if fast is None:
        return Routine("hard", fixed, (Call(_dependent(sizes), names, outputs),), outputs)
    state = (*outputs, "full")
    begun = ("point_fast", "active_wide", "multipliers_wide", "status_fast", "count_fast", "ends")
    steps: tuple[Step, ...] = (
        Call(_reflected(sizes, fast.d), names[1:], ("origin", "start", "free", "ends", "idle")),
        Call(
            reduced_kernel(fast, sizes.m, sizes.cap), ("unit", "origin", "start", "idle", "free"),
            tuple(f"{name}_fast" for name in outputs),
        ),
        Call(_padded(n, fast.d), ("active_fast", "multipliers_fast"), ("active_wide", "multipliers_wide")),
    )  # fmt: skip
    if sizes.cap is not None and p > 1:
        return Routine("hard", fixed, steps, begun[:-1])
    steps += (Loop(_otherwise(sizes), 1, carried=begun, results=state, fixed=names, until=5),)
    return Routine("hard", fixed, steps, outputs)


def _reflected(sizes: Sizes, d: int) -> Program:
    """Return a program for the inputs of `reduced_kernel`, and two flags: use only this search; skip it."""
    # first flag: this solver is enough (J has independent rows, or stage 1 is skipped); second flag: skip this solver
    n, p = sizes.n, sizes.p
    target, J, x, skip = ca.SX.sym("target", n), ca.SX.sym("J", p * n), ca.SX.sym("x", p), ca.SX.sym("skip")
    left = reflect(as_matrix(J, n), x, target, sizes.precision)
    outputs = [
        left.origin,
        left.start,
        flat(left.free),
        ca.logic_or(skip, left.full),
        ca.logic_or(skip, ca.logic_not(left.full)),
    ]
    return lower(ca.Function("reflected", [target, J, x, skip], list(map(ca.densify, outputs))), reciprocals=True)


def _padded(n: int, d: int) -> Program:
    pair = [ca.SX.sym("active", d), ca.SX.sym("multipliers", d)]
    wide = [ca.densify(ca.vertcat(a, ca.SX.zeros(n - d, 1))) for a in pair]
    return lower(ca.Function("padded", pair, wide))


def _otherwise(sizes: Sizes) -> Routine:
    """Return the body of a loop that runs once if rows of J are linearly dependent, with a search in n unknowns."""
    n, p = sizes.n, sizes.p
    sizes_of = (("point", n + 1), ("active", n), ("multipliers", n), ("status", 1), ("count", 1), ("ends", 1))
    fixed = (("unit", sizes.rows), ("target", n), ("J", p * n), ("x", p), ("skip", 1))
    fresh = tuple(f"{name}_next" for name, _ in sizes_of[:-1])
    steps = (
        Call(_dependent(sizes), tuple(name for name, _ in fixed), fresh),
        Call(_done("ends"), ("ends",), ("ends_next",)),
    )
    return Routine("otherwise", (*sizes_of, *fixed), steps, (*fresh, "ends_next"))


def _dependent(sizes: Sizes) -> Routine:
    """Return a variant of `exact_stage` for any J; a row that is linearly dependent on earlier rows is skipped."""
    n, p = sizes.n, sizes.p
    prepare = _eliminated(sizes) if n < LOOPED else _eliminated_in_loops(sizes)
    results = ("point", "active", "multipliers", "status", "count")
    steps = (
        Call(prepare, ("target", "J", "x"), ("base", "free")),
        Call(sizes.general_kernel, ("unit", "base", "skip", "free"), results),
    )
    fixed = (("unit", sizes.rows), ("target", n), ("J", p * n), ("x", p), ("skip", 1))
    return Routine("dependent", fixed, steps, results)


def _eliminated(sizes: Sizes) -> Program:
    n, p = sizes.n, sizes.p
    target, J, x = ca.SX.sym("target", n), ca.SX.sym("J", p * n), ca.SX.sym("x", p)
    matrix = as_matrix(J, n)
    left = eliminate(matrix, sizes.precision)
    spanned = [left.rank > i for i in range(n)]
    free = ca.horzcat(*(ca.if_else(spanned[i], 0, left.basis[:, i]) if i < p else left.basis[:, i] for i in range(n)))
    base = target + left.lift @ (x - matrix @ target)
    base = base + left.lift @ (x - matrix @ base)  # a far target costs digits, so the correction is repeated
    outputs = [ca.vertcat(base, 0), flat(free)]
    return lower(ca.Function("eliminated", [target, J, x], list(map(ca.densify, outputs))))


def _eliminated_in_loops(sizes: Sizes) -> Routine:
    n, p = sizes.n, sizes.p
    v = ca.SX.sym("v", n)
    close = lower(ca.Function("closed", [v], [ca.densify(ca.vertcat(v, 0))]))
    steps = (
        Call(elimination(p, n, sizes.precision), ("J",), ("lift", "basis", "rank")),
        Call(split_basis(n), ("basis", "rank"), ("span", "free")),
        Call(corrected(n, p), ("target", "lift", "J", "x"), ("once",)),
        Call(corrected(n, p), ("once", "lift", "J", "x"), ("twice",)),
        Call(close, ("twice",), ("base",)),
    )
    return Routine("eliminated", (("target", n), ("J", p * n), ("x", p)), steps, ("base", "free"))


def lower_stages(sizes: Sizes) -> Routine:
    """Return the routine of stages 2 and 3, which minimises the task residual or else moves soft bounds outwards."""
    n, p = sizes.n, sizes.p
    state = (("point", n + 1), ("active", n), ("multipliers", n), ("status", 1), ("count", 1), ("safe", 1))
    fixed = (("unit", sizes.rows), ("target", n), ("near", n), ("J", p * n), ("x", p))
    ends = ("point", "active", "multipliers", "end", "count")
    first, again = (tuple(f"{name}_{tag}" for name in ends) for tag in ("limited", "again"))
    steps = (
        Loop(
            _open_row(sizes), sizes.blocks, (), ("open",), sliced=("unit",), fixed=("point",), lanes=sizes.lanes
        ),
        Call(_opening(n), ("point",), ("opening",)),
        Call(least_squares(sizes), ("open", "near", "opening", "J", "x"), first),
        Call(_value(sizes), ("point_limited", "end_limited", "J"), ("held", "no", "yes", "none")),
        Loop(
            _again(sizes), 1, carried=(*first[:3], "none", "none", "none", "no"),
            results=(*again, "feasible_again", "over_again"), fixed=("open", "target", "J", "held"), until=6,
        ),
        Loop(
            _opening_turn(sizes), 1, carried=("point", "none", "none", "none", "yes"),
            results=("wide", "solved", "feasible_wide", "count_opened", "over_opened"), fixed=("unit", "near"), until=4,
        ),
        Call(
            _outcome(sizes),
            (
                "point", "count", "safe", "yes", "feasible_again", "wide", "solved", "feasible_wide", "count_opened",
                *first, *again,
            ),
            tuple(f"{name}_next" for name, _ in state),
        ),
    )  # fmt: skip
    return Routine("down", (*state, *fixed), steps, tuple(f"{name}_next" for name, _ in state))


def _again(sizes: Sizes) -> Routine:
    """Return the body of a loop that runs stage 1 once with the value of J v from stage 2, if stage 2 succeeded."""
    n, p = sizes.n, sizes.p
    state = (
        ("point", n + 1), ("active", n), ("multipliers", n), ("end", 1), ("count", 1), ("feasible", 1), ("no", 1),
    )  # fmt: skip
    fixed = (("open", sizes.rows), ("target", n), ("J", p * n), ("held", p))
    after = tuple(f"{name}_next" for name, _ in state)
    steps = (
        Call(exact_stage(sizes), ("open", "target", "J", "held", "no"), after[:5]),
        Call(sizes.certificate, ("open", "point_next"), ("feasible_next",)),
        Call(_done("no"), ("no",), ("no_next",)),
    )
    return Routine("again", (*state, *fixed), steps, after)


def _opening_turn(sizes: Sizes) -> Routine:
    """Return the body of a loop that computes the smallest opening of the soft rows once, if stage 2 failed."""
    n = sizes.n
    state = (("point", n + 1), ("solved", 1), ("feasible", 1), ("count", 1), ("yes", 1))
    after = tuple(f"{name}_next" for name, _ in state)
    steps = (
        Call(_opened(sizes), ("unit", "near", "point", "yes"), after[:4]),
        Call(_done("yes"), ("yes",), ("yes_next",)),
    )
    return Routine("opening", (*state, ("unit", sizes.rows), ("near", n)), steps, after)


def _done(flag: str) -> Program:
    # the output 1 ends the loop after one pass
    return lower(ca.Function("done", [ca.SX.sym(flag)], [ca.SX.ones(1)]))


def _opening(n: int) -> Program:
    point = ca.SX.sym("point", n + 1)
    return lower(ca.Function("opening", [point], [point[n]]))


def _open_row(sizes: Sizes) -> Program:
    n = sizes.n
    row, point = ca.SX.sym("row", n + 3), ca.SX.sym("point", n + 1)
    widening = row[n + 2] * point[n]
    moved = ca.vertcat(row[:n], row[n] - widening, row[n + 1] + widening, row[n + 2])
    return lower(ca.Function("open_row", [row, point], [moved]))


def _value(sizes: Sizes) -> Program:
    n, p = sizes.n, sizes.p
    point, end, J = ca.SX.sym("point", n + 1), ca.SX.sym("end"), ca.SX.sym("J", p * n)
    good = ca.eq(end, OPTIMAL)
    outputs = [as_matrix(J, n) @ point[:n], ca.logic_not(good), good, ca.SX.zeros(1)]
    return lower(ca.Function("value", [point, end, J], outputs))


def _outcome(sizes: Sizes) -> Program:
    # the better of two results of stage 2; if both failed, the point of stage 3 and its opening
    n = sizes.n
    point, count, safe = ca.SX.sym("point", n + 1), ca.SX.sym("count"), ca.SX.sym("safe")
    yes, feasible, wide = ca.SX.sym("yes"), ca.SX.sym("feasible"), ca.SX.sym("wide", n + 1)
    solved, feasible_wide, spent = ca.SX.sym("solved"), ca.SX.sym("feasible_wide"), ca.SX.sym("spent")

    def symbols(tag: str) -> list[ca.SX]:
        names = ("point", "active", "multipliers", "end", "count")
        return [ca.SX.sym(f"{k}_{tag}", s) for k, s in zip(names, (n + 1, n, n, 1, 1), strict=True)]

    limited, again = symbols("limited"), symbols("again")
    better = ca.logic_and(yes, ca.logic_and(ca.eq(again[3], OPTIMAL), feasible))
    final = [ca.vertcat(again[0][:n], point[n]), again[1], again[2]]
    chosen = [ca.if_else(better, final[k], limited[k]) for k in range(3)]
    empty = ca.SX.zeros(n, 1)
    outputs = [
        ca.if_else(yes, chosen[0], wide),
        ca.if_else(yes, chosen[1], empty),
        ca.if_else(yes, chosen[2], empty),
        ca.if_else(yes, ca.if_else(point[n] > 0, RELAXED, LIMITED), 0),
        count + limited[4] + again[4] + spent,
        ca.logic_or(safe, ca.logic_and(solved, feasible_wide)),
    ]
    inputs = [point, count, safe, yes, feasible, wide, solved, feasible_wide, spent, *limited, *again]
    return lower(ca.Function("outcome", inputs, list(map(ca.densify, outputs))))
