"""Rows of slopes: every expression of dynamics as its value at x* plus a row times the distance from x*.

With ξ = x − x*, an expression is e(x, w) = e(x*, w) + r(θ)·ξ on {V ≤ level}, where the row r is a polynomial in slopes
θ, of degree at most 1 in each of them. If x* has radii, this holds for every x* within them. A slope is a parameter, a
secant slope of a function of one variable, the value of a factor, or the value of an expression at x*; interval
arithmetic encloses its range on {V ≤ level}. A slope that occurs twice in a product is replaced there by an independent
copy, which only adds cases. Parameters that are disturbances are linear variables beside ξ.

A limit clip(y) of an expression y may have a feedback G, which only the proof uses. Where lower ≤ y* + G·ξ ≤ upper on
the whole region, clip(y) lies between y and y* + G·ξ, so that its row is G + θ (r_y − G) with θ in [0, 1], and it is
exact at the border of the region (Hu and Lin, Control Systems with Actuator Saturation, 2001, lemma 1).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import product

import numpy as np
from mpmath import libmp
from numpy.typing import NDArray

from surctl.certcheck.document import Rejected
from surctl.certcheck.elementary import BITS, hull
from surctl.certcheck.enclosure import Interval, above, enclose, mul, outward, over, plus, rational
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.identity import Exact
from surctl.certcheck.jets import Tape, as_array, as_interval
from surctl.certcheck.patience import go_on
from surctl.certcheck.region_exact import Matrix, magnitude, relative_root_up
from surctl.certcheck.secants import common, fraction, pieces, secant

__all__ = ["Number", "Poly", "Row", "Rows"]

Row = NDArray[np.object_]  # of objects of the class `Number`, or fractions
Poly = dict[tuple[int, ...], Fraction]
"""A polynomial of degree at most 1 in each slope: coefficients by the sorted indices of the slopes in a term."""

_FEW = 6  # slopes of a row whose vertices are tried for its support
_NARROW = Fraction(1, 2**33)  # a slope with a smaller relative width counts as a number with an error
_MORE = 1 + Fraction(1, 10**6)  # least ratio of two costs that differ
_MOST_TERMS = 4096  # of a polynomial
_DIGITS = 26  # bits of the ends of a slope's range
_ZERO = (libmp.fzero, libmp.fzero)


@dataclass(frozen=True)
class Number:
    """A polynomial in the slopes with an error bound; sums of them, and products with numbers, are exact."""

    poly: Poly
    error: Fraction = Fraction(0)

    def __add__(self, other: Number | Fraction) -> Number:
        if not isinstance(other, Number):
            other = Number({(): other} if other else {})
        if not other.poly and not other.error:
            return self
        poly = dict(self.poly)
        for term, number in other.poly.items():
            total = poly.get(term, Fraction(0)) + number
            if total:
                poly[term] = total
            else:
                del poly[term]
        return Number(poly, self.error + other.error)

    def __mul__(self, factor: Fraction) -> Number:
        go_on()
        poly = {term: factor * number for term, number in self.poly.items()} if factor else {}
        return Number(poly, abs(factor) * self.error)

    __radd__, __rmul__ = __add__, __mul__

    def __neg__(self) -> Number:
        return self * Fraction(-1)

    def __sub__(self, other: Number | Fraction) -> Number:
        return self + -other


class Rows:
    """The rows of expressions where ξᵀ Q⁻¹ ξ ≤ level for a convex combination Q of the covers.

    Nodes are those of an own table without divisions by states and without atan2, min and max of two expressions; all
    lists are indexed by the position of the node.

    Attributes:
        rows: row of each rate or successor, a list of polynomials for the places in `linear`.
        slopes: range of each slope.
        limits: for the node of each limit with a feedback, its operand, the least distance of the operand at x* from
            the limits, and the feedback.
        linear: positions in `names` of the states and of the disturbances.

    Args:
        names: names of the states, then of the parameters.
        box: ranges of `names`, which hold on the region.
        rates: texts of the expressions.
        covers: matrices Q ≻ 0 (n, n); the only one is P⁻¹ if V = ξᵀ P ξ.
        centre: x* (n,), or the middle of the values that it may have.
        level: level of the region, about x*.
        disturbances: names of the parameters that are linear variables.
        feedbacks: G (n,) of each limit on both sides of its operand at x*, in the order in which `rates` name them.
        radii: how far x* may be from `centre` (n,); empty if it is there.
    """

    def __init__(
        self,
        names: Sequence[str],
        box: Sequence[Interval],
        rates: Sequence[str],
        covers: Sequence[Matrix],
        centre: Sequence[Fraction],
        level: Fraction,
        disturbances: Sequence[str] = (),
        feedbacks: Sequence[Sequence[Fraction]] = (),
        radii: Sequence[Fraction] = (),
    ) -> None:
        self.names, self.centre, self.radii = tuple(names), centre, radii
        self.states = len(centre)
        self.linear = [*range(self.states), *(k for k, name in enumerate(names) if name in disturbances)]
        # powers of 2 scale the doubles to about 1, so that none is rounded to 0 or overflows
        sizes = [max(cover[k][k] for cover in covers) for k in range(self.states)]
        self._unit = [Fraction(2) ** (magnitude(size) // 2) for size in sizes]
        scaled = [
            [[cover[i][j] / (s * t) for j, t in enumerate(self._unit)] for i, s in enumerate(self._unit)]
            for cover in covers
        ]
        self._inner = np.array([[[float(x) for x in row] for row in cover] for cover in scaled])
        self._radius = relative_root_up(level)
        self.table = ExpressionTable(names)
        self.range: dict[int, Interval] = {}  # of each node on the region
        self.rest: dict[int, Interval] = {}  # of each node at x*, without disturbances
        self.base: dict[int, int] = {}  # node of which it is a function of one variable; −1 if it has no state
        self.slopes: list[tuple[Fraction, Fraction]] = []
        self._rows: dict[int, Row] = {}
        self._values: dict[tuple[str, int], Number] = {}
        self._numeric: dict[int, bool] = {}
        self.limits: dict[int, tuple[int, Fraction, Sequence[Fraction]]] = {}
        self._feedbacks = feedbacks
        self.box = self._variables(box)
        source = ExpressionTable(names)
        self.roots = self._rewritten(source, [source.read(text) for text in rates])
        self.rows = [self.row(root) for root in self.roots]

    def _variables(self, box: Sequence[Interval]) -> list[tuple[Interval, Interval]]:
        """Return ranges on the region, and values at x*, of all variables."""
        ends = []
        for k, own in enumerate(box):
            if k < self.states:
                at = _around(rational(self.centre[k]), self.radii[k]) if self.radii else rational(self.centre[k])
                extent = self._ellipsoid([Fraction(j == k) for j in range(self.states)])
                ends.append((common(own, _around(at, extent)), at))
            elif k in self.linear:
                ends.append((hull(own, _ZERO), _ZERO))
            else:
                ends.append((own, own))
        return ends

    def _ellipsoid(self, row: list[Fraction]) -> Fraction:
        """Return an upper bound on |row · ξ| where ξᵀ Q⁻¹ ξ ≤ level, for any convex combination Q of the covers."""
        scaled = [x * unit for x, unit in zip(row, self._unit, strict=True)]
        if not any(scaled):
            return Fraction(0)
        unit = Fraction(2) ** magnitude(max(map(abs, scaled)))
        own = np.array([float(x / unit) for x in scaled])
        most = float((own @ self._inner @ own).max())
        size = float((np.abs(own) @ np.abs(self._inner) @ np.abs(own)).max())
        # the rounding errors of n² + 2n products and of their factors are below 1e-12 of their sizes
        return Fraction(float(np.sqrt(max(most, 0.0) + 1e-12 * size)) * (1 + 1e-12)) * unit * self._radius

    # ---- the expressions

    def _rewritten(self, source: ExpressionTable, roots: Sequence[int]) -> list[int]:
        new: dict[int, int] = {}
        for at in source.needed(roots):
            go_on()
            entry = source.entries[at]
            new[at] = self._put(entry.op, tuple(new[a] for a in entry.args), entry.value)
        return [new[root] for root in roots]

    def _put(self, op: str, args: tuple[int, ...], value: Fraction = Fraction(0)) -> int:
        """Return the node of an operation, written without operations that the rule does not have."""
        free = [a for a in args if self.base[a] >= 0]
        alone = len({self.base[a] for a in free}) == 1 and all(
            self.base[a] >= 0 or self._numeric[a] for a in args
        )  # a function of one variable
        one_sided = op in ("min", "max") and (self.base[args[0]] < 0) != (self.base[args[1]] < 0)
        if op in ("min", "max", "abs", "select") and not (one_sided and self._feedbacks):
            chosen = self._decided(op, args)
            if chosen is not None:
                return chosen
        if free and not alone:
            if op == "div" and self.base[args[1]] >= 0:
                return self._put("mul", (args[0], self._put("pow", (args[1],), Fraction(-1))))
            if op == "mul" and (grouped := self._grouped(args)) is not None:
                return grouped
            if op in ("min", "max") and not (one_sided and self._feedbacks):
                return self._apart_from(op, args)
            if op == "atan2":
                if not above(self.range[args[1]]):
                    raise Rejected("the slope rule needs a positive second operand of atan2")
                return self._put("atan", (self._put("div", args),))
        at = self.table.put(op, *args, value=value)
        if at not in self.range:
            limit = self._limited(op, args)
            if limit is not None and len(self.limits) < len(self._feedbacks):
                self.limits[at] = *limit, self._feedbacks[len(self.limits)]
                alone = False
            self._numeric[at] = op in ("num", "pi") or (op != "var" and all(self._numeric[a] for a in args))
            if not free:
                self.base[at] = at if op == "var" and value.numerator in self.linear else -1
            else:
                self.base[at] = self.base[free[0]] if alone else at
            self.range[at], self.rest[at] = self._ranges(at)
        return at

    def _grouped(self, args: tuple[int, ...]) -> int | None:
        """Return a product in which two functions of one variable are multiplied first; None for other products.

        With a p without states, (p q) b is p (q b). If b is not 0 at the equilibrium, (a + p q) b is a b + p (q b).
        """
        for whole, b in (args, args[::-1]):
            op, parts, _ = self.table.entries[whole]
            for p, q in (parts, parts[::-1]) if op == "mul" else ():
                if self.base[p] < 0 <= self.base[b] == self.base[q]:
                    return self._put("mul", (p, self._put("mul", (q, b))))
            if op in ("add", "sub") and self.rest[b] != _ZERO and any(self._shares(part, b) for part in parts):
                first, second = (self._put("mul", (part, b)) for part in parts)
                return self._put(op, (first, second))
        return None

    def _shares(self, at: int, b: int) -> bool:
        """Return whether an expression is a function of the same variable as b, or one times a p without states."""
        entry = self.table.entries[at]
        factors = entry.args if entry.op == "mul" else (at,)
        return [self.base[part] for part in factors if self.base[part] >= 0] == [self.base[b]]

    def _apart_from(self, op: str, args: tuple[int, ...]) -> int:
        """Return a + op(0, b − a) for op(a, b)."""
        apart = self._put("sub", (args[1], args[0]))
        return self._put("add", (args[0], self._put(op, (self._put("num", ()), apart))))

    def _decided(self, op: str, args: tuple[int, ...]) -> int | None:
        """Return the operand that the function takes on the whole region and at x*; None if it is not decided."""
        whole = [hull(self.range[a], self.rest[a]) for a in args]
        if op == "abs":
            if libmp.mpf_ge(whole[0][0], libmp.fzero):
                return args[0]
            return self._put("neg", args) if libmp.mpf_le(whole[0][1], libmp.fzero) else None
        first, second = (args[1], args[0]) if op == "max" else args[-2:]
        if libmp.mpf_le(whole[0][1], whole[1][0]):
            return first
        return second if libmp.mpf_gt(whole[0][0], whole[1][1]) else None

    def _limited(self, op: str, args: tuple[int, ...]) -> tuple[int, Fraction] | None:
        """Return y and the least distance of y* from its limits, if the operation limits y on both sides.

        It is min(max(y, lower), upper) or max(min(y, upper), lower) with limits without states, lower < y* < upper.
        """
        if op not in ("min", "max") or (self.base[args[0]] < 0) == (self.base[args[1]] < 0):
            return None
        outer, inner = args if self.base[args[0]] < 0 else args[::-1]
        entry = self.table.entries[inner]
        free = [self.base[a] < 0 for a in entry.args]
        if entry.op not in {"min", "max"} - {op} or free[0] == free[1]:
            return None
        other, y = entry.args if free[0] else entry.args[::-1]
        low, high = (other, outer) if op == "min" else (outer, other)
        gap = min(fraction(self._apart(high, y)[0]), fraction(self._apart(y, low)[0]))
        return (y, gap) if gap > 0 else None

    def _apart(self, a: int, b: int) -> Interval:
        """Return a − b at x*."""
        return libmp.mpi_sub(self.rest[a], self.rest[b], BITS)

    def _ranges(self, at: int) -> tuple[Interval, Interval]:
        entry = self.table.entries[at]
        if entry.op == "var":
            return self.box[entry.value.numerator]
        small = ExpressionTable([str(k) for k in range(len(entry.args))])
        root = small.put(entry.op, *(small.put("var", value=k) for k in range(len(entry.args))), value=entry.value)
        own, rest = (enclose(small, [root], [known[a] for a in entry.args])[0] for known in (self.range, self.rest))
        if 0 <= self.base[at] != at:
            image, still = self._image(at)
            own, rest = common(own, image), common(rest, still)
        elif self.base[at] == at and (entry.op not in ("min", "max") or at in self.limits):
            own = common(own, _around(rest, self._support(self.row(at))))
        return own, rest

    def _image(self, at: int) -> tuple[Interval, Interval]:
        """Return the range on the region, and that at x*, of a function of its base."""
        function, base = self._function(at), self.base[at]
        covered = pieces(self.range[base], outward(self.rest[base]))
        ends, [rest] = function.everywhere(covered)[0].value, function.everywhere(as_array(self.rest[base]))
        return as_interval(ends), as_interval(rest.value)

    def _support(self, row: Row) -> Fraction:
        """Return an upper bound on |row · (ξ, w)|."""
        used = sorted({k for entry in row for term in entry.poly for k in term})
        n, total = self.states, Fraction(0)
        for k, entry in enumerate(row):
            size = self.size(entry) if k >= n or len(used) > _FEW else entry.error
            total += size * self._extent(k)
        if len(used) > _FEW:
            return total
        most = Fraction(0)
        for ends in product(*(self.slopes[k] for k in used)):
            value = dict(zip(used, ends, strict=True))
            most = max(most, self._ellipsoid([_evaluated(entry.poly, value) for entry in row[:n]]))
        return most + total

    def _extent(self, k: int) -> Fraction:
        """Return an upper bound on |ξ_k|, or on the disturbance of this place."""
        own, rest = self.box[self.linear[k]]
        return fraction(libmp.mpi_abs(libmp.mpi_sub(own, rest, BITS), BITS)[1])

    # ---- rows and values as polynomials in the slopes

    def row(self, at: int) -> Row:
        """Return r with e(x, p) = e(x*, p) + r·(ξ, w) on the region, for the node e."""
        if at not in self._rows:
            go_on()
            self._rows[at] = self._row(at)
        return self._rows[at]

    def _row(self, at: int) -> Row:
        entry, base = self.table.entries[at], self.base[at]
        args = entry.args
        if base < 0:
            return np.array([Number({})] * len(self.linear), dtype=object)
        if base != at:
            return self._scaled(self._slope(self._secant(at)), self.row(base))
        if at in self.limits:
            return self._limit_row(at)
        match entry.op:
            case "var":
                own = entry.value.numerator
                return np.array([Number({(): Fraction(1)} if k == own else {}) for k in self.linear], dtype=object)
            case "neg":
                return np.negative(self.row(args[0]))
            case "add":
                return np.add(self.row(args[0]), self.row(args[1]))
            case "sub":
                return np.subtract(self.row(args[0]), self.row(args[1]))
            case "div":
                return self._scaled(self._inverse(args[1]), self.row(args[0]))
            case "mul":
                a, b = args
                if self.base[a] < 0 or self.base[b] < 0:
                    a, b = (a, b) if self.base[a] < 0 else (b, a)
                    return self._scaled(self._value(a), self.row(b))
                a, b = self._ordered(a, b)
                # a b − a* b* = a (b − b*) + b* (a − a*)
                return np.add(self._scaled(self._factor(a), self.row(b)), self._scaled(self._value(b), self.row(a)))
            case "min" | "max":
                return self.row(self._apart_from(entry.op, args))
        raise Rejected(f"the slope rule does not cover {entry.op} of several variables")

    def _limit_row(self, at: int) -> Row:
        """Return the row G + θ (r_y − G), θ in [0, 1], of a limit of y; raise Rejected if G reaches the limits."""
        y, gap, feedback = self.limits[at]
        if len(feedback) != self.states or self._ellipsoid(list(feedback)) > gap:
            raise Rejected("the feedback of a limit does not stay within the limit")
        row: Row = np.array([*feedback, *[Fraction(0)] * (len(self.linear) - self.states)], dtype=object)
        apart = np.subtract(self.row(y), row)
        return np.asarray(self._scaled(self._slope((libmp.fzero, libmp.fone)), apart) + row)

    def _ordered(self, a: int, b: int) -> tuple[int, int]:
        """Return two factors so that the first one, whose value becomes a slope, is the better one."""
        zero = [self.rest[k] == _ZERO for k in (a, b)]

        def cost(one: int, other: int) -> Fraction:
            low, high = self.range[one]
            return (fraction(high) - fraction(low)) * self._support(self.row(other))

        # rounding must not decide between equal costs
        swap = zero[0] and not zero[1] if zero[0] != zero[1] else cost(a, b) > cost(b, a) * _MORE
        return (b, a) if swap else (a, b)

    def _value(self, at: int) -> Number:
        """Return the value of a node at x*, without disturbances, as a polynomial in parameters, or as a slope."""
        key = "value", at
        if key not in self._values:
            self._values[key] = self._exact_value(at) or self._slope(self.rest[at], self.range[at])
        return self._values[key]

    def _factor(self, at: int) -> Number:
        """Return the value of a node on the region as a slope, the same one in all products."""
        key = "factor", at
        if key not in self._values:
            self._values[key] = self._slope(self.range[at])
        return self._values[key]

    def _exact_value(self, at: int) -> Number | None:
        entry, narrow = self.table.entries[at], self.rest[at]
        if entry.op == "num":
            return Number({(): entry.value} if entry.value else {})
        if narrow[0] == narrow[1]:
            number = fraction(narrow[0])
            return Number({(): number} if number else {})
        if self._numeric[at]:
            return None
        args = entry.args
        match entry.op:
            case "var" if self.base[at] < 0:
                return self._slope(narrow)
            case "var":
                return None if self.radii else Number({(): self.centre[entry.value.numerator]})
            case "neg":
                return -self._value(args[0])
            case "add":
                return self._value(args[0]) + self._value(args[1])
            case "sub":
                return self._value(args[0]) - self._value(args[1])
            case "mul":
                a, b = (self._value(a) for a in args)
                if {k for t in a.poly for k in t} & {k for t in b.poly for k in t}:
                    return None
                return self.times(a, b)
            case "div" if self._numeric[args[1]]:
                return self.times(self._value(args[0]), self._inverse(args[1]))
        return None

    def _inverse(self, at: int) -> Number:
        """Return 1/e of a node without states."""
        key = "inverse", at
        if key not in self._values:
            entry = self.table.entries[at]
            if entry.op == "num" and entry.value:
                self._values[key] = Number({(): 1 / entry.value})
            else:
                self._values[key] = self._slope(over(rational(Fraction(1)), self.rest[at]))
        return self._values[key]

    def _slope(self, ends: Interval, whole: Interval = _ZERO) -> Number:
        """Return a new slope with this range, or a number with an error if the range is narrow.

        With radii, a range that is narrow relative to `whole`, the values in the region, is narrow too.
        """
        low, high = (fraction(end) for end in ends)
        middle, half = (low + high) / 2, (high - low) / 2
        if half <= _NARROW * max([abs(middle), *(abs(fraction(end)) for end in whole if self.radii)]):
            return Number({(): middle} if middle else {}, half)
        self.slopes.append(_rounded(ends))
        return Number({(len(self.slopes) - 1,): Fraction(1)})

    # ---- arithmetic of polynomials

    def size(self, a: Number) -> Fraction:
        """Return an upper bound on |a|."""
        total = a.error
        for term, number in a.poly.items():
            size = abs(number)
            for k in term:
                size *= max(abs(end) for end in self.slopes[k])
            total += size
        return total

    def _scaled(self, factor: Number, row: Row) -> Row:
        # one copy of a slope that occurs twice serves the whole row
        copies: dict[int, int] = {}
        return np.array([self.times(factor, entry, copies) for entry in row], dtype=object)

    def times(self, a: Number, b: Number, copies: dict[int, int] | None = None) -> Number:
        """Return a b; a slope of both is replaced by a copy, which is also that of other products with `copies`."""
        if not (a.poly or a.error) or not (b.poly or b.error):
            return Number({})
        go_on()
        copies = {} if copies is None else copies
        error = a.error * self.size(b) + (self.size(a) - a.error) * b.error
        poly: Poly = {}
        for s, x in a.poly.items():
            for t, y in b.poly.items():
                term = list(t)
                for k in s:
                    if k in t and k not in copies:
                        copies[k] = self._copy(k)
                    term.append(copies[k] if k in t else k)
                key = tuple(sorted(term))
                poly[key] = poly.get(key, Fraction(0)) + x * y
        if len(poly) > _MOST_TERMS:
            raise Rejected("the slope rule needs too many terms")
        return Number({key: number for key, number in poly.items() if number}, error)

    def _copy(self, k: int) -> int:
        self.slopes.append(self.slopes[k])
        return len(self.slopes) - 1

    # ---- functions of one variable

    def _function(self, at: int) -> Tape:
        """Return the node `at` as a function of its base."""
        small, base = ExpressionTable(["t"]), self.base[at]
        new = {base: small.put("var", value=0)}
        for k in self.table.needed([at]):
            entry = self.table.entries[k]
            if k not in new and all(a in new for a in entry.args) and entry.op != "var":
                new[k] = small.put(entry.op, *(new[a] for a in entry.args), value=entry.value)
        return Tape(small, (new[at],))

    def _secant(self, at: int) -> Interval:
        """Return the range of (g(t) − g(c))/(t − c), for t in the range of the base and c its value at x*."""
        base = self.base[at]
        return secant(self._function(at), self.range[base], self.rest[base])

    def resting(self, k: int, moved: Fraction) -> Number:
        """Return f_k(centre, w) − moved without disturbances; it is the number 0 only if it is exactly 0."""
        table, small = self.table, ExpressionTable(self.names)
        new: dict[int, int] = {}
        for at in table.needed([self.roots[k]]):
            entry = table.entries[at]
            if entry.op == "var" and entry.value.numerator in self.linear:
                place = entry.value.numerator
                new[at] = small.put("num", value=self.centre[place] if place < self.states else 0)
            elif self.rest[at] == _ZERO:  # decides a branch
                new[at] = small.put("num")
            else:
                new[at] = small.put(entry.op, *(new[a] for a in entry.args), value=entry.value)
        exactly = Exact(small)
        apart = small.put("sub", new[self.roots[k]], small.put("num", value=moved))
        if not exactly.of(apart)[0] and not exactly.assumed:
            return Number({})
        # the mean value theorem bounds it more closely where terms in the parameters cancel
        box = [own for own, _ in self.box]
        middle = [rational((fraction(low) + fraction(high)) / 2) for low, high in box]
        [total], [jet] = enclose(small, [apart], middle), Tape(small, (apart,)).everywhere(as_array(*box), order=1)
        assert jet.slope is not None
        for low, high, own, at_middle in zip(*jet.slope, box, middle, strict=True):
            total = plus(total, mul(as_interval((low, high)), libmp.mpi_sub(own, at_middle, BITS)))
        return self._slope(common(plus(self.rest[self.roots[k]], rational(-moved)), total))


def _rounded(a: Interval) -> tuple[Fraction, Fraction]:
    """Return an interval around `a` whose ends have few digits."""
    low, high = libmp.mpf_pos(a[0], _DIGITS, "f"), libmp.mpf_pos(a[1], _DIGITS, "c")
    return fraction(low), fraction(high)


def _around(a: Interval, extent: Fraction) -> Interval:
    """Return the numbers that differ from one in the interval by at most `extent`."""
    end = rational(extent)[1]
    return libmp.mpi_add(a, (libmp.mpf_neg(end), end), BITS)


def _evaluated(poly: Poly, value: Mapping[int, Fraction]) -> Fraction:
    total = Fraction(0)
    for term, number in poly.items():
        for k in term:
            number *= value[k]
        total += number
    return total
