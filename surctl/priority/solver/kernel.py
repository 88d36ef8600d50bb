"""The least-distance solver, which repeats the active-set iteration of module `dual_step` in a bounded loop.

The processor can evaluate several constraint rows with one vector instruction; the number of rows is called the number
of lanes. Constraint rows are therefore stored in blocks of as many rows as there are lanes: first entry 1 of all rows
in the block, then entry 2, and so on. The solution does not depend on the number of lanes.

`Sizes` holds the numbers of variables and rows of a safe step, and the routines that several of its stages call.
"""

from __future__ import annotations

import itertools
import math
from functools import cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.ir import Call, Gather, Loop, Program, Routine, Step, lower
from surctl.priority.solver.dual_step import (
    SKIPPED,
    Space,
    close,
    halve,
    iteration,
    misses,
    pricing,
    threshold,
    which,
)
from surctl.priority.solver.elimination import FLOAT64, Precision, as_matrix

__all__ = [
    "Sizes",
    "certificate",
    "in_blocks",
    "into",
    "kernel",
    "lanes_of",
    "most_iterations",
    "reduced_kernel",
    "row_by_row",
    "search",
    "unit_rows",
]


def most_iterations(space: Space) -> int:
    """Return the largest number of iterations of a search; it grows with the number of unknowns d.

    A row that enters costs one iteration, and every row that leaves again one more. If the opening is unknown too,
    every soft row can become active, so the number is doubled.
    """
    return (2 if space.opening else 1) * max(40, 8 * space.d)


def lanes_of(rows: int, precision: Precision = FLOAT64) -> int:
    """Return the number of rows in a block: the largest of 4, 2, 1 that divides `rows` and is ≤ `precision.lanes`."""
    return math.gcd(rows, precision.lanes)


def in_blocks(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Reorder constraint rows (…, rows, width) to blocks (…, rows·width) as the routines for double take them."""
    *batch, count, width = rows.shape
    lanes = lanes_of(count)
    return np.swapaxes(rows.reshape(*batch, count // lanes, lanes, width), -1, -2).reshape(*batch, count * width)


def row_by_row(routine: Routine, rows: int, precision: Precision = FLOAT64) -> Routine:
    """Return a version of the routine whose first input, the constraint rows, is stored row by row, not in blocks."""
    if lanes_of(rows, precision) == 1:
        return routine
    (name, size), *others = routine.inputs
    table = ca.SX.sym(name, size)
    order = in_blocks(np.arange(size, dtype=np.float64).reshape(rows, size // rows)).astype(int).tolist()
    arrange = lower(ca.Function(f"in_blocks_{rows}", [table], [table[order]]))
    rest, results = tuple(other for other, _ in others), tuple(result for result, _ in routine.outputs)
    steps = (Call(arrange, (name,), ("blocks",)), Call(routine, ("blocks", *rest), results))
    return Routine(f"{routine.name}_row_by_row", routine.inputs, steps, results)


@cache
def kernel(space: Space, rows: int, cap: int | None = None) -> Routine:
    """Return the routine that finds the point base + Z y with the smallest ‖y‖ that satisfies all constraint rows.

    The point consists of v and the opening t, the amount by which the bounds of soft rows are moved outwards. If t is
    unknown, Z is the identity; otherwise Z acts on v only.

    Inputs: rows (rows·(n + 3),), constraint rows in blocks, each a (of length 1 or 0), lower, upper, soft; base (n +
    1,); skip, nonzero to return the base with status `SKIPPED`; Z (n·d,), row by row, with orthonormal columns, or an
    orthogonal projector; Z is absent if t is unknown. Outputs: point (n + 1,); numbers and multipliers (d,) of the
    active rows; status, 0 if the iteration limit `cap` (None: `most_iterations`) was reached, and the point then
    violates rows; count, number of iterations.
    """
    n, d = space.n, space.d
    free = () if space.opening else (("Z", n * d),)
    base, x = ca.SX.sym("base", n + 1), ca.SX.sym("x", space.point)
    take = lower(ca.Function(f"take_{space.point}", [base], [base[: space.point]]))
    full = x if space.opening else ca.vertcat(x, base[n])
    give = lower(ca.Function(f"give_{space.point}", [x, base], [full]))
    steps = (
        Call(take, ("base",), ("start",)),
        Call(
            search(space, rows, cap),
            ("rows", "start", "skip", *(name for name, _ in free)),
            ("x", "numbers", "multipliers", "status", "count"),
        ),
        Call(give, ("x", "base"), ("point",)),
    )
    inputs = (("rows", rows * (n + 3)), ("base", n + 1), ("skip", 1), *free)
    return Routine(f"nearest_{d}", inputs, steps, ("point", "numbers", "multipliers", "status", "count"))


@cache
def reduced_kernel(space: Space, rows: int, cap: int | None = None) -> Routine:
    """Return a routine with the outputs of `kernel` that searches in d < n unknowns y.

    Inputs: rows and skip as in `kernel`, origin (n,), start (d,), Z (n·d,). The velocity is origin + Z y, where y is
    the feasible vector nearest to start; the opening is 0. The constraint rows are converted once to constraints on y.
    If the origin is much larger than the solution, the bounds of the converted rows are inaccurate; start may be far
    from the solution.
    """
    n, d = space.n, space.d
    lanes = lanes_of(rows, space.precision)
    small = Space(d, d, mapped=False, precision=space.precision)
    origin, Z, y = ca.SX.sym("origin", n), ca.SX.sym("Z", n * d), ca.SX.sym("y", d)
    lift = lower(ca.Function("lift", [origin, Z, y], [ca.vertcat(origin + as_matrix(Z, d) @ y, 0)]))
    steps = (
        Loop(
            _reduce(space), rows // lanes, (), ("table",), sliced=("rows",), fixed=("origin", "Z"), lanes=lanes
        ),
        Call(search(small, rows, cap), ("table", "start", "skip"), ("y", "numbers", "multipliers", "status", "count")),
        Call(lift, ("origin", "Z", "y"), ("point",)),
    )  # fmt: skip
    inputs = (("rows", rows * (n + 3)), ("origin", n), ("start", d), ("skip", 1), ("Z", n * d))
    return Routine(f"reduced_{d}", inputs, steps, ("point", "numbers", "multipliers", "status", "count"))


def _reduce(space: Space) -> Program:
    # the constraint row on y, for v = origin + Z y
    n, d = space.n, space.d
    row, origin, Z = ca.SX.sym("row", n + 3), ca.SX.sym("origin", n), ca.SX.sym("Z", n * d)
    value = ca.dot(row[:n], origin)
    reduced = ca.vertcat(as_matrix(Z, d).T @ row[:n], row[n] - value, row[n + 1] - value)
    return lower(ca.Function("reduce", [row, origin, Z], [reduced]))


@cache
def search(space: Space, rows: int, cap: int | None = None) -> Routine:
    """Return the active-set search alone: the feasible point nearest to `base`, for rows without the entry `soft`.

    Inputs: rows (rows·`space.row`,) in blocks, each of length 1 or 0; base (`space.point`,); skip; M (n·d,) if
    `space.mapped`. Outputs: point, numbers and multipliers (d,) of the active rows, status and count as in `kernel`.
    """
    free = (("M", space.n * space.d),) if space.mapped and not space.opening else ()
    space = space if free else Space(space.n, space.d, space.opening, mapped=False, precision=space.precision)
    width = space.row
    names = tuple(name for name, _ in free)
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
            fixed=("rows", *names),
            until=len(state) - 1,
        ),
    )
    inputs = (("rows", rows * width), ("base", space.point), ("skip", 1), *free)
    results = ("point_last", "numbers_last", "multipliers_last", "status_last", "count_last")
    return Routine(f"search_{space.d}", inputs, steps, results)


def _state(space: Space) -> tuple[tuple[str, int], ...]:
    d = space.d
    return (
        ("point", space.point),
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
    base, skip = ca.SX.sym("base", space.point), ca.SX.sym("skip")
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
    free = (("M", space.n * space.d),) if space.mapped else ()
    names = tuple(name for name, _ in state[:-2])
    steps = (
        Call(which(), ("best", "pending"), ("at", "number")),
        Gather("rows", "at", space.row, "row", lanes=lanes),
        Call(
            iteration(space), (*names, "number", "row", *(name for name, _ in free)),
            tuple(f"{name}_next" for name in names),
        ),
        *_price(space, rows, "_next"),
        Call(close(), ("best_next", "pending_next", "began_next"), ("status_next",)),
    )  # fmt: skip
    inputs = (*state, ("rows", rows * space.row), *free)
    return Routine(f"turn_{space.d}", inputs, steps, tuple(f"{name}_next" for name, _ in state))


@cache
def certificate(space: Space, rows: int) -> Routine:
    """Return a routine that tests whether a point (n + 1,), v and opening, satisfies every constraint row.

    The output is 1 if no row is violated by more than `precision.feasibility`·max(1, |v|), otherwise (also for a NaN)
    0.
    """
    n, lanes = space.n, lanes_of(rows, space.precision)
    full = Space(n, space.d, space.opening, precision=space.precision)
    feasible, row, point = ca.SX.sym("feasible"), ca.SX.sym("row", n + 3), ca.SX.sym("point", n + 1)
    size = ca.SX.sym("size")
    above, below = misses(full, row, point)
    good = ca.if_else(below <= size, ca.if_else(above <= size, feasible, 0), 0)
    one = lower(ca.Function("keeps", [feasible, row, point, size], [good]))
    largest = ca.SX(1)
    for i in range(n):
        largest = ca.fmax(largest, ca.fabs(point[i]))
    begin = lower(ca.Function("tolerance", [point], [space.precision.feasibility * largest]))
    yes_all = lower(ca.Function("ones", [], [ca.SX.ones(1)]))
    every, yes = ca.SX.sym("every", lanes), ca.SX(1)
    for k in range(lanes):
        yes = ca.logic_and(yes, every[k])
    end = lower(ca.Function("all_feasible", [every], [yes]))
    steps = (
        Call(begin, ("point",), ("size",)),
        Loop(yes_all, 1, (), ("yes",), lanes=lanes),
        Loop(one, rows // lanes, ("yes",), ("every",), sliced=("rows",), fixed=("point", "size"), lanes=lanes),
        Call(end, ("every",), ("feasible",)),
    )
    return Routine(
        "certify_open" if space.opening else "certify",
        (("rows", rows * (n + 3)), ("point", n + 1)),
        steps,
        ("feasible",),
    )


class Sizes:
    """Numbers for which a safe step is compiled: n velocities, p rows of the task Jacobian J, m constraint rows.

    Attributes:
        precision: tolerances of the solver.
        cap: largest number of iterations in a search for v; None means the limit in module `kernel`.
        general: search with n unknowns. fast: search with n − p unknowns, after elimination of p independent rows of J
            (None if p ≥ n). opening: search in which v and the opening of the soft rows are unknown.
        rows: number of entries that store all constraint rows. lanes: number of rows in a block (see module `kernel`).
            blocks: number of blocks.
        general_kernel, opening_kernel: solver routines for the searches `general` and `opening`. certificate,
            opening_certificate: routines that test whether a point satisfies all constraint rows.
    """

    def __init__(self, n: int, p: int, m: int, precision: Precision = FLOAT64, *, cap: int | None = None) -> None:
        self.n, self.p, self.m, self.precision, self.cap = n, p, m, precision, cap
        self.general = Space(n, n, precision=precision)
        self.fast = Space(n, n - p, precision=precision) if p < n else None
        self.opening = Space(n, n + 1, opening=True, precision=precision)
        self.rows = m * (n + 3)
        self.lanes = lanes_of(m, precision)
        self.blocks = m // self.lanes
        self.general_kernel = kernel(self.general, m, cap)
        self.opening_kernel = kernel(self.opening, m)
        self.certificate = certificate(self.general, m)
        self.opening_certificate = certificate(self.opening, m)


def unit_rows(sizes: Sizes) -> tuple[Step, ...]:
    """Return the steps that scale each constraint row to length 1 and store the rows in blocks.

    The steps convert the variable `rows` (m·(n + 3),), stored row by row, to the variable `unit`. A row with normal 0
    is not scaled; all velocities satisfy this row, or none does. No velocity satisfies a row whose squared length
    exceeds `precision.huge`.
    """
    if sizes.lanes == 1:
        look: tuple[Step, ...] = (
            Call(_one(), (), ("unit_so_far",)),
            Loop(_look(sizes), sizes.m, ("unit_so_far",), ("all_unit",), sliced=("rows",)),
        )
        begun = "rows"
    else:
        look = (
            Loop(_one(), 1, (), ("unit_so_far",), lanes=sizes.lanes),
            Loop(
                _load(sizes), sizes.blocks, ("unit_so_far",), ("each", "loaded"), spread=("rows",), lanes=sizes.lanes
            ),
            Call(_every(sizes.lanes), ("each",), ("all_unit",)),
        )  # fmt: skip
        begun = "loaded"
    return (*look, Loop(_scaling(sizes), 1, (begun, "all_unit"), ("unit", "scaled"), until=1))


def _one() -> Program:
    return lower(ca.Function("one", [], [ca.SX.ones(1)]))


def _load(sizes: Sizes) -> Program:
    # yes: 1 if all rows of this lane so far have length 1 or 0
    yes, row = ca.SX.sym("yes"), ca.SX.sym("row", sizes.n + 3)
    return lower(ca.Function("load", [yes, row], [ca.if_else(_is_unit(sizes, row), yes, 0), row]))


def _look(sizes: Sizes) -> Program:
    # yes: 1 if all constraint rows so far have length 1 or 0
    yes, row = ca.SX.sym("yes"), ca.SX.sym("row", sizes.n + 3)
    return lower(ca.Function("look", [yes, row], [ca.if_else(_is_unit(sizes, row), yes, 0)]))


def _is_unit(sizes: Sizes, row: ca.SX) -> ca.SX:
    square = ca.sumsqr(row[: sizes.n])
    return ca.logic_or(ca.fabs(square - 1) <= sizes.precision.unit, ca.eq(square, 0))


def _every(lanes: int) -> Program:
    each, yes = ca.SX.sym("each", lanes), ca.SX(1)
    for k in range(lanes):
        yes = ca.logic_and(yes, each[k])
    return lower(ca.Function("every", [each], [yes]))


def _scaling(sizes: Sizes) -> Routine:
    """Return the body of a loop that scales the rows once, if some row has a length other than 0 or 1."""
    n = sizes.n
    row = ca.SX.sym("row", n + 3)
    square = ca.sumsqr(row[:n])
    length = ca.sqrt(square)
    inverse = 1 / ca.if_else(length <= sizes.precision.short, 1, length)
    scaled = ca.vertcat(row[: n + 2] * inverse, row[n + 2])
    # its square overflows, so scaling would give a row of zeros that always holds; this row never holds instead
    never = ca.vertcat(ca.SX.zeros(n), 1, 1, 0)
    far = square > sizes.precision.huge
    scale = lower(ca.Function("unit_row", [row], [ca.if_else(far, never, scaled)]))
    one = lower(ca.Function("scaled", [], [ca.SX.ones(1)]))
    steps = (
        Loop(scale, sizes.blocks, (), ("unit",), sliced=("rows",), lanes=sizes.lanes),
        Call(one, (), ("yes",)),
    )
    return Routine("scale", (("rows", sizes.rows), ("done", 1)), steps, ("unit", "yes"))


def into(value: ca.SX, low: ca.SX, high: ca.SX) -> ca.SX:
    """Return the value clipped to the bounds; a NaN becomes the lower bound."""
    above = ca.if_else(low <= value, value, low)
    return ca.if_else(above <= high, above, high)
