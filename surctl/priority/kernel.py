"""The least-distance solver as a routine: the iteration of `dual_step` in a bounded loop."""

from __future__ import annotations

import casadi as ca

from surctl.ir import Call, Gather, Loop, Program, Routine, lower
from surctl.priority.dual_step import SKIPPED, Space, iteration, misses, pricing, threshold, which

__all__ = ["CAP", "OPEN_CAP", "certificate", "kernel"]

CAP = 40
"""Largest number of iterations."""

OPEN_CAP = 80
"""The same where the opening is free: γ makes every soft row a candidate."""

_KEPT = 1e-9


def kernel(space: Space, rows: int) -> Routine:
    """(rows, base, skip[, Z]) → (point, numbers, multipliers, status, count).

    The point nearest to the base, in y, that keeps all rows.

    rows: (rows·(n + 3),), each a (of length 1, or 0), lower, upper, soft. base: (n + 1,), v and t. skip: not 0
    gives the base with status `SKIPPED`. Z: (n·d,), row by row, orthonormal columns (or an orthogonal projector);
    absent if the opening is free. status: 0 when `CAP` (`OPEN_CAP`) was reached; the point is then of no use.
    """
    n, d = space.n, space.d
    free = () if space.opening else (("Z", n * d),)
    names = tuple(name for name, _ in free)
    state = tuple(name for name, _ in _state(space))
    last = tuple(f"{name}_last" for name in state)
    cap = OPEN_CAP if space.opening else CAP
    steps = (
        Call(_start(space), ("base", "skip"), state),
        Loop(_turn(space, rows), cap, carried=state, results=last, fixed=("rows", *names), until=5),
    )
    inputs = (("rows", rows * space.row), ("base", n + 1), ("skip", 1), *free)
    results = ("point_last", "numbers_last", "multipliers_last", "status_last", "count_last")
    return Routine(f"nearest_{d}", inputs, steps, results)


def _state(space: Space) -> tuple[tuple[str, int], ...]:
    d = space.d
    return (
        ("point", space.n + 1),
        ("normals", d * d),
        ("multipliers", d),
        ("numbers", d),
        ("pending", 2),
        ("status", 1),
        ("count", 1),
    )


def _start(space: Space) -> Program:
    """(base, skip) → the state before the first iteration."""
    base, skip = ca.SX.sym("base", space.n + 1), ca.SX.sym("skip")
    d = space.d
    zeros = [ca.SX.zeros(size, 1) for size in (d * d, d, d, 2)]
    status = ca.if_else(skip, SKIPPED, 0)
    return lower(ca.Function(f"start_{d}", [base, skip], [base, *map(ca.densify, zeros), status, ca.SX.zeros(1)]))


def _turn(space: Space, rows: int) -> Routine:
    """Price all rows, fetch the one to work on, make one step."""
    state = _state(space)
    free = () if space.opening else (("Z", space.n * space.d),)
    given = tuple(name for name, _ in state)
    after = tuple(f"{name}_next" for name in given)
    steps = (
        Call(threshold(space), ("point",), ("least",)),
        Loop(pricing(space), rows, ("least",), ("best",), sliced=("rows",), fixed=("point",), index=True),
        Call(which(), ("best", "pending"), ("at",)),
        Gather("rows", "at", space.row, "row"),
        Call(iteration(space), (*given, "at", "row", *(name for name, _ in free)), after),
    )
    return Routine(f"turn_{space.d}", (*state, ("rows", rows * space.row), *free), steps, after)


def certificate(space: Space, rows: int) -> Routine:
    """(rows, point) → 1 if the point keeps every row within 1e-9 (relative to max |v| above 1), else 0.

    Written as what holds, not as what is violated: a NaN keeps nothing.
    """
    n = space.n
    kept, row, point = ca.SX.sym("kept"), ca.SX.sym("row", space.row), ca.SX.sym("point", n + 1)
    size = ca.SX.sym("size")
    above, below = misses(space, row, point)
    good = ca.if_else(below <= size, ca.if_else(above <= size, kept, 0), 0)
    one = lower(ca.Function("keeps", [kept, row, point, size], [good]))
    largest = ca.SX(1)
    for i in range(n):
        largest = ca.fmax(largest, ca.fabs(point[i]))
    begin = lower(ca.Function("tolerance", [point], [ca.SX(1), _KEPT * largest]))
    steps = (
        Call(begin, ("point",), ("yes", "size")),
        Loop(one, rows, ("yes",), ("kept",), sliced=("rows",), fixed=("point", "size")),
    )
    return Routine(
        "certify_open" if space.opening else "certify", (("rows", rows * space.row), ("point", n + 1)), steps, ("kept",)
    )
