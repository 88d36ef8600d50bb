"""Expression trees, made of exact numbers, names and the operations of the claim grammar."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import lru_cache

from surctl.errors import InputError

__all__ = ["ARITY", "BRANCHING", "DEEPEST", "PI", "Node", "number", "ordered", "power", "rebuilt", "variable"]

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
