"""The safe step: the velocity nearest to a target that meets a first task within limits, and what replaces it.

1. The active-set search of module `kernel` finds the velocity nearest to the target that meets the task J v = x and
   satisfies every constraint row. Most steps of a controller end here, a few times faster than with stage 2. From
   `LOOPED` velocities on, this is no longer faster, and only the bounded fallback makes it.
2. If there is none, if it is not shown to be the nearest, or if the rows of J are nearly dependent, the kernel in
   package `hierarchy` solves the two levels J v = x and v = target. So soft rows are relaxed by the least amount, then
   the task is met as well as possible, then the target is approached.
3. If the hard constraint rows contradict each other, the velocity is the target clipped to the box.

The velocity of every stage is clipped to the box and checked.

With the bounded fallback, stage 1 runs for a few iterations only. If it fails, a method of constant computing cost
replaces stage 2. It first determines a safe point: the target clipped to the box, or v = 0, whichever satisfies the
hard constraint rows and violates the soft rows less. Then it starts from the velocity at which stage 1 stopped and
projects on one violated row after another, in a few sweeps over all constraint rows (Agmon 1954; Motzkin and Schoenberg
1954). The last sweep makes shorter steps, because constraint rows may contradict each other. Finally v moves from the
safe point towards the projected velocity. This move ends before v violates a hard row, or a soft row by more than the
safe point does.

So v violates the constraint rows no more than the safe point does, but v is not optimal: the fallback may miss a
velocity that satisfies all rows, and it does not reduce the task residual.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import casadi as ca

from surctl.errors import InputError
from surctl.ir import Call, Loop, Program, Routine, Step, lower, lower_named
from surctl.priority.hierarchy.kernel import hierarchy
from surctl.priority.settings import ZERO_ROW, Fallback
from surctl.priority.shapes import LevelShape, StackShape
from surctl.priority.solver.dual_step import OPTIMAL, SKIPPED, dot
from surctl.priority.solver.elimination import FLOAT64, LOOPED, Precision, as_matrix, reflect
from surctl.priority.solver.kernel import certificate, into, lanes_of, nearest_point, unit_rows

MET, LIMITED, RELAXED, CLAMPED, BOUNDED, UNCONFIRMED = 1, 2, 3, 4, 5, 6
"""Status of a velocity. MET: the task is met. LIMITED: it is met as well as the constraint rows allow. RELAXED: soft
rows are relaxed. CLAMPED: v is only clipped to the box. BOUNDED: the bounded fallback was used; the opening is then an
upper bound on the violation of any soft row. UNCONFIRMED: v was not shown to be optimal."""

CAP = 4
"""Largest number of iterations of stage 1 with the bounded fallback."""

SOLUTION = ("v", "active", "multipliers", "opening", "status", "count")
"""Names of the outputs of a safe step."""


@dataclass(frozen=True)
class Sizes:
    """What a safe step is compiled for.

    Attributes:
        n: number of velocities. m: number of constraint rows.
        level: the task: number of its rows, and whether it is set-based; None for no task.
        precision: tolerances for the number type. fallback: what replaces stage 1; see the module docstring.
        damping: λ; if it is not 0, the velocity v minimises λ²‖v − target‖² + ‖J v − x‖² within the limits.
    """

    n: int
    m: int
    level: LevelShape | None = None
    precision: Precision = FLOAT64
    fallback: Fallback = "exact"
    damping: float = 0.0

    @property
    def rows(self) -> int:
        """Return the number of entries of the constraint rows."""
        return self.m * (self.n + 3)

    @property
    def lanes(self) -> int:
        """Return the number of constraint rows in a block."""
        return lanes_of(self.m, self.precision)

    @property
    def task(self) -> tuple[tuple[str, int], ...]:
        """Return the inputs of the task."""
        k = self.level.rows if self.level else 0
        return (("J", k * self.n), ("lower", k), ("upper", k)) if self.level else ()

    @property
    def solution(self) -> tuple[tuple[str, int], ...]:
        """Return names and sizes of the outputs."""
        return tuple(zip(SOLUTION, (self.n, self.n, self.n, 1, 1, 1), strict=True))

    def symbols(self) -> dict[str, ca.SX]:
        """Return symbols for target and task."""
        return {name: ca.SX.sym(name, size) for name, size in (("target", self.n), *self.task)}


def limited_step(sizes: Sizes) -> Routine:
    """Return the routine of a safe step.

    Inputs: target (n,); J (k·n,), lower and upper (k,) of the task, if there is one; rows (m·(n + 3),) and box (2n,) as
    in `safe_step`. Outputs, always finite: those of `safe_step`, but `active` first lists the rows that limit the task,
    with multipliers of min ½‖J v − x‖², and a set-based task at its bound has the number m + 1.
    """
    task, fixed = tuple(name for name, _ in sizes.task), (*(name for name, _ in sizes.task), "rows", "box")
    inputs = (("target", sizes.n), *sizes.task, ("rows", sizes.rows), ("box", 2 * sizes.n))
    begun = (*SOLUTION[:4], "met", SOLUTION[5])
    first: tuple[Step, ...] = (
        *unit_rows(sizes.n, sizes.m, sizes.precision),
        *_nearest(sizes),
        Call(certificate(sizes.n, sizes.m, sizes.precision), ("unit", "v"), ("feasible",)),
        Call(_judge(sizes), ("target", *task, "v", "end", "shown", "feasible"), ("met", "opening", "fits")),
    )
    damped = sizes.damping != 0.0 and not (sizes.level and sizes.level.is_set)
    if damped or (sizes.n >= LOOPED and sizes.fallback == "exact"):
        nothing = {name: ca.SX.zeros(size) for name, size in (*sizes.solution, ("fits", 1))}
        first = (Call(lower_named("nothing", {}, nothing), (), (*begun, "fits")),)
    if sizes.fallback == "exact":
        last = Loop(
            _strict(sizes), 1, begun, tuple(f"{k}_last" for k in SOLUTION), fixed=("fits", "target", *fixed), until=4
        )
    else:
        state = (*begun, "end")
        results = tuple(f"{name}_last" for name in (*SOLUTION, "end"))
        last = Loop(_eased(sizes), 1, state, results, fixed=("unit", "target", "box"), until=4)
    finish = Call(
        _finish(sizes),
        ("target", *task, "box", *(f"{name}_last" for name in SOLUTION)),
        tuple(f"{k}_out" for k in SOLUTION),
    )
    return Routine("safe_step", inputs, (*first, last, finish), tuple(f"{name}_out" for name in SOLUTION))


def _nearest(sizes: Sizes) -> tuple[Step, ...]:
    """Return the steps of stage 1: a search without the task, if it is inactive or set-based, then one with the task.

    A set-based task that the first search does not meet is met at the nearest bound in the second.
    """
    n, m, level = sizes.n, sizes.m, sizes.level
    cap = None if sizes.fallback == "exact" else CAP
    free = nearest_point(n, n, m, precision=sizes.precision, cap=cap)
    outcome = ("v", "active", "multipliers", "end", "count", "shown")
    if level is None or sizes.damping:
        zero = lower_named("zero", {}, {"none": ca.SX.zeros(1)})
        return (Call(zero, (), ("none",)), Call(free, ("unit", "target", "none"), outcome))
    begun, once = (tuple(f"{name}_{tag}" for name in outcome) for tag in ("begun", "once"))
    state, table = tuple(zip(outcome, (n, n, n, 1, 1, 1), strict=True)), ("unit", sizes.rows)
    alone = level.rows == 1 or cap is None  # the bounded fallback does not look at inactive tasks of several rows
    first = once if level.rows < n else outcome
    steps: tuple[Step, ...] = (Call(_without_search(sizes), ("J", "lower"), (*(begun if alone else first), "wait")),)
    if alone:
        search = _search(state, (table, ("target", n)), (Call(free, ("unit", "target", "over"), _SEARCHED),))
        steps += (Loop(search, 1, (*begun, "wait"), (*first, "free"), fixed=("unit", "target"), until=6),)
    if level.rows >= n:
        return steps
    d = n - level.rows
    few = nearest_point(n, d, m, precision=sizes.precision, cap=cap)
    narrow = ("v_next", "active_few", "multipliers_few", *_SEARCHED[3:])
    arrays = (("origin", n), ("start", d), ("Z", n * d))
    body = (
        Call(few, ("unit", "origin", "start", "over", "Z"), narrow),
        Call(_padded(n, d), narrow[1:3], _SEARCHED[1:3]),
    )
    return (
        *steps,
        Call(_reflected(sizes), ("target", "J", "lower", "upper", "v_once"), ("origin", "start", "Z", "idle")),
        Loop(
            _search(state, (table, *arrays), body), 1, (*once, "idle"), (*outcome, "over"),
            fixed=("unit", "origin", "start", "Z"), until=6,
        ),
    )  # fmt: skip


_SEARCHED = ("v_next", "active_next", "multipliers_next", "end_next", "spent", "shown_next")


def _search(
    state: tuple[tuple[str, int], ...], fixed: tuple[tuple[str, int], ...], search: tuple[Step, ...]
) -> Routine:
    """Return the body of a loop that runs a search once, and adds the iterations up."""
    one, count, spent = ca.SX.sym("over"), ca.SX.sym("count"), ca.SX.sym("spent")
    add = lower_named("searched", {"over": one, "count": count, "spent": spent}, {"yes": 1.0, "total": count + spent})
    steps = (*search, Call(add, ("over", "count", "spent"), ("yes", "total")))
    results = (*_SEARCHED[:4], "total", _SEARCHED[5], "yes")
    return Routine("search_once", (*state, ("over", 1), *fixed), steps, results)


def _without_search(sizes: Sizes) -> Program:
    """Return a program for the initial result of stage 1, and whether to skip the search without the task.

    If the task has as many rows as there are velocities, v meets the first rows; otherwise no search was made.
    """
    n, level, J, x = (
        sizes.n,
        sizes.level,
        ca.SX.sym("J", dict(sizes.task)["J"]),
        ca.SX.sym("x", dict(sizes.task)["lower"]),
    )
    nothing: dict[str, ca.SX | float] = {name: ca.SX.zeros(n) for name in ("v", "active", "multipliers")}
    end, full, wait = ca.SX(SKIPPED), ca.SX(0), ca.SX(0)
    if level is not None and not level.is_set:
        wait = _largest(J) > ZERO_ROW
        if level.rows >= n:
            left = reflect(as_matrix(J, n)[:n, :], x[:n], ca.SX.zeros(n), sizes.precision)
            full = left.full
            nothing["v"], end = ca.if_else(full, left.origin, 0), ca.if_else(full, OPTIMAL, SKIPPED)
    outputs = {**nothing, "end": end, "count": 0.0, "shown": full, "wait": wait}
    return lower_named("without_search", {"J": J, "x": x}, outputs)


def _reflected(sizes: Sizes) -> Program:
    """Return a program for the inputs of the search with the task, and whether to skip it."""
    n, level, inputs = sizes.n, sizes.level, sizes.symbols() | {"v": ca.SX.sym("v", sizes.n)}
    J, x = inputs["J"], inputs["lower"]
    inactive = ca.logic_not(_largest(J) > ZERO_ROW)
    if level is not None and level.is_set:
        value = as_matrix(J, n) @ inputs["v"]
        x = ca.fmin(ca.fmax(value, inputs["lower"]), inputs["upper"])
        size = _largest(J) * ca.fmax(1, _largest(inputs["v"]))
        inactive = ca.logic_or(inactive, ca.fabs(value - x) <= sizes.precision.priced * size)
    left = reflect(as_matrix(J, n), x, inputs["target"], sizes.precision)
    idle = ca.logic_or(inactive, ca.logic_not(left.full))
    outputs = {"origin": left.origin, "start": left.start, "Z": ca.vec(ca.densify(left.free).T), "idle": idle}
    return lower_named("reflected", inputs, outputs)


def _padded(n: int, d: int) -> Program:
    pair = [ca.SX.sym("active", d), ca.SX.sym("multipliers", d)]
    wide = [ca.densify(ca.vertcat(a, ca.SX.zeros(n - d, 1))) for a in pair]
    return lower(ca.Function("padded", pair, wide))


def _largest(vector: ca.SX) -> ca.SX:
    size = ca.SX(0)
    for i in range(vector.numel()):
        size = ca.fmax(size, ca.fabs(vector[i]))
    return size


def _judge(sizes: Sizes) -> Program:
    """Return a program for the status MET if the v of stage 1 is shown to be the nearest, else 0; and if it fits.

    It fits if it satisfies the constraint rows and meets the task to rounding.
    """
    task, precision = sizes.symbols(), sizes.precision
    v, end, shown, feasible = ca.SX.sym("v", sizes.n), ca.SX.sym("end"), ca.SX.sym("shown"), ca.SX.sym("feasible")
    good, size = ca.logic_and(ca.eq(end, OPTIMAL), feasible), ca.fmax(1, _largest(v))
    if sizes.level is not None:
        matrix = as_matrix(task["J"], sizes.n)
        for k in range(sizes.level.rows):
            square, value = ca.sumsqr(matrix[k, :]), ca.dot(matrix[k, :].T, v)
            miss = ca.fmax(ca.fmax(value - task["upper"][k], task["lower"][k] - value), 0)
            met = miss**2 <= (precision.feasibility * size) ** 2 * square
            good = ca.logic_and(good, ca.logic_or(met, square <= ZERO_ROW**2))
    inputs = {**task, "v": v, "end": end, "shown": shown, "feasible": feasible}
    met = ca.if_else(ca.logic_and(good, shown), MET, 0)
    return lower_named("judge", inputs, {"met": met, "opening": ca.SX.zeros(1), "fits": good})


def _strict(sizes: Sizes) -> Routine:
    """Return the body of a loop that runs once if stage 1 failed: strict priority of task over target (stage 2).

    If the result is not shown to be optimal either, the velocity of stage 1 is returned if it fits.
    """
    n, k = sizes.n, sizes.level.rows if sizes.level else 0
    names = tuple(name for name, _ in sizes.task)
    levels = (*([sizes.level] if sizes.level else []), LevelShape(n))
    shape = StackShape(n, (LevelShape(n + k),) if sizes.damping else levels)
    arrays, outcome = ("J_all", "low_all", "high_all"), (*(f"{name}_next" for name in SOLUTION), "origin")
    near: tuple[Step, ...] = ()
    if sizes.damping and sizes.level and sizes.level.is_set:
        alone = Sizes(n, sizes.m, precision=sizes.precision)
        kernel = hierarchy(StackShape(n, (LevelShape(n),)), sizes.m, sizes.precision)
        near = (
            Call(_levels(alone), ("target",), tuple(f"{name}_near" for name in arrays)),
            Call(
                kernel,
                (*(f"{name}_near" for name in arrays), "rows", "box"),
                ("near", *(f"{k}_near" for k in outcome[1:])),
            ),
        )
    steps = (
        *near,
        Call(_levels(sizes), ("target", *names, *(["near"] if near else [])), arrays),
        Call(hierarchy(shape, sizes.m, sizes.precision), (*arrays, "rows", "box"), outcome),
        Call(_outcome(sizes), (*SOLUTION, "fits", *outcome[:-1]), tuple(f"{name}_all" for name in SOLUTION)),
    )
    fixed = (("fits", 1), ("target", n), *sizes.task, ("rows", sizes.rows), ("box", 2 * n))
    return Routine("strict", (*sizes.solution, *fixed), steps, tuple(f"{name}_all" for name in SOLUTION))


def _levels(sizes: Sizes) -> Program:
    """Return a program for the levels of stage 2, from target and task.

    With damping, a set-based task becomes the equality with its bound that is nearest to the velocity `near`, which
    satisfies the limits and is nearest to the target; no equality if `near` is inside the bounds.
    """
    n, v, eye = sizes.n, sizes.symbols(), ca.SX.eye(sizes.n)
    weight = sizes.damping or 1.0
    J, low, high = [weight * eye], [weight * v["target"]], [weight * v["target"]]
    if sizes.level is not None:
        active, matrix = _largest(v["J"]) > ZERO_ROW, as_matrix(v["J"], n)
        lower_, upper = v["lower"], v["upper"]
        if sizes.damping and sizes.level.is_set:
            v["near"] = ca.SX.sym("near", n)
            value = matrix @ v["near"]
            active = ca.logic_and(active, ca.logic_not(ca.logic_and(lower_ <= value, value <= upper)))
            lower_ = upper = ca.if_else(active, ca.if_else(value < lower_, lower_, upper), 0)
        J, low, high = [ca.if_else(active, matrix, 0), *J], [lower_, *low], [upper, *high]
    outputs = {"J_all": ca.vec(ca.densify(ca.vertcat(*J)).T), "low": ca.vertcat(*low), "high": ca.vertcat(*high)}
    return lower_named("levels", v, outputs)


def _outcome(sizes: Sizes) -> Program:
    # without a task that is met first, no limit limits it
    old = {name: ca.SX.sym(name, size) for name, size in sizes.solution}
    new = {f"{name}_new": ca.SX.sym(f"{name}_new", size) for name, size in sizes.solution}
    fits, status = ca.SX.sym("fits"), new["status_new"]
    stays = ca.logic_and(fits, ca.eq(status, UNCONFIRMED))
    if sizes.level is None or sizes.damping:
        status = ca.if_else(ca.eq(status, LIMITED), MET, status)
    outputs = {f"{name}_all": ca.if_else(stays, old[name], new[f"{name}_new"]) for name in SOLUTION[:4]}
    outputs |= {"status_all": status, "count_all": old["count"] + new["count_new"]}
    return lower_named("outcome", {**old, "fits": fits, **new}, outputs)


_SWEEPS = (1.0, 0.75)  # fractions of the step to a violated row, one for each sweep
_TOGETHER = 4  # rows in one pass of a loop, which keeps the point in registers meanwhile

_Body: TypeAlias = Callable[[list[ca.SX], ca.SX, list[ca.SX]], list[ca.SX]]
"""A function (state, row, fixed) → the next state."""


def _eased(sizes: Sizes) -> Routine:
    """Return the bounded fallback as the body of a loop that runs once if stage 1 failed.

    The number of iterations and `end`, the status of the search, stay unchanged. The new status is `BOUNDED`, or
    `CLAMPED` if neither the target clipped to the box nor v = 0 satisfies the hard constraint rows; v is then the
    clipped target.
    """
    n = sizes.n
    state, fixed = (*sizes.solution, ("end", 1)), (("unit", sizes.rows), ("target", n), ("box", 2 * n))
    steps: tuple[Step, ...] = (
        Call(_start(sizes), ("v", "end", "target", "box"), ("near", "limits", "worst", "hard", "stands", "first")),
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
            ("v_next", "none", "opening_next", "status_next"),
        ),
    )  # fmt: skip
    after = ("v_next", "none", "none", "opening_next", "status_next", "count", "end")
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
    point, end = ca.SX.sym("v", n), ca.SX.sym("end")
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
    outputs = [v, ca.SX.zeros(n), opening, ca.if_else(sound, BOUNDED, CLAMPED)]
    inputs = [near, safe, goal, slack, sound, part, missed]
    return lower(ca.Function("eased_end", inputs, list(map(ca.densify, outputs))))


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
        fallback: "exact" for stage 2 of the module docstring, or "bounded" for a velocity that is not optimal, at
            constant computing cost. Both give equal velocities, to the last bit, if stage 1 succeeds within `CAP`
            iterations. If J has several rows, "bounded" requires linearly independent rows.

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
    if p < 1:
        raise InputError("must be a whole number of at least 1", key="p", value=p)
    inner = limited_step(Sizes(n, m, LevelShape(p), precision, fallback))
    inputs = (("target", n), ("J", p * n), ("x", p), ("rows", m * (n + 3)), ("box", 2 * n))
    steps = (Call(inner, ("target", "J", "x", "x", "rows", "box"), SOLUTION),)
    return Routine("safe_step", inputs, steps, SOLUTION)


def _finish(sizes: Sizes) -> Program:
    # v is finite and inside the box, whatever a stage returned
    n, huge, v = sizes.n, sizes.precision.huge, sizes.symbols()
    own = {name: ca.SX.sym(name, size) for name, size in sizes.solution}
    box = ca.SX.sym("box", 2 * n)
    good, size = own["status"] != CLAMPED, ca.fmax(1, _largest(own["v"]))
    own_task = [v[k] for k in ("J", "lower") if sizes.level and (k == "J" or not sizes.level.is_set)]
    for entry in ca.vertsplit(ca.vertcat(v["target"], *own_task)):
        good = ca.logic_and(good, ca.fabs(entry) <= huge)
    final = []
    for i in range(n):
        start = ca.if_else(ca.eq(own["status"], CLAMPED), v["target"][i], own["v"][i])
        inside = into(start, box[i], box[n + i])
        finite = ca.if_else(ca.fabs(inside) <= huge, inside, 0)
        good = ca.logic_and(good, ca.fabs(finite - start) <= sizes.precision.feasibility * size)
        final.append(finite)
    outputs = {
        "v": ca.vertcat(*final),
        **{name: ca.if_else(good, own[name], 0) for name in ("active", "multipliers", "opening")},
        "status": ca.if_else(good, own["status"], CLAMPED),
        "count": own["count"],
    }
    return lower_named("finish", {**v, "box": box, **own}, {f"{name}_out": value for name, value in outputs.items()})
