"""Damped levels of the priority kernel: each minimises ‖J v − x‖² + w² ‖v‖², with the rates J v of those above kept.

With weight w > 0, a level has one optimum, so what is passed on to the levels below is not the set of its optima but
its rates: `keep` makes them the right side of its rows, which the elimination then meets exactly, and no limit is
locked. The factors of the rows do not change by that, nor does W. Behind the reflections from the right, the columns of
a level are those of its rank; in all others, the optimum is 0.
"""

from __future__ import annotations

from surctl.ir.procedure import fabs, sqrt, within
from surctl.priority.hierarchy.factors import Memory, eliminate_left, multipliers
from surctl.priority.hierarchy.judgement import at_v, bound_loss, remember


def damp(s: Memory, level: int) -> None:
    """Begin a level: keep the rates of the last one, and set w² = c ‖x‖ + 1e-6."""
    if s.last > 2:
        keep(s, s.last - 1)
    square = 0.0
    for row in within(s.first[level], s.first[level + 1], s.b):
        if s.on[row] != 0:
            square += s.rhs[row] * s.rhs[row]
    s.ridge[level] = s.damping[0] * sqrt(square) + 1e-6
    s.last = level + 1


def keep(s: Memory, level: int) -> None:
    """Make the rates at v the right side of the rows; a set-based row may still move into its interval."""
    for row in within(s.first[level], s.first[level + 1], s.b):
        s.lock_set[row] = 0
        if s.on[row] != 0:
            value = at_v(s, row)
            s.rhs[row] = value
            if s.on[row] < 0 and value < s.low[row]:
                s.low[row] = value
            if s.on[row] > 0 and value > s.high[row]:
                s.high[row] = value
    if s.rank[level] > 0 and s.many[level] > s.rank[level]:
        s.left[level] = 1
        eliminate_left(s, level, s.rank[level])


def confirm(s: Memory, level: int) -> None:
    """Note whether v is shown to be optimal for a level, and report the limits that are active there."""
    s.size = 1.0
    for j in within(0, s.n, s.n):
        s.size = fabs(s.v[j]) if fabs(s.v[j]) > s.size else s.size
    radius = 2.0 * (1.0 + s.size)
    for i in range(s.m):
        s.gap[i] = radius
    square = 0.0
    for a in within(0, level + 1, s.p):
        s.spread[a] = 0.0 if a > 1 else 2e-10 * s.size
        for row in within(s.first[a], s.first[a + 1], s.b):
            s.gap_set[row] = radius * s.scale[a]
            if s.on[row] != 0:
                s.rest[row] = s.rhs[row] - at_v(s, row)
                if a == level:
                    square += s.rest[row] * s.rest[row]
                elif a > 1 and not fabs(s.rest[row]) <= 1e-6 * s.scale[a]:
                    s.sure = 0
    for j in within(0, s.N, s.x):
        square += s.ridge[level] * s.v[j] * s.v[j]
    value = sqrt(square)
    unit = s.scale[level] if s.scale[level] > 1.0 else 1.0
    if not value > 1e-12 * s.size * unit:
        return
    multipliers(s, level)
    loss = bound_loss(s, level, radius)
    if value > 1e-7 * unit and not 2.0 * loss <= 1e-7 * value * (unit + value):
        s.sure = 0
    floor = 1e-11 * value * unit
    for i in within(0, s.w, s.x):
        sign = s.lam[i] * s.side[i]
        if sign > floor:
            if level == 2:
                s.limited = 1
            s.place = remember(s, (s.W[i] + 1) * s.side[i], sign, s.place)
    number = s.m
    for a in within(2, level, s.p):
        if s.is_set[a] != 0:
            number += 1
            row = s.first[a]
            if s.on[row] != 0 and s.mu[row] * s.on[row] > floor:
                s.place = remember(s, number * s.on[row], s.mu[row], s.place)
