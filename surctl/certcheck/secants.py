"""Ranges of secant slopes of functions of one variable, in intervals of doubles."""

from __future__ import annotations

import math
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
from mpmath import libmp

from surctl.certcheck import arrays as iv
from surctl.certcheck.arrays import Ends
from surctl.certcheck.enclosure import Interval, Undefined, greatest, least, outward
from surctl.certcheck.jets import Tape, as_interval

__all__ = ["common", "fraction", "pieces", "secant", "slopes_on"]

_PIECES, _HALVED = 24, 4  # parts of a range on each side of x* for a secant slope; halvings of the part next to x*
_FINE, _MOST_PARTS = 24, 12  # parts of x* as wide as the range, where x* has radii; most of them
_MOST_EXPONENT = 20_000  # of 2, in an end of a range
_NARROW = 2.0**-33  # relative width of a number that counts as a point


def secant(function: Tape, whole: Interval, rest: Interval) -> Interval:
    """Return the range of (g(t) − g(c))/(t − c), for t in `whole` and c in `rest`."""
    low, high = outward(rest)
    first, last = outward(whole)
    if not math.isfinite(high - low + last - first):
        raise Undefined("a slope that is unbounded")
    # parts that cover c and are short relative to `whole`
    count = max(1, min(_MOST_PARTS, math.ceil((high - low) * _FINE / (last - first)))) if last > first else 1
    cuts = [low, *(low + (high - low) * k / count for k in range(1, count)), high]
    with np.errstate(all="ignore"):
        ends = [_secants(function, pieces(whole, c), c) for c in pairwise(cuts)]
    return as_interval((np.hstack([one[0] for one in ends]), np.hstack([one[1] for one in ends])))


def pieces(whole: Interval, c: tuple[float, float]) -> Ends:
    """Return intervals (1, B) that cover an interval; they are shorter near c, where the mean value theorem decides."""
    low, high = outward(whole)
    middle = min(max(c[0] / 2 + c[1] / 2, low), high)
    steps = np.array([0.0, *(0.5**k / _PIECES for k in range(_HALVED, 0, -1)), *np.arange(1, _PIECES) / _PIECES])
    inside = np.unique([*(middle - (middle - low) * steps), *(middle + (high - middle) * steps)])
    cuts = np.array([low, *inside[(low < inside) & (inside < high)], high])
    return cuts[None, :-1], cuts[None, 1:]


def _secants(function: Tape, t: Ends, c: tuple[float, float]) -> Ends:
    """Return the range of s = (g(t) − g(c))/(t − c) for each piece t (1, B)."""
    own = np.array([[c[0]]]), np.array([[c[1]]])
    m = iv.point(own[0] / 2 + own[1] / 2)
    [at_c], [jet] = function.everywhere(own, order=1), function.everywhere(t, order=1)
    assert at_c.slope is not None and jet.slope is not None
    apart = iv.subtract(t, own)
    between = slopes_on(function, (np.minimum(t[0], c[0]), np.maximum(t[1], c[1])))
    secants = _common(between, iv.divide(iv.subtract(jet.value, at_c.value), apart))
    if c[1] - c[0] > _NARROW * max(np.abs(end).max() for end in apart):
        # s_c = (s − g'(c))/(t − c), and s(c) = s(m) + s_c(γ)(c − m)
        bend = iv.divide(iv.subtract(secants, at_c.slope), apart)
        first = _secants(function, t, (m[0].item(), m[0].item()))
        return _common(secants, iv.add(first, iv.multiply(bend, iv.subtract(own, m))))
    # s' = (g' − s)/(t − c), and s(t) = s(m) + s'(τ)(t − m)
    middle = iv.point(t[0] / 2 + t[1] / 2)
    [at_middle] = function.everywhere(middle)
    bend = iv.divide(iv.subtract(jet.slope, secants), apart)
    first = iv.divide(iv.subtract(at_middle.value, at_c.value), iv.subtract(middle, own))
    return _common(secants, iv.add(first, iv.multiply(bend, iv.subtract(t, middle))))


def slopes_on(function: Tape, t: Ends) -> Ends:
    """Return the range of the slopes on each piece (1, B), which bounds secant slopes by the mean value theorem.

    Below and above 0, the slopes of a function with a kink there, such as t |t|, have narrower ranges.
    """

    def own(part: Ends) -> Ends:
        [jet] = function.everywhere(part, order=1)
        assert jet.slope is not None
        return jet.slope

    across = (t[0] < 0) & (t[1] > 0)
    if not across.any():
        return own(t)
    below, above = own((t[0], np.where(across, 0.0, t[1]))), own((np.where(across, 0.0, t[0]), t[1]))
    return np.minimum(below[0], above[0]), np.maximum(below[1], above[1])


def _common(a: Ends, b: Ends) -> Ends:
    return np.maximum(a[0], b[0]), np.minimum(a[1], b[1])


def common(a: Interval, b: Interval) -> Interval:
    """Return the intersection of two intervals, both of which contain the same number."""
    return greatest(a, b)[0], least(a, b)[1]


def fraction(x: Any) -> Fraction:
    """Return one of mpmath's raw numbers as a fraction."""
    sign, man, exp, _ = x
    if x in (libmp.finf, libmp.fninf, libmp.fnan) or abs(exp) > _MOST_EXPONENT:
        raise Undefined("a slope that is unbounded, or too large or small to be written")
    return Fraction(-int(man) if sign else int(man)) * Fraction(2) ** int(exp)
