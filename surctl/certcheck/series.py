"""Signs of functions of one variable on an interval, by Taylor expansion with an enclosed remainder.

FLINT's power series over balls have the Taylor coefficients. A function whose first j coefficients at a point are
exactly 0 is (t − t0)^j times a second function, whose sign is known if its range does not contain 0.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import Any

from flint import arb, arb_series, ctx, fmpq
from mpmath import libmp

from surctl.certcheck.document import Rejected
from surctl.certcheck.elementary import PRECISION, Interval, Undefined
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.patience import afford, go_on

__all__ = ["same_sign"]

_ORDER = 6
_PIECES = 600
_SIZE = 1500  # memory of a series [bytes]
_OPERATIONS: Mapping[str, Callable[..., arb_series]] = {
    "add": operator.add, "sub": operator.sub, "mul": operator.mul, "div": operator.truediv, "neg": operator.neg,
    **{op: getattr(arb_series, op) for op in ("acos", "asin", "atan", "cos", "exp", "log", "sin", "sqrt", "tan")},
}  # fmt: skip


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
        with ctx.workprec(PRECISION):
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
    wide = arb(low).union(arb(high))
    try:
        coefficients = [*_series(table, root, arb(origin))[:_ORDER], _series(table, root, wide)[_ORDER]]
    except Undefined:
        return 0
    zeros = 0
    while zeros < _ORDER and coefficients[zeros] == 0:
        zeros += 1
    total = coefficients[-1]
    for c in reversed(coefficients[zeros:-1]):
        total = c + (wide - origin) * total
    # if zeros is odd, (t − origin)^zeros has one sign only if the origin is an end of the interval
    if zeros % 2 and low < origin < high:
        return 0
    side = -1 if zeros % 2 and high == origin else 1
    return side if total >= 0 else -side if total <= 0 else 0


def _series(table: ExpressionTable, root: int, point: arb) -> list[arb]:
    """Return the Taylor coefficients at all points of a ball; raise Undefined if there are none."""
    known: dict[int, arb_series] = {}
    needed = table.needed([root])
    afford(_SIZE * len(needed))
    try:
        for at in needed:
            go_on()
            entry = table.entries[at]
            known[at] = _step(entry.op, entry.value, [known[a] for a in entry.args], point)
    except (ValueError, ZeroDivisionError):
        raise Undefined("a division by an interval that contains 0") from None
    if known[root].prec <= _ORDER:  # coefficients that were cut off, by a smaller `ctx.cap`, would be read as 0
        raise Undefined("a series of too few terms")
    coefficients = [known[root][k] for k in range(_ORDER + 1)]
    if not all(c.is_finite() for c in coefficients):
        raise Undefined("a function that has no Taylor series on the whole interval")
    return coefficients


def _step(op: str, value: Fraction, args: list[arb_series], point: arb) -> arb_series:
    match op:
        case "num":
            return _constant(arb(fmpq(*value.as_integer_ratio())))
        case "pi":
            return _constant(arb.pi())
        case "var":
            return arb_series([point, 1], prec=_ORDER + 1)
        case "pow":
            power = math.prod([args[0]] * abs(value.numerator), start=_constant(arb(1)))
            return power if value >= 0 else _constant(arb(1)) / power
        case "tanh":
            return _constant(arb(1)) - _constant(arb(2)) / ((args[0] + args[0]).exp() + _constant(arb(1)))
    if op not in _OPERATIONS:
        raise Rejected(f"a fact may not use the operation {op!r}")
    return _OPERATIONS[op](*args)


def _constant(value: arb) -> arb_series:
    return arb_series([value], prec=_ORDER + 1)
