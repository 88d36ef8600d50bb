"""Damped levels of the priority kernel: each minimises ‖J v − x‖² + w² ‖v‖², with the rates J v of those above kept.

With weight w > 0, a level has one optimum, so what is passed on to the levels below is not the set of its optima but
its rates, and no limit is locked. `keep` puts the rows of the level before those of W: the first f columns of Q span
them, and v does not change along these columns any more. Singular values below 1e-8·‖J‖ count as 0. A limit of W that
depends on the rows leaves W; otherwise limits and rows together would fix more than there are velocities, and the
search would go round. A set-based level stays behind W, with the rate as its bound if it is outside (`keep_set`).
"""

from __future__ import annotations

from surctl.ir.procedure import anew, fabs, seldom, sqrt, within
from surctl.priority.hierarchy.factors import along, enter, leave, multipliers, pivots, reflect_table
from surctl.priority.hierarchy.judgement import at_v, bound_loss, remember
from surctl.priority.hierarchy.memory import Memory


def damp(s: Memory, level: int) -> None:
    """Begin a level: keep the openings, or the rates of the last level, and set w² = c ‖x‖ + 1e-6."""
    assert s.last in range(level + 1)
    assert s.last == 0 or s.last >= 3
    if s.last == 0 and seldom(1):
        for a in range(2):
            if s.on[a] != 0:
                if s.budget != 0 and s.spent > s.budget:
                    return
                keep(s, a)
    elif s.is_set[s.last - 1] != 0:
        keep_set(s, s.last - 1)
    else:
        keep(s, s.last - 1)
    s.skip = 0
    for a in within(0, level, s.p):
        if s.is_set[a] != 0 or s.on[s.first[a]] != 0:
            break
        s.skip = a + 1
        s.rank[a] = 0
        s.start[a + 1] = 0
        s.used[a + 1] = 0
    s.valid = s.skip
    square = 0.0
    for row in within(s.first[level], s.first[level + 1], s.b):
        if s.on[row] != 0:
            square += s.rhs[row] * s.rhs[row]
    s.ridge[level] = s.damping[0] * sqrt(square + 1e-18) + 1e-6  # smooth at rest
    s.last = level + 1


def keep_set(s: Memory, level: int) -> None:
    """Make the rates at v the bounds of set-based rows outside their interval; they may still move into it."""
    for row in within(s.first[level], s.first[level + 1], s.b):
        s.lock_set[row] = 0
        if s.on[row] != 0:
            value = at_v(s, row)
            s.rhs[row] = value
            if s.on[row] < 0 and value < s.low[row]:
                s.low[row] = value
            if s.on[row] > 0 and value > s.high[row]:
                s.high[row] = value


def keep(s: Memory, level: int) -> None:
    """Put the rows of a level before those of W, and drop limits from W that depend on them."""
    anew()
    begin = s.first[level]
    end = s.first[level + 1]
    old = s.w
    f = s.f
    free = s.N - f
    assert old - f <= s.n + 2 and end - begin <= s.b and free <= s.n + 2
    assert s.last == 0 or free <= s.n  # the columns of the openings are kept first
    assert s.last == 0 or old - f <= s.n
    for i in within(f, old, s.x):
        s.near[i - f] = (s.W[i] + 1) * s.side[i]
        s.inside[s.W[i]] = 0
    for row in within(begin, end, s.b):
        s.pivot[row] = row
        s.rhs[row] = at_v(s, row)
        s.on[row] = 0
        for j in within(0, free, s.x):
            s.B[j * s.k + row] = s.T[(f + j) * s.r + row]
    s.many[level] = end - begin
    s.start[level] = 0
    s.used[level] = 0
    pivots(s, level, free, end)
    assert s.rank[level] <= s.first[level + 1] - begin and s.rank[level] <= s.n + 2
    for number in within(0, s.rank[level], s.x):
        for j in within(number, free, s.x):
            s.h[f + j] = s.V[number * s.x + j]
        assert s.N - (f + number) <= s.n + 2 - number
        s.factor = s.tau[number]
        reflect_table(s, f + number, s.N)
    s.f += s.rank[level]
    s.w = s.f
    assert s.n + 2 >= s.N and s.f - f <= s.n + 2
    for j in range(s.x):
        s.d[j] = 0.0
    for j in within(0, s.N, s.x):
        s.d[j] = s.v[j]
    for j in within(f, s.f, s.x):
        s.y[j] = along(s, j)
    for i in within(0, old - f, s.x):
        side = 1 if s.near[i] > 0 else -1
        if enter(s, side * s.near[i] - 1, side) != 0 and not fabs(s.L[(s.w - 1) * s.x + s.w - 1]) > 1e-7:
            leave(s, s.w - 1)


def confirm(s: Memory, level: int) -> None:
    """Note whether v is shown to be optimal for a level, and report the limits that are active there."""
    s.size = 1.0
    assert s.w in range(s.n + 3)
    assert s.n + 2 >= s.N and level <= s.p
    for j in within(0, s.n, s.n):
        s.size = fabs(s.v[j]) if fabs(s.v[j]) > s.size else s.size
    radius = 2.0 * (1.0 + s.size)
    square = 0.0
    for a in within(0, level + 1, s.p):
        for row in within(s.first[a], s.first[a + 1], s.b):
            s.gap_set[row] = radius * s.scale[a]
            if s.on[row] != 0 or (a > 1 and s.is_set[a] == 0):
                s.rest[row] = s.rhs[row] - at_v(s, row)
                if a == level:
                    square += s.rest[row] * s.rest[row]
                elif a > 1 and not fabs(s.rest[row]) <= 1e-6 * s.scale[a]:
                    s.sure = 0
    for j in within(0, s.N, s.x):
        square += s.ridge[level] * s.v[j] * s.v[j]
    value = sqrt(square)
    unit = s.scale[level] if s.scale[level] > 1.0 else 1.0
    if level < 2 and not value > 1e-10 * s.size:
        s.spread[level] = 2.0 * value
    if not value > 1e-12 * s.size * unit:
        return
    multipliers(s, level)
    loss = bound_loss(s, level, radius)
    if value > 1e-7 * unit and not 2.0 * loss <= 1e-7 * value * (unit + value):
        s.sure = 0
    floor = 1e-11 * value * unit
    for i in within(s.f, s.w, s.x):
        sign = s.lam[i] * s.side[i]
        if sign > floor:
            if level == 2:
                s.limited = 1
            if level > 1:
                s.place = remember(s, (s.W[i] + 1) * s.side[i], sign, s.place)
            elif loss / sign < s.gap[s.W[i]]:
                s.gap[s.W[i]] = loss / sign
    number = s.m
    for a in within(2, level, s.p):
        if s.is_set[a] != 0:
            number += 1
            row = s.first[a]
            if s.on[row] != 0 and s.mu[row] * s.on[row] > floor:
                s.place = remember(s, number * s.on[row], s.mu[row], s.place)
