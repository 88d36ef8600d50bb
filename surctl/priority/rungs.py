"""The rungs of the safe tick, each a routine over the kernel: the task exact, or served, or rows opened for it.

1. `exact_rung`: the point nearest to the target that meets the task J v = x and every row.
2. The point that meets the task as well as the rows allow (`served`), and is nearest to the target among those: rung 1
   again, with J v at its value.
3. The least t by which the soft rows must open (`opened`), then 2.

`lower_rungs` is one turn of 2 and 3; `ladder` runs the turns.
"""

from __future__ import annotations

import casadi as ca

from surctl.ir import Call, Loop, Program, Routine, lower
from surctl.priority.dual_step import OPTIMAL
from surctl.priority.elimination import as_matrix
from surctl.priority.kernel import kernel
from surctl.priority.opened import opened
from surctl.priority.rows import Sizes
from surctl.priority.served import served

__all__ = ["LIMITED", "RELAXED", "exact_rung", "lower_rungs"]

LIMITED, RELAXED = 2, 3
"""Status of rungs 2 and 3: task met as well as the rows allow; soft rows opened."""


def exact_rung(sizes: Sizes) -> Routine:
    """(rows, base, skip, Z fast, Z all, full) → (point, active, multipliers, status, count), the task exact.

    With independent task rows in n − p unknowns, otherwise in n.
    """
    n, fast = sizes.n, sizes.fast
    given = (
        ("rows", sizes.rows),
        ("base", n + 1),
        ("skip", 1),
        ("fast", n * fast.d if fast is not None else 1),
        ("all", n * n),
        ("full", 1),
    )
    outputs = ("point", "active", "multipliers", "status", "count")
    slow = tuple(f"{name}_all" for name in outputs)
    if fast is None:
        steps: tuple[Call, ...] = (Call(sizes.general_kernel, ("rows", "base", "skip", "all"), outputs),)
        return Routine("hard", given, steps, outputs)
    quick = tuple(f"{name}_fast" for name in outputs)
    full, skip = ca.SX.sym("full"), ca.SX.sym("skip")
    switch = lower(
        ca.Function("switch", [full, skip], [ca.logic_or(skip, ca.logic_not(full)), ca.logic_or(skip, full)])
    )
    steps = (
        Call(switch, ("full", "skip"), ("skip_fast", "skip_all")),
        Call(kernel(fast, sizes.m), ("rows", "base", "skip_fast", "fast"), quick),
        Call(sizes.general_kernel, ("rows", "base", "skip_all", "all"), slow),
        Call(_either(n, fast.d), ("full", *quick, *slow), outputs),
    )
    return Routine("hard", given, steps, outputs)


def _either(n: int, d: int) -> Program:
    """The answer of the kernel that ran; slots that the fast one does not have are empty."""
    full = ca.SX.sym("full")
    quick = [ca.SX.sym(f"quick{k}", size) for k, size in enumerate((n + 1, d, d, 1, 1))]
    slow = [ca.SX.sym(f"slow{k}", size) for k, size in enumerate((n + 1, n, n, 1, 1))]
    padded = [ca.vertcat(a, ca.SX.zeros(b.numel() - a.numel(), 1)) for a, b in zip(quick, slow, strict=True)]
    chosen = [ca.densify(ca.if_else(full, a, b)) for a, b in zip(padded, slow, strict=True)]
    return lower(ca.Function("either", [full, *quick, *slow], chosen))


def lower_rungs(sizes: Sizes) -> Routine:
    """Rungs 2 and 3: serve the task inside the rows; if no point keeps them, open the soft ones for the next turn."""
    n, p = sizes.n, sizes.p
    state = (("point", n + 1), ("active", n), ("multipliers", n), ("status", 1), ("count", 1), ("safe", 1))
    fast = n * sizes.fast.d if sizes.fast is not None else 1
    fixed = (
        ("unit", sizes.rows), ("target", n), ("near", n), ("J", p * n), ("x", p), ("lift", n * p), ("fast", fast),
        ("all", n * n), ("full", 1),
    )  # fmt: skip
    ends = ("point", "active", "multipliers", "end", "count")
    first, again = (tuple(f"{name}_{tag}" for name in ends) for tag in ("served", "again"))
    steps = (
        Loop(_open_row(sizes), sizes.m, (), ("open",), sliced=("unit",), fixed=("point",)),
        Call(_opening(n), ("point",), ("opening",)),
        Call(served(sizes), ("open", "near", "opening", "J", "x"), first),
        Call(_value(sizes), ("point_served", "end_served", "target", "J", "lift"), ("held", "no", "yes")),
        Call(exact_rung(sizes), ("open", "held", "no", "fast", "all", "full"), again),
        Call(sizes.certificate, ("open", "point_again"), ("kept_again",)),
        Call(opened(sizes), ("unit", "near", "point", "yes"), ("wide", "found", "kept_wide", "count_opened")),
        Call(
            _outcome(sizes),
            (
                "point",
                "count",
                "safe",
                "yes",
                "kept_again",
                "wide",
                "found",
                "kept_wide",
                "count_opened",
                *first,
                *again,
            ),
            tuple(f"{name}_next" for name, _ in state),
        ),
    )
    return Routine("down", (*state, *fixed), steps, tuple(f"{name}_next" for name, _ in state))


def _opening(n: int) -> Program:
    """The opening of a point."""
    point = ca.SX.sym("point", n + 1)
    return lower(ca.Function("opening", [point], [point[n]]))


def _open_row(sizes: Sizes) -> Program:
    """A row with its bounds moved outwards by the opening of the point, if it is soft."""
    n = sizes.n
    row, point = ca.SX.sym("row", n + 3), ca.SX.sym("point", n + 1)
    room = row[n + 2] * point[n]
    moved = ca.vertcat(row[:n], row[n] - room, row[n + 1] + room, row[n + 2])
    return lower(ca.Function("open_row", [row, point], [moved]))


def _value(sizes: Sizes) -> Program:
    """(served point, end, target, J, lift) → base that holds J v at its value, and whether it failed, served."""
    n, p = sizes.n, sizes.p
    point, end = ca.SX.sym("point", n + 1), ca.SX.sym("end")
    target, J, lift = ca.SX.sym("target", n), ca.SX.sym("J", p * n), ca.SX.sym("lift", n * p)
    matrix, inverse = as_matrix(J, n), as_matrix(lift, p)
    base = target + inverse @ (matrix @ (point[:n] - target))
    base = base + inverse @ (matrix @ (point[:n] - base))  # a far target costs digits: once more
    good = ca.eq(end, OPTIMAL)
    outputs = [ca.vertcat(base, point[n]), ca.logic_not(good), good]
    return lower(ca.Function("value", [point, end, target, J, lift], outputs))


def _outcome(sizes: Sizes) -> Program:
    """The better of served and solved again; or, if neither, the opened rows' point and their opening."""
    n = sizes.n
    point, count, safe = ca.SX.sym("point", n + 1), ca.SX.sym("count"), ca.SX.sym("safe")
    yes, kept, wide = ca.SX.sym("yes"), ca.SX.sym("kept"), ca.SX.sym("wide", n + 1)
    found, kept_wide, spent = ca.SX.sym("found"), ca.SX.sym("kept_wide"), ca.SX.sym("spent")

    def answer(tag: str) -> list[ca.SX]:
        names = ("point", "active", "multipliers", "end", "count")
        return [ca.SX.sym(f"{k}_{tag}", s) for k, s in zip(names, (n + 1, n, n, 1, 1), strict=True)]

    served, again = answer("served"), answer("again")
    better = ca.logic_and(yes, ca.logic_and(ca.eq(again[3], OPTIMAL), kept))
    chosen = [ca.if_else(better, again[k], served[k]) for k in range(3)]
    empty = ca.SX.zeros(n, 1)
    outputs = [
        ca.if_else(yes, chosen[0], wide),
        ca.if_else(yes, chosen[1], empty),
        ca.if_else(yes, chosen[2], empty),
        ca.if_else(yes, ca.if_else(point[n] > 0, RELAXED, LIMITED), 0),
        count + served[4] + again[4] + spent,
        ca.logic_or(safe, ca.logic_and(found, kept_wide)),
    ]
    inputs = [point, count, safe, yes, kept, wide, found, kept_wide, spent, *served, *again]
    return lower(ca.Function("outcome", inputs, list(map(ca.densify, outputs))))
