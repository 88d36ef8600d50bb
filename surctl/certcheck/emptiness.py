"""Whether a claim says nothing (is vacuous), because no point of its box satisfies its constraints."""

from __future__ import annotations

from collections.abc import Sequence

from mpmath import libmp

from surctl.certcheck.enclosure import Interval, Undefined, above, enclose, exact, span
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.inequality import Box, halves
from surctl.certcheck.patience import go_on

__all__ = ["is_empty"]

_MOST = 200  # boxes


def is_empty(names: Sequence[str], box: Box, constraints: Sequence[str]) -> bool | None:
    """Return whether on the whole box some constraint is certainly positive, so that they hold together nowhere.

    The box is halved until this is shown (True), or a point satisfies all constraints (False). None: neither was shown
    with `_MOST` boxes.
    """
    table = ExpressionTable(names)
    roots = [table.read(text) for text in constraints]
    if not roots:
        return False
    waiting = [list(box)]
    for _ in range(_MOST):
        if not waiting:
            return True
        go_on()
        part = waiting.pop()
        if any(above(value) for value in _values(table, roots, [span(*ends) for ends in part])):
            continue
        centre = [low / 2 + high / 2 for low, high in part]
        at = _values(table, roots, [exact(x) for x in centre])
        if len(at) == len(roots) and all(libmp.mpf_le(value[1], libmp.fzero) for value in at):
            return False
        waiting += halves(part, box)
    return None


def _values(table: ExpressionTable, roots: Sequence[int], box: list[Interval]) -> list[Interval]:
    """Return the ranges of those expressions that are defined on the whole box."""
    values = []
    for root in roots:
        try:
            values.append(enclose(table, [root], box)[0])
        except Undefined:
            continue
    return values
