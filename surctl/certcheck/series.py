"""Signs of functions of one variable on an interval, by Taylor expansion with an enclosed remainder.

The Taylor coefficients of an expression follow from those of its operands by recurrences: those of sin, for instance,
from sin' = cos · argument'. A function whose first j coefficients at a point are exactly 0 is (t − t0)^j times a second
function, whose sign is known if its range does not contain 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from functools import cache
from typing import Any

from mpmath import libmp

from surctl.certcheck.angles import BITS, pi
from surctl.certcheck.document import Rejected
from surctl.certcheck.enclosure import Interval, Undefined, above, enclose, exact, minus, mul, over, plus, rational
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.patience import afford, go_on

__all__ = ["same_sign"]

Series = list[Any]
"""The Taylor coefficients, each an interval."""

_ORDER = 6
_PIECES = 600
_SIZE = 3000  # memory of a series [bytes]
_ZERO, _ONE = rational(Fraction(0)), rational(Fraction(1))
_AT_ZERO = {"sin": 0, "cos": 1, "exp": 1, "tan": 0, "tanh": 0, "atan": 0, "asin": 0}
_UNARY = ("acos", "asin", "atan", "cos", "exp", "log", "sin", "sqrt", "tan", "tanh")


def same_sign(table: ExpressionTable, roots: Sequence[int], ends: Interval) -> bool:
    """Return whether the product of one or two expressions of one variable is shown to be ≥ 0 on an interval.

    Args:
        table: table of the expressions; it has one variable.
        roots: positions of the expressions.
        ends: the interval.
    """
    low, high = math.nextafter(_double(ends[0]), -math.inf), math.nextafter(_double(ends[1]), math.inf)
    waiting = [(low, 0.0), (0.0, high)] if low < 0 < high else [(low, high)]
    for _ in range(_PIECES):
        if not waiting:
            return True
        go_on()
        low, high = waiting.pop()
        sign = math.prod(_sign(table, root, low, high) for root in roots)
        if sign < 0:
            return False
        if not sign:
            middle = low / 2 + high / 2
            waiting += [(low, middle), (middle, high)]
    return False


def _double(x: Any) -> float:
    value = float(libmp.to_float(x))
    if not math.isfinite(value):
        raise Rejected("a fact is about an unbounded expression")
    return value


def _sign(table: ExpressionTable, root: int, low: float, high: float) -> int:
    """Return 1 if the expression is ≥ 0 on [low, high], −1 if it is ≤ 0, and 0 if neither is shown."""
    origin = low if low == 0 else high if high == 0 else min(max(low / 2 + high / 2, low), high)
    wide = exact(low)[0], exact(high)[1]
    try:
        at, on = _series(table, root, exact(origin)), _series(table, root, wide)
    except Undefined:
        return 0
    coefficients = [*at[:_ORDER], on[_ORDER]]
    zeros = 0
    while zeros < _ORDER and coefficients[zeros] == _ZERO:
        zeros += 1
    step = libmp.mpi_sub(wide, exact(origin), BITS)
    total = coefficients[-1]
    for c in reversed(coefficients[zeros:-1]):
        total = plus(c, mul(step, total))
    # if zeros is odd, (t − origin)^zeros has one sign only if the origin is an end of the interval
    if zeros % 2 and low < origin < high:
        return 0
    side = -1 if zeros % 2 and high == origin else 1
    if not libmp.mpf_lt(total[0], libmp.fzero):
        return side
    return -side if not libmp.mpf_gt(total[1], libmp.fzero) else 0


def _series(table: ExpressionTable, root: int, point: Interval) -> Series:
    known: dict[int, Series] = {}
    needed = table.needed([root])
    afford(_SIZE * len(needed))
    for at in needed:
        go_on()
        entry = table.entries[at]
        known[at] = _step(entry.op, entry.value, [known[a] for a in entry.args], point)
    return known[root]


def _step(op: str, value: Fraction, args: list[Series], point: Interval) -> Series:
    match op:
        case "num":
            return _constant(rational(value))
        case "pi":
            return _constant(pi())
        case "var":
            return [point, _ONE, *[_ZERO] * (_ORDER - 1)]
        case "add":
            return [plus(a, b) for a, b in zip(*args, strict=True)]
        case "sub":
            return [plus(a, minus(b)) for a, b in zip(*args, strict=True)]
        case "neg":
            return [minus(a) for a in args[0]]
        case "mul":
            return [_convolved(args[0], args[1], k) for k in range(_ORDER + 1)]
        case "div":
            return _quotient(args[0], args[1])
        case "pow":
            total = _constant(_ONE)
            for _ in range(abs(value.numerator)):
                total = [_convolved(total, args[0], k) for k in range(_ORDER + 1)]
            return total if value >= 0 else _quotient(_constant(_ONE), total)
    if op not in _UNARY:
        raise Rejected(f"a fact may not use the operation {op!r}")
    return _function(op, args[0])


def _constant(value: Interval) -> Series:
    return [value, *[_ZERO] * _ORDER]


def _convolved(a: Series, b: Series, k: int, first: int = 0, last: int | None = None) -> Interval:
    """Return Σ a_j b_(k − j) for j from `first` to `last`, or to k."""
    total = _ZERO
    for j in range(first, (k if last is None else last) + 1):
        total = plus(total, mul(a[j], b[k - j]))
    return total


def _quotient(a: Series, b: Series) -> Series:
    if not (above(b[0]) or libmp.mpf_lt(b[0][1], libmp.fzero)):
        raise Undefined("a division by an interval that contains 0")
    out: Series = []
    for k in range(_ORDER + 1):
        out.append(over(plus(a[k], minus(_convolved(out, b, k, last=k - 1))), b[0]))
    return out


def _function(op: str, a: Series) -> Series:
    first = _value(op, a[0])
    slope = [mul(rational(Fraction(j)), x) for j, x in enumerate(a)]  # coefficients of t · argument'
    if op in ("sin", "cos"):
        sine, cosine = [_value("sin", a[0])], [_value("cos", a[0])]
        for k in range(1, _ORDER + 1):
            sine.append(_share(_convolved(slope, cosine, k, 1), k))
            cosine.append(minus(_share(_convolved(slope, sine, k, 1), k)))
        return sine if op == "sin" else cosine
    out = [first]
    if op in ("exp", "tan", "tanh"):
        for k in range(1, _ORDER + 1):
            # exp' = exp, tan' = 1 + tan², tanh' = 1 − tanh²
            rate = list(out)
            if op != "exp":
                square = [_convolved(out, out, j) for j in range(k)]
                rate = [plus(_ONE if j == 0 else _ZERO, x if op == "tan" else minus(x)) for j, x in enumerate(square)]
            out.append(_share(_convolved(slope, rate, k, 1), k))
        return out
    if op == "sqrt":
        twice = mul(rational(Fraction(2)), first)
        if not above(first):
            raise Undefined("a root of an interval that contains 0")
        for k in range(1, _ORDER + 1):
            out.append(over(plus(a[k], minus(_convolved(out, out, k, 1, k - 1))), twice))
        return out
    # log' = 1 / t, atan' = 1 / (1 + t²), asin' = 1 / √(1 − t²): divide the slope by a series
    below = a
    if op != "log":
        square = [_convolved(a, a, j) for j in range(_ORDER + 1)]
        one = _constant(_ONE)
        below = [plus(x, y if op == "atan" else minus(y)) for x, y in zip(one, square, strict=True)]
        below = below if op == "atan" else _function("sqrt", below)
    rate = _quotient(slope, below)
    rest = [_share(x, k) for k, x in enumerate(rate) if k]
    return [first, *([minus(x) for x in rest] if op == "acos" else rest)]


def _share(x: Interval, k: int) -> Interval:
    return x if k == 1 or x == _ZERO else over(x, rational(Fraction(k)))


def _value(op: str, x: Interval) -> Interval:
    if x == _ZERO and op in _AT_ZERO:
        return rational(Fraction(_AT_ZERO[op]))
    table, at = _table(op)
    return enclose(table, [at], [x])[0].value


@cache
def _table(op: str) -> tuple[ExpressionTable, int]:
    table = ExpressionTable(["t"])
    return table, table.put(op, table.put("var", value=0))
