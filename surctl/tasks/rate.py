"""Limit on the rate of change of a task's quantity σ."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from surctl.tasks.rows import Kind, LimitRow, checked_kind, checked_positive
from surctl.tasks.set_task import SetTask
from surctl.tasks.task import Expression, Task, sized_column

__all__ = ["RateLimit"]


@dataclass(frozen=True, eq=False)
class RateLimit:
    """The limit |σ̇_i| ≤ limit_i on every entry of a task's quantity σ, expressed as constraints on the velocity.

    Attributes:
        task: the task whose quantity σ is limited; it also provides the Jacobian J in σ̇ = J v.
        limit: largest rate of each of the k entries of σ, (k,) or one number for all, at least 0 [unit of σ per
            second].
        kind: kind of limit; see `Kind`.

    Raises:
        InputError: a shape is wrong, a number is negative or not finite, or the kind is unknown; the message names the
            task.
    """

    task: Task | SetTask
    limit: Expression
    kind: Kind = "set"

    def __post_init__(self) -> None:
        """Check the attributes and convert a limit that is one number to a column."""
        name, k = f"{self.task.name}.rate", self.task.size
        checked_kind(name, self.kind)
        column = sized_column(self.limit, (1, k), key=f"limit {name}: limit")
        column = ca.repmat(column, k, 1) if column.numel() < k else column
        object.__setattr__(self, "limit", checked_positive(name, "limit", column, k, zero=True))

    def rows(self) -> tuple[LimitRow, ...]:
        """Return one limit row per entry of σ, named TASK.rate for one entry, otherwise TASK.rate0, TASK.rate1, …"""
        J, limit = self.task.jacobian(), ca.SX(self.limit)
        return tuple(
            LimitRow(name, self.kind, J[i, :], -limit[i], limit[i])
            for i, name in enumerate(self.task.row_names("rate"))
        )
