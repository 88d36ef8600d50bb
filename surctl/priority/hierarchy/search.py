"""The search of the priority kernel, with one limit or one level at a time."""

from __future__ import annotations

from surctl.ir.procedure import fabs, seldom, sqrt, within
from surctl.priority.hierarchy.damping import confirm, damp
from surctl.priority.hierarchy.factors import enter, leave, multipliers, optimum
from surctl.priority.hierarchy.judgement import at_goal, at_v
from surctl.priority.hierarchy.memory import Memory


def prepare(s: Memory) -> None:
    """Copy the problem into the arrays, choose the unknowns and the first v."""
    s.bad = 0
    for j in range(s.x):
        s.v[j] = 0.0
    for j in range(s.n):
        e = 0.0
        e = s.box[j] if e < s.box[j] else e
        e = s.box[s.n + j] if e > s.box[s.n + j] else e
        s.v[j] = e
    far = 0.0
    wide = 0.0
    for i in range(s.m):
        square = 0.0
        for j in range(s.n):
            square += s.rows[i * (s.n + 3) + j] * s.rows[i * (s.n + 3) + j]
        length = sqrt(square)
        if not length <= 1e150:
            s.bad = 1
        inverse = 1.0 / length if length > 1e-16 else 0.0
        value = 0.0
        for j in range(s.n):
            e = s.rows[i * (s.n + 3) + j] * inverse
            s.At[j * s.m + i] = e
            value += e * s.v[j]
        inverse = inverse if length > 1e-16 else 1.0
        s.lo[i] = s.rows[i * (s.n + 3) + s.n] * inverse
        s.up[i] = s.rows[i * (s.n + 3) + s.n + 1] * inverse
        if not s.lo[i] <= 1e299 or not s.up[i] >= -1e299:
            s.bad = 1
        s.inside[i] = 0
        s.lock[i] = 0
        miss = value - s.up[i] if value - s.up[i] > s.lo[i] - value else s.lo[i] - value
        if s.rows[i * (s.n + 3) + s.n + 2] > 0.0:
            s.column[i] = 1
            wide = miss if miss > wide else wide
        else:
            s.column[i] = 0
            far = miss if miss > far else far
    s.N = s.n
    s.hard = -1
    s.soft = -1
    if far > 0.0:
        s.hard = s.N
        s.v[s.N] = far
        s.N += 1
    if wide > 0.0:
        s.soft = s.N
        s.v[s.N] = wide
        s.N += 1
    for i in range(s.m):
        s.column[i] = s.soft if s.column[i] == 1 else s.hard
    for q in range(s.x * s.r):
        s.T[q] = 0.0
    for j in range(s.x):
        s.T[j * s.r + s.k + j] = 1.0
    for j in range(s.n):
        for row in within(2, s.first[s.p], s.k):
            s.T[j * s.r + row] = s.J[(row - 2) * s.n + j]
    for row in range(s.k):
        s.on[row] = 0
        s.lock_set[row] = 0
        s.rhs[row] = 0.0
    if s.damped != 0:
        s.f = 0
        s.skip = 0
        s.last = 0
        s.sure = 1
        s.limited = 0
        s.place = 0
        for row in within(2, s.first[s.p], s.k):
            s.low[row] = s.lower[row - 2]
            s.high[row] = s.upper[row - 2]
        for i in range(s.m):
            s.gap[i] = 1e300
        for level in range(s.p):
            s.ridge[level] = 0.0
            s.spread[level] = 0.0
    if s.hard >= 0:
        s.T[s.hard * s.r] = 1.0
        s.on[0] = 1
    if s.soft >= 0:
        s.T[s.soft * s.r + 1] = 1.0
        s.on[1] = 1
    for level in range(s.p):
        s.scale[level] = 1.0
        largest = 0.0
        for row in within(s.first[level], s.first[level + 1], s.b):
            if row >= 2:
                square = 0.0
                for j in range(s.n):
                    square += s.J[(row - 2) * s.n + j] * s.J[(row - 2) * s.n + j]
                largest = square if square > largest else largest
                if s.is_set[level] == 0:
                    s.on[row] = 1
                    s.rhs[row] = s.lower[row - 2]
        if largest > 0.0:
            s.scale[level] = sqrt(largest)
    s.w = 0
    s.valid = s.skip if s.damped != 0 else 0
    s.start[0] = 0
    s.used[0] = 0
    s.moved = 0
    s.still = 0


def switch_set(s: Memory, level: int) -> int:
    """Choose which rows of a set-based level are at a bound; return 0 if v is inside all of them."""
    any_on = 0
    for row in within(s.first[level], s.first[level + 1], s.b):
        value = at_v(s, row)
        now = -1 if value < s.lower[row - 2] else 1 if value > s.upper[row - 2] else 0
        if now != 0:
            any_on = 1
            s.rhs[row] = s.lower[row - 2] if now < 0 else s.upper[row - 2]
        if now != 0 or s.on[row] != 0:
            s.valid = s.valid if s.valid < level else level
        s.on[row] = now
    return any_on


def at_once(s: Memory) -> int:
    """Try the optimum of all levels without active limits; return 1 if it satisfies all limits."""
    optimum(s, s.p + 1)
    size = 1.0
    for j in range(s.n):
        size = fabs(s.goal[j]) if fabs(s.goal[j]) > size else size
    for i in range(s.m):
        total = 0.0
        for j in range(s.n):
            total += s.At[j * s.m + i] * s.goal[j]
        s.value[i] = total
    over = 0
    for i in range(s.m):
        if not s.value[i] <= s.up[i] + 1e-13 * size or not s.value[i] >= s.lo[i] - 1e-13 * size:
            over = 1
    for level in within(2, s.p, s.p):
        if s.is_set[level] != 0:
            for row in within(s.first[level], s.first[level + 1], s.b):
                value = at_goal(s, row)
                if not value <= s.upper[row - 2] or not value >= s.lower[row - 2]:
                    over = 1
    if over == 0:
        for j in range(s.x):
            s.v[j] = s.goal[j]
    return 1 - over


def approach(s: Memory, i: int, side: int, rate: float, distance: float) -> None:
    """Note that v + step exceeds a bound of limit i, if it does; `rate` is the speed towards this bound."""
    distance = distance if distance > 0.0 else 0.0
    if distance + 1e-13 * s.size < rate * s.nearest:
        s.nearest = (distance + 1e-13 * s.size) / rate
    if distance < rate and (s.toward[i] == 0 or distance * s.speed[i] < s.slack[i] * rate):
        if s.toward[i] == 0:
            s.near[s.hits] = i
            s.hits += 1
        s.toward[i] = side
        s.slack[i] = distance
        s.speed[i] = rate


def ratio(s: Memory, limit: int) -> float:
    """Find the first limit between v and v + step, of nearly equal ones the one that is approached fastest."""
    assert s.n + 2 >= s.N and limit <= s.p
    s.block = -1
    s.block_set = 0
    square = 0.0
    for j in within(0, s.N, s.x):
        square += s.step[j] * s.step[j]
    tiny = 1e-10 * sqrt(square)
    tiny = tiny if tiny > 1e-13 * s.size else 1e-13 * s.size
    more = 1e-13 * s.size
    s.nearest = 1.0
    s.hits = 0
    for i in range(s.m):
        speed = 0.0
        value = 0.0
        for j in range(s.n):
            entry = s.At[j * s.m + i]
            speed += entry * s.step[j]
            value += entry * s.v[j]
        s.speed[i] = speed
        s.value[i] = value
        s.margin[0 * s.m + i] = s.up[i] - value  # a table of two rows
        s.margin[1 * s.m + i] = value - s.lo[i]
    for i in range(s.m):
        s.toward[i] = 0
        e = s.speed[i]
        if s.column[i] < 0:
            at = i if e > 0.0 else s.m + i  # an index, because processors cannot predict this branch
            if not s.margin[at] >= fabs(e) and s.inside[i] == 0 and fabs(e) > tiny:
                if e > 0.0 and s.up[i] < 1e299:
                    approach(s, i, 1, e, s.margin[at])
                if e < 0.0 and s.lo[i] > -1e299:
                    approach(s, i, -1, -e, s.margin[at])
        elif s.inside[i] == 0:
            opened = s.v[s.column[i]]
            opening = s.step[s.column[i]]
            if e - opening > tiny and s.up[i] < 1e299:
                approach(s, i, 1, e - opening, s.up[i] + opened - s.value[i])
            if -e - opening > tiny and s.lo[i] > -1e299:
                approach(s, i, -1, -e - opening, s.value[i] - s.lo[i] + opened)
    for level in within(2, limit, s.p):
        if s.is_set[level] == 0:
            continue
        for row in within(s.first[level], s.first[level + 1], s.b):
            s.toward_set[row] = 0
            if s.on[row] != 0:
                continue
            now = at_v(s, row)
            change = 0.0
            for j in range(s.n):
                change += s.J[(row - 2) * s.n + j] * s.step[j]
            distance = 0.0
            if change > tiny:
                s.toward_set[row] = 1
                distance = (s.high[row] if s.damped != 0 else s.upper[row - 2]) - now
            elif change < -tiny:
                s.toward_set[row] = -1
                distance = now - (s.low[row] if s.damped != 0 else s.lower[row - 2])
                change = -change
            else:
                continue
            distance = distance if distance > 0.0 else 0.0
            s.slack_set[row] = distance
            s.speed_set[row] = change
            if distance + more < change * s.nearest:
                s.nearest = (distance + more) / change
    if not s.nearest < 1.0:
        return 1.0
    fastest = 0.0
    share = 1.0
    for k in within(0, s.hits, s.m):
        i = s.near[k]
        if s.speed[i] > fastest and s.slack[i] <= s.nearest * s.speed[i]:
            fastest = s.speed[i]
            share = s.slack[i] / s.speed[i]
            s.block = i
            s.block_side = s.toward[i]
    for level in within(2, limit, s.p):
        if s.is_set[level] == 0:
            continue
        for row in within(s.first[level], s.first[level + 1], s.b):
            if s.toward_set[row] == 0 or not s.speed_set[row] > fastest:
                continue
            if s.slack_set[row] <= s.nearest * s.speed_set[row] and s.slack_set[row] < s.speed_set[row]:
                fastest = s.speed_set[row]
                share = s.slack_set[row] / s.speed_set[row]
                s.block = row
                s.block_set = 1
                s.block_side = s.toward_set[row]
    return share


def move_limits(s: Memory) -> None:
    """After several steps of length 0, move all limits outwards by different amounts of 1e-10 to 2e-10."""
    s.still = 0
    if s.moved == 0:
        for i in range(s.m):
            s.lo_true[i] = s.lo[i]
            s.up_true[i] = s.up[i]
    if s.moved >= 6:
        return
    s.moved += 1
    part = 0.13 * s.moved
    for i in range(s.m):
        part = part + 0.6180339887498949
        part = part - 1.0 if part >= 1.0 else part
        s.lo[i] -= 1e-10 * s.size * (1.0 + part)
        s.up[i] += 1e-10 * s.size * (1.0 + part)
    s.valid = s.skip if s.damped != 0 else 0


def advance(s: Memory) -> int:
    """Go to the optimum on W, or to the first limit on the way; return 1 for a full step, −1 if W cannot grow."""
    optimum(s, s.top)
    levels = s.top if s.top < s.p else s.p
    longest = 0.0
    assert s.n + 2 >= s.N
    s.size = 1.0
    for j in within(0, s.N, s.x):
        s.step[j] = s.goal[j] - s.v[j]
        longest = fabs(s.step[j]) if fabs(s.step[j]) > longest else longest
        s.size = fabs(s.goal[j]) if fabs(s.goal[j]) > s.size else s.size
    s.block = -1
    share = 1.0
    if longest > (1e-11 if s.damped != 0 else 1e-15) * s.size and (s.damped == 0 or s.w < s.N):
        share = ratio(s, levels)
    if s.block < 0:
        for j in within(0, s.N, s.x):
            s.v[j] = s.goal[j]
        if longest > 1e-9 * s.size:
            s.still = 0
        return 1
    for j in within(0, s.N, s.x):
        s.v[j] += share * s.step[j]
    if share * longest > 1e-12 * s.size:
        s.still = 0
    else:
        s.still += 1
        if s.still > (s.n if s.damped != 0 else 5):
            move_limits(s)
    if s.block_set != 0:
        level = s.level_of[s.block]
        s.valid = s.valid if s.valid < level else level
        s.on[s.block] = s.block_side
        s.rhs[s.block] = (
            (s.high[s.block] if s.damped != 0 else s.upper[s.block - 2])
            if s.block_side > 0
            else (s.low[s.block] if s.damped != 0 else s.lower[s.block - 2])
        )
        return 0
    return 0 if enter(s, s.block, s.block_side) != 0 else -1


def unlocked(s: Memory, level: int) -> int:
    """Return whether an active limit, or an active row of a set-based level above, is not locked."""
    assert s.w <= s.n + 2 and level <= s.p
    for i in within(s.f if s.damped != 0 else 0, s.w, s.x):
        if s.lock[s.W[i]] == 0:
            return 1
    for a in within(2, level, s.p):
        if s.is_set[a] != 0:
            for row in within(s.first[a], s.first[a + 1], s.b):
                if s.on[row] != 0 and s.lock_set[row] == 0:
                    return 1
    return 0


def release(s: Memory) -> int:
    """Drop the limit with the worst multiplier and return 1; lock those with a positive one and return 0 if none."""
    level = s.top - 1
    assert s.n + 2 >= s.N and s.w <= s.n + 2 and level <= s.p
    worst = 0.0
    which = -1
    from_set = 0
    largest = 0.0
    if level < s.p:
        square = 0.0
        for row in within(s.first[level], s.first[level + 1], s.b):
            if s.on[row] != 0:
                square += s.rest[row] * s.rest[row]
        if s.damped != 0 and level > 1:
            for j in within(0, s.N, s.x):
                square += s.ridge[level] * s.v[j] * s.v[j]
        largest = sqrt(square)
        if s.is_set[level] != 0:
            for row in within(s.first[level], s.first[level + 1], s.b):
                if s.on[row] != 0:
                    e = -s.rest[row] * s.on[row]
                    if e < -1e-12 * s.size and e < worst:
                        worst = e
                        which = row
                        from_set = 1
                    else:
                        s.lock_set[row] = 1 if e > 1e-11 * s.size else 0
        unit = s.scale[level] if s.scale[level] > 1.0 else 1.0
        if which < 0 and (not largest > 1e-12 * s.size * unit or (s.w == 0 and level <= 2)):
            return 0
    else:
        assert s.w + s.start[s.p] <= s.n + 2
        for j in within(0, s.w + s.start[s.p], s.x):
            largest = fabs(s.y[j]) if fabs(s.y[j]) > largest else largest
        if not largest > 0.0:
            return 0
    if which < 0:
        if unlocked(s, level) == 0:
            return 0
        multipliers(s, level)
        unit = s.scale[level] if level < s.p else 1.0
        limit = 1e-11 * largest * unit
        if level < s.p and limit < 1e-14 * s.size * unit:
            limit = 1e-14 * s.size * unit
        for i in within(s.f if s.damped != 0 else 0, s.w, s.x):
            if s.lock[s.W[i]] == 0:
                e = s.lam[i] * s.side[i]
                if e < -limit and e < worst:
                    worst = e
                    which = i
        for a in within(2, level, s.p):
            if s.is_set[a] != 0:
                for row in within(s.first[a], s.first[a + 1], s.b):
                    if s.on[row] != 0 and s.lock_set[row] == 0:
                        e = s.mu[row] * s.on[row]
                        if e < -limit and e < worst:
                            worst = e
                            which = row
                            from_set = 1
        if s.damped != 0 and which < 0 and level > 1:
            return 0
        if which < 0:
            for i in within(s.f if s.damped != 0 else 0, s.w, s.x):
                if s.lam[i] * s.side[i] > limit:
                    s.lock[s.W[i]] = 1
            for a in within(2, level, s.p):
                if s.is_set[a] != 0:
                    for row in within(s.first[a], s.first[a + 1], s.b):
                        if s.on[row] != 0 and s.mu[row] * s.on[row] > limit:
                            s.lock_set[row] = 1
            return 0
    if from_set != 0:
        s.on[which] = 0
        a = s.level_of[which]
        s.valid = s.valid if s.valid < a else a
    else:
        assert which >= 0
        leave(s, which)
    return 1


def descend(s: Memory) -> int:
    """Take in the levels one after another; return 1 at the end, 0 if the iterations do not suffice."""
    s.top = 1
    fresh = 1
    for turn in range(s.cap):
        if s.budget != 0 and s.spent > s.budget:
            return 0
        s.turns = turn + 1
        if fresh != 0 and seldom(s.p + 1):
            fresh = 0
            for a in within(s.top - 1, s.p, s.p):
                if s.is_set[a] != 0:
                    if switch_set(s, a) != 0:
                        break
                elif s.on[s.first[a]] != 0:
                    break
                s.top += 1
            if s.damped != 0 and s.top > s.p:
                return 1
            assert s.top in range(1, s.p + 2)
            if s.damped != 0 and s.top > 2 and seldom(1, s.top):
                damp(s, s.top - 1)
        if s.budget != 0 and s.spent > s.budget:
            return 0
        assert s.top in range(1, s.p + 2)
        assert s.damped == 0 or s.last == (s.top if s.top > 2 else 0)
        assert s.w in range(s.n + 3)
        done = advance(s)
        if done < 0:
            return 0
        if done > 0 and release(s) == 0 and seldom(1, s.top):
            if s.damped != 0:
                confirm(s, s.top - 1)
            if s.top > s.p:
                return 1
            s.top += 1
            fresh = 1
    return 0


def restore(s: Memory) -> None:
    """Bring moved limits back, and compute v on the same W."""
    if s.moved == 0:
        return
    for i in range(s.m):
        s.lo[i] = s.lo_true[i]
        s.up[i] = s.up_true[i]
    s.valid = s.skip if s.damped != 0 else 0
    assert s.damped == 0 or s.last in range(s.p + 1)
    if s.reached != 0:
        optimum(s, s.last if s.damped != 0 else s.p + 1)
        for j in within(0, s.N, s.x):
            s.v[j] = s.goal[j]
