"""Claims as exact expressions, split into cases: in a case, every min, max, abs and select takes one branch."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction

from surctl.verification.claim import Claim
from surctl.verification.formula import Node, Statement, from_casadi, number, ordered, parse, rebuilt, text_of, variable
from surctl.verification.formula.node import BRANCHING

__all__ = ["Case", "Statement", "cases_of", "statement_of"]

MOST_BRANCHES = 5
"""The largest number of min, max, abs and select in a claim that is split into cases."""


@dataclass(frozen=True, eq=False)
class Case:
    """A case of a statement: every branching expression (min, max, abs, select) takes one of its branches.

    Attributes:
        choice: "0" or "1" for each branching expression, in the order in which the expressions occur in left, right and
            the constraints; empty if there is no branching expression.
        margin: left − right.
        constraints: the constraints of the statement, then one constraint for each chosen branch.
        touching: values of variables for which the margin is 0, if known.
    """

    choice: str
    margin: Node
    constraints: tuple[Node, ...]
    touching: Mapping[str, Fraction] = field(default_factory=dict)


def statement_of(claim: Claim) -> Statement:
    """Return the claim's expressions with exact numbers.

    Raises:
        UnsupportedOperation: the claim has an operation that the claim grammar lacks.
        InputError: an expression is too long to write out.
    """
    if claim.exact is not None:
        return claim.exact
    names = tuple(v.name for v in claim.variables)
    rows = [claim.constraints[k] for k in range(claim.constraints.numel())]
    nodes = from_casadi(claim.symbols, names, [claim.left, claim.right, *rows])
    # parse the written text, so that the expressions are those that a reader of the certificate obtains
    known = {name: variable(name) for name in names}
    nodes = [parse(text_of(node), known) for node in nodes]
    return Statement(names, claim.lower, claim.upper, nodes[0], nodes[1], tuple(nodes[2:]))


def substituted(statement: Statement) -> tuple[Node, ...]:
    """Return left, right and constraints; a variable with equal bounds is replaced by its decimal value."""
    ends = zip(statement.names, statement.lower, statement.upper, strict=True)
    fixed = {name: number(Fraction(repr(float(low)))) for name, low, high in ends if low == high}

    if not fixed:
        return statement.parts

    def change(node: Node, args: tuple[Node, ...]) -> Node:
        if node.op == "var":
            return fixed.get(node.name, node)
        unchanged = all(a is b for a, b in zip(args, node.args, strict=True))
        return node if unchanged else Node(node.op, args, node.value, node.name)

    return tuple(rebuilt(part, change) for part in statement.parts)


def cases_of(parts: Sequence[Node]) -> list[Case]:
    """Return one case for each choice of branches; if there are too many branches, a single case without choices."""
    branches = _branches(parts)
    left, right, *constraints = parts
    if len(branches) > MOST_BRANCHES:
        return [Case("", left - right, tuple(constraints))]
    if not branches:
        return [Case("", left - right, tuple(constraints))]
    cases = []
    for bits in range(2 ** len(branches)):
        choice = format(bits, f"0{len(branches)}b")
        chosen, conditions = _chosen(parts, dict(zip(branches, choice, strict=True)))
        cases.append(Case(choice, chosen[0] - chosen[1], (*chosen[2:], *conditions)))
    return cases


def _branches(parts: Iterable[Node]) -> list[Node]:
    met: dict[Node, None] = {}
    if not any(node.op in BRANCHING for node in ordered(*parts)):
        return []
    visited: set[Node] = set()
    stack = list(reversed(list(parts)))
    while stack:
        node = stack.pop()
        if node in visited:
            continue
        visited.add(node)
        if node.op in BRANCHING:
            met[node] = None
        stack.extend(reversed(node.args))
    return list(met)


def _chosen(parts: Sequence[Node], choice: dict[Node, str]) -> tuple[list[Node], list[Node]]:
    """Return the parts with the chosen branches, and the conditions (expressions ≤ 0) under which the choice holds."""
    conditions: dict[Node, Node] = {}

    def change(node: Node, args: tuple[Node, ...]) -> Node:
        if node not in choice:
            return node if not args else Node(node.op, args, node.value, node.name)
        second = choice[node] == "1"
        if node.op == "abs":
            conditions[node] = args[0] if second else -args[0]
            return -args[0] if second else args[0]
        if node.op == "select":
            conditions[node] = args[1] - args[0] if second else args[0] - args[1]
            return args[3] if second else args[2]
        smaller_first = node.op == "min"
        conditions[node] = args[0] - args[1] if second != smaller_first else args[1] - args[0]
        return args[1] if second else args[0]

    chosen = [rebuilt(part, change) for part in parts]
    return chosen, [conditions[node] for node in choice]
