"""The inputs of the priority solver, as expressions: tasks, limits on the velocity, and the box of the velocity."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from surctl.marine.control.closing import CLIMB, yaw_limit
from surctl.marine.control.decision import Decision, TaskLevel
from surctl.tasks import LimitRow, VelocityBox

__all__ = ["limit_rows", "solver_inputs"]


def limit_rows(decision: Decision, p: dict[str, ca.SX]) -> list[LimitRow]:
    """Return the limits l ≤ a·ν ≤ u: first the four of the velocity box, then those of the barriers."""
    most = ca.vertcat(p["cap"], p["cap"], CLIMB, yaw_limit(p))
    return [*VelocityBox(-most, most).rows(), *(row for limit in decision.rows for row in limit.rows())]


def solver_inputs(levels: Sequence[TaskLevel], rows: Sequence[LimitRow]) -> dict[str, ca.SX]:
    """Return J by rows, the references, the limits (a, lower, upper, may be relaxed?), and the velocity box."""
    flat = [ca.vertcat(row.a.T, row.lower, row.upper, row.kind != "actuator") for row in rows]
    inputs = {
        "J": ca.vec(ca.vertcat(*(level.J for level in levels)).T),
        "reference": ca.vertcat(*(level.reference for level in levels)),
        "rows": ca.vertcat(*flat),
        "box": ca.vertcat(*(getattr(row, side) for side in ("lower", "upper") for row in rows[:4])),
    }
    return {name: ca.densify(value) for name, value in inputs.items()}
