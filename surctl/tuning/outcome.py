"""End of a tuning: which gain set is taken, also the start gains; missed goals, advice, tables, `tuning.json`."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from surctl import __version__
from surctl.assessment import Assessment, Comparison, Figure, Part
from surctl.tuning.cegis import Round, Tuning
from surctl.tuning.chunked import Progress
from surctl.tuning.goals import RunGoal
from surctl.tuning.montecarlo import APART, monte_carlo
from surctl.tuning.pool import Condition, scope

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
    goal: RunGoal | None
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
        bound = f"{goal.sign} {goal.limit:g}{unit}"
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


def value_text(goal: RunGoal, figure: float) -> str:
    """Return the value of a goal's metric as text; a word for no arrival, an unstable loop, or an infinite value."""
    if np.isnan(figure):
        return goal.absent
    if goal.metric in _ZERO_IF_UNSTABLE and figure == 0:
        return "unstable"
    return f"{figure:.4g}" if np.isfinite(figure) else "unbounded"


def misses(tuning: Tuning) -> tuple[Miss, ...]:
    """Return the hard goals and claims that the tuned gains miss (`Tuning.unmet`), each with its worst run."""
    goals = {g.name: g for g in tuning.request.goals}
    request, verified = tuning.request, tuning.result.verified
    own = [goals[name] for name in tuning.unmet if name in goals]
    known = _worst(own, tuning) if own else {}
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
        ending = None if goals[name].linear else request.ending(run, tuning.result.gains)
        extent = f"missed in {verified.missed[name]:.2%} of the verifying runs"
        if goals[name].over == "mean":
            extent = "the mean of the verifying runs misses it"
        own_plant = None if run.plant else run
        result.append(Miss(name, goals[name], run, counterexample.figure, ending, extent, own_plant))
    return tuple(result)


def _worst(goals: Sequence[RunGoal], tuning: Tuning) -> dict[str, Miss]:
    """Return the goals that the tuned gains miss under the conditions, by name."""
    conditions = tuning.request.conditions
    table = tuning.request.figures(goals, conditions, tuning.tuned.sets)
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
        ending = None if goal.linear else tuning.request.ending(run, tuning.result.gains)
        own_plant = next((conditions[own[j]] for j in order if each[j] > 1 and not varied[j]), None)
        worst[goal.name] = Miss(goal.name, goal, run, float(figure[k]), ending, extent, own_plant)
    return worst


def advice(tuning: Tuning, *, trials: int) -> tuple[str, bool]:
    """Return what to do about the missed hard goals, and whether more trials or rounds can help.

    Args:
        tuning: a tuning that is not accepted.
        trials: number of trials of each search of this tuning.
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


_SCORE = "the largest soft goal over its limit, or over its start value if that meets the limit; lower is better"
_LARGE = 100  # a larger normalised value only says that a run did not arrive, or that the metric is almost 0


def outcome_text(tuning: Tuning) -> str:
    """Return what the fresh runs and the search for a conflict showed, in one line."""
    last = tuning.result
    fresh = last.verified
    missed = f"HARD GOALS NOT MET: {', '.join(tuning.unmet)}; " if tuning.unmet else ""
    checked = "not verified by fresh runs"
    if fresh is not None:
        refuted = ", ".join(last.refuted) or "nothing"
        checked = f"{fresh.runs} fresh runs with seeds {fresh.seeds[0]} to {fresh.seeds[1]} refute {refuted}"
    if tuning.conflict:
        checked += f"; not met together: {' + '.join(tuning.conflict)}"
    return missed + checked


def goal_rows(tuning: Tuning) -> list[dict[str, Any]]:
    """Return one table row per goal: its bound, its metric and normalised value with start gains and tuned gains."""
    hand, tuned = tuning.hand.evaluation, tuning.tuned.evaluation
    return [
        goal.to_dict()
        | {
            "hand": float(hand.figure[0, j]),
            "tuned": float(tuned.figure[0, j]),
            "normalised_hand": float(hand.normalised[0, j]),
            "normalised_tuned": float(tuned.normalised[0, j]),
            "met": bool(tuned.normalised[0, j] <= 1),
        }
        | goal.place_dict(float(tuned.place[0, j]))
        | {"better": tuning.better[j]}
        for j, goal in enumerate(tuning.request.goals)
    ]


def summary(tuning: Tuning) -> list[str]:
    """Return the result of a tuning as lines of text: the table of the goals, then the outcome.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import Goal, Request, build_cases, conditions, gain_ranges
        >>> from surctl.tuning import summary, tune
        >>> gains = load_gains("default")
        >>> runs = conditions(build_cases([load_scenario("pool-behind")], gains=gains, law="closed_form"), seeds=[0])
        >>> request = Request((Goal("soon", "time_s", "s", 20.0),), runs, gains, gain_ranges(gains, ["k_v"]))
        >>> tuning = tune(request, trials=8, rounds=1, runs=0)
        >>> lines = summary(tuning)
        >>> print(lines[1])
        soon                    soft  s             ≤ 20       20.45        19.9     1.022 → 0.995
        >>> print(lines[-1])
        after 1 round(s): not verified by fresh runs
    """
    lines = [f"{'goal':<24}{'kind':<6}{'unit':<6}{'limit':>12}{'start gains':>12}{'tuned':>12}{'normalised':>18}"]
    places = tuning.tuned.evaluation.place[0].tolist()
    for goal, one, place in zip(tuning.request.goals, goal_rows(tuning), places, strict=True):
        both = (one[f"normalised_{which}"] for which in ("hand", "tuned"))
        change = " → ".join(f"{value:.3f}" if value < _LARGE else f"> {_LARGE}" for value in both)
        mark = "" if one["met"] else "  MISSED"
        mark += "".join(f"  {at}" for at in [goal.place_text(place)] if at)
        lines.append(
            f"{one['name']:<24}{one['kind']:<6}{one['unit']:<6}{goal.sign + ' ' + format(one['limit'], 'g'):>12}"
            f"{value_text(goal, one['hand']):>12}{value_text(goal, one['tuned']):>12}{change:>18}{mark}"
        )
    if any(goal.kind == "soft" for goal in tuning.request.goals):
        start = tuning.hand.evaluation.normalised[0]
        change = " → ".join(f"{pool.score(start)[0]:.3f}" for pool in (tuning.hand, tuning.tuned))
        lines += ["", f"score {change}: {_SCORE}"]
    last = tuning.result
    values = ", ".join(f"{name} = {value:.4g}" for name, value in last.gains.items())
    lines += ["", f"gains: {values}", f"after {len(tuning.rounds)} round(s): {outcome_text(tuning)}"]
    return lines


def tuning_dict(tuning: Tuning) -> dict[str, Any]:
    """Return the result as plain data for `tuning.json`.

    Numbers that are not finite are converted when the file is written.
    """
    request, front, best = tuning.request, tuning.front, tuning.result
    start = tuning.hand.evaluation.normalised[0]
    scores = front.score(start)
    return {
        "version": __version__,
        "request": request.digest,
        "seed": request.seed,
        "accepted": tuning.accepted,
        "unmet": list(tuning.unmet),
        "misses": [miss.to_dict() for miss in misses(tuning)],
        "goals": goal_rows(tuning),
        "space": {s.name: [s.low, s.high] for s in request.space},
        "best": {"gains": dict(best.gains), "score": best.score, "feasible": best.feasible},
        "front": [
            {
                "gains": front.gains(k),
                "score": float(scores[k]),
                "effort_n": float(front.evaluation.effort[k]),
                "normalised": front.evaluation.normalised[k].tolist(),
            }
            for k in range(len(scores))
        ],
        "rounds": [r.to_dict() for r in tuning.rounds],
        "counterexamples": [
            asdict(c) for r in tuning.rounds for c in (*r.training, *(r.verified.counterexamples if r.verified else ()))
        ],
        "conflict": list(tuning.conflict),
    }


# Goals checked at the end of a tuning, on figures of the assessment that the search does not compute


@dataclass(frozen=True, eq=False)
class Finals:
    """What the check at the end of a tuning shows.

    Attributes:
        goals: the goals that were checked.
        comparison: the assessment of the start gains and of the tuned gains.
        checked: number of gain sets that were checked; 0 if there are no such goals.
        best: for each goal, by name, the best value of a set that was checked.
        undetermined: default goals that are not judged, because the assessment has no such figure.
        started: whether the start gains are one of the sets, because all others miss a goal.
        refused: why the start gains are the result, as a line of text; empty if they are not.
    """

    goals: tuple[RunGoal, ...]
    comparison: Comparison
    checked: int
    best: Mapping[str, float]
    undetermined: tuple[RunGoal, ...] = ()
    started: bool = False
    refused: str = ""

    @property
    def unmet(self) -> tuple[str, ...]:
        """Names of the hard goals that the tuned gains miss."""
        return tuple(g.name for g in self.goals if g.kind == "hard" and not _met(g, self.comparison.after))

    def lines(self) -> list[str]:
        """Return one line for each goal, and one that says on how many gain sets the goals were checked."""
        if not self.goals:
            return []
        count = self.checked - self.started
        sets = f"the {count} best gain sets" if count > 1 else "the best gain set"
        lines = [f"checked at the end, on {sets} of the search{' and the start gains' if self.started else ''}:"]
        for goal in self.goals:
            unit = "" if goal.unit == "1" else f" {goal.unit}"
            before, after = (_text(_value(goal, a)) for a in (self.comparison.before, self.comparison.after))
            text = f"  {goal.name} ({goal.kind}): {goal.metric} {goal.sign} {goal.limit:g}{unit}: {before} → {after}"
            if not _met(goal, self.comparison.after):
                text += f"  MISSED; best of the checked sets: {_text(self.best[goal.name])}"
            lines.append(text)
        return [*lines, self.refused] if self.refused else lines

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


class Tuned(NamedTuple):
    """A tuning, and the check of its gains at the end."""

    tuning: Tuning
    finals: Finals

    @property
    def gains(self) -> dict[str, float]:
        """The tuned gains by name; if no gain set meets all hard goals, those that miss least."""
        return dict(self.tuning.result.gains)

    @property
    def unmet(self) -> tuple[str, ...]:
        """Names of the hard goals that the tuned gains miss; empty if the tuning succeeded."""
        return (*self.tuning.unmet, *self.finals.unmet)

    @property
    def figures(self) -> Mapping[str, Figure]:
        """The figures of the assessment with the tuned gains, by name."""
        return self.finals.comparison.after.figures

    def lines(self) -> list[str]:
        """Return lines of text: the table of the goals, the gains, and the goals that were checked at the end."""
        return [*summary(self.tuning), *self.finals.lines()]


def check_finals(
    tuning: Tuning,
    goals: Sequence[RunGoal],
    assessed: Callable[[Mapping[str, float], Collection[str] | None, Mapping[str, Part] | None], Assessment],
    *,
    default: Collection[RunGoal] = (),
    progress: Progress = lambda _: None,
) -> Tuned:
    """Return the tuning with the best of its gain sets that meets the goals, and what the check shows.

    The sets are the tuned gains, the next best sets of the chosen round that meet the hard goals of the search and, if
    all of these miss a goal, the start gains if they are in the ranges. The first one that misses the fewest hard
    goals, then the fewest soft ones, then its worst hard goal by the least share, becomes the tuned gains, if the fresh
    runs that verified the tuning do not refute it.

    Args:
        tuning: a finished tuning.
        goals: the goals on figures of the assessment.
        assessed: function of gains, the names of parts (None: all), and parts that are known: what is assessed.
        default: those of the goals that are left out if the assessment of the tuned gains has no such figure.
        progress: function that receives one line of text for each gain set.
    """
    begun = tuning.request.begun
    parts = {goal.part for goal in goals}
    undetermined: tuple[RunGoal, ...] = ()
    sets, tables = [tuning.result.gains, *(_alternatives(tuning) if goals else [])], list[Assessment]()
    for k, gains in enumerate(sets if goals else []):
        progress(f"goals of the assessment: gain set {k + 1} of {len(sets)}")
        tables.append(assessed(gains, parts, None))
        if k == 0:
            undetermined = tuple(g for g in goals if g in default and g.metric not in tables[0].figures)
            goals = [goal for goal in goals if goal not in undetermined]
        if all(_met(goal, tables[-1]) for goal in goals):
            break
    inside = all(span.low <= begun[span.name] <= span.high for span in tuning.request.space)
    started = bool(tables) and inside and not all(_met(goal, tables[-1]) for goal in goals)
    if started:  # gains that are worse than these are no result
        sets = [*sets[: len(tables)], begun]
        tables.append(assessed(begun, parts, None))
    before = tables[-1].parts if started else None
    order = sorted(range(len(tables)), key=lambda k: _missed(goals, tables[k]))
    checked = tables[0].parts if tables else None
    for k in order:
        other = tuning if k == 0 else _adopted(tuning, sets[k])
        if k == 0 or other.accepted:
            tuning, checked = other, tables[k].parts
            break
    refused = ""
    if started and tuning.result.gains == begun:
        missed = [goal for goal in goals if not _met(goal, tables[0])]
        values = ", ".join(f"{g.metric} {g.sign} {g.limit:g} ({_text(_value(g, tables[0]))})" for g in missed)
        remedy = "add a goal of type margins; " * ({g.metric for g in missed} <= {"disk_margin", "delay_margin_s"})
        refused = f"start gains kept: {remedy}the best set of the search misses {values}"
    progress("assessment of start and tuned gains ...")
    after = assessed(tuning.result.gains, None, checked)
    comparison = Comparison(assessed(begun, None, before), after)
    best = {goal.name: _best(goal, tables) for goal in goals}
    return Tuned(tuning, Finals(tuple(goals), comparison, len(tables), best, undetermined, started, refused))


def _alternatives(tuning: Tuning) -> list[Mapping[str, float]]:
    # the next best sets of the chosen round that meet every hard goal over all runs known at the end
    others = list(tuning.result.others)
    if not others or not tuning.accepted:
        return []
    pool = tuning.request.judge({s.name: np.array([o[s.name] for o in others]) for s in tuning.request.space})
    return [others[k] for k in range(len(others)) if pool.feasible[k]][: tuning.request.checked - 1]


def _adopted(tuning: Tuning, gains: Mapping[str, float]) -> Tuning:
    """Return the tuning with a further round, which has these gains and is verified by the runs of the chosen round."""
    request, last = tuning.request, tuning.result
    verified = None
    if last.verified is not None:
        first = last.verified.seeds[0] - request.seed * APART
        runs = request.fresh(runs=last.verified.runs, first=first)
        verified = monte_carlo(request.figures, request.goals, runs, gains)
    pool = request.judge({s.name: np.array([gains[s.name]]) for s in request.space})
    start = tuning.hand.evaluation.normalised[0]
    missed = tuple(g.name for g, n in zip(request.goals, pool.evaluation.normalised[0], strict=True) if not n <= 1)
    one = Round(gains, float(pool.score(start)[0]), bool(pool.feasible[0]), missed, (), verified, (), ())
    return replace(tuning, tuned=pool, rounds=(*tuning.rounds, one), chosen=len(tuning.rounds))


def _missed(goals: Sequence[RunGoal], one: Assessment) -> tuple[int, int, float]:
    # how many hard and soft goals are missed, and by how much the worst hard one
    shares = {goal: _share(goal, one) for goal in goals}
    missed = [goal.kind for goal, share in shares.items() if not share <= 1]
    hard = [share for goal, share in shares.items() if goal.kind == "hard" and not share <= 1]
    return missed.count("hard"), missed.count("soft"), float(np.nan_to_num(max(hard, default=1.0), nan=np.inf))


def _share(goal: RunGoal, one: Assessment) -> float:
    return float(goal.normalised(np.array([_value(goal, one)]))[0])


def _met(goal: RunGoal, one: Assessment) -> bool:
    return _share(goal, one) <= 1


def _value(goal: RunGoal, one: Assessment) -> float:
    return one.figures[goal.metric].value if goal.metric in one.figures else float("nan")


def _best(goal: RunGoal, tables: Sequence[Assessment]) -> float:
    values = np.array([_value(goal, one) for one in tables])
    return float(values[int(np.argmin(goal.badness(values)))])


def _text(value: float) -> str:
    return "none" if np.isnan(value) else f"{value:.4g}"
