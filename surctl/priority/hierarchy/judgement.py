"""The test of the priority kernel that v is optimal for every level.

`judge` shows it after the search. Let g be the negative gradient of half the squared objective of a
level, λ and μ the multipliers of the active limits and of the levels above, and d = g − Σ λ a − Σ Jᵀ μ what they leave.
For every v + Δ that satisfies the limits, keeps J v of the levels above, and is at most D away, g·Δ ≤ |d| D + Σ λ gap.
So half the squared objective is at most this much above its minimum, because it is convex. A limit with a multiplier λ'
> 0 at a level above, whose own bound is e, has a gap of at most e/λ' at every optimum of that level, so a wrong sign of
its λ costs at most |λ| e/λ'. The bound includes what rounding may change.

A limit whose multiplier lies between 1e-11 and 3e-10 of the residual stops the levels below, or does not, depending on
whether a singular value near 1e-10·‖J‖ counts as 0. Then nothing is shown for the levels below.
"""

from __future__ import annotations

from surctl.ir.procedure import fabs, sqrt, within
from surctl.priority.hierarchy.factors import along, multipliers
from surctl.priority.hierarchy.memory import Memory


def at_goal(s: Memory, row: int) -> float:
    """Return J·goal of a row."""
    e = 0.0
    for j in range(s.n):
        e += s.J[(row - 2) * s.n + j] * s.goal[j]
    return e


def at_v(s: Memory, row: int) -> float:
    """Return J·v of a row; of an opening, the opening."""
    if row < 2:
        place = s.hard if row == 0 else s.soft
        return s.v[place] if place >= 0 else 0.0
    e = 0.0
    for j in range(s.n):
        e += s.J[(row - 2) * s.n + j] * s.v[j]
    return e


def add_row(s: Memory, row: int, e: float) -> None:
    """Add e times a row of the levels' Jacobian, openings included, to d."""
    if row >= 2:
        for j in range(s.n):
            s.d[j] += s.J[(row - 2) * s.n + j] * e
    else:
        s.d[s.hard if row == 0 else s.soft] += e


def bound_loss(s: Memory, level: int, radius: float) -> float:
    """Return how much half the squared objective of a level may be above its least value, from lam and mu."""
    assert s.n + 2 >= s.N and s.w <= s.n + 2 and level <= s.p
    for j in range(s.x):
        s.d[j] = 0.0
    total = 0.0
    if level < s.p:
        for row in within(s.first[level], s.first[level + 1], s.b):
            if s.on[row] != 0:
                e = s.rest[row]
                total += fabs(e) * s.scale[level]
                add_row(s, row, e)
        if s.damped != 0:
            total += s.ridge[level] * s.size
            for j in within(0, s.N, s.x):
                s.d[j] -= s.ridge[level] * s.v[j]
    else:
        for j in within(0, s.N, s.x):
            s.d[j] = -s.v[j]
    loss = 0.0
    for a in within(0, level, s.p):
        for row in within(s.first[a], s.first[a + 1], s.b):
            e = s.mu[row]
            if s.on[row] == 0 or e == 0.0:
                continue
            total += fabs(e) * s.scale[a]
            add_row(s, row, -e)
            if s.is_set[a] != 0 and not fabs(s.rest[row]) > 1e-12 * s.size:
                sign = e * s.on[row]
                loss += sign * fabs(s.rest[row]) if sign > 0.0 else -sign * s.gap_set[row]
            else:
                loss += fabs(e) * s.spread[a]
    for i in within(s.f if s.damped != 0 else 0, s.w, s.x):
        e = s.lam[i]
        total += fabs(e)
        which = s.W[i]
        value = 0.0
        for j in range(s.n):
            s.d[j] -= s.At[j * s.m + which] * e
            value += s.At[j * s.m + which] * s.v[j]
        opened = 0.0
        if s.column[which] >= 0:
            s.d[s.column[which]] += e * s.side[i]
            opened = s.v[s.column[which]]
        sign = e * s.side[i]
        gap = s.up[which] + opened - value if s.side[i] > 0 else value - s.lo[which] + opened
        loss += (
            sign * fabs(gap)
            if sign > 0.0
            else -sign * (radius if s.damped != 0 and radius < s.gap[which] else s.gap[which])
        )
    if s.damped != 0:
        for j in within(0, s.f, s.x):
            e = along(s, j)
            for i in range(s.x):
                s.d[i] -= e * s.T[j * s.r + s.k + i]
    square = 0.0
    for j in within(0, s.N, s.x):
        square += s.d[j] * s.d[j]
    return loss + sqrt(square) * radius + 1e-15 * total * radius


def remember(s: Memory, number: int, weight: float, place: int) -> int:
    """Report an active limit once; return the next free place."""
    for i in within(0, place, s.n):
        if fabs(s.active[i]) == fabs(1.0 * number):
            return place
    if place < s.n:
        s.active[place] = 1.0 * number
        s.multipliers[place] = fabs(weight)
        return place + 1
    return place


def judge(s: Memory) -> int:
    """Report the active limits, and return 1 if v is shown to be optimal, with 2 added if a limit stops level 1."""
    place = 0
    good = 1
    limited = 0
    vague = 0
    assert s.n + 2 >= s.N and s.w <= s.n + 2
    s.size = 1.0
    for j in within(0, s.n, s.n):
        s.size = fabs(s.v[j]) if fabs(s.v[j]) > s.size else s.size
    radius = 2.0 * (1.0 + s.size)
    for i in range(s.m):
        total = 0.0
        for j in range(s.n):
            total += s.At[j * s.m + i] * s.v[j]
        s.value[i] = total
    for i in range(s.m):
        s.gap[i] = radius
        value = s.value[i]
        opened = s.v[s.column[i]] if s.column[i] >= 0 else 0.0
        if not value - s.up[i] - opened <= 1e-9 * (1.0 + s.size) or not s.lo[i] - opened - value <= 1e-9 * (
            1.0 + s.size
        ):
            good = 0
    if s.damped != 0:
        return good * s.sure + 2 * s.limited
    for row in within(0, s.first[s.p], s.k):
        s.gap_set[row] = radius * s.scale[s.level_of[row]]
        if s.on[row] != 0:
            s.rest[row] = s.rhs[row] - at_v(s, row)
        elif s.is_set[s.level_of[row]] != 0:  # if the iterations did not suffice, v may leave an interval unseen
            value = at_v(s, row)
            above = value - s.upper[row - 2]
            below = s.lower[row - 2] - value
            unit = s.scale[s.level_of[row]] if s.scale[s.level_of[row]] > 1.0 else 1.0
            if not above <= 1e-7 * unit or not below <= 1e-7 * unit:
                good = 0
    for level in within(0, s.p + 1, s.p + 1):
        square = 0.0
        if level < s.p:
            for row in within(s.first[level], s.first[level + 1], s.b):
                if s.on[row] != 0:
                    square += s.rest[row] * s.rest[row]
        else:
            for j in within(0, s.N, s.x):
                square += s.v[j] * s.v[j]
        value = sqrt(square)
        unit = 1.0
        if level < s.p:
            s.spread[level] = 2.0 * value if not value > 1e-10 * s.size * s.scale[level] else 0.0
            unit = s.scale[level] if s.scale[level] > 1.0 else 1.0
        if not value > 1e-12 * s.size * unit:
            continue
        multipliers(s, level)
        loss = bound_loss(s, level, radius)
        floor = 1e-11 * value * unit
        if value > 1e-7 * unit and (vague != 0 or not 2.0 * loss <= 1e-7 * value * (unit + value)):
            good = 0
        for i in within(0, s.w, s.x):
            sign = s.lam[i] * s.side[i]
            if sign > floor:
                if sign < 3e-10 * value * unit:
                    vague = 1
                if level == 2:
                    limited = 1
                if level >= 2:
                    place = remember(s, (s.W[i] + 1) * s.side[i], sign, place)
                gap = loss / sign
                s.gap[s.W[i]] = gap if gap < s.gap[s.W[i]] else s.gap[s.W[i]]
        number = s.m
        for a in within(2, s.p, s.p):
            if s.is_set[a] != 0:
                number += 1
                row = s.first[a]
                if a < level and s.on[row] != 0 and s.mu[row] * s.on[row] > floor:
                    place = remember(s, number * s.on[row], s.mu[row], place)
                    gap = loss / (s.mu[row] * s.on[row])
                    s.gap_set[row] = gap if gap < s.gap_set[row] else s.gap_set[row]
    return good + 2 * limited
