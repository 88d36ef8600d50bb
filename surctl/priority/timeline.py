"""Timeline of priority decisions: how much each level was relaxed, and which constraint rows caused this."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError
from surctl.priority.solution import PrioritySolution

__all__ = ["NOTICEABLE", "PriorityTimeline"]

NOTICEABLE = 1e-6
"""Smallest residual that counts, in any level's unit; smaller residuals are rounding errors."""


@dataclass(frozen=True, eq=False)
class PriorityTimeline:
    """The priority decisions of n control steps.

    Attributes:
        time: (n,) time of each control step [s].
        levels: names of the priority levels, highest priority first; `units` holds the units of the levels' residuals.
        to_levels: (n, levels) part of a level's residual that higher levels cause, that is, the residual without
            constraint rows.
        to_rows: (n, levels) part of each level's residual that the constraint rows cause in addition.
        rows: names of the constraint rows that bind or are violated in some control step, in the law's order.
        binding: (n, rows) whether a constraint row binds; missed: (n, rows) by how much the velocity violates the
            constraint row [m/s].
        causes: (n, levels, rows) whether a constraint row caused a residual of a level.
    """

    time: NDArray[np.float64]
    levels: tuple[str, ...]
    units: tuple[str, ...]
    to_levels: NDArray[np.float64]
    to_rows: NDArray[np.float64]
    rows: tuple[str, ...]
    binding: NDArray[np.bool_]
    missed: NDArray[np.float64]
    causes: NDArray[np.bool_]

    @property
    def eventful(self) -> bool:
        """Whether, in some control step, a level has a residual or a constraint row binds or is violated."""
        return bool(self.rows) or bool((self.to_levels > NOTICEABLE).any())

    @classmethod
    def of(
        cls,
        time: ArrayLike,
        solutions: Sequence[PrioritySolution],
        *,
        units: Mapping[str, str] | None = None,
        rows: Sequence[str] = (),
    ) -> PriorityTimeline:
        """Return the timeline of the solutions of one stack at successive times.

        Args:
            time: (n,) time of each solution [s].
            solutions: n solutions.
            units: names of all levels, highest priority first, with their units; default: those of the solutions.
            rows: names of constraint rows in the order of the timeline; other rows follow in alphabetical order.

        Raises:
            InputError: the numbers of times and solutions differ.

        Example:
            >>> import casadi as ca
            >>> from surctl.priority import PriorityTimeline, assemble, solve
            >>> from surctl.tasks import Stack, Task, VelocityBox
            >>> q = ca.SX.sym("q", 2)
            >>> go = Task(name="go", eta=q, sigma=q[0] + q[1], target=2.0, gain=1.0, unit="m")
            >>> step = assemble(Stack((go,)), [VelocityBox([-0.5, -0.5], [0.5, 0.5])], inputs={"q": q})
            >>> solutions = [solve(step.problem({"q": [x, 0.0]}), mode="projected") for x in (0.0, 1.5)]
            >>> timeline = PriorityTimeline.of([0.0, 1.0], solutions)
            >>> timeline.rows, timeline.to_rows[:, 0].round(2).tolist()
            (('velocity.0', 'velocity.1'), [1.0, 0.0])
        """
        at = np.asarray(time, dtype=float).reshape(-1)
        if len(at) != len(solutions):
            raise InputError(f"has {len(at)} times for {len(solutions)} solutions", key="time", remedy="give one each")
        known = units if units is not None else (solutions[0].units if solutions else {})
        names, order = tuple(known), {row: place for place, row in enumerate(rows)}
        missed = [{row: by for row, by in a.relaxed.items() if by > NOTICEABLE} for a in solutions]
        held = [{row for row, _ in a.binding} for a in solutions]
        active = sorted(set().union(*missed, *held), key=lambda row: (order.get(row, len(order)), row))
        shape = (len(solutions), len(names))
        to_levels = np.array([[a.without_limits[name] for name in names] for a in solutions]).reshape(shape)
        residual = np.array([[a.residuals[name] for name in names] for a in solutions]).reshape(shape)
        to_rows = np.maximum(residual - to_levels, 0.0)
        causes = np.zeros((*shape, len(active)), dtype=bool)
        for k, (solution, by) in enumerate(zip(solutions, held, strict=True)):
            for level, name in enumerate(names):
                if to_rows[k, level] > NOTICEABLE:
                    guilty = solution.causes.get(name, by)
                    causes[k, level] = [row in guilty for row in active]
        table = (len(solutions), len(active))
        return cls(
            time=at,
            levels=names,
            units=tuple(known.values()),
            to_levels=to_levels,
            to_rows=to_rows,
            rows=tuple(active),
            binding=np.array([[row in one for row in active] for one in held], dtype=bool).reshape(table),
            missed=np.array([[one.get(row, 0.0) for row in active] for one in missed]).reshape(table),
            causes=causes,
        )
