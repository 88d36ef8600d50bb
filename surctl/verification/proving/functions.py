"""Interval arithmetic of functions by NumPy's routines, for the prover: fast, with the errors that NumPy states.

Each function returns intervals for the part of `a` on which it is defined; `defined` says where it is defined on all of
`a`. Values at 0 and 1 that are exact stay exact, because claims often hold with equality there. The intervals are
widened by `LIBM_STEPS` units: the stated error is up to 4 units for NumPy's vector routines, and 1 unit for the C
libraries.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from types import MappingProxyType

import numpy as np

from surctl.certcheck import arrays as iv
from surctl.certcheck.arrays import Array, Ends, Flags

LIBM_STEPS = 8
"""Units in the last place by which results of NumPy's vector routines are widened: twice the 4 that NumPy allows."""

LARGEST_EXPONENT = 1e5
"""Largest argument of exp, sinh and cosh on which a proof may rely. Above 709 the upper end is infinite."""

_LARGEST = float(np.finfo(float).max)
_LARGEST_ANGLE = 1e5  # [rad] for larger angles the error of the argument reduction is not bounded here
_TINY = 5e-324


def widened(a: Ends, steps: float | Array = LIBM_STEPS) -> Ends:
    """Return the intervals with both ends moved outwards by `steps` units in the last place."""
    lower, upper = a
    # one unit is at most 2^-52 of the magnitude; the tiny term covers subnormal results
    slack_low, slack_high = steps * 2.0**-52 * np.abs(lower), steps * 2.0**-52 * np.abs(upper)
    return iv.down(lower - slack_low - steps * _TINY), iv.up(upper + slack_high + steps * _TINY)


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
    whole = iv.up(np.full_like(low, np.pi))
    return np.where(cut, -whole, low), np.where(cut, whole, high)


_MONOTONE: Mapping[str, tuple[np.ufunc, float, tuple[float, float], tuple[float, float]]] = MappingProxyType(
    {"exp": (np.exp, 0.0, (-np.inf, LARGEST_EXPONENT), (0.0, np.inf)),
     "log": (np.log, 1.0, (0.0, np.inf), (-np.inf, np.inf)),
     "sinh": (np.sinh, 0.0, (-LARGEST_EXPONENT, LARGEST_EXPONENT), (-np.inf, np.inf)),
     "cosh": (np.cosh, 0.0, (-LARGEST_EXPONENT, LARGEST_EXPONENT), (1.0, np.inf)),
     "tanh": (np.tanh, 0.0, (-np.inf, np.inf), (-1.0, 1.0)),
     "asin": (np.arcsin, 0.0, (-1.0, 1.0), (-np.inf, np.inf)),
     "acos": (np.arccos, 1.0, (-1.0, 1.0), (0.0, np.inf))}
)  # fmt: skip
"""Functions with their argument whose value is exact, and the ranges of arguments and values; cosh is one of |a|."""


def _monotone(op: str, a: Ends) -> Ends:
    function, fixed, domain, values = _MONOTONE[op]
    ends = np.clip(a[0], *domain), np.clip(a[1], *domain)
    first, last = iv.magnitude(ends) if op == "cosh" else ends[::-1] if op == "acos" else ends
    low, high = function(first), function(last)
    # an overflow at the lower end: the value is at least the largest double
    bottom, top = widened((np.minimum(low, _LARGEST), np.maximum(high, -_LARGEST)))
    bottom, top = np.maximum(bottom, values[0]), np.where(np.isnan(top), np.inf, np.minimum(top, values[1]))
    return np.where(first == fixed, low, bottom), np.where(last == fixed, high, top)


def tan(a: Ends) -> Ends:
    """Return the tangent; the whole real line where a may contain a pole."""
    parts = []
    for end in a:
        low, high = iv.divide(sine(iv.point(end)), cosine(iv.point(end)))
        parts.append((np.where(end == 0, 0.0, low), np.where(end == 0, 0.0, high)))
    fine = _between_poles(a)
    return np.where(fine, parts[0][0], -np.inf), np.where(fine, parts[1][1], np.inf)


def _between_poles(a: Ends) -> Flags:
    # in half turns from pole to pole, widened for the rounding of the division
    low, high = a
    rounding = 1e-15 * (1.0 + np.abs(low) + np.abs(high))
    same = np.floor(low / np.pi + 0.5 - rounding) == np.floor(high / np.pi + 0.5 + rounding)
    fine: Flags = same & (np.maximum(np.abs(low), np.abs(high)) < _LARGEST_ANGLE)
    return fine


def powr(a: Ends, exponent: Fraction) -> Ends:
    """Return a^exponent for the nonnegative part of a; the whole real line for a negative exponent if a contains 0."""
    near = float(exponent)
    base = np.maximum(a[0], 0.0), np.maximum(a[1], 0.0)
    ends = base if exponent > 0 else (base[1], base[0])
    bottom, top = (np.power(end, near) for end in ends)
    # the exponent is off by half a unit: the power is off by |exponent ln x| half units
    steps = LIBM_STEPS + 2.0 * (Fraction(near) != exponent) * np.maximum(*(np.abs(_logs(end, near)) for end in base))
    low, high = np.minimum(bottom, _LARGEST), np.maximum(top, 0.0)
    low, high = widened((low, high), steps)
    for end, value in ((0.0, 0.0), (1.0, 1.0)):
        low, high = np.where(ends[0] == end, value, low), np.where(ends[1] == end, value, high)
    wild = (exponent < 0) & (a[0] <= 0)
    return np.where(wild, -np.inf, np.maximum(low, 0.0)), np.where(wild, np.inf, high)


def _logs(x: Array, exponent: float) -> Array:
    # exponent ln x, at most ±745 where the power is a double
    return np.clip(exponent * np.log(np.maximum(x, 5e-324)), -1e3, 1e3)


def quick_functions(op: str, exponent: Fraction, args: Sequence[Ends]) -> tuple[Ends, Flags]:
    """Return the range of a function on intervals of its arguments, and where it is defined on all of them."""
    low, high = args[0]
    match op:
        case "sin" | "cos":
            return (sine if op == "sin" else cosine)(args[0]), np.ones(low.shape, dtype=bool)
        case "atan2":
            return atan2(*args), np.logical_or.reduce([(below > 0) | (above < 0) for below, above in args])
        case "tan":
            return tan(args[0]), _between_poles(args[0])
        case "powr":
            return powr(args[0], exponent), low >= 0 if exponent > 0 else low > 0
    least, most = _MONOTONE[op][2]
    return _monotone(op, args[0]), (low > least if op == "log" else low >= least) & (high <= most)
