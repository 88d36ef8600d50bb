"""Timeline of a run's priority decisions.

The timeline shows how much each priority level was relaxed, and which constraint rows (n·v ≤ b) caused this.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surctl.simulation.run import Run

__all__ = ["NOTICEABLE", "PriorityTimeline", "priority_timeline"]

NOTICEABLE = 1e-6
"""Smallest residual that counts, in any level's unit; smaller residuals are rounding errors."""


@dataclass(frozen=True, eq=False)
class PriorityTimeline:
    """The priority decisions of a run at its n control steps.

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


def priority_timeline(run: Run) -> PriorityTimeline:
    """Return the priority timeline of a run.

    The function solves the law's problem again at each control step, with a name for every constraint row.

    Control steps whose input the law rejected are left out. The function takes about 1 ms per control step.

    Example:
        >>> from surctl.control import build_law, load_gains
        >>> from surctl.simulation import load_scenario, priority_timeline, simulate
        >>> from surctl.vehicle import load_vehicle
        >>> law = build_law(mode="filter", contacts=1)
        >>> run = simulate(load_scenario("pool-behind"), load_vehicle("sur400"), gains=load_gains("default"), law=law)
        >>> timeline = priority_timeline(run)
        >>> [(name, round(float(most), 2)) for name, most in zip(timeline.levels, timeline.to_rows.max(axis=0))]
        [('velocity', 0.23), ('depth', 0.0), ('heading', 0.0)]
    """
    record, law = run.record, run.law
    steps = np.flatnonzero(record.status >= 0)
    solutions = [
        law.explained(record.law_state[k], record.law_input[k], record.parameters_at(k)) for k in steps.tolist()
    ]
    names = tuple(name for name, _, _ in law.levels)
    missed = [{row: by for row, by in a.relaxed.items() if by > NOTICEABLE} for a in solutions]
    held = [{row for row, _ in a.binding} for a in solutions]
    active = set().union(*missed, *held)
    order = {row: place for place, row in enumerate(law.rows)}
    rows = tuple(sorted(active, key=lambda row: (order.get(row, len(order)), row)))
    shape = (len(steps), len(names))
    to_levels = np.array([[a.without_limits[name] for name in names] for a in solutions]).reshape(shape)
    residual = np.array([[a.residuals[name] for name in names] for a in solutions]).reshape(shape)
    to_rows = np.maximum(residual - to_levels, 0.0)
    causes = np.zeros((*shape, len(rows)), dtype=bool)
    for k, (solution, by) in enumerate(zip(solutions, held, strict=True)):
        for level, name in enumerate(names):
            if to_rows[k, level] > NOTICEABLE:
                guilty = solution.causes.get(name, by)
                causes[k, level] = [row in guilty for row in rows]
    return PriorityTimeline(
        time=record.time[steps],
        levels=names,
        units=tuple(unit for _, _, unit in law.levels),
        to_levels=to_levels,
        to_rows=to_rows,
        rows=rows,
        binding=np.array([[row in one for row in rows] for one in held], dtype=bool).reshape(len(steps), len(rows)),
        missed=np.array([[one.get(row, 0.0) for row in rows] for one in missed]).reshape(len(steps), len(rows)),
        causes=causes,
    )
