"""Interval enclosures of value, gradient and Hessian, computed together by forward-mode differentiation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from surctl.verification.proving import intervals as iv
from surctl.verification.proving.intervals import Ends


@dataclass(frozen=True, eq=False)
class Jet:
    """Enclosures of one quantity and of its derivatives on B boxes of n variables.

    Attributes:
        value: (B,) intervals that contain the quantity.
        slope: (n, B) intervals that contain the gradient; None if the gradient is not computed. At a kink the interval
            covers the slopes on both sides.
        bend: (n, n, B) intervals that contain the Hessian; None if the Hessian is not computed.
    """

    value: Ends
    slope: Ends | None = None
    bend: Ends | None = None

    def __add__(self, other: Jet) -> Jet:
        return self._linear(other, iv.add)

    def __sub__(self, other: Jet) -> Jet:
        return self._linear(other, iv.subtract)

    def __neg__(self) -> Jet:
        slope, bend = (None if part is None else iv.negate(part) for part in (self.slope, self.bend))
        return Jet(iv.negate(self.value), slope, bend)

    def __mul__(self, other: Jet) -> Jet:
        value = iv.multiply(self.value, other.value)
        if self.slope is None or other.slope is None:
            return Jet(value)
        slope = iv.add(iv.multiply(self.slope, other.value), iv.multiply(other.slope, self.value))
        if self.bend is None or other.bend is None:
            return Jet(value, slope)
        crossed = iv.multiply(_column(self.slope), _row(other.slope))
        turned = iv.multiply(_row(self.slope), _column(other.slope))
        own = iv.add(iv.multiply(self.bend, other.value), iv.multiply(other.bend, self.value))
        return Jet(value, slope, iv.add(own, iv.add(crossed, turned)))

    def through(self, value: Ends, first: Callable[[], Ends], second: Callable[[], Ends]) -> Jet:
        """Apply a function to this quantity, given the function's value, first and second derivative, each (B,)."""
        if self.slope is None:
            return Jet(value)
        slope = first()
        moved = iv.multiply(self.slope, slope)
        # for a variable the product with its slope 1 is exact: claims that are equalities at a point need that
        unit = (self.slope[0] == 1) & (self.slope[1] == 1)
        moved = np.where(unit, slope[0], moved[0]), np.where(unit, slope[1], moved[1])
        if self.bend is None:
            return Jet(value, moved)
        return Jet(value, moved, iv.add(iv.multiply(self.bend, slope), iv.multiply(self._outer(), second())))

    def power(self, exponent: int) -> Jet:
        """Return an integer power of this quantity, exponent ≥ 0."""
        n, x = exponent, self.value
        return self.through(
            iv.to_power(x, n),
            lambda: _times(n, iv.to_power(x, max(n - 1, 0))),
            lambda: _times(n * (n - 1), iv.to_power(x, max(n - 2, 0))),
        )

    def inverse(self) -> Jet:
        """Return the reciprocal of this quantity."""
        one = np.ones_like(self.value[0])
        value = iv.divide(iv.point(one), self.value)
        squared = iv.square(value)
        return self.through(value, lambda: iv.negate(squared), lambda: _times(2, iv.multiply(squared, value)))

    def angle(self, x: Jet) -> Jet:
        """Return atan2(y, x), where this quantity is y."""
        value = iv.atan2(self.value, x.value)
        if self.slope is None or x.slope is None:
            return Jet(value)
        length = iv.add(iv.square(x.value), iv.square(self.value))
        turn = iv.subtract(iv.multiply(self.slope, x.value), iv.multiply(x.slope, self.value))
        slope = iv.divide(turn, length)
        # the angle jumps across the negative x axis
        jump = (x.value[0] <= 0) & (self.value[0] <= 0) & (self.value[1] >= 0)
        slope = np.where(jump, -np.inf, slope[0]), np.where(jump, np.inf, slope[1])
        if self.bend is None or x.bend is None:
            return Jet(value, slope)
        crossed = iv.subtract(
            iv.multiply(_column(self.slope), _row(x.slope)), iv.multiply(_column(x.slope), _row(self.slope))
        )
        own = iv.subtract(iv.multiply(self.bend, x.value), iv.multiply(x.bend, self.value))
        growth = iv.add(iv.multiply(x.slope, x.value), iv.multiply(self.slope, self.value))
        loss = iv.multiply(_column(slope), _times(2, _row(growth)))
        return Jet(value, slope, iv.divide(iv.subtract(iv.add(own, crossed), loss), length))

    def magnitude(self) -> Jet:
        """Return the absolute value of this quantity."""
        low, high = self.value
        zero = np.zeros_like(low)
        return choose((low, high), iv.point(zero), -self, self, iv.magnitude(self.value))

    def larger(self, other: Jet) -> Jet:
        """Return the larger of the two quantities."""
        return choose(self.value, other.value, other, self, iv.hull_max(self.value, other.value))

    def smaller(self, other: Jet) -> Jet:
        """Return the smaller of the two quantities."""
        return choose(self.value, other.value, self, other, iv.hull_min(self.value, other.value))

    def _linear(self, other: Jet, rule: Callable[[Ends, Ends], Ends]) -> Jet:
        slope = None if self.slope is None or other.slope is None else rule(self.slope, other.slope)
        bend = None if self.bend is None or other.bend is None else rule(self.bend, other.bend)
        return Jet(rule(self.value, other.value), slope, bend)

    def _outer(self) -> Ends:
        # (n, n, B); the diagonal is not negative
        assert self.slope is not None
        outer = iv.multiply(_column(self.slope), _row(self.slope))
        squares = iv.square(self.slope)
        diagonal = np.eye(len(squares[0]), dtype=bool)[:, :, None]
        return np.where(diagonal, squares[0][None], outer[0]), np.where(diagonal, squares[1][None], outer[1])


def choose(a: Ends, b: Ends, x: Jet, y: Jet, value: Ends | None = None) -> Jet:
    """Return x on boxes where a ≤ b, y on boxes where a > b, and the interval hull of x and y on all other boxes.

    If `value` is given, the selected function is continuous, so its slope lies in the hull of both slopes. Without
    `value` the function may jump, and its slope is unbounded on a box that contains both cases. On such a box the
    Hessian is unbounded, with and without `value`.
    """
    first, second = a[1] <= b[0], a[0] > b[1]
    jumps = value is None

    def joined(p: Ends, q: Ends, *, wild: bool) -> Ends:
        low = np.where(first, p[0], np.where(second, q[0], -np.inf if wild else np.minimum(p[0], q[0])))
        high = np.where(first, p[1], np.where(second, q[1], np.inf if wild else np.maximum(p[1], q[1])))
        return low, high

    decided = joined(x.value, y.value, wild=False) if value is None else value
    if x.slope is None or y.slope is None:
        return Jet(decided)
    slope = joined(x.slope, y.slope, wild=jumps)
    if x.bend is None or y.bend is None:
        return Jet(decided, slope)
    return Jet(decided, slope, joined(x.bend, y.bend, wild=True))


def _column(a: Ends) -> Ends:
    return a[0][:, None], a[1][:, None]


def _row(a: Ends) -> Ends:
    return a[0][None], a[1][None]


def _times(factor: float, a: Ends) -> Ends:
    return iv.multiply(iv.point(np.full_like(a[0], factor)), a)
