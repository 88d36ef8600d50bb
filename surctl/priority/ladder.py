"""The safe tick as one routine: a finite answer for any input, by a ladder of least-distance problems.

1. The point nearest to the target that meets the task J v = x and every row.
2. If there is none: the point that meets the task as well as the rows allow, nearest to the target among those.
3. If the rows contradict each other: the least opening of the soft rows, then 2.
4. If the hard rows contradict each other: the target in the box.

Whatever came out is moved into the box, and checked. How 1 to 3 are found is told in `rungs`.
"""

from __future__ import annotations

import casadi as ca

from surctl.ir import Call, Loop, Program, Routine, lower
from surctl.priority.dual_step import OPTIMAL
from surctl.priority.elimination import as_matrix, eliminate, flat
from surctl.priority.rows import SHORT, Sizes
from surctl.priority.rungs import LIMITED, RELAXED, exact_rung, lower_rungs

__all__ = ["CLAMPED", "LIMITED", "MET", "RELAXED", "safe_tick"]

MET, CLAMPED = 1, 4
"""Status, beside `LIMITED` and `RELAXED` of the rungs between: task met; only kept in the box."""

_MET = 1e-9
_HUGE = 1e300


def safe_tick(n: int, p: int, m: int) -> Routine:
    """(target (n,), J (p·n,), x (p,), rows (m·(n + 3),), box (2n,)) → the answer, always finite.

    rows: a (n,), lower, upper, soft (1: may open, 0: may not), of any length. box: lower (n,), upper (n,).
    Outputs: v (n,); active (n,), signed row numbers from 1 (+ at the upper bound, − at the lower, 0 none) and
    their multipliers (n,) of ½‖v − target‖², for rows of length 1; opening (1,) of the soft rows [row of length
    1]; status (1,), see `MET` …; count (1,), iterations in all.

    Args:
        n: velocities, at least 1.
        p: rows of the task, at least 1 (a row of zeros with x = 0 is no task).
        m: rows, at least 1 (a row of zeros between infinite bounds is none).
    """
    sizes = Sizes(n, p, m)
    carried = ("point", "active", "multipliers", "status", "count", "none")
    after = tuple(f"{name}_down" for name in carried)
    steps = (
        Loop(_unit_row(sizes), m, (), ("unit",), sliced=("rows",)),
        Call(
            _prepare(sizes),
            ("J", "x", "target", "box"),
            ("lift", "fast", "all", "full", "base", "idle", "near", "none", "sound"),
        ),
        Call(
            exact_rung(sizes),
            ("unit", "base", "idle", "fast", "all", "full"),
            ("nearest", "active", "multipliers", "end", "count"),
        ),
        Call(sizes.certificate, ("unit", "nearest"), ("kept",)),
        Call(_judge(sizes), ("nearest", "end", "kept", "J", "x", "base"), ("point", "status")),
        Loop(
            lower_rungs(sizes),
            2,
            carried=carried,
            results=after,
            fixed=("unit", "target", "near", "J", "x", "lift", "fast", "all", "full"),
            until=3,
        ),
        Call(_finish(sizes), ("point_down", "status_down", "none_down", "sound", "box"), ("v", "opening", "outcome")),
    )
    inputs = (("target", n), ("J", p * n), ("x", p), ("rows", sizes.rows), ("box", 2 * n))
    return Routine(
        "safe_tick",
        inputs,
        steps,
        ("v", "active_down", "multipliers_down", "opening", "outcome", "count_down"),
    )


def _unit_row(sizes: Sizes) -> Program:
    """A row scaled to length 1; a row of zeros keeps its bounds: it is met always or never."""
    n = sizes.n
    row = ca.SX.sym("row", n + 3)
    length = ca.sqrt(ca.sumsqr(row[:n]))
    inverse = 1 / ca.if_else(length <= SHORT, 1, length)
    return lower(ca.Function("unit_row", [row], [ca.vertcat(row[: n + 2] * inverse, row[n + 2])]))


def _prepare(sizes: Sizes) -> Program:
    """(J, x, target, box) → lift, Z of the fast and of the general kernel, whether all rows count, base, 0, near, 0,
    sound.

    `near` is the target moved into the box: where rungs 2 and 3 start, since only the task's value and the opening
    are taken from them, and small numbers are exact ones. `sound`: task and target are finite.
    """
    n, p = sizes.n, sizes.p
    J, x, target = ca.SX.sym("J", p * n), ca.SX.sym("x", p), ca.SX.sym("target", n)
    box = ca.SX.sym("box", 2 * n)
    matrix = as_matrix(J, n)
    left = eliminate(matrix)
    taken = [left.rank > i for i in range(n)]
    free = ca.horzcat(*(ca.if_else(taken[i], 0, left.basis[:, i]) if i < p else left.basis[:, i] for i in range(n)))
    full = ca.eq(left.rank, p) if sizes.fast is not None else ca.SX(0)
    fast = left.basis[:, p:] if sizes.fast is not None else ca.SX.zeros(1, 1)
    base = target + left.lift @ (x - matrix @ target)
    base = base + left.lift @ (x - matrix @ base)  # a far target costs digits: once more
    sound = ca.SX(1)
    for entry in ca.vertsplit(ca.vertcat(target, J, x)):
        sound = ca.if_else(ca.fabs(entry) <= _HUGE, sound, 0)
    near = ca.vertcat(*(_into(target[i], box[i], box[n + i]) for i in range(n)))
    outputs = [
        flat(left.lift),
        flat(fast),
        flat(free),
        full,
        ca.vertcat(base, 0),
        ca.SX.zeros(1),
        near,
        ca.SX.zeros(1),
        sound,
    ]
    return lower(ca.Function("prepare", [J, x, target, box], list(map(ca.densify, outputs))))


def _judge(sizes: Sizes) -> Program:
    """(point, kernel status, kept, J, x, base) → point (the base if it does not count), MET or 0."""
    n, p = sizes.n, sizes.p
    point, end, kept = ca.SX.sym("point", n + 1), ca.SX.sym("end"), ca.SX.sym("kept")
    J, x, base = ca.SX.sym("J", p * n), ca.SX.sym("x", p), ca.SX.sym("base", n + 1)
    good = ca.logic_and(ca.logic_and(ca.eq(end, OPTIMAL), kept), _meets(as_matrix(J, n), x, point[:n]))
    chosen = ca.densify(ca.if_else(good, point, base))
    return lower(ca.Function("judge", [point, end, kept, J, x, base], [chosen, ca.if_else(good, MET, 0)]))


def _meets(J: ca.SX, x: ca.SX, v: ca.SX) -> ca.SX:
    """Whether every task row is met, relative to its length; said as what holds."""
    size = ca.SX(1)
    for i in range(v.numel()):
        size = ca.fmax(size, ca.fabs(v[i]))
    good = ca.SX(1)
    for k in range(J.shape[0]):
        length = ca.sqrt(ca.sumsqr(J[k, :]))
        scale = ca.if_else(length <= SHORT, 1, length)
        good = ca.logic_and(good, ca.fabs(ca.dot(J[k, :].T, v) - x[k]) <= _MET * size * scale)
    return good


def _finish(sizes: Sizes) -> Program:
    """(point, status, safe, sound, box) → v inside the box, finite whatever came before; opening; outcome.

    Whatever a task that is not finite led to is not called an answer. A point of rung 3 that keeps the opened rows
    will do when nothing better was found from there.
    """
    n = sizes.n
    point, status, box = ca.SX.sym("point", n + 1), ca.SX.sym("status"), ca.SX.sym("box", 2 * n)
    safe, sound, v = ca.SX.sym("safe"), ca.SX.sym("sound"), []
    reached = ca.if_else(ca.logic_and(ca.eq(status, 0), safe), RELAXED, status)
    good = ca.logic_and(reached != 0, sound)
    size = ca.SX(1)
    for i in range(n):
        size = ca.fmax(size, ca.fabs(point[i]))
    for i in range(n):
        inside = _into(point[i], box[i], box[n + i])
        finite = ca.if_else(ca.fabs(inside) <= _HUGE, inside, 0)
        good = ca.logic_and(good, ca.fabs(finite - point[i]) <= _MET * size)
        v.append(finite)
    opening = ca.if_else(good, point[n], 0)
    return lower(
        ca.Function(
            "finish", [point, status, safe, sound, box], [ca.vertcat(*v), opening, ca.if_else(good, reached, CLAMPED)]
        )
    )


def _into(value: ca.SX, low: ca.SX, high: ca.SX) -> ca.SX:
    """The value moved between the bounds; a NaN goes to the lower one."""
    above = ca.if_else(low <= value, value, low)
    return ca.if_else(above <= high, above, high)
