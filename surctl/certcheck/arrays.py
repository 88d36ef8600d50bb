"""A quick look at many boxes of a proof at once, in arrays of doubles that are rounded outward.

A box that is not decided here is left to `surctl.certcheck.enclosure`, so this module only has to be right where it
decides. NaN is a range that is not known, because an operation is not defined on the whole box, or an end is infinite
minus infinite or 0 times infinite. Every operation on NaN results in NaN, and no comparison with NaN is true. The
processor rounds each sum, product and quotient to one of the two doubles beside the exact number; every end is then
moved to the next double. The ranges of functions come from `enclosure`, one interval at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import cache, lru_cache
from typing import Any

import numpy as np
from mpmath import libmp
from numpy.typing import NDArray

from surctl.certcheck.enclosure import Interval, Undefined, enclose, rational
from surctl.certcheck.expressions import BRANCHES, Entry, ExpressionTable
from surctl.certcheck.patience import go_on

__all__ = ["FEWEST", "TOGETHER", "proved_together", "ranges"]

TOGETHER = 512
"""Number of boxes that are worth a look together."""

FEWEST = 16
"""With fewer boxes by the same rule, arrays are slower than intervals one at a time."""

Array = NDArray[np.float64]
Ends = tuple[Array, Array]
"""Lower and upper ends (B,) of intervals, or (1,) if all boxes have the same; no interval (None) is [0, 0]."""
Leaf = tuple[str, list[tuple[float, float]]]

_MOST = 500_000  # most intervals in the arrays of an expression
_UNKNOWN = (np.nan, np.nan)
_ONE = (np.ones(1), np.ones(1))


def proved_together(
    expressions: ExpressionTable, numerator: int | None, constraints: Sequence[int], leaves: Sequence[Leaf]
) -> list[bool]:
    """Return for each leaf, a rule and a box, whether it is certain that the rule proves the inequality on the box.

    Args:
        expressions: table of all expressions.
        numerator: expression of which numerator ≤ 0 is to be proved; None if it need not be defined on the boxes.
        constraints: expressions of which one has to be positive for the rules `i` and `j`.
        leaves: the leaves.
    """
    if len(leaves) < FEWEST:
        return [False] * len(leaves)
    done = np.zeros(len(leaves), dtype=bool)
    rules = np.array([rule for rule, _ in leaves])
    for rule, roots in {
        **dict.fromkeys("ij", constraints),
        **dict.fromkeys("nm", () if numerator is None else (numerator,)),
    }.items():
        among = np.flatnonzero(rules == rule)
        if len(among) < FEWEST or not _has_gradual_underflow():
            continue
        low, high = np.array([leaves[k][1] for k in among.tolist()]).transpose(2, 1, 0)
        for root in roots:
            needed, left = expressions.needed([root]), np.flatnonzero(~done[among])
            step = _MOST // (len(needed) * (len(low) + 1))
            if step < FEWEST or not {expressions.entries[at].op for at in needed}.isdisjoint(_OTHERS):
                continue
            for begin in range(0, len(left), step):
                part = left[begin : begin + step]
                with np.errstate(all="ignore"):
                    done[among[part]] = _decided(expressions, rule, root, low[:, part], high[:, part])
    return done.tolist()


_OTHERS = (*BRANCHES, "atan2")  # operations that are left to `enclosure`


def _has_gradual_underflow() -> bool:
    """Return whether the processor computes with denormal numbers; some libraries make it replace them by 0."""
    return bool(np.all(np.array([5e-324, 2.0**-1022]) * np.array([1.0, 0.5]) > 0))


def _decided(expressions: ExpressionTable, rule: str, root: int, low: Array, high: Array) -> NDArray[np.bool_]:
    """Return for each box whether the rule is certain to hold: root ≤ 0 for `n` and `m`, root > 0 for `i` and `j`.

    The rules are those of `surctl.certcheck.inequality`. The boxes have ends (n, B) that are doubles; the range of a
    variable contains each end and its printed decimal.
    """
    if rule in "in":
        return _good(rule, ranges(expressions, root, _decimals(low, high))[0])
    value, slope = ranges(expressions, root, _decimals(low, high), order=1)
    known: NDArray[np.bool_] = ~np.isnan(value[0] + value[1])  # the root is defined on the whole box
    if rule == "j":
        return known & _good(rule, _mean_value(expressions, root, slope, low, high))
    # the face of the box where the root is largest
    down, up = (np.array([np.broadcast_to(_some(s)[k], low.shape[1:]) for s in slope]) for k in (0, 1))
    rises = down >= 0
    low, high = np.where(rises, high, low), np.where(~rises & (up <= 0), low, high)
    on_face = ranges(expressions, root, _decimals(low, high))[0]
    return known & (_good(rule, on_face) | _good(rule, _mean_value(expressions, root, slope, low, high)))


def _good(rule: str, a: Ends) -> NDArray[np.bool_]:
    fine: NDArray[np.bool_] = a[0] > 0 if rule in "ij" else a[1] <= 0
    return fine


def _mean_value(expressions: ExpressionTable, root: int, slope: list[Any], low: Array, high: Array) -> Ends:
    """Return the range by the mean-value form: value at the centre + slopes · offsets."""
    centre = low / 2 + high / 2
    centre = np.where((low <= centre) & (centre <= high), centre, np.nan)
    wide = _decimals(low, high)
    total, _ = ranges(expressions, root, (centre, centre))
    for k, s in enumerate(slope):
        if s is not None:
            total = _sum(total, _times(s, (_down(wide[0][k] - centre[k]), _up(wide[1][k] - centre[k]))))
    return total


def ranges(expressions: ExpressionTable, root: int, box: Ends, *, order: int = 0) -> tuple[Ends, list[Any]]:
    """Return the range of an expression on boxes (n, B), and with order 1 those of its slopes; None is [0, 0].

    A range is NaN if it is not known, and has the shape (1,) if it is the same on all boxes.
    """
    known: dict[int, tuple[Ends, list[Any]]] = {}
    for at in expressions.needed([root]):
        go_on()
        entry = expressions.entries[at]
        known[at] = _step(entry, [known[a] for a in entry.args], box, order)
    return known[root]


def _step(entry: Entry, args: list[tuple[Ends, list[Any]]], box: Ends, order: int) -> tuple[Ends, list[Any]]:
    n = len(box[0])
    match entry.op:
        case "num":
            return _constant(entry.value), [None] * n
        case "var":
            at = entry.value.numerator
            return (box[0][at], box[1][at]), [_ONE if order and k == at else None for k in range(n)]
        case "add":
            return _sum(args[0][0], args[1][0]), [_sum(p, q) for p, q in zip(args[0][1], args[1][1], strict=True)]
        case "sub":
            a, b = args[0], _negative(args[1])
            return _sum(a[0], b[0]), [_sum(p, q) for p, q in zip(a[1], b[1], strict=True)]
        case "neg":
            return _negative(args[0])
        case "mul" if entry.args[0] != entry.args[1]:
            return _product(*args)
        case "mul":
            return _power(args[0], 2)
        case "div":
            return _product(args[0], _reciprocal(args[1]))
        case "pow" if entry.value:
            raised = _power(args[0], abs(entry.value.numerator))
            return raised if entry.value > 0 else _reciprocal(raised)
    return _function(entry.op, entry.value, args, order, n)


def _down(x: Array) -> Array:
    return np.nextafter(x, -np.inf)


def _up(x: Array) -> Array:
    return np.nextafter(x, np.inf)


def _decimals(low: Array, high: Array) -> Ends:
    # the decimal that is printed for a double lies between the two doubles beside it
    return np.where(low == 0, 0.0, _down(low)), np.where(high == 0, 0.0, _up(high))


def _constant(value: Fraction) -> Ends:
    low, high = _doubles(rational(value))
    return np.array([low]), np.array([high])


def _doubles(a: Interval) -> tuple[float, float]:
    """Return doubles that enclose an interval of mpmath's raw numbers."""
    low, high = (float(libmp.to_float(end)) for end in a)
    if libmp.from_float(low) != a[0]:
        low = float(np.nextafter(low, -np.inf))
    if libmp.from_float(high) != a[1]:
        high = float(np.nextafter(high, np.inf))
    return low, high


def _some(a: Ends | None) -> Ends:
    return (np.zeros(1), np.zeros(1)) if a is None else a


def _minus(a: Any) -> Any:
    return None if a is None else (-a[1], -a[0])


def _negative(a: tuple[Ends, list[Any]]) -> tuple[Ends, list[Any]]:
    return _minus(a[0]), [_minus(s) for s in a[1]]


def _sum(a: Any, b: Any) -> Any:
    if a is None or b is None:
        return b if a is None else a
    return _down(a[0] + b[0]), _up(a[1] + b[1])


def _times(a: Any, b: Any) -> Any:
    if a is None or b is None:
        return None
    p, q, r, s = a[0] * b[0], a[0] * b[1], a[1] * b[0], a[1] * b[1]
    low, high = np.minimum(np.minimum(p, q), np.minimum(r, s)), np.maximum(np.maximum(p, q), np.maximum(r, s))
    return _down(low), _up(high)


def _product(a: tuple[Ends, list[Any]], b: tuple[Ends, list[Any]]) -> tuple[Ends, list[Any]]:
    slope = [_sum(_times(p, b[0]), _times(q, a[0])) for p, q in zip(a[1], b[1], strict=True)]
    return _times(a[0], b[0]), slope


def _chain(a: tuple[Ends, list[Any]], value: Ends, first: Callable[[], Ends]) -> tuple[Ends, list[Any]]:
    slope = None if all(s is None for s in a[1]) else first()
    return value, [_times(s, slope) for s in a[1]]


def _reciprocal(a: tuple[Ends, list[Any]]) -> tuple[Ends, list[Any]]:
    low, high = a[0]
    fine = (low > 0) | (high < 0)
    value = np.where(fine, _down(1.0 / high), np.nan), np.where(fine, _up(1.0 / low), np.nan)
    return _chain(a, value, lambda: _minus(_raised(value, 2)))


def _power(a: tuple[Ends, list[Any]], n: int) -> tuple[Ends, list[Any]]:
    factor = np.full(1, float(n))
    return _chain(a, _raised(a[0], n), lambda: _times((factor, factor), _raised(a[0], n - 1)) if n > 1 else _ONE)


def _raised(a: Ends, n: int) -> Ends:
    """Return the interval of a^n for n ≥ 1."""
    if n % 2:
        sizes = [_powers(np.abs(end), n) for end in a]
        return np.where(a[0] < 0, -sizes[0][1], sizes[0][0]), np.where(a[1] < 0, -sizes[1][0], sizes[1][1])
    small, large = np.minimum(np.abs(a[0]), np.abs(a[1])), np.maximum(np.abs(a[0]), np.abs(a[1]))
    return _powers(np.where((a[0] <= 0) & (a[1] >= 0), 0.0, small), n)[0], _powers(large, n)[1]


def _powers(x: Array, n: int) -> Ends:
    """Return bounds on x^n for numbers x ≥ 0."""
    low = high = x
    for _ in range(n - 1):
        low, high = np.maximum(_down(low * x), 0.0), _up(high * x)
    return low, high


def _function(
    op: str, value: Fraction, args: list[tuple[Ends, list[Any]]], order: int, n: int
) -> tuple[Ends, list[Any]]:
    """Return the jet of a function of at most one argument, whose ranges `enclosure` computes."""
    a = args[0] if args else ((np.zeros(1), np.zeros(1)), [None] * n)
    shown = [_of_one(op, value, low, high, order) for low, high in zip(*(end.tolist() for end in a[0]), strict=True)]
    columns = np.array(shown).T
    return _chain(a, (columns[0], columns[1]), lambda: (columns[2], columns[3]))


@lru_cache(8192)
def _of_one(op: str, value: Fraction, low: float, high: float, order: int) -> tuple[float, float, float, float]:
    """Return the range of a function on an interval, and with order 1 that of its slope."""
    table, at = _table(op, value)
    if not (np.isfinite(low) and np.isfinite(high)):
        return (*_UNKNOWN, *_UNKNOWN)
    try:
        [jet] = enclose(table, [at], [(libmp.from_float(low), libmp.from_float(high))], order=order)
    except Undefined:
        return (*_UNKNOWN, *_UNKNOWN)
    slope = jet.slope[0] if jet.slope else None
    return (*_doubles(jet.value), *(_doubles(slope) if slope else (0.0, 0.0)))


@cache
def _table(op: str, value: Fraction) -> tuple[ExpressionTable, int]:
    table = ExpressionTable(["t"])
    return table, table.put(op, *((table.put("var"),) if op != "pi" else ()), value=value)
