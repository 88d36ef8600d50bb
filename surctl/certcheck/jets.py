"""Ranges of expressions, their gradients and Hessians on many boxes at once, by forward-mode differentiation.

`Tape` evaluates the operations of a table in intervals of doubles (`surctl.certcheck.arrays`). Functions of a number
are computed by `exact_functions`: cosine and sine by their series, the others by `surctl.certcheck.enclosure`, one
interval at a time. The prover has faster ones, which rely on a library's bounds of its errors.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from mpmath import libmp

from surctl.certcheck import arrays as iv
from surctl.certcheck.arrays import Ends, Flags
from surctl.certcheck.derivative import along
from surctl.certcheck.enclosure import Interval, Undefined, enclose, outward
from surctl.certcheck.expressions import Entry, ExpressionTable
from surctl.certcheck.patience import afford, go_on

__all__ = [
    "Functions", "Jet", "Read", "Tape", "as_array", "as_interval", "choose", "exact_functions", "mean_value",
]  # fmt: skip


@dataclass(frozen=True, eq=False)
class Jet:
    """Enclosures of one quantity and of its derivatives on B boxes of n variables.

    Attributes:
        value: (B,) intervals that contain the quantity.
        slope: (n, B) intervals that contain the gradient; None if the gradient is not computed. At a kink the interval
            covers the slopes on both sides.
        bend: (n, n, B) intervals that contain the Hessian; None if the Hessian is not computed.
        flat: whether the quantity is a number, whose derivatives are exactly 0.
    """

    value: Ends
    slope: Ends | None = None
    bend: Ends | None = None
    flat: bool = False

    def __add__(self, other: Jet) -> Jet:
        value = iv.add(self.value, other.value)
        if self.flat or other.flat:
            inner = self if other.flat else other
            return Jet(value, inner.slope, inner.bend, inner.flat)
        slope = None if self.slope is None or other.slope is None else iv.add(self.slope, other.slope)
        return Jet(value, slope, None if self.bend is None or other.bend is None else iv.add(self.bend, other.bend))

    def __sub__(self, other: Jet) -> Jet:
        return self + -other

    def __neg__(self) -> Jet:
        slope, bend = (None if part is None else iv.negate(part) for part in (self.slope, self.bend))
        return Jet(iv.negate(self.value), slope, bend, self.flat)

    def __mul__(self, other: Jet) -> Jet:
        value = iv.multiply(self.value, other.value)
        if self.slope is None or other.slope is None:
            return Jet(value)
        if self.flat or other.flat:
            inner, factor = (self, other.value) if other.flat else (other, self.value)
            slope, bend = (None if part is None else iv.multiply(part, factor) for part in (inner.slope, inner.bend))
            return Jet(value, slope, bend, inner.flat)
        slope = iv.add(iv.multiply(self.slope, other.value), iv.multiply(other.slope, self.value))
        if self.bend is None or other.bend is None:
            return Jet(value, slope)
        crossed = iv.multiply(_column(self.slope), _row(other.slope))
        turned = crossed[0].swapaxes(0, 1), crossed[1].swapaxes(0, 1)
        own = iv.add(iv.multiply(self.bend, other.value), iv.multiply(other.bend, self.value))
        return Jet(value, slope, iv.add(own, iv.add(crossed, turned)))

    def through(self, value: Ends, first: Callable[[], Ends], second: Callable[[], Ends]) -> Jet:
        """Apply a function to this quantity, given the function's value, first and second derivative, each (B,)."""
        if self.slope is None or self.flat:
            return Jet(value, self.slope, self.bend, self.flat)
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

    def angle(self, x: Jet, value: Ends) -> Jet:
        """Return atan2(y, x) with a given range, where this quantity is y."""
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
    jumps = value is None
    first, second = a[1] <= b[0], a[0] > b[1] if jumps else a[0] >= b[1]

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


# Expressions on many boxes


Functions = Callable[[str, Fraction, Sequence[Ends]], tuple[Ends, Flags]]
"""Range of a function, from its name, exponent and arguments' intervals, and where it is defined on all of them."""


class Read(NamedTuple):
    """The result of evaluating expressions on B boxes.

    Attributes:
        jets: for each expression, the enclosures of its value and derivatives.
        defined: for each expression, whether all its operations are defined on the whole box (B,).
    """

    jets: tuple[Jet, ...]
    defined: tuple[Flags, ...]


@lru_cache(8192)
def _of_numbers(op: str, exponent: Fraction, *ends: float) -> tuple[float, float]:
    """Return the range of a function on one interval of each argument; (NaN, NaN) where it is not defined on it."""
    if not np.all(np.isfinite(ends)):
        return np.nan, np.nan
    table, root = _alone(op, exponent, len(ends) // 2)
    raw = [libmp.from_float(end) for end in ends]
    try:
        return outward(enclose(table, [root], [*zip(raw[::2], raw[1::2], strict=True)])[0])
    except Undefined:
        return np.nan, np.nan


@lru_cache(256)
def _alone(op: str, exponent: Fraction, count: int) -> tuple[ExpressionTable, int]:
    """Return a table with one operation of some variables, and its position."""
    table = ExpressionTable([f"t{k}" for k in range(count)])
    return table, table.put(op, *(table.put("var", value=k) for k in range(count)), value=exponent)


def exact_functions(op: str, exponent: Fraction, args: Sequence[Ends]) -> tuple[Ends, Flags]:
    """Return the ranges of a function on B intervals of its arguments, and where it is defined; see `Functions`."""
    if op in ("sin", "cos"):
        cosine, sine, known = iv.cosine_and_sine(args[0])
        low, high = cosine if op == "cos" else sine
    else:
        known = np.zeros(args[0][0].shape, dtype=bool)
        low, high = np.full(known.shape, np.nan), np.full(known.shape, np.nan)
    others = np.flatnonzero(~known)
    if others.size:
        ends = [end[others].tolist() for arg in args for end in arg]
        shown = np.array([_of_numbers(op, exponent, *each) for each in zip(*ends, strict=True)])
        low[others], high[others] = shown.T
    fine = ~np.isnan(low)
    return (np.where(fine, low, -np.inf), np.where(fine, high, np.inf)), fine


@lru_cache(256)
def _derivatives(op: str, exponent: Fraction, functions: Functions) -> list[Tape]:
    """Return the first and the second derivative of a function of one argument."""
    table, whole = _alone(op, exponent, 1)
    rates = [table.put("num", value=1)]
    first = along(table, whole, rates)
    return [Tape(table, (root,), functions) for root in (first, along(table, first, rates))]


@dataclass(frozen=True, eq=False)
class Tape:
    """Expressions of a table, to be evaluated on many boxes at once.

    Attributes:
        table: the table.
        roots: positions of the expressions in the table.
        functions: the ranges of functions.
    """

    table: ExpressionTable
    roots: tuple[int, ...]
    functions: Functions = exact_functions

    @cached_property
    def needed(self) -> Sequence[int]:
        """Positions of all operations of the expressions, operands first."""
        return self.table.needed(self.roots)

    @cached_property
    def total(self) -> bool:
        """Whether all operations are defined for all numbers."""
        return self.table.total(self.roots)

    @cached_property
    def _last(self) -> dict[int, int]:
        """For each operation, the last one that uses it, or −1 for an expression itself."""
        last = {a: at for at in self.needed for a in self.table.entries[at].args}
        return last | dict.fromkeys(self.roots, -1)

    def run(self, box: Ends, *, order: int = 0) -> Read:
        """Evaluate the expressions on boxes (n, B); return enclosures, with derivatives up to `order` ≤ 2."""
        n, count = box[0].shape
        jets: dict[int, Jet] = {}
        defined: dict[int, Flags] = {}
        everywhere = np.ones(count, dtype=bool)
        with np.errstate(all="ignore"):
            for at in self.needed:
                go_on()
                entry = self.table.entries[at]
                jets[at], fine = self._step(entry, [jets[a] for a in entry.args], box, order)
                afford(16 * count * len(jets) * max(n, 1) ** order)
                if not self.total:
                    for a in entry.args:
                        fine = defined[a] if fine is None else fine & defined[a]
                    defined[at] = everywhere if fine is None else fine
                for a in {a for a in entry.args if self._last[a] == at}:
                    del jets[a]
        return Read(tuple(jets[r] for r in self.roots), tuple(defined.get(r, everywhere) for r in self.roots))

    def everywhere(self, box: Ends, *, order: int = 0) -> tuple[Jet, ...]:
        """Return the enclosures on boxes; raise Undefined unless the expressions are defined on all of them."""
        read = self.run(box, order=order)
        if not all(fine.all() for fine in read.defined):
            raise Undefined("an operation that is not defined on its whole range")
        return read.jets

    def _step(self, entry: Entry, args: list[Jet], box: Ends, order: int) -> tuple[Jet, Flags | None]:
        """Return the enclosures of an operation, and where it is defined; None if it is defined everywhere."""
        n, count = box[0].shape
        match entry.op:
            case "var":
                at = entry.value.numerator
                return _jet((box[0][at], box[1][at]), at, n, order), None
            case "num" | "pi":
                low, high = (np.full(count, end) for end in (iv.PI if entry.op == "pi" else iv.enclosed(entry.value)))
                return _jet((low, low if np.array_equal(low, high) else high), None, n, order), None
            case "add":
                return args[0] + args[1], None
            case "sub":
                return args[0] - args[1], None
            case "mul":
                # the product of equal factors is a square, which gives narrower intervals
                return args[0].power(2) if entry.args[0] == entry.args[1] else args[0] * args[1], None
            case "div":
                over, inverse = self.table.entries[entry.args[0]], args[1].inverse()
                # a product is rounded
                return inverse if over.op == "num" and over.value == 1 else args[0] * inverse, _nonzero(args[1].value)
            case "neg":
                return -args[0], None
            case "pow" if entry.value >= 0:
                return args[0].power(entry.value.numerator), None
            case "pow":
                return args[0].power(-entry.value.numerator).inverse(), _nonzero(args[0].value)
            case "sqrt":
                return self._through(entry, iv.squared_root(args[0].value), args[0]), args[0].value[0] >= 0
            case "atan" | "atan2":
                x = args[-1] if entry.op == "atan2" else _jet(iv.point(np.ones(count)), None, n, order)
                value, fine = self.functions("atan2", entry.value, (args[0].value, x.value))
                return args[0].angle(x, value), fine
            case "abs":
                zero = iv.point(np.zeros(count))
                return choose(args[0].value, zero, -args[0], args[0], iv.magnitude(args[0].value)), None
            case "min" | "max":
                a, b = args[0].value, args[1].value
                if entry.op == "min":
                    return choose(a, b, args[0], args[1], iv.hull_min(a, b)), None
                return choose(a, b, args[1], args[0], iv.hull_max(a, b)), None
            case "select":
                return choose(args[0].value, args[1].value, args[2], args[3]), None
        value, fine = self.functions(entry.op, entry.value, [args[0].value])
        return self._through(entry, value, args[0]), fine

    def _through(self, entry: Entry, value: Ends, inside: Jet) -> Jet:
        """Return a function of one quantity, with its value there; its derivatives are those of its expression."""
        first, second = _derivatives(entry.op, entry.value, self.functions)
        at = inside.value[0][None], inside.value[1][None]
        return inside.through(value, lambda: first.run(at).jets[0].value, lambda: second.run(at).jets[0].value)


def _nonzero(a: Ends) -> Flags:
    return (a[0] > 0) | (a[1] < 0)


def _jet(value: Ends, at: int | None, n: int, order: int) -> Jet:
    """Return the enclosures of the variable `at`, or of a constant."""
    if not order:
        return Jet(value)
    slope = np.zeros((n, value[0].size))
    if at is not None:
        slope[at] = 1.0
    bend = iv.point(np.zeros((n, n, value[0].size))) if order > 1 else None
    return Jet(value, iv.point(slope), bend, at is None)


def as_array(*intervals: Interval) -> Ends:
    """Return intervals as ends (n, 1) of doubles, rounded outward."""
    low, high = np.array([outward(one) for one in intervals]).reshape(-1, 2).T[:, :, None]
    return low, high


def as_interval(ends: Ends) -> Interval:
    """Return the smallest interval that contains all intervals of an array."""
    return libmp.from_float(float(ends[0].min())), libmp.from_float(float(ends[1].max()))


def mean_value(jet: Jet, there: Jet, offset: Ends) -> Ends:
    """Return the range (B,) on boxes by the mean-value form: value at a point + slopes · offsets (n, B) from it."""
    assert jet.slope is not None
    with np.errstate(all="ignore"):
        moves = iv.multiply(jet.slope, offset)
        total = there.value
        for k in range(len(offset[0])):
            total = iv.add(total, (moves[0][k], moves[1][k]))
    return total
