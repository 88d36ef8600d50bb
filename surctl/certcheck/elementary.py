"""Ranges of the checker's elementary functions on intervals, by the ball arithmetic of FLINT.

At a number, FLINT (Arb) encloses the value of a function with a proved error bound (Johansson, IEEE Transactions on
Computers 66 (8), 2017). Both ends of an enclosure are rounded outward to 60 bits. On an interval, the values at its
ends decide, as each function is monotone between known points. At the arguments 0 and 1 the functions return exact
values, because claims often hold with equality there.

The ends of an interval are raw numbers of mpmath (tuples, not `mpf` objects). A range is None if it has no finite bound
here: its argument or its logarithm exceeds 2^20, or is infinite.
"""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache
from typing import Any

from flint import arb, ctx, fmpq
from mpmath import libmp

__all__ = [
    "BITS", "ELEMENTARY", "PRECISION", "Interval", "Undefined", "angle", "circle", "elementary", "hull", "pi",
    "real_power", "tangent",
]  # fmt: skip

Interval = Any
"""The pair (lower end, upper end) of an interval, as raw numbers of mpmath."""
Raw = Any

BITS = 60
"""Precision of the ends of an interval [bits]."""

PRECISION = 160
"""Precision of FLINT's balls [bits]; for large arguments of functions, the bits after the point."""

ELEMENTARY = ("acos", "asin", "cosh", "exp", "log", "powr", "sinh", "sqrt", "tan", "tanh")
"""The operations of `elementary`; `powr` is the power with a fractional exponent."""

_FAR = 1100  # above 2^_FAR the bounds of a sine are ±1
_LARGEST = 20  # |x| < 2^_LARGEST for an exponential
_TINY_POWER = libmp.mpf_shift(libmp.fone, -(1 << _LARGEST))  # more than e^x for x ≤ -2^_LARGEST
_UNIT = (libmp.fnone, libmp.fone)


class Undefined(Exception):
    """Error for an operation that is not defined on the whole interval of its operand."""


def hull(a: Interval, b: Interval) -> Interval:
    """Return the smallest interval that contains two intervals."""
    low = a[0] if libmp.mpf_le(a[0], b[0]) else b[0]
    return low, a[1] if libmp.mpf_ge(a[1], b[1]) else b[1]


# ---- functions at numbers


def _magnitude(x: Raw) -> int:
    """Return n with 2^(n−1) ≤ |x| < 2^n, for x ≠ 0."""
    return int(x[2] + x[3])


def _bounded(a: Interval) -> bool:
    # infinities and NaN have the mantissa 0
    return all(end[1] or end == libmp.fzero for end in a)


def _ball(x: Raw) -> arb:
    """Return a number as a ball without radius."""
    if not _bounded((x,)):
        raise Undefined("a function of an unbounded interval")
    return arb((-int(x[1]) if x[0] else int(x[1]), int(x[2])))


def _ends(ball: arb) -> Interval | None:
    if not ball.is_finite():
        return None
    (low, below), (high, above) = ball.lower().man_exp(), ball.upper().man_exp()
    return (
        libmp.from_man_exp(int(low), int(below), BITS, "f"),
        libmp.from_man_exp(int(high), int(above), BITS, "c"),
    )


@lru_cache(8192)
def _at(function: str, *x: Raw) -> Interval:
    """Return the range of one of FLINT's functions at numbers; None if it has no finite bound."""
    with ctx.workprec(PRECISION + min(max(0, *map(_magnitude, x)), _FAR)):
        return _ends(getattr(arb, function)(*map(_ball, x)))


@lru_cache(8192)
def _power_of(x: Raw, exponent: Fraction) -> Interval | None:
    if x in (libmp.fzero, libmp.fone):
        return x, x
    with ctx.workprec(PRECISION):
        logarithm = _ball(x).log() * fmpq(exponent.numerator, exponent.denominator)
        if not abs(logarithm) < 1 << _LARGEST:
            return (libmp.fzero, _TINY_POWER) if logarithm < 0 else None
        return _ends(logarithm.exp())


@lru_cache(8192)
def _quarters(x: Raw) -> tuple[int, int]:
    """Return bounds on the number ⌊x/(π/2)⌋ of quarter turns; they differ only next to a multiple of π/2."""
    with ctx.workprec(PRECISION + max(0, _magnitude(x))):
        turns = 2 * _ball(x) / arb.pi()
        low, high = (end.floor().man_exp() for end in (turns.lower(), turns.upper()))
        return int(low[0]) << int(low[1]), int(high[0]) << int(high[1])


# ---- functions on intervals


def pi() -> Interval:
    """Return a narrow interval that contains π."""
    return _PI


with ctx.workprec(PRECISION):
    _PI = _ends(arb.pi())


def _is_far(a: Interval) -> bool:
    return not _bounded(a) or any(_magnitude(end) > _FAR for end in a)


def _monotone(name: str, a: Interval) -> Interval | None:
    """Return the range of an increasing function: from the lower end at a's lower end to the upper end at its upper."""
    if not _bounded(a):
        return None
    low, high = _at(name, a[0]), _at(name, a[1])
    return None if low is None or high is None else (low[0], high[1])


def _within(a: Interval, low: Raw, high: Raw) -> Interval:
    """Return the part of an interval from `low` to `high`."""
    return a[0] if libmp.mpf_ge(a[0], low) else low, a[1] if libmp.mpf_le(a[1], high) else high


def circle(a: Interval) -> tuple[Interval, Interval]:
    """Return the ranges of cosine and sine on an interval.

    Cosine and sine are monotone between multiples of π/2. So their values at the ends of the interval, and the values 0
    and ±1 at the multiples of π/2 inside, give the ranges. A multiple next to an end may count as inside.
    """
    if _is_far(a):
        return _UNIT, _UNIT
    first, last = _quarters(a[0])[0], _quarters(a[1])[1]
    if last - first > 4:
        return _UNIT, _UNIT
    ranges = []
    for name in ("cos", "sin"):
        value = hull(_at(name, a[0]), _at(name, a[1]))
        for k in range(first + 1, last + 1) if a[0] != a[1] else ():
            if (k & 1) == (name == "sin"):
                one = libmp.fone if k & 3 < 2 else libmp.fnone
                value = hull(value, (one, one))
        ranges.append(_within(value, *_UNIT))
    return ranges[0], ranges[1]


def tangent(a: Interval) -> Interval | None:
    """Return the range of the tangent on an interval; None if the interval may contain a pole, or is too large.

    The branch of the tangent between two poles has the number ⌊(k + 1)/2⌋ for k quarter turns; on it, the tangent
    increases.
    """
    if _is_far(a) or (_quarters(a[0])[0] + 1) // 2 != (_quarters(a[1])[1] + 1) // 2:
        return None
    return _monotone("tan", a)


def angle(y: Interval, x: Interval) -> Interval:
    """Return the range of atan2(y, x) on a box without (0, 0) in which all y ≥ 0, all y < 0 or all x > 0.

    On such a box atan2 is smooth, because its jump lies outside the box. If y has one sign on the box, atan2 is
    monotone in x everywhere, and monotone in y at each end of the range of x. If y changes its sign, x is positive;
    then atan2 is monotone in y everywhere, and monotone in x at each end of the range of y. In both cases the values at
    the corners of the box give the range.
    """
    first, *others = {(a, b) for a in y for b in x}
    total = _at("atan2", *first)
    for corner in others:
        total = hull(total, _at("atan2", *corner))
    return total


def real_power(a: Interval, exponent: Fraction) -> Interval | None:
    """Return the range of x^exponent on an interval of numbers ≥ 0 (> 0 if the exponent is negative).

    Return None if the result exceeds e^(2^20). The power increases with x if the exponent is positive, and decreases
    otherwise.
    """
    if not _bounded(a):
        return None
    low, high = (_power_of(end, exponent) for end in (a if exponent > 0 else a[::-1]))
    return None if low is None or high is None else (low[0], high[1])


def _exponential(a: Interval) -> Interval | None:
    if not _bounded(a) or (_magnitude(a[1]) > _LARGEST and not a[1][0]):
        return None
    low, high = ((libmp.fzero, _TINY_POWER) if _magnitude(x) > _LARGEST else _at("exp", x) for x in a)
    return low[0], high[1]


def _hyperbolic(name: str, a: Interval) -> Interval | None:
    """Return the range of sinh or cosh; None if a number exceeds 2^20 in magnitude."""
    if not _bounded(a) or any(_magnitude(x) > _LARGEST for x in a):
        return None
    if name == "sinh":
        return _monotone(name, a)
    whole = _monotone(name, libmp.mpi_abs(a, BITS))  # cosh is even, and increases with |x|
    return _within(whole, libmp.fone, libmp.finf)


def elementary(op: str, x: Interval, exponent: Fraction) -> Interval:
    """Return the range of a function on an interval.

    Args:
        op: a name in `ELEMENTARY`.
        x: the interval.
        exponent: the exponent of `powr`; the other operations do not use it.

    Raises:
        Undefined: the function is not defined on the whole interval, or its values are too large.
    """
    match op:
        case "exp":
            return _known(_exponential(x), "an exponential of numbers above 2^20")
        case "log":
            if not libmp.mpf_gt(x[0], libmp.fzero):
                raise Undefined("a logarithm of an interval that contains numbers of at most 0")
            return _known(_monotone("log", x), "a logarithm of a number that is too large")
        case "sinh" | "cosh":
            return _known(_hyperbolic(op, x), f"a {op} of numbers above 2^20")
        case "tanh":
            return _within(_known(_monotone("tanh", x), "a tanh of an unbounded interval"), *_UNIT)
        case "tan":
            return _known(tangent(x), "a tangent of an interval that may contain a pole")
        case "asin" | "acos":
            if not (libmp.mpf_ge(x[0], libmp.fnone) and libmp.mpf_le(x[1], libmp.fone)):
                raise Undefined(f"an arc{op[1:]} of an interval that is not within [-1, 1]")
            low, high = x if op == "asin" else x[::-1]
            return _at(op, low)[0], _at(op, high)[1]
        case "powr":
            if libmp.mpf_lt(x[0], libmp.fzero):
                raise Undefined("a fractional power of an interval that contains negative numbers")
            if exponent < 0 and x[0] == libmp.fzero:
                raise Undefined("a negative power of an interval that contains 0")
            return _known(real_power(x, exponent), "a power that is too large")
        case "sqrt":
            if libmp.mpf_lt(x[0], libmp.fzero):
                raise Undefined("a root of an interval that contains negative numbers")
            return libmp.mpi_sqrt(x, BITS)
    raise Undefined(f"the operation {op!r} is not known")


def _known(a: Interval | None, trouble: str) -> Interval:
    if a is None:
        raise Undefined(trouble)
    return a
