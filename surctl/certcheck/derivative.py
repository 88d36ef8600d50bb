"""Derivatives, substitution and branches of expressions in the checker's table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from surctl.certcheck.document import Rejected
from surctl.certcheck.expressions import BRANCHES, ExpressionTable
from surctl.certcheck.patience import go_on

__all__ = ["along", "branched", "branches_of", "composed"]


def along(table: ExpressionTable, root: int, rates: Sequence[int]) -> int:
    """Return Σ ∂root/∂x_k · rates[k] over the first variables of the table; raise Rejected if root is not smooth.

    Factors 1 and terms 0 are left out, so that the derivative with respect to one variable is short too.
    """
    put, zero, one, slope = table.put, table.put("num"), table.put("num", value=1), dict[int, int]()

    def negative(a: int) -> int:
        entry = table.entries[a]
        if entry.op == "num":
            return put("num", value=-entry.value)
        return entry.args[0] if entry.op == "neg" else put("neg", a)

    def plus(a: int, b: int) -> int:
        if zero in (a, b):
            return b if a == zero else a
        entry = table.entries[b]
        return put("sub", a, entry.args[0]) if entry.op == "neg" else put("add", a, b)

    def times(a: int, b: int) -> int:
        return zero if zero in (a, b) else b if a == one else a if b == one else put("mul", a, b)

    # forward differentiation: the derivative of every operation along the vector field
    for at in table.needed([root]):
        go_on()
        op, args, value = table.entries[at]
        moves = [slope[a] for a in args]
        if op == "var":
            slope[at] = rates[value.numerator] if value.numerator < len(rates) else zero
        elif op in BRANCHES or op == "atan2":
            raise Rejected(f"the function contains {op}, which has kinks or jumps")
        elif all(m == zero for m in moves):
            slope[at] = zero
        elif op in ("add", "sub"):
            slope[at] = plus(moves[0], moves[1] if op == "add" else negative(moves[1]))
        elif op == "neg":
            slope[at] = negative(moves[0])
        elif op == "mul":
            slope[at] = plus(times(moves[0], args[1]), times(args[0], moves[1]))
        elif op == "div" and moves[1] == zero:
            slope[at] = put("div", moves[0], args[1])
        elif op == "div":
            over = plus(times(moves[0], args[1]), negative(times(args[0], moves[1])))
            slope[at] = put("div", over, put("pow", args[1], value=2))
        elif op in ("pow", "powr"):
            left = one if value == 1 else args[0] if value == 2 else put(op, args[0], value=value - 1)
            slope[at] = times(times(put("num", value=value), left), moves[0])
        else:
            slope[at] = times(_outer(table, op, args[0], at), moves[0])
    return slope[root]


def _outer(table: ExpressionTable, op: str, inside: int, whole: int) -> int:
    """Return the derivative of a function of one argument, from the positions of argument and value."""
    put, one, two = table.put, table.put("num", value=1), table.put("num", value=2)
    match op:
        case "exp":
            return whole
        case "log":
            return put("div", one, inside)
        case "sinh" | "cosh":
            return put("cosh" if op == "sinh" else "sinh", inside)
        case "tan" | "tanh":
            return put("add" if op == "tan" else "sub", one, put("pow", whole, value=2))
        case "sqrt":
            return put("div", one, put("mul", two, whole))
        case "sin":
            return put("cos", inside)
        case "cos":
            return put("neg", put("sin", inside))
        case "atan":
            return put("div", one, put("add", one, put("pow", inside, value=2)))
        case "acos" | "asin":
            rest = put("div", one, put("sqrt", put("sub", one, put("pow", inside, value=2))))
            return put("neg", rest) if op == "acos" else rest
    raise Rejected(f"the checker has no derivative of {op}")


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
