"""The operations of the instruction list: for each, its number of operands, its NumPy function, and its C99 text.

IEEE 754 defines the value of every operation to the last bit, except for the operations in `LIBM`. So every back end
computes the same bytes. `fma` is a product and a sum with one rounding. Operations return 1 for true and 0 for false,
and treat any nonzero number as true (also a NaN, as in C).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["LEAVES", "LIBM", "OPERATIONS", "SUBSTITUTES", "Operation"]

Value = NDArray[np.floating[Any]]  # () or (batch,), of the replay's dtype

LEAVES = frozenset({"const", "input"})
"""Instructions without operands: `const` has a `value`; `args` of `input` are the indices of input and entry."""


@dataclass(frozen=True)
class Operation:
    """One operation of the instruction list.

    Attributes:
        name: name in the instruction list: CasADi's name in lower case, or `select`.
        arity: number of operands.
        numpy: NumPy function that performs the operation on arrays of one dtype; a bool result represents 0 and 1.
        c99: C expression with {0}, {1}, … for the operands, which are identifiers.
        commutative: whether the operands can be swapped without a change of any bit of a finite result.
    """

    name: str
    arity: int
    numpy: Callable[..., Any]
    c99: str
    commutative: bool = False


def _select(condition: Value, then: Value, otherwise: Value) -> Any:
    return np.where(condition != 0, then, otherwise)


def _if_else_zero(condition: Value, then: Value) -> Any:
    return np.where(condition != 0, then, np.zeros_like(then))


def _fmin(a: Value, b: Value) -> Any:
    # not np.fmin: for signed zeros and NaN the result must be that of the C text
    return np.where(b < a, b, a)


def _fmax(a: Value, b: Value) -> Any:
    return np.where(a < b, b, a)


def _fma(a: Value, b: Value, c: Value) -> Any:
    single = np.result_type(a, b, c) == np.float32
    return np.frompyfunc(_fma_single if single else _fma_double, 3, 1)(a, b, c)


def _fma_double(*operands: Any) -> float:
    # rational numbers: slow, but the only rounding is the last step, for every double
    a, b, c = map(float, operands)
    if not (math.isfinite(a) and math.isfinite(b)) or (c == 0.0 and 0.0 in (a, b)):
        return a * b + c
    if not math.isfinite(c):  # a b must not overflow to the opposite infinity
        return c
    exact = Fraction(a) * Fraction(b) + Fraction(c)
    try:
        return float(exact)
    except OverflowError:
        return math.inf if exact > 0 else -math.inf


def _fma_single(a: Any, b: Any, c: Any) -> float:
    once = _fma_double(a, b, c)
    if math.isfinite(once):  # a second rounding errs if the double lies midway between floats; its last bit decides
        lost = Fraction(float(a)) * Fraction(float(b)) + Fraction(float(c)) - Fraction(once)
        if lost and not np.float64(once).view(np.int64) & 1:
            once = math.nextafter(once, math.copysign(math.inf, lost))
    return once


_TABLE = (
    Operation("add", 2, lambda a, b: a + b, "{0} + {1}", commutative=True),
    Operation("sub", 2, lambda a, b: a - b, "{0} - {1}"),
    Operation("mul", 2, lambda a, b: a * b, "{0} * {1}", commutative=True),
    Operation("div", 2, lambda a, b: a / b, "{0} / {1}"),
    Operation("fma", 3, _fma, "fma({0}, {1}, {2})"),
    Operation("neg", 1, lambda a: -a, "-{0}"),
    Operation("inv", 1, lambda a: 1.0 / a, "1.0 / {0}"),
    Operation("sq", 1, lambda a: a * a, "{0} * {0}"),
    Operation("twice", 1, lambda a: a + a, "{0} + {0}"),
    Operation("sqrt", 1, np.sqrt, "sqrt({0})"),
    Operation("fabs", 1, np.abs, "fabs({0})"),
    Operation("floor", 1, np.floor, "floor({0})"),
    Operation("fmin", 2, _fmin, "({1} < {0}) ? {1} : {0}"),
    Operation("fmax", 2, _fmax, "({0} < {1}) ? {1} : {0}"),
    Operation("lt", 2, lambda a, b: a < b, "({0} < {1}) ? 1.0 : 0.0"),
    Operation("le", 2, lambda a, b: a <= b, "({0} <= {1}) ? 1.0 : 0.0"),
    Operation("eq", 2, lambda a, b: a == b, "({0} == {1}) ? 1.0 : 0.0", commutative=True),
    Operation("ne", 2, lambda a, b: a != b, "({0} != {1}) ? 1.0 : 0.0", commutative=True),
    Operation(
        "and",
        2,
        lambda a, b: (a != 0) & (b != 0),
        "(({0} != 0.0) && ({1} != 0.0)) ? 1.0 : 0.0",
        commutative=True,
    ),
    Operation(
        "or",
        2,
        lambda a, b: (a != 0) | (b != 0),
        "(({0} != 0.0) || ({1} != 0.0)) ? 1.0 : 0.0",
        commutative=True,
    ),
    Operation("not", 1, lambda a: a == 0, "({0} == 0.0) ? 1.0 : 0.0"),
    Operation("if_else_zero", 2, _if_else_zero, "({0} != 0.0) ? {1} : 0.0"),
    Operation("select", 3, _select, "({0} != 0.0) ? {1} : {2}"),
    Operation("sin", 1, np.sin, "sin({0})"),
    Operation("cos", 1, np.cos, "cos({0})"),
    Operation("atan2", 2, np.arctan2, "atan2({0}, {1})"),
    Operation("acos", 1, np.arccos, "acos({0})"),
)

OPERATIONS: Mapping[str, Operation] = MappingProxyType({op.name: op for op in _TABLE})
"""The operations by name."""

LIBM = frozenset({"sin", "cos", "atan2", "acos"})
"""Operations whose last bits depend on the platform's mathematical library."""

SUBSTITUTES: Mapping[str, str] = MappingProxyType(
    {
        "asin": "write atan2(x, sqrt(1 - x*x))",
        "assertion": "check outside the law",
        "atan": "write atan2(x, 1)",
        "call": "build the inner function without never_inline",
        "ceil": "write -floor(-x)",
        "constpow": "multiply it out, or use sqrt",
        "copysign": "write if_else(y < 0, -fabs(x), fabs(x))",
        "exp": "approximate it by a polynomial or a rational function",
        "fmod": "write x - y*floor(x/y) (result has the sign of y)",
        "hypot": "write sqrt(x*x + y*y)",
        "log": "approximate it by a polynomial or a rational function",
        "monitor": "remove it",
        "parameter": "make it an input of the function",
        "pow": "multiply it out, or use sqrt",
        "printme": "remove it",
        "remainder": "write x - y*floor(x/y + 0.5)",
        "sign": "write if_else(x < 0, -1, if_else(x > 0, 1, 0))",
        "tan": "write sin(x)/cos(x)",
        "tanh": "write x/sqrt(1 + x*x) or a clamp",
    }
)
"""For operations that the instruction list does not support, the replacement that an error message suggests."""
