"""Exact solution of sparse linear equations by a change of few unknowns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

from surctl.sos.polynomial import Monomial

__all__ = ["Column", "corrected"]

Name = tuple[int, int | Monomial]
_MOST = 4000  # most equations with more than one unknown


@dataclass(frozen=True)
class Column:
    """An unknown of linear equations.

    Attributes:
        name: index of the block and place of the entry, or index of the relation and monomial of its multiplier.
        row: its coefficient in each equation.
        rank: unknowns of a low rank are changed first.
    """

    name: Name
    row: Mapping[Monomial, Fraction]
    rank: int


def corrected(rest: Mapping[Monomial, Fraction], columns: Sequence[Column]) -> dict[Name, Fraction] | None:
    """Return changes of unknowns such that Σ change · row = rest; None if there are none.

    Args:
        rest: right side of the equations; 0 where a monomial is missing.
        columns: the unknowns.
    """
    order = sorted(range(len(columns)), key=lambda k: (len(columns[k].row), columns[k].rank))
    place = {k: p for p, k in enumerate(order)}
    equations: dict[Monomial, dict[int, Fraction]] = {}
    for k, column in enumerate(columns):
        for m, c in column.row.items():
            equations.setdefault(m, {})[place[k]] = c
    sides = {m: Fraction(rest.get(m, 0)) for m in equations}
    if any(c and m not in equations for m, c in rest.items()):
        return None
    # an unknown that occurs in one equation alone solves it without an influence on the others
    changes: dict[Name, Fraction] = {}
    later: dict[Monomial, int] = {}
    for m, equation in equations.items():
        own = next((p for p in sorted(equation) if len(columns[order[p]].row) == 1), None)
        if own is not None:
            later[m] = own
    solved = _eliminated(
        {m: dict(e) for m, e in equations.items() if m not in later},
        {m: s for m, s in sides.items() if m not in later},
    )
    if solved is None:
        return None
    for p, value in solved.items():
        changes[columns[order[p]].name] = value
        for m, c in columns[order[p]].row.items():
            sides[m] -= c * value
    for m, p in later.items():
        changes[columns[order[p]].name] = sides[m] / equations[m][p]
    return {name: value for name, value in changes.items() if value}


def _eliminated(
    equations: dict[Monomial, dict[int, Fraction]], sides: dict[Monomial, Fraction]
) -> dict[int, Fraction] | None:
    """Return one solution of the equations, in which few unknowns differ from 0."""
    if len(equations) > _MOST:
        return None
    users: dict[int, set[Monomial]] = {}
    for m, equation in equations.items():
        for p in equation:
            users.setdefault(p, set()).add(m)
    solved: list[tuple[Monomial, int]] = []
    left = set(equations)
    while left:
        m = min(left, key=lambda e: (len(equations[e]), e))
        left.remove(m)
        equation = equations[m]
        if not equation:
            if sides[m]:
                return None
            continue
        largest = max(abs(c) for c in equation.values())
        p = min((p for p, c in equation.items() if 4 * abs(c) >= largest), key=lambda p: (len(users[p]), p))
        solved.append((m, p))
        for other in list(users[p]):
            if other == m or other not in left:
                continue
            factor = equations[other][p] / equation[p]
            sides[other] -= factor * sides[m]
            for q, c in equation.items():
                value = equations[other].get(q, Fraction(0)) - factor * c
                if value:
                    equations[other][q] = value
                    users[q].add(other)
                else:
                    equations[other].pop(q, None)
                    users[q].discard(other)
    values: dict[int, Fraction] = {}
    for m, p in reversed(solved):
        equation = equations[m]
        known = sum((c * values[q] for q, c in equation.items() if q in values), Fraction(0))
        values[p] = (sides[m] - known) / equation[p]
    return values
