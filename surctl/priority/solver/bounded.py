"""The bounded fallback: a velocity, computed at constant cost, if none is found that meets task and constraints.

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
from surctl.priority.solver.dual_step import SKIPPED, dot
from surctl.priority.solver.rows import Sizes, into

__all__ = ["BOUNDED", "CAP", "eased"]

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
