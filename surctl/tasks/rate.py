"""A limit on how fast one task's quantity may change."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from surctl.tasks.rows import Kind, LimitRow, checked_kind, checked_positive
from surctl.tasks.set_task import SetTask
from surctl.tasks.task import Expression, Task, sized_column

__all__ = ["RateLimit"]


@dataclass(frozen=True, eq=False)
class RateLimit:
    """|σ̇_i| ≤ limit_i for every entry of a task's σ, as rows on the velocity.

    Attributes:
        task: whose σ; J of (13).
        limit: (k,) or one number for all, at least 0 [unit of σ per second].
        kind: see `Kind`.

    Raises:
        InputError: wrong shape, a number that is negative or not finite, an unknown kind; it names the task.
    """

    task: Task | SetTask
    limit: Expression
    kind: Kind = "set"

    def __post_init__(self) -> None:
        """Check, and turn the number into a column."""
        name, k = f"{self.task.name}.rate", self.task.size
        checked_kind(name, self.kind)
        column = sized_column(self.limit, (1, k), key=f"limit {name}: limit")
        column = ca.repmat(column, k, 1) if column.numel() < k else column
        object.__setattr__(self, "limit", checked_positive(name, "limit", column, k, zero=True))

    def rows(self) -> tuple[LimitRow, ...]:
        """TASK.rate for a task of one row, TASK.rate0, TASK.rate1, … for more."""
        J, limit = self.task.jacobian(), ca.SX(self.limit)
        return tuple(
            LimitRow(name, self.kind, J[i, :], -limit[i], limit[i])
            for i, name in enumerate(self.task.row_names("rate"))
        )
