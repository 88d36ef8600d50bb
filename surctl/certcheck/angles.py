"""Proved intervals for sines, cosines, tangents and angles, in fixed-point arithmetic with error bounds.

A fixed-point number is an integer number of units of 2^-128. Every sum in this module has at most 40 terms. The error
of a term is less than 3 units, because truncation of a product or quotient costs less than one unit and the errors of
its operands contribute less than two. Each function returns the interval from `OFF` = 2^11 units below the computed
number to `OFF` units above it. `OFF` is more than twice the error bound that the function's docstring derives. The
ends of an interval are raw numbers of mpmath (tuples, not `mpf` objects). The module applies only +, -, ×, ÷, square
root and comparison to these numbers.
"""

from __future__ import annotations

from functools import lru_cache
from math import isqrt
from typing import Any

from mpmath import libmp

__all__ = [
    "BITS", "LESS", "NEAR", "OFF", "UNIT", "WIDTH", "Interval", "angle", "arccos", "arcsin", "circle", "hull",
    "magnitude", "pi", "scaled", "tangent",
]  # fmt: skip

Interval = Any
"""The pair (lower end, upper end) of an interval, as raw numbers of mpmath."""
Raw = Any

BITS = 60
"""Precision of the ends of an interval [bits]."""

WIDTH, UNIT, OFF = 128, 1 << 128, 1 << 11
"""Bits after the point, one, and the widening of a result."""

_FAR, NEAR = 1100, -40  # above 2^_FAR the bounds of a sine are ±1; below 2^NEAR sin x ≈ x
LESS = libmp.mpf_sub(libmp.fone, libmp.mpf_shift(libmp.fone, 2 * NEAR))  # 1 − 2^-80
_LINE_OF_ONE = (libmp.fnone, libmp.fone)


def _arccot(n: int, bits: int) -> int:
    """Return arctan(1/n) in units of 2^-bits for n > 1; each of the < `bits` terms of the sum is off by < 2 units."""
    power, total, k = (1 << bits) // n, 0, 1
    while power:
        total += -(power // k) if k & 2 else power // k
        power //= n * n
        k += 2
    return total


_LONG = _FAR + WIDTH + 64
# Machin: π/2 = 8 arctan 1/5 − 2 arctan 1/239; error < 20 · 2 · _LONG units before truncation by 64 bits
_HALF_PI = (8 * _arccot(5, _LONG + 64) - 2 * _arccot(239, _LONG + 64)) >> 64


@lru_cache(2048)
def _half_pi(bits: int) -> int:
    """Return π/2 in units of 2^-bits, with an error of less than 2 units, for bits ≤ _LONG."""
    return _HALF_PI >> (_LONG - bits)


def scaled(value: int, power: int = 0, off: int = OFF) -> Interval:
    """Return the interval (value ± off) 2^power units of 2^-128, rounded outward to 60 bits."""
    low, high = (
        libmp.from_man_exp(value + o, power - WIDTH, BITS, rounding) for o, rounding in ((-off, "f"), (off, "c"))
    )
    return low, high


def pi() -> Interval:
    """Return a narrow interval that contains π."""
    return _PI


_PI = scaled(2 * _half_pi(WIDTH))


def magnitude(x: Raw) -> int:
    """Return n with 2^(n−1) ≤ |x| < 2^n, for x ≠ 0."""
    return int(x[2] + x[3])


def _taylor(r: int) -> tuple[int, int]:
    """Return the cosine and the sine of the angle r; all three are in units of 2^-128, and −4 ≤ r ≤ π/4 + 4 units.

    The terms r^n/n! are below one unit from n = 36 on, so each of the two series has at most 18 terms. Each term is
    computed from the previous term by a truncated product (error 1 unit) with a truncated r² (1 unit), and by a
    truncated quotient (1 unit), so its error is less than 3 units. The remainder of each series is less than 4 units.
    The total error is therefore less than 60 units.
    """
    square, cosine, sine = r * r >> WIDTH, UNIT, r
    a, b, n = UNIT, r, 1
    while a:
        a = (a * square >> WIDTH) // (n * (n + 1))
        b = (b * square >> WIDTH) // ((n + 1) * (n + 2))
        if n & 2:
            cosine, sine = cosine + a, sine + b
        else:
            cosine, sine = cosine - a, sine - b
        n += 2
    return cosine, sine


@lru_cache(8192)
def _at(x: Raw) -> tuple[int, Interval, Interval]:
    """Return k, cos x and sin x of a number with |x| < 2^_FAR; k is the integer with 0 ≤ r < π/2 for r = x − k π/2.

    If x has m bits before the point, x and π/2 are computed in units of 2^-(128 + m). Truncation changes x by less than
    one of these units. It changes k π/2 by less than 2^(m+1) of these units, because k ≤ 2^m. So the error of r = x − k
    π/2 is less than 3 units of 2^-128, plus one unit for the truncation of r. If the function uses π/2 − r instead of
    r, the error of π/2 − r is less than 6 units. The slopes of sine and cosine are at most 1. Together with the error
    of `_taylor`, the error of the results is less than 70 units.
    """
    if x == libmp.fzero:
        return 0, (libmp.fone, libmp.fone), (libmp.fzero, libmp.fzero)
    size = magnitude(x)
    m = max(size, 0)
    k, r = divmod(int(libmp.to_fixed(x, WIDTH + m)), _half_pi(WIDTH + m))
    r >>= m
    whole = _half_pi(WIDTH)
    if 2 * r > whole:
        sine, cosine = _taylor(whole - r)
    else:
        cosine, sine = _taylor(r)
    for _ in range(k & 3):
        cosine, sine = -sine, cosine
    of_cosine, of_sine = _within(scaled(cosine)), _within(scaled(sine))
    return k, of_cosine, _nearly(x) if size <= NEAR else of_sine


def _nearly(x: Raw) -> Interval:
    """Return bounds on sin x and arctan x for |x| ≤ 2^-40: both values lie between x (1 − 2^-80) and x."""
    less, more = libmp.mpf_mul(x, LESS, BITS, "d"), libmp.mpf_pos(x, BITS, "u")
    return (more, less) if x[0] else (less, more)


def _within(a: Interval) -> Interval:
    # intersection with [−1, 1], the range of sine and cosine
    low = libmp.fnone if libmp.mpf_lt(a[0], libmp.fnone) else a[0]
    return low, libmp.fone if libmp.mpf_gt(a[1], libmp.fone) else a[1]


def circle(a: Interval) -> tuple[Interval, Interval]:
    """Return the ranges of cosine and sine on an interval.

    Cosine and sine are monotone between multiples of π/2. So their values at the ends of the interval, and the values 0
    and ±1 at the multiples of π/2 inside, give the ranges. `_at` may count a multiple of π/2 within 4 units (of 2^-128)
    of an end of the interval as outside; then the bounds of the values at this end contain 0 and ±1 nevertheless.
    """
    low, high = a
    if any(end[1] == 0 and end != libmp.fzero for end in a) or any(magnitude(e) > _FAR for e in a if e[1]):
        return _LINE_OF_ONE, _LINE_OF_ONE
    first, cosine, sine = _at(low)
    if low == high:
        return cosine, sine
    last, other, another = _at(high)
    if last - first >= 4:
        return _LINE_OF_ONE, _LINE_OF_ONE
    cosine, sine = hull(cosine, other), hull(sine, another)
    for k in range(first + 1, last + 1):
        one = libmp.fone if k & 3 < 2 else libmp.fnone
        if k & 1:
            sine = hull(sine, (one, one))
        else:
            cosine = hull(cosine, (one, one))
    return cosine, sine


def tangent(a: Interval) -> Interval | None:
    """Return the range of the tangent on an interval; None if the interval may contain a pole, or is too large.

    `_at` numbers the quarter turns by k, so the branch of the tangent between two poles has the number ⌊(k + 1)/2⌋.
    Near a multiple of π/2, k may be off by one. At an even multiple this does not change the branch. Near an odd
    multiple, within 2^10 units, the interval of the cosine contains 0, and the result is None. On one branch the
    tangent increases.
    """
    if any(end[1] == 0 and end != libmp.fzero for end in a) or any(magnitude(e) > _FAR for e in a if e[1]):
        return None
    values, branches = [], set()
    for end in a:
        k, cosine, sine = _at(end)
        if not (libmp.mpf_gt(cosine[0], libmp.fzero) or libmp.mpf_lt(cosine[1], libmp.fzero)):
            return None
        branches.add((k + 1) // 2)
        values.append(libmp.mpi_div(sine, cosine, BITS))
    return (values[0][0], values[1][1]) if len(branches) == 1 else None


def hull(a: Interval, b: Interval) -> Interval:
    """Return the smallest interval that contains two intervals."""
    low = a[0] if libmp.mpf_le(a[0], b[0]) else b[0]
    return low, a[1] if libmp.mpf_ge(a[1], b[1]) else b[1]


def _arctan(t: int) -> int:
    """Return arctan t for 0 ≤ t ≤ 1, both in units of 2^-128; the error of the argument t is less than one unit.

    The rule arctan t = 2 arctan(t/(1 + √(1 + t²))) is applied three times. The map t → t/(1 + √(1 + t²)) has a slope of
    at most 1/2, and the truncation of its root and quotient costs less than 2 units. So after three applications the
    error of t is less than 4 units, and t ≤ tan(π/32) < 0.0985. From the 21st term on, the terms of the arctan series
    are below one unit; each term has an error of less than 3 units, and the remainder of the series is less than 2
    units. Together with the error of t, the sum has an error of less than 66 units. After multiplication by 8 this
    error is less than 530 units.
    """
    for _ in range(3):
        t = (t << WIDTH) // (UNIT + isqrt((UNIT << WIDTH) + t * t))
    square, power, total, n = t * t >> WIDTH, t, t, 1
    while power:
        power = power * square >> WIDTH
        n += 2
        total += -(power // n) if n & 2 else power // n
    return 8 * total


@lru_cache(8192)
def _angle_of(y: Raw, x: Raw) -> Interval:
    """Return an interval that contains atan2(y, x), for numbers that are not both 0; arctan is off by < 600 units."""
    up, ahead = libmp.mpf_abs(y), libmp.mpf_abs(x)
    steep = bool(libmp.mpf_gt(up, ahead))
    small, large = (ahead, up) if steep else (up, ahead)
    if not steep and not x[0]:
        if y == libmp.fzero:
            return libmp.fzero, libmp.fzero
        if magnitude(small) - magnitude(large) < NEAR - 1:
            low = _nearly(libmp.mpf_div(small, large, BITS, "d"))[0]
            high = libmp.mpf_div(small, large, BITS, "u")
            return (libmp.mpf_neg(high), libmp.mpf_neg(low)) if y[0] else (low, high)
    turn = _arctan(_ratio(small, large))
    quarter = _half_pi(WIDTH)
    turn = quarter - turn if steep else turn
    turn = 2 * quarter - turn if x[0] else turn
    return scaled(-turn if y[0] else turn)


def _ratio(small: Raw, large: Raw) -> int:
    """Return small/large in units of 2^-128, truncated, for 0 ≤ small ≤ large."""
    shift = small[2] - large[2] + WIDTH
    if magnitude(small) - magnitude(large) < -WIDTH - 1:
        return 0
    return int((small[1] << max(shift, 0)) // (large[1] << max(-shift, 0)))


def angle(y: Interval, x: Interval) -> Interval:
    """Return the range of atan2(y, x) on a box without (0, 0) in which all y ≥ 0, all y < 0 or all x > 0.

    On such a box atan2 is smooth, because its jump lies outside the box. If y has one sign on the box, atan2 is
    monotone in x everywhere, and monotone in y at each end of the range of x. If y changes its sign, x is positive;
    then atan2 is monotone in y everywhere, and monotone in x at each end of the range of y. In both cases the values at
    the corners of the box give the range.
    """
    first, *others = {(a, b) for a in y for b in x}
    total = _angle_of(*first)
    for corner in others:
        total = hull(total, _angle_of(*corner))
    return total


def arccos(x: Interval) -> Interval:
    """Return the range of arccos on an interval within [−1, 1]; arccos decreases, so its values at the ends suffice."""
    return _arccos_of(x[1])[0], _arccos_of(x[0])[1]


def arcsin(x: Interval) -> Interval:
    """Return the range of arcsin on an interval within [−1, 1]; arcsin increases, so its values at the ends suffice."""
    # arcsin x = atan2(x, √((1 − x)(1 + x)))
    return angle((x[0], x[0]), _other_leg(x[0]))[0], angle((x[1], x[1]), _other_leg(x[1]))[1]


@lru_cache(8192)
def _arccos_of(x: Raw) -> Interval:
    # arccos x = atan2(√((1 − x)(1 + x)), x)
    return angle(_other_leg(x), (x, x))


def _other_leg(x: Raw) -> Interval:
    """Return √((1 − x)(1 + x)), with the root rounded down and up, for a number in [−1, 1]."""
    ends = []
    for rounding in "fc":
        factors = (step(libmp.fone, x, 2 * BITS, rounding) for step in (libmp.mpf_sub, libmp.mpf_add))
        ends.append(libmp.mpf_sqrt(libmp.mpf_mul(*factors, 2 * BITS, rounding), 2 * BITS, rounding))
    return ends[0], ends[1]
