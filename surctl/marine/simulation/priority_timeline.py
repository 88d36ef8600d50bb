"""Timeline of a run's priority decisions."""

from __future__ import annotations

import numpy as np

from surctl.marine.simulation.run import Run
from surctl.priority import PriorityTimeline

__all__ = ["priority_timeline"]


def priority_timeline(run: Run) -> PriorityTimeline:
    """Return the priority timeline of a run.

    The function solves the law's problem again at each control step, with a name for every constraint row.

    Control steps whose input the law rejected are left out. The function takes about 1 ms per control step.

    Example:
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.simulation import load_scenario, priority_timeline, simulate
        >>> from surctl.marine.vehicle import load_vehicle
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
    units = {name: unit for name, _, unit in law.levels}
    return PriorityTimeline.of(record.time[steps], solutions, units=units, rows=law.rows)
