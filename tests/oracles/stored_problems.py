"""Priority problems that tests store as JSON; an absent bound is null."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from surctl.priority import Level, PriorityProblem, Row, build_problem

__all__ = ["stored_problem"]


def stored_problem(data: Mapping[str, Any]) -> PriorityProblem:
    """Return the problem with these levels (name, J, lower, upper, unit) and rows (name, kind, a, lower, upper)."""

    def bound(value: float | None, absent: float) -> float:
        return absent if value is None else value

    levels = [
        Level(
            level["name"],
            np.array(level["J"]),
            np.array([bound(value, -math.inf) for value in level["lower"]]),
            np.array([bound(value, math.inf) for value in level["upper"]]),
            level["unit"],
        )
        for level in data["levels"]
    ]
    rows = [
        Row(row["name"], row["kind"], np.array(row["a"]), bound(row["lower"], -math.inf), bound(row["upper"], math.inf))
        for row in data["rows"]
    ]
    return build_problem(levels, rows)
