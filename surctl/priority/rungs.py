"""The rungs of the safe tick, each a routine over the kernel: the task exact, or served, or rows opened for it.

1. `exact_rung`: the point nearest to the target that meets the task J v = x and every row.
2. The point that meets the task as well as the rows allow, and is nearest to the target among those.
   min ‖v − target‖² + ‖J v − x‖²/δ² over the rows is itself a least-distance problem, in v and the scaled misses
   (J v − x)/δ, and always has independent equalities; done twice (a proximal point step takes the error from δ² to
   δ⁴), then solved again with J v at its value.
3. The least t by which the soft rows must open, from the point (target, −γ) (a least-distance problem solves a
   linear programme exactly once γ is large: Mangasarian and Meyer 1979; a second step from there reaches farther).

`lower_rungs` is one turn of 2 and 3; `ladder` runs the turns.
"""

from __future__ import annotations

import casadi as ca

from surctl.ir import Call, Loop, Program, Routine, lower
from surctl.priority.dual_step import OPTIMAL, Space
from surctl.priority.elimination import as_matrix, eliminate, flat
from surctl.priority.kernel import certificate, kernel

__all__ = ["LIMITED", "RELAXED", "SHORT", "Sizes", "exact_rung", "lower_rungs"]

LIMITED, RELAXED = 2, 3
"""Status of rungs 2 and 3: task met as well as the rows allow; soft rows opened."""

SHORT = 1e-15
"""Length up to which a row counts as a row of zeros."""

_DELTA = 1e-3
_PULL = 1e3  # γ, relative to 1 + max |target|
_MARGIN = 1e-11  # room that the opening gets beyond the least one, for rounding


class Sizes:
    """n velocities, p task rows, m rows; the routines below share them."""

    def __init__(self, n: int, p: int, m: int) -> None:
        self.n, self.p, self.m = n, p, m
        self.general = Space(n, n)
        self.fast = Space(n, n - p) if p < n else None
        self.rows = m * self.general.row
        self.general_kernel = kernel(self.general, m)
        self.certificate = certificate(self.general, m)


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
    opening = Space(n, n + 1, opening=True)
    ends = ("point", "active", "multipliers", "end", "count")
    served, again = (tuple(f"{name}_{tag}" for name in ends) for tag in ("served", "again"))
    steps = (
        Loop(_open_row(sizes), sizes.m, (), ("open",), sliced=("unit",), fixed=("point",)),
        Call(_scaled(sizes), ("J", "x"), ("weights", "rest", "pull")),
        Call(_begin(sizes), ("near", "point"), ("centre", *(f"{name}_zero" for name in ends[1:]))),
        Loop(
            _serve(sizes),
            2,
            carried=("centre", *(f"{name}_zero" for name in ends[1:])),
            results=served,
            fixed=("open", "weights", "rest", "pull"),
        ),
        Call(sizes.certificate, ("open", "point_served"), ("kept_served",)),
        Call(
            _value(sizes), ("point_served", "end_served", "kept_served", "target", "J", "lift"), ("held", "no", "yes")
        ),
        Call(exact_rung(sizes), ("open", "held", "no", "fast", "all", "full"), again),
        Call(sizes.certificate, ("open", "point_again"), ("kept_again",)),
        Call(_start_open(sizes), ("near",), ("low", "end_low", "count_low")),
        Loop(
            _open(sizes, opening),
            2,
            carried=("low", "end_low", "count_low"),
            results=("point_opened", "end_opened", "count_opened"),
            fixed=("unit", "yes"),
        ),
        Call(_widened(sizes), ("point_opened", "end_opened", "point"), ("wide", "found")),
        Call(certificate(opening, sizes.m), ("unit", "wide"), ("kept_wide",)),
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
                *served,
                *again,
            ),
            tuple(f"{name}_next" for name, _ in state),
        ),
    )
    return Routine("down", (*state, *fixed), steps, tuple(f"{name}_next" for name, _ in state))


def _open_row(sizes: Sizes) -> Program:
    """A row with its bounds moved outwards by the opening of the point, if it is soft."""
    n = sizes.n
    row, point = ca.SX.sym("row", n + 3), ca.SX.sym("point", n + 1)
    room = row[n + 2] * point[n]
    moved = ca.vertcat(row[:n], row[n] - room, row[n + 1] + room, row[n + 2])
    return lower(ca.Function("open_row", [row, point], [moved]))


def _scaled(sizes: Sizes) -> Program:
    """(J, x) → lift and Z of the problem in (v, (J v − x)/δ), their v parts, and x; J divided by its largest row."""
    n, p = sizes.n, sizes.p
    J, x = ca.SX.sym("J", p * n), ca.SX.sym("x", p)
    matrix = as_matrix(J, n)
    longest = ca.SX(0)
    for k in range(p):
        longest = ca.fmax(longest, ca.sqrt(ca.sumsqr(matrix[k, :])))
    scale = ca.if_else(longest <= SHORT, 0, 1 / ca.if_else(longest <= SHORT, 1, longest))
    matrix = matrix * scale
    left = eliminate(ca.horzcat(matrix, -_DELTA * ca.SX.eye(p)))
    lift = left.lift[:n, :]
    weights = ca.vertcat(flat(lift), flat(matrix))
    return lower(ca.Function("scaled", [J, x], [weights, flat(left.basis[:n, p:]), x * scale]))


def _begin(sizes: Sizes) -> Program:
    """(target, point) → the target with the opening so far, and empty results."""
    n = sizes.n
    target, point = ca.SX.sym("target", n), ca.SX.sym("point", n + 1)
    zeros = [ca.SX.zeros(n, 1), ca.SX.zeros(n, 1), ca.SX.zeros(1), ca.SX.zeros(1)]
    return lower(ca.Function("begin", [target, point], [ca.vertcat(target, point[n]), *zeros]))


def _serve(sizes: Sizes) -> Routine:
    """One proximal step: from a centre to the point that weighs the task against the distance to it."""
    n, p = sizes.n, sizes.p
    centre, weights, pull = ca.SX.sym("centre", n + 1), ca.SX.sym("weights", 2 * n * p), ca.SX.sym("pull", p)
    lift, matrix = as_matrix(weights[: n * p], p), as_matrix(weights[n * p :], n)
    moved = centre[:n] + lift @ (pull - matrix @ centre[:n])
    base = lower(ca.Function("weigh", [centre, weights, pull], [ca.vertcat(moved, centre[n]), ca.SX.zeros(1)]))
    old, new = ca.SX.sym("old"), ca.SX.sym("new")
    add = lower(ca.Function("total", [old, new], [old + new]))
    given = (("centre", n + 1), ("active", n), ("multipliers", n), ("end", 1), ("count", 1))
    fixed = (("open", sizes.rows), ("weights", 2 * n * p), ("rest", n * n), ("pull", p))
    steps = (
        Call(base, ("centre", "weights", "pull"), ("base", "go")),
        Call(
            sizes.general_kernel,
            ("open", "base", "go", "rest"),
            ("point_next", "active_next", "multipliers_next", "end_next", "spent"),
        ),
        Call(add, ("count", "spent"), ("count_next",)),
    )
    return Routine(
        "serve",
        (*given, *fixed),
        steps,
        ("point_next", "active_next", "multipliers_next", "end_next", "count_next"),
    )


def _value(sizes: Sizes) -> Program:
    """(served point, end, kept, target, J, lift) → base that holds J v at its value, and whether it failed, served."""
    n, p = sizes.n, sizes.p
    point, end, kept = ca.SX.sym("point", n + 1), ca.SX.sym("end"), ca.SX.sym("kept")
    target, J, lift = ca.SX.sym("target", n), ca.SX.sym("J", p * n), ca.SX.sym("lift", n * p)
    base = target + as_matrix(lift, p) @ (as_matrix(J, n) @ (point[:n] - target))
    good = ca.logic_and(ca.eq(end, OPTIMAL), kept)
    outputs = [ca.vertcat(base, point[n]), ca.logic_not(good), good]
    return lower(ca.Function("value", [point, end, kept, target, J, lift], outputs))


def _start_open(sizes: Sizes) -> Program:
    """near → (near, 0), and empty results."""
    near = ca.SX.sym("near", sizes.n)
    outputs = [ca.densify(ca.vertcat(near, 0)), ca.SX.zeros(1), ca.SX.zeros(1)]
    return lower(ca.Function("start_open", [near], outputs))


def _open(sizes: Sizes, space: Space) -> Routine:
    """One proximal step of the linear programme min t: nearest to (v, t − γ); a step that fails changes nothing."""
    n = sizes.n
    point, end, count = ca.SX.sym("point", n + 1), ca.SX.sym("end"), ca.SX.sym("count")
    found, why, spent = ca.SX.sym("found", n + 1), ca.SX.sym("why"), ca.SX.sym("spent")
    size = ca.SX(0)
    for i in range(n + 1):
        size = ca.fmax(size, ca.fabs(point[i]))
    low = lower(ca.Function("pull", [point], [ca.vertcat(point[:n], point[n] - _PULL * (1 + size))]))
    good = ca.eq(why, OPTIMAL)
    kept = [ca.densify(ca.if_else(good, found, point)), ca.if_else(good, why, end), count + spent]
    keep = lower(ca.Function("keep", [point, end, count, found, why, spent], kept))
    steps = (
        Call(low, ("point",), ("base",)),
        Call(kernel(space, sizes.m), ("unit", "base", "skip"), ("found", "numbers", "multipliers", "why", "spent")),
        Call(keep, ("point", "end", "count", "found", "why", "spent"), ("point_next", "end_next", "count_next")),
    )
    given = (("point", n + 1), ("end", 1), ("count", 1), ("unit", sizes.rows), ("skip", 1))
    return Routine("open", given, steps, ("point_next", "end_next", "count_next"))


def _widened(sizes: Sizes) -> Program:
    """(opened point, end, point) → the opened point with a margin on its opening, and whether there is one."""
    n = sizes.n
    opened, end, point = ca.SX.sym("opened", n + 1), ca.SX.sym("end"), ca.SX.sym("point", n + 1)
    wider = opened[n] + _MARGIN * (1 + ca.fabs(opened[n]))
    found = ca.eq(end, OPTIMAL)
    wide = ca.if_else(found, ca.vertcat(opened[:n], ca.fmax(wider, point[n])), point)
    return lower(ca.Function("widened", [opened, end, point], [ca.densify(wide), found]))


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
