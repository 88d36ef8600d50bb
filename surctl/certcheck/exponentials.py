"""Proved intervals for exponentials, logarithms, hyperbolic functions and powers with a fractional exponent.

mpmath's own intervals of these functions are not used, because nothing states their rounding errors: its interval
arctangent and arccosine once did not round outward. As in `surctl.certcheck.angles`, the arithmetic is fixed-point: a
number is an integer number of units of 2^-128, and every function returns the interval from `off` units below the
computed number to `off` units above it. The ends of an interval have 60 bits, so 68 bits guard the result; `off` is
more than twice the error bound that the function's docstring derives, and at most 2^17 units. Truncation of a product
or a quotient costs less than one unit. At the arguments 0 and 1 the functions return exact values, because claims often
hold with equality there.

A function returns None if it has no finite bound here: its argument or its logarithm exceeds 2^20, or is infinite.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from functools import lru_cache
from typing import Any

from mpmath import libmp

from surctl.certcheck.angles import BITS, LESS, NEAR, UNIT, WIDTH, Interval, magnitude, scaled

__all__ = ["exponential", "hyperbolic_cosine", "hyperbolic_sine", "hyperbolic_tangent", "logarithm", "real_power"]

Raw = Any

_OFF_POWER = 1 << 17
_LARGEST = 20  # |x| < 2^_LARGEST for an exponential
_TINY_POWER = libmp.mpf_shift(libmp.fone, -(1 << _LARGEST))  # more than e^x for x ≤ -2^_LARGEST
_MORE = libmp.mpf_add(libmp.fone, libmp.mpf_shift(libmp.fone, 2 * NEAR))  # 1 + 2^-80
_MOST_EXPONENT_BITS = 1000
_LONG = WIDTH + _MOST_EXPONENT_BITS
_ONE = (libmp.fone, libmp.fone)
_ZERO = (libmp.fzero, libmp.fzero)


def _log_two_to(bits: int) -> int:
    """Return ln 2 = 2 artanh 1/3 in units of 2^-bits; each of the < bits/3 terms of the sum is off by < 2 units."""
    power, total, k = (1 << bits) // 3, 0, 1
    while power:
        total += power // k
        power //= 9
        k += 2
    return 2 * total


# error < 2 · 2 · _LONG/3 units before truncation by 64 bits, so less than 2 units after it
_LOG_TWO = _log_two_to(_LONG + 64) >> 64


@lru_cache(2048)
def _log_two(bits: int) -> int:
    """Return ln 2 in units of 2^-bits, with an error of less than 2 units, for bits ≤ _LONG."""
    return _LOG_TWO >> (_LONG - bits)


def _bounded(a: Interval) -> bool:
    # infinities and NaN have the mantissa 0
    return all(end[1] or end == libmp.fzero for end in a)


def _fixed(x: Raw, m: int) -> int:
    """Return a number in units of 2^-(128 + m), with an error of less than one unit."""
    return int(libmp.to_fixed(x, WIDTH + m))


def _grown(t: int, m: int) -> tuple[int, int]:
    """Return (s, k) with e^x = s 2^k for x = t units of 2^-(128 + m), |x| ≤ 2^m and m ≥ 0; s is in units of 2^-128.

    The error of s is less than 120 units if t is off by less than one unit. With x = k ln 2 + r, |k| ≤ 2.5 · 2^m, and
    ln 2 is off by less than 2 units of 2^-(128 + m), so r is off by less than 5 units of 2^-128; the truncations of t
    and of r cost one unit each. As e^r ≤ 2, these 7 units change s by less than 15. The term r^n/n! results from the
    term before by a truncated product and a truncated quotient: its error is less than (3 · 0.7 + 1)/2 + 1 < 3 units if
    that of the term before is less than 3. From n = 33 on, the terms are below one unit, so at most 32 are added, with
    an error of less than 96 units, and the remainder is less than 5 units.
    """
    k, r = divmod(t, _log_two(WIDTH + m))
    r >>= m
    total, term, n = UNIT + r, r, 1
    while term:
        n += 1
        term = (term * r >> WIDTH) // n
        total += term
    return total, k


@lru_cache(8192)
def _exp_of(x: Raw) -> Interval | None:
    if x == libmp.fzero:
        return _ONE
    if magnitude(x) > _LARGEST:
        return (libmp.fzero, _TINY_POWER) if x[0] else None
    m = max(magnitude(x), 0)
    return scaled(*_grown(_fixed(x, m), m))


@lru_cache(8192)
def _sinh_cosh_of(x: Raw) -> tuple[Interval, Interval] | None:
    """Return the intervals of sinh x and cosh x, with an error of less than 250 units of e^|x|/2 before widening.

    e^|x| = p 2^k and e^-|x| = q 2^j with j ≤ k. The errors of p and q are less than 120 units, and the shift of q costs
    less than one unit. For |x| < 2^-40, sinh x lies between x and x (1 + 2^-80), because x²/6 + … < 2^-80.
    """
    if x == libmp.fzero:
        return _ZERO, _ONE
    size = magnitude(x)
    if size > _LARGEST:
        return None
    m = max(size, 0)
    t = _fixed(libmp.mpf_abs(x), m)
    (p, k), (q, j) = _grown(t, m), _grown(-t, m)
    q >>= k - j
    low, high = scaled(p + q, k - 1)
    cosh = (low if libmp.mpf_gt(low, libmp.fone) else libmp.fone), high
    if size <= NEAR:
        return _between(x, libmp.mpf_pos(x, BITS, "d"), libmp.mpf_mul(x, _MORE, BITS, "u")), cosh
    sinh = scaled(p - q, k - 1)
    return (libmp.mpi_neg(sinh) if x[0] else sinh), cosh


def _between(x: Raw, small: Raw, large: Raw) -> Interval:
    # bounds of an odd function at x, the smaller magnitude first
    return (large, small) if x[0] else (small, large)


@lru_cache(8192)
def _tanh_of(x: Raw) -> Interval:
    """Return the interval of tanh x = ±(1 − w)/(1 + w) with w = e^(−2|x|).

    w is off by less than 121 units; for |x| ≥ 2^8, w < 2^-700 counts as 0. The slope of (1 − w)/(1 + w) is at most 2,
    and the truncation of the quotient costs one unit: the error is less than 243 units. For |x| < 2^-40, tanh x lies
    between x (1 − 2^-80) and x, because x²/3 < 2^-80.
    """
    if x == libmp.fzero:
        return _ZERO
    size = magnitude(x)
    if size <= NEAR:
        return _between(x, libmp.mpf_mul(x, LESS, BITS, "d"), libmp.mpf_pos(x, BITS, "u"))
    w = 0
    if size <= 8:
        m = max(size + 1, 0)
        s, k = _grown(-_fixed(libmp.mpf_shift(libmp.mpf_abs(x), 1), m), m)
        w = s >> -k
    low, high = scaled(((UNIT - w) << WIDTH) // (UNIT + w), 0)
    bounds = low, (high if libmp.mpf_lt(high, libmp.fone) else libmp.fone)
    return libmp.mpi_neg(bounds) if x[0] else bounds


@lru_cache(8192)
def _log_fixed(x: Raw) -> int | None:
    """Return ln x in units of 2^-128 for x > 0, with an error of less than 256 units.

    x = f 2^e with 3/4 ≤ f < 3/2, and ln f = 2 artanh y with y = (f − 1)/(f + 1), |y| ≤ 1/5. Truncations of f and of the
    quotient put y off by less than 2 units. From the 29th on, the terms y^n/n are below one unit; each has an error of
    less than 3 units (a truncated product with a truncated square, and a truncated quotient), and the remainder is less
    than 2 units. So artanh y is off by less than 3 + 84 + 2 units, and ln f by less than 180. The error of e ln 2 is
    less than 3 units, because ln 2 has as many more bits as e has.
    """
    e = magnitude(x)
    f = _fixed((0, x[1], -x[3], x[3]), 0)
    if 4 * f < 3 * UNIT:
        e -= 1
        f = _fixed((0, x[1], 1 - x[3], x[3]), 0)
    bits = abs(e).bit_length()
    if bits > _MOST_EXPONENT_BITS:
        return None
    y = (abs(f - UNIT) << WIDTH) // (f + UNIT)
    square, power, total = y * y >> WIDTH, y, y
    for n in range(3, 61, 2):
        power = power * square >> WIDTH
        total += power // n
    return (2 * total if f >= UNIT else -2 * total) + (e * _log_two(WIDTH + bits) >> bits)


@lru_cache(8192)
def _log_of(x: Raw) -> Interval | None:
    if x == libmp.fone:
        return _ZERO
    value = _log_fixed(x)
    return None if value is None else scaled(value, 0)


@lru_cache(8192)
def _power_of(x: Raw, exponent: Fraction) -> Interval | None:
    """Return the interval of x^exponent for x ≥ 0 and |exponent| ≤ 64; x > 0 for a negative exponent.

    The logarithm of the power is off by less than 64 · 256 + 1 units. These change the number s of `_grown` by less
    than 2^15 + 3 units, and s has an error of less than 120 units otherwise: `_OFF_POWER` is more than twice their sum.
    """
    if x in (libmp.fzero, libmp.fone):
        return x, x
    logarithm_ = _log_fixed(x)
    if logarithm_ is None:
        return None
    t = logarithm_ * exponent.numerator // exponent.denominator
    if abs(t) >= UNIT << _LARGEST:
        return (libmp.fzero, _TINY_POWER) if t < 0 else None
    return scaled(*_grown(t << _LARGEST, _LARGEST), _OFF_POWER)


def _monotone(a: Interval, function: Callable[[Raw], Interval | None]) -> Interval | None:
    """Return the range of an increasing function: from the lower end at a's lower end to the upper end at its upper."""
    if not _bounded(a):
        return None
    low, high = function(a[0]), function(a[1])
    return None if low is None or high is None else (low[0], high[1])


def exponential(a: Interval) -> Interval | None:
    """Return the range of e^x on an interval; None if its upper end exceeds 2^20."""
    return _monotone(a, _exp_of)


def logarithm(a: Interval) -> Interval | None:
    """Return the range of ln x on an interval of positive numbers; None if a number has too large an exponent."""
    return _monotone(a, _log_of)


def hyperbolic_sine(a: Interval) -> Interval | None:
    """Return the range of sinh on an interval; None if a number exceeds 2^20 in magnitude."""
    return _monotone(a, lambda x: None if (pair := _sinh_cosh_of(x)) is None else pair[0])


def hyperbolic_cosine(a: Interval) -> Interval | None:
    """Return the range of cosh on an interval; None if a number exceeds 2^20 in magnitude."""
    sizes = libmp.mpi_abs(a, BITS)  # cosh is even, and increases with |x|
    return _monotone(sizes, lambda x: None if (pair := _sinh_cosh_of(x)) is None else pair[1])


def hyperbolic_tangent(a: Interval) -> Interval | None:
    """Return the range of tanh on an interval; None if an end is infinite."""
    return _monotone(a, _tanh_of)


def real_power(a: Interval, exponent: Fraction) -> Interval | None:
    """Return the range of x^exponent on an interval of numbers ≥ 0 (> 0 if the exponent is negative).

    Return None if the result exceeds e^(2^20). The power increases with x if the exponent is positive, and decreases
    otherwise.
    """
    ends = a if exponent > 0 else (a[1], a[0])
    if not _bounded(a):
        return None
    low, high = (_power_of(end, exponent) for end in ends)
    return None if low is None or high is None else (low[0], high[1])
