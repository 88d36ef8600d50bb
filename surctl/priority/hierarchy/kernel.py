"""Strict priority within limits: one active set over all levels (Escande, Mansard, Wieber 2014); least budget.

Given limits l ≤ a·v ≤ u (rows of length 1, hard or soft) and levels J v = x or l ≤ J v ≤ u, the kernel finds

1. the smallest opening of the hard limits, then of the soft limits, for which some v satisfies them;
2. level by level, among the v that are optimal for the levels above, those with the smallest ‖J v − x‖, for a
   set-based level with the smallest distance of J v from its interval;
3. among these, the shortest v.

Openings are unknowns of their own (columns n and n + 1), and `opening = 0` are the levels 0 and 1, so v = 0 clipped to
the box is always feasible to begin with. W is the set of active limits, A_W Q = [L 0] with Q orthogonal. The table T =
[J; I] Q is updated when a limit enters W (one reflection) or leaves it (Givens rotations). Behind the columns of W, a
copy B of the table's rows J is eliminated level by level by reflections from the right, with the longest remaining row
as pivot; singular values below 1e-10·‖J‖ count as 0. A level with more rows than its rank needs a QR from the left too
(elimination of all levels: Dimitrov, Sherikov and Wieber 2015). Each iteration goes to the optimum on W or to the first
limit on the way. After a full step, the multipliers of the level say which limit leaves W; limits with a positive
multiplier are locked, because they are active at every optimum of the level.

The functions are the source of a `Procedure`; `hierarchy` returns it.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Set
from functools import lru_cache
from typing import Any

from surctl.errors import InputError
from surctl.ir.bound import called, spending
from surctl.ir.procedure import Procedure, fabs, source_of, within
from surctl.priority.hierarchy import damping, factors, judgement, search
from surctl.priority.hierarchy.factors import optimum
from surctl.priority.hierarchy.judgement import judge
from surctl.priority.hierarchy.memory import Memory
from surctl.priority.hierarchy.search import at_once, descend, prepare, restore
from surctl.priority.shapes import StackShape
from surctl.priority.solver.elimination import FLOAT32, FLOAT64, Precision


def arrange(_s: Memory) -> None:
    """Write the structure of the levels; `hierarchy` puts a function for its levels in the place of this one."""


def sound(s: Memory) -> int:
    """Return whether the numbers of the levels are finite and their bounds in order."""
    good = 1
    for level in within(2, s.p, s.p):
        for row in within(s.first[level] - 2, s.first[level + 1] - 2, s.b):
            for j in range(s.n):
                if not fabs(s.J[row * s.n + j]) <= 1e140:
                    good = 0
            if s.is_set[level] != 0:
                if not s.lower[row] <= s.upper[row] or not s.lower[row] <= 1e300 or not s.upper[row] >= -1e300:
                    good = 0
            elif not fabs(s.lower[row]) <= 1e300 or s.lower[row] != s.upper[row]:
                good = 0
    return good


def retreat(s: Memory) -> float:
    """Move v back towards the first v until the hard limits hold; return the largest violation of a soft limit."""
    share = 1.0
    for j in range(s.n):
        e = 0.0
        e = s.box[j] if e < s.box[j] else e
        s.goal[j] = s.box[s.n + j] if e > s.box[s.n + j] else e
    for turn in range(2):
        wide = 0.0
        for i in range(s.m):
            start = 0.0
            value = 0.0
            for j in range(s.n):
                start += s.At[j * s.m + i] * s.goal[j]
                value += s.At[j * s.m + i] * s.v[j]
            above = value - s.up[i] if value > start else s.lo[i] - value
            path = fabs(value - start)
            if s.rows[i * (s.n + 3) + s.n + 2] > 0.0:
                above = value - s.up[i] if value - s.up[i] > s.lo[i] - value else s.lo[i] - value
                wide = above if above > wide else wide
            elif above > 1e-10 * (1.0 + s.size) and above > (1.0 - share) * path:
                share = 1.0 - above / path if above < path else 0.0
        if turn == 0:
            for j in range(s.n):
                s.v[j] = s.goal[j] + share * (s.v[j] - s.goal[j])
    return wide


def solution(s: Memory) -> None:
    """Solve the problem and write the outputs."""
    arrange(s)
    for j in range(s.n):
        s.active[j] = 0.0
        s.multipliers[j] = 0.0
        s.target[j] = 0.0
    s.opening[0] = 0.0
    s.status[0] = 4.0
    s.count[0] = 0.0
    prepare(s)
    if s.bad == 0 and sound(s) != 0:
        s.turns = 1
        s.reached = 1
        if s.damped != 0 or s.hard >= 0 or s.soft >= 0 or at_once(s) == 0:
            s.reached = descend(s)
        if s.budget != 0 and s.spent > s.budget:
            s.reached = 0
        if s.damped != 0 and s.reached == 0:
            s.sure = 0
        restore(s)
        if s.damped == 0 and s.budget == 0 and s.valid < s.p:
            optimum(s, s.p + 1)
        if s.budget != 0 and s.reached == 0:
            s.size = 1.0
            outcome = 0
        else:
            outcome = judge(s)
        far = s.v[s.hard] if s.hard >= 0 else 0.0
        wide = s.v[s.soft] if s.soft >= 0 else 0.0
        if outcome == 0 or outcome == 2:
            wide = retreat(s)
        s.opening[0] = wide if wide > 1e-12 * s.size else 0.0
        s.status[0] = 3.0 if s.opening[0] > 0.0 else 2.0 if outcome >= 2 else 1.0
        if outcome == 0 or outcome == 2:
            s.status[0] = 6.0
        if far > 1e-9 * s.size:
            s.status[0] = 4.0
        s.count[0] = 1.0 * s.turns
    finite = 1
    for j in range(s.n):
        if not fabs(s.v[j]) <= 1e300 or s.count[0] == 0.0:
            finite = 0
    for j in range(s.n):
        e = s.v[j] if finite != 0 else 0.0
        e = e if e >= s.box[j] else s.box[j]
        e = e if e <= s.box[s.n + j] else s.box[s.n + j]
        s.velocity[j] = e if fabs(e) <= 1e300 else 0.0
    if finite == 0:
        s.status[0] = 4.0
    if s.status[0] == 4.0:
        s.opening[0] = 0.0
        for j in range(s.n):
            s.active[j] = 0.0
            s.multipliers[j] = 0.0


_FACTORS = (
    factors.reflection, factors.reflect_table, factors.reflect_levels, factors.along, factors.enter, factors.leave,
    factors.eliminate_left, factors.solve_left, factors.take_off, factors.pivots,
)  # fmt: skip
_POINTS = (factors.solve_level, factors.optimum, factors.multipliers, judgement.at_goal, judgement.at_v)
_SEARCH = (
    search.prepare, search.switch_set, search.at_once, search.approach, search.ratio, search.move_limits,
    search.advance, search.unlocked, search.release, search.descend, search.restore,
)  # fmt: skip
_LOSS = (judgement.add_row, judgement.bound_loss, judgement.remember)
_END = (judgement.judge, retreat, sound, solution)
_STRICT = (*_FACTORS, *_POINTS, *_SEARCH, *_LOSS, *_END)
_DAMPED = (
    *_FACTORS, factors.solve_damped, *_POINTS, *_LOSS, damping.keep_set, damping.keep, damping.damp, damping.confirm,
    *_SEARCH, *_END,
)  # fmt: skip


def hierarchy(
    shape: StackShape,
    rows: int,
    precision: Precision = FLOAT64,
    *,
    damped: bool = False,
    budget: int | None = None,
    others: int = 0,
) -> Procedure:
    """Return the kernel for levels of these shapes and a number of limits, with the ports of `priority_step`.

    damped: whether levels are damped, see module `damping`. One more input is c, `damping` (1,): w² = c ‖x‖ + 1e-6.
    budget: most operations of a run, see `Procedure.operations`, and of others; None: as many as the problem needs. If
    the search does not end within the budget, it ends early, and its velocity is unconfirmed.

    Raises:
        InputError: the budget is too small for any search, or no int of C.
    """
    if budget is None:
        return _kernel(shape, rows, precision, damped, None)
    if budget >= 2**31:
        raise InputError("is too large", key="budget", value=budget, remedy="give less than 2147483648, or None")
    rest = budget - others - _kernel(shape, rows, precision, damped, 0).operations
    if rest < 0:
        raise InputError("is too small", key="budget", value=budget, remedy=f"give {budget - rest} or more operations")
    return _kernel(shape, rows, precision, damped, rest)


@lru_cache(maxsize=32)
def _kernel(shape: StackShape, rows: int, precision: Precision, damped: bool, budget: int | None) -> Procedure:
    """Return the kernel; budget: most operations before those that do not check it."""
    off = frozenset((*(() if damped else ("damped",)), *(("budget",) if budget is None else ())))
    functions = [_source(function, off, precision) for function in (_DAMPED if damped else _STRICT)]
    n, starts = shape.n, (0, 1, *(2 + start for start in shape.starts), 2 + shape.rows)
    p, x, k = len(shape.levels) + 2, _padded(n + 2), _padded(2 + shape.rows)
    r, largest, more = k + x, max(level.rows for level in shape.levels), x * damped
    begin = next((level for level in range(2, p) if shape.levels[level - 2].is_set), p) if damped else 0
    functions = [function.replace("s.earliest", str(begin)) for function in functions]  # in `assert` alone
    arranged = ["def arrange(s):"]
    arranged += [f"    s.first[{level}] = {start}" for level, start in enumerate(starts)]
    for level in range(p):
        arranged.append(f"    s.is_set[{level}] = {int(level > 1 and shape.levels[level - 2].is_set)}")
        arranged += [f"    s.level_of[{row}] = {level}" for row in range(starts[level], starts[level + 1])]
    sources = ["\n".join(arranged), *functions]
    return Procedure.of(
        "hierarchy",
        sources if budget is None else [spending("\n".join(sources))],
        inputs=(*shape.inputs, ("rows", rows * (n + 3)), ("box", 2 * n), *((("damping", 1),) if damped else ())),
        outputs=(
            ("velocity", n), ("active", n), ("multipliers", n), ("opening", 1), ("status", 1), ("count", 1),
            ("target", n),
        ),
        sizes={
            "n": n, "x": x, "quarter": x // 4, "m": rows, "k": k, "b": largest, "p": p, "r": r,
            "cap": 2 * (n + rows) + p, **({"damped": 1} if damped else {}),
            **({} if budget is None else {"budget": budget}),
        },
        reals={
            "At": n * rows, "lo": rows, "up": rows, "lo_true": rows, "up_true": rows, "T": x * r, "B": x * k,
            "L": x * x, "V": x * x, "tau": x, "h": x, "sums": r, "y": x, "z": x, "g": x, "QR": k * x,
            "diagonal": p * x, "weight": p * x, "side_d": k + more, "norms": k + more, "rhs": k, "rest": k, "scale": p,
            "v": x, "goal": x, "step": x, "lam": x, "mu": k, "speed": rows, "value": rows, "margin": 2 * rows,
            "slack": rows, "slack_set": k, "speed_set": k, "gap": rows, "gap_set": k, "spread": p, "d": x, "factor": 0,
            "head": 0, "nearest": 0, "size": 0,
            **({"R": (k + x) * x, "ridge": p, "low": k, "high": k} if damped else {}),
        },
        wholes={
            "first": p + 1, "is_set": p, "level_of": k, "column": rows, "pivot": k, "many": p, "start": p + 1,
            "used": p + 1, "left": p, "rank": p, "on": k, "lock": rows, "lock_set": k, "inside": rows, "W": x,
            "side": x, "toward": rows, "near": rows, "toward_set": k,
            **dict.fromkeys(
                ("N", "w", "valid", "hard", "soft", "top", "moved", "still", "bad", "reached", "block", "block_set",
                 "block_side", "turns", "hits",
                 *(("f", "skip", "last", "sure", "limited", "place") if damped else ()),
                 *(() if budget is None else ("spent",))), 0,
            ),
        },
    )  # fmt: skip


_FLOAT = {
    **{1e-16: 1e-16, 1e-15: 1e-7, 1e-14: 1e-6, 1e-13: 1e-6, 1e-12: 1e-5, 1e-11: 1e-5, 1e-10: 3e-5, 3e-10: 1e-4},
    **{1e-9: 1e-4, 1e-7: 1e-2, 1e-6: 1e-2, 1e30: 1e30, 1e140: 1e15, 1e150: 1e15, 1e299: 1e29, 1e300: 1e30},
}
"""The tolerances of the kernel for float, by those for double."""


@lru_cache(maxsize=512)  # kernels of other shapes have the same functions
def _source(function: Callable[..., Any], off: frozenset[str], precision: Precision) -> str:
    """Return the source of a function with its tolerances, without the branches for what is `off`."""
    tree = _Without(off).visit(ast.parse(source_of(function)))
    if precision == FLOAT32:
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and type(node.value) is float and not 1e-4 <= abs(node.value) <= 10.0:
                node.value = _FLOAT[node.value] if node.value else 0.0
    return ast.unparse(tree)


class _Without(ast.NodeTransformer):
    """Takes `s.damped` or `s.budget` as 0 if it is off, and drops what is never reached then.

    A budget may be 0 before the time of the search is known, so `s.budget` counts as not 0 if it is on; with it, each
    iteration may be the last, so nothing is gained by `seldom`.
    """

    def __init__(self, off: Set[str]) -> None:
        self.off = off

    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        self.generic_visit(node)
        match node:
            case ast.Compare(left=ast.Attribute(attr="damped" | "budget" as name), ops=[op]):
                if name in self.off or name == "budget":
                    return ast.Constant(isinstance(op, ast.Eq) is (name in self.off))
        return node

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.expr:
        self.generic_visit(node)
        neutral = isinstance(node.op, ast.And)
        values = [v for v in node.values if "budget" in self.off or called(v, "seldom") is None]
        constants = [value.value for value in values if isinstance(value, ast.Constant)]
        rest = [value for value in values if not isinstance(value, ast.Constant)]
        if (not neutral) in constants:
            return ast.Constant(not neutral)
        return ast.BoolOp(node.op, rest) if len(rest) > 1 else rest[0] if rest else ast.Constant(neutral)

    def visit_IfExp(self, node: ast.IfExp) -> ast.expr:
        self.generic_visit(node)
        return node.orelse if isinstance(node.test, ast.Constant) else node

    def visit_If(self, node: ast.If) -> ast.stmt | list[ast.stmt]:
        self.generic_visit(node)
        return node.orelse if isinstance(node.test, ast.Constant) else node


def _padded(size: int) -> int:
    return -(-size // 4) * 4
