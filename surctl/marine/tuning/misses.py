"""Hard goals and claims that a tuning misses: the worst run of each, its value and bound, and what to do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from surctl.marine.simulation import STOPS, simulate_batch
from surctl.marine.tuning.cegis import Tuning
from surctl.marine.tuning.evaluation import Condition, figures, scope
from surctl.marine.tuning.goals import Goal

__all__ = ["Miss", "advice", "misses", "value_text"]

_ZERO_IF_UNSTABLE = ("disk_margin", "single_loop_disk_margin", "delay_margin_s", "phase_margin_deg")


@dataclass(frozen=True)
class Miss:
    """A hard goal or a claim that the tuned gains miss, in the run in which they miss it most.

    Attributes:
        name: name of the goal or of the claim.
        goal: the goal; None for a claim.
        run: the worst run; None for a claim.
        figure: value of the goal's metric in this run, in its unit; NaN if the run did not arrive.
        ending: how and at what time the run ended; None for a goal about the linear loop and for a claim.
        nominal: the worst run that misses the goal with the vehicle's own parameters; None if there is none.
        extent: the runs that miss the goal, as text; empty for a claim.
    """

    name: str
    goal: Goal | None
    run: Condition | None
    figure: float
    ending: str | None = None
    extent: str = ""
    nominal: Condition | None = None

    @property
    def text(self) -> str:
        """The miss in one line: goal, run, value and bound."""
        if self.goal is None or self.run is None:
            return f"claim {self.name} is refuted with these gains"
        goal = self.goal
        unit = "" if goal.unit == "1" else f" {goal.unit}"
        bound = f"{'≤' if goal.sense == 'at most' else '≥'} {goal.limit:g}{unit}"
        value = value_text(goal, self.figure)
        value += unit if value[-1].isdigit() else ""
        ended = "" if self.ending is None else f" ({self.ending})"
        return f"{self.name} in {self.run.label}: {goal.metric} {value}{ended}, bound {bound}; {self.extent}"

    def to_dict(self) -> dict[str, Any]:
        """The miss as plain data for JSON."""
        run = self.run
        where = {} if run is None else {"case": run.case.name, "seed": run.seed, "plant": dict(run.plant)}
        limit = None if self.goal is None else self.goal.limit
        value = {"figure": self.figure, "limit": limit, "ending": self.ending, "extent": self.extent}
        return {"name": self.name, **where, **value}


def value_text(goal: Goal, figure: float) -> str:
    """Return the value of a goal's metric as text, or a word: no arrival, a value that is not finite, an unstable loop.

    Examples:
        >>> from surctl.marine.tuning import Goal, value_text
        >>> soon = Goal("soon", "time_s", "s", 20.0)
        >>> value_text(soon, 19.93), value_text(soon, float("nan"))
        ('19.93', 'no arrival')
        >>> value_text(Goal("late", "delay_margin_s", "s", 0.2, "at least"), 0.0)
        'unstable'
    """
    if np.isnan(figure):
        return "undefined" if goal.linear else "no arrival"
    if goal.metric in _ZERO_IF_UNSTABLE and figure == 0:
        return "unstable"
    return f"{figure:.4g}" if np.isfinite(figure) else "unbounded"


def misses(tuning: Tuning) -> tuple[Miss, ...]:
    """Return the hard goals and claims that the tuned gains miss (`Tuning.unmet`), each with its worst run.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import Goal, Request, build_cases, conditions, gain_ranges, misses, tune
        >>> gains = load_gains("default")
        >>> runs = conditions(build_cases([load_scenario("pool-behind")], gains=gains, law="closed_form"), seeds=[0])
        >>> goals = (Goal("fast", "time_s", "s", 15.0, kind="hard"),)
        >>> tuning = tune(Request(goals, runs, gains, gain_ranges(gains, ["k_v"])), trials=8, rounds=1, runs=0)
        >>> [miss] = misses(tuning)
        >>> miss.text
        'fast in pool-behind/sur400/truth, seed 0: time_s ... s (reached at ... s), bound ≤ 15 s; missed in 1 of 1 run'
    """
    goals = {g.name: g for g in tuning.request.goals}
    request, verified = tuning.request, tuning.result.verified
    own = [goals[name] for name in tuning.unmet if name in goals]
    sets = {name: np.asarray(values, dtype=float) for name, values in tuning.tuned.sets.items()}
    known = _worst(own, request.conditions, sets, threads=request.threads) if own else {}
    result = []
    for name in tuning.unmet:
        if name in known:
            result.append(known[name])
            continue
        counterexample = next((c for c in verified.counterexamples if c.goal == name), None) if verified else None
        if counterexample is None or verified is None:
            result.append(Miss(name, None, None, float("nan")))
            continue
        run = counterexample.condition(request.cases)
        ending = None if goals[name].linear else _ending(run, sets)
        extent = f"missed in {verified.missed[name]:.2%} of the verifying runs"
        if goals[name].over == "mean":
            extent = "the mean of the verifying runs misses it"
        own_plant = None if run.plant else run
        result.append(Miss(name, goals[name], run, counterexample.figure, ending, extent, own_plant))
    return tuple(result)


def _worst(
    goals: Sequence[Goal], conditions: Sequence[Condition], sets: Mapping[str, Any], *, threads: int
) -> dict[str, Miss]:
    """Return the goals that one gain set misses under the conditions, by name."""
    table = figures(goals, conditions, sets, threads=threads)
    worst = {}
    for goal in goals:
        own = scope(goal, conditions)
        figure = goal.worst(table)[0][0, own]
        each = goal.normalised(figure)
        mean = goal.over == "mean"
        whole = float(goal.normalised(figure.mean()) if mean else each.max())
        if whole <= 1:
            continue
        # of runs that are equally bad, one with the nominal plant, which the user can simulate directly
        varied = np.array([bool(conditions[k].plant) for k in own])
        order = np.lexsort((varied, -goal.badness(figure), -each))
        k = int(order[0])
        run = conditions[own[k]]
        extent = f"missed in {int((each > 1).sum())} of {len(own)} run{'s' * (len(own) != 1)}"
        if mean:
            extent = f"the mean of {len(own)} runs is {value_text(goal, float(figure.mean()))}"
        ending = None if goal.linear else _ending(run, sets)
        own_plant = next((conditions[own[j]] for j in order if each[j] > 1 and not varied[j]), None)
        worst[goal.name] = Miss(goal.name, goal, run, float(figure[k]), ending, extent, own_plant)
    return worst


def _ending(run: Condition, sets: Mapping[str, Any]) -> str:
    """Return how a run ends with the gain set."""
    values = {name: float(np.ravel(v)[0]) for name, v in sets.items()} | dict(run.plant)
    batch = simulate_batch(run.case, {name: np.array([v]) for name, v in values.items()}, seeds=np.array([run.seed]))
    stop, time = (float(np.ravel(batch.column(name))[0]) for name in ("stopped", "time_s"))
    return f"{STOPS[int(stop)]} at {time:.2f} s"


def advice(tuning: Tuning, *, trials: int) -> tuple[str, bool]:
    """Return what to do about the missed hard goals, and whether more trials or rounds can help.

    Args:
        tuning: a tuning that is not accepted.
        trials: number of trials of each search of this tuning.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import Goal, Request, advice, build_cases, conditions, gain_ranges, tune
        >>> gains = load_gains("default")
        >>> runs = conditions(build_cases([load_scenario("pool-behind")], gains=gains, law="closed_form"), seeds=[0])
        >>> goals = (Goal("fast", "time_s", "s", 15.0, kind="hard"),)
        >>> tuning = tune(Request(goals, runs, gains, gain_ranges(gains, ["k_v"])), trials=8, rounds=1, runs=0)
        >>> text, longer = advice(tuning, trials=8)
        >>> text.split(";")[0], longer
        ('no gain set of the searches (8 trials each) meets fast even without the other goals', False)
    """
    clash = tuning.conflict
    if not clash:
        return "some gain set may meet them: increase --trials and --rounds", True
    searched = f"no gain set of the searches ({trials} trials each) meets"
    if len(clash) == 1:
        linear = any(g.linear and g.name == clash[0] for g in tuning.request.goals)
        remedy = "look at such a run, then relax the goal or change the mission or the vehicle"
        if linear:
            remedy = "relax the goal or lower its cruise speed"
        return f"{searched} {clash[0]} even without the other goals; {remedy}", False
    return f"{searched} {' + '.join(clash)} together: relax one of them; each part of them can be met", False
