"""The result of the priority law in one control period, with an explanation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.priority.optimality import is_optimal
from surctl.priority.problem import Level, PriorityProblem
from surctl.priority.settings import Settings

__all__ = ["Outcome", "PrioritySolution", "residuals_at"]

Outcome: TypeAlias = Literal["optimal", "limited", "relaxed", "unconfirmed", "clamped"]
"""optimal: v is the optimum of the mode, and the first task, where the mode considers it, is met as well as without
limits. limited: the first task is met as well as the limits allow. relaxed: the limits contradict each other, so some
were relaxed or moved. unconfirmed: v satisfies the limits as far as a solver could, but was not shown to be optimal, by
the tolerance `optimality.LOSS`. clamped: the actuator limits contradict each other (or no solver found a solution), and
v is only clipped to the velocity bounds."""

_NOTICEABLE = 1e-7


@dataclass(frozen=True, eq=False)
class PrioritySolution:
    """The velocity from the priority law, which is always finite, with the limits and tasks that determine it.

    Attributes:
        v: (n,), velocity; for this vehicle (u, v, w, r) in the body frame {B} [m/s, rad/s].
        settings: settings of the priority law: mode, sweeps, damping, cut-off.
        target: (n,), the velocity to which v is as near as limits and strict levels allow: for "projected", the result
            of the projections on all levels below the first; for "filter", the result of the NSB law, equation (16) of
            the paper; for "lexicographic", 0.
        residuals: residual ‖J v − x‖ of each level with Jacobian J and desired rate x, by name [unit of σ per second].
        without_limits: residual of each level for the velocity of the NSB law without limits; this residual is due to
            the higher levels alone.
        binding: (name, Lagrange multiplier) of each active limit, in the unit of the limit; positive at the upper
            bound, negative at the lower bound. A set-based level at its bound is listed under the name of the level,
            with a dot and the row index if its Jacobian has several rows. The multiplier belongs to min ½‖v − target‖².
            If the limit restricts a strict level (the first level in "projected", any level in "lexicographic"), the
            multiplier belongs to min ½‖J v − x‖² of this level.
        causes: for each strict level that limits restrict, the names of these limits.
        relaxed: violation of each limit that v violates, or that had to be moved because it crosses a harder one, by
            name, in the unit of the limit.
        conflict: names of the limits that contradict each other; empty if no limit had to be relaxed.
        fallback: 1 if the first task is met; 2 if the first task is met as well as the limits allow; 3 if limits are
            relaxed, or if the status is "unconfirmed" or "clamped".
        iterations: number of iterations of all solvers together; 0 if no solver was needed.
        status: see `Outcome`.
        units: unit of each level's residual.
    """

    v: NDArray[np.float64]
    settings: Settings
    target: NDArray[np.float64]
    residuals: Mapping[str, float]
    without_limits: Mapping[str, float]
    binding: tuple[tuple[str, float], ...]
    causes: Mapping[str, tuple[str, ...]]
    relaxed: Mapping[str, float]
    conflict: tuple[str, ...]
    fallback: Literal[1, 2, 3]
    iterations: int
    status: Outcome
    units: Mapping[str, str]

    @property
    def mode(self) -> str:
        """Return the name of the priority mode."""
        return self.settings.mode

    def explain(self) -> str:
        """Return one or two sentences that state which task is not fully met, by how much, and due to which limit."""
        if self.status == "clamped":
            return "The actuator rows contradict each other, or all solvers failed: v is only moved into the box."
        text = self._losses()
        if self.status == "unconfirmed":
            text = f"{text} No solution passed the optimality check, so a better v may exist."
        if not self.relaxed:
            return text
        missed = ", ".join(f"`{name}` by {amount:.2g}" for name, amount in self.relaxed.items())
        if self.mode == "nsb":
            return f"{text} This mode ignores limits: v violates {missed}."
        who = f" ({_listed(self.conflict)})" if self.conflict else ""
        return f"{text} The limits contradict each other{who}, so the least violation was allowed: {missed}."

    def is_optimal(self, problem: PriorityProblem, tol: float = 1e-6) -> bool:
        """Return whether v is optimal for the priority mode and `problem`, by the check in module `optimality`."""
        return self.status != "clamped" and is_optimal(
            self.v, problem, settings=self.settings, target=self.target, tol=tol
        )

    def _losses(self) -> str:
        """Return a sentence that states which tasks are not fully met, by how much, and due to which limits."""
        bind = tuple(name for name, _ in self.binding)
        lost: dict[tuple[str, ...], list[str]] = {}
        for name, residual in self.residuals.items():
            amount = residual - self.without_limits[name]
            if amount > _NOTICEABLE:
                unit = f" {self.units[name]}" if self.units[name] else ""
                lost.setdefault(self.causes.get(name, bind), []).append(f"task `{name}` gave up {amount:.2g}{unit}")
        if not lost:
            if bind:
                return f"{_listed(bind)} {_verb(bind)}, but no task gives up anything."
            known = "the null-space-based law" if self.mode != "lexicographic" else "that of strict priority"
            return f"v is {known}." if self.relaxed else f"No limit binds: v is {known}."
        because = [
            ", ".join(tasks) + (f" because {_listed(rows)} {_verb(rows)}" if rows else "")
            for rows, tasks in lost.items()
        ]
        text = "; ".join(because)
        return f"{text[0].upper()}{text[1:]}."


def _listed(names: Sequence[str]) -> str:
    return " and ".join(f"`{name}`" for name in names)


def _verb(names: Sequence[str]) -> str:
    return "bind" if len(names) > 1 else "binds"


def residuals_at(v: NDArray[np.float64], levels: tuple[Level, ...]) -> dict[str, float]:
    """Return the residual ‖J v − x‖ of each level by name; for a set-based level, the distance to its interval."""
    return {level.name: level.residual(v) for level in levels}
