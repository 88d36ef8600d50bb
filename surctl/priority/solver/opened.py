"""Stage 3 of the safe step: the smallest amount t by which soft bounds must move outwards so that all rows agree.

The amount t is called the opening. The minimisation of t over v and t subject to the constraint rows is a linear
programme, which is solved by proximal steps. A proximal step with step size γ finds the feasible point nearest to (v, t
− γ), which is a least-distance problem. Finitely many steps reach a minimiser (Mangasarian and Meyer 1979 for a single
step, Ferris 1991 for several steps). After a step of length s, t is at most s·D/γ above the minimum, where D is the
diameter of the feasible set; the iteration stops when this bound is negligible. γ increases from step to step, since
nearly parallel constraint rows need a large γ. In the last step, γ is small to limit rounding errors.
"""

from __future__ import annotations

import casadi as ca

from surctl.ir import Call, Loop, Program, Routine, lower
from surctl.priority.solver.dual_step import OPTIMAL
from surctl.priority.solver.precision import Precision
from surctl.priority.solver.rows import Sizes

__all__ = ["opened"]

_STEPS = 7


def opened(sizes: Sizes) -> Routine:
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
