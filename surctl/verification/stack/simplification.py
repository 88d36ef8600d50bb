"""Simplification of expressions on a box: a max becomes its larger operand if this operand is the same everywhere."""

from __future__ import annotations

import casadi as ca

from surctl.priority.diagnosis.findings import Region
from surctl.verification.formula import Node, from_casadi, rebuilt, to_casadi
from surctl.verification.proving.tape import build_tape

__all__ = ["simplified"]


def simplified(expression: ca.SX, region: Region, names: tuple[str, ...]) -> ca.SX:
    """Return a column that is equal to `expression` on the region, without branches that interval arithmetic decides.

    Branches are min, max, abs and select. Without them, derivatives of the column contain no comparisons.

    Raises:
        UnsupportedOperation: the expression has an operation that the claim grammar does not have.
    """
    box = region.lower[:, None], region.upper[:, None]

    def above(a: Node, b: Node) -> int:
        # 0 if neither inequality is certain on the whole box
        read = build_tape(names, [a - b]).run(box)
        low, high = (float(end[0]) for end in read.jets[0].value)
        if not read.defined[0][0]:
            return 0
        return 1 if low >= 0 else -1 if high <= 0 else 0

    def change(node: Node, args: tuple[Node, ...]) -> Node:
        same = Node(node.op, args, node.value, node.name)
        if node.op not in ("abs", "min", "max", "select"):
            return same
        first, second = (args[0], -args[0]) if node.op == "abs" else args[:2]
        sign = above(first, second)
        if not sign:
            return same
        if node.op == "select":  # for equal operands select takes the case a ≤ b
            return args[2] if sign < 0 else same
        wins = sign > 0 if node.op != "min" else sign < 0
        return first if wins else second

    nodes = from_casadi(region.symbols, names, [expression[k] for k in range(expression.numel())])
    symbols = {name: region.symbols[k] for k, name in enumerate(names)}
    return ca.vertcat(*[to_casadi(rebuilt(node, change), symbols) for node in nodes])
