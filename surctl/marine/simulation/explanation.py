"""Explain a run: which tasks the priority solver relaxed, and which constraint rows (n·v ≤ b) caused this."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from surctl.marine.simulation.run import Run
from surctl.priority import PriorityTimeline

__all__ = ["Explanation", "explain", "priority_timeline"]


def priority_timeline(run: Run) -> PriorityTimeline:
    """Return the priority timeline of a run.

    The function solves the law's problem again at each control step, with a name for every constraint row.

    Control steps whose input the law rejected are left out.

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


@dataclass(frozen=True)
class Explanation:
    """The constraint rows that bind or are relaxed, from `time_s` [s] until the next explanation.

    `text` describes the first control step of this interval.
    """

    time_s: float
    binding: tuple[str, ...]
    relaxed: tuple[str, ...]
    text: str


def explain(run: Run) -> list[Explanation]:
    """Return one explanation for each control step at which the set of binding or relaxed constraint rows changes.

    The law's problem is solved again at each control step, with a name for every constraint row. Mode `nsb` ignores the
    constraint rows, so for this mode the relaxed rows are those that the velocity violates. Control steps whose input
    the law rejected because a number was not finite (status `NONFINITE`) are left out.

    Example:
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.simulation import explain, load_scenario, simulate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> law = build_law(mode="filter", contacts=1)
        >>> run = simulate(load_scenario("pool-behind"), load_vehicle("sur400"), gains=load_gains("default"), law=law)
        >>> first, second, *_ = explain(run)
        >>> print(first.text)
        No limit binds: v is the null-space-based law.
        >>> print(f"{second.time_s:.2f} s: {second.text}")
        10.15 s: Task `velocity` gave up 0.0017 m/s because `contact_0` binds.
    """
    record, explanations = run.record, list[Explanation]()
    for k, status in enumerate(record.status):
        if status < 0:
            continue
        solution = run.law.explained(record.law_state[k], record.law_input[k], record.parameters_at(k))
        binding, relaxed = tuple(name for name, _ in solution.binding), tuple(solution.relaxed)
        if not explanations or (binding, relaxed) != (explanations[-1].binding, explanations[-1].relaxed):
            explanations.append(Explanation(float(record.time[k]), binding, relaxed, solution.explain()))
    return explanations
