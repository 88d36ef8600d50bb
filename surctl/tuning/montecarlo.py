"""Random runs that test gains: training runs screen a search, fresh runs verify one set; their seeds."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.tuning.chunked import Journal, Progress
from surctl.tuning.goals import RunGoal
from surctl.tuning.pool import ClaimPoint, Condition, Figures, Pool, SearchRequest, Sets, Simulated, merged, scope

APART = 10_000_000  # seeds reserved for each tuning, so that two tunings never share a seed

MOST_SEED = 2**62 // APART
"""Largest seed of a tuning, because the seeds of its runs are 64-bit numbers."""


@dataclass(frozen=True)
class Counterexample:
    """A run that misses a goal.

    If the goal bounds a mean, the counterexample is one of several runs whose mean misses the goal.

    Attributes:
        goal: name of the goal.
        case: name of the case.
        seed: seed of the run.
        plant: changed parameters (`plant.…`) of the simulated vehicle.
        figure: value of the goal's metric, in its unit; NaN if the run did not arrive.
        normalised: normalised value of the goal for this run (`RunGoal.normalised`); above 1, the run
            misses the goal's limit. It may be at most 1 if the goal limits the mean of all runs.
    """

    goal: str
    case: str
    seed: int
    plant: Mapping[str, float]
    figure: float
    normalised: float

    def condition(self, cases: Sequence[Any]) -> Condition:
        """Return the run as a condition of a tuning; the condition counts only for the refuted goal."""
        case = next(c for c in cases if c.name == self.case)
        return Condition(case, self.seed, dict(self.plant), (self.goal,))


@dataclass(frozen=True)
class MonteCarlo:
    """Result of the fresh runs of one gain set.

    Attributes:
        runs: number of runs.
        seeds: first and last seed of the fresh runs; no seed in this range was used before.
        missed: share of the runs of a goal that miss its limit, by goal name; a goal without a fresh run is omitted.
        normalised: normalised value of each goal in its worst run, by goal name; for a goal that bounds a mean, the
            normalised value of the mean.
        counterexamples: for each refuted goal, a few of the worst runs in every case, the worst first. For a goal that
            bounds a mean, they are a few runs spread evenly from the worst run to the best.
    """

    runs: int
    seeds: tuple[int, int]
    missed: Mapping[str, float]
    normalised: Mapping[str, float]
    counterexamples: tuple[Counterexample, ...]

    @property
    def refuted(self) -> tuple[str, ...]:
        """Names of the goals that the fresh runs refute."""
        return tuple(dict.fromkeys(c.goal for c in self.counterexamples))


def monte_carlo(
    figures: Simulated,
    goals: Sequence[RunGoal],
    conditions: Sequence[Condition],
    gains: Mapping[str, float],
    *,
    each: int = 3,
) -> MonteCarlo:
    """Simulate one gain set under every condition and find the goals that it misses.

    Args:
        figures: function that simulates gain sets, see `SearchRequest.figures`.
        goals: the goals.
        conditions: the runs.
        gains: the gain set: the value of each gain by name.
        each: largest number of counterexamples of one goal in one case.
    """
    sets = {name: np.array([value]) for name, value in gains.items()}
    table = figures(goals, conditions, sets)
    missed, normalised, counterexamples = {}, {}, []
    for goal in goals:
        own = scope(goal, conditions)
        if not own:  # nominal plant and cases without seeds: the goal has no fresh run
            continue
        figure = goal.worst(table)[0][0, own]
        apiece = goal.normalised(figure)
        whole = float(goal.normalised(figure.mean()) if goal.over == "mean" else apiece.max())
        missed[goal.name], normalised[goal.name] = float((apiece > 1).mean()), whole
        if whole > 1:
            chosen = _chosen(goal, figure, apiece, [conditions[k].case.name for k in own], each)
            for k in chosen:
                run, numbers = conditions[own[k]], (float(figure[k]), float(apiece[k]))
                counterexamples.append(Counterexample(goal.name, run.case.name, run.seed, run.plant, *numbers))
    return MonteCarlo(
        len(conditions), (conditions[0].seed, conditions[-1].seed), missed, normalised, tuple(counterexamples)
    )


def _chosen(
    goal: RunGoal, figure: NDArray[np.float64], normalised: NDArray[np.float64], cases: Sequence[str], most: int
) -> list[int]:
    """Return the indices of runs that refute a goal: the worst runs of each case.

    For a goal that bounds a mean, the runs are spread evenly from the worst run to the best.
    """
    # several normalised values may be inf: the metric then decides which run is worse, NaN first
    order = [int(k) for k in np.lexsort((-goal.badness(figure), -normalised))]
    by_case = {case: [k for k in order if cases[k] == case] for case in dict.fromkeys(cases[k] for k in order)}
    chosen = []
    for own in by_case.values():
        if goal.over == "mean":  # spread evenly over the ranks, because the worst runs alone would have another mean
            count = min(most, len(own))
            chosen += [own[(2 * j + 1) * len(own) // (2 * count)] for j in range(count)]
        else:
            chosen += [k for k in own if normalised[k] > 1][:most]
    return sorted(chosen, key=order.index)


TRAINING = 10  # training runs for each verifying run: a set that passes 10 n runs seldom fails in n fresh runs
_FIRST = APART // 2  # first seed of the training runs, beyond the seeds of fresh runs
_EACH = 10  # refuting runs of a set that are stored for each goal and case
_SHORT = 64  # best sets of a search that are simulated in all runs, and as many sets of its front


@dataclass(frozen=True, eq=False)
class Screened:
    """Result of screening the gain sets of a search.

    Attributes:
        request: the request of the search, to which every refuting run is added as a condition for the goal that it
            refutes.
        gains: the best gain set that remains; if none remains, the set that misses least.
        counterexamples: the training runs that refuted a gain set.
    """

    request: SearchRequest
    gains: dict[str, float]
    counterexamples: tuple[Counterexample, ...]


def harder(
    request: SearchRequest, counterexamples: Sequence[Counterexample], claims: Sequence[ClaimPoint] = ()
) -> SearchRequest:
    """Extend a request: refuting runs become conditions of the goals that they refute, claim points constraints."""
    requested = [c for c in request.conditions if c.goals is None]
    known = [c for c in request.conditions if c.goals is not None]
    refuting = merged((*known, *(c.condition(request.cases) for c in counterexamples)))
    return replace(request, conditions=(*requested, *refuting), claims=(*request.claims, *claims))


_PART, _PAUSE = 256, 2.0  # runs that are stored together; time between two lines of progress [s]


def stored_figures(request: SearchRequest, journal: Journal, progress: Progress) -> Simulated:
    """Return `SearchRequest.figures` in parts of some hundreds of runs, which the journal stores, with their pace."""

    def figures(goals: Sequence[RunGoal], conditions: Sequence[Condition], sets: Sets) -> Figures:
        names = sorted({"effort_n", *(name for goal in goals for name in goal.columns)})
        count, most = len(next(iter(sets.values()))), max(1, _PART // len(conditions))
        parts = [(sets, conditions[k : k + _PART]) for k in range(0, len(conditions), _PART)]
        if count > 1:
            parts = [({n: v[k : k + most] for n, v in sets.items()}, conditions) for k in range(0, count, most)]
        values = {name: np.asarray(value).tolist() for name, value in sets.items()}
        about = f"{request.digest} {[goal.name for goal in goals]} {values} {[(c.run, c.goals) for c in conditions]}"
        batches, tables = journal.batches(about, width=1 + len(names)), list[NDArray[np.float64]]()
        known, done, whole, began = 0, 0, count * len(conditions), time.perf_counter()
        shown = began
        for some, own in parts:
            places = np.arange(done, done + len(next(iter(some.values()))) * len(own), dtype=float)[:, None]
            restored = batches.known(len(places)) is not None

            def simulated(_: object, some: Sets = some, own: Sequence[Condition] = own) -> NDArray[np.float64]:
                table = request.figures(goals, own, some)
                return np.column_stack([table[name].ravel() for name in names])

            tables.append(batches.evaluated(places, simulated)[:, 1:])
            done += len(places)
            known += len(places) * restored
            now = time.perf_counter()
            if not restored and now - shown > _PAUSE:
                shown, rate = now, (done - known) / (now - began)
                progress(f"test run {done}/{whole}, {rate:.3g} runs/s, ETA {(whole - done) / rate:.0f} s")
        every = np.concatenate(tables)
        return {name: every[:, k].reshape(count, -1) for k, name in enumerate(names)}

    return figures


def screen(
    request: SearchRequest,
    pool: Pool,
    *,
    runs: int,
    figures: Simulated | None = None,
    progress: Progress = lambda _: None,
) -> Screened:
    """Simulate training runs with the best gain set and drop all sets that a failed run refutes, until a set passes.

    The training runs are identical for all gain sets and all rounds of a tuning; they differ from the fresh runs. A
    gain set is tested only on the goals that it meets over the runs of the search. The screening ends with a set that
    no training run refutes, or when no set remains.

    Args:
        request: the request of the search.
        pool: simulated gain sets of the search, the start gains first.
        runs: number of training runs.
        figures: function that simulates gain sets; None: that of the request.
        progress: function that receives one line of text at the end.
    """
    figures, start = figures or request.figures, pool.evaluation.normalised[0]
    met = pool.evaluation.normalised <= 1
    left = [k for k in pool.ranked(start) if pool.feasible[k]]
    tested = bool(left)
    training = request.fresh(runs=runs, first=_FIRST)
    counterexamples: list[Counterexample] = []
    tried = 0
    while left:
        goals = [g for g, m in zip(request.goals, met[left[0]], strict=True) if m]
        gains = pool.gains(left[0])
        refuting = monte_carlo(figures, goals, training, gains, each=_EACH).counterexamples
        if not refuting:
            break
        tried += 1
        counterexamples += refuting
        left = _withstanding(request, pool, met, left[1:], refuting, figures)
    tougher = harder(request, counterexamples)
    if not left:
        pool = reduced_pool(tougher, pool, figures=figures)
        left = [pool.best(pool.evaluation.normalised[0])]
    added = len(tougher.conditions) - len(request.conditions)
    if tested:
        progress(_message(runs, tried, added))
    else:
        progress("no gain set meets the hard goals, so no training runs are simulated")
    return Screened(tougher, pool.gains(left[0]), tuple(counterexamples))


def _message(runs: int, failed: int, added: int) -> str:
    if not failed:
        return f"None of the candidate gain sets failed in {runs:,} training runs."
    sets = "candidate gain set" + "s" * (failed != 1)
    failed_runs = "failed run" + "s" * (added != 1)
    return f"{failed} {sets} failed in {runs:,} training runs; {added} {failed_runs} join the tuning runs."


def reduced_pool(
    request: SearchRequest, pool: Pool, *others: Mapping[str, float], figures: Simulated | None = None
) -> Pool:
    """Return a smaller pool, simulated in the runs of a request: start gains, best sets, Pareto front, `others`."""
    start = pool.evaluation.normalised[0]
    best = pool.ranked(start)[:_SHORT]
    front = pool.front(start)
    spread = [front[int(k)] for k in np.unique(np.linspace(0, len(front) - 1, _SHORT).astype(int))] if front else []
    chosen = pool.subset(list(dict.fromkeys([0, *best, *spread]))).sets
    return request.judge({n: np.append(values, [o[n] for o in others]) for n, values in chosen.items()}, figures)


def _withstanding(
    request: SearchRequest, pool: Pool, met: NDArray[np.bool_], left: list[int], refuting: Sequence[Counterexample],
    figures: Simulated,
) -> list[int]:  # fmt: skip
    """Return the sets that still meet, in every refuting run, the goals that they met before the screening.

    Goals that bound a mean are left out, because one run cannot refute them.
    """
    if not left:
        return []
    place = {g.name: j for j, g in enumerate(request.goals)}
    goals = [replace(g, cases=()) for g in request.goals]  # every run here already belongs to its goal
    runs = [c.condition(request.cases) for c in refuting]
    conditions = merged(runs)
    column = {c.run: k for k, c in enumerate(conditions)}
    table = figures(goals, conditions, pool.subset(left).sets)
    withstands = np.ones(len(left), dtype=bool)
    for one, run in zip(refuting, runs, strict=True):
        goal = goals[place[one.goal]]
        if goal.over == "worst":
            fails = goal.normalised(goal.worst(table)[0][:, column[run.run]]) > 1
            withstands &= ~(fails & met[left, place[one.goal]])
    return [k for k, good in zip(left, withstands, strict=True) if good]
