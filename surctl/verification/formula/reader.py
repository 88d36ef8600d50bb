"""Convert CasADi SX expressions to expressions of the claim grammar, operation by operation."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations_with_replacement
from types import MappingProxyType

import casadi as ca

from surctl.errors import UnsupportedOperation
from surctl.verification.formula.node import PI, Node, number, power, variable
from surctl.verification.formula.parser import FUNCTIONS

__all__ = ["from_casadi"]

_SHARES = tuple(Fraction(p, q) for p in range(1, 5) for q in (1, 2, 3, 4, 6))
_PI_PARTS: Mapping[float, Fraction] = MappingProxyType(
    {sign * math.pi * p.numerator / p.denominator: sign * p for p in _SHARES for sign in (1, -1)}
)
_NAMES: Mapping[int, str] = MappingProxyType(
    {int(getattr(ca, n)): n[3:].lower() for n in dir(ca) if n.startswith("OP_")}
)
_PLAIN = MappingProxyType(
    {"add": "add", "sub": "sub", "mul": "mul", "div": "div", "neg": "neg", "sqrt": "sqrt", "fabs": "abs",
     "fmin": "min", "fmax": "max", "sin": "sin", "cos": "cos", "atan2": "atan2", "acos": "acos", "atan": "atan",
     "asin": "asin", "tan": "tan", "exp": "exp", "log": "log", "sinh": "sinh", "cosh": "cosh", "tanh": "tanh"}
)  # fmt: skip
_COMPOSED: Mapping[str, Callable[..., Node]] = MappingProxyType(
    {"sq": lambda x: power(x, 2), "twice": lambda x: number(2) * x, "inv": lambda x: number(1) / x,
     "fma": lambda x, y, z: x * y + z, "log1p": lambda x: Node("log", (number(1) + x,)),
     "expm1": lambda x: Node("exp", (x,)) - number(1)}
)  # fmt: skip
_SUBSTITUTES: Mapping[str, str] = MappingProxyType(
    {"hypot": "write sqrt(x*x + y*y)", "sign": "write if_else(x < 0, -1, 1)", "copysign": "use if_else and fabs",
     "asinh": "write log(x + sqrt(x*x + 1))", "acosh": "write log(x + sqrt(x*x - 1))",
     "atanh": "write log((1 + x)/(1 - x))/2"}
)  # fmt: skip
_COMMUTATIVE = frozenset({"add", "mul"})
_COMPARISONS = frozenset({"lt", "le"})
_LONG = 15  # a number with at least this many digits is assumed to result from rounding
_LARGEST_SHARE = 1000  # an exponent of 15 digits or more is read as a fraction with at most this denominator
_LARGEST_POWER = 64


@dataclass(frozen=True)
class _Comparison:
    # a < b or a <= b, or its negation
    op: str
    a: Node
    b: Node
    negated: bool = False


@dataclass(frozen=True)
class _Branch:
    # the value if the comparison holds, otherwise 0
    condition: _Comparison
    value: Node


_Value = Node | _Comparison | _Branch


def from_casadi(
    symbols: ca.SX, names: Sequence[str], expressions: Sequence[ca.SX], *, to_the_bit: bool = False
) -> list[Node]:
    """Convert scalar SX expressions in the symbols to expressions of the grammar.

    With `to_the_bit`, every number is exactly the double of the instruction list, as the exported code has it; nothing
    is guessed. Otherwise the expressions stand for a formula on paper, which was written with decimals: a number
    becomes the shortest decimal number whose nearest double is the constant in the CasADi expression. CasADi evaluates
    constant subexpressions when they are created. Therefore a constant that equals a fraction of π in double precision
    is read as this fraction of π, and an exponent that equals a fraction such as 1/3 as this fraction. A constant of 15
    digits or more that equals the rounded product of two other constants is read as this product.

    A power with a variable exponent, x^y, becomes exp(y*log(x)), which is defined for x > 0.

    Args:
        symbols: column of symbols (n, 1).
        names: names of the symbols, in order.
        expressions: scalar expressions, dense or structurally zero.
        to_the_bit: whether numbers are the doubles themselves, as for a law or plant; not for a formula on paper.

    Raises:
        UnsupportedOperation: an expression has an operation that the grammar lacks, such as floor or a logical
            operation other than a comparison.
    """
    function = ca.Function("claim", [symbols], [ca.densify(ca.vertcat(*expressions, 0))])
    count = function.n_instructions()
    ops = [_NAMES.get(function.instruction_id(k), "unknown") for k in range(count)]
    constants = [float(function.instruction_constant(k)) for k in range(count) if ops[k] == "const"]
    reader = _Reader(guess=not to_the_bit)
    slots: dict[int, _Value] = {}  # CasADi reuses work slots: each write gives a slot a new value
    stored: dict[int, Node] = {}
    for k, op in enumerate(ops):
        args, result = function.instruction_input(k), function.instruction_output(k)
        if op == "output":
            stored[int(result[1])] = _plain(slots[args[0]], op)
        elif op == "input":
            slots[result[0]] = reader.put(variable(names[args[1]]))
        elif op == "const":
            value = float(function.instruction_constant(k))
            slots[result[0]] = reader.put(_double(value) if to_the_bit else _constant(value, constants))
        else:
            slots[result[0]] = reader.put(reader.operation(op, [slots[a] for a in args]))
    return [stored[k] for k in range(len(expressions))]


class _Reader:
    # operands of sums and products are ordered by their first occurrence, so that equal expressions have equal nodes
    def __init__(self, *, guess: bool) -> None:
        self._guess = guess
        self._order: dict[_Value, int] = {}

    def put(self, value: _Value) -> _Value:
        self._order.setdefault(value, len(self._order))
        return value

    def operation(self, op: str, values: Sequence[_Value]) -> _Value:
        if op in _COMPARISONS:
            return _Comparison(op, _plain(values[0], op), _plain(values[1], op))
        if op == "not" and isinstance(condition := values[0], _Comparison):
            return _Comparison(condition.op, condition.a, condition.b, not condition.negated)
        if op == "if_else_zero" and isinstance(condition := values[0], _Comparison):
            return _Branch(condition, _plain(values[1], op))
        if op == "add" and (joined := _joined(*values)) is not None:
            return joined
        if op in _COMMUTATIVE:
            values = sorted(values, key=lambda v: self._order[v])
        args = [_plain(v, op) for v in values]
        if op in _PLAIN:
            return Node(_PLAIN[op], tuple(args))
        if op in _COMPOSED:
            return _COMPOSED[op](*args)
        if op in ("pow", "constpow"):
            return _power(*args, guess=self._guess)
        remedy = _SUBSTITUTES.get(op, "use + - * / ^ and the functions " + ", ".join(FUNCTIONS))
        raise UnsupportedOperation(f"operation {op!r} is not part of the claim grammar", key="claim", remedy=remedy)


def _joined(first: _Value, second: _Value) -> Node | None:
    """Return the select that CasADi writes as the sum of two branches with opposite conditions; None otherwise."""
    if not (isinstance(first, _Branch) and isinstance(second, _Branch)):
        return None
    p, q = first.condition, second.condition
    if (p.op, p.a, p.b) != (q.op, q.a, q.b) or p.negated == q.negated:
        return None
    x, y = (second.value, first.value) if p.negated else (first.value, second.value)
    return Node("select", (p.a, p.b, x, y)) if p.op == "le" else Node("select", (p.b, p.a, y, x))


def _plain(value: _Value, op: str) -> Node:
    if isinstance(value, _Branch):  # CasADi leaves out a branch that is 0
        c = value.condition
        joined = _joined(value, _Branch(_Comparison(c.op, c.a, c.b, not c.negated), number(0)))
        assert joined is not None
        return joined
    if not isinstance(value, Node):
        raise UnsupportedOperation(
            f"a comparison as an operand of {op!r} is not part of the claim grammar", key="claim", remedy="use select"
        )
    return value


def _power(base: Node, exponent: Node, *, guess: bool) -> Node:
    if exponent.op != "num":
        return Node("exp", (exponent * Node("log", (base,)),))
    value = exponent.value
    near = value.limit_denominator(_LARGEST_SHARE)
    if guess and float(near) == float(value):
        value = near
    if abs(value) > _LARGEST_POWER:
        raise UnsupportedOperation(
            f"a power with the exponent {float(value):g} is not part of the claim grammar",
            key="claim",
            remedy=f"use an exponent of at most {_LARGEST_POWER}",
        )
    return power(base, value)


def _double(value: float) -> Node:
    if not math.isfinite(value):
        raise UnsupportedOperation(
            f"contains the constant {value}", key="claim", remedy="find the expression that is undefined"
        )
    return number(Fraction(value))


def _constant(value: float, others: Sequence[float]) -> Node:
    _double(value)
    share = _PI_PARTS.get(value)
    if share is not None:
        return PI if share == 1 else number(share) * PI
    exact = Fraction(repr(value))
    if sum(c.isdigit() for c in repr(value).split("e")[0].lstrip("-0.")) < _LONG:
        return number(exact)
    for b, c in combinations_with_replacement([x for x in others if x > 0 and x not in (1.0, abs(value))], 2):
        if b * c == abs(value):
            product = power(_constant(b, ()), 2) if b == c else _constant(b, ()) * _constant(c, ())
            return product if value > 0 else -product
    return number(exact)
