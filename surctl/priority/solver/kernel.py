"""The least-distance solver, which repeats the active-set iteration of module `dual_step` in a bounded loop.

The processor can evaluate several constraint rows with one vector instruction; the number of rows is called the number
of lanes. Constraint rows are therefore stored in blocks of as many rows as there are lanes: first entry 1 of all rows
in the block, then entry 2, and so on. The solution does not depend on the number of lanes.

`nearest_point` applies the solver to velocities that satisfy equalities too.
"""

from __future__ import annotations

import itertools
import math
from functools import cache

import casadi as ca

from surctl.ir import Call, Gather, Loop, Program, Routine, Step, lower
from surctl.priority.solver.dual_step import SKIPPED, Space, close, halve, iteration, misses, pricing, threshold, which
from surctl.priority.solver.elimination import FLOAT64, Precision, as_matrix


def most_iterations(space: Space) -> int:
    """Return the largest number of iterations of a search; it grows with the number of unknowns d.

    A row that enters costs one iteration, and every row that leaves again one more.
    """
    return max(40, 8 * space.d)


def lanes_of(rows: int, precision: Precision = FLOAT64) -> int:
    """Return the number of rows in a block: the largest of 4, 2, 1 that divides `rows` and is ≤ `precision.lanes`."""
    return math.gcd(rows, precision.lanes)


@cache
def nearest_point(n: int, d: int, rows: int, *, precision: Precision = FLOAT64, cap: int | None = None) -> Routine:
    """Return the routine that finds, of the velocities v = origin + Z y that satisfy all rows, the one nearest to w.

    Inputs: rows (rows·(n + 3),), constraint rows in blocks, each a (of length 1 or 0), lower, upper, soft; origin (n,);
    start (d,), the coordinates y of the velocity nearest to w without the rows; skip, nonzero to do nothing; Z (n·d,),
    row by row, with orthonormal columns. For d = n, `start` is w, and origin and Z are absent. Outputs: v (n,); numbers
    and multipliers (d,) of the active rows; status, 0 if the iteration limit `cap` (None: `most_iterations`) was
    reached, and v then violates rows; count, number of iterations; shown, whether the result is shown to be optimal.

    The rows are converted once to rows on y. Let r be what the weighted normals of the active rows leave of start − y.
    Every other y' that satisfies the rows and is at most D away has (start − y)·(y' − y) ≤ |r| D + Σ weight·gap, where
    gap is the distance of y from the bound. So half the squared distance is at most this much above the least one.
    """
    lanes, space, mapped = lanes_of(rows, precision), Space(d, precision), d < n
    free = ("origin", "Z") if mapped else ()
    blocks = rows // lanes
    names = tuple(f"row{j}" for j in range(d))
    lift = ca.SX.sym("origin", n), ca.SX.sym("Z", n * d), ca.SX.sym("y", d)
    steps: tuple[Step, ...] = (
        Loop(_reduce(n, d), blocks, (), ("table",), sliced=("rows",), fixed=free, lanes=lanes),
        Call(search(space, rows, cap), ("table", "start", "skip"), ("y", "numbers", "multipliers", "status", "count")),
        Call(_indices(d), ("numbers",), tuple(f"at{j}" for j in range(d))),
        *(Gather("table", f"at{j}", space.row, names[j], lanes=lanes) for j in range(d)),
        Call(_shown(space), ("start", "y", "numbers", "multipliers", *names), ("shown",)),
    )  # fmt: skip
    if mapped:
        lifted = lower(ca.Function("lift", list(lift), [lift[0] + as_matrix(lift[1], d) @ lift[2]]))
        steps = (*steps, Call(lifted, ("origin", "Z", "y"), ("v",)))
    sizes = {"origin": n, "start": d, "skip": 1, "Z": n * d}
    inputs = (("rows", rows * (n + 3)), *((k, size) for k, size in sizes.items() if mapped or k in ("start", "skip")))
    outputs = ("v" if mapped else "y", "numbers", "multipliers", "status", "count", "shown")
    return Routine(f"nearest_{d}", inputs, steps, outputs)


def _reduce(n: int, d: int) -> Program:
    # the constraint row on y, for v = origin + Z y
    row, origin, Z = ca.SX.sym("row", n + 3), ca.SX.sym("origin", n), ca.SX.sym("Z", n * d)
    if d == n:
        return lower(ca.Function("reduce", [row], [row[: n + 2]]))
    value = ca.dot(row[:n], origin)
    reduced = ca.vertcat(as_matrix(Z, d).T @ row[:n], row[n] - value, row[n + 1] - value)
    return lower(ca.Function("reduce", [row, origin, Z], [reduced]))


def _indices(d: int) -> Program:
    # −1 for an empty slot
    numbers = ca.SX.sym("numbers", d)
    return lower(ca.Function("indices", [numbers], [ca.fabs(numbers[j]) - 1 for j in range(d)]))


def _shown(space: Space) -> Program:
    d, tight = space.d, space.precision
    start, y, numbers, u = (ca.SX.sym(name, d) for name in ("start", "y", "numbers", "u"))
    rows = [ca.SX.sym(f"row{j}", d + 2) for j in range(d)]
    rest, cost, weight = start - y, ca.SX(0), ca.SX(1)
    square, size = ca.sumsqr(rest), ca.SX(0)
    for j, row in enumerate(rows):
        sign = ca.if_else(ca.eq(numbers[j], 0), 0, ca.if_else(numbers[j] < 0, -u[j], u[j]))
        rest = rest - ca.if_else(ca.eq(numbers[j], 0), 0, sign * row[:d])
        gap = ca.fabs(ca.if_else(numbers[j] < 0, row[d], row[d + 1]) - ca.dot(row[:d], y))
        cost = cost + ca.if_else(ca.eq(numbers[j], 0), 0, u[j] * gap)
        weight = weight + u[j]
        size = ca.fmax(size, ca.fabs(y[j]))
    loss = (ca.sqrt(ca.sumsqr(rest)) + tight.error * weight) * (2 * (1 + size)) + cost
    value = ca.sqrt(square)
    good = ca.logic_or(value <= tight.loss, 2 * loss <= tight.loss * value * (1 + value))
    return lower(ca.Function(f"shown_{d}", [start, y, numbers, u, *rows], [good]))


@cache
def search(space: Space, rows: int, cap: int | None = None) -> Routine:
    """Return the active-set search alone: the point nearest to `base` that satisfies the rows, without entry `soft`.

    Inputs: rows (rows·`space.row`,) in blocks, each of any length; base (d,); skip. Outputs: point, numbers and
    multipliers (d,) of the active rows, status and count as in `nearest_point`.
    """
    state = tuple(name for name, _ in _state(space))
    most = most_iterations(space) if cap is None else cap
    steps = (
        Call(_start(space), ("base", "skip"), tuple(f"{name}_first" for name in state[:-2])),
        *_price(space, rows, "_first"),
        Call(close(), ("best_first", "pending_first", "began_first"), ("status_first",)),
        Loop(
            _turn(space, rows),
            most,
            carried=tuple(f"{name}_first" for name in state),
            results=tuple(f"{name}_last" for name in state),
            fixed=("rows",),
            until=len(state) - 1,
        ),
    )
    inputs = (("rows", rows * space.row), ("base", space.d), ("skip", 1))
    results = ("point_last", "numbers_last", "multipliers_last", "status_last", "count_last")
    return Routine(f"search_{space.d}", inputs, steps, results)


def _state(space: Space) -> tuple[tuple[str, int], ...]:
    d = space.d
    return (
        ("point", d),
        ("normals", d * d),
        ("multipliers", d),
        ("numbers", d),
        ("pending", 2),
        ("began", 1),
        ("count", 1),
        ("best", 2),
        ("status", 1),
    )


def _start(space: Space) -> Program:
    base, skip = ca.SX.sym("base", space.d), ca.SX.sym("skip")
    d = space.d
    zeros = [ca.SX.zeros(size, 1) for size in (d * d, d, d, 2)]
    status = ca.if_else(skip, SKIPPED, 0)
    return lower(ca.Function(f"start_{d}", [base, skip], [base, *map(ca.densify, zeros), status, ca.SX.zeros(1)]))


def _price(space: Space, rows: int, tag: str) -> tuple[Step, ...]:
    """Return the steps that find the row most violated at the variable point{tag}: first per lane, then over lanes."""
    lanes = lanes_of(rows, space.precision)
    names = [f"best{tag}" if left == 1 else f"best{tag}_of_{left}" for left in (8, 4, 2, 1) if left <= lanes]
    halves: list[Step] = []
    for full, half in itertools.pairwise(names):
        lanes_left = lanes // 2 ** (len(halves) + 1)
        halves.append(Loop(halve(), 1, (), (half,), sliced=(full,), lanes=lanes_left))
    return (
        Loop(threshold(space), 1, (), (f"least{tag}",), fixed=(f"point{tag}",), lanes=lanes),
        Loop(
            pricing(space), rows // lanes, (f"least{tag}",), (names[0],), sliced=("rows",),
            fixed=(f"point{tag}",), index=True, lanes=lanes,
        ),
        *halves,
    )  # fmt: skip


def _turn(space: Space, rows: int) -> Routine:
    """Return a routine for one iteration, with the row that is still becoming active or else the most violated row."""
    state, lanes = _state(space), lanes_of(rows, space.precision)
    names = tuple(name for name, _ in state[:-2])
    steps = (
        Call(which(), ("best", "pending"), ("at", "number")),
        Gather("rows", "at", space.row, "row", lanes=lanes),
        Call(
            iteration(space), (*names, "number", "row"),
            tuple(f"{name}_next" for name in names),
        ),
        *_price(space, rows, "_next"),
        Call(close(), ("best_next", "pending_next", "began_next"), ("status_next",)),
    )  # fmt: skip
    inputs = (*state, ("rows", rows * space.row))
    return Routine(f"turn_{space.d}", inputs, steps, tuple(f"{name}_next" for name, _ in state))


@cache
def certificate(n: int, rows: int, precision: Precision = FLOAT64) -> Routine:
    """Return a routine that tests whether a velocity v (n,) satisfies every constraint row.

    The output is 1 if no row is violated by more than `precision.feasibility`·max(1, |v|), otherwise (also for a NaN)
    0.
    """
    lanes = lanes_of(rows, precision)
    feasible, row, v, size = ca.SX.sym("feasible"), ca.SX.sym("row", n + 3), ca.SX.sym("v", n), ca.SX.sym("size")
    above, below = misses(Space(n), row, v)
    good = ca.if_else(below <= size, ca.if_else(above <= size, feasible, 0), 0)
    one = lower(ca.Function("keeps", [feasible, row, v, size], [good]))
    largest = ca.SX(1)
    for i in range(n):
        largest = ca.fmax(largest, ca.fabs(v[i]))
    begin = lower(ca.Function("tolerance", [v], [precision.feasibility * largest]))
    steps = (
        Call(begin, ("v",), ("size",)),
        Loop(_one(), 1, (), ("yes",), lanes=lanes),
        Loop(one, rows // lanes, ("yes",), ("every",), sliced=("rows",), fixed=("v", "size"), lanes=lanes),
        Call(_every(lanes), ("every",), ("feasible",)),
    )
    return Routine("certify", (("rows", rows * (n + 3)), ("v", n)), steps, ("feasible",))


def unit_rows(n: int, rows: int, precision: Precision = FLOAT64) -> tuple[Step, ...]:
    """Return the steps that scale each constraint row to length 1 and store the rows in blocks.

    The steps convert the variable `rows` (rows·(n + 3),), stored row by row, to the variable `unit`. A row with normal
    0 is not scaled; all velocities satisfy this row, or none does. No velocity satisfies a row whose squared length
    exceeds `precision.huge`.
    """
    lanes, begun = lanes_of(rows, precision), "rows"
    if lanes == 1:
        look: tuple[Step, ...] = (
            Call(_one(), (), ("unit_so_far",)),
            Loop(_look(n, precision), rows, ("unit_so_far",), ("all_unit",), sliced=("rows",)),
        )
    else:
        begun, load = "loaded", _look(n, precision, load=True)
        look = (
            Loop(_one(), 1, (), ("unit_so_far",), lanes=lanes),
            Loop(load, rows // lanes, ("unit_so_far",), ("each", "loaded"), spread=("rows",), lanes=lanes),
            Call(_every(lanes), ("each",), ("all_unit",)),
        )
    scaling = _scaling(n, rows, precision)
    return (*look, Loop(scaling, 1, (begun, "all_unit"), ("unit", "scaled"), until=1))


def _one() -> Program:
    return lower(ca.Function("one", [], [ca.SX.ones(1)]))


def _look(n: int, precision: Precision, *, load: bool = False) -> Program:
    # yes: 1 if all constraint rows so far (of this lane) have length 1 or 0
    yes, row = ca.SX.sym("yes"), ca.SX.sym("row", n + 3)
    square = ca.sumsqr(row[:n])
    unit = ca.logic_or(ca.fabs(square - 1) <= precision.unit, ca.eq(square, 0))
    outputs = [ca.if_else(unit, yes, 0), *([row] if load else [])]
    return lower(ca.Function("load" if load else "look", [yes, row], outputs))


def _every(lanes: int) -> Program:
    each, yes = ca.SX.sym("each", lanes), ca.SX(1)
    for k in range(lanes):
        yes = ca.logic_and(yes, each[k])
    return lower(ca.Function("every", [each], [yes]))


def _scaling(n: int, rows: int, precision: Precision) -> Routine:
    """Return the body of a loop that scales the rows once, if some row has a length other than 0 or 1."""
    lanes, row = lanes_of(rows, precision), ca.SX.sym("row", n + 3)
    square = ca.sumsqr(row[:n])
    length = ca.sqrt(square)
    inverse = 1 / ca.if_else(length <= precision.short, 1, length)
    scaled = ca.vertcat(row[: n + 2] * inverse, row[n + 2])
    # its square overflows, so scaling would give a row of zeros that always holds; this row never holds instead
    never = ca.vertcat(ca.SX.zeros(n), 1, 1, 0)
    scale = lower(ca.Function("unit_row", [row], [ca.if_else(square > precision.huge, never, scaled)]))
    one = lower(ca.Function("scaled", [], [ca.SX.ones(1)]))
    steps = (Loop(scale, rows // lanes, (), ("unit",), sliced=("rows",), lanes=lanes), Call(one, (), ("yes",)))
    return Routine("scale", (("rows", rows * (n + 3)), ("done", 1)), steps, ("unit", "yes"))


def into(value: ca.SX, low: ca.SX, high: ca.SX) -> ca.SX:
    """Return the value clipped to the bounds; a NaN becomes the lower bound."""
    above = ca.if_else(low <= value, value, low)
    return ca.if_else(above <= high, above, high)
