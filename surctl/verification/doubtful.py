"""Points that refute an exact statement although doubles hide it: an expression is not defined, or digits cancel."""

from __future__ import annotations

import itertools
import math
import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from enum import Enum
from fractions import Fraction
from types import MappingProxyType
from typing import Any

import numpy as np
from flint import arb, ctx, fmpq
from numpy.typing import NDArray

from surctl.verification.formula import Node, Statement, number, ordered, power, substitute, text_of, values_of
from surctl.verification.proving.tape import build_tape
from surctl.verification.proving.touching import vanishes

# Values of expressions at one rational point, in balls of 256 bits (FLINT); whether a value exists is decided too.
#
# Doubles lose digits where large numbers cancel, and a value at which an expression is not defined (1/0, the logarithm
# of 0) is often hidden behind later operations. Here every number has its exact value, and a comparison with 0 that
# balls cannot decide is decided by exact rewriting.


_BITS = 256
_ZERO = arb(0)


class _Mark(Enum):
    UNDEFINED = "undefined"


UNDEFINED = _Mark.UNDEFINED
"""The result for an expression that has no value at the point."""

Value = Any  # a ball, UNDEFINED or None; flint has no types

_OPERATIONS: Mapping[str, Callable[..., arb]] = MappingProxyType(
    {"add": operator.add, "sub": operator.sub, "mul": operator.mul, "div": operator.truediv, "neg": operator.neg,
     "abs": abs, "pi": arb.pi, "min": arb.min, "max": arb.max,
     **{op: getattr(arb, op) for op in (
        "sqrt", "sin", "cos", "tan", "exp", "log", "atan", "atan2", "sinh", "cosh", "tanh")}}
)  # fmt: skip

_BOUNDED = frozenset({"sqrt", "log", "powr", "asin", "acos"})  # undefined where the expression of `_gap` is negative
_EDGES = frozenset({"sqrt", "asin", "acos"})  # defined where it is 0, as are powers with a positive exponent


def _gap(node: Node) -> Node | None:
    """Return the expression that is 0 at the edge of the domain of an operation; None if it is defined everywhere."""
    match node.op:
        case "div":
            return node.args[1]
        case "sqrt" | "log" | "powr":
            return node.args[0]
        case "pow" if node.value < 0:
            return node.args[0]
        case "asin" | "acos":
            return number(1) - power(node.args[0], 2)
        case "tan":
            return Node("cos", node.args)
        case "atan2":
            return power(node.args[0], 2) + power(node.args[1], 2)
    return None


class Pointwise:
    """The values of expressions at a point.

    Args:
        point: exact value of each variable.

    Example:
        >>> from fractions import Fraction
        >>> from surctl.verification.formula import parse, variable
        >>> from surctl.verification.doubtful import UNDEFINED, Pointwise
        >>> at = Pointwise({"x": Fraction(0)})
        >>> at.value(parse("1/(1/x)", {"x": variable("x")})) is UNDEFINED
        True
        >>> at.at_most_zero(parse("sin(pi) - x", {"x": variable("x")}))
        True
    """

    def __init__(self, point: Mapping[str, Fraction]) -> None:
        self._numbers = {name: number(value) for name, value in point.items()}
        self._known: dict[Node, Value] = {}
        self.culprit: Node | None = None

    def value(self, node: Node) -> Value:
        """Return a ball around the value of an expression, UNDEFINED, or None if neither is certain.

        The ball of a value that is certainly 0 is 0.
        """
        if node not in self._known:
            with ctx.workprec(_BITS):
                value = self._value(node)
            if value is UNDEFINED and self.culprit is None:
                self.culprit = node
            if isinstance(value, arb):
                value = value if value.is_finite() else None
                if value is not None and value.contains(0) and vanishes(substitute(node, self._numbers)):
                    value = _ZERO
            self._known[node] = value
        return self._known[node]

    def least(self, node: Node) -> float:
        """Return a lower bound of the value of an expression; −inf if it may be undefined."""
        value = self.value(node)
        if not isinstance(value, arb):
            return float("-inf")
        end = value.lower()
        near = float(end)
        return near if arb(near) <= end else math.nextafter(near, -math.inf)

    def at_most_zero(self, node: Node) -> bool:
        """Return whether an expression is certainly ≤ 0."""
        value = self.value(node)
        return isinstance(value, arb) and bool(value <= 0)

    def sign(self, node: Node) -> int | None:
        """Return the certain sign of an expression; None if it is not certain."""
        value = self.value(node)
        if not isinstance(value, arb):
            return None
        return 1 if value > 0 else -1 if value < 0 else 0 if value == 0 else None

    def _value(self, node: Node) -> Value:
        if node.op == "select":
            a, b, x, y = node.args
            if UNDEFINED in (self.value(a), self.value(b)):
                return UNDEFINED
            sign = self.sign(a - b)
            return None if sign is None else self.value(x if sign <= 0 else y)
        args: list[arb] = []
        for operand in node.args:
            value = self.value(operand)
            if not isinstance(value, arb):
                return value
            args.append(value)
        if (gap := _gap(node)) is not None:
            sign = self.sign(gap)
            if sign is None:
                return None
            edge = node.op in _EDGES or (node.op == "powr" and node.value > 0)
            if (sign < 0 and node.op in _BOUNDED) or (sign == 0 and not edge):
                return UNDEFINED
        match node.op:
            case "num" | "var":
                return arb(fmpq(*(node if node.op == "num" else self._numbers[node.name]).value.as_integer_ratio()))
            case "pow":
                return args[0] ** int(node.value)
            case "powr":
                return _ZERO if args[0] == 0 else args[0] ** arb(fmpq(*node.value.as_integer_ratio()))
            case "asin" | "acos":  # at 1, a ball may reach beyond
                rest = Node("sqrt", (number(1) - power(node.args[0], 2),))
                return self.value(Node("atan2", (node.args[0], rest) if node.op == "asin" else (rest, node.args[0])))
        return _OPERATIONS[node.op](*args)


Array = NDArray[np.float64]

_MOST_CORNERS = 8  # variables up to which all corners of the box are tried
_FEW = 3  # variables up to which the middles of faces are tried too
_MOST = 32  # points that are evaluated with 256 bits
_STARTS = 3  # local searches for each operation that may be undefined
_DECIMALS = range(9)
_SHORT = 60


def exceeding(statement: Statement, points: Array, threshold: float = 0.0) -> tuple[Mapping[str, float], float] | None:
    """Return a point of the domain at which left − right certainly exceeds a threshold, with a lower bound of it.

    Points at which intervals of doubles show left ≤ right are passed over; the others are evaluated with 256 bits.

    Args:
        statement: the statement.
        points: points (n, N) in the variables' units.
        threshold: excess that counts as rounding.
    """
    if not points.size:
        return None
    margin = statement.left - statement.right
    read = build_tape(statement.names, [margin, *statement.constraints]).run((points, points))
    outside = np.any([jet.value[0] > 0 for jet in read.jets[1:]] or [np.zeros(points.shape[1], dtype=bool)], axis=0)
    high = np.where(read.defined[0] & ~outside, read.jets[0].value[1], -np.inf)
    for k in np.argsort(-high, kind="stable")[:_MOST]:
        if not high[k] > threshold:
            break
        values = dict(zip(statement.names, (float(x) for x in points[:, k]), strict=True))
        at = _at(statement, values)
        if at is not None and (excess := at.least(margin)) > threshold:
            return values, excess
    return None


def undefined_at(statement: Statement, points: Array) -> tuple[Mapping[str, float], str] | None:
    """Return a point of the domain at which the statement is certainly not defined, and the operation without a value.

    At a pole that no decimal number is, the point is a double beside it: the denominator changes its sign between this
    double and its neighbour.

    Args:
        statement: the statement.
        points: points (n, N) in the variables' units.
    """
    root = statement.lower[:, None], statement.upper[:, None]
    tape = build_tape(statement.names, statement.parts)
    if all(fine[0] for fine in tape.run(root).defined):
        return None
    points = np.hstack([points, special_points(statement)])
    doubtful = ~np.logical_and.reduce(tape.run((points, points)).defined)
    gaps = list(_gaps(statement.parts, statement.names, root))
    candidates = [points[:, doubtful][:, :_MOST], *(_near(statement, gap, points) for gap, _ in gaps)]
    for x in itertools.chain.from_iterable(part.T for part in candidates):
        values = dict(zip(statement.names, map(float, x), strict=True))
        culprit = _undefined(statement, values)
        if culprit is not None:
            return values, _short(culprit)
    for gap, node in gaps:
        if node.op not in _BOUNDED:
            beside = _crossing(statement, gap, points)
            if beside is not None:
                return beside, f"{_short(node)}, at a pole less than one double away,"
    return None


def special_points(statement: Statement) -> Array:
    """Return corners (n, K) of the box; with few variables, also the points between with coordinates 0 or the middle.

    Samples miss them, and they are where expressions often have no value.
    """
    ends = [*zip(statement.lower.tolist(), statement.upper.tolist(), strict=True)]
    count = len(statement.names)
    if count > _MOST_CORNERS:
        return np.column_stack([statement.lower, statement.upper])
    inner = [(0.0, low / 2 + high / 2) if count <= _FEW else () for low, high in ends]
    axes = [
        sorted({low, high} | {x for x in between if low <= x <= high})
        for (low, high), between in zip(ends, inner, strict=True)
    ]
    return np.array(list(itertools.product(*axes)), dtype=float).T


def _at(statement: Statement, values: Mapping[str, float]) -> Pointwise | None:
    """Return the values at a point, each the decimal of its double; None unless it certainly lies in the domain."""
    at = _in_box(statement, values)
    return at if at is not None and all(at.at_most_zero(g) for g in statement.constraints) else None


def _in_box(statement: Statement, values: Mapping[str, float]) -> Pointwise | None:
    ends = zip(values.values(), statement.lower, statement.upper, strict=True)
    return _pointwise(values) if all(low <= x <= high for x, low, high in ends) else None


def _pointwise(values: Mapping[str, float]) -> Pointwise:
    return Pointwise({name: Fraction(repr(x)) for name, x in values.items()})


def _undefined(statement: Statement, values: Mapping[str, float]) -> Node | None:
    """Return the operation without a value at a point; None unless the point certainly refutes the statement."""
    at = _in_box(statement, values)
    if at is None:
        return None
    broken = [node for node in statement.parts if at.value(node) is UNDEFINED]
    others = [g for g in statement.constraints if g not in broken]
    return at.culprit if broken and all(at.at_most_zero(g) for g in others) else None


def _gaps(parts: Sequence[Node], names: Sequence[str], root: tuple[Array, Array]) -> Iterator[tuple[Node, Node]]:
    """Yield, for each operation that may be undefined in the box, an expression that is 0 at the edge, and the node."""
    for node in ordered(*parts):
        if (gap := _gap(node)) is None:
            continue
        low, high = build_tape(names, [gap]).run(root).jets[0].value
        if not (low[0] > 0 or (high[0] < 0 and node.op not in _BOUNDED)):
            yield gap, node


def _near(statement: Statement, gap: Node, points: Array) -> Array:
    """Return points (n, K) at which an expression is 0, or least, up to rounding, also with few decimals."""
    from scipy.optimize import minimize

    def read(x: Array) -> Array:
        values = values_of([gap], dict(zip(statement.names, x, strict=True)))[0]
        return np.where(np.isnan(values), np.inf, values)

    size = read(points)
    order = np.concatenate([np.argsort(np.abs(size))[:_STARTS], np.argsort(size)[:1]])
    ends = []
    for start in points[:, order].T:
        for aim in (np.abs, lambda g: g):
            run = minimize(
                lambda x, aim=aim: float(np.clip(aim(read(x[:, None]))[0], -1e6, 1e6)),
                start,
                bounds=[*zip(statement.lower, statement.upper, strict=True)],
                method="L-BFGS-B",
            )
            ends += [np.round(run.x, k) + 0.0 for k in _DECIMALS] + [run.x]
    return np.unique(np.array(ends), axis=0).T


def _crossing(statement: Statement, gap: Node, points: Array) -> Mapping[str, float] | None:
    """Return a point beside which a continuous expression changes its sign, within the domain; None if none is ends.

    Where the expression itself is not defined on the way, the statement is not defined either.
    """
    if any(node.op in ("select", "atan2") for node in ordered(gap)):
        return None
    names = statement.names
    rows = values_of([gap, *statement.constraints], dict(zip(names, points, strict=True)))
    inside = np.all(rows[1:] <= 0, axis=0) & np.isfinite(rows[0])
    ends = []
    for sign in (1, -1):
        own = np.flatnonzero(inside & (sign * rows[0] > 0))
        if not own.size:
            return None
        ends.append(points[:, own[np.argmin(np.abs(rows[0][own]))]])
    first, second = ends
    while True:
        middle = first + (second - first) / 2
        if np.all((middle == first) | (middle == second)):
            break
        if _pointwise(dict(zip(names, map(float, middle), strict=True))).sign(gap) == 1:  # doubles would err here
            first = middle
        else:
            second = middle
    return _signs_differ(statement, gap, first, second)


def _signs_differ(statement: Statement, gap: Node, first: Array, second: Array) -> Mapping[str, float] | None:
    """Return the second point if the signs at two neighbours certainly differ and their box lies in the domain."""
    low, high = np.minimum(first, second), np.maximum(first, second)
    read = build_tape(statement.names, statement.constraints).run((low[:, None], high[:, None]))
    if any(jet.value[1][0] > 0 for jet in read.jets):
        return None
    both = [dict(zip(statement.names, map(float, x), strict=True)) for x in (first, second)]
    signs = [_pointwise(values).sign(gap) for values in both]
    return both[1] if signs in ([1, -1], [-1, 1]) else None


def _short(node: Node) -> str:
    text = text_of(node)
    return text if len(text) <= _SHORT else f"{text[: _SHORT - 3]}..."
