"""The closed loop for numba: `hand/loop.c` line by line, one run at a time, on preallocated arrays.

Names of members are positions in the scene, see `scene.scene_of`.
"""

from __future__ import annotations

from math import atan2, cos, floor, inf, isfinite, log, nan, pi, sin, sqrt
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scene import OWN_METRICS, Array, with_corners

from surctl.noise import noise_states

__all__ = ["fly_many"]

DT, SONAR, PROJECTED, TICKS, START, TARGET = 0, 1, 2, 3, 4, 6
DEPTH, CRUISE, CAP, REACH, LENGTH, WIDTH = 8, 9, 10, 11, 12, 13
POINTS, WAY, PLANT, LAG, HULL = 14, 15, 31, 47, 48
MODEL, MODEL_HULL, CURRENT, WAVE, COUNT, OBSTACLES = 49, 65, 66, 68, 70, 71
PER = 11  # columns of an obstacle: shape, x, y, half sizes or radius, drift, rate, to, speed, removed
K1, K2, LOOK, WAIT, K_PSI, K_V, K_R, K_I = 0, 1, 2, 3, 4, 5, 6, 7
MARGIN, REACTION, BRAKE, LAMBDA, LMS, BETA = 8, 9, 10, 14, 15, 16
M1, M2 = 4294967087, 4294944443
COS_HALF, SIN_HALF = 0.7933533402912352, 0.6087614290087205
FARTHEST, NEAREST = 4.5, 0.2
CONTACTS, MOST, SECTORS = 8, 16, 16

jit = njit(cache=True, error_model="numpy", fastmath={"contract"}, nogil=True)


@jit
def clip(v, low, high):
    return low if v < low else high if v > high else v


@jit
def length2(x, y):
    return sqrt(x * x + y * y)


@jit
def uniform(r):
    p = (1403580 * r[1] - 810728 * r[0]) % M1
    q = (527612 * r[5] - 1370589 * r[3]) % M2
    r[0], r[1], r[2] = r[1], r[2], p
    r[3], r[4], r[5] = r[4], r[5], q
    return (p - q if p > q else p + M1 - q) * 2.328306549295728e-10


@jit
def normals(r, out, count):
    for i in range(0, count, 2):
        radius = sqrt(-2 * log(uniform(r)))
        angle = 2 * pi * uniform(r)
        out[i], out[i + 1] = radius * cos(angle), radius * sin(angle)


@jit
def place(s, luck, time, shape):
    """Return rows of shape: disc, present, x, y, half sizes, velocity."""
    for k in range(int(s[COUNT])):
        o, row = OBSTACLES + PER * k, shape[k]
        row[0], row[1] = 0.0 if s[o] == 0 else 1.0, 1.0
        row[2], row[3], row[4], row[5] = s[o + 1], s[o + 2], s[o + 3], s[o + 4]
        row[6] = row[7] = 0.0
        if s[o] == 2:
            wx, wy = s[o + 7] - s[o + 1], s[o + 8] - s[o + 2]
            distance = length2(wx, wy)
            if s[o + 9] * time >= distance:
                row[2], row[3], row[1] = s[o + 7], s[o + 8], 1.0 - s[o + 10]
            else:
                row[6], row[7] = s[o + 9] * wx / distance, s[o + 9] * wy / distance
                row[2] += row[6] * time
                row[3] += row[7] * time
        elif s[o + 5] > 0:
            dx, dy = luck[3 + 3 * k], luck[4 + 3 * k]
            angle = s[o + 6] * time + luck[5 + 3 * k]
            far, speed = s[o + 5] * sin(angle), s[o + 5] * s[o + 6] * cos(angle)
            row[2] += far * dx
            row[3] += far * dy
            row[6], row[7] = speed * dx, speed * dy


@jit
def foot(o, x, y):
    dx, dy = x - o[2], y - o[3]
    if o[0] == 1:
        far = length2(dx, dy)
        ux, uy = (dx / far, dy / far) if far > 0 else (1.0, 0.0)
        return far - o[4], o[2] + o[4] * ux, o[3] + o[4] * uy
    qx, qy = clip(dx, -o[4], o[4]), clip(dy, -o[5], o[5])
    far = length2(dx - qx, dy - qy)
    if far == 0:
        ox, oy = abs(dx) - o[4], abs(dy) - o[5]
        far = max(ox, oy)
        if ox >= oy:
            qx = o[4] if dx >= 0 else -o[4]
        else:
            qy = o[5] if dy >= 0 else -o[5]
    return far, o[2] + qx, o[3] + qy


@jit
def slab(p, d, half):
    if d == 0:
        return (-inf, inf) if abs(p) <= half else (inf, -inf)
    a, b = (-half - p) / d, (half - p) / d
    return min(a, b), max(a, b)


@jit
def ray(o, x, y, ex, ey):
    dx, dy = o[2] - x, o[3] - y
    if o[0] == 1:
        along, across = dx * ex + dy * ey, dx * ey - dy * ex
        square = o[4] * o[4] - across * across
        return along - sqrt(square) if along > 0 and square >= 0 else inf
    nx, fx = slab(-dx, ex, o[4])
    ny, fy = slab(-dy, ey, o[5])
    near = max(nx, ny)
    return near if 0 <= near <= min(fx, fy) else inf


@jit
def turned(sensor, c, s):
    if sensor == 0:
        return c, s
    if sensor == 1:
        return -s, c
    if sensor == 2:
        return -c, -s
    return s, -c


@jit
def wall_of(s, x, y, k):
    """Return the distance to the wall and its direction."""
    if k == 0:
        return x, -1.0, 0.0
    if k == 1:
        return s[LENGTH] - x, 1.0, 0.0
    if k == 2:
        return y, 0.0, -1.0
    return s[WIDTH] - y, 0.0, 1.0


@jit
def fire(s, shapes, sensor, eta, noise, samples):
    found = inf
    ax, ay = turned(sensor, cos(eta[3]), sin(eta[3]))
    x, y = eta[0] + s[HULL] * ax, eta[1] + s[HULL] * ay
    lx, ly = ax * COS_HALF - ay * SIN_HALF, ay * COS_HALF + ax * SIN_HALF
    rx, ry = ax * COS_HALF + ay * SIN_HALF, ay * COS_HALF - ax * SIN_HALF
    for k in range(int(s[COUNT])):
        if shapes[k, 1] == 0:
            continue
        far, fx, fy = foot(shapes[k], x, y)
        if far >= found:
            continue
        if far <= 0:
            far = 0.0
        elif (fx - x) * ax + (fy - y) * ay < far * (COS_HALF - 1e-12):
            far = min(ray(shapes[k], x, y, lx, ly), ray(shapes[k], x, y, rx, ry))
        found = min(found, far)
    for k in range(4):
        far, nx, ny = wall_of(s, x, y, k)
        if far >= found:
            continue
        if far <= 0:
            far = 0.0
        elif nx * ax + ny * ay < COS_HALF - 1e-12:
            best = max(lx * nx + ly * ny, rx * nx + ry * ny)
            far = far / best if best > 0 else inf
        found = min(found, far)
    for k in range(5):
        if found > FARTHEST:
            samples[k] = FARTHEST
        else:
            heard = clip(found + 0.0011 + 0.015 * noise[k], NEAREST, FARTHEST)
            samples[k] = np.rint(heard * 255 / FARTHEST) * FARTHEST / 255


@jit
def push(window, n, value):
    for i in range(n - 1, 0, -1):
        window[i] = window[i - 1]
    window[0] = value


@jit
def range_of(f, sample, g):
    """Filter of one sensor: window, history 8, theta 12, before 16, errors 20, mean error 28, refused 29, echo, age."""
    value = (sample[0] + 2 * sample[1] + 3 * sample[2] + 4 * sample[3] + 5 * sample[4]) / 15
    mean = square = predicted = power = corrected = 0.0
    for i in range(8):
        mean += f[i] / 8
        square += f[i] * f[i] / 8
    spread = max(sqrt(max(square - mean * mean, 0.0)), FARTHEST / 255)
    accepted = abs(value - f[0]) < g[LAMBDA] * spread
    gated = value if accepted else mean
    push(f, 8, value)
    f[29] = 0.0 if accepted or not g[LAMBDA] > 0 else min(f[29] + 1, 3.0)
    if accepted and abs(gated - f[8]) > 0.3:
        for i in range(4):
            f[8 + i], f[12 + i], f[16 + i] = gated, 0.25, 0.25
    else:
        for i in range(4):
            predicted += f[12 + i] * f[8 + i]
            power += f[8 + i] * f[8 + i]
        residual = gated - predicted
        push(f[20:28], 8, abs(residual))
        for i in range(8):
            corrected += (8 - i) / 64.0 * f[20 + i]
        if corrected >= f[28]:
            step = clip(g[LMS], 0.0, 1.0) * residual / max(power, 1e-6)
            beta = clip(g[BETA], 0.0, 0.5) * min(1.0, corrected / max(f[28], 1e-9))
            for i in range(4):
                old = f[12 + i]
                f[12 + i] += step * f[8 + i] + beta * (old - f[16 + i])
                f[16 + i] = old
        else:
            for i in range(4):
                f[16 + i] = f[12 + i]
        f[28] += (corrected - f[28]) / 8
        push(f[8:12], 4, gated)
    predicted = 0.0
    for i in range(4):
        predicted += f[12 + i] * f[8 + i]
    return clip(min(f[8], predicted), NEAREST, FARTHEST)


@jit
def expected(s, ax, ay, x, y, known, count):
    found = 2 * FARTHEST
    for k in range(4):
        distance, nx, ny = wall_of(s, x, y, k)
        along, across = ax * nx + ay * ny, abs(ax * ny - ay * nx)
        edge = along * COS_HALF + across * SIN_HALF
        seen = distance if along >= COS_HALF else distance / edge if edge > 1e-9 else 2 * FARTHEST
        found = min(found, max(seen, 0.0))
    for k in range(count):
        tx, ty, radius = known[k, 0] - x, known[k, 1] - y, known[k, 2]
        far = length2(tx, ty)
        if far <= radius:
            return 0.0
        if far - radius >= found:
            continue
        seen = far - radius
        if tx * ax + ty * ay < far * COS_HALF:
            seen = 2 * FARTHEST
            for side in (-1, 1):
                rx, ry = ax * COS_HALF - side * ay * SIN_HALF, ay * COS_HALF + side * ax * SIN_HALF
                along, across = tx * rx + ty * ry, tx * ry - ty * rx
                square = radius * radius - across * across
                if along > 0 and square >= 0:
                    seen = min(seen, along - sqrt(square))
        found = min(found, seen)
    return found


@jit
def excess(vx, vy, sector, count):
    """Return rows of sector: normal, bound, point."""
    worst = -10.0
    for k in range(count):
        worst = max(worst, vx * sector[k, 0] + vy * sector[k, 1] - sector[k, 2])
    return worst


@jit
def worst_bound(vx, vy, sector, count, normal):
    """Return the largest violation of a bound (0 if none), and the normal of this bound."""
    over, normal[0], normal[1] = 0.0, 0.0, 0.0
    for k in range(count):
        excess = vx * sector[k, 0] + vy * sector[k, 1] - sector[k, 2]
        if excess > over:
            over, normal[0], normal[1] = excess, sector[k, 0], sector[k, 1]
    return over


@jit
def brake_beyond(vx, vy, sector, count, velocity):
    """Brake harder than the velocity loop, without sideways force, if the robot is faster than a bound."""
    n, other = np.zeros(2), np.zeros(2)
    over = worst_bound(vx, vy, sector, count, n)
    along = (velocity[0] - vx) * n[0] + (velocity[1] - vy) * n[1]
    sx, sy = vx + along * n[0], vy + along * n[1]
    beyond = worst_bound(sx, sy, sector, count, other)
    share = min(over / 0.02, 1.0)
    velocity[0] += share * (sx - beyond * other[0] - velocity[0]) - 4 * over * n[0]
    velocity[1] += share * (sy - beyond * other[1] - velocity[1]) - 4 * over * n[1]


@jit
def choose(s, wx, wy, sector, count, latch, out):
    wished = max(length2(wx, wy), 1e-3)
    ax, ay, retreat = wx / wished, wy / wished, 0.0
    for k in range(count):
        retreat = max(retreat, min(-sector[k, 2], s[CAP]))
    speed = min(wished, s[CRUISE]) if excess(wished * ax, wished * ay, sector, count) > 1e-3 else wished
    if retreat > 0:
        speed = max(speed, min(retreat + 0.05, s[CAP]))
    worst, bx, by = -10.0, sector[0, 3], sector[0, 4]
    for k in range(count):
        missed = speed * (ax * sector[k, 0] + ay * sector[k, 1]) - sector[k, 2]
        if missed > worst:
            worst, bx, by = missed, sector[k, 3], sector[k, 4]
    gx, gy = bx - latch[1], by - latch[2]
    latched = latch[0] if gx * gx + gy * gy <= 0.09 else 0.0
    taken, missed, cx, cy = 0.0, worst, ax, ay
    blocked = missed > 1e-3
    if blocked:
        cheapest = 10 + 100 * missed
        for sign in (1, -1):
            for k in range(count):
                if sector[k, 2] >= speed:
                    continue
                c = clip(sector[k, 2] / speed, -1.0, 1.0)
                sn = sign * sqrt(1 - c * c)
                ex, ey = sector[k, 0] * c - sector[k, 1] * sn, sector[k, 1] * c + sector[k, 0] * sn
                left = 1.0 if ax * ey - ay * ex >= 0 else -1.0
                cost = 1 - ex * ax - ey * ay + (0.0 if sign > 0 else 1e-4) + (8.0 if latched * left < -0.5 else 0.0)
                if cost >= cheapest:
                    continue
                over = excess(speed * ex, speed * ey, sector, count)
                if over > 1e-3:
                    cost += 10 + 100 * over
                if cost < cheapest:
                    cheapest, cx, cy, missed, taken = cost, ex, ey, over, left
    fast = speed
    for k in range(count):
        along = cx * sector[k, 0] + cy * sector[k, 1]
        if along > 1e-3:
            fast = min(fast, max(sector[k, 2], 0.0) / along)
    fast = max(fast, retreat)
    out[0], out[1] = fast * cx, fast * cy
    if missed > 1e-3 and excess(out[0], out[1], sector, count) > excess(0.0, 0.0, sector, count) + 1e-3:
        out[0] = out[1] = 0.0
    latch[0], latch[1], latch[2] = taken if blocked else 0.0, bx, by
    return blocked


@jit
def nearest(d, base, row, rows, x, q, t):
    """Goldfarb and Idnani's dual method: min |x - base|, a x <= b; a in row[:, :3], b in row[:, 3]."""
    active, u, r, z, n = [0, 0, 0], [0.0] * 4, [0.0] * 3, [0.0] * 3, 0
    for i in range(d):
        x[i] = base[i]
    for _ in range(100):
        p, worst = -1, 1e-12
        for k in range(rows):
            miss = -row[k, 3]
            for i in range(d):
                miss += row[k, i] * x[i]
            if miss > worst:
                worst, p = miss, k
        if p < 0:
            return True
        u[n] = 0.0
        for _ in range(100):
            zz, miss, limit, drop = 0.0, -row[p, 3], inf, -1
            for j in range(n):
                for i in range(d):
                    q[j, i] = row[active[j], i]
                for k in range(j):
                    t[k, j] = 0.0
                    for i in range(d):
                        t[k, j] += q[k, i] * q[j, i]
                    for i in range(d):
                        q[j, i] -= t[k, j] * q[k, i]
                t[j, j] = 0.0
                for i in range(d):
                    t[j, j] += q[j, i] * q[j, i]
                t[j, j] = sqrt(t[j, j])
                for i in range(d):
                    q[j, i] /= t[j, j]
            for i in range(d):
                z[i] = row[p, i]
            for j in range(n):
                r[j] = 0.0
                for i in range(d):
                    r[j] += q[j, i] * z[i]
                for i in range(d):
                    z[i] -= r[j] * q[j, i]
            for j in range(n - 1, -1, -1):
                for k in range(j + 1, n):
                    r[j] -= t[j, k] * r[k]
                r[j] /= t[j, j]
            for j in range(n):
                if r[j] > 1e-12 and u[j] / r[j] < limit:
                    limit, drop = u[j] / r[j], j
            for i in range(d):
                zz += z[i] * row[p, i]
                miss += row[p, i] * x[i]
            full = miss / zz if zz > 1e-14 and n < d else inf
            go = min(full, limit)
            if go == inf:
                return False
            if full < inf:
                for i in range(d):
                    x[i] -= go * z[i]
            for j in range(n):
                u[j] -= go * r[j]
            u[n] += go
            if full <= limit:
                active[n] = p
                n += 1
                break
            for j in range(drop, n - 1):
                active[j] = active[j + 1]
            for j in range(drop, n):
                u[j] = u[j + 1]
            n -= 1
    return False


@jit
def project(s, tu, tv, sector, count, c, sn, v, row, q, t, low, base, moved_to):
    cap, rows = s[CAP], 4
    met = abs(tu) <= cap and abs(tv) <= cap
    for k in range(4):
        row[k, 0] = 1.0 if k == 0 else -1.0 if k == 1 else 0.0
        row[k, 1] = 1.0 if k == 2 else -1.0 if k == 3 else 0.0
        row[k, 2], row[k, 3] = 0.0, cap
    for k in range(count):
        a, b = c * sector[k, 0] + sn * sector[k, 1], c * sector[k, 1] - sn * sector[k, 0]
        met = met and a * tu + b * tv <= sector[k, 2] + 1e-12
        row[rows, 0], row[rows, 1], row[rows, 2], row[rows, 3] = a, b, 0.0, sector[k, 2]
        rows += 1
    v[0], v[1] = tu, tv
    if met:
        return
    base[0], base[1] = tu, tv
    if nearest(2, base, row, rows, v, q, t):
        return
    low[0], low[1], low[2], pull = clip(tu, -cap, cap), clip(tv, -cap, cap), 0.0, 1.0
    for k in range(4, rows):
        row[k, 2] = -1.0
    for _ in range(20):
        base[0], base[1], base[2] = low[0], low[1], low[2] - pull
        if not nearest(3, base, row, rows, moved_to, q, t):
            break
        moved = 0.0
        for i in range(3):
            moved = max(moved, abs(moved_to[i] - low[i]))
            low[i] = moved_to[i]
        if moved <= 1e-12:
            break
        pull *= 10
    for k in range(4, rows):
        row[k, 2] = 0.0
        row[k, 3] += low[2] + 1e-10
    base[0], base[1] = tu, tv
    if not nearest(2, base, row, rows, v, q, t):
        v[0], v[1] = low[0], low[1]


@jit
def rate(s, x, wanted, fx, fy, dx):
    c, sn, lag = cos(x[3]), sin(x[3]), s[LAG]
    cx, cy = c * s[CURRENT] + sn * s[CURRENT + 1], c * s[CURRENT + 1] - sn * s[CURRENT]
    u, v, w, r = x[4], x[5], x[6], x[7]
    a, b = u - cx, v - cy
    m = PLANT
    for i in range(4):
        relative = a if i == 0 else b if i == 1 else x[4 + i]
        thrust = x[8 + i] if lag > 0 else wanted[i]
        dx[8 + i] = (wanted[i] - x[8 + i]) / max(lag, 1e-3) if lag > 0 else 0.0
        dx[4 + i] = thrust - (s[m + 4 + i] + s[m + 8 + i] * abs(relative)) * relative
    dx[4] += c * fx + sn * fy + s[m + 1] * b * r
    dx[5] += c * fy - sn * fx - s[m] * a * r
    dx[7] -= (s[m + 1] - s[m]) * a * b
    for i in range(4):
        dx[4 + i] /= s[m + i]
    dx[4] += r * cy
    dx[5] -= r * cx
    dx[0], dx[1], dx[2], dx[3] = c * u - sn * v, sn * u + c * v, w, r


@jit
def advance(s, x, tau, fx, fy, k, wanted):
    for i in range(4):
        wanted[i] = clip(tau[i], -s[PLANT + 12 + i], s[PLANT + 12 + i])
    for h in (0.010, 0.010, 0.005):
        rate(s, x, wanted, fx, fy, k[0])
        for i in range(12):
            k[4, i] = x[i] + h / 2 * k[0, i]
        rate(s, k[4], wanted, fx, fy, k[1])
        for i in range(12):
            k[4, i] = x[i] + h / 2 * k[1, i]
        rate(s, k[4], wanted, fx, fy, k[2])
        for i in range(12):
            k[4, i] = x[i] + h * k[2, i]
        rate(s, k[4], wanted, fx, fy, k[3])
        for i in range(12):
            x[i] += h / 6 * (k[0, i] + 2 * k[1, i] + 2 * k[2, i] + k[3, i])


@jit
def away_from_path(s, x, y):
    best = inf
    for k in range(int(s[POINTS]) - 1):
        ax, ay = s[WAY + 2 * k], s[WAY + 2 * k + 1]
        wx, wy = s[WAY + 2 * k + 2] - ax, s[WAY + 2 * k + 3] - ay
        t = clip(((x - ax) * wx + (y - ay) * wy) / (wx * wx + wy * wy), 0.0, 1.0)
        ex, ey = x - ax - t * wx, y - ay - t * wy
        best = min(best, ex * ex + ey * ey)
    return sqrt(best)


@jit
def wall_distance(s, x):
    return min(min(x[0], s[LENGTH] - x[0]), min(x[1], s[WIDTH] - x[1]))


@jit
def bound_of(free, at, brake, reaction):
    return sqrt(at * at + 2 * brake * free) - at if free >= 0 else free / reaction


@jit
def set_sector(row, eta, dx, dy, radius, hull):
    """Return the normal and the clearance of a contact."""
    distance = length2(dx, dy)
    row[0], row[1] = (dx / distance, dy / distance) if distance > 1e-6 else (1.0, 0.0)
    free = distance - radius - hull
    row[3], row[4] = eta[0] + (free + hull) * row[0], eta[1] + (free + hull) * row[1]
    return free


@jit
def fly(s, g, luck, random, out):
    sonar, count, points, moving, stopped = s[SONAR] > 0, int(s[COUNT]), int(s[POINTS]), 0, 0
    chord, tx, ty, path = np.zeros(8), np.zeros(8), np.zeros(8), 0.0
    for k in range(points - 1):
        wx, wy = s[WAY + 2 * k + 2] - s[WAY + 2 * k], s[WAY + 2 * k + 3] - s[WAY + 2 * k + 1]
        chord[k] = length2(wx, wy)
        tx[k], ty[k] = wx / chord[k], wy / chord[k]
        path += chord[k]
    m = MODEL
    brake = g[BRAKE] * min(s[m + 12], s[m + 13]) / max(s[m], s[m + 1])
    at, hull = brake * g[REACTION], s[MODEL_HULL]
    root = sqrt(s[m + 7] * s[m + 7] + 4 * s[m + 11] * 0.85 * s[m + 15])
    turn = 2 * 0.85 * s[m + 15] / max(s[m + 7] + root, 1e-6)
    for k in range(count):
        moving += s[OBSTACLES + PER * k] == 2

    x, eta, integral, tau, last, wanted, limited = (
        np.zeros(12), np.zeros(4), np.zeros(4), np.zeros(4), np.zeros(4), np.zeros(4), np.zeros(4),
    )  # fmt: skip
    samples, noise, known = np.zeros((4, 5)), np.zeros(14 + 4 * MOST), np.zeros((CONTACTS, 5))
    shape, sector, feet = np.zeros((MOST, 8)), np.zeros((SECTORS, 5)), np.zeros((MOST, 2))
    latch, velocity, k4 = np.zeros(3), np.zeros(2), np.zeros((5, 12))
    row, q, t3, low, base, moved_to = (
        np.zeros((4 + SECTORS, 4)), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3), np.zeros(3), np.zeros(3),
    )  # fmt: skip
    filters, fresh = np.zeros((4, 33)), np.zeros(4)
    for i in range(4):
        filters[i, :12], filters[i, 12:20], filters[i, 29], filters[i, 32] = FARTHEST, 0.25, 3.0, 0.55
    x[0], x[1], x[2] = s[START], s[START + 1], s[DEPTH]
    x[3] = atan2(s[WAY + 3] - s[START + 1], s[WAY + 2] - s[START])
    progress, clear, settling, kept, saturated, firing, tick = 0.0, False, False, 0, 0, 0, 0
    out[:] = 0.0
    nearest_thing, error, square, px, py, jerk = inf, 0.0, 0.0, 0.0, 0.0, 0.0
    last_tick = int(s[TICKS]) - 1

    for tick in range(int(s[TICKS])):
        time, clearance = tick * s[DT], inf
        place(s, luck, time, shape)
        if sonar:
            normals(random, noise, 14 + 4 * moving)
            fire(s, shape, firing, x, noise, samples[firing])
            fresh[firing] = 1.0
            firing = (firing + 1) % 4
        for k in range(count):
            if shape[k, 1] > 0:
                far, feet[k, 0], feet[k, 1] = foot(shape[k], x[0], x[1])
                clearance = min(clearance, far - s[HULL])
        wall = wall_distance(s, x) - s[HULL]
        clear = clear or wall > 0
        if clear:
            clearance = min(clearance, wall)
        nearest_thing = min(nearest_thing, clearance)

        told = order = 0
        for i in range(4):
            eta[i] = x[i]
        for k in range(count):
            is_moving = s[OBSTACLES + PER * k] == 2
            order += is_moving
            if shape[k, 1] == 0 or told == CONTACTS or (sonar and not is_moving):
                continue
            disc = shape[k, 0] == 1
            known[told, 0], known[told, 1] = (shape[k, 2], shape[k, 3]) if disc else (feet[k, 0], feet[k, 1])
            known[told, 2], known[told, 3], known[told, 4] = shape[k, 4] if disc else 0.0, shape[k, 6], shape[k, 7]
            if sonar:
                n = 14 + 4 * (order - 1)
                known[told, 0] += 0.01 * noise[n]
                known[told, 1] += 0.01 * noise[n + 1]
                known[told, 3] += 0.01 * noise[n + 2]
                known[told, 4] += 0.01 * noise[n + 3]
            told += 1
        if sonar:
            for i in range(4):
                eta[i] += 0.01 * noise[10 + i]
        c, sn = cos(eta[3]), sin(eta[3])

        travelled, k = 0.0, 0
        while k + 2 < points and progress >= travelled + chord[k]:
            travelled += chord[k]
            k += 1
        along = clip(progress - travelled, 0.0, chord[k])
        ox = eta[0] - s[WAY + 2 * k] - along * tx[k]
        oy = eta[1] - s[WAY + 2 * k + 1] - along * ty[k]
        x_e, y_e = ox * tx[k] + oy * ty[k], tx[k] * oy - ty[k] * ox
        if progress >= path:
            far = length2(ox, oy)
            fastest = min(s[CRUISE], sqrt(at * at + 2 * brake * far) - at)
            gain = min(g[K_V] / 3, fastest / max(far, 1e-3))
            wish_x, wish_y = -ox * gain, -oy * gain
        else:
            slant = sqrt(y_e * y_e + g[LOOK] * g[LOOK]) / g[LOOK]
            go = min(max(s[CRUISE] - g[K1] * x_e, 0.0), s[CAP] / slant)
            across = -go * y_e / g[LOOK]
            wish_x, wish_y = go * tx[k] - across * ty[k], go * ty[k] + across * tx[k]
        heading = atan2(ty[k], tx[k])
        progress = min(progress + s[DT] * s[CRUISE] * clip(2 * (1 + x_e / g[WAIT]), 0.0, 1.0), path)

        sectors = 0
        for i in range(told):
            sec = sector[sectors]
            sectors += 1
            free = set_sector(sec, eta, known[i, 0] - eta[0], known[i, 1] - eta[1], known[i, 2], hull)
            closing = known[i, 3] * sec[0] + known[i, 4] * sec[1]
            free -= g[MARGIN] + g[REACTION] * max(-closing, 0.0)
            sec[2] = closing + bound_of(free, at, brake, g[REACTION])
        if sonar:
            for i in range(4):
                f = filters[i]
                f[32] = min(f[32] + s[DT], 0.5 + s[DT])
                if fresh[i] > 0:
                    heard = range_of(f, samples[i], g)
                    ax, ay = turned(i, c, sn)
                    fresh[i] = 0.0
                    if f[29] < 3 and heard < FARTHEST - 0.1:
                        explained = expected(s, ax, ay, eta[0] + hull * ax, eta[1] + hull * ay, known, told)
                        if heard < explained - 0.1:
                            f[30], f[31], f[32] = eta[0] + (hull + heard) * ax, eta[1] + (hull + heard) * ay, 0.0
                if f[32] > 0.5 + 0.5 * s[DT]:
                    continue
                sec = sector[sectors]
                sectors += 1
                free = set_sector(sec, eta, f[30] - eta[0], f[31] - eta[1], 0.0, hull)
                sec[2] = bound_of(free - g[MARGIN], at, brake, g[REACTION])
        for i in range(4):
            sec = sector[sectors]
            sectors += 1
            distance, sec[0], sec[1] = wall_of(s, eta[0], eta[1], i)
            sec[3], sec[4] = eta[0] + distance * sec[0], eta[1] + distance * sec[1]
            sec[2] = bound_of(distance - hull - g[MARGIN], at, brake, g[REACTION])

        avoiding = choose(s, wish_x, wish_y, sector, sectors, latch, velocity)
        brake_beyond(c * x[4] - sn * x[5], sn * x[4] + c * x[5], sector, sectors, velocity)
        wanted[0], wanted[1] = c * velocity[0] + sn * velocity[1], c * velocity[1] - sn * velocity[0]
        off = heading - eta[3]
        wanted[2] = g[K2] * (s[DEPTH] - eta[2])
        wanted[3] = g[K_PSI] * (off - 2 * pi * floor((off + pi) / (2 * pi)))
        if s[PROJECTED] > 0:
            project(s, wanted[0], wanted[1], sector, sectors, c, sn, wanted, row, q, t3, low, base, moved_to)

        shrink = min(1.0, s[CAP] / max(length2(wanted[0], wanted[1]), 1e-6))
        clipped = False
        wanted[0] *= shrink
        wanted[1] *= shrink
        wanted[2], wanted[3] = clip(wanted[2], -0.1, 0.1), clip(wanted[3], -turn, turn)
        for i in range(4):
            miss = wanted[i] - x[4 + i]
            drag = (s[m + 4 + i] + s[m + 8 + i] * abs(wanted[i])) * wanted[i]
            free = drag + s[m + i] * ((g[K_R] if i == 3 else g[K_V]) * miss + integral[i])
            tau[i] = clip(free, -s[m + 12 + i], s[m + 12 + i])
            if abs(free - tau[i]) > 1e-9:
                clipped = True
            else:
                integral[i] += s[DT] * g[K_I] * miss
        sound = isfinite(tau[0] + tau[1] + tau[2] + tau[3] + progress)

        away, off_depth = away_from_path(s, x[0], x[1]), x[2] - s[DEPTH]
        settling = avoiding or (settling and away > 0.1)
        if not settling:
            error += away * away + off_depth * off_depth
            kept += 1
        square += away * away
        past_x, past_y = x[0] - s[TARGET], x[1] - s[TARGET + 1]
        gap = length2(past_x, past_y)
        out[6] = max(out[6], away)
        if gap <= 1:
            out[7] = max(out[7], past_x * tx[points - 2] + past_y * ty[points - 2])
        out[9] += length2(tau[0], tau[1])
        saturated += clipped
        for i in range(4):
            out[10] = max(out[10], abs(tau[i]) / s[m + 12 + i])
        if tick > 0:
            out[8] += length2(x[0] - px, x[1] - py)
            for i in range(2):
                jerk += (tau[i] - last[i]) * (tau[i] - last[i])
        px, py = x[0], x[1]
        for i in range(4):
            last[i] = tau[i]

        if clearance <= 0:
            stopped = 2
        elif gap <= s[REACH]:
            stopped = 1
        elif not sound:
            stopped = 3
        if stopped != 0:
            last_tick = tick
            break

        for half in range(2):
            fx = fy = 0.0
            if s[WAVE] > 0:
                wave = s[WAVE] * sin(2 * pi * (time + half * 0.025) / s[WAVE + 1] + luck[2])
                fx, fy = wave * luck[0], wave * luck[1]
            advance(s, x, tau, fx, fy, k4, limited)
            if half == 0:
                between = inf
                place(s, luck, time + 0.025, shape)
                if sonar:
                    fire(s, shape, firing, x, noise[5:], samples[firing])
                    fresh[firing] = 1.0
                    firing = (firing + 1) % 4
                for k in range(count):
                    if shape[k, 1] > 0:
                        between = min(between, foot(shape[k], x[0], x[1])[0] - s[HULL])
                wall = wall_distance(s, x) - s[HULL]
                clear = clear or wall > 0
                if clear:
                    between = min(between, wall)
                nearest_thing = min(nearest_thing, between)

    rows = last_tick + 1
    out[0], out[1], out[2] = 1.0 if stopped == 1 else 0.0, 1.0 if stopped == 2 else 0.0, last_tick * s[DT]
    out[3], out[4], out[5] = nearest_thing, sqrt(error / kept) if kept else nan, sqrt(square / rows)
    out[9] /= rows
    out[11] = saturated / rows
    out[12] = sqrt(jerk / (rows - 1)) / s[DT] if rows > 1 else 0.0
    out[13] = stopped


@jit
def fly_all(s, gains, luck, random, out):
    for i in range(len(out)):
        fly(s, gains[i], luck[i], random[i], out[i])


def fly_many(scene: Array, gains: Array, luck: Array, seeds: NDArray[np.uint64]) -> Array:
    """Do the same as `hand.HandLoop.run` on one thread."""
    random: Any = noise_states(seeds).astype(np.int64)
    out = np.empty((len(seeds), OWN_METRICS))
    fly_all(scene, gains, luck, random, out)
    return with_corners(out)
