"""Convert expressions of the claim grammar to CasADi SX expressions and back."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from itertools import combinations_with_replacement
from types import MappingProxyType

import casadi as ca

from surctl.errors import UnsupportedOperation
from surctl.ir.lowering import lower
from surctl.ir.program import Instruction
from surctl.verification.formula.node import PI, Node, number, ordered, power, variable

__all__ = ["from_casadi", "to_casadi"]

_SHARES = tuple(Fraction(p, q) for p in range(1, 5) for q in (1, 2, 3, 4, 6))
_PI_PARTS: Mapping[float, Fraction] = MappingProxyType(
    {sign * math.pi * p.numerator / p.denominator: sign * p for p in _SHARES for sign in (1, -1)}
)
_PLAIN = MappingProxyType(
    {"add": "add", "sub": "sub", "mul": "mul", "div": "div", "neg": "neg", "sqrt": "sqrt", "fabs": "abs",
     "fmin": "min", "fmax": "max", "sin": "sin", "cos": "cos", "atan2": "atan2", "acos": "acos"}
)  # fmt: skip
_CASADI: Mapping[str, Callable[..., ca.SX]] = MappingProxyType(
    {"sqrt": ca.sqrt, "sin": ca.sin, "cos": ca.cos, "atan2": ca.atan2, "acos": ca.acos, "abs": ca.fabs,
     "min": ca.fmin, "max": ca.fmax}
)  # fmt: skip
_LONG = 15  # a number with at least this many digits is assumed to result from rounding
_ORDERED = frozenset({"lt", "le"})


def from_casadi(symbols: ca.SX, names: Sequence[str], expressions: Sequence[ca.SX]) -> list[Node]:
    """Convert scalar SX expressions in the symbols to expressions of the grammar.

    A number becomes the shortest decimal number whose nearest double is the constant in the CasADi expression. CasADi
    evaluates constant subexpressions when they are created. Therefore a constant that equals a fraction of π in double
    precision is read as this fraction of π. A constant of 15 digits or more that equals the rounded product of two
    other constants is read as this product.

    Args:
        symbols: column of symbols (n, 1).
        names: names of the symbols, in order.
        expressions: scalar expressions, dense or structurally zero.

    Raises:
        UnsupportedOperation: an expression has an operation that the grammar lacks, such as floor or a logical
            operation other than a comparison.
    """
    function = ca.Function("claim", [symbols], [ca.densify(ca.vertcat(*expressions, 0))])
    program = lower(function)
    constants = [i.number for i in program.instructions if i.op == "const"]
    nodes: list[Node | None] = []
    for instruction in program.instructions:
        if instruction.op == "const":
            nodes.append(_constant(instruction.number, constants))
        elif instruction.op == "input":
            nodes.append(variable(names[instruction.args[1]]))
        elif instruction.op in _ORDERED:
            nodes.append(None)  # the select that uses the comparison reads it
        else:
            nodes.append(_operation(instruction, program.instructions, nodes))
    refs = program.output_refs[0][:-1]
    return [_operand(nodes, r, "comparison") for r in refs]


def _operation(instruction: Instruction, all_of_them: Sequence[Instruction], nodes: Sequence[Node | None]) -> Node:
    op = instruction.op
    if op == "select" and all_of_them[instruction.args[0]].op in _ORDERED:
        condition = all_of_them[instruction.args[0]]
        a, b = (_operand(nodes, at, condition.op) for at in condition.args)
        x, y = (_operand(nodes, at, op) for at in instruction.args[1:])
        return Node("select", (a, b, x, y)) if condition.op == "le" else Node("select", (b, a, y, x))
    args = tuple(_operand(nodes, at, op) for at in instruction.args)
    if op in _PLAIN:
        return Node(_PLAIN[op], args)
    if op == "sq":
        return power(args[0], 2)
    if op == "twice":
        return number(2) * args[0]
    if op == "inv":
        return number(1) / args[0]
    if op == "fma":
        return args[0] * args[1] + args[2]
    raise UnsupportedOperation(
        f"operation {op!r} is not part of the claim grammar", key="claim", remedy="use min, max, abs or select"
    )


def _operand(nodes: Sequence[Node | None], at: int, op: str) -> Node:
    node = nodes[at]
    if node is None:
        raise UnsupportedOperation(
            f"a comparison as an operand of {op!r} is not part of the claim grammar", key="claim", remedy="use select"
        )
    return node


def _constant(value: float, others: Sequence[float]) -> Node:
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
