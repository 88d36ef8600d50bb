"""Factors of the priority kernel: the table T behind the active limits W, and the levels eliminated behind W."""

from __future__ import annotations

from surctl.ir.procedure import anew, back, fabs, once, sqrt, within
from surctl.priority.hierarchy.memory import Memory


def reflection(s: Memory, head: float, square: float) -> float:
    """Return the first entry of a vector after the reflection to its first axis; set `factor` and `head` of the normal.

    head: the first entry of the vector. square: the square of its length.
    """
    if not square > 0.0:
        s.factor = 0.0
        s.head = head
        return 0.0
    length = sqrt(square)
    to = -length if head > 0.0 else length
    s.head = head - to
    s.factor = 1.0 / (length * fabs(s.head))
    return to


def reflect_table(s: Memory, lo: int, hi: int) -> None:
    """Apply the reflection h to the columns lo … hi of T."""
    assert hi - lo <= s.n + 2
    for row in range(s.r):
        total = 0.0
        for j in within(lo, hi, s.x):
            total += s.T[j * s.r + row] * s.h[j]
        total = total * s.factor
        for j in within(lo, hi, s.x):
            e = s.h[j]
            s.T[j * s.r + row] -= total * e


def reflect_levels(s: Memory, number: int, lo: int, hi: int, begin: int, end: int) -> None:
    """Apply reflection `number` to the columns lo … hi and rows begin … end of B."""
    assert hi - lo <= s.n + 2 and end <= s.first[s.p] and begin >= 0
    for row in within(begin, end, s.k):
        total = 0.0
        for j in within(lo, hi, s.x):
            total += s.B[j * s.k + row] * s.V[number * s.x + j]
        total = total * s.tau[number]
        for j in within(lo, hi, s.x):
            e = s.V[number * s.x + j]
            s.B[j * s.k + row] -= total * e


def along(s: Memory, j: int) -> float:
    """Return d·q for column j of Q; d and q are padded with zeros."""
    for i in range(4):
        total = 0.0
        for q in range(s.quarter):
            total += s.d[4 * q + i] * s.T[j * s.r + s.k + 4 * q + i]
        s.sums[i] = total
    return (s.sums[0] + s.sums[1]) + (s.sums[2] + s.sums[3])


def enter(s: Memory, i: int, side: int) -> int:
    """Take limit i at its upper (1) or lower (−1) bound into W; return 0 if it depends on W."""
    assert s.w in range(s.n + 3)
    assert s.n + 2 >= s.N
    assert s.damped == 0 or s.last == 0 or s.N - s.w <= s.n
    if s.w >= s.N:
        return 0
    for j in range(s.n):
        s.d[j] = s.At[j * s.m + i]
    for j in within(s.n, s.x, s.x):
        s.d[j] = 0.0
    if s.column[i] >= 0:
        s.d[s.column[i]] = -1.0 * side
    for j in within(0, s.N, s.x):
        s.h[j] = along(s, j)
    for j in within(0, s.w, s.x):
        s.L[s.w * s.x + j] = s.h[j]
    square = 0.0
    for j in within(s.w, s.N, s.x):
        square += s.h[j] * s.h[j]
    to = reflection(s, s.h[s.w], square)
    if not fabs(to) >= 1e-12:
        return 0
    s.L[s.w * s.x + s.w] = to
    s.h[s.w] = s.head
    reflect_table(s, s.w, s.N)
    s.valid = s.skip if s.damped != 0 else 0
    s.W[s.w] = i
    s.side[s.w] = side
    s.inside[i] = side
    s.w += 1
    return 1


def leave(s: Memory, place: int) -> None:
    """Drop entry `place` of W; rotations make L triangular again."""
    assert s.w in range(s.n + 3)
    assert place >= 0
    s.valid = s.skip if s.damped != 0 else 0
    s.inside[s.W[place]] = 0
    for i in within(place + 1, s.w, s.x):
        for j in within(0, i + 1, s.x):
            s.L[(i - 1) * s.x + j] = s.L[i * s.x + j]
        s.W[i - 1] = s.W[i]
        s.side[i - 1] = s.side[i]
    s.w -= 1
    assert s.w - place <= s.n + 1
    for i in within(place, s.w, s.x):
        assert s.w - (i + 1) <= s.n
        a = s.L[i * s.x + i]
        b = s.L[i * s.x + i + 1]
        length = sqrt(a * a + b * b)
        if length > 0.0:
            cosine = a / length
            sine = b / length
            s.L[i * s.x + i] = length
            for j in within(i + 1, s.w, s.x):
                a = s.L[j * s.x + i]
                b = s.L[j * s.x + i + 1]
                s.L[j * s.x + i] = cosine * a + sine * b
                s.L[j * s.x + i + 1] = cosine * b - sine * a
            for q in range(s.r):
                one = s.T[i * s.r + q]
                other = s.T[(i + 1) * s.r + q]
                s.T[i * s.r + q] = cosine * one + sine * other
                s.T[(i + 1) * s.r + q] = cosine * other - sine * one


def eliminate_left(s: Memory, level: int, cols: int) -> float:
    """QR from the left of the level's rows in `cols` columns; return the smallest |diagonal| entry."""
    base = s.first[level]
    cnt = s.many[level]
    assert cnt <= s.first[level + 1] - base and cols <= s.first[level + 1] - base and cols <= s.n + 2
    least = 1e30
    for i in within(0, cnt, s.b):
        row = s.pivot[base + i]
        s.side_d[i] = s.rest[row]
        for j in within(0, cols, s.x):
            s.QR[(base + i) * s.x + j] = s.B[(s.start[level] + j) * s.k + row]
    for j in within(0, cols, s.x):
        square = 0.0
        for i in within(j, cnt, s.b):
            e = s.QR[(base + i) * s.x + j]
            s.norms[i] = e
            square += e * e
        length = sqrt(square)
        head = s.norms[j]
        to = -length if head > 0.0 else length
        s.norms[j] = head - to
        s.QR[(base + j) * s.x + j] = head - to
        t = 1.0 / (length * fabs(head - to)) if length > 0.0 else 0.0
        s.diagonal[level * s.x + j] = to
        s.weight[level * s.x + j] = t
        if not length >= least:
            least = length
        total = 0.0
        for i in within(j, cnt, s.b):
            total += s.norms[i] * s.side_d[i]
        total = total * t
        for i in within(j, cnt, s.b):
            s.side_d[i] -= total * s.norms[i]
        for q in within(j + 1, cols, s.x):
            part = 0.0
            for i in within(j, cnt, s.b):
                part += s.norms[i] * s.QR[(base + i) * s.x + q]
            part = part * t
            for i in within(j, cnt, s.b):
                f = s.norms[i]
                s.QR[(base + i) * s.x + q] -= part * f
    return least


def solve_left(s: Memory, level: int, cols: int) -> None:
    """Solve the triangular system of the QR from the left."""
    base = s.first[level]
    assert cols <= s.first[level + 1] - base and cols <= s.n + 2
    at = s.w + s.start[level]
    for j in back(0, cols, s.x):
        e = s.side_d[j]
        for q in within(j + 1, cols, s.x):
            e -= s.QR[(base + j) * s.x + q] * s.y[at + q]
        to = s.diagonal[level * s.x + j]
        s.y[at + j] = e / to if fabs(to) > 0.0 else 0.0


def take_off(s: Memory, begin: int, end: int, low: int, high: int) -> None:
    """Subtract the columns low … high of B, times y, from the remainders of the rows begin … end."""
    assert high - low <= s.n + 2 and end <= s.first[s.p] and begin >= 0
    for row in within(begin, end, s.k):
        rest = s.rest[row]
        for j in within(low, high, s.x):
            rest -= s.B[j * s.k + row] * s.y[s.w + j]
        s.rest[row] = rest


def pivots(s: Memory, level: int, free: int, end: int) -> None:
    """Eliminate the rows of a level from the right, longest remaining row first."""
    base = s.first[level]
    cnt = s.many[level]
    assert cnt <= s.first[level + 1] - base and free - s.start[level] <= s.n + 2 and free <= s.n + 2
    for row in within(base, s.first[level + 1], s.b):
        total = 0.0
        for j in within(s.start[level], free, s.x):
            total += s.B[j * s.k + row] * s.B[j * s.k + row]
        s.sums[row] = total
    for i in within(0, cnt, s.b):
        s.norms[i] = s.sums[s.pivot[base + i]]
    cut = (1e-8 if s.damped != 0 else 1e-10) * s.scale[level]
    number = s.used[level]
    column = s.start[level]
    for done in within(0, cnt, s.b):
        if column >= free:
            break
        assert free - column <= s.n + 2 - done and free - (column + 1) <= s.n + 1 - done
        best = done
        for i in within(done + 1, cnt, s.b):
            if s.norms[i] > s.norms[best]:
                best = i
        row = s.pivot[base + best]
        square = 0.0
        for j in within(column, free, s.x):
            e = s.B[j * s.k + row]
            s.V[number * s.x + j] = e
            square += e * e
        if square < s.norms[best] * 1e-4 and square < 1e-6 * s.scale[level] * s.scale[level]:
            # cancellation: the lengths are computed anew
            for i in within(done, cnt, s.b):
                s.norms[i] = 0.0
                for j in within(column, free, s.x):
                    e = s.B[j * s.k + s.pivot[base + i]]
                    s.norms[i] += e * e
            best = done
            for i in within(done + 1, cnt, s.b):
                if s.norms[i] > s.norms[best]:
                    best = i
            row = s.pivot[base + best]
            square = s.norms[best]
            for j in within(column, free, s.x):
                s.V[number * s.x + j] = s.B[j * s.k + row]
        if not square > cut * cut:
            break
        once(column, free)
        s.pivot[base + best] = s.pivot[base + done]
        s.pivot[base + done] = row
        s.norms[best] = s.norms[done]
        to = reflection(s, s.V[number * s.x + column], square)
        s.V[number * s.x + column] = s.head
        s.tau[number] = s.factor
        reflect_levels(s, number, column, free, base, end)
        s.B[column * s.k + row] = to
        for j in within(column + 1, free, s.x):
            s.B[j * s.k + row] = 0.0
        for i in within(done + 1, cnt, s.b):
            e = s.B[column * s.k + s.pivot[base + i]]
            s.norms[i] -= e * e
        number += 1
        column += 1
    s.used[level + 1] = number
    s.rank[level] = column - s.start[level]


def solve_damped(s: Memory, level: int, cols: int) -> None:
    """Find the part of y of a damped level by a QR of its rows in `cols` columns, with w I below them."""
    base = s.first[level]
    cnt = s.many[level]
    at = s.w + s.start[level]
    assert cnt <= s.first[level + 1] - base and cols <= s.first[level + 1] - base and cols <= s.n + 2
    weight = sqrt(s.ridge[level])
    for i in within(0, cnt, s.b):
        row = s.pivot[base + i]
        s.side_d[i] = s.rest[row]
        for j in within(0, cols, s.x):
            s.R[i * s.x + j] = s.B[(s.start[level] + j) * s.k + row]
    for i in within(cnt, cnt + cols, s.x):
        s.side_d[i] = 0.0
        for j in within(0, cols, s.x):
            s.R[i * s.x + j] = 0.0
        s.R[i * s.x + i - cnt] = weight
    for j in within(0, cols, s.x):
        end = cnt + j + 1  # rows of w I below are still 0 in this column
        assert end - j <= s.first[level + 1] - base + 1
        square = 0.0
        for i in within(j, end, s.b + 1):
            e = s.R[i * s.x + j]
            s.norms[i] = e
            square += e * e
        length = sqrt(square)
        head = s.norms[j]
        to = -length if head > 0.0 else length
        s.norms[j] = head - to
        s.R[j * s.x + j] = to
        t = 1.0 / (length * fabs(head - to))
        total = 0.0
        for i in within(j, end, s.b + 1):
            total += s.norms[i] * s.side_d[i]
        total = total * t
        for i in within(j, end, s.b + 1):
            s.side_d[i] -= total * s.norms[i]
        for q in within(j + 1, cols, s.x):
            part = 0.0
            for i in within(j, end, s.b + 1):
                part += s.norms[i] * s.R[i * s.x + q]
            part = part * t
            for i in within(j, end, s.b + 1):
                f = s.norms[i]
                s.R[i * s.x + q] -= part * f
    for j in back(0, cols, s.x):
        e = s.side_d[j]
        for q in within(j + 1, cols, s.x):
            e -= s.R[j * s.x + q] * s.y[at + q]
        s.y[at + j] = e / s.R[j * s.x + j]


def solve_level(s: Memory, level: int, end: int) -> None:
    """Eliminate one level behind those above, and find its part of y."""
    base = s.first[level]
    assert s.n + 2 >= s.N
    free = s.N - s.w
    assert s.damped == 0 or s.last == 0 or free <= s.n
    cnt = 0
    for row in within(base, s.first[level + 1], s.b):
        if s.on[row] != 0:
            s.pivot[base + cnt] = row
            cnt += 1
    assert cnt == 0 or s.damped == 0 or level < 2 or s.is_set[level] != 0 or level + 1 == s.last
    s.many[level] = cnt
    s.left[level] = 0
    s.rank[level] = 0
    s.used[level + 1] = s.used[level]
    begin = s.start[level]
    s.start[level + 1] = begin
    if cnt == 0 or begin >= free:
        return
    if s.damped != 0 and level > 1 and level + 1 == s.last:
        pivots(s, level, free, end)
        assert s.rank[level] <= s.first[level + 1] - base and s.rank[level] <= free
        s.start[level + 1] = begin + s.rank[level]
        solve_damped(s, level, s.rank[level])
        take_off(s, base, end, begin, begin + s.rank[level])
        return
    if cnt >= free - begin:
        s.rank[level] = free - begin
        assert free - begin <= s.first[level + 1] - base
        if eliminate_left(s, level, free - begin) > 1e-6 * s.scale[level]:
            s.left[level] = 1
            s.start[level + 1] = free
            solve_left(s, level, free - begin)
            take_off(s, base, end, begin, free)
            return
    pivots(s, level, free, end)
    rank = s.rank[level]
    assert rank <= s.first[level + 1] - base and rank <= free
    s.start[level + 1] = begin + rank
    if rank == 0:
        return
    if cnt == rank:
        for i in within(0, rank, s.x):
            row = s.pivot[base + i]
            e = s.rest[row]
            for j in within(0, i, s.x):
                e -= s.B[(begin + j) * s.k + row] * s.y[s.w + begin + j]
            s.y[s.w + begin + i] = e / s.B[(begin + i) * s.k + row]
    else:
        s.left[level] = 1
        eliminate_left(s, level, rank)
        solve_left(s, level, rank)
    take_off(s, base, end, begin, begin + rank)


def optimum(s: Memory, top: int) -> None:
    """Write the optimum of the levels before `top` on W into `goal`; what none fixes keeps its value, or is short."""
    anew()
    levels = top if top < s.p else s.p
    end = s.first[levels]
    assert s.w in range(s.n + 3)
    assert s.n + 2 >= s.N
    free = s.N - s.w
    assert s.damped == 0 or s.last == 0 or free <= s.n
    known = s.valid if s.valid < levels else levels
    begin = s.first[s.valid]
    assert known >= 0 and begin >= 0 and s.used[s.valid] <= free
    # damped levels above are kept, and only from the first set-based one on, levels are eliminated anew
    assert s.damped == 0 or levels < 3 or s.last == levels
    assert (
        s.damped == 0 or levels < 3 or end - begin <= end - s.first[s.earliest if s.earliest < levels else levels - 1]
    )
    if s.valid == (s.skip if s.damped != 0 else 0):
        for i in within(s.f if s.damped != 0 else 0, s.w, s.x):
            e = s.up[s.W[i]] if s.side[i] > 0 else s.lo[s.W[i]]
            for j in within(0, i, s.x):
                e -= s.L[i * s.x + j] * s.y[j]
            s.y[i] = e / s.L[i * s.x + i]
    if end > begin:
        for row in within(begin, end, s.k):
            rest = s.rhs[row]
            for j in within(0, s.w, s.x):
                rest -= s.T[j * s.r + row] * s.y[j]
            s.rest[row] = rest
            for j in within(0, free, s.x):
                s.B[j * s.k + row] = s.T[(s.w + j) * s.r + row]
        for number in within(0, s.used[s.valid], s.x):
            once(number, free)
            reflect_levels(s, number, number, free, begin, end)
        take_off(s, begin, end, 0, s.start[s.valid])
    for level in within(known, levels, s.p):
        solve_level(s, level, end)
    if s.valid < levels:
        s.valid = levels
    rank = s.start[levels]
    number = s.used[levels]
    assert rank >= 0 and rank <= free and number <= free
    for j in within(0, rank, s.x):
        s.z[j] = s.y[s.w + j]
    for j in within(rank, free, s.x):
        s.z[j] = 0.0
    if top <= s.p and rank < free and (s.damped == 0 or top < 3):
        for j in range(s.x):
            s.d[j] = 0.0
        for j in within(0, s.N, s.x):
            s.d[j] = s.v[j]
        for j in within(0, free, s.x):
            s.g[j] = along(s, s.w + j)
        for i in within(0, number, s.x):
            e = 0.0
            for j in within(i, free, s.x):
                e += s.V[i * s.x + j] * s.g[j]
            e = e * s.tau[i]
            for j in within(i, free, s.x):
                s.g[j] -= e * s.V[i * s.x + j]
        for j in within(rank, free, s.x):
            s.z[j] = s.g[j]
    for i in back(0, number, s.x):
        e = 0.0
        for j in within(i, free, s.x):
            e += s.V[i * s.x + j] * s.z[j]
        e = e * s.tau[i]
        for j in within(i, free, s.x):
            s.z[j] -= e * s.V[i * s.x + j]
    for i in range(s.x):
        goal = 0.0
        for j in within(0, s.w, s.x):
            goal += s.T[j * s.r + s.k + i] * s.y[j]
        for j in within(0, free, s.x):
            goal += s.T[(s.w + j) * s.r + s.k + i] * s.z[j]
        s.goal[i] = goal


def multipliers(s: Memory, level: int) -> None:
    """Find lam of W and mu of the levels above for the objective of a level; number p is the length of v."""
    above = s.start[level]
    assert above <= s.n + 2 - s.w
    if level < s.p:
        for j in within(0, s.w, s.x):
            e = 0.0
            for row in within(s.first[level], s.first[level + 1], s.b):
                if s.on[row] != 0:
                    e += s.T[j * s.r + row] * s.rest[row]
            s.g[j] = e - s.ridge[level] * s.y[j] if s.damped != 0 else e
        for j in within(0, above, s.x):
            e = 0.0
            for row in within(s.first[level], s.first[level + 1], s.b):
                if s.on[row] != 0:
                    e += s.B[j * s.k + row] * s.rest[row]
            s.g[s.w + j] = e - s.ridge[level] * s.y[s.w + j] if s.damped != 0 else e
    else:
        for j in within(0, s.w + above, s.x):
            s.g[j] = -s.y[j]
    for a in back(0, level, s.p):
        base = s.first[a]
        cnt = s.many[a]
        rank = s.rank[a]
        at = s.w + s.start[a]
        for row in within(base, s.first[a + 1], s.b):
            s.mu[row] = 0.0
        if rank == 0:
            continue
        assert rank <= s.first[a + 1] - base and rank <= s.n + 2 - s.w
        assert cnt <= s.first[a + 1] - base and s.start[a] <= s.n + 2 - s.w
        if s.left[a] == 0:
            for i in back(0, rank, s.x):
                e = s.g[at + i]
                for q in within(i + 1, rank, s.x):
                    e -= s.B[(s.start[a] + i) * s.k + s.pivot[base + q]] * s.mu[s.pivot[base + q]]
                s.mu[s.pivot[base + i]] = e / s.B[(s.start[a] + i) * s.k + s.pivot[base + i]]
        else:
            for j in within(0, rank, s.x):
                e = s.g[at + j]
                for q in within(0, j, s.x):
                    e -= s.QR[(base + q) * s.x + j] * s.side_d[q]
                to = s.diagonal[a * s.x + j]
                s.side_d[j] = e / to if fabs(to) > 0.0 else 0.0
            for i in within(rank, cnt, s.b):
                s.side_d[i] = 0.0
            for j in back(0, rank, s.x):
                e = 0.0
                for i in within(j, cnt, s.b):
                    e += s.QR[(base + i) * s.x + j] * s.side_d[i]
                e = e * s.weight[a * s.x + j]
                for i in within(j, cnt, s.b):
                    s.side_d[i] -= e * s.QR[(base + i) * s.x + j]
            for i in within(0, cnt, s.b):
                s.mu[s.pivot[base + i]] = s.side_d[i]
        for j in within(0, s.w, s.x):
            e = 0.0
            for i in within(0, cnt, s.b):
                e += s.T[j * s.r + s.pivot[base + i]] * s.mu[s.pivot[base + i]]
            s.g[j] -= e
        for j in within(0, s.start[a], s.x):
            e = 0.0
            for i in within(0, cnt, s.b):
                e += s.B[j * s.k + s.pivot[base + i]] * s.mu[s.pivot[base + i]]
            s.g[s.w + j] -= e
    for c in back(s.f if s.damped != 0 else 0, s.w, s.x):
        e = s.g[c]
        for i in within(c + 1, s.w, s.x):
            e -= s.L[i * s.x + c] * s.lam[i]
        s.lam[c] = e / s.L[c * s.x + c]
