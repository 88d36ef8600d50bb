"""One rule, two lives: the few operations in which a rule can be written once for CasADi symbols and NumPy arrays.

Arithmetic and comparisons are the operands' own; what Python cannot overload for both stands here. Truth values come
from comparisons and go into `where`, `both`, `either` and `no` only.
"""

from __future__ import annotations

from typing import Any, Protocol, TypeAlias

import casadi as ca
import numpy as np

__all__ = ["NUMBERS", "SYMBOLS", "Elementwise", "Value"]

Value: TypeAlias = Any
"""An SX column (n, 1) or an array (..., n); a float where one number serves all."""


class Elementwise(Protocol):
    """Operations on values, element by element."""

    def where(self, condition: Value, yes: Value, other: Value) -> Value:
        """`yes` where the condition holds, else `other`; both must be finite."""

    def both(self, *conditions: Value) -> Value:
        """All of them hold."""

    def either(self, *conditions: Value) -> Value:
        """At least one of them holds."""

    def no(self, condition: Value) -> Value:
        """It does not hold."""

    def least(self, *values: Value) -> Value:
        """The smallest."""

    def most(self, *values: Value) -> Value:
        """The largest."""

    def size(self, value: Value) -> Value:
        """Its absolute value."""

    def root(self, value: Value) -> Value:
        """Its square root; of a value that is at least 0."""

    def floor(self, value: Value) -> Value:
        """The whole number below."""

    def turned(self, value: Value, by: int) -> Value:
        """The elements (sensors) shifted round by `by` places: element i becomes that of i + by."""


class _Symbols:
    def where(self, condition: Value, yes: Value, other: Value) -> Value:
        return ca.if_else(condition, yes, other)

    def both(self, *conditions: Value) -> Value:
        result = conditions[0]
        for other in conditions[1:]:
            result = ca.logic_and(result, other)
        return result

    def either(self, *conditions: Value) -> Value:
        result = conditions[0]
        for other in conditions[1:]:
            result = ca.logic_or(result, other)
        return result

    def no(self, condition: Value) -> Value:
        return ca.logic_not(condition)

    def least(self, *values: Value) -> Value:
        result = values[0]
        for other in values[1:]:
            result = ca.fmin(result, other)
        return result

    def most(self, *values: Value) -> Value:
        result = values[0]
        for other in values[1:]:
            result = ca.fmax(result, other)
        return result

    def size(self, value: Value) -> Value:
        return ca.fabs(value)

    def root(self, value: Value) -> Value:
        return ca.sqrt(value)

    def floor(self, value: Value) -> Value:
        return ca.floor(value)

    def turned(self, value: Value, by: int) -> Value:
        return ca.vertcat(value[by:], value[:by])


class _Numbers:
    def where(self, condition: Value, yes: Value, other: Value) -> Value:
        return np.where(condition, yes, other)

    def both(self, *conditions: Value) -> Value:
        result = conditions[0]
        for other in conditions[1:]:
            result = np.logical_and(result, other)
        return result

    def either(self, *conditions: Value) -> Value:
        result = conditions[0]
        for other in conditions[1:]:
            result = np.logical_or(result, other)
        return result

    def no(self, condition: Value) -> Value:
        return np.logical_not(condition)

    def least(self, *values: Value) -> Value:
        result = values[0]
        for other in values[1:]:
            result = np.minimum(result, other)
        return result

    def most(self, *values: Value) -> Value:
        result = values[0]
        for other in values[1:]:
            result = np.maximum(result, other)
        return result

    def size(self, value: Value) -> Value:
        return np.abs(value)

    def root(self, value: Value) -> Value:
        return np.sqrt(value)

    def floor(self, value: Value) -> Value:
        return np.floor(value)

    def turned(self, value: Value, by: int) -> Value:
        return np.roll(value, -by, axis=-1)


SYMBOLS: Elementwise = _Symbols()
NUMBERS: Elementwise = _Numbers()
