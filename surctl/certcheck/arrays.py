"""Interval arithmetic on arrays of doubles, rounded outward: each result contains all values of the operation.

Sums, products, quotients and roots only need a processor that rounds as IEEE 754 states, with denormal numbers. The
ends of a sum are rounded outward only if its exact rounding error requires it, and those of a product, quotient or root
are moved to the next double unless they are exact: claims often hold with equality at 0. Cosine and sine have a series
of their own. The prover and the checker compute with this module.
"""

from __future__ import annotations

import sys
from fractions import Fraction
from functools import lru_cache, reduce
from math import inf, nextafter, pi

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "PI", "Array", "Ends", "Flags", "add", "cosine_and_sine", "decimals", "divide", "down", "enclosed",
    "has_gradual_underflow", "hull_max", "hull_min", "magnitude", "multiply", "negate", "point", "square",
    "squared_root", "subtract", "to_power", "up",
]  # fmt: skip

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Ends = tuple[Array, Array]
"""Intervals (lower, upper) as two arrays of equal shape; the whole real line is (−inf, inf)."""

PI = pi, nextafter(pi, 4.0)
"""Bounds on π: the double lies below it."""

_TERMS = 10  # of the series of cosine and sine
_LARGEST_ANGLE = 1000.0  # of the series [rad]


def has_gradual_underflow() -> bool:
    """Return whether the processor computes with denormal numbers; some libraries make it replace them by 0."""
    return bool(np.all(np.array([5e-324, 2.0**-1022]) * np.array([1.0, 0.5]) > 0))


def point(x: Array) -> Ends:
    """Return point intervals, each of which contains exactly one number."""
    return x, x


def enclosed(value: Fraction) -> tuple[float, float]:
    """Return the nearest double below and the nearest double above a number; both are the number if it is a double."""
    largest = sys.float_info.max
    try:
        near = float(value)
    except OverflowError:
        return (largest, inf) if value > 0 else (-inf, -largest)
    over, under = near.as_integer_ratio()
    above = over * value.denominator - value.numerator * under  # a comparison of fractions is slow
    low = near if above <= 0 else nextafter(near, -inf)
    return low, near if above >= 0 else nextafter(near, inf)


_DIGITS = Fraction("3.14159265358979323846264338327950288")  # first digits of π
_HEAD = round(float(_DIGITS / 2) * 2**31) / 2**31  # π/2 to 32 bits
_TAIL = enclosed(_DIGITS / 2 - Fraction(_HEAD))[0], enclosed((_DIGITS + Fraction(1, 10**35)) / 2 - Fraction(_HEAD))[1]
"""Bounds on π/2 − _HEAD."""


def decimals(low: Array, high: Array) -> Ends:
    """Return intervals that contain the ends and the decimals that are printed for them."""
    ends = []
    for side, end in enumerate((low, high)):
        each, places = np.unique(end, return_inverse=True)
        ends.append(np.array([_decimal(x)[side] for x in each.tolist()])[places].reshape(end.shape))
    return ends[0], ends[1]


@lru_cache(8192)
def _decimal(x: float) -> tuple[float, float]:
    """Return the least and the largest of a double and of the doubles around its printed decimal."""
    low, high = enclosed(Fraction(repr(x)))
    return min(x, low), max(x, high)


def down(x: Array) -> Array:
    """Return the next lower doubles."""
    return np.nextafter(x, -np.inf)


def up(x: Array) -> Array:
    """Return the next higher doubles."""
    return np.nextafter(x, np.inf)


def _sum_ends(a: Array, b: Array) -> tuple[Array, Array]:
    """Return the sum a + b and its rounding error, which is exact unless the sum overflows."""
    total = a + b
    part = total - a
    error = (a - (total - part)) + (b - part)
    return total, error


def add(a: Ends, b: Ends) -> Ends:
    """Return a + b."""
    low, error_low = _sum_ends(a[0], b[0])
    high, error_high = _sum_ends(a[1], b[1])
    # the comparison is false for a NaN error, so the end is then moved outwards
    low = np.where(error_low >= 0, low, down(low))
    high = np.where(error_high <= 0, high, up(high))
    return np.where(np.isnan(low), -np.inf, low), np.where(np.isnan(high), np.inf, high)


def negate(a: Ends) -> Ends:
    """Return −a."""
    return -a[1], -a[0]


def subtract(a: Ends, b: Ends) -> Ends:
    """Return a − b."""
    return add(a, negate(b))


def multiply(a: Ends, b: Ends) -> Ends:
    """Return the product a b; an infinite end times 0 is 0."""
    # one array operation on all products of ends costs far less than four, as most arrays are small
    x, y = (np.array(end[:1] if end[0] is end[1] else end) for end in (a, b))
    x = x.reshape(len(x), 1, *(1,) * (y.ndim - x.ndim), *x.shape[1:])
    y = y.reshape(1, len(y), *(1,) * (x.ndim - 1 - y.ndim), *y.shape[1:])
    exact = (x == 0) | (y == 0)
    p = np.where(exact, 0.0, x * y)
    if np.array_equal(p == 0, exact):
        low, high = p.min(axis=(0, 1)), p.max(axis=(0, 1))
        return np.where(low == 0, 0.0, down(low)), np.where(high == 0, 0.0, up(high))
    low, high = np.where(exact, p, down(p)), np.where(exact, p, up(p))  # a product underflows, or is NaN
    return low.min(axis=(0, 1)), high.max(axis=(0, 1))


def square(a: Ends) -> Ends:
    """Return a²."""
    return to_power(a, 2)


def to_power(a: Ends, exponent: int) -> Ends:
    """Return a^exponent for exponent ≥ 0; the interval of an even power has no negative part."""
    if exponent == 0:
        return np.ones_like(a[0]), np.ones_like(a[1])
    if exponent % 2:
        low, high = _repeated(np.abs(a[0]), exponent), _repeated(np.abs(a[1]), exponent)
        return np.where(a[0] < 0, -low[1], low[0]), np.where(a[1] < 0, -high[0], high[1])
    small = np.where((a[0] <= 0) & (a[1] >= 0), 0.0, np.minimum(np.abs(a[0]), np.abs(a[1])))
    large = np.maximum(np.abs(a[0]), np.abs(a[1]))
    return _repeated(small, exponent)[0], _repeated(large, exponent)[1]


def _repeated(x: Array, exponent: int) -> Ends:
    """Return x^exponent for x ≥ 0."""
    low = high = x
    for _ in range(exponent - 1):
        low, high = np.maximum(down(low * x), 0.0), np.where(x == 0, 0.0, up(high * x))
    return low, high


def divide(a: Ends, b: Ends) -> Ends:
    """Return a / b; the whole real line if b contains 0."""
    unsafe = (b[0] <= 0) & (b[1] >= 0)
    under = np.where(unsafe, 1.0, b[0]), np.where(unsafe, 1.0, b[1])
    quotients = [_quotient(x, y) for x in (a[:1] if a[0] is a[1] else a) for y in under]
    low, high = reduce(np.minimum, (q[0] for q in quotients)), reduce(np.maximum, (q[1] for q in quotients))
    low, high = np.where(unsafe, -np.inf, low), np.where(unsafe, np.inf, high)
    return np.where(np.isnan(low), -np.inf, low), np.where(np.isnan(high), np.inf, high)


def _quotient(x: Array, y: Array) -> Ends:
    exact = (x == 0) | (y == 1)
    q = np.where(x == 0, 0.0, x / y)
    return np.where(exact, q, down(q)), np.where(exact, q, up(q))


def squared_root(a: Ends) -> Ends:
    """Return √a for the nonnegative part of a."""
    ends = [np.maximum(end, 0.0) for end in a]
    exact = [(end == 0) | (end == 1) for end in ends]
    low, high = map(np.sqrt, ends)
    return np.where(exact[0], low, down(low)), np.where(exact[1], high, up(high))


def hull_min(a: Ends, b: Ends) -> Ends:
    """Return min(a, b)."""
    return np.minimum(a[0], b[0]), np.minimum(a[1], b[1])


def hull_max(a: Ends, b: Ends) -> Ends:
    """Return max(a, b)."""
    return np.maximum(a[0], b[0]), np.maximum(a[1], b[1])


def magnitude(a: Ends) -> Ends:
    """Return |a|."""
    holds = (a[0] <= 0) & (a[1] >= 0)
    ends = np.abs(a[0]), np.abs(a[1])
    return np.where(holds, 0.0, np.minimum(*ends)), np.maximum(*ends)


def cosine_and_sine(a: Ends) -> tuple[Ends, Ends, Flags]:
    """Return cosine and sine of intervals, and whether they are known: the ends must lie within ±1000."""
    at_ends = [_at(end) for end in a]
    first, last = np.ceil(a[0] / _HEAD - 1e-6), np.floor(a[1] / _HEAD + 1e-6)  # quarter turns inside
    ranges = []
    for both, crest in (([one[0] for one in at_ends], 0), ([one[1] for one in at_ends], 1)):
        low, high = np.maximum(hull_min(*both)[0], -1.0), np.minimum(hull_max(*both)[1], 1.0)
        inside = [np.floor((last - k) / 4) >= np.ceil((first - k) / 4) for k in (crest, crest + 2)]
        ranges.append((np.where(inside[1], -1.0, low), np.where(inside[0], 1.0, high)))
    return ranges[0], ranges[1], at_ends[0][2] & at_ends[1][2]


def _at(x: Array) -> tuple[Ends, Ends, Flags]:
    """Return bounds on cosine and sine of numbers, by the series at r = x − k π/2 for a whole number k, and where.

    With u = r² ≤ 1, cos r = 1 − u/(1·2) (1 − u/(3·4) (1 − …)) and sin r = r (1 − u/(2·3) (1 − u/(4·5) (1 − …))). Each
    parenthesis is an alternating series with decreasing terms, the first of which is 1; so it lies in [0, 1].
    """
    fine = np.abs(x) <= _LARGEST_ANGLE
    x = np.where(fine, x, 0.0)
    k = np.rint(x / _HEAD)
    rest = multiply(point(k), (np.full_like(x, _TAIL[0]), np.full_like(x, _TAIL[1])))
    r = subtract(subtract(point(x), point(k * _HEAD)), rest)  # the product is exact
    u, bounds = square(r), []
    fine &= u[1] <= 1
    for begin in (1, 2):
        low, high = np.zeros_like(x), np.ones_like(x)
        for n in range(begin + 2 * _TERMS, 0, -2):
            low, high = (
                down(1 - up(up(u[1] * high) / (n * (n + 1)))),
                up(1 - down(down(u[0] * low) / (n * (n + 1)))),
            )
        bounds.append((np.where(x == 0, 1.0, low), np.where(x == 0, 1.0, high)))  # equality is frequent there
    cosine, sine = bounds[0], multiply(r, bounds[1])
    for turn in (1, 2):
        here, before = np.floor(k / turn) % 2 == 1, (cosine, sine)
        turned = (negate(sine), cosine) if turn == 1 else (negate(cosine), negate(sine))
        cosine, sine = (
            (np.where(here, new[0], old[0]), np.where(here, new[1], old[1]))
            for new, old in zip(turned, before, strict=True)
        )
    return cosine, sine, fine
