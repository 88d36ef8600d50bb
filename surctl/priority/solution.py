"""What the priority law answers at one tick, and why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.priority.optimality import is_optimal
from surctl.priority.problem import Level, PriorityProblem

__all__ = ["Mode", "Outcome", "PrioritySolution", "residuals_at"]

Mode: TypeAlias = Literal["nsb", "projected"]
Outcome: TypeAlias = Literal["optimal", "limited", "relaxed", "clamped"]
"""optimal: the first task is met; limited: it is met as well as the rows allow; relaxed: the rows contradict
each other, and some gave way; clamped: the actuator rows themselves do (or no solver answered), and v is only
kept in the box."""

_NOTICEABLE = 1e-7


@dataclass(frozen=True, eq=False)
class PrioritySolution:
    """A velocity that is always finite, and its reasons.

    Attributes:
        v: (n,); for this vehicle (u, v, w, r) in {B} [m/s, rad/s].
        mode: the law.
        residuals: ‖J_i v − x_i‖ of each level [unit of σ per second].
        without_limits: the same for the law (16) without rows: what a level loses to levels above it alone.
        binding: (row, multiplier) of the rows that hold v back; positive at the upper bound, negative at the
            lower. Of ½‖v − w_2‖² in the last projection; for a row that holds back the first task itself, of
            ½‖J_1 v − x_1‖².
        relaxed: how far v misses the rows that it misses, in the unit of each row.
        fallback: 1 first task met, 2 met as well as the rows allow, 3 rows relaxed or v clamped.
        iterations: of the QP solver, summed; 0 when none was needed.
        status: see `Outcome`.
    """

    v: NDArray[np.float64]
    mode: Mode
    residuals: Mapping[str, float]
    without_limits: Mapping[str, float]
    binding: tuple[tuple[str, float], ...]
    relaxed: Mapping[str, float]
    fallback: Literal[1, 2, 3]
    iterations: int
    status: Outcome

    def explain(self) -> str:
        """One or two sentences: which task gave up how much, because of which row."""
        if self.status == "clamped":
            return "The actuator rows contradict each other, or no solver answered: v is only kept in the box."
        text = self._losses()
        if self.relaxed:
            missed = ", ".join(f"`{name}` by {amount:.2g}" for name, amount in self.relaxed.items())
            text += (
                f" This mode knows no limits: v misses {missed}."
                if self.mode == "nsb"
                else (f" The limits contradict each other, so the least violation was allowed: {missed}.")
            )
        return text

    def is_optimal(self, problem: PriorityProblem, tol: float = 1e-6) -> bool:
        """Whether v is what `mode` promises for `problem`, judged from v alone; see `optimality`."""
        return self.status != "clamped" and is_optimal(self.v, problem, mode=self.mode, tol=tol)

    def _losses(self) -> str:
        """The sentence on tasks."""
        lost = {
            name: residual - self.without_limits[name]
            for name, residual in self.residuals.items()
            if residual - self.without_limits[name] > _NOTICEABLE
        }
        because = " and ".join(f"`{name}`" for name, _ in self.binding)
        verb = "bind" if len(self.binding) > 1 else "binds"
        if lost:
            what = ", ".join(f"task `{name}` gave up {amount:.2g}" for name, amount in lost.items())
            return f"{what[0].upper()}{what[1:]}" + (f" because {because} {verb}." if because else ".")
        if because:
            return f"{because} {verb}, at no task's cost."
        return "v is the null-space-based law." if self.relaxed else "No limit binds: v is the null-space-based law."


def residuals_at(v: NDArray[np.float64], levels: tuple[Level, ...]) -> dict[str, float]:
    """‖J_i v − x_i‖ of each level, by name."""
    return {level.name: float(np.sqrt(((level.J @ v - level.x) ** 2).sum())) for level in levels}
