"""One iteration of the dual active-set method of Goldfarb and Idnani (1983) for min ‖y‖ subject to linear constraints.

The constraint rows are lower ≤ g·(start + y) ≤ upper with normals g (d,). The violations are evaluated at the point
start + y itself, so the last evaluation also checks the returned point. Up to d active rows are stored in a list;
each entry, called a slot, consists of normal, multiplier and signed row number (+ at the upper bound, − at the lower
bound, 0 if the slot is empty). Empty slots are at the end. Every iteration orthogonalises the normals again (modified
Gram–Schmidt), so errors do not accumulate as they would in an updated factorisation. A violated row that needs
several steps to become active is called pending between these steps.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import casadi as ca

from surctl.ir import Program, lower
from surctl.priority.solver.elimination import FLOAT64, Precision


class _Planar(NamedTuple):
    """Relation of the normal of the entering row, which becomes active, to the normals of the active rows.

    Attributes:
        apart: component of the entering normal outside the span of the active normals, times the length of the first
            active normal.
        first: squared length of the first active normal.
        r: coefficients of the entering normal as a combination of the active normals, 0 for an unused entry. ratios:
            multipliers divided by r.
        full: (2,), displacement of the unknowns that satisfies the entering row, for a violation of 1. rate: (2,),
            component of the entering normal outside the span of the active normals.
        whole: change of the multiplier in this displacement, for a violation of 1.
    """

    apart: ca.SX
    first: ca.SX
    r: list[ca.SX]
    ratios: list[ca.SX]
    full: ca.SX
    rate: ca.SX
    whole: ca.SX


def _planar(normals: list[ca.SX], numbers: list[ca.SX], multipliers: list[ca.SX], entering: ca.SX) -> _Planar:
    """Compute the step for at most two active rows; unused entries of the lists have number 0 and are last.

    A perpendicular vector replaces a missing normal. All divisions that depend on the entering row can run in parallel.
    """
    one, two = numbers[0] != 0, numbers[1] != 0
    first = ca.if_else(one, normals[0], _across(-entering))
    second = ca.if_else(two, normals[1], _across(first))
    area, apart, along = _cross(first, second), _cross(first, entering), _cross(entering, second)
    inverse, per_miss, per_rate = _inverse(area), _inverse(apart), _inverse(along)
    squared = first[0] * first[0] + first[1] * first[1]
    beside = apart * inverse
    return _Planar(
        apart=apart,
        first=squared,
        r=[ca.if_else(one, along * inverse, 0), ca.if_else(two, beside, 0)],
        ratios=[multipliers[0] * area * per_rate, multipliers[1] * area * per_miss],
        full=per_miss * second,
        rate=beside * second,
        whole=per_miss * (per_miss * squared),
    )


def _inverse(x: ca.SX) -> ca.SX:
    return 1 / ca.if_else(ca.eq(x, 0), 1, x)


def _cross(a: ca.SX, b: ca.SX) -> ca.SX:
    return a[0] * b[1] - a[1] * b[0]


def _across(a: ca.SX) -> ca.SX:
    """Return the vector (2,) rotated by 90° counter-clockwise."""
    return ca.vertcat(-a[1], a[0])


OPTIMAL, STUCK, SKIPPED = 1, 2, 3
"""Reasons to stop: all rows are satisfied; no point satisfies the rows; the search was skipped."""


@dataclass(frozen=True)
class Space:
    """Number of unknowns d of the active-set search, and its tolerances."""

    d: int
    precision: Precision = FLOAT64

    @property
    def row(self) -> int:
        """Return the number of entries that store a constraint row: normal, lower, upper."""
        return self.d + 2


def pricing(space: Space) -> Program:
    """Return a program that compares one constraint row with the most violated row so far.

    Its inputs are the index of the row, violation and signed number of the most violated row, the row and the point.
    Its output is the violation and signed number of the row violated more.

    Of equally violated rows the first is chosen; a row with a NaN is never chosen.
    """
    turn, best = ca.SX.sym("turn"), ca.SX.sym("best", 2)
    row, point = ca.SX.sym("row", space.row), ca.SX.sym("point", space.d)
    above, below = misses(space, row, point)
    at_lower = above < below
    missed = ca.if_else(at_lower, below, above)
    number = ca.if_else(at_lower, -(turn + 1), turn + 1)
    better = best[0] < missed
    result = ca.vertcat(ca.if_else(better, missed, best[0]), ca.if_else(better, number, best[1]))
    return lower(ca.Function("price", [turn, best, row, point], [result]))


def misses(space: Space, row: ca.SX, point: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the amounts by which a row at the point is above its upper and below its lower bound (negative if not)."""
    value = dot(row[: space.d], point)
    return value - row[space.d + 1], row[space.d] - value


def _sum(terms: list[ca.SX]) -> ca.SX:
    # adding in pairs shortens the chain of dependent additions
    while len(terms) > 1:
        terms = [a + b for a, b in zip(terms[::2], terms[1::2], strict=False)] + terms[len(terms) // 2 * 2 :]
    return terms[0]


def dot(a: ca.SX, b: ca.SX) -> ca.SX:
    """Return the scalar product a · b; the products are summed in pairs."""
    return _sum([a[i] * b[i] for i in range(a.numel())])


def threshold(space: Space) -> Program:
    """Return a program for the start of the search for the most violated row: the smallest violation that counts."""
    point = ca.SX.sym("point", space.d)
    least = space.precision.priced * _size(point)
    return lower(ca.Function("threshold", [point], [ca.densify(ca.vertcat(least, 0))]))


def halve() -> Program:
    """Return a program that selects the more violated of two rows (the first if equal), by violation and number."""
    four = ca.SX.sym("four", 4)
    tie = ca.logic_and(ca.eq(four[0], four[1]), ca.fabs(four[3]) < ca.fabs(four[2]))
    second = ca.logic_or(four[0] < four[1], tie)
    best = ca.vertcat(ca.if_else(second, four[1], four[0]), ca.if_else(second, four[3], four[2]))
    return lower(ca.Function("halve", [four], [best]))


def close() -> Program:
    """Return a program that sets the status to optimal if no row is violated and no row is pending."""
    best, pending, status = ca.SX.sym("best", 2), ca.SX.sym("pending", 2), ca.SX.sym("status")
    idle = ca.logic_and(ca.eq(best[1], 0), ca.eq(pending[0], 0))
    after = ca.if_else(ca.logic_and(ca.eq(status, 0), idle), OPTIMAL, status)
    return lower(ca.Function("close", [best, pending, status], [after]))


def _size(v: ca.SX) -> ca.SX:
    size = ca.SX(0)
    for i in range(v.numel()):
        size = ca.fmax(size, ca.fabs(v[i]))
    return 1 + size


def which() -> Program:
    """Return a program for index and signed number of the next row: the pending row, else the most violated one."""
    best, pending = ca.SX.sym("best", 2), ca.SX.sym("pending", 2)
    number = ca.if_else(ca.eq(pending[0], 0), best[1], pending[0])
    return lower(ca.Function("which", [best, pending], [ca.fabs(number) - 1, number]))


@dataclass(frozen=True)
class _Slots:
    """Normals, multipliers and numbers of the active rows; unused entries have number 0 and are at the end."""

    normals: list[ca.SX]  # (d,) each
    multipliers: list[ca.SX]
    numbers: list[ca.SX]  # signed row numbers


@dataclass(frozen=True)
class _Triangle:
    """QR factorisation of the active normals, by modified Gram–Schmidt without square roots; R has a unit diagonal."""

    Q: list[ca.SX]  # orthogonal columns
    R: list[list[ca.SX]]  # entries above the diagonal
    inverse: list[ca.SX]  # 1/‖q‖² of each column q of Q, 0 in an empty slot

    @staticmethod
    def of(slots: _Slots) -> _Triangle:
        Q: list[ca.SX] = []
        R = [[ca.SX(0)] * len(slots.normals) for _ in slots.normals]
        inverse: list[ca.SX] = []
        for j, normal in enumerate(slots.normals):
            q = normal
            for i in range(j):
                R[i][j] = dot(Q[i], q) * inverse[i]
                q = q - R[i][j] * Q[i]
            used = slots.numbers[j] != 0
            inverse.append(ca.if_else(used, 1 / ca.if_else(used, dot(q, q), 1), 0))
            Q.append(q)
        return _Triangle(Q, R, inverse)

    def split(self, normal: ca.SX) -> tuple[ca.SX, list[ca.SX]]:
        """Return the part of a normal outside the span of the columns of Q, and the coordinates of the rest in Q."""
        # two passes suffice (Parlett 1998, 6.9); if the last slot is in use, every normal lies in the span, so
        # `outside` may ignore the last slot
        outside, inside = normal, [ca.SX(0)] * len(self.Q)
        for _ in range(2):
            for j, q in enumerate(self.Q[:-1]):
                part = dot(q, outside) * self.inverse[j]
                outside = outside - part * q
                inside[j] = inside[j] + part
        inside[-1] = dot(self.Q[-1], outside) * self.inverse[-1]
        return outside, inside

    def solve(self, rhs: list[ca.SX]) -> list[ca.SX]:
        # R r = rhs by back substitution; the entries of r for empty slots are 0
        r = list(rhs)
        for j in reversed(range(len(r))):
            for k in range(j + 1, len(r)):
                r[j] = r[j] - self.R[j][k] * r[k]
        return r


@dataclass(frozen=True)
class _Entering:
    """The violated row that enters the active set, with the sign that makes its violated bound an upper bound."""

    number: ca.SX  # signed row number
    normal: ca.SX
    missed: ca.SX  # violation

    @staticmethod
    def of(space: Space, row: ca.SX, number: ca.SX, point: ca.SX) -> _Entering:
        above, below = misses(space, row, point)
        at_lower = number < 0
        normal = ca.if_else(at_lower, -row[: space.d], row[: space.d])
        return _Entering(number, normal, ca.if_else(at_lower, below, above))


@dataclass(frozen=True)
class _Place:
    """Relation of the normal of the entering row to the normals of the active rows."""

    outside: ca.SX  # whether the normal of the entering row is sufficiently outside the span of the active normals
    whole: ca.SX  # if outside: step of the multiplier that satisfies the entering row
    full: ca.SX  # if outside: displacement (d,) of y that satisfies the entering row
    rate: ca.SX  # displacement (d,) of y for a unit step of the multiplier
    r: list[ca.SX]  # decrease of the active multipliers for a unit step
    ratios: list[ca.SX]  # multipliers divided by r

    @staticmethod
    def of(slots: _Slots, entering: _Entering, precision: Precision) -> _Place:
        if len(slots.normals) == 2:
            at = _planar(slots.normals, slots.numbers, slots.multipliers, entering.normal)
            outside = at.apart * at.apart > precision.parallel * at.first
            missed = entering.missed
            return _Place(outside, missed * at.whole, missed * at.full, at.rate, at.r, at.ratios)
        triangle = _Triangle.of(slots)
        rest, inside = triangle.split(entering.normal)
        r, square = triangle.solve(inside), dot(rest, rest)
        outside = square > precision.parallel
        whole = entering.missed / ca.if_else(outside, square, 1)
        ratios = [u / ca.if_else(ca.eq(rate, 0), 1, rate) for u, rate in zip(slots.multipliers, r, strict=True)]
        return _Place(outside, whole, whole * rest, rest, r, ratios)


@dataclass(frozen=True)
class _Step:
    length: ca.SX
    displacement: ca.SX
    full: ca.SX
    drop: list[ca.SX]
    status: ca.SX

    @staticmethod
    def of(slots: _Slots, entering: _Entering, place: _Place, size: ca.SX, precision: Precision) -> _Step:
        never = precision.never
        # a full step needs an empty slot: rounding can suggest an extra independent direction that does not exist
        free = ca.logic_and(place.outside, ca.eq(slots.numbers[-1], 0))
        whole = ca.if_else(free, place.whole, never)
        part, first = ca.SX(never), ca.SX(-1)
        for j, (number, r, ratio) in enumerate(zip(slots.numbers, place.r, place.ratios, strict=True)):
            sooner = ca.logic_and(ca.logic_and(number != 0, r > precision.pushing), ratio < part)
            part, first = ca.if_else(sooner, ratio, part), ca.if_else(sooner, j, first)
        goes = ca.logic_not(ca.logic_and(ca.logic_not(free), entering.missed <= precision.rounding * size))
        full = ca.logic_and(free, whole <= part)
        partial = ca.logic_and(ca.logic_and(goes, ca.logic_not(full)), part < never)
        stuck = ca.logic_and(goes, ca.logic_not(ca.logic_or(full, partial)))
        length = ca.if_else(full, whole, ca.if_else(partial, part, 0))
        return _Step(
            length=length,
            displacement=ca.if_else(full, place.full, ca.if_else(ca.logic_and(free, partial), part * place.rate, 0)),
            full=full,
            drop=[ca.logic_and(partial, ca.eq(first, j)) for j in range(len(place.r))],
            status=ca.if_else(goes, ca.if_else(stuck, STUCK, 0), OPTIMAL),
        )


@cache
def iteration(space: Space) -> Program:
    """Return the program for one iteration, which updates the first seven of its inputs.

    The inputs are point, normals, multipliers, numbers, pending, status, count, number and row.

    normals: (d·d,), normals of the active rows, one after another. multipliers: (d,), their Lagrange multipliers.
    numbers: (d,), their signed row numbers, 0 for an unused entry. pending: (2,), signed number (0: none) and
    multiplier of the row that is about to become active. status: status of the search. count: number of iterations.
    number: signed number of the row to process. row: the entries of this row.
    """
    d = space.d
    point, normals, u = ca.SX.sym("point", d), ca.SX.sym("normals", d * d), ca.SX.sym("multipliers", d)
    numbers, pending, status = ca.SX.sym("numbers", d), ca.SX.sym("pending", 2), ca.SX.sym("status")
    count, number, row = ca.SX.sym("count"), ca.SX.sym("number"), ca.SX.sym("row", space.row)

    slots = _Slots([normals[d * j : d * (j + 1)] for j in range(d)], ca.vertsplit(u), ca.vertsplit(numbers))
    entering = _Entering.of(space, row, number, point)
    inputs = [point, normals, u, numbers, pending, status, count, number, row]
    place = _Place.of(slots, entering, space.precision)
    step = _Step.of(slots, entering, place, _size(point), space.precision)
    r = place.r
    multiplier = pending[1] + step.length
    after = _exchange(slots, step, r, entering, multiplier)
    stays = ca.logic_and(ca.eq(step.status, 0), ca.logic_not(step.full))
    outputs = [
        point - step.displacement,
        ca.vertcat(*after.normals),
        ca.vertcat(*after.multipliers),
        ca.vertcat(*after.numbers),
        ca.vertcat(ca.if_else(stays, entering.number, 0), ca.if_else(stays, multiplier, 0)),
        step.status,
        count + 1,
    ]
    return lower(ca.Function(f"iterate_{d}", inputs, outputs), reciprocals=True)


def _exchange(slots: _Slots, step: _Step, r: list[ca.SX], entering: _Entering, multiplier: ca.SX) -> _Slots:
    """Return the list of active rows after the step: a dropped row is removed, and the entering row is appended."""
    columns: tuple[list[ca.SX], ...] = ([], [], [])
    left = [ca.fmax(u - step.length * ratio, 0) for u, ratio in zip(slots.multipliers, r, strict=True)]
    new = (entering.normal, multiplier, entering.number)
    moves, used_before = ca.SX(0), ca.SX(1)
    for j, drop in enumerate(step.drop):
        moves = ca.logic_or(moves, drop)
        used = slots.numbers[j] != 0
        takes = ca.logic_and(step.full, ca.logic_and(used_before, ca.logic_not(used)))
        used_before = used
        for column, every, own in zip(columns, (slots.normals, left, slots.numbers), new, strict=True):
            behind = every[j + 1] if j + 1 < len(every) else 0
            column.append(ca.if_else(takes, own, ca.if_else(moves, behind, every[j])))
    return _Slots(*columns)
