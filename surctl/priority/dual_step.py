"""One iteration of the dual active-set method of Goldfarb and Idnani (1983) for min ‖y‖, as symbolic expressions.

The unknown is y (d,); the rows act on v = base + Z y (n,) and on an opening t of the soft rows:

    lower − soft·t ≤ a·v ≤ upper + soft·t

with a of length 1. Rows are priced on v itself, so that nothing has to be reduced but the row that enters. Up to d
active rows stand in slots: normal, multiplier, signed row number (+ at the upper bound, − at the lower, 0 empty),
and by how much the base misses the row. The slots are orthogonalised afresh in every iteration (modified
Gram–Schmidt): no factor is updated, nothing drifts. A row that needs several steps is pending in between.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from surctl.ir import Program, lower
from surctl.priority.elimination import as_matrix, flat

__all__ = ["OPTIMAL", "SKIPPED", "STUCK", "Space", "iteration", "polish", "pricing", "threshold", "which"]

OPTIMAL, STUCK, SKIPPED = 1, 2, 3
"""Why an iteration was the last: no row is missed; no point keeps the rows; there was nothing to do."""

_PRICED = 1e-12  # a row missed by no more than this, relative to 1 + max |v|, counts as kept
_ROUNDING = 1e-10  # likewise for a row that depends on the active ones: more means that no point keeps both
_PARALLEL = 1e-16  # square of the smallest part of a normal outside the span of the active ones
_PUSHING = 1e-12
_NEVER = 1e300


@dataclass(frozen=True)
class Space:
    """Sizes, and which variables are free.

    Attributes:
        n: length of v.
        d: length of y, at least 1.
        opening: whether t is free as well; then d = n + 1 and y = (v, t) − base, otherwise t is the base's.
    """

    n: int
    d: int
    opening: bool = False

    @property
    def row(self) -> int:
        """Entries of a row: a (n,), lower, upper, soft."""
        return self.n + 3


def pricing(space: Space) -> Program:
    """(turn, best, row, point) → best: the most violated row so far, (amount, signed number from 1).

    Strictly more than the best: the first of equals wins, and a NaN never does.
    """
    turn, best = ca.SX.sym("turn"), ca.SX.sym("best", 2)
    row, point = ca.SX.sym("row", space.row), ca.SX.sym("point", space.n + 1)
    above, below = _missed(space, row, point)
    at_lower = above < below
    missed = ca.if_else(at_lower, below, above)
    better = best[0] < missed
    number = turn + 1
    chosen = ca.if_else(at_lower, -number, number)
    result = ca.vertcat(ca.if_else(better, missed, best[0]), ca.if_else(better, chosen, best[1]))
    return lower(ca.Function("price", [turn, best, row, point], [result]))


def _missed(space: Space, row: ca.SX, point: ca.SX) -> tuple[ca.SX, ca.SX]:
    """By how much the point is above the upper and below the lower bound (negative: inside)."""
    value, room = ca.dot(row[: space.n], point[: space.n]), row[space.n + 2] * point[space.n]
    return value - row[space.n + 1] - room, row[space.n] - value - room


def threshold(space: Space) -> Program:
    """point → (smallest amount that counts, no row)."""
    point = ca.SX.sym("point", space.n + 1)
    return lower(ca.Function("threshold", [point], [ca.vertcat(_PRICED * _size(point[: space.n]), 0)]))


def _size(v: ca.SX) -> ca.SX:
    size = ca.SX(0)
    for i in range(v.numel()):
        size = ca.fmax(size, ca.fabs(v[i]))
    return 1 + size


def which() -> Program:
    """(best, pending) → index of the row to work on, and its signed number: the pending one, if there is one."""
    best, pending = ca.SX.sym("best", 2), ca.SX.sym("pending", 2)
    number = ca.if_else(ca.eq(pending[0], 0), best[1], pending[0])
    return lower(ca.Function("which", [best, pending], [ca.fabs(number) - 1, number]))


@dataclass(frozen=True)
class _Slots:
    """Active rows as columns: normals (d, d), multipliers, numbers, misses of the base (d,)."""

    normals: list[ca.SX]
    multipliers: list[ca.SX]
    numbers: list[ca.SX]
    misses: list[ca.SX]

    @staticmethod
    def of(space: Space, normals: ca.SX, table: ca.SX) -> _Slots:
        d = space.d
        columns = [normals[d * j : d * (j + 1)] for j in range(d)]
        u, numbers, misses = ([table[d * k + j] for j in range(d)] for k in range(3))
        return _Slots(columns, u, numbers, misses)

    def table(self) -> ca.SX:
        return ca.vertcat(*self.multipliers, *self.numbers, *self.misses)


@dataclass(frozen=True)
class _Triangle:
    """normals = Q R by modified Gram–Schmidt; an empty slot has a zero column and a zero in `inverse`."""

    Q: list[ca.SX]
    R: list[list[ca.SX]]
    inverse: list[ca.SX]

    @staticmethod
    def of(slots: _Slots) -> _Triangle:
        Q: list[ca.SX] = []
        R = [[ca.SX(0)] * len(slots.normals) for _ in slots.normals]
        inverse: list[ca.SX] = []
        for j, normal in enumerate(slots.normals):
            q = normal
            for i in range(j):
                R[i][j] = ca.dot(Q[i], q)
                q = q - R[i][j] * Q[i]
            used = slots.numbers[j] != 0
            length = ca.sqrt(ca.if_else(used, ca.sumsqr(q), 1))
            inverse.append(ca.if_else(used, 1 / length, 0))
            Q.append(q * inverse[j])
        return _Triangle(Q, R, inverse)

    def split(self, normal: ca.SX) -> tuple[ca.SX, list[ca.SX]]:
        """(what stands outside the span, coordinates in Q); twice, which is enough (Parlett 1998, 6.9)."""
        outside, inside = normal, [ca.SX(0)] * len(self.Q)
        for _ in range(2):
            for j, q in enumerate(self.Q):
                part = ca.dot(q, outside)
                outside = outside - part * q
                inside[j] = inside[j] + part
        return outside, inside

    def solve(self, rhs: list[ca.SX]) -> list[ca.SX]:
        """r with R r = rhs, 0 in empty slots."""
        r = list(rhs)
        for j in reversed(range(len(r))):
            for k in range(j + 1, len(r)):
                r[j] = r[j] - self.R[j][k] * r[k]
            r[j] = r[j] * self.inverse[j]
        return r

    def solve_transposed(self, rhs: list[ca.SX]) -> list[ca.SX]:
        """c with Rᵀ c = rhs, 0 in empty slots."""
        c = list(rhs)
        for j in range(len(c)):
            for i in range(j):
                c[j] = c[j] - self.R[i][j] * c[i]
            c[j] = c[j] * self.inverse[j]
        return c


@dataclass(frozen=True)
class _Entering:
    """The row at hand, turned so that it asks for normal · v ≤ bound: its normal in y, and both misses."""

    normal: ca.SX
    missed: ca.SX
    missed_by_base: ca.SX

    @staticmethod
    def of(space: Space, row: ca.SX, number: ca.SX, *, point: ca.SX, base: ca.SX, Z: ca.SX | None) -> _Entering:
        n, at_lower = space.n, number < 0
        a = ca.if_else(at_lower, -row[:n], row[:n])
        bound, soft = ca.if_else(at_lower, -row[n], row[n + 1]), row[n + 2]
        normal = ca.vertcat(a, -soft) if Z is None else Z.T @ a
        missed, at_base = (ca.dot(a, p[:n]) - bound - soft * p[n] for p in (point, base))
        return _Entering(normal, missed, at_base)


@dataclass(frozen=True)
class _Step:
    """How far to go, and what happens to the slots."""

    length: ca.SX
    move: ca.SX
    full: ca.SX
    drop: list[ca.SX]
    status: ca.SX

    @staticmethod
    def of(slots: _Slots, found: ca.SX, entering: _Entering, outside: ca.SX, r: list[ca.SX], size: ca.SX) -> _Step:
        square = ca.sumsqr(outside)
        room = ca.SX(0)
        for number in slots.numbers:
            room = ca.logic_or(room, ca.eq(number, 0))
        # a full step needs a free slot: rounding may see a further direction where there is none
        free = ca.logic_and(square > _PARALLEL, room)
        whole = ca.if_else(free, entering.missed / ca.if_else(free, square, 1), _NEVER)
        part, first = ca.SX(_NEVER), ca.SX(-1)
        for j, number in enumerate(slots.numbers):
            gives = ca.logic_and(number != 0, r[j] > _PUSHING)
            ratio = ca.if_else(gives, slots.multipliers[j] / ca.if_else(gives, r[j], 1), _NEVER)
            sooner = ratio < part
            part, first = ca.if_else(sooner, ratio, part), ca.if_else(sooner, j, first)
        rounding = ca.logic_and(ca.logic_not(free), entering.missed <= _ROUNDING * size)
        goes = ca.logic_and(found, ca.logic_not(rounding))
        full = ca.logic_and(ca.logic_and(goes, free), whole <= part)
        partial = ca.logic_and(ca.logic_and(goes, ca.logic_not(full)), part < _NEVER)
        length = ca.if_else(full, whole, ca.if_else(partial, part, 0))
        stuck = ca.logic_and(goes, ca.logic_not(ca.logic_or(full, partial)))
        return _Step(
            length=length,
            move=ca.if_else(free, length, 0),
            full=full,
            drop=[ca.logic_and(partial, ca.eq(first, j)) for j in range(len(r))],
            status=ca.if_else(goes, ca.if_else(stuck, STUCK, 0), OPTIMAL),
        )


def iteration(space: Space) -> Program:
    """(point, normals, table, pending, status, count, number, row, base[, Z]) → the first six, one step on.

    point, base: (n + 1,), v and t. normals: (d·d,), slot by slot. table: (3d,), multipliers, numbers, misses.
    pending: (2,), signed number (0: none) and multiplier. Z: (n·d,) row by row, absent if the opening is free.
    """
    n, d = space.n, space.d
    point, normals, table = ca.SX.sym("point", n + 1), ca.SX.sym("normals", d * d), ca.SX.sym("table", 3 * d)
    pending, status, count = ca.SX.sym("pending", 2), ca.SX.sym("status"), ca.SX.sym("count")
    number, row, base = ca.SX.sym("number"), ca.SX.sym("row", space.row), ca.SX.sym("base", n + 1)
    Z = None if space.opening else ca.SX.sym("Z", n * d)
    map_ = None if Z is None else as_matrix(Z, d)

    slots = _Slots.of(space, normals, table)
    entering = _Entering.of(space, row, number, point=point, base=base, Z=map_)
    triangle = _Triangle.of(slots)
    outside, inside = triangle.split(entering.normal)
    r = triangle.solve(inside)
    step = _Step.of(slots, number != 0, entering, outside, r, _size(point[:n]))
    lifted = outside if map_ is None else ca.vertcat(map_ @ outside, 0)
    multiplier = pending[1] + step.length
    after = _exchange(slots, step, r, entering, number, multiplier)
    stays = ca.logic_and(ca.eq(step.status, 0), ca.logic_not(step.full))
    outputs = [
        point - step.move * lifted,
        ca.vertcat(*after.normals),
        after.table(),
        ca.vertcat(ca.if_else(stays, number, 0), ca.if_else(stays, multiplier, 0)),
        step.status,
        count + 1,
    ]
    inputs = [point, normals, table, pending, status, count, number, row, base, *([] if Z is None else [Z])]
    return lower(ca.Function(f"iterate_{d}", inputs, outputs))


def _exchange(
    slots: _Slots, step: _Step, r: list[ca.SX], entering: _Entering, number: ca.SX, multiplier: ca.SX
) -> _Slots:
    """Multipliers after the step; the dropped row leaves its slot, the entering one takes the first empty slot."""
    columns: tuple[list[ca.SX], ...] = ([], [], [], [])
    waiting = step.full
    for j, drop in enumerate(step.drop):
        takes = ca.logic_and(waiting, ca.eq(slots.numbers[j], 0))
        waiting = ca.logic_and(waiting, ca.logic_not(takes))
        left = ca.fmax(slots.multipliers[j] - step.length * r[j], 0)
        for column, old, new in zip(
            columns,
            (slots.normals[j], left, slots.numbers[j], slots.misses[j]),
            (entering.normal, multiplier, number, entering.missed_by_base),
            strict=True,
        ):
            column.append(ca.if_else(takes, new, ca.if_else(drop, 0, old)))
    return _Slots(*columns)


def polish(space: Space) -> Program:
    """(normals, table, base[, Z]) → (point, numbers, multipliers) from the active rows alone.

    The nearest point to the base at which every active row is tight, with one step of refinement: what rounding
    the iterations left is gone, and the multipliers are those of ½‖y‖².
    """
    n, d = space.n, space.d
    normals, table, base = ca.SX.sym("normals", d * d), ca.SX.sym("table", 3 * d), ca.SX.sym("base", n + 1)
    Z = None if space.opening else ca.SX.sym("Z", n * d)
    slots = _Slots.of(space, normals, table)
    triangle = _Triangle.of(slots)
    y, u = ca.SX.zeros(d, 1), [ca.SX(0)] * d
    for _ in range(2):
        off = [miss + ca.dot(normal, y) for miss, normal in zip(slots.misses, slots.normals, strict=True)]
        c = triangle.solve_transposed(off)
        y = y - sum((c[j] * triangle.Q[j] for j in range(d)), ca.SX.zeros(d, 1))
        u = [old + more for old, more in zip(u, triangle.solve(c), strict=True)]
    lifted = y if Z is None else ca.vertcat(as_matrix(Z, d) @ y, 0)
    outputs = [base + lifted, ca.vertcat(*slots.numbers), ca.vertcat(*u)]
    return lower(ca.Function(f"polish_{d}", [normals, table, base, *([] if Z is None else [Z])], outputs))
