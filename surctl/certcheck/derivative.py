"""Derivatives, substitution and branches of expressions in the checker's table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from surctl.certcheck.document import Rejected
from surctl.certcheck.expressions import BRANCHES, ExpressionTable
from surctl.certcheck.patience import go_on

__all__ = ["along", "branched", "branches_of", "composed"]


def along(table: ExpressionTable, root: int, rates: Sequence[int]) -> int:
    """Return Σ ∂root/∂x_k · rates[k] over the first variables of the table; raise Rejected if root is not smooth."""
    # forward differentiation: the derivative of every operation along the vector field
    put = table.put
    zero, one, two = put("num"), put("num", value=1), put("num", value=2)
    slope: dict[int, int] = {}

    def times(a: int, b: int) -> int:
        return zero if zero in (a, b) else b if a == one else a if b == one else put("mul", a, b)

    for at in table.needed([root]):
        go_on()
        entry, args = table.entries[at], table.entries[at].args
        op, moves = entry.op, [slope[a] for a in args]
        if op == "var":
            index = entry.value.numerator
            slope[at] = rates[index] if index < len(rates) else zero
        elif op in BRANCHES or op == "atan2":
            raise Rejected(f"the function contains {op}, which has kinks or jumps")
        elif all(m == zero for m in moves):
            slope[at] = zero
        elif op in ("add", "sub"):
            slope[at] = put(op, *moves)
        elif op == "neg":
            slope[at] = put("neg", moves[0])
        elif op == "mul":
            slope[at] = put("add", times(moves[0], args[1]), times(args[0], moves[1]))
        elif op == "div":
            over = put("sub", times(moves[0], args[1]), times(args[0], moves[1]))
            slope[at] = put("div", over, put("pow", args[1], value=2))
        elif op == "pow":
            base = put("pow", args[0], value=entry.value - 1) if entry.value != 1 else one
            slope[at] = times(times(put("num", value=entry.value), base), moves[0])
        elif op == "powr":
            base = put("powr", args[0], value=entry.value - 1)
            slope[at] = times(times(put("num", value=entry.value), base), moves[0])
        elif op == "exp":
            slope[at] = times(at, moves[0])
        elif op == "log":
            slope[at] = put("div", moves[0], args[0])
        elif op in ("sinh", "cosh"):
            slope[at] = times(put("cosh" if op == "sinh" else "sinh", args[0]), moves[0])
        elif op in ("tan", "tanh"):
            inner = put("add" if op == "tan" else "sub", one, put("pow", at, value=2))
            slope[at] = times(inner, moves[0])
        elif op == "sqrt":
            slope[at] = put("div", moves[0], put("mul", two, at))
        elif op == "sin":
            slope[at] = times(put("cos", args[0]), moves[0])
        elif op == "cos":
            slope[at] = put("neg", times(put("sin", args[0]), moves[0]))
        elif op == "atan":
            slope[at] = put("div", moves[0], put("add", one, put("pow", args[0], value=2)))
        elif op in ("acos", "asin"):
            rest = put("sub", one, put("pow", args[0], value=2))
            slope[at] = put("div", moves[0], put("sqrt", rest))
            if op == "acos":
                slope[at] = put("neg", slope[at])
        else:
            raise Rejected(f"the checker has no derivative of {op}")
    return slope[root]


def composed(table: ExpressionTable, root: int, successors: Mapping[int, int]) -> int:
    """Return the expression with the entries `successors[k]` in the place of the variables k."""

    def change(at: int, _: tuple[int, ...]) -> int | None:
        entry = table.entries[at]
        return successors.get(entry.value.numerator) if entry.op == "var" else None

    return table.rewritten([root], change)[0]


def branches_of(table: ExpressionTable, roots: Sequence[int]) -> list[int]:
    """Return the distinct abs, max, min and select entries of expressions, in the order in which they occur."""
    met, visited, waiting = list[int](), set[int](), list(reversed(roots))
    while waiting:
        at = waiting.pop()
        if at not in visited:
            visited.add(at)
            entry = table.entries[at]
            if entry.op in BRANCHES:
                met.append(at)
            waiting += reversed(entry.args)
    return met


def branched(table: ExpressionTable, roots: Sequence[int], picked: Mapping[int, str]) -> tuple[list[int], list[int]]:
    """Return expressions after a choice for branches, and expressions that are ≤ 0 where the choice holds.

    Args:
        table: the table.
        roots: the expressions.
        picked: "0" or "1", the first or the second operand, for some of the entries of `branches_of`.
    """
    if not picked:
        return list(roots), []
    put, conditions = table.put, dict[int, int]()

    def change(at: int, args: tuple[int, ...]) -> int | None:
        if at not in picked:
            return None
        entry, second = table.entries[at], picked[at] == "1"
        if entry.op == "abs":
            conditions[at] = args[0] if second else put("neg", args[0])
            return put("neg", args[0]) if second else args[0]
        a, b = args[:2]
        first_is_less = entry.op != "max"
        conditions[at] = put("sub", b, a) if second == first_is_less else put("sub", a, b)
        return args[len(args) // 2 + second] if entry.op == "select" else args[int(second)]

    chosen = table.rewritten(roots, change)
    return chosen, [conditions[at] for at in picked]
