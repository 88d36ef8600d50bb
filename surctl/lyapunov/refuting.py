"""Counterexamples to strict inequalities: points of the open region where left < right fails, also with equality.

A proof states a bound, such as V' ≤ −factor · (r²)^power. A point where the bound fails refutes the claim V' < 0 only
if V' ≥ 0 there. Equality is common, as V' = 0 at velocity 0, so points are also evaluated in rational numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from surctl.verification import Claim
from surctl.verification.formula import Node, ordered
from surctl.verification.proving import certain_excess

__all__ = ["strict_counterexample"]

Array = NDArray[np.float64]

_TOWARDS = (0.0, 1e-8, 1e-6, 1e-4, 1e-2)  # relative steps towards the equilibrium
_AT_ZERO = {"sin": 0, "cos": 1, "tan": 0, "exp": 1, "atan": 0, "asin": 0, "sinh": 0, "cosh": 1, "tanh": 0}
_EVERYWHERE = {"add", "sub", "neg", "mul", "abs", "max", "min", "sin", "cos", "exp", "atan", "sinh", "cosh", "tanh"}
_SMALL = 1e-3  # deviations below this share of the range may be 0


def strict_counterexample(
    claim: Claim, near: Mapping[str, float], equilibrium: Mapping[str, float], *,
    search: Callable[[Claim], Mapping[str, float] | None],
) -> Mapping[str, float] | None:  # fmt: skip
    """Return a point that is not the equilibrium and where left ≥ right for certain, or None if none is found.

    Args:
        claim: the claim that left < right where no constraint is positive, except at the equilibrium.
        near: a point close to which counterexamples are sought first.
        equilibrium: values of the states at the equilibrium, by name.
        search: returns a point where left > right, or None.
    """
    points = _points(claim, near, equilibrium)
    excess = certain_excess(claim, points)
    names = list(claim.exact.names) if claim.exact else []
    rest = np.array([equilibrium.get(name, np.nan) for name in names])
    for k, point in enumerate(points.T):
        away = not equilibrium or bool(np.any((point != rest) & np.isfinite(rest)))
        at = dict(zip(names, point.tolist(), strict=True))
        if away and (excess[k] >= 0 or _fails(claim, at, inside=bool(np.isfinite(excess[k])))):
            return claim.values(point)
    return search(claim)


def _points(claim: Claim, near: Mapping[str, float], equilibrium: Mapping[str, float]) -> Array:
    """Return the point and points (n, k) close to it, with states or small deviations set to the equilibrium."""
    point = claim.point(near)
    assert claim.exact is not None
    rest = np.array([equilibrium.get(name, value) for name, value in zip(claim.exact.names, point, strict=True)])
    small = np.abs(point - rest) < _SMALL * (claim.upper - claim.lower)
    chosen = [np.zeros(len(point), dtype=bool), small, *np.eye(len(point), dtype=bool)]
    columns = [np.where(mask, rest, rest + (point - rest) * (1 - step)) for step in _TOWARDS for mask in chosen]
    return np.asarray(np.clip(np.column_stack(columns), claim.lower[:, None], claim.upper[:, None]))


def _fails(claim: Claim, at: Mapping[str, float], *, inside: bool) -> bool:
    """Return whether left ≥ right in the domain, in rational arithmetic; `inside` if the point is in the domain."""
    statement = claim.exact
    assert statement is not None
    excess, *constraints = _rational([statement.left - statement.right, *statement.constraints], at)
    return excess is not None and excess >= 0 and (inside or all(v is not None and v <= 0 for v in constraints))


def _rational(roots: list[Node], at: Mapping[str, float]) -> list[Fraction | None]:
    """Return the values of expressions; None for a number that is not rational, or not known to exist."""
    known: dict[Node, Fraction | None] = {}
    real: set[Node] = set()  # expressions that have a value, rational or not
    for node in ordered(*roots):
        args = [known[a] for a in node.args]
        value = _value(node, args, at)
        exists = all(a in real for a in node.args) and (value is not None or node.op in _EVERYWHERE)
        if node.op == "mul" and exists and 0 in args:
            value = Fraction(0)
        known[node] = value if exists else None
        if exists:
            real.add(node)
    return [known[root] for root in roots]


def _value(node: Node, args: list[Fraction | None], at: Mapping[str, float]) -> Fraction | None:
    """Return the value of an operation, or None if it is not rational; the operands are rational or None."""
    if node.op == "num":
        return node.value
    if node.op == "var":
        return Fraction(at[node.name])
    numbers = [a for a in args if a is not None]
    if len(numbers) < len(args):
        return None
    match node.op, numbers:
        case "add", [a, b]:
            return a + b
        case "sub", [a, b]:
            return a - b
        case "neg", [a]:
            return -a
        case "mul", [a, b]:
            return a * b
        case "div", [a, b] if b:
            return a / b
        case "pow", [a] if a or node.value > 0:
            return Fraction(a ** int(node.value))
        case "abs", [a]:
            return abs(a)
        case "max", [a, b]:
            return max(a, b)
        case "min", [a, b]:
            return min(a, b)
    return Fraction(_AT_ZERO[node.op]) if numbers == [0] and node.op in _AT_ZERO else None
