"""Interval arithmetic on arrays with outward rounding: each result contains all values of the operation.

The ends of sums and differences are rounded outwards only if their exact rounding error requires it. The intervals of
products, quotients and roots are widened by one unit in the last place, because IEEE 754 rounds these operations to the
nearest number. The intervals of sin, cos, atan2, acos and the functions of `proving.functions` are widened by
`LIBM_STEPS` units: the stated error is up to 4 units for NumPy's vector routines, and 1 unit for the C libraries.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ends = tuple[Array, Array]
"""Intervals (lower, upper) as two arrays of equal shape; the whole real line is (−inf, inf)."""

LIBM_STEPS = 8
"""Units in the last place by which results of NumPy's vector routines are widened: twice the 4 that NumPy allows."""

_LARGEST_ANGLE = 1e5  # [rad] for larger angles the error of the argument reduction is not bounded here
_TINY = 5e-324


def point(x: Array) -> Ends:
    """Return point intervals, each of which contains exactly one number."""
    return x, x


def _down(x: Array) -> Array:
    return np.nextafter(x, -np.inf)


def _up(x: Array) -> Array:
    return np.nextafter(x, np.inf)


def widened(a: Ends, steps: float | Array = LIBM_STEPS) -> Ends:
    """Return the intervals with both ends moved outwards by `steps` units in the last place."""
    lower, upper = a
    # one unit is at most 2^-52 of the magnitude; the tiny term covers subnormal results
    slack_low, slack_high = steps * 2.0**-52 * np.abs(lower), steps * 2.0**-52 * np.abs(upper)
    return _down(lower - slack_low - steps * _TINY), _up(upper + slack_high + steps * _TINY)


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
    low = np.where(error_low >= 0, low, _down(low))
    high = np.where(error_high <= 0, high, _up(high))
    return np.where(np.isnan(low), -np.inf, low), np.where(np.isnan(high), np.inf, high)


def negate(a: Ends) -> Ends:
    """Return −a."""
    return -a[1], -a[0]


def subtract(a: Ends, b: Ends) -> Ends:
    """Return a − b."""
    return add(a, negate(b))


def multiply(a: Ends, b: Ends) -> Ends:
    """Return the product a b; an infinite end times 0 is 0."""
    # one array operation on the four products of ends costs far less than four, as most arrays are small
    x, y = np.array(a), np.array(b)
    x = x.reshape(2, 1, *(1,) * (y.ndim - x.ndim), *x.shape[1:])
    y = y.reshape(1, 2, *(1,) * (x.ndim - 1 - y.ndim), *y.shape[1:])
    exact = (x == 0) | (y == 0)
    p = np.where(exact, 0.0, x * y)
    if np.array_equal(p == 0, exact):
        low, high = p.min(axis=(0, 1)), p.max(axis=(0, 1))
        return np.where(low == 0, 0.0, _down(low)), np.where(high == 0, 0.0, _up(high))
    low, high = np.where(exact, p, _down(p)), np.where(exact, p, _up(p))  # a product underflows, or is NaN
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
        low, high = np.maximum(_down(low * x), 0.0), np.where(x == 0, 0.0, _up(high * x))
    return low, high


def divide(a: Ends, b: Ends) -> Ends:
    """Return a / b; the whole real line if b contains 0."""
    unsafe = (b[0] <= 0) & (b[1] >= 0)
    under = np.where(unsafe, 1.0, b[0]), np.where(unsafe, 1.0, b[1])
    quotients = [_quotient(x, y) for x in a for y in under]
    low = np.minimum(np.minimum(quotients[0][0], quotients[1][0]), np.minimum(quotients[2][0], quotients[3][0]))
    high = np.maximum(np.maximum(quotients[0][1], quotients[1][1]), np.maximum(quotients[2][1], quotients[3][1]))
    low, high = np.where(unsafe, -np.inf, low), np.where(unsafe, np.inf, high)
    return np.where(np.isnan(low), -np.inf, low), np.where(np.isnan(high), np.inf, high)


def _quotient(x: Array, y: Array) -> Ends:
    exact = (x == 0) | (y == 1)
    q = np.where(x == 0, 0.0, x / y)
    return np.where(exact, q, _down(q)), np.where(exact, q, _up(q))


def squared_root(a: Ends) -> Ends:
    """Return √a for the nonnegative part of a."""
    low, high = np.sqrt(np.maximum(a[0], 0.0)), np.sqrt(np.maximum(a[1], 0.0))
    exact = [(root == 0) | (root == 1) for root in (low, high)]
    return np.where(exact[0], low, _down(low)), np.where(exact[1], high, _up(high))


def sine(a: Ends) -> Ends:
    """Return sin a."""
    return _wave(a, np.sin, 0.25)


def cosine(a: Ends) -> Ends:
    """Return cos a."""
    return _wave(a, np.cos, 0.0)


def _wave(a: Ends, function: np.ufunc, crest: float) -> Ends:
    """Return the range of a sinusoid over a; its maxima lie at (k + crest) 2π, and its minima π after each maximum."""
    low, high = a
    wild = ~(np.maximum(np.abs(low), np.abs(high)) < _LARGEST_ANGLE)
    low, high = np.where(wild, 0.0, low), np.where(wild, 0.0, high)
    ends = []
    for end in (low, high):
        value = function(end)
        bottom, top = widened((value, value))
        # beyond 1 rad the argument reduction leaves an absolute error, which also affects small results
        reduced = np.where(np.abs(end) > 1.0, LIBM_STEPS * 2.0**-52, 0.0)
        # the values at 0 are exact, because claims often hold with equality there
        ends.append((np.where(end == 0, value, bottom - reduced), np.where(end == 0, value, top + reduced)))
    bottom, top = np.minimum(ends[0][0], ends[1][0]), np.maximum(ends[0][1], ends[1][1])
    # in turns, widened for the rounding of the division: an extra maximum only widens the interval
    rounding = 1e-15 * (1.0 + np.abs(low) + np.abs(high))
    first, last = low / (2 * np.pi) - rounding, high / (2 * np.pi) + rounding
    has_crest = np.floor(last - crest) >= np.ceil(first - crest)
    has_trough = np.floor(last - crest - 0.5) >= np.ceil(first - crest - 0.5)
    bottom = np.where(wild | has_trough, -1.0, np.maximum(bottom, -1.0))
    return bottom, np.where(wild | has_crest, 1.0, np.minimum(top, 1.0))


def atan2(y: Ends, x: Ends) -> Ends:
    """Return the angle of the vector (x, y); [−π, π] if the box contains the origin or part of the negative x axis."""
    corners = [np.arctan2(b, a) for a in x for b in y]
    low, high = widened((np.minimum.reduce(corners), np.maximum.reduce(corners)))
    cut = (x[0] <= 0) & (y[0] <= 0) & (y[1] >= 0)
    whole = _up(np.full_like(low, np.pi))
    return np.where(cut, -whole, low), np.where(cut, whole, high)


def acos(a: Ends) -> Ends:
    """Return arccos of the part of a in [−1, 1]."""
    low, high = np.clip(a[0], -1.0, 1.0), np.clip(a[1], -1.0, 1.0)
    bottom, top = widened((np.arccos(high), np.arccos(low)))
    return np.maximum(bottom, 0.0), np.where(low >= 1.0, 0.0, top)


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
