"""Interval arithmetic on one pair of doubles with outward rounding: sums, products and powers as in `intervals`."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from math import inf, isnan, nextafter, pi

from surctl.verification.formula import Node

Ends = tuple[float, float]

_LARGEST = sys.float_info.max


def enclosed(node: Node) -> Ends:
    """Return two doubles that enclose an exact number or π: the nearest double below and the nearest double above."""
    if node.op == "pi":
        return pi, nextafter(pi, 4.0)  # the double lies below π
    value = node.value
    try:
        near = float(value)
    except OverflowError:
        return (_LARGEST, inf) if value > 0 else (-inf, -_LARGEST)
    over, under = near.as_integer_ratio()
    above = over * value.denominator - value.numerator * under  # a comparison of fractions is slow
    low = near if above <= 0 else nextafter(near, -inf)
    return low, near if above >= 0 else nextafter(near, inf)


def applied(node: Node, args: Sequence[Ends], known: Mapping[str, Ends]) -> Ends | None:
    """Return the interval of an operation; None if the operation is not arithmetic, or may be undefined.

    Args:
        node: the operation.
        args: the intervals of its operands.
        known: the interval of each variable, by name.
    """
    match node.op:
        case "var":
            return known[node.name]
        case "num" | "pi":
            return enclosed(node)
        case "add":
            return _add(args[0], args[1])
        case "sub":
            return _add(args[0], _negated(args[1]))
        case "mul":
            # the product of equal factors is a square, which gives narrower intervals
            return _power(args[0], 2) if node.args[0] == node.args[1] else _multiply(args[0], args[1])
        case "div" if node.args[1].op == "num" and (args[1][0] > 0 or args[1][1] < 0):  # 1e-400 is between doubles
            return _multiply(args[0], _inverse(args[1]))
        case "neg":
            return _negated(args[0])
        case "pow" if node.value >= 0:
            return _power(args[0], node.value.numerator)
    return None


def _negated(a: Ends) -> Ends:
    return -a[1], -a[0]


def _add(a: Ends, b: Ends) -> Ends:
    low, high = a[0] + b[0], a[1] + b[1]
    # the rounding error of a sum is exact unless the sum overflows; the comparison is false for NaN
    part = low - a[0]
    if not (a[0] - (low - part)) + (b[0] - part) >= 0:
        low = nextafter(low, -inf)
    part = high - a[1]
    if not (a[1] - (high - part)) + (b[1] - part) <= 0:
        high = nextafter(high, inf)
    return -inf if isnan(low) else low, inf if isnan(high) else high


def _multiply(a: Ends, b: Ends) -> Ends:
    lows, highs = [], []
    for x in a:
        for y in b:
            if x == 0 or y == 0:
                lows.append(0.0)
                highs.append(0.0)
            else:
                lows.append(nextafter(x * y, -inf))
                highs.append(nextafter(x * y, inf))
    return min(lows), max(highs)


def _inverse(a: Ends) -> Ends:
    # 1 / a for an interval without 0
    return nextafter(1.0 / a[1], -inf), nextafter(1.0 / a[0], inf)


def _power(a: Ends, exponent: int) -> Ends:
    if exponent == 0:
        return 1.0, 1.0
    if exponent % 2:
        low, high = _repeated(abs(a[0]), exponent), _repeated(abs(a[1]), exponent)
        return -low[1] if a[0] < 0 else low[0], -high[0] if a[1] < 0 else high[1]
    small = 0.0 if a[0] <= 0 <= a[1] else min(abs(a[0]), abs(a[1]))
    return _repeated(small, exponent)[0], _repeated(max(abs(a[0]), abs(a[1])), exponent)[1]


def _repeated(x: float, exponent: int) -> Ends:
    """Return x^exponent for x ≥ 0."""
    low = high = x
    for _ in range(exponent - 1):
        low, high = max(nextafter(low * x, -inf), 0.0), nextafter(high * x, inf) if x else 0.0
    return low, high
