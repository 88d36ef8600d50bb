"""Goals checked at the end of a tuning, on figures of the assessment that the search does not compute."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from surctl.assessment import Assessment, Comparison, Subject, assess
from surctl.marine.control import Gains
from surctl.marine.tuning.cegis import Round, Tuning
from surctl.marine.tuning.goals import PART_OF, Goal
from surctl.marine.tuning.montecarlo import APART, fresh, monte_carlo
from surctl.tuning.chunked import Progress

__all__ = ["CHECKED", "Finals", "check_finals"]

CHECKED = 4
"""Number of gain sets, the best of a search, on which goals are checked at its end."""


@dataclass(frozen=True, eq=False)
class Finals:
    """What the check at the end of a tuning shows.

    Attributes:
        goals: the goals that were checked.
        comparison: the assessment of the start gains and of the tuned gains.
        checked: number of gain sets that were checked; 0 if there are no such goals.
        best: for each goal, by name, the best value of a set that was checked.
        undetermined: default goals that are not judged, because the assessment has no such figure.
    """

    goals: tuple[Goal, ...]
    comparison: Comparison
    checked: int
    best: Mapping[str, float]
    undetermined: tuple[Goal, ...] = ()

    @property
    def unmet(self) -> tuple[str, ...]:
        """Names of the hard goals that the tuned gains miss."""
        return tuple(g.name for g in self.goals if g.kind == "hard" and not _met(g, self.comparison.after))

    def lines(self) -> list[str]:
        """Return one line for each goal, and one that says on how many gain sets the goals were checked."""
        if not self.goals:
            return []
        sets = f"the {self.checked} best gain sets" if self.checked > 1 else "the best gain set"
        lines = [f"checked at the end, on {sets} of the search:"]
        for goal in self.goals:
            unit = "" if goal.unit == "1" else f" {goal.unit}"
            before, after = (_text(_value(goal, a)) for a in (self.comparison.before, self.comparison.after))
            text = f"  {goal.name} ({goal.kind}): {goal.metric} {goal.sign} {goal.limit:g}{unit}: {before} → {after}"
            if not _met(goal, self.comparison.after):
                text += f"  MISSED; best of the checked sets: {_text(self.best[goal.name])}"
            lines.append(text)
        return lines

    def to_dict(self) -> dict[str, Any]:
        """Return the goals and their values as plain data for JSON."""
        one, other = self.comparison.before, self.comparison.after
        return {
            "checked": self.checked,
            "goals": [
                goal.to_dict()
                | {
                    "hand": _value(goal, one),
                    "tuned": _value(goal, other),
                    "met": _met(goal, other),
                    "best": self.best[goal.name],
                }
                for goal in self.goals
            ],
        }


def check_finals(
    tuning: Tuning,
    goals: Sequence[Goal],
    subject: Callable[[Gains], Subject],
    *,
    default: Collection[Goal] = (),
    progress: Progress = lambda _: None,
) -> tuple[Tuning, Finals]:
    """Return the tuning with the best of its gain sets that meets the goals, and what the check shows.

    The sets are the tuned gains and the next best sets of the chosen round that meet the hard goals of the search. The
    first one that misses the fewest hard goals, then the fewest soft ones, becomes the tuned gains, if the fresh runs
    that verified the tuning do not refute it.

    Args:
        tuning: a finished tuning.
        goals: the goals on figures of the assessment.
        subject: the subject of the assessment with these gains.
        default: those of the goals that are left out if the assessment of the tuned gains has no such figure.
        progress: function that receives one line of text for each gain set.

    Example:
        >>> from surctl.assessment import Figure, Part
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import Goal, Request, build_cases, check_finals, conditions, gain_ranges, tune
        >>> gains = load_gains("default")
        >>> runs = conditions(build_cases([load_scenario("pool-behind")], gains=gains, law="closed_form"), seeds=[0])
        >>> request = Request((Goal("soon", "time_s", "s", 20.0),), runs, gains, gain_ranges(gains, ["k_v"]))
        >>> tuning = tune(request, trials=8, rounds=1, runs=0)
        >>> class Proved:  # in place of a `Mission`
        ...     name = "proved"
        ...     def __init__(self, gains):
        ...         self.figure = Figure("region_m", 0.3, "m", "proved", "high")
        ...     def parts(self):
        ...         return {"region": lambda: Part((self.figure,), ())}
        >>> tuning, finals = check_finals(tuning, [Goal("wide", "region_m", "m", 0.2, "at least")], Proved)
        >>> print(finals.lines()[-1])
          wide (soft): region_m ≥ 0.2 m: 0.3 → 0.3
    """
    base = tuning.request.base
    parts = {PART_OF[goal.metric] for goal in goals}
    undetermined: tuple[Goal, ...] = ()
    sets, tables = [tuning.result.gains, *(_alternatives(tuning) if goals else [])], list[Assessment]()
    for k, gains in enumerate(sets if goals else []):
        progress(f"goals of the assessment: gain set {k + 1} of {len(sets)}")
        tables.append(assess(subject(base.with_values(gains)), parts=parts))
        if k == 0:
            undetermined = tuple(g for g in goals if g in default and g.metric not in tables[0].figures)
            goals = [goal for goal in goals if goal not in undetermined]
        if all(_met(goal, tables[-1]) for goal in goals):
            break
    order = sorted(range(len(tables)), key=lambda k: _missed(goals, tables[k]))
    checked = tables[0].parts if tables else None
    for k in order:
        other = tuning if k == 0 else _adopted(tuning, sets[k])
        if k == 0 or other.accepted:
            tuning, checked = other, tables[k].parts
            break
    progress("assessment of start and tuned gains ...")
    after = assess(subject(base.with_values(tuning.result.gains)), computed=checked)
    comparison = Comparison(assess(subject(base)), after)
    best = {goal.name: _best(goal, tables) for goal in goals}
    return tuning, Finals(tuple(goals), comparison, len(tables), best, undetermined)


def _alternatives(tuning: Tuning) -> list[Mapping[str, float]]:
    # the next best sets of the chosen round that meet every hard goal over all runs known at the end
    others = list(tuning.result.others)
    if not others or not tuning.accepted:
        return []
    pool = tuning.request.judge({s.name: np.array([o[s.name] for o in others]) for s in tuning.request.space})
    return [others[k] for k in range(len(others)) if pool.feasible[k]][: CHECKED - 1]


def _adopted(tuning: Tuning, gains: Mapping[str, float]) -> Tuning:
    """Return the tuning with a further round, which has these gains and is verified by the runs of the chosen round."""
    request, last = tuning.request, tuning.result
    verified = None
    if last.verified is not None:
        first = last.verified.seeds[0] - request.seed * APART
        runs = fresh(request.cases, runs=last.verified.runs, first=first, tuning=request.seed)
        verified = monte_carlo(request.goals, runs, gains, threads=request.threads)
    pool = request.judge({s.name: np.array([gains[s.name]]) for s in request.space})
    start = tuning.hand.evaluation.normalised[0]
    missed = tuple(g.name for g, n in zip(request.goals, pool.evaluation.normalised[0], strict=True) if not n <= 1)
    one = Round(gains, float(pool.score(start)[0]), bool(pool.feasible[0]), missed, (), verified, (), ())
    return replace(tuning, tuned=pool, rounds=(*tuning.rounds, one), chosen=len(tuning.rounds))


def _missed(goals: Sequence[Goal], one: Assessment) -> tuple[int, int]:
    missed = [goal.kind for goal in goals if not _met(goal, one)]
    return missed.count("hard"), missed.count("soft")


def _met(goal: Goal, one: Assessment) -> bool:
    return bool(goal.normalised(np.array([_value(goal, one)]))[0] <= 1)


def _value(goal: Goal, one: Assessment) -> float:
    return one.figures[goal.metric].value if goal.metric in one.figures else float("nan")


def _best(goal: Goal, tables: Sequence[Assessment]) -> float:
    values = np.array([_value(goal, one) for one in tables])
    return float(values[int(np.argmin(goal.badness(values)))])


def _text(value: float) -> str:
    return "none" if np.isnan(value) else f"{value:.4g}"
