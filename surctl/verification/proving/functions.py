"""Interval arithmetic of exp, log, tan, asin, sinh, cosh, tanh and fractional powers, with outward rounding.

Each function returns intervals for the part of `a` on which it is defined; `defined` says where it is defined on all of
`a`. Values at 0 and 1 that are exact stay exact, because claims often hold with equality there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from surctl.verification.proving import intervals as iv
from surctl.verification.proving.intervals import Ends

Array = NDArray[np.float64]

LARGEST_EXPONENT = 1e5
"""Largest argument of exp, sinh and cosh on which a proof may rely. Above 709 the upper end is infinite."""

_LARGEST = float(np.finfo(float).max)
_LARGEST_ANGLE = 1e5  # [rad] as for sine and cosine


def _increasing(a: Ends, function: Callable[[Array], Array], *, fixed: float, least: float = -np.inf) -> Ends:
    """Return the range of an increasing function with values ≥ `least` and the exact value `function(fixed)`."""
    low, high = function(a[0]), function(a[1])
    # an overflow at the lower end: the value is at least the largest double
    bottom, top = iv.widened((np.minimum(low, _LARGEST), np.maximum(high, -_LARGEST)))
    bottom, top = np.maximum(bottom, least), np.where(np.isnan(top), np.inf, top)
    return np.where(a[0] == fixed, low, bottom), np.where(a[1] == fixed, high, top)


def exp(a: Ends) -> Ends:
    """Return e^a."""
    return _increasing(a, np.exp, fixed=0.0, least=0.0)


def log(a: Ends) -> Ends:
    """Return the natural logarithm of the positive part of a."""
    return _increasing((np.maximum(a[0], 0.0), np.maximum(a[1], 0.0)), np.log, fixed=1.0)


def sinh(a: Ends) -> Ends:
    """Return the hyperbolic sine."""
    return _increasing(a, np.sinh, fixed=0.0)


def cosh(a: Ends) -> Ends:
    """Return the hyperbolic cosine, which increases with |a|."""
    return _increasing(iv.magnitude(a), np.cosh, fixed=0.0, least=1.0)


def tanh(a: Ends) -> Ends:
    """Return the hyperbolic tangent."""
    low, high = _increasing(a, np.tanh, fixed=0.0)
    return np.maximum(low, -1.0), np.minimum(high, 1.0)


def arcsine(a: Ends) -> Ends:
    """Return the arcsine of the part of a in [−1, 1]."""
    return _increasing((np.clip(a[0], -1.0, 1.0), np.clip(a[1], -1.0, 1.0)), np.arcsin, fixed=0.0)


def tan(a: Ends) -> Ends:
    """Return the tangent; the whole real line where a may contain a pole."""
    parts = []
    for end in a:
        low, high = iv.divide(iv.sine(iv.point(end)), iv.cosine(iv.point(end)))
        parts.append((np.where(end == 0, 0.0, low), np.where(end == 0, 0.0, high)))
    fine = _between_poles(a)
    return np.where(fine, parts[0][0], -np.inf), np.where(fine, parts[1][1], np.inf)


def _between_poles(a: Ends) -> NDArray[np.bool_]:
    # in half turns from pole to pole, widened for the rounding of the division
    low, high = a
    rounding = 1e-15 * (1.0 + np.abs(low) + np.abs(high))
    same = np.floor(low / np.pi + 0.5 - rounding) == np.floor(high / np.pi + 0.5 + rounding)
    fine: NDArray[np.bool_] = same & (np.maximum(np.abs(low), np.abs(high)) < _LARGEST_ANGLE)
    return fine


def powr(a: Ends, exponent: Fraction) -> Ends:
    """Return a^exponent for the nonnegative part of a; the whole real line for a negative exponent if a contains 0."""
    near = float(exponent)
    base = np.maximum(a[0], 0.0), np.maximum(a[1], 0.0)
    ends = base if exponent > 0 else (base[1], base[0])
    bottom, top = (np.power(end, near) for end in ends)
    # the exponent is off by half a unit: the power is off by |exponent ln x| half units
    steps = iv.LIBM_STEPS + 2.0 * (Fraction(near) != exponent) * np.maximum(*(np.abs(_logs(end, near)) for end in base))
    low, high = np.minimum(bottom, _LARGEST), np.maximum(top, 0.0)
    low, high = iv.widened((low, high), steps)
    for end, value in ((0.0, 0.0), (1.0, 1.0)):
        low, high = np.where(ends[0] == end, value, low), np.where(ends[1] == end, value, high)
    wild = (exponent < 0) & (a[0] <= 0)
    return np.where(wild, -np.inf, np.maximum(low, 0.0)), np.where(wild, np.inf, high)


def _logs(x: Array, exponent: float) -> Array:
    # exponent ln x, at most ±745 where the power is a double
    return np.clip(exponent * np.log(np.maximum(x, 5e-324)), -1e3, 1e3)


def defined(op: str, args: Sequence[Ends], exponent: Fraction) -> NDArray[np.bool_]:
    """Return for each interval whether an operation is defined on all of it; `exponent` is that of `pow` and `powr`."""
    low, high = args[-1]
    fine = np.ones(low.shape, dtype=bool)
    match op:
        case "div":
            fine = (low > 0) | (high < 0)
        case "pow" if exponent < 0:
            fine = (low > 0) | (high < 0)
        case "atan2":
            fine = np.logical_or.reduce([(below > 0) | (above < 0) for below, above in args])
        case "exp":
            fine = high <= LARGEST_EXPONENT
        case "sinh" | "cosh":
            fine = (low >= -LARGEST_EXPONENT) & (high <= LARGEST_EXPONENT)
        case "log":
            fine = low > 0
        case "sqrt":
            fine = low >= 0
        case "asin" | "acos":
            fine = (low >= -1) & (high <= 1)
        case "tan":
            fine = _between_poles(args[-1])
        case "powr":
            fine = low >= 0 if exponent > 0 else low > 0
    certain: NDArray[np.bool_] = fine
    return certain
