"""Expression trees of exact numbers, names and operations; their derivatives and values; statements on a box."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import lru_cache
from types import MappingProxyType
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.derivative import along
from surctl.certcheck.expressions import ExpressionTable
from surctl.errors import InputError, UnsupportedOperation

ARITY: Mapping[str, int] = {
    "add": 2, "sub": 2, "mul": 2, "div": 2, "neg": 1, "pow": 1, "sqrt": 1, "sin": 1, "cos": 1, "atan": 1,
    "atan2": 2, "acos": 1, "asin": 1, "tan": 1, "exp": 1, "log": 1, "sinh": 1, "cosh": 1, "tanh": 1, "powr": 1,
    "abs": 1, "min": 2, "max": 2, "select": 4,
}  # fmt: skip
"""The number of operands of each operation; `select(a, b, x, y)` is x if a ≤ b, and y otherwise.

`pow` is a power with an integer exponent. `powr` is a power with any other exponent; it is defined for positive bases,
and for 0 if the exponent is positive.
"""

BRANCHING = frozenset({"abs", "min", "max", "select"})
"""The operations whose value is that of one of two expressions; a comparison of the operands selects the expression."""

DEEPEST = 300
"""The largest depth to which operations may be nested."""


_NONE = Fraction(0)  # the value of a node that has none


@dataclass(frozen=True, eq=False, init=False)
class Node:
    """A node of an expression tree: an operation, a number or a name; nodes with equal content are equal.

    Attributes:
        op: kind of the node: `num`, `pi`, `var`, or an operation, which is a key of `ARITY`.
        args: the operands.
        value: the exact number of a `num` node, or the exponent of a `pow` or `powr` node.
        name: the name of the variable of a `var` node.
        depth: depth of the tree below and including this node.
    """

    op: str
    args: tuple[Node, ...]
    value: Fraction
    name: str
    depth: int = field(init=False)
    _hash: int = field(init=False, repr=False)

    def __init__(self, op: str, args: tuple[Node, ...] = (), value: Fraction = _NONE, name: str = "") -> None:
        # a proof makes hundreds of nodes: one loop, and no slow hash of a fraction
        depth = 0
        key: list[str | int] = [op, name]
        for a in args:
            key.append(a._hash)
            if a.depth > depth:
                depth = a.depth
        if depth >= DEEPEST:  # recursive functions process the expression
            raise InputError(
                f"is nested more than {DEEPEST} levels deep", key="expression", remedy="write it with less nesting"
            )
        key += (0, 1) if value is _NONE else value.as_integer_ratio()
        own = self.__dict__  # the class is frozen
        own["op"], own["args"], own["value"], own["name"] = op, args, value, name
        own["depth"], own["_hash"] = depth + 1, hash(tuple(key))

    def __hash__(self) -> int:
        return self._hash

    def __eq__(self, other: object) -> bool:
        if self is other:
            return True
        if not isinstance(other, Node) or self._hash != other._hash:
            return False
        same = self.op == other.op and self.name == other.name and self.args == other.args
        return same and (self.value is other.value or self.value == other.value)

    def __add__(self, other: Node) -> Node:
        return Node("add", (self, other))

    def __sub__(self, other: Node) -> Node:
        return Node("sub", (self, other))

    def __mul__(self, other: Node) -> Node:
        return Node("mul", (self, other))

    def __truediv__(self, other: Node) -> Node:
        return Node("div", (self, other))

    def __neg__(self) -> Node:
        return Node("neg", (self,))


PI = Node("pi")


def number(value: int | Fraction) -> Node:
    """Return the node of an exact number."""
    return Node("num", value=value if type(value) is Fraction else Fraction(value))


def variable(name: str) -> Node:
    """Return the node of a variable."""
    return Node("var", name=name)


def power(base: Node, exponent: int | Fraction) -> Node:
    """Return the node of a power with a constant exponent."""
    value = Fraction(exponent)
    return base if value == 1 else Node("pow" if value.denominator == 1 else "powr", (base,), value)


@lru_cache(128)
def ordered(*roots: Node) -> Sequence[Node]:
    """Return every distinct node of the expressions once; the operands of a node come before the node."""
    order: list[Node] = []
    visited: set[Node] = set()
    stack = [(root, False) for root in reversed(roots)]
    while stack:
        node, expanded = stack.pop()
        if expanded:
            order.append(node)
        elif node not in visited:
            visited.add(node)
            stack.append((node, True))
            stack += [(a, False) for a in reversed(node.args)]
    return tuple(order)


def rebuilt(root: Node, change: Callable[[Node, tuple[Node, ...]], Node]) -> Node:
    """Rebuild an expression from its leaves upwards: change(node, rebuilt operands) replaces every node."""
    replaced: dict[Node, Node] = {}
    for node in ordered(root):
        replaced[node] = change(node, tuple(replaced[a] for a in node.args))
    return replaced[root]


# Expressions as entries of the checker's table, and the checker's rules for derivatives


def table_of(names: Sequence[str], roots: Sequence[Node]) -> tuple[ExpressionTable, list[int]]:
    """Return a table of the operations of several expressions, and the positions of the expressions."""
    table, at, place = ExpressionTable(names), dict[Node, int](), {name: k for k, name in enumerate(names)}
    for node in ordered(*roots):
        value = place[node.name] if node.op == "var" else node.value
        at[node] = table.put(node.op, *(at[a] for a in node.args), value=value)
    return table, [at[root] for root in roots]


def nodes_of(table: ExpressionTable) -> list[Node]:
    """Return the expression at each position of a table."""
    nodes: list[Node] = []
    for op, args, value in table.entries:
        own = variable(table.names[value.numerator]) if op == "var" else Node(op, tuple(nodes[a] for a in args), value)
        nodes.append(own)
    return nodes


def derivative(root: Node, name: str) -> Node:
    """Return the exact partial derivative of an expression with respect to a variable, as the checker computes it.

    Raises:
        UnsupportedOperation: the expression contains abs, atan2, min, max or select, which have kinks or jumps.

    Example:
        >>> from surctl.verification.formula import derivative, parse, text_of, variable
        >>> text_of(derivative(parse("x^2*sin(y)", {"x": variable("x"), "y": variable("y")}), "x"))
        '2*x*sin(y)'
    """
    kinked = next((node.op for node in ordered(root) if node.op in BRANCHING or node.op == "atan2"), None)
    if kinked is not None:
        raise UnsupportedOperation(
            f"{kinked} has no derivative everywhere", key="expression", remedy="use a smooth expression"
        )
    names = dict.fromkeys(node.name for node in ordered(root) if node.op == "var")
    table, (at,) = table_of([*names], [root])
    slope = along(table, at, [table.put("num", value=int(own == name)) for own in names])
    return nodes_of(table)[slope]


def substitute(root: Node, by: Mapping[str, Node]) -> Node:
    """Return the expression with an expression in the place of each variable that `by` names."""

    def change(node: Node, args: tuple[Node, ...]) -> Node:
        return by.get(node.name, node) if node.op == "var" else Node(node.op, args, node.value, node.name)

    return rebuilt(root, change)


# Values of expressions of the claim grammar at many points, in doubles


Array = NDArray[np.float64]

_NUMPY: Mapping[str, Callable[..., Any]] = MappingProxyType(
    {"add": np.add, "sub": np.subtract, "mul": np.multiply, "div": np.divide, "neg": np.negative, "sqrt": np.sqrt,
     "sin": np.sin, "cos": np.cos, "tan": np.tan, "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan,
     "atan2": np.arctan2, "sinh": np.sinh, "cosh": np.cosh, "tanh": np.tanh, "exp": np.exp, "log": np.log,
     "abs": np.abs, "min": np.minimum, "max": np.maximum,
     "select": lambda a, b, x, y: np.where(np.isnan(a) | np.isnan(b), np.nan, np.where(a <= b, x, y))}
)  # fmt: skip

_POLES = frozenset({"div", "log", "pow", "powr"})


def values_of(roots: Sequence[Node], at: Mapping[str, Array]) -> Array:
    """Return the values (k, N) of expressions at points; an expression that has no value at a point is NaN there.

    A value too large for a double is infinite.

    Args:
        roots: the expressions (k).
        at: values (N,) of each variable, by name.

    Example:
        >>> import numpy as np
        >>> from surctl.verification.formula import parse, values_of, variable
        >>> values_of([parse("x^2 + 1", {"x": variable("x")})], {"x": np.array([1.0, 2.0])})
        array([[2., 5.]])
    """
    known: dict[Node, Any] = {}
    with np.errstate(all="ignore"):
        for node in ordered(*roots):
            args = [known[a] for a in node.args]
            match node.op:
                case "num":
                    known[node] = float(node.value)
                case "pi":
                    known[node] = np.pi
                case "var":
                    known[node] = at[node.name]
                case "pow" if node.value == 2:
                    known[node] = args[0] * args[0]
                case "pow" | "powr":
                    known[node] = np.where(np.isnan(args[0]), np.nan, np.power(args[0], float(node.value)))
                case _:
                    known[node] = _NUMPY[node.op](*args)
            if node.op in _POLES:  # a later division must not turn 1/0 into 0
                known[node] = np.where(np.isinf(known[node]), np.nan, known[node])
    count = len(next(iter(at.values())))
    return np.array([np.broadcast_to(known[root], (count,)) for root in roots])


def exact_values(roots: Sequence[Node], at: Mapping[str, Any]) -> list[Any] | None:
    """Return the values of expressions at a point; None if one is not rational, as most sines, or is not defined.

    The point has fractions, or polynomials with rational coefficients.

    Example:
        >>> from fractions import Fraction
        >>> from surctl.verification.formula import exact_values, parse, variable
        >>> exact_values([parse("max(0, 3*x - 1)", {"x": variable("x")})], {"x": Fraction(1, 2)})
        [Fraction(1, 2)]
    """
    known: dict[Node, Any] = {}
    for node in ordered(*roots):
        args = [known[a] for a in node.args]
        match node.op:
            case "num":
                known[node] = node.value
            case "var" if node.name in at:
                known[node] = at[node.name]
            case "div" if args[1]:
                known[node] = args[0] / args[1]
            case "pow" if args[0] or node.value > 0:
                known[node] = args[0] ** node.value.numerator
            case op if op in _AT_ZERO and not args[0]:
                known[node] = _AT_ZERO[op]
            case "atan2" if not args[0] and args[1] > 0:
                known[node] = Fraction(0)
            case "sqrt" if args[0] >= 0:
                known[node] = Fraction(*map(math.isqrt, args[0].as_integer_ratio()))
                if known[node] ** 2 != args[0]:
                    return None
            case op if op in _EXACT:
                known[node] = _EXACT[op](*args)
            case _:
                return None
    return [known[root] for root in roots]


_AT_ZERO: Mapping[str, Fraction] = MappingProxyType(
    dict.fromkeys(("sin", "tan", "tanh", "atan", "asin", "sinh"), Fraction(0))
    | dict.fromkeys(("cos", "exp", "cosh"), Fraction(1))
)
_EXACT: Mapping[str, Callable[..., Any]] = MappingProxyType(
    {"add": operator.add, "sub": operator.sub, "mul": operator.mul, "neg": operator.neg, "abs": abs, "min": min,
     "max": max}
)  # fmt: skip


# Convert expressions of the claim grammar to CasADi SX expressions; `formula.reader` does the opposite


_CASADI: Mapping[str, Callable[..., Any]] = MappingProxyType(
    {"add": operator.add, "sub": operator.sub, "mul": operator.mul, "div": operator.truediv, "neg": operator.neg,
     "sqrt": ca.sqrt, "sin": ca.sin, "cos": ca.cos, "atan2": ca.atan2, "acos": ca.acos, "abs": ca.fabs, "min": ca.fmin,
     "max": ca.fmax, "asin": ca.asin, "tan": ca.tan, "exp": ca.exp, "log": ca.log, "sinh": ca.sinh, "cosh": ca.cosh,
     "tanh": ca.tanh, "atan": lambda a: ca.atan2(a, 1),  # the instruction set has no atan
     "select": lambda a, b, x, y: ca.if_else(a <= b, x, y)}
)  # fmt: skip


def to_casadi(root: Node, symbols: Mapping[str, ca.SX]) -> ca.SX:
    """Convert an expression of the claim grammar to a CasADi SX expression; exact numbers become doubles."""
    converted: dict[Node, ca.SX] = {}
    for node in ordered(root):
        args = [converted[a] for a in node.args]
        match node.op:
            case "num" | "pi":
                converted[node] = ca.SX(float(node.value) if node.op == "num" else math.pi)
            case "var":
                converted[node] = symbols[node.name]
            case "pow":
                converted[node] = _multiplied(args[0], node.value.numerator)
            case "powr":
                converted[node] = ca.power(args[0], float(node.value))
            case _:
                converted[node] = _CASADI[node.op](*args)
    return ca.SX(converted[root])


def _multiplied(base: ca.SX, exponent: int) -> ca.SX:
    # repeated squaring, because the instruction set has no power operation
    if exponent < 0:
        return 1 / _multiplied(base, -exponent)
    result, square = ca.SX(1), base
    while exponent:
        if exponent & 1:
            result = result * square
        square, exponent = square * square, exponent >> 1
    return result


# The statement of an inequality with exact numbers


@dataclass(frozen=True, eq=False)
class Statement:
    """The statement left ≤ right on the part of a box where no constraint is positive.

    Attributes:
        names: names of the n variables.
        lower: lower bounds (n,).
        upper: upper bounds (n,).
        left: expression of the left side.
        right: expression of the right side.
        constraints: expressions of the constraints.
        touching: values of variables for which left = right, if known; a proof needs them.
    """

    names: tuple[str, ...]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    left: Node
    right: Node
    constraints: tuple[Node, ...]
    touching: Mapping[str, Fraction] = field(default_factory=dict)

    @property
    def parts(self) -> tuple[Node, ...]:
        """All expressions of the statement: left, right and the constraints."""
        return (self.left, self.right, *self.constraints)
