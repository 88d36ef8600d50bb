"""Operations with one notation for CasADi symbols and NumPy arrays, so that the rules of the tracker are written once.

Arithmetic and comparisons use the operators of the operands. This module contains the operations that Python cannot
overload for both CasADi symbols and NumPy arrays. Truth values come from comparisons; only `where`, `both`, `either`
and `no` take truth values as arguments.
"""

from __future__ import annotations

from typing import Any, Protocol, TypeAlias

import casadi as ca
import numpy as np

__all__ = ["NUMBERS", "SYMBOLS", "Elementwise", "Value"]

Value: TypeAlias = Any
"""An SX column (n, 1) or an array (..., n); a float stands for n equal numbers."""


class Elementwise(Protocol):
    """Operations on values, element by element."""

    def where(self, condition: Value, yes: Value, other: Value) -> Value:
        """Return `yes` where the condition holds, otherwise `other`; `yes` and `other` must be finite."""

    def both(self, *conditions: Value) -> Value:
        """Return a truth value: whether all conditions hold."""

    def either(self, *conditions: Value) -> Value:
        """Return a truth value: whether at least one condition holds."""

    def no(self, condition: Value) -> Value:
        """Return a truth value: whether the condition does not hold."""

    def least(self, *values: Value) -> Value:
        """Return the smallest of the values."""

    def most(self, *values: Value) -> Value:
        """Return the largest of the values."""

    def size(self, value: Value) -> Value:
        """Return the absolute value."""

    def root(self, value: Value) -> Value:
        """Return the square root of a value that is at least 0."""

    def floor(self, value: Value) -> Value:
        """Return the largest whole number that is not above the value."""

    def turned(self, value: Value, by: int) -> Value:
        """Return the elements (sensors) rotated by `by` places: new element i is old element i + by."""


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
