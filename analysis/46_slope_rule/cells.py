"""Rows of slopes on many boxes at once, with cosine and sine of one angle as points: a proposal for the checker.

As in `surctl.certcheck.slope_rows`, an expression is e(x, p) = e(0, p) + r(θ)·x on {xᵀ P x ≤ level}, with a row r of
polynomials in slopes θ. Here, the boxes (cells of parameters, levels of V) share these polynomials, and only the ranges
of the slopes differ. What else differs from the checker's rule:

- An angle has a cell in each box. Its cosine c and sine s remain variables of the polynomials, with s² = 1 − c², so
  that terms cancel as they do for every angle. In a cell, the monomials of c and s are a convex combination of few
  points (`monomials`), at which polynomials are evaluated.
- Values at x = 0 are polynomials too; bounds of them count in ranges, and as the trim error f(0, p) (`spread`).
- A square of a slope is k² = 2 m k − m² + σ with the middle m of its range and a slope σ ≥ 0.
- Secant slopes are functions of c and of the distance from c. A function of one expression and of parameters has one
  slope. The limit b of min(a, b) has none, if b exceeds the value of a at x = 0 everywhere.
- Parameters may have a polytope with given vertices.

Intervals are rounded outward; sums of products in doubles have a bound of their rounding errors.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck import Rejected
from surctl.certcheck import arrays as iv
from surctl.certcheck.arrays import Ends
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.jets import Tape
from surctl.certcheck.secants import slopes_on
from surctl.certcheck.slope_rows import Number, Poly

Array = NDArray[np.float64]
Powers = tuple[int, int]
_Group = dict[int, Array]

ROUNDING = 1e-11  # bound of the relative rounding error of a sum of products
_COSINE, _SINE = 0, 1  # the first two slopes
_PARTS, _HALVED, _FINE, _MOST_PARTS = 12, 3, 6, 4  # parts of a distance, and of x* relative to it, for secant slopes
_PIECES = 12  # of a range, for the image of a function
_NARROW = 2.0**-33  # relative width of a slope that counts as a number
_FEW = 9  # slopes of a row whose corners are tried for its support
_KEPT = 10  # slopes of the trim error whose corners are tried


def monomials(middle: Array, half: Array, powers: Iterable[Powers]) -> dict[Powers, Array]:
    """Return points (J, B) for monomials of cosine and sine of angles in cells middle ± half (B,).

    The values of all monomials at one angle of a cell are the same convex combination of their J points. With u =
    tan(δ/2), δ the angle from the middle, a monomial of degree ≤ D is N(u)/(1 + u²)^D. In Bernstein's basis on the
    cell, N has coefficients β_k and (1 + u²)^D has w_k > 0, so that the points are β_k/w_k. If all degrees are even,
    cosine and sine of the double angle take the place of those of the angle, and D is half as large.

    Args:
        middle, half: the cells [rad]; half a cell must be below π/4.
        powers: exponents of the cosine and of the sine, which is at most 1.
    """
    every = set(powers)
    even = all(sum(one) % 2 == 0 for one in every)
    factor = 2 if even else 1
    degree = max((sum(one) for one in every), default=0) // factor
    t = np.tan(factor * half / 2)
    unit = np.array([np.ones_like(t), np.zeros_like(t), t**2])  # coefficients of 1 + u², with u = t v
    c, s = np.cos(factor * middle), np.sin(factor * middle)
    cosine, sine = np.array([c, -2 * s * t, -c * t**2]), np.array([s, 2 * c * t, -s * t**2])
    # in the double angle, the factors are c² = (1 + cos)/2 and c s = sin/2
    first, second = ((unit + cosine) / 2, sine / 2) if even else (cosine, sine)
    change = _bernstein(2 * degree)

    def coefficients(a: int, b: int) -> Array:
        total = np.ones((1, len(t)))
        for part, count in ((first, a), (second, b), (unit, degree - a - b)):
            for _ in range(count):
                product = np.zeros((len(total) + 2, len(t)))
                for k, x in enumerate(part):
                    product[k : k + len(total)] += x * total
                total = product
        return change @ total

    weights = coefficients(0, 0)
    if not np.all(weights > 0):
        raise Rejected("a cell of the angle is too wide")
    inner = {(a, b): ((a - b) // 2, b) if even else (a, b) for a, b in every}
    return {one: coefficients(*own) / weights for one, own in inner.items()}


def _bernstein(degree: int) -> Array:
    """Return the matrix that turns coefficients of powers of v in [−1, 1] into coefficients in Bernstein's basis."""
    change = np.zeros((degree + 1, degree + 1))
    for power in range(degree + 1):
        shifted = [math.comb(power, i) * (-1.0) ** (power - i) * 2.0**i for i in range(power + 1)]  # of t, v = 2 t − 1
        for k in range(degree + 1):
            parts = (x * math.comb(k, i) / math.comb(degree, i) for i, x in enumerate(shifted[: k + 1]))
            change[k, power] = sum(parts)
    return change


class Cells:
    """Rows of expressions on B boxes; the nodes of expressions are those of an own table.

    Attributes:
        rows: row of each expression, polynomials for the states.
        roots: nodes of the expressions.
        slopes: range (B,) of each slope; the first two are cosine and sine of the angle.

    Args:
        names: names of the n states, then of the parameters, the first of which is the angle.
        rates: texts of the expressions.
        cover: P⁻¹ (n, n); block-diagonal for several groups of states, each of which has the level for itself.
        level: the levels (B,).
        box: ends of the parameters, each (B,).
        polytopes: vertices of pairs of parameters.
        same: number (B,) of the cell of parameters of each box.
        groups: number of states of each group, in their order; None means one group.
    """

    def __init__(
        self,
        names: Sequence[str],
        rates: Sequence[str],
        cover: Array,
        level: Array,
        box: Sequence[Ends],
        polytopes: Mapping[tuple[str, str], Array],
        same: NDArray[np.intp],
        groups: Sequence[int] | None = None,
    ) -> None:
        self.cover, self.radius, self.count = cover, np.sqrt(level) * (1 + 1e-12), len(level)
        self.states = len(cover)
        ends = np.cumsum([0, *(groups or [self.states])])
        self._blocks = [slice(*pair) for pair in pairwise(ends.tolist())]
        self.polytopes = [(tuple(names.index(name) for name in pair), np.array(at)) for pair, at in polytopes.items()]
        self.first, self.cell = np.unique(same, return_index=True, return_inverse=True)[1:]
        self.table = ExpressionTable(names)
        self.range: dict[int, Ends] = {}  # of each node on the region
        self.rest: dict[int, Ends] = {}  # of each node at x = 0
        self.base: dict[int, int] = {}  # node of which it is a function of one variable; −1 if it has no state
        self.single: dict[int, int] = {}  # the same, with parameters beside the variable
        self.capped: dict[int, tuple[int, int]] = {}  # a and b of min(a, b) or max(a, b) where b matters away from 0
        self._numeric: dict[int, bool] = {}
        self._rows: dict[int, list[Number]] = {}
        self._values: dict[tuple[str, int], Number] = {}
        self._squares: dict[int, tuple[Fraction, int]] = {}
        self._reach: dict[int, Array] = {}
        self._of_parameter: dict[int, int] = {}  # slope of each parameter
        zero = iv.point(np.zeros(self.count))
        extents = [np.sqrt(cover[k, k]) * (1 + 1e-12) * self.radius for k in range(self.states)]
        self.box = [*(((-x, x), zero) for x in extents), *((ends, ends) for ends in box)]
        angle = box[0]
        self.middle, self.half = (angle[0] + angle[1]) / 2, (angle[1] - angle[0]) / 2 * (1 + 1e-12) + 1e-15
        self.slopes = [_of("cos", angle), _of("sin", angle)]
        source, new = ExpressionTable(names), dict[int, int]()
        roots = [source.read(text) for text in rates]
        for at in source.needed(roots):
            entry = source.entries[at]
            new[at] = self._put(entry.op, tuple(new[a] for a in entry.args), entry.value)
        self.roots = [new[root] for root in roots]
        self.rows = [self.row(root) for root in self.roots]

    # ---- the expressions

    def _put(self, op: str, args: tuple[int, ...], value: Fraction = Fraction(0)) -> int:
        free = [a for a in args if self.base[a] >= 0]
        alone = len({self.base[a] for a in free}) == 1 and all(self.base[a] >= 0 or self._numeric[a] for a in args)
        chosen = self._decided(op, args) if op in ("min", "max", "abs") else None
        if chosen is not None:
            return chosen
        capped = None
        if free and not alone:
            if op == "div" and self.base[args[1]] >= 0:
                return self._put("mul", (args[0], self._put("pow", (args[1],), Fraction(-1))))
            if op == "mul" and (grouped := self._grouped(args)) is not None:
                return grouped
            if op in ("min", "max"):
                capped = next((pair for pair in (args, args[::-1]) if self._is_apart(op, *pair)), None)
                if capped is None:
                    apart = self._put("sub", (args[1], args[0]))
                    return self._put("add", (args[0], self._put(op, (self._put("num", ()), apart))))
        at = self.table.put(op, *args, value=value)
        if at not in self.range:
            self._numeric[at] = op in ("num", "pi") or (op != "var" and all(self._numeric[a] for a in args))
            if capped:
                self.capped[at] = capped
            if free:
                self.base[at] = self.base[free[0]] if alone else at
            else:
                self.base[at] = at if op == "var" and value.numerator < self.states else -1
            self.single[at] = self.base[at]
            inner = {self.single[a] for a in free}
            linear = op in ("add", "sub", "neg") or (op in ("mul", "div") and len(free) == 1)
            if free and self.base[at] == at and len(inner) == 1 and linear:
                self.single[at] = inner.pop()
            self._enclose(at)
        return at

    def _grouped(self, args: tuple[int, ...]) -> int | None:
        """Return p (q b) for (p q) b with a p without states and two functions q and b of one variable."""
        for whole, b in (args, args[::-1]):
            op, parts, _ = self.table.entries[whole]
            for p, q in (parts, parts[::-1]) if op == "mul" else ():
                if self.base[p] < 0 <= self.base[b] == self.base[q]:
                    return self._put("mul", (p, self._put("mul", (q, b))))
        return None

    def _is_apart(self, op: str, a: int, b: int) -> bool:
        """Return whether b is above the value of a at x = 0 everywhere (for min), or below it (for max)."""
        if op == "min":
            return bool(np.all(self.range[b][0] > self.rest[a][1]))
        return bool(np.all(self.range[b][1] < self.rest[a][0]))

    def _decided(self, op: str, args: tuple[int, ...]) -> int | None:
        """Return the operand that the function takes on the whole region and at x = 0; None if it is not decided."""
        whole = [_hull(self.range[a], self.rest[a]) for a in args]
        if op == "abs":
            if np.all(whole[0][0] >= 0):
                return args[0]
            return self._put("neg", args) if np.all(whole[0][1] <= 0) else None
        first, second = (args[1], args[0]) if op == "max" else args
        if np.all(whole[0][1] <= whole[1][0]):
            return first
        return second if np.all(whole[0][0] >= whole[1][1]) else None

    def _enclose(self, at: int) -> None:
        """Compute the ranges of a node on the region and at x = 0."""
        entry, base = self.table.entries[at], self.base[at]
        if entry.op == "var":
            self.range[at], self.rest[at] = self.box[entry.value.numerator]
            return
        own, rest = (self._natural(at, known) for known in (self.range, self.rest))
        if 0 <= base != at:
            function = self._function(at)
            t = _cut(self.range[base], _PIECES)
            own = _common(own, _joined(_value(function, t)))
            rest = _common(rest, _value(function, self.rest[base]))
        self.range[at], self.rest[at] = own, rest
        if base == at and entry.op not in ("min", "max"):
            value = self._exact_value(at)
            if value is not None and len(_used(value.poly)) <= _KEPT:
                low, high = self._bounds(value, self.first)  # it does not depend on the level
                rest = self.rest[at] = _common(rest, (low[self.cell], high[self.cell]))
            size = self._support(self.row(at))
            self.range[at] = _common(own, iv.add(rest, (-size, size)))

    def _natural(self, at: int, known: Mapping[int, Ends]) -> Ends:
        entry = self.table.entries[at]
        if not entry.args:
            low, high = iv.PI if entry.op == "pi" else iv.enclosed(entry.value)
            return np.full(self.count, low), np.full(self.count, high)
        if entry.op == "mul" and entry.args[0] == entry.args[1]:
            return iv.square(known[entry.args[0]])
        return _of(entry.op, *(known[a] for a in entry.args), value=entry.value)

    def _function(self, at: int) -> Tape:
        """Return the node `at` as a function of its base."""
        small, base = ExpressionTable(["t"]), self.base[at]
        new = {base: small.put("var", value=0)}
        for k in self.table.needed([at]):
            entry = self.table.entries[k]
            if k not in new and all(a in new for a in entry.args) and entry.op != "var":
                new[k] = small.put(entry.op, *(new[a] for a in entry.args), value=entry.value)
        return Tape(small, (new[at],))

    # ---- rows and values

    def row(self, at: int) -> list[Number]:
        """Return r with e(x, p) = e(0, p) + r·x on the region, for the node e."""
        if at not in self._rows:
            self._rows[at] = self._row(at)
        return self._rows[at]

    def _row(self, at: int) -> list[Number]:
        entry, base, single = self.table.entries[at], self.base[at], self.single[at]
        args = entry.args
        if base < 0:
            return [Number({})] * self.states
        if at in self.capped:
            return self._scaled(self._cap(at), self.row(self.capped[at][0]))
        if single != at:
            return self._scaled(self._one(self._share(at)), self.row(single))
        match entry.op:
            case "var":
                return [Number({(): Fraction(1)} if k == entry.value.numerator else {}) for k in range(self.states)]
            case "neg":
                return [-x for x in self.row(args[0])]
            case "add":
                return [x + y for x, y in zip(self.row(args[0]), self.row(args[1]), strict=True)]
            case "sub":
                return [x - y for x, y in zip(self.row(args[0]), self.row(args[1]), strict=True)]
            case "div":
                return self._scaled(self._inverse(args[1]), self.row(args[0]))
            case "mul":
                a, b = args
                if self.base[a] < 0 or self.base[b] < 0:
                    a, b = (a, b) if self.base[a] < 0 else (b, a)
                    return self._scaled(self.value(a), self.row(b))
                # a b − a* b* = a (b − b*) + b* (a − a*), with b* = 0 if one of them is 0
                a, b = (b, a) if _is_zero(self.rest[a]) else (a, b)
                first, second = self._scaled(self._factor(a), self.row(b)), self._scaled(self.value(b), self.row(a))
                return [x + y for x, y in zip(first, second, strict=True)]
        raise Rejected(f"no rule for {entry.op} of several variables")

    def _cap(self, at: int) -> Number:
        """Return the slope θ of min(a, b) − a* = θ (a − a*): 1 or, where b < a, (b − a*)/(a − a*)."""
        (a, b), reach = self.capped[at], self._reach_of(self.capped[at][0])
        if self.table.entries[at].op == "min":
            room = iv.subtract(iv.point(self.range[b][0]), iv.point(self.rest[a][1]))
        else:
            room = iv.subtract(iv.point(self.rest[a][0]), iv.point(self.range[b][1]))
        least = iv.divide((room[0], room[0]), iv.point(np.maximum(reach, 1e-300)))[0]
        return self._slope((np.clip(least, 0.0, 1.0), np.ones(self.count)))

    def _share(self, at: int) -> Number:
        """Return κ of e − e* = κ (w − w*), for a function e of the node w and of parameters."""
        key = "share", at
        if key not in self._values:
            self._values[key] = self._new_share(at)
        return self._values[key]

    def _new_share(self, at: int) -> Number:
        entry, w = self.table.entries[at], self.single[at]
        if at == w:
            return Number({(): Fraction(1)})
        if self.base[at] < 0:
            return Number({})
        if self.base[at] != at:
            return self._slope(secant(self._function(at), self.range[w], self.rest[w], self._reach_of(w)))
        match entry.op:
            case "add":
                return self._share(entry.args[0]) + self._share(entry.args[1])
            case "sub":
                return self._share(entry.args[0]) - self._share(entry.args[1])
            case "neg":
                return -self._share(entry.args[0])
            case "div":
                return self.times(self._inverse(entry.args[1]), self._share(entry.args[0]))
        a, b = entry.args if self.base[entry.args[0]] < 0 else entry.args[::-1]
        return self.times(self.value(a), self._share(b))

    def _one(self, a: Number) -> Number:
        """Return one slope in the place of a polynomial of several ones without cosine and sine."""
        used = _used(a.poly)
        return a if len(used) < 2 or used & {_COSINE, _SINE} else self._slope(self._bounds(a))

    def _reach_of(self, at: int) -> Array:
        """Return an upper bound (B,) on |e − e*| for the node e."""
        if at not in self._reach:
            size, (low, high), (least, most) = self._support(self.row(at)), self.range[at], self.rest[at]
            ends = np.maximum(
                iv.subtract(iv.point(high), iv.point(least))[1], iv.subtract(iv.point(most), (low, low))[1]
            )
            self._reach[at] = np.minimum(size, ends)
        return self._reach[at]

    def value(self, at: int) -> Number:
        """Return the value of a node at x = 0 as a polynomial, or as a slope."""
        key = "value", at
        if key not in self._values:
            exact = self._exact_value(at)
            self._values[key] = self._slope(self.rest[at]) if exact is None else exact
        return self._values[key]

    def _factor(self, at: int) -> Number:
        """Return the value of a node on the region as a slope."""
        key = "factor", at
        if key not in self._values:
            self._values[key] = self._slope(self.range[at])
        return self._values[key]

    def _exact_value(self, at: int) -> Number | None:
        entry, rest = self.table.entries[at], self.rest[at]
        args = entry.args
        if entry.op == "num":
            return Number({(): entry.value} if entry.value else {})
        if _is_zero(rest):
            return Number({})
        if at in self.capped:
            return self.value(self.capped[at][0])
        match entry.op:
            case "var" if self.base[at] < 0:
                key, value = ("value", at), self._values.get(("value", at))
                if value is None:
                    value = self._values[key] = self._slope(rest)
                    self._of_parameter[entry.value.numerator] = max(_used(value.poly), default=-1)
                return value
            case "cos" | "sin" if self.table.entries[args[0]] == ("var", (), self.states):
                return Number({(_COSINE if entry.op == "cos" else _SINE,): Fraction(1)})
            case "neg":
                return -self.value(args[0])
            case "add":
                return self.value(args[0]) + self.value(args[1])
            case "sub":
                return self.value(args[0]) - self.value(args[1])
            case "mul":
                return self.times(self.value(args[0]), self.value(args[1]))
            case "pow" if entry.value == 2:
                return self.times(self.value(args[0]), self.value(args[0]))
            case "div" if self.base[args[1]] < 0:
                return self.times(self.value(args[0]), self._inverse(args[1]))
            case "abs":
                return self._exact_size(args[0])
            case "min" | "max":
                first, second = (self.rest[a] for a in args)
                if np.all(first[1] <= second[0]):
                    return self.value(args[0 if entry.op == "min" else 1])
                if np.all(second[1] <= first[0]):
                    return self.value(args[1 if entry.op == "min" else 0])
        return None

    def _exact_size(self, at: int) -> Number | None:
        """Return |e*| = ±e* + η, with η ≠ 0 only where e* has the other sign; None if that is so in many boxes."""
        low, high = self.rest[at]
        positive = bool((low + high).sum() > 0)
        wrong = np.maximum(-low if positive else high, 0.0)
        if np.mean(wrong > 0) > 0.5:
            return None
        own = self.value(at)
        return (own if positive else -own) + self._slope((np.zeros(self.count), 2 * wrong), np.abs(high - low).max())

    def _inverse(self, at: int) -> Number:
        """Return 1/e of a node without states."""
        key = "inverse", at
        if key not in self._values:
            entry = self.table.entries[at]
            if entry.op == "num" and entry.value:
                self._values[key] = Number({(): 1 / entry.value})
            elif entry.op == "mul" and any(self._numeric[a] for a in entry.args):
                self._values[key] = self.times(*(self._inverse(a) for a in entry.args))
            else:
                self._values[key] = self._slope(_of("div", iv.point(np.ones(self.count)), self.rest[at]))
        return self._values[key]

    def _slope(self, ends: Ends, whole: float = 0.0) -> Number:
        """Return a new slope with this range, or a number with an error if the range is narrow in all boxes."""
        least, most = float(ends[0].min()), float(ends[1].max())
        if not math.isfinite(most - least):
            raise Rejected("a slope is unbounded")
        if most - least <= _NARROW * max(abs(least), abs(most), whole):
            middle = Fraction(least / 2 + most / 2)
            return Number({(): middle} if middle else {}, max(Fraction(most) - middle, middle - Fraction(least)))
        self.slopes.append(ends)
        return Number({(len(self.slopes) - 1,): Fraction(1)})

    # ---- arithmetic of polynomials

    def _scaled(self, factor: Number, row: Sequence[Number]) -> list[Number]:
        return [self.times(factor, entry) for entry in row]

    def times(self, a: Number, b: Number) -> Number:
        """Return a b."""
        if not (a.poly or a.error) or not (b.poly or b.error):
            return Number({})
        error = Fraction(0)
        if a.error or b.error:
            sizes = (Fraction(float(self.size(one.poly).max())) for one in (a, b))
            error = sum((x * y for x, y in zip(sizes, (b.error, a.error), strict=True)), a.error * b.error)
        poly: Poly = {}
        for s, x in a.poly.items():
            for t, y in b.poly.items():
                self._gather(poly, sorted((*s, *t)), x * y)
        return Number({term: number for term, number in poly.items() if number}, error)

    def _gather(self, poly: Poly, term: list[int], number: Fraction) -> None:
        """Add a term, in which a slope may occur twice, to a polynomial."""
        twice = next((k for k, other in pairwise(term) if k == other != _COSINE), None)
        if twice is None:
            key = tuple(term)
            poly[key] = poly.get(key, Fraction(0)) + number
            return
        rest = list(term)
        rest.remove(twice)
        rest.remove(twice)
        if twice == _SINE:
            self._gather(poly, rest, number)
            self._gather(poly, sorted([_COSINE, _COSINE, *rest]), -number)
            return
        middle, square = self._square(twice)
        self._gather(poly, sorted([twice, *rest]), 2 * middle * number)
        self._gather(poly, rest, -(middle**2) * number)
        self._gather(poly, sorted([square, *rest]), number)

    def _square(self, k: int) -> tuple[Fraction, int]:
        """Return m, and the slope σ with k² = 2 m k − m² + σ."""
        if k not in self._squares:
            low, high = self.slopes[k]
            middle = float(np.mean(low / 2 + high / 2))
            self.slopes.append(iv.square(iv.subtract((low, high), iv.point(np.full(self.count, middle)))))
            self._squares[k] = Fraction(middle), len(self.slopes) - 1
        return self._squares[k]

    def size(self, poly: Poly) -> Array:
        """Return an upper bound (B,) on a polynomial's absolute value."""
        total = np.zeros(self.count)
        for term, number in poly.items():
            size = np.full(self.count, abs(float(number)))
            for k in term:
                size = size * np.maximum(np.abs(self.slopes[k][0]), np.abs(self.slopes[k][1]))
            total = total + size
        return np.asarray(total * (1 + ROUNDING) + 1e-300)

    # ---- values at corners

    def points(self, polys: Sequence[Poly], which: NDArray[np.intp] | None = None) -> dict[Powers, Array]:
        """Return the points (J, B) of the monomials of cosine and sine in some polynomials."""
        powers = {(term.count(_COSINE), term.count(_SINE)) for poly in polys for term in poly}
        if not powers - {(0, 0)}:
            return {(0, 0): np.ones((1, self.count if which is None else len(which)))}
        chosen = slice(None) if which is None else which
        return monomials(self.middle[chosen], self.half[chosen], powers)

    def corners(self, polys: Sequence[Poly], which: NDArray[np.intp] | None = None) -> Array:
        """Return the values (len(polys), V, B) of polynomials at all corners of the slopes and points of the angle.

        Args:
            polys: the polynomials.
            which: positions of some boxes; None means all.
        """
        at, table = self.points(polys, which), dict[tuple[int, ...], Array]()
        shape = 1, len(polys), *next(iter(at.values())).shape
        for k, poly in enumerate(polys):
            for term, number in poly.items():
                own = tuple(one for one in term if one > _SINE)
                value = table.setdefault(own, np.zeros(shape))
                value[0, k] += float(number) * at[term.count(_COSINE), term.count(_SINE)]
        used = {k for term in table for k in term}
        values = _at_corners(table or {(): np.zeros(shape)}, self.groups(used, slice(None) if which is None else which))
        return np.moveaxis(values, 1, 0).reshape(len(polys), -1, shape[-1])

    def groups(self, used: set[int], which: NDArray[np.intp] | slice) -> list[_Group]:
        """Return slopes that vary together, with their values (V, 1, 1, B): pairs with a polytope, and single ones."""
        groups, left = list[_Group](), set(used)
        for pair, vertices in self.polytopes:
            slopes = [self._of_parameter.get(place, -1) for place in pair]
            if left.issuperset(slopes):
                left -= set(slopes)
                groups.append({k: vertices[:, place, None, None, None] for place, k in enumerate(slopes)})
        return groups + [{k: np.array([end[which] for end in self.slopes[k]])[:, None, None]} for k in sorted(left)]

    def _bounds(self, a: Number, which: NDArray[np.intp] | None = None) -> Ends:
        """Return the range of a number in all boxes (B,), or in some of them."""
        values, size = self.corners([a.poly], which)[0], self.size(a.poly)
        error = ROUNDING * (size if which is None else size[which]) + float(a.error) * (1 + ROUNDING)
        return values.min(axis=0) - error, values.max(axis=0) + error

    def _support(self, row: Sequence[Number]) -> Array:
        """Return an upper bound (B,) on |row · x|."""
        polys = [entry.poly for entry in row]
        extents = [own[1] for own, _ in self.box[: self.states]]
        sizes = [self.size(poly) for poly in polys]
        total = sum(float(entry.error) * extent for entry, extent in zip(row, extents, strict=True)) * (1 + ROUNDING)
        if len(set().union(*map(_used, polys))) > _FEW:
            return np.asarray(total + sum(size * extent for size, extent in zip(sizes, extents, strict=True)))
        values, most = self.corners(polys), np.array(sizes)
        for block in self._blocks:
            own, size, cover = values[block], most[block], self.cover[block, block]
            square = np.einsum("ivb,ij,jvb->vb", own, cover, own).max(axis=0)
            square = square + ROUNDING * np.einsum("ib,ij,jb->b", size, np.abs(cover), size)
            total = total + np.sqrt(np.maximum(square, 0.0)) * self.radius * (1 + ROUNDING)
        return np.asarray(total)

    # ---- the trim error

    def spread(self, metric: Array) -> tuple[int, Array]:
        """Return W (cells, n, n) with f(0, p) f(0, p)ᵀ ≤ θ² W in each cell, and the slope θ; −1 means θ = 1.

        θ is a slope that all of f(0, p) is a multiple of. The trace of P W for the given matrix P (n, n) is small.
        """
        values = [self.value(root) for root in self.roots]
        live = [k for k, one in enumerate(values) if one.poly or one.error]
        out = np.zeros((len(self.first), self.states, self.states))
        if not live:
            return -1, out
        polys = [values[k].poly for k in live]
        shared = set.intersection(*(set(term) for poly in polys for term in poly)) - {_COSINE, _SINE}
        factor = min(shared) if shared and not any(values[k].error for k in live) else -1
        polys = [{tuple(k for k in term if k != factor): x for term, x in poly.items()} for poly in polys]
        few, loss = self._fewer(polys)
        rounded = [ROUNDING * self.size(poly)[self.first] for poly in polys]
        loss += np.array([size + float(values[k].error) for k, size in zip(live, rounded, strict=True)])
        root = np.linalg.qr(np.linalg.cholesky(metric).T[:, live])[1]
        values_at = self.corners(few, self.first)
        for cell in range(len(self.first)):
            out[cell][np.ix_(live, live)] = _covering(values_at[:, :, cell], loss[:, cell], root)
        return factor, out

    def _fewer(self, polys: Sequence[Poly]) -> tuple[list[Poly], Array]:
        """Return polynomials with at most `_KEPT` slopes, and bounds (len(polys), cells) of what is left out."""
        influence: dict[int, float] = {}
        for poly in polys:
            for term, number in poly.items():
                for k in _used({term: number}) - {_COSINE, _SINE}:
                    size = self.size({tuple(other for other in term if other != k): number})
                    low, high = self.slopes[k]
                    influence[k] = influence.get(k, 0.0) + float((size * (high - low)).max())
        loss = np.zeros((len(polys), len(self.first)))
        for k in sorted(influence, key=lambda k: -influence[k])[_KEPT:]:
            low, high = self.slopes[k]
            middle = Fraction(float(np.mean(low / 2 + high / 2)))
            apart = iv.subtract((low, high), iv.point(np.full(self.count, float(middle))))
            far = np.maximum(np.abs(apart[0]), np.abs(apart[1]))
            new = list[Poly]()
            for at, poly in enumerate(polys):
                rest: Poly = {}
                for term, number in poly.items():
                    own = tuple(other for other in term if other != k)
                    if k in term:
                        loss[at] += (self.size({own: number}) * far)[self.first] * (1 + ROUNDING)
                    rest[own] = rest.get(own, Fraction(0)) + number * (middle if k in term else 1)
                new.append({term: number for term, number in rest.items() if number})
            polys = new
        return list(polys), loss


def _covering(points: Array, loss: Array, root: Array) -> Array:
    """Return W (d, d) with e eᵀ ≤ W for all e within ± loss (d,) of a convex combination of points (d, V).

    The trace of R W Rᵀ is small, for the matrix `root` = R (d, d).
    """
    q = root @ points
    d = len(q)
    scale, turn = np.linalg.eigh(q @ q.T / q.shape[1])
    ways = np.random.default_rng(0).normal(size=(64, d))
    ways = np.vstack([ways, (ways / np.sqrt(scale + 1e-12 * scale[-1] + 1e-300)) @ turn.T, np.eye(d)]) @ q
    few = q[:, np.unique([*ways.argmax(axis=1), *ways.argmin(axis=1)])]
    weights = np.full(few.shape[1], 1 / few.shape[1])
    for _ in range(80):  # the least trace is that of √M tr √M, with the weights for which tr √M is largest
        scale, turn = np.linalg.eigh((few * weights) @ few.T)
        scale = np.sqrt(np.maximum(scale, 1e-12 * scale[-1] + 1e-300))
        weights = weights * np.einsum("iv,ij,jv->v", few, (turn / scale) @ turn.T, few)
        weights /= weights.sum()
    shape = (turn * scale) @ turn.T * scale.sum()
    most = np.einsum("iv,ij,jv->v", q, np.linalg.inv(shape), q).max() * (1 + 1e-6)  # more than all rounding errors
    back = np.linalg.inv(root)
    whole = most * back @ shape @ back.T
    sizes = loss * np.linalg.norm(root, axis=0)
    if sizes.any():
        # (e + d)(e + d)ᵀ ≤ (1 + a) e eᵀ + (1 + 1/a) d dᵀ
        a = sizes.sum() / np.sqrt(max(np.trace(root @ whole @ root.T), 1e-300))
        box = np.divide(loss**2 * sizes.sum(), sizes, out=np.zeros_like(loss), where=sizes > 0)
        whole = (1 + a) * whole + (1 + 1 / a) * np.diag(box)
    return np.asarray(whole * (1 + 1e-6))


# ---- the decrease of V


@dataclass(frozen=True)
class Form:
    """A matrix S (n, n) of W = xᵀ S x, and Z (n, n) with W' = xᵀ (Aᵀ S + S A − Z) x for x' = A x."""

    s: Array
    z: Array


def held(p: Array, sampled: int, period: float, pull: float) -> list[Form]:
    """Return W at the beginning and at the end of a period, for states x and the sampled values x̂ of the first ones.

    W = xᵀ P x + (period − τ) · pull · (x − x̂)ᵀ P (x − x̂) with the time τ since the last instant, where the second P is
    the block of the first states. At an instant and at the end of a period it is V = xᵀ P x, and V ≤ W in between. The
    matrix that decides is linear in τ, so that W decreases all the time if it does so with both forms.

    Args:
        p: P (n, n).
        sampled: number of the first states that are sampled.
        period: the period [s].
        pull: weight of the difference [1/s].
    """
    n = len(p)
    apart = np.zeros((sampled, n + sampled))
    apart[:, :sampled], apart[:, n:] = np.eye(sampled), -np.eye(sampled)
    z, s = pull * apart.T @ p[:sampled, :sampled] @ apart, np.zeros((n + sampled,) * 2)
    s[:n, :n] = p
    return [Form(s + period * z, z), Form(s, z)]


class Decrease:
    """The test whether W decreases in all cells, for the rows of the rates of x.

    For f(0, p) f(0, p)ᵀ ≤ θ² R and η > 0, W' < −rate W where W ≥ low follows from Z − (Aᵀ S + S A) − (rate + η) S − θ²
    S R S/(η low) ≻ 0 at all corners, since the left side is a concave function of each slope. A matrix whose
    factorisation in doubles succeeds after a shift that exceeds all rounding errors is positive definite (Rump, BIT 46,
    2006).

    Attributes:
        corners: number of corners of a matrix.

    Args:
        cells: the rows.
        forms: the forms of W that decide.
        scale: a matrix (n, n), positive definite, of the size of W.
    """

    def __init__(self, cells: Cells, forms: Sequence[Form], scale: Array) -> None:
        self.cells, self.forms = cells, forms
        self._change = np.linalg.inv(np.linalg.cholesky(scale))
        self._sizes = np.abs(self._change), np.abs(self._change.T)
        self._lower = np.tril_indices(len(scale))
        self._factor, spread = cells.spread(scale)
        self._fixed = [(self._turned(form.z), self._turned(form.s)) for form in forms]
        self._trims = [self._turned(form.s @ spread @ form.s) for form in forms]
        loose = [np.abs(form.s) @ np.abs(spread) @ np.abs(form.s) for form in forms]
        self._loose = [[self._size(one) for one in each] for each in loose]
        error = np.array([[float(entry.error) for entry in row] for row in cells.rows]) * (1 + ROUNDING)
        self._error = [2 * self._size(np.abs(form.s) @ error) for form in forms]
        matrices = _matrices(cells)
        used = {k for term in matrices for k in term} | {self._factor}
        self._used = used - {-1, _COSINE, _SINE}
        points = cells.points([dict.fromkeys(matrices, Fraction(1))], cells.first)
        self._losses: list[dict[tuple[int, ...], Array]] = [{} for _ in forms]
        self._largest: list[dict[tuple[int, ...], float]] = [{} for _ in forms]
        for term, matrix in matrices.items():
            own = tuple(k for k in term if k > _SINE)
            at = points[term.count(_COSINE), term.count(_SINE)][..., None]
            for form, losses, largest in zip(forms, self._losses, self._largest, strict=True):
                loss = -(form.s @ matrix + matrix.T @ form.s)
                losses[own] = losses.get(own, 0.0) + at * self._turned(loss)[self._lower]
                bound = np.abs(form.s) @ np.abs(matrix)
                largest[own] = largest.get(own, 0.0) + 1.1 * self._size(bound + bound.T)  # more than all points
        self.corners = 2 ** len(self._used) * len(next(iter(points.values())))

    def _turned(self, matrices: Array) -> Array:
        return np.asarray(self._change @ matrices @ self._change.T)

    def _size(self, matrix: Array) -> float:
        """Return a bound of the sizes of all numbers in T M Tᵀ."""
        return float((self._sizes[0] @ np.abs(matrix) @ self._sizes[1]).sum())

    def growth(self, boxes: NDArray[np.intp], rate: float, low: float, growths: Sequence[float]) -> float | None:
        """Return the first η with which W decreases at a rate in some boxes where W ≥ low; None if there is none.

        Args:
            boxes: positions of the boxes.
            rate: the rate [1/s].
            low: the level.
            growths: values of η to be tried [1/s].
        """
        for growth in growths:
            if all(self._holds(box, rate, low, growth) for box in boxes.tolist()):
                return growth
        return None

    def _holds(self, box: int, rate: float, low: float, growth: float) -> bool:
        cell, slopes = self.cells.cell[box], self.cells.slopes
        groups = self.cells.groups(self._used, np.array([box]))
        largest = {k: max(abs(float(end[box])) for end in slopes[k]) for k in self._used}
        squares = np.ones((1,) * 4)
        if self._factor >= 0:
            squares = _at_corners({(self._factor,): squares}, groups) ** 2
        most = float(squares.max()) / (growth * low)
        for k, form in enumerate(self.forms):
            z, s = self._fixed[k]
            table = {term: value[None, :, cell, :, None] for term, value in self._losses[k].items()}
            size = sum(x * math.prod(largest[j] for j in term) for term, x in self._largest[k].items())
            size += self._size(form.z) + (rate + growth) * self._size(form.s) + most * self._loose[k][cell]
            fixed = z - (rate + growth) * s - (ROUNDING * size + self._error[k]) * np.eye(len(s))
            trim = squares * (self._trims[k][cell][self._lower] / (growth * low))[:, None]
            losses = _at_corners(table, groups) + fixed[self._lower][:, None] - trim
            if not (np.isfinite(size) and _are_definite(losses[..., 0], len(s))):
                return False
        return True


def _are_definite(entries: Array, n: int) -> bool:
    """Return whether all pivots of matrices (n, n), given by their lower triangles (..., n (n + 1)/2), are positive."""
    flat = np.ascontiguousarray(entries.reshape(-1, entries.shape[-1]).T)
    a = {pair: flat[k] for k, pair in enumerate(zip(*np.tril_indices(n), strict=True))}
    for k in range(n):
        if not np.all(a[k, k] > 0):  # a NaN fails this test too
            return False
        for i in range(k + 1, n):
            factor = a[i, k] / a[k, k]
            for j in range(k + 1, i + 1):
                a[i, j] = a[i, j] - factor * a[j, k]
    return True


def _matrices(cells: Cells) -> dict[tuple[int, ...], Array]:
    """Return the matrices (n, n) of each term of A."""
    out: dict[tuple[int, ...], Array] = {}
    for i, row in enumerate(cells.rows):
        for j, entry in enumerate(row):
            for term, number in entry.poly.items():
                out.setdefault(term, np.zeros((cells.states,) * 2))[i, j] += float(number)
    return out


def _at_corners(table: Mapping[tuple[int, ...], Array], groups: Sequence[_Group]) -> Array:
    """Return the values (V, ...) of a polynomial with coefficients (1, ...) of each term at all corners of its slopes.

    Args:
        table: the coefficients.
        groups: the values (K, ...) of slopes that vary together.
    """
    for group in groups:
        reduced: dict[tuple[int, ...], Array] = {}
        for term, value in table.items():
            more = np.ones((1,) * value.ndim)
            for k in set(term) & set(group):
                more = more * group[k]
            own = tuple(other for other in term if other not in group)
            count = len(next(iter(group.values())))
            whole = np.broadcast_to(value * more[:, None], (count, *np.broadcast_shapes(value.shape, more.shape[1:])))
            whole = whole.reshape(-1, *whole.shape[2:])
            reduced[own] = reduced[own] + whole if own in reduced else whole
        table = reduced
    return table[()]


# ---- functions of one variable


def secant(function: Tape, whole: Ends, rest: Ends, reach: Array) -> Ends:
    """Return the range (B,) of (g(c + d) − g(c))/d for c in `rest`, |d| ≤ `reach`, and c + d in `whole`."""
    width = np.maximum(2 * reach, 1e-300)
    count = int(np.clip(np.ceil(np.max((rest[1] - rest[0]) / width) * _FINE), 1, _MOST_PARTS))
    side = np.array([*(0.5**k / _PARTS for k in range(_HALVED, 0, -1)), *np.arange(1, _PARTS + 1) / _PARTS])
    steps = np.array([*-side[::-1], 0.0, *side])
    steps[[0, -1]] *= 1 + 1e-12
    ends = steps[:, None] * reach
    ranges = []
    for low, high in zip(*_cuts(rest, count), strict=True):
        d = ends[:-1], ends[1:]
        shape = d[0].shape
        c = np.broadcast_to(low, shape), np.broadcast_to(high, shape)
        inside = [np.broadcast_to(end, shape).reshape(1, -1) for end in whole]
        with np.errstate(all="ignore"):
            s = _secants(function, *((a.reshape(1, -1), b.reshape(1, -1)) for a, b in (c, d)), (inside[0], inside[1]))
        ranges.append((s[0].reshape(shape).min(axis=0), s[1].reshape(shape).max(axis=0)))
    return np.min([low for low, _ in ranges], axis=0), np.max([high for _, high in ranges], axis=0)


def _secants(function: Tape, c: Ends, d: Ends, whole: Ends) -> Ends:
    """Return the range of s(c, d) = (g(c + d) − g(c))/d on pieces (1, B) of c and d, for c + d in `whole`."""
    far = iv.add(c, d)
    t = np.clip(far[0], *whole), np.clip(far[1], *whole)
    [at_c], [jet] = function.everywhere(c, order=1), function.everywhere(t, order=1)
    assert at_c.slope is not None and jet.slope is not None
    between = slopes_on(function, (np.minimum(t[0], c[0]), np.maximum(t[1], c[1])))
    known = _common(between, iv.divide(iv.subtract(jet.value, at_c.value), d))
    # the mean value theorem with s_d = (g'(c + d) − s)/d and s_c = (g'(c + d) − g'(c))/d; it needs all of c + d
    read = function.run(far, order=1)
    slope = read.jets[0].slope
    assert slope is not None
    middle_c, middle_d = iv.point(c[0] / 2 + c[1] / 2), iv.point(d[0] / 2 + d[1] / 2)
    end, start = function.run(iv.add(middle_c, middle_d)), function.run(middle_c)
    first = iv.divide(iv.subtract(end.jets[0].value, start.jets[0].value), middle_d)
    every = _common(slopes_on(function, _hull(far, c)), iv.divide(iv.subtract(read.jets[0].value, at_c.value), d))
    by_d = iv.divide(iv.subtract(slope, every), d)
    by_c = iv.divide(iv.subtract(slope, at_c.slope), d)
    near = iv.add(
        first, iv.add(iv.multiply(by_d, iv.subtract(d, middle_d)), iv.multiply(by_c, iv.subtract(c, middle_c)))
    )
    fine = read.defined[0] & end.defined[0]
    return _common(known, (np.where(fine, near[0], -np.inf), np.where(fine, near[1], np.inf)))


def _cuts(a: Ends, count: int) -> tuple[Array, Array]:
    """Return the ends (count, B) of parts that cover intervals."""
    inner = [a[0] + (a[1] - a[0]) * (k / count) for k in range(1, count)]
    return np.array([a[0], *inner]), np.array([*inner, a[1]])


def _cut(a: Ends, count: int) -> Ends:
    return _cuts(a, count)


def _value(function: Tape, t: Ends) -> Ends:
    """Return the range of a function on intervals of any shape."""
    [jet] = function.everywhere((t[0].reshape(1, -1), t[1].reshape(1, -1)))
    return jet.value[0].reshape(t[0].shape), jet.value[1].reshape(t[0].shape)


def _of(op: str, *args: Ends, value: Fraction = Fraction(0)) -> Ends:
    """Return the range of an operation on intervals (B,) of its operands."""
    table = ExpressionTable([f"t{k}" for k in range(len(args))])
    root = table.put(op, *(table.put("var", value=k) for k in range(len(args))), value=value)
    [jet] = Tape(table, (root,)).everywhere((np.array([a[0] for a in args]), np.array([a[1] for a in args])))
    return jet.value


def _joined(a: Ends) -> Ends:
    return a[0].min(axis=0), a[1].max(axis=0)


def _hull(a: Ends, b: Ends) -> Ends:
    return np.minimum(a[0], b[0]), np.maximum(a[1], b[1])


def _common(a: Ends, b: Ends) -> Ends:
    return np.maximum(a[0], b[0]), np.minimum(a[1], b[1])


def _is_zero(a: Ends) -> bool:
    return not np.any(a[0]) and not np.any(a[1])


def _used(poly: Poly) -> set[int]:
    return {k for term in poly for k in term}
