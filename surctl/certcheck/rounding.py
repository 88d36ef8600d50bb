"""Bound of what the rounding of the exported code can change in an expression that its instruction list computes.

A proof is about real numbers. A list that adds a number and subtracts it again is the same expression in real numbers,
but in double precision a large number absorbs the other one. The errors of the operations are therefore bounded on the
box, one after the other, including overflow, underflow and comparisons that rounding may decide.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import hypot, inf, isfinite, sqrt
from typing import Any, TypeAlias

from mpmath import libmp

from surctl.certcheck.elementary import Undefined
from surctl.certcheck.enclosure import enclose, span
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.inequality import Box, halves
from surctl.certcheck.patience import go_on

__all__ = ["OVERFLOW", "SHARE", "STEP", "TINY", "propagated", "rounding_error"]

STEP = 2.0**-52  # largest relative error of an operation
_FUNCTIONS, _FUNCTION = ("sin", "cos", "tan", "atan2", "acos", "exp", "log", "tanh"), 4  # their largest error [STEP]
TINY = 2.0**-1074  # largest error of an operation whose result underflows
SHARE = 1e-6  # largest error of a result, relative to its largest value
_MOST = 256  # most parts of a box
OVERFLOW = 2.0**1000  # a number of the code is smaller

Real: TypeAlias = Any  # float or Fraction
Ends: TypeAlias = tuple[Real, Real]


def rounding_error(table: ExpressionTable, root: int, box: Box, constants: Mapping[int, float]) -> float:
    """Return a bound of the error of an expression on a box, in double precision; infinity if none is found.

    Args:
        table: the table of the expression.
        root: the expression.
        box: bounds of the variables.
        constants: errors of the numbers that a list computes from constants, by position.
    """
    worst, waiting = 0.0, [box]
    for _ in range(_MOST):
        if not waiting:
            return worst
        part = waiting.pop()
        go_on()
        error = _error(table, root, part, constants)
        if isfinite(error):
            worst = max(worst, error)
            continue
        waiting += halves(part, box)
    return inf


def _error(table: ExpressionTable, root: int, box: Box, constants: Mapping[int, float]) -> float:
    needed = table.needed([root])
    try:
        ranges = enclose(table, needed, [span(*ends) for ends in box])
    except Undefined:
        return inf
    errors: dict[int, float] = {}
    ends: dict[int, Ends] = {}
    for at, value in zip(needed, ranges, strict=True):
        entry = table.entries[at]
        low, high = ends[at] = libmp.to_float(value[0]), libmp.to_float(value[1])
        size = max(abs(low), abs(high))
        if not entry.args:
            errors[at] = constants.get(at, 0.0)
            continue
        error = float(propagated(entry.op, [errors[a] for a in entry.args], [ends[a] for a in entry.args], size))
        if entry.op not in ("abs", "max", "min", "neg", "select"):
            error += (_FUNCTION if entry.op in _FUNCTIONS else 1) * STEP * size + TINY
        errors[at] = error if size < OVERFLOW and error < OVERFLOW else inf
    return errors[root]


def propagated(op: str, errors: Sequence[Real], ends: Sequence[Ends], size: Real) -> Real:
    """Return a bound of what the errors of the operands change in the result of an exact operation.

    Args:
        op: the operation.
        errors: largest error of each operand.
        ends: bounds of each operand.
        size: largest absolute value of the result.
    """
    most = [max(abs(low), abs(high)) for low, high in ends]
    least = [0.0 if low <= 0.0 <= high else min(abs(low), abs(high)) for low, high in ends]
    if not any(errors):
        return 0.0
    match op:
        case "neg" | "abs" | "sin" | "cos" | "tanh" | "floor":
            return errors[0]
        case "add" | "sub":
            return errors[0] + errors[1]
        case "mul":
            return _times(most[0], errors[1]) + _times(most[1], errors[0]) + _times(*errors)
        case "div":
            return 2 * (errors[0] + _times(size, errors[1])) / least[1] if errors[1] < least[1] / 2 else inf
        case "sqrt":
            return min(sqrt(errors[0]), errors[0] / sqrt(least[0]) if errors[0] < least[0] / 2 else inf)
        case "acos":
            return 2 * sqrt(errors[0])
        case "exp":
            return 2 * size * errors[0] if errors[0] < 1 else inf
        case "log":
            return 2 * errors[0] / least[0] if errors[0] < least[0] / 2 else inf
        case "tan":  # tan(a + e) − tan a = (1 + tan² a) tan e/(1 − tan a tan e)
            return 4 * (1 + size * size) * errors[0] if errors[0] < 1 / (4 + 4 * size) else inf
        case "atan2":
            radius = hypot(*least)
            return 2 * sum(errors) / radius if sum(errors) < radius / 2 else inf
        case "max" | "min":
            return max(errors)
        case "select":
            (a, b), (c, d) = ends[:2]
            apart = b < c - sum(errors[:2]) or a > d + sum(errors[:2])
            decided = apart or sum(errors[:2]) <= SHARE * ((b - a) + (d - c))
            return max(errors[2:]) if decided else inf
    return inf


def _times(a: Real, b: Real) -> Real:
    return a * b if a and b else 0
