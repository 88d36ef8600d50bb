"""Interval arithmetic of the checker, with first and second derivatives; mpmath rounds each end outward to 60 bits.

An interval is a pair of mpmath's raw numbers (tuples, not `mpf` objects). A derivative None means the interval [0, 0].
mpmath rounds sums, products, quotients, integer powers and roots correctly; the other functions come from
`surctl.certcheck.elementary`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, lru_cache
from typing import Any

from mpmath import libmp

from surctl.certcheck.derivative import along
from surctl.certcheck.elementary import BITS, ELEMENTARY, Interval, Undefined, angle, circle, elementary, hull, pi
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.patience import afford, go_on

__all__ = [
    "Interval", "Jet", "Undefined", "above", "decimal", "enclose", "exact", "greatest", "hull", "is_zero", "least",
    "middle", "rational", "span",
]  # fmt: skip

Slopes = list[Any]
"""The derivative with respect to each variable; None means 0."""

_SIZE = 450  # memory of an interval [bytes]
_ZERO = (libmp.fzero, libmp.fzero)
_ONE = (libmp.fone, libmp.fone)
_LINE = (libmp.fninf, libmp.finf)


@dataclass(frozen=True)
class Jet:
    """Ranges of a function's value, gradient (n) and symmetric Hessian (n × n); None for a derivative not computed."""

    value: Interval
    slope: Slopes | None = None
    bend: list[Slopes] | None = None


def exact(x: float) -> Interval:
    """Return a double as an interval of zero width."""
    raw = libmp.from_float(x)
    return raw, raw


def span(low: float, high: float) -> Interval:
    """Return the interval [low, high], rounded outward to contain both the doubles and their printed decimals."""
    return _end(low)[0], _end(high)[1]


@lru_cache(8192)
def _end(x: float) -> Interval:
    """Return the interval between a double and its printed decimal."""
    raw = libmp.from_float(x)
    low, high = decimal(x)
    return raw if libmp.mpf_le(raw, low) else low, raw if libmp.mpf_ge(raw, high) else high


def decimal(x: float) -> Interval:
    """Return a narrow interval around the printed decimal of a double."""
    return rational(Fraction(repr(x)))


def rational(x: Fraction) -> Interval:
    """Return a narrow interval around a rational number."""
    return _quotient(x.numerator, x.denominator)


@lru_cache(1024)
def _quotient(p: int, q: int) -> Interval:
    return libmp.from_rational(p, q, BITS, "f"), libmp.from_rational(p, q, BITS, "c")


def above(a: Interval, bound: Any = libmp.fzero) -> bool:
    """Return whether every number in the interval a is greater than `bound`."""
    return bool(libmp.mpf_gt(a[0], bound))


def is_zero(a: Interval) -> bool:
    """Return whether the interval a is exactly [0, 0]."""
    return bool(a == _ZERO)


def least(a: Interval, b: Interval) -> Interval:
    """Return the interval of min(a, b)."""
    return tuple(x if libmp.mpf_le(x, y) else y for x, y in zip(a, b, strict=True))


def greatest(a: Interval, b: Interval) -> Interval:
    """Return the interval of max(a, b)."""
    return tuple(x if libmp.mpf_ge(x, y) else y for x, y in zip(a, b, strict=True))


def middle(a: Interval) -> float:
    """Return about the middle of the interval a."""
    return float(libmp.to_float(a[0]) + libmp.to_float(a[1])) / 2


def plus(a: Interval, b: Interval) -> Interval:
    """Return the interval a + b; None means 0."""
    return b if a is None else a if b is None else libmp.mpi_add(a, b, BITS)


def minus(a: Interval) -> Interval:
    """Return the interval −a; None means 0."""
    return None if a is None else libmp.mpi_neg(a)


def mul(a: Interval, b: Interval) -> Interval:
    """Return the interval a · b; None means 0, and 0 times an unbounded interval is 0."""
    if a is None or b is None:
        return None
    if a == _ZERO or b == _ZERO:
        return _ZERO
    if libmp.finf in (*a, *b) or libmp.fninf in (*a, *b):
        return _LINE
    return libmp.mpi_mul(a, b, BITS)


def over(a: Interval, b: Interval) -> Interval:
    """Return the interval a / b; it is the whole real line if b contains 0 or if a or b is unbounded."""
    if a is None:
        return None
    if not (above(b) or libmp.mpf_lt(b[1], libmp.fzero)) or libmp.finf in (*a, *b) or libmp.fninf in (*a, *b):
        return _LINE
    return libmp.mpi_div(a, b, BITS)


def enclose(
    expressions: ExpressionTable, roots: Sequence[int], box: Sequence[Interval], *, order: int = 0
) -> list[Jet]:
    """Return the ranges on a box of expressions and of their derivatives up to `order` (0, 1 or 2).

    Raises:
        Undefined: an operation in one of the expressions is not defined on the whole box.
    """
    jets: dict[int, Jet] = {}
    needed = expressions.needed(roots)
    last = {a: at for at in needed for a in expressions.entries[at].args} if order else {}  # where operands end
    last |= dict.fromkeys(roots, -1)
    afford(_SIZE * len(needed))
    for k, at in enumerate(needed):
        if order > 1 or k % 64 == 0:
            go_on()
        entry = expressions.entries[at]
        jets[at] = _step(entry.op, entry.value, [jets[a] for a in entry.args], entry.args, box, order)
        if order:
            afford(_SIZE * len(jets) * len(box) ** order)
            for a in {a for a in entry.args if last[a] == at}:
                del jets[a]
    return [jets[r] for r in roots]


def _step(op: str, value: Fraction, args: list[Jet], at: tuple[int, ...], box: Sequence[Interval], order: int) -> Jet:
    n = len(box)
    match op:
        case "num":
            return _flat(rational(value), n, order)
        case "pi":
            return _flat(pi(), n, order)
        case "var":
            jet = _flat(box[value.numerator], n, order)
            if jet.slope is not None:
                jet.slope[value.numerator] = _ONE
            return jet
        case "add":
            return _sum(args[0], args[1])
        case "sub":
            return _sum(args[0], _chain(args[1], libmp.mpi_neg(args[1].value), (minus(_ONE), None)))
        case "neg":
            return _chain(args[0], libmp.mpi_neg(args[0].value), (minus(_ONE), None))
        case "mul":
            return _power(args[0], 2) if at[0] == at[1] else _product(args[0], args[1])
        case "div":
            return _product(args[0], _reciprocal(args[1]))
        case "pow":
            jet = _power(args[0], abs(value.numerator))
            return jet if value >= 0 else _reciprocal(jet)
        case _ if op in ELEMENTARY:
            jet, image = args[0], elementary(op, args[0].value, value)
            return Jet(image) if jet.slope is None else _chain(jet, image, _derivatives(op, value, jet.value, order))
        case "sin" | "cos":
            cosine, sine = _circle(args[0].value)
            if op == "sin":
                return _chain(args[0], sine, (cosine, minus(sine)))
            return _chain(args[0], cosine, (minus(sine), minus(cosine)))
        case "atan2":
            return _angle(args[0], args[1])
        case "atan":
            return _angle(args[0], _flat(_ONE, n, order))
        case "abs":
            return _chosen(rational(Fraction(0)), args[0].value, args[0], _negative(args[0]), abs_of(args[0].value))
        case "min":
            return _chosen(args[0].value, args[1].value, args[0], args[1], least(args[0].value, args[1].value))
        case "max":
            return _chosen(args[1].value, args[0].value, args[0], args[1], greatest(args[0].value, args[1].value))
        case "select":
            return _chosen(args[0].value, args[1].value, args[2], args[3], None)
    raise Undefined(f"the operation {op!r} is not known")


def abs_of(a: Interval) -> Interval:
    """Return the interval of |a|."""
    return libmp.mpi_abs(a, BITS)


def _flat(value: Interval, n: int, order: int) -> Jet:
    return Jet(value, [None] * n if order else None, [[None] * n for _ in range(n)] if order > 1 else None)


def _negative(a: Jet) -> Jet:
    return _chain(a, libmp.mpi_neg(a.value), (minus(_ONE), None))


def _sum(a: Jet, b: Jet) -> Jet:
    value = plus(a.value, b.value)
    if a.slope is None or b.slope is None:
        return Jet(value)
    slope = [plus(x, y) for x, y in zip(a.slope, b.slope, strict=True)]
    if a.bend is None or b.bend is None:
        return Jet(value, slope)
    rows = zip(a.bend, b.bend, strict=True)
    return Jet(value, slope, [[plus(x, y) for x, y in zip(p, q, strict=True)] for p, q in rows])


def _product(a: Jet, b: Jet) -> Jet:
    value = mul(a.value, b.value)
    if a.slope is None or b.slope is None:
        return Jet(value)
    p, q, n = a.slope, b.slope, len(a.slope)
    slope = [plus(mul(p[i], b.value), mul(q[i], a.value)) for i in range(n)]
    if a.bend is None or b.bend is None:
        return Jet(value, slope)
    bend: list[Slopes] = [[None] * n for _ in range(n)]
    for i in range(n):
        for j in range(i + 1):
            own = plus(mul(a.bend[i][j], b.value), mul(b.bend[i][j], a.value))
            bend[i][j] = bend[j][i] = plus(own, plus(mul(p[i], q[j]), mul(p[j], q[i])))
    return Jet(value, slope, bend)


def _chain(a: Jet, value: Interval, derivatives: tuple[Interval, Interval]) -> Jet:
    """Return value, gradient and Hessian of f(a) by the chain rule, from f(a), f'(a) and f''(a)."""
    if a.slope is None:
        return Jet(value)
    first, second = derivatives
    slope = [mul(s, first) for s in a.slope]
    if a.bend is None:
        return Jet(value, slope)
    n = len(slope)
    bend: list[Slopes] = [[None] * n for _ in range(n)]
    for i in range(n):
        for j in range(i + 1):
            outer = square(a.slope[i]) if i == j else mul(a.slope[i], a.slope[j])
            bend[i][j] = bend[j][i] = plus(mul(a.bend[i][j], first), mul(outer, second))
    return Jet(value, slope, bend)


def square(a: Interval) -> Interval:
    """Return the interval a²; None means 0."""
    return None if a is None else (_LINE if a == _LINE else libmp.mpi_pow_int(a, 2, BITS))


def _power(a: Jet, n: int) -> Jet:
    def to(e: int) -> Interval:
        return _ONE if e <= 0 else libmp.mpi_pow_int(a.value, e, BITS)

    if a.slope is None:
        return Jet(to(n))
    first = mul(_integer(n), to(n - 1))
    second = None if a.bend is None else mul(_integer(n * (n - 1)), to(n - 2))
    return _chain(a, to(n), (first, second))


def _integer(x: int) -> Interval:
    raw = libmp.from_int(x)
    return raw, raw


def _reciprocal(a: Jet) -> Jet:
    if not (above(a.value) or libmp.mpf_lt(a.value[1], libmp.fzero)):
        raise Undefined("a division by an interval that contains 0")
    value = libmp.mpi_div(_ONE, a.value, BITS)
    if a.slope is None:
        return Jet(value)
    squared = libmp.mpi_pow_int(value, 2, BITS)
    return _chain(a, value, (minus(squared), mul(rational(Fraction(2)), mul(squared, value))))


_circle = lru_cache(1024)(circle)  # neighbouring boxes share the ranges of most of their variables


@cache
def _formulas(op: str, exponent: Fraction) -> tuple[ExpressionTable, list[int]]:
    """Return the first and the second derivative of a function of t."""
    table = ExpressionTable(["t"])
    whole, rates = table.put(op, table.put("var"), value=exponent), [table.put("num", value=1)]
    first = along(table, whole, rates)
    return table, [first, along(table, first, rates)]


def _derivatives(op: str, exponent: Fraction, x: Interval, order: int) -> tuple[Interval, Interval]:
    """Return the ranges of f' and, with order 2, of f''; the whole real line for one that is unbounded."""
    table, roots = _formulas(op, exponent)
    ranges: Slopes = [None, None]
    for k in range(order):
        try:
            ranges[k] = enclose(table, [roots[k]], [x])[0].value
        except Undefined:
            ranges[k] = _LINE
    return ranges[0], ranges[1]


def _angle(y: Jet, x: Jet) -> Jet:
    holds = [not (above(v) or libmp.mpf_lt(v[1], libmp.fzero)) for v in (x.value, y.value)]
    if all(holds):
        raise Undefined("an atan2 of a box that contains (0, 0)")
    jumps = holds[1] and not above(x.value)
    value = (libmp.mpf_neg(pi()[1]), pi()[1]) if jumps else angle(y.value, x.value)
    if x.slope is None or y.slope is None:
        return Jet(value)
    n = len(x.slope)
    if jumps:
        return Jet(value, [_LINE] * n, None if x.bend is None else [[_LINE] * n for _ in range(n)])
    length = plus(square(x.value), square(y.value))
    slope = [over(plus(mul(y.slope[i], x.value), minus(mul(x.slope[i], y.value))), length) for i in range(n)]
    if x.bend is None or y.bend is None:
        return Jet(value, slope)
    bend: list[Slopes] = [[None] * n for _ in range(n)]
    growth = [mul(rational(Fraction(2)), plus(mul(x.slope[j], x.value), mul(y.slope[j], y.value))) for j in range(n)]
    for i in range(n):
        for j in range(n):
            turn = plus(mul(y.bend[i][j], x.value), minus(mul(x.bend[i][j], y.value)))
            crossed = plus(mul(y.slope[i], x.slope[j]), minus(mul(x.slope[i], y.slope[j])))
            bend[i][j] = over(plus(plus(turn, crossed), minus(mul(slope[i], growth[j]))), length)
    return Jet(value, slope, bend)


def _chosen(a: Interval, b: Interval, x: Jet, y: Jet, value: Interval | None) -> Jet:
    """Return the `Jet` of f, where f = x if a ≤ b and f = y otherwise; `value` is f's range, or None if f may jump."""
    if libmp.mpf_le(a[1], b[0]):
        return x
    if libmp.mpf_gt(a[0], b[1]) or (value is not None and libmp.mpf_ge(a[0], b[1])):  # without a jump, x = y if a = b
        return y
    both = hull(x.value, y.value) if value is None else value
    if x.slope is None or y.slope is None:
        return Jet(both)
    n = len(x.slope)
    slope: Slopes = [_LINE] * n
    if value is not None:
        slope = [None if p is None and q is None else hull(p or _ZERO, q or _ZERO) for p, q in _pairs(x, y)]
    return Jet(both, slope, None if x.bend is None else [[_LINE] * n for _ in range(n)])


def _pairs(x: Jet, y: Jet) -> list[tuple[Interval, Interval]]:
    return list(zip(x.slope or [], y.slope or [], strict=True))
