"""Dynamics as x' = A(θ)(x − x*) on {V ≤ level}, with a matrix that has degree at most 1 in each slope θ.

The slopes are those of `surctl.certcheck.slope_rows`, in doubles and with sampled ranges: they only serve to propose V
and level, and the checker encloses the ranges itself. With feedbacks, the output of each limit lies between its operand
and a variable of its own, beside ξ: the value G·ξ of its feedback.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from surctl.errors import UnsupportedOperation
from surctl.lyapunov.dynamics import Dynamics
from surctl.verification.formula import Node, number, ordered, values_of, variable

__all__ = ["Embedding"]

Array = NDArray[np.float64]
Ends = tuple[float, float]
Poly = dict[tuple[int, ...], float]

_POINTS = 65  # samples of a range
_FEW = 6  # slopes of a row whose vertices are tried
_NARROW = 1e-9  # relative width of a range that counts as a number
_WIDER = 1e-3  # by which sampled ranges are widened, relative to their width


class Embedding:
    """The slopes of dynamics where |c·ξ|² ≤ c Q c', ξ = x − x*, for all rows c and one of the covers Q.

    Attributes:
        slopes: range of each slope.
        rows: the rows of A(θ), each a list (n,) of polynomials in the slopes; (n + k,) with the feedbacks of k limits.
        inner: for each expression whose range decides a slope, its value at x* and its row (n,) at all vertices (K, n).
        limits: for each limit with a feedback, the least distance of its operand at x* from it.
        operands: the row of each such operand (n + k,), in the middle of all slopes.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        covers: Array,
        *,
        rates: Sequence[Node] | None = None,
        feedbacks: Array | None = None,
    ) -> None:
        n = len(dynamics.names)
        self.dynamics, self.names = dynamics, dynamics.names
        self.feedbacks = np.zeros((0, n)) if feedbacks is None else feedbacks
        wide = np.vstack([np.eye(n), self.feedbacks])
        self.covers = wide @ covers @ wide.T
        self.limits: list[float] = []
        self.operands: list[Array] = []
        self._limits: dict[Node, tuple[int, Node]] = {}
        self.slopes: list[Ends] = []
        self.inner: list[tuple[Node, Array]] = []
        self._range: dict[Node, Ends] = {}
        self._rest: dict[Node, Ends] = {}
        self._base: dict[Node, Node | None] = {}
        self._numeric: dict[Node, bool] = {}
        self._rows: dict[Node, list[Poly]] = {}
        self._values: dict[Node, Poly] = {}
        self._inverses: dict[Node, Poly] = {}
        self._factors: dict[Node, Poly] = {}
        self._roots = [self._written(rate) for rate in (dynamics.rates if rates is None else rates)]
        self.rows = [self._row(root) for root in self._roots]

    def ends(self, k: int) -> Ends:
        """Return the range of a rate on the region."""
        (low, high), rest = self._range[self._roots[k]], self._rest[self._roots[k]]
        return min(low, rest[0]), max(high, rest[1])

    # ---- nodes

    def _written(self, root: Node) -> Node:
        new: dict[Node, Node] = {}
        for node in ordered(root):
            new[node] = self._put(Node(node.op, tuple(new[a] for a in node.args), node.value, node.name))
        return new[root]

    def _put(self, node: Node) -> Node:
        args, op = node.args, node.op
        free = [a for a in args if self._base[a] is not None]
        alone = len({self._base[a] for a in free}) == 1 and all(
            self._base[a] is not None or self._numeric[a] for a in args
        )
        one_sided = op in ("min", "max") and (self._base[args[0]] is None) != (self._base[args[1]] is None)
        if op in ("min", "max", "abs", "select") and not (one_sided and len(self.feedbacks)):
            chosen = self._decided(node)
            if chosen is not None:
                return chosen
        if free and not alone:
            if op == "div" and self._base[args[1]] is not None:
                return self._put(Node("mul", (args[0], self._put(Node("pow", (args[1],), number(-1).value)))))
            if op in ("min", "max") and not (one_sided and len(self.feedbacks)):
                return self._apart_from(node)
            if op == "atan2":
                if not self._range[args[1]][0] > 0:
                    raise UnsupportedOperation("atan2 with a second operand that may be negative", key="slopes")
                return self._put(Node("atan", (self._put(Node("div", args)),)))
            if op not in ("add", "sub", "neg", "mul", "div", "min", "max"):
                raise UnsupportedOperation(f"{op} of several variables", key="slopes")
        if node not in self._range:
            limit = self._limited(node)
            if limit is not None and len(self.limits) < len(self.feedbacks):
                self._limits[node] = len(self.limits), limit[0]
                self.limits.append(limit[1])
                alone = False
            self._numeric[node] = op in ("num", "pi") or (op != "var" and all(self._numeric[a] for a in args))
            if op == "var" and node.name in self.names:
                self._base[node] = node
            else:
                self._base[node] = None if not free else self._base[free[0]] if alone else node
            self._range[node], self._rest[node] = self._ranges(node)
        return node

    def _apart_from(self, node: Node) -> Node:
        apart = self._put(Node("sub", node.args[::-1]))
        return self._put(Node("add", (node.args[0], self._put(Node(node.op, (self._put(number(0)), apart))))))

    def _decided(self, node: Node) -> Node | None:
        ends = [(min(r[0], c[0]), max(r[1], c[1])) for r, c in ((self._range[a], self._rest[a]) for a in node.args)]
        args = node.args
        if node.op == "abs":
            return args[0] if ends[0][0] >= 0 else self._put(-args[0]) if ends[0][1] <= 0 else None
        first, second = (args[1], args[0]) if node.op == "max" else args[-2:]
        return first if ends[0][1] <= ends[1][0] else second if ends[0][0] > ends[1][1] else None

    def _limited(self, node: Node) -> tuple[Node, float] | None:
        """Return y and the least distance of y* from its limits, as the checker does."""
        free = {a: self._base[a] is None for a in node.args}
        if node.op not in ("min", "max") or len(set(free.values())) == 1:
            return None
        outer, inner = node.args if free[node.args[0]] else node.args[::-1]
        if inner.op not in {"min", "max"} - {node.op} or len({self._base[a] is None for a in inner.args}) == 1:
            return None
        other, y = inner.args if self._base[inner.args[0]] is None else inner.args[::-1]
        low, high = (other, outer) if node.op == "min" else (outer, other)
        gap = min(self._rest[high][0] - self._rest[y][1], self._rest[y][0] - self._rest[low][1])
        return (y, gap) if gap > 0 else None

    def _ranges(self, node: Node) -> tuple[Ends, Ends]:
        if node.op == "var":
            d = self.dynamics
            if node.name in self.names:
                k = self.names.index(node.name)
                at, extent = float(d.equilibrium[k]), float(np.sqrt(self.covers[:, k, k].max()))
                low, high = d.box[:, k]
                return (max(low, at - extent), min(high, at + extent)), (at, at)
            k = [w.name for w in d.parameters].index(node.name)
            return (d.ranges[0, k], d.ranges[1, k]), (d.ranges[0, k], d.ranges[1, k])
        own, rest = (_interval(node, [known[a] for a in node.args]) for known in (self._range, self._rest))
        base = self._base[node]
        if base is not None and base is not node:
            values = self._along(node, np.linspace(*self._range[base], _POINTS))
            still = self._along(node, np.array(self._rest[base]))
            own, rest = _common(own, (values.min(), values.max())), _common(rest, (still.min(), still.max()))
        elif base is node and (node.op not in ("min", "max") or node in self._limits):
            extent = self._support(self._row(node))
            own = _common(own, (rest[0] - extent, rest[1] + extent))
        if not np.all(np.isfinite((*own, *rest))):
            raise UnsupportedOperation("an expression that is not finite on the region", key="slopes")
        return own, rest

    def _along(self, node: Node, values: Array) -> Array:
        """Return the values of a function of its base."""
        base = self._base[node]
        inner: dict[Node, Node] = {}
        for each in ordered(node):
            inner[each] = (
                variable("t") if each == base else Node(each.op, tuple(inner[a] for a in each.args), each.value)
                if each.op != "var" else each
            )  # fmt: skip
        out: Array = values_of([inner[node]], dict.fromkeys(("t", *self.names), values))[0]
        return out

    # ---- rows and values

    def _row(self, node: Node) -> list[Poly]:
        if node not in self._rows:
            self._rows[node] = self._new_row(node)
        return self._rows[node]

    def _new_row(self, node: Node) -> list[Poly]:
        base, args = self._base[node], node.args
        if base is None:
            return [{} for _ in self.covers[0]]
        if base is not node and base != node:
            return self._scaled(self._slope(self._secant(node)), self._row(base))
        if node in self._limits:
            place, y = self._limits[node]
            self.operands.append(self._vertices_of(self._row(y), most=0)[0])
            share = self._slope((0.0, 1.0))
            own = self._scaled(share, self._row(y))
            own[len(self.names) + place] = _plus({(): 1.0}, self._times({(): -1.0}, share))
            return own
        match node.op:
            case "min" | "max":
                return self._row(self._apart_from(node))
            case "var":
                return [{(): 1.0} if k == self.names.index(node.name) else {} for k in range(len(self.covers[0]))]
            case "neg":
                return self._scaled({(): -1.0}, self._row(args[0]))
            case "add" | "sub":
                second = self._scaled({(): 1.0 if node.op == "add" else -1.0}, self._row(args[1]))
                return [_plus(a, b) for a, b in zip(self._row(args[0]), second, strict=True)]
            case "div":
                return self._scaled(self._inverse(args[1]), self._row(args[0]))
        a, b = args
        if self._base[a] is None or self._base[b] is None:
            a, b = (a, b) if self._base[a] is None else (b, a)
            return self._scaled(self._value(a), self._row(b))
        zero = [self._rest[k] == (0.0, 0.0) for k in (a, b)]
        cost = [
            (self._range[k][1] - self._range[k][0]) * self._support(self._row(other)) for k, other in ((a, b), (b, a))
        ]
        if (zero[0] and not zero[1]) if zero[0] != zero[1] else cost[0] > cost[1]:
            a, b = b, a
        if a not in self._factors:
            self._factors[a] = self._slope(self._range[a])
        first = self._scaled(self._factors[a], self._row(b))
        second = self._scaled(self._value(b), self._row(a))
        return [_plus(x, y) for x, y in zip(first, second, strict=True)]

    def _value(self, node: Node) -> Poly:
        if node not in self._values:
            exact = self._exact_value(node)
            self._values[node] = self._slope(self._rest[node]) if exact is None else exact
        return self._values[node]

    def _exact_value(self, node: Node) -> Poly | None:
        low, high = self._rest[node]
        if self._numeric[node] or low == high:
            return _number((low + high) / 2)
        args = node.args
        match node.op:
            case "neg":
                return self._times({(): -1.0}, self._value(args[0]))
            case "add":
                return _plus(self._value(args[0]), self._value(args[1]))
            case "sub":
                return _plus(self._value(args[0]), self._times({(): -1.0}, self._value(args[1])))
            case "mul":
                a, b = (self._value(a) for a in args)
                return None if {k for t in a for k in t} & {k for t in b for k in t} else self._times(a, b)
            case "div" if self._numeric[args[1]]:
                return self._times(self._value(args[0]), self._inverse(args[1]))
        return None

    def _inverse(self, node: Node) -> Poly:
        if node not in self._inverses:
            low, high = self._rest[node]
            if low <= 0 <= high:
                raise UnsupportedOperation("a division by an expression that may be 0", key="slopes")
            self._inverses[node] = self._slope((1 / high, 1 / low))
        return self._inverses[node]

    def _slope(self, ends: Ends) -> Poly:
        low, high = ends
        if high - low <= _NARROW * abs(high + low):
            return _number((low + high) / 2)
        self.slopes.append(ends)
        return {(len(self.slopes) - 1,): 1.0}

    def _scaled(self, factor: Poly, row: list[Poly]) -> list[Poly]:
        copies: dict[int, int] = {}
        return [self._times(factor, entry, copies) for entry in row]

    def _times(self, a: Poly, b: Poly, copies: dict[int, int] | None = None) -> Poly:
        copies = {} if copies is None else copies
        out: Poly = {}
        for s, x in a.items():
            for t, y in b.items():
                for k in set(s) & set(t) - set(copies):
                    self.slopes.append(self.slopes[k])
                    copies[k] = len(self.slopes) - 1
                term = tuple(sorted([*t, *(copies[k] if k in t else k for k in s)]))
                out[term] = out.get(term, 0.0) + x * y
        return {term: x for term, x in out.items() if x}

    def _secant(self, node: Node) -> Ends:
        base = self._base[node]
        assert base is not None
        low, high = self._range[base]
        t = np.linspace(low, high, _POINTS)
        slopes = []
        for c in dict.fromkeys((*self._rest[base], sum(self._rest[base]) / 2)):
            near = max(high - low, 1e-9) * 1e-5
            apart = np.where(np.abs(t - c) < near, near, t - c)
            value = self._along(node, np.array([c, c - near]))
            slopes += [(self._along(node, c + apart) - value[0]) / apart, np.array([(value[0] - value[1]) / near])]
        every = np.concatenate(slopes)
        every = every[np.isfinite(every)]
        if not every.size:
            raise UnsupportedOperation("an expression that is not finite on the region", key="slopes")
        spare = _WIDER * float(np.ptp(every)) if np.ptp(every) > 1e-6 * np.abs(every).max() else 0.0
        if base.op != "var":
            self.inner.append((base, self._vertices_of(self._row(base), most=2)))
        if not spare:
            return float(every.mean()), float(every.mean())
        return float(every.min()) - spare, float(every.max()) + spare

    def _vertices_of(self, row: list[Poly], most: int = _FEW) -> Array:
        used = sorted({k for entry in row for term in entry for k in term})[:most]
        middle = np.array([sum(ends) / 2 for ends in self.slopes])
        rows = []
        for ends in product(*(self.slopes[k] for k in used)):
            value = middle.copy()
            value[used] = ends
            rows.append([sum(x * np.prod(value[list(term)]) for term, x in entry.items()) for entry in row])
        return np.array(rows, dtype=float)

    def _support(self, row: list[Poly]) -> float:
        at = self._vertices_of(row)
        return float(np.sqrt(np.einsum("ki,cij,kj->ck", at, self.covers, at).clip(0).max()))


def _number(x: float) -> Poly:
    return {(): x} if x else {}


def _plus(a: Poly, b: Poly) -> Poly:
    out = dict(a)
    for term, x in b.items():
        out[term] = out.get(term, 0.0) + x
    return {term: x for term, x in out.items() if x}


def _common(a: Ends, b: Ends) -> Ends:
    low, high = max(a[0], float(b[0])), min(a[1], float(b[1]))
    return (low, high) if low <= high else ((low + high) / 2, (low + high) / 2)


def _interval(node: Node, args: Sequence[Ends]) -> Ends:
    """Return a range of an operation, by samples of its operands; sums and products are exact."""
    match node.op:
        case "num" | "pi":
            value = float(values_of([node], {"t": np.zeros(1)})[0, 0])
            return value, value
        case "add":
            return args[0][0] + args[1][0], args[0][1] + args[1][1]
        case "sub":
            return args[0][0] - args[1][1], args[0][1] - args[1][0]
    grids = np.meshgrid(*(np.linspace(*ends, 2 if node.op in ("mul", "neg") else 33) for ends in args))
    names = [f"a{k}" for k in range(len(args))]
    small = Node(node.op, tuple(variable(name) for name in names), node.value)
    values = values_of([small], {name: g.ravel() for name, g in zip(names, grids, strict=True)})
    return (float(values.min()), float(values.max())) if np.all(np.isfinite(values)) else (-np.inf, np.inf)
