"""Ranges of expressions on a box in intervals of mpmath's numbers, whose ends are rounded outward to 60 bits.

An interval is a pair of mpmath's raw numbers (tuples, not `mpf` objects). mpmath rounds sums, products, quotients,
integer powers and roots correctly; the other functions come from `surctl.certcheck.elementary`. For ranges of slopes,
and many boxes, there are intervals of doubles (`surctl.certcheck.jets`).
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import lru_cache
from math import inf, nextafter
from typing import Any

from mpmath import libmp

from surctl.certcheck.elementary import BITS, ELEMENTARY, Interval, Undefined, angle, circle, elementary, hull, pi
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.patience import afford, go_on

__all__ = [
    "Interval", "Undefined", "above", "decimal", "enclose", "exact", "greatest", "hull", "least", "middle", "outward",
    "rational", "span",
]  # fmt: skip

_SIZE = 450  # memory of an interval [bytes]
_ZERO = (libmp.fzero, libmp.fzero)
_ONE = (libmp.fone, libmp.fone)
_LINE = (libmp.fninf, libmp.finf)


def exact(x: float) -> Interval:
    """Return a double as an interval of zero width."""
    raw = libmp.from_float(x)
    return raw, raw


def span(low: float, high: float) -> Interval:
    """Return the interval [low, high], rounded outward to contain both the doubles and their printed decimals."""
    return _end(low)[0], _end(high)[1]


@lru_cache(8192)
def _end(x: float) -> Interval:
    """Return the interval between a double and its printed decimal."""
    raw = libmp.from_float(x)
    low, high = decimal(x)
    return raw if libmp.mpf_le(raw, low) else low, raw if libmp.mpf_ge(raw, high) else high


def decimal(x: float) -> Interval:
    """Return a narrow interval around the printed decimal of a double."""
    return rational(Fraction(repr(x)))


def rational(x: Fraction) -> Interval:
    """Return a narrow interval around a rational number."""
    return _quotient(x.numerator, x.denominator)


@lru_cache(1024)
def _quotient(p: int, q: int) -> Interval:
    return libmp.from_rational(p, q, BITS, "f"), libmp.from_rational(p, q, BITS, "c")


def above(a: Interval, bound: Any = libmp.fzero) -> bool:
    """Return whether every number in the interval a is greater than `bound`."""
    return bool(libmp.mpf_gt(a[0], bound))


def least(a: Interval, b: Interval) -> Interval:
    """Return the interval of min(a, b)."""
    return tuple(x if libmp.mpf_le(x, y) else y for x, y in zip(a, b, strict=True))


def greatest(a: Interval, b: Interval) -> Interval:
    """Return the interval of max(a, b)."""
    return tuple(x if libmp.mpf_ge(x, y) else y for x, y in zip(a, b, strict=True))


def middle(a: Interval) -> float:
    """Return about the middle of the interval a."""
    return float(libmp.to_float(a[0]) + libmp.to_float(a[1])) / 2


def outward(a: Interval) -> tuple[float, float]:
    """Return doubles that enclose an interval."""
    low, high = (float(libmp.to_float(end)) for end in a)
    return (
        low if libmp.from_float(low) == a[0] else nextafter(low, -inf),
        high if libmp.from_float(high) == a[1] else nextafter(high, inf),
    )


def plus(a: Interval, b: Interval) -> Interval:
    """Return the interval a + b."""
    return libmp.mpi_add(a, b, BITS)


def mul(a: Interval, b: Interval) -> Interval:
    """Return the interval a · b; 0 times an unbounded interval is 0."""
    if a == _ZERO or b == _ZERO:
        return _ZERO
    if libmp.finf in (*a, *b) or libmp.fninf in (*a, *b):
        return _LINE
    return libmp.mpi_mul(a, b, BITS)


def over(a: Interval, b: Interval) -> Interval:
    """Return the interval a / b; it is the whole real line if b contains 0 or if a or b is unbounded."""
    if not (above(b) or libmp.mpf_lt(b[1], libmp.fzero)) or libmp.finf in (*a, *b) or libmp.fninf in (*a, *b):
        return _LINE
    return libmp.mpi_div(a, b, BITS)


def enclose(expressions: ExpressionTable, roots: Sequence[int], box: Sequence[Interval]) -> list[Interval]:
    """Return the ranges of expressions on a box.

    Raises:
        Undefined: an operation in one of the expressions is not defined on the whole box.
    """
    known: dict[int, Interval] = {}
    needed = expressions.needed(roots)
    afford(_SIZE * len(needed))
    for k, at in enumerate(needed):
        if k % 64 == 0:
            go_on()
        entry = expressions.entries[at]
        known[at] = _step(entry.op, entry.value, [known[a] for a in entry.args], entry.args, box)
    return [known[r] for r in roots]


def _step(op: str, value: Fraction, args: list[Interval], at: tuple[int, ...], box: Sequence[Interval]) -> Interval:
    match op:
        case "num":
            return rational(value)
        case "pi":
            return pi()
        case "var":
            return box[value.numerator]
        case "add":
            return plus(args[0], args[1])
        case "sub":
            return plus(args[0], libmp.mpi_neg(args[1]))
        case "neg":
            return libmp.mpi_neg(args[0])
        case "mul":
            return libmp.mpi_pow_int(args[0], 2, BITS) if at[0] == at[1] else mul(args[0], args[1])
        case "div":
            return mul(args[0], _reciprocal(args[1]))
        case "pow":
            power = _ONE if not value else libmp.mpi_pow_int(args[0], abs(value.numerator), BITS)
            return power if value >= 0 else _reciprocal(power)
        case _ if op in ELEMENTARY:
            return elementary(op, args[0], value)
        case "cos" | "sin":
            return _circle(args[0])[op == "sin"]
        case "atan2" | "atan":
            return _angle(args[0], args[1] if op == "atan2" else _ONE)
        case "abs":
            return libmp.mpi_abs(args[0], BITS)
        case "min":
            return least(args[0], args[1])
        case "max":
            return greatest(args[0], args[1])
        case "select":
            a, b, x, y = args
            return x if libmp.mpf_le(a[1], b[0]) else y if libmp.mpf_gt(a[0], b[1]) else hull(x, y)
    raise Undefined(f"the operation {op!r} is not known")


def _reciprocal(a: Interval) -> Interval:
    if _has_zero(a):
        raise Undefined("a division by an interval that contains 0")
    return libmp.mpi_div(_ONE, a, BITS)


def _has_zero(a: Interval) -> bool:
    return not (above(a) or libmp.mpf_lt(a[1], libmp.fzero))


_circle = lru_cache(1024)(circle)  # neighbouring boxes share the ranges of most of their variables


def _angle(y: Interval, x: Interval) -> Interval:
    if _has_zero(x) and _has_zero(y):
        raise Undefined("an atan2 of a box that contains (0, 0)")
    jumps = _has_zero(y) and not above(x)
    return (libmp.mpf_neg(pi()[1]), pi()[1]) if jumps else angle(y, x)
