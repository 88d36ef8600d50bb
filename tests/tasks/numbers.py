"""Rows and expressions as numbers, for tests."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from surctl.priority import Row
from surctl.tasks import Limit


def function(expression, *symbols):
    return ca.Function("f", list(symbols), [ca.densify(ca.SX(expression))])


def rows_at(limit: Limit, symbols: Sequence[ca.SX] = (), values: Sequence[object] = ()) -> list[Row]:
    """The rows where the symbols have these values."""
    made = limit.rows()
    A = function(ca.vertcat(*(r.a for r in made)), *symbols)
    bounds = function(ca.vertcat(*(ca.horzcat(r.lower, r.upper) for r in made)), *symbols)
    A, bounds = np.array(A.call([ca.DM(v) for v in values])[0]), np.array(bounds.call([ca.DM(v) for v in values])[0])
    return [Row(r.name, r.kind, a, *map(float, b)) for r, a, b in zip(made, A, bounds, strict=True)]


def missed(rows: Sequence[Row], v) -> float:
    """The largest miss, each row scaled to length 1."""
    worst = 0.0
    for row in rows:
        value, length = row.a @ v, np.linalg.norm(row.a)
        worst = max(worst, (value - row.upper) / length, (row.lower - value) / length)
    return worst
