"""Exact partial derivatives of expressions of the claim grammar, and substitution of expressions for variables."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from fractions import Fraction
from types import MappingProxyType

from surctl.errors import UnsupportedOperation
from surctl.verification.formula.node import Node, number, ordered, power, rebuilt

__all__ = ["derivative", "substitute"]

_ZERO, _ONE = number(0), number(1)

_CHAIN: Mapping[str, Callable[[Node, Node], Node]] = MappingProxyType(
    {
        "sin": lambda a, _: Node("cos", (a,)),
        "cos": lambda a, _: -Node("sin", (a,)),
        "sqrt": lambda _, whole: _ONE / (number(2) * whole),
        "atan": lambda a, _: _ONE / (_ONE + power(a, 2)),
        "acos": lambda a, _: -(_ONE / Node("sqrt", (_ONE - power(a, 2),))),
        "asin": lambda a, _: _ONE / Node("sqrt", (_ONE - power(a, 2),)),
        "tan": lambda _, whole: _ONE + power(whole, 2),
        "tanh": lambda _, whole: _ONE - power(whole, 2),
        "exp": lambda _, whole: whole,
        "log": lambda a, _: _ONE / a,
        "sinh": lambda a, _: Node("cosh", (a,)),
        "cosh": lambda a, _: Node("sinh", (a,)),
    }
)
"""Derivative of each function of one argument, from the argument and the whole expression."""


def derivative(root: Node, name: str) -> Node:
    """Return the exact partial derivative of an expression with respect to a variable.

    Raises:
        UnsupportedOperation: the expression contains abs, min, max or select, which have kinks or jumps.

    Example:
        >>> from surctl.verification.formula import derivative, parse, text_of, variable
        >>> text_of(derivative(parse("x^2*sin(y)", {"x": variable("x"), "y": variable("y")}), "x"))
        '2*x*sin(y)'
    """
    slopes: dict[Node, Node] = {}
    for node in ordered(root):
        slopes[node] = _slope(node, [slopes[a] for a in node.args], name)
    return slopes[root]


def substitute(root: Node, by: Mapping[str, Node]) -> Node:
    """Return the expression with an expression in the place of each variable that `by` names."""

    def change(node: Node, args: tuple[Node, ...]) -> Node:
        return by.get(node.name, node) if node.op == "var" else Node(node.op, args, node.value, node.name)

    return rebuilt(root, change)


def _slope(node: Node, slopes: list[Node], name: str) -> Node:
    op, args = node.op, node.args
    if op == "var":
        return _ONE if node.name == name else _ZERO
    if all(s == _ZERO for s in slopes):
        return _ZERO
    match op:
        case "add":
            return _sum(slopes[0], slopes[1])
        case "sub":
            return _sum(slopes[0], _minus(slopes[1]))
        case "neg":
            return _minus(slopes[0])
        case "mul":
            return _sum(_product(slopes[0], args[1]), _product(args[0], slopes[1]))
        case "div":
            over = _sum(_product(slopes[0], args[1]), _minus(_product(args[0], slopes[1])))
            return over / power(args[1], 2) if slopes[1] != _ZERO else slopes[0] / args[1]
        case "pow" | "powr":
            return _product(_product(number(node.value), _power(args[0], node.value - 1)), slopes[0])
        case "atan2":
            y, x = args
            over = _sum(_product(slopes[0], x), _minus(_product(y, slopes[1])))
            return over / (power(x, 2) + power(y, 2))
    if op not in _CHAIN:
        raise UnsupportedOperation(
            f"{op} has no derivative everywhere", key="expression", remedy="use a smooth expression"
        )
    return _product(_CHAIN[op](args[0], node), slopes[0])


def _sum(a: Node, b: Node) -> Node:
    if a == _ZERO:
        return b
    if b == _ZERO:
        return a
    return a - b.args[0] if b.op == "neg" else a + b


def _minus(a: Node) -> Node:
    if a.op == "num":
        return number(-a.value)
    return a.args[0] if a.op == "neg" else -a


def _product(a: Node, b: Node) -> Node:
    if _ZERO in (a, b):
        return _ZERO
    if a == _ONE:
        return b
    return a if b == _ONE else a * b


def _power(base: Node, exponent: Fraction) -> Node:
    return _ONE if exponent == 0 else power(base, exponent)
