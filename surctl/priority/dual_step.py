"""One iteration of the dual active-set method of Goldfarb and Idnani (1983) for min ‖y‖, as symbolic expressions.

The unknown is y (d,); the rows act on v = base + Z y (n,) and on an opening t of the soft rows:

    lower − soft·t ≤ a·v ≤ upper + soft·t

with a of length 1. Rows are priced on v itself, so that nothing has to be reduced but the row that enters, and the
last pricing is a check of the very point that is handed out. Up to d active rows stand in slots: normal, multiplier
and signed row number (+ at the upper bound, − at the lower, 0 empty). The slots are orthogonalised afresh in every
iteration (modified Gram–Schmidt): no factor is updated, nothing drifts. A row that needs several steps is pending in
between.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from surctl.ir import Program, lower
from surctl.priority.elimination import as_matrix

__all__ = ["OPTIMAL", "SKIPPED", "STUCK", "Space", "iteration", "misses", "pricing", "threshold", "which"]

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
    """(turn, best, row, point) → best: the most violated row so far, (amount, its number from 1).

    Strictly more than the best: the first of equals wins, and a NaN never does.
    """
    turn, best = ca.SX.sym("turn"), ca.SX.sym("best", 2)
    row, point = ca.SX.sym("row", space.row), ca.SX.sym("point", space.n + 1)
    above, below = misses(space, row, point)
    missed = ca.if_else(above < below, below, above)
    better = best[0] < missed
    result = ca.vertcat(ca.if_else(better, missed, best[0]), ca.if_else(better, turn + 1, best[1]))
    return lower(ca.Function("price_open" if space.opening else "price", [turn, best, row, point], [result]))


def misses(space: Space, row: ca.SX, point: ca.SX) -> tuple[ca.SX, ca.SX]:
    """By how much the point is above the upper and below the lower bound (negative: inside)."""
    n = space.n
    value = ca.dot(row[:n], point[:n])
    if not space.opening:  # t is 0
        return value - row[n + 1], row[n] - value
    room = row[n + 2] * point[n]
    return value - (row[n + 1] + room), (row[n] - room) - value


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
    """(best, pending) → index of the row to work on: that of the pending one, if there is one; −1 for none."""
    best, pending = ca.SX.sym("best", 2), ca.SX.sym("pending", 2)
    number = ca.if_else(ca.eq(pending[0], 0), best[1], ca.fabs(pending[0]))
    return lower(ca.Function("which", [best, pending], [number - 1]))


@dataclass(frozen=True)
class _Slots:
    """Active rows: normals (d,) each, multipliers, numbers."""

    normals: list[ca.SX]
    multipliers: list[ca.SX]
    numbers: list[ca.SX]


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


@dataclass(frozen=True)
class _Entering:
    """The row at hand, turned so that it asks for normal · v ≤ bound: signed number, normal in y, and its miss."""

    number: ca.SX
    normal: ca.SX
    missed: ca.SX

    @staticmethod
    def of(space: Space, row: ca.SX, at: ca.SX, *, pending: ca.SX, point: ca.SX, Z: ca.SX | None) -> _Entering:
        above, below = misses(space, row, point)
        at_lower = ca.if_else(ca.eq(pending, 0), above < below, pending < 0)
        number = at + 1
        a = ca.if_else(at_lower, -row[: space.n], row[: space.n])
        normal = ca.vertcat(a, -row[space.n + 2]) if Z is None else Z.T @ a
        return _Entering(ca.if_else(at_lower, -number, number), normal, ca.if_else(at_lower, below, above))


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
    """(point, normals, multipliers, numbers, pending, status, count, at, row[, Z]) → the first seven, one step on.

    point: (n + 1,), v and t. normals: (d·d,), slot by slot. multipliers, numbers: (d,). pending: (2,), signed number
    (0: none) and multiplier. at: index of the row, −1 for none. Z: (n·d,) row by row, absent if the opening is free.
    """
    n, d = space.n, space.d
    point, normals, u = ca.SX.sym("point", n + 1), ca.SX.sym("normals", d * d), ca.SX.sym("multipliers", d)
    numbers, pending, status = ca.SX.sym("numbers", d), ca.SX.sym("pending", 2), ca.SX.sym("status")
    count, at, row = ca.SX.sym("count"), ca.SX.sym("at"), ca.SX.sym("row", space.row)
    Z = None if space.opening else ca.SX.sym("Z", n * d)
    map_ = None if Z is None else as_matrix(Z, d)

    slots = _Slots([normals[d * j : d * (j + 1)] for j in range(d)], ca.vertsplit(u), ca.vertsplit(numbers))
    entering = _Entering.of(space, row, at, pending=pending[0], point=point, Z=map_)
    triangle = _Triangle.of(slots)
    outside, inside = triangle.split(entering.normal)
    r = triangle.solve(inside)
    step = _Step.of(slots, at >= 0, entering, outside, r, _size(point[:n]))
    lifted = outside if map_ is None else ca.vertcat(map_ @ outside, 0)
    multiplier = pending[1] + step.length
    after = _exchange(slots, step, r, entering, multiplier)
    stays = ca.logic_and(ca.eq(step.status, 0), ca.logic_not(step.full))
    outputs = [
        point - step.move * lifted,
        ca.vertcat(*after.normals),
        ca.vertcat(*after.multipliers),
        ca.vertcat(*after.numbers),
        ca.vertcat(ca.if_else(stays, entering.number, 0), ca.if_else(stays, multiplier, 0)),
        step.status,
        count + 1,
    ]
    inputs = [point, normals, u, numbers, pending, status, count, at, row, *([] if Z is None else [Z])]
    return lower(ca.Function(f"iterate_{d}", inputs, outputs))


def _exchange(slots: _Slots, step: _Step, r: list[ca.SX], entering: _Entering, multiplier: ca.SX) -> _Slots:
    """Multipliers after the step; the dropped row leaves its slot, the entering one takes the first empty slot."""
    columns: tuple[list[ca.SX], ...] = ([], [], [])
    waiting = step.full
    for j, drop in enumerate(step.drop):
        takes = ca.logic_and(waiting, ca.eq(slots.numbers[j], 0))
        waiting = ca.logic_and(waiting, ca.logic_not(takes))
        left = ca.fmax(slots.multipliers[j] - step.length * r[j], 0)
        for column, old, new in zip(
            columns,
            (slots.normals[j], left, slots.numbers[j]),
            (entering.normal, multiplier, entering.number),
            strict=True,
        ):
            column.append(ca.if_else(takes, new, ca.if_else(drop, 0, old)))
    return _Slots(*columns)
