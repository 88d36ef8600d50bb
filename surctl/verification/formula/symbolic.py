"""Convert expressions of the claim grammar to CasADi SX expressions; `formula.reader` does the opposite."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType

import casadi as ca

from surctl.verification.formula.node import Node, ordered

__all__ = ["to_casadi"]

_CASADI: Mapping[str, Callable[..., ca.SX]] = MappingProxyType(
    {"sqrt": ca.sqrt, "sin": ca.sin, "cos": ca.cos, "atan2": ca.atan2, "acos": ca.acos, "abs": ca.fabs,
     "min": ca.fmin, "max": ca.fmax, "asin": ca.asin, "tan": ca.tan, "exp": ca.exp, "log": ca.log, "sinh": ca.sinh,
     "cosh": ca.cosh, "tanh": ca.tanh}
)  # fmt: skip


def to_casadi(root: Node, symbols: Mapping[str, ca.SX]) -> ca.SX:
    """Convert an expression of the claim grammar to a CasADi SX expression; exact numbers become doubles."""
    converted: dict[Node, ca.SX] = {}
    for node in ordered(root):
        converted[node] = _symbolic(node, [converted[a] for a in node.args], symbols)
    return ca.SX(converted[root])


def _symbolic(node: Node, args: list[ca.SX], symbols: Mapping[str, ca.SX]) -> ca.SX:
    match node.op:
        case "num":
            return ca.SX(float(node.value))
        case "pi":
            return ca.SX(math.pi)
        case "var":
            return symbols[node.name]
        case "add":
            return args[0] + args[1]
        case "sub":
            return args[0] - args[1]
        case "mul":
            return args[0] * args[1]
        case "div":
            return args[0] / args[1]
        case "neg":
            return -args[0]
        case "pow":
            return _multiplied(args[0], node.value.numerator)
        case "powr":
            return ca.SX(ca.power(args[0], float(node.value)))
        case "atan":
            return ca.atan2(args[0], 1)  # the instruction set has no atan
        case "select":
            return ca.if_else(args[0] <= args[1], args[2], args[3])
        case _:
            return ca.SX(_CASADI[node.op](*args))


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
