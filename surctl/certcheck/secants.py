"""Ranges of secant slopes of functions of one variable, in interval arithmetic."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from functools import reduce
from itertools import pairwise
from typing import Any, TypeAlias

from mpmath import libmp

from surctl.certcheck.elementary import BITS, hull
from surctl.certcheck.enclosure import Interval, Undefined, above, greatest, least, minus, mul, over, plus, rational

__all__ = ["common", "fraction", "pieces", "secant"]

Function: TypeAlias = Callable[[Interval, int], tuple[Interval, Interval]]
"""Value and, with order 1, slope of a function on an interval."""

_PIECES, _HALVED = 24, 4  # parts of a range on each side of x* for a secant slope; halvings of the part next to x*
_FINE, _MOST_PARTS = 24, 12  # parts of x* as wide as the range, where x* has radii; most of them
_MOST_EXPONENT = 20_000  # of 2, in an end of a range
_NARROW = Fraction(1, 2**33)  # relative width of a number that counts as a point


def secant(function: Function, whole: Interval, rest: Interval) -> Interval:
    """Return the range of (g(t) − g(c))/(t − c), for t in `whole` and c in `rest`."""
    secants = []
    for c in _parts(rest, whole):
        value = function(c, 0)[0]
        secants += [_secant_on(function, piece, c, value) for piece in pieces(whole, c)]
    return reduce(hull, secants)


def pieces(ends: Interval, c: Interval) -> list[Interval]:
    """Return intervals that cover an interval; they are shorter near c, where the mean value theorem decides."""
    low, high = (fraction(end) for end in ends)
    if low == high:
        return [ends]
    middle = min(max((fraction(c[0]) + fraction(c[1])) / 2, low), high)
    steps = [Fraction(1, _PIECES * 2**k) for k in range(_HALVED, 0, -1)] + [
        Fraction(k, _PIECES) for k in range(1, _PIECES)
    ]
    below = [middle - (middle - low) * step for step in reversed(steps)]
    inside = [x for x in [*below, middle, *(middle + (high - middle) * step for step in steps)] if low < x < high]
    return list(pairwise([ends[0], *(rational(x)[0] for x in dict.fromkeys(inside)), ends[1]]))


def _parts(c: Interval, whole: Interval) -> list[Interval]:
    """Return intervals that cover c; they are short relative to `whole`."""
    low, high = (fraction(end) for end in c)
    width = fraction(whole[1]) - fraction(whole[0])
    if not width or (high - low) * _FINE <= width:
        return [c]
    count = min(_MOST_PARTS, math.ceil((high - low) * _FINE / width))
    inner = [rational(low + (high - low) * Fraction(k, count))[0] for k in range(1, count)]
    return list(pairwise([c[0], *inner, c[1]]))


def _secant_on(function: Function, piece: Interval, c: Interval, value: Interval) -> Interval:
    """Return the range of s = (g(t) − g(c))/(t − c) for t in `piece`."""
    between = function(hull(piece, c), 1)[1]  # the mean value theorem
    apart = libmp.mpi_sub(piece, c, BITS)
    if not (above(apart) or libmp.mpf_lt(apart[1], libmp.fzero)):
        return between
    at, own = function(piece, 1)
    secant = common(between, over(plus(at, minus(value)), apart))
    width = fraction(c[1]) - fraction(c[0])
    if width > _NARROW * max(
        abs(fraction(end)) for end in apart
    ):  # s_c = (s − g'(c))/(t − c), and s(c) = s(m) + s_c(γ)(c − m)
        m = rational((fraction(c[0]) + fraction(c[1])) / 2)
        bend = over(plus(secant, minus(function(c, 1)[1])), apart)
        first = _secant_on(function, piece, (m[0], m[0]), function((m[0], m[0]), 0)[0])
        return common(secant, plus(first, mul(bend, libmp.mpi_sub(c, (m[0], m[0]), BITS))))
    # s' = (g' − s)/(t − c), and s(t) = s(m) + s'(τ)(t − m)
    bend = over(plus(own, minus(secant)), apart)
    low, high = (fraction(end) for end in piece)
    middle = rational((low + high) / 2)
    first = over(plus(function(middle, 0)[0], minus(value)), libmp.mpi_sub(middle, c, BITS))
    return common(secant, plus(first, mul(bend, libmp.mpi_sub(piece, middle, BITS))))


def common(a: Interval, b: Interval) -> Interval:
    """Return the intersection of two intervals, both of which contain the same number."""
    return greatest(a, b)[0], least(a, b)[1]


def fraction(x: Any) -> Fraction:
    """Return one of mpmath's raw numbers as a fraction."""
    sign, man, exp, _ = x
    if x in (libmp.finf, libmp.fninf, libmp.fnan) or abs(exp) > _MOST_EXPONENT:
        raise Undefined("a slope that is unbounded, or too large or small to be written")
    return Fraction(-int(man) if sign else int(man)) * Fraction(2) ** int(exp)
