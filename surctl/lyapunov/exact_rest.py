"""Exact values of expressions, and exact equilibria of dynamics that are rational functions close to them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction

from surctl.verification.formula import Node, ordered

_LONGEST = 400  # digits of a coordinate that a certificate may state

Row = tuple[Fraction, ...]


def exact_values(
    roots: Sequence[Node], at: Mapping[str, Fraction], along: Sequence[str] = ()
) -> list[tuple[Fraction, Row]] | None:
    """Return the value of each expression at a point, and its derivatives by the names `along`.

    Returns:
        None if a value is not rational, as that of most sines and roots, or not defined.

    Example:
        >>> from fractions import Fraction
        >>> from surctl.lyapunov.exact_rest import exact_values
        >>> from surctl.verification.formula import parse, variable
        >>> root = parse("max(0, 3*x - 1)", {"x": variable("x")})
        >>> exact_values([root], {"x": Fraction(1, 2)}, ["x"])
        [(Fraction(1, 2), (Fraction(3, 1),))]
    """
    zero = (Fraction(0),) * len(along)
    known: dict[Node, tuple[Fraction, Row]] = {}
    for node in ordered(*roots):
        args = [known[a] for a in node.args]
        match node.op, args:
            case "num", []:
                result = node.value, zero
            case "var", []:
                result = at[node.name], tuple(Fraction(name == node.name) for name in along)
            case "neg", [(x, dx)]:
                result = -x, _scaled(Fraction(-1), dx)
            case "add", [(x, dx), (y, dy)]:
                result = x + y, _sum(dx, dy)
            case "sub", [(x, dx), (y, dy)]:
                result = x - y, _sum(dx, _scaled(Fraction(-1), dy))
            case "mul", [(x, dx), (y, dy)]:
                result = x * y, _sum(_scaled(y, dx), _scaled(x, dy))
            case "div", [(x, dx), (y, dy)] if y:
                result = x / y, _scaled(1 / y, _sum(dx, _scaled(-x / y, dy)))
            case "min" | "max", [one, other]:
                result = (min if node.op == "min" else max)(one, other, key=lambda part: part[0])
            case "sin", [(x, dx)] if not x:
                result = Fraction(0), dx
            case "cos", [(x, _)] if not x:
                result = Fraction(1), zero
            case _:
                return None
        known[node] = result
    return [known[root] for root in roots]


def exact_root(rates: Sequence[Node], near: Mapping[str, Fraction], moving: Sequence[str]) -> list[Fraction] | None:
    """Return values of the names `moving` at which all rates are exactly 0, by one exact step of Newton's method.

    The step is exact for rates that are affine between the point and the root, as with a linear law within its limits.

    Returns:
        None if the step does not end at a root, or needs too many digits.

    Example:
        >>> from fractions import Fraction
        >>> from surctl.lyapunov.exact_rest import exact_root
        >>> from surctl.verification.formula import parse, variable
        >>> exact_root([parse("min(2, 1 - 3*x)", {"x": variable("x")})], {"x": Fraction(0.33)}, ["x"])
        [Fraction(1, 3)]
    """
    start = exact_values(rates, near, moving)
    step = None if start is None else _solved([[*slope, -value] for value, slope in start])
    if step is None:
        return None
    root = [near[name] + change for name, change in zip(moving, step, strict=True)]
    if max(len(str(part)) for one in root for part in one.as_integer_ratio()) > _LONGEST // 2 - 2:
        return None
    end = exact_values(rates, {**near, **dict(zip(moving, root, strict=True))})
    return root if end is not None and not any(value for value, _ in end) else None


def _solved(rows: list[list[Fraction]]) -> list[Fraction] | None:
    # Gauss and Jordan; each row ends with the right-hand side
    for k in range(len(rows)):
        pivot = max(range(k, len(rows)), key=lambda i: abs(rows[i][k]))
        if not rows[pivot][k]:
            return None
        rows[k], rows[pivot] = rows[pivot], rows[k]
        rows[k] = [x / rows[k][k] for x in rows[k]]
        for i in range(len(rows)):
            if i != k and (factor := rows[i][k]):
                rows[i] = [x - factor * y for x, y in zip(rows[i], rows[k], strict=True)]
    return [row[-1] for row in rows]


def _scaled(factor: Fraction, row: Row) -> Row:
    return tuple(factor * x for x in row)


def _sum(a: Row, b: Row) -> Row:
    return tuple(x + y for x, y in zip(a, b, strict=True))
