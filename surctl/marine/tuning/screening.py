"""Screen the gain sets of a search by many training runs, because sets that pass a few runs often fail in others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from surctl.marine.tuning.claim_points import ClaimPoint
from surctl.marine.tuning.evaluation import figures, merged
from surctl.marine.tuning.montecarlo import APART, Counterexample, fresh, monte_carlo
from surctl.marine.tuning.pool import Pool, Request
from surctl.tuning.chunked import Progress

__all__ = ["TRAINING", "Screened", "harder", "reduced_pool", "screen"]

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

    request: Request
    gains: dict[str, float]
    counterexamples: tuple[Counterexample, ...]


def harder(request: Request, counterexamples: Sequence[Counterexample], claims: Sequence[ClaimPoint] = ()) -> Request:
    """Extend a request: refuting runs become conditions of the goals that they refute, claim points constraints."""
    requested = [c for c in request.conditions if c.goals is None]
    known = [c for c in request.conditions if c.goals is not None]
    refuting = merged((*known, *(c.condition(request.cases) for c in counterexamples)))
    return replace(request, conditions=(*requested, *refuting), claims=(*request.claims, *claims))


def screen(request: Request, pool: Pool, *, runs: int, progress: Progress = lambda _: None) -> Screened:
    """Simulate training runs with the best gain set and drop all sets that a failed run refutes, until a set passes.

    The training runs are identical for all gain sets and all rounds of a tuning; they differ from the fresh runs. A
    gain set is tested only on the goals that it meets over the runs of the search. The screening ends with a set that
    no training run refutes, or when no set remains.

    Args:
        request: the request of the search.
        pool: simulated gain sets of the search, the start gains first.
        runs: number of training runs.
        progress: function that receives one line of text at the end.
    """
    start = pool.evaluation.normalised[0]
    met = pool.evaluation.normalised <= 1
    left = [k for k in pool.ranked(start) if pool.feasible[k]]
    tested = bool(left)
    training = fresh(request.cases, runs=runs, first=_FIRST, tuning=request.seed)
    counterexamples: list[Counterexample] = []
    tried = 0
    while left:
        goals = [g for g, m in zip(request.goals, met[left[0]], strict=True) if m]
        gains = pool.gains(left[0])
        refuting = monte_carlo(goals, training, gains, each=_EACH, threads=request.threads).counterexamples
        if not refuting:
            break
        tried += 1
        counterexamples += refuting
        left = _withstanding(request, pool, met, left[1:], refuting)
    tougher = harder(request, counterexamples)
    if not left:
        pool = reduced_pool(tougher, pool)
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


def reduced_pool(request: Request, pool: Pool, *others: Mapping[str, float]) -> Pool:
    """Return a smaller pool, simulated in the runs of a request: start gains, best sets, Pareto front, `others`."""
    start = pool.evaluation.normalised[0]
    best = pool.ranked(start)[:_SHORT]
    front = pool.front(start)
    spread = [front[int(k)] for k in np.unique(np.linspace(0, len(front) - 1, _SHORT).astype(int))] if front else []
    chosen = pool.subset(list(dict.fromkeys([0, *best, *spread]))).sets
    return request.judge({n: np.append(values, [o[n] for o in others]) for n, values in chosen.items()})


def _withstanding(
    request: Request, pool: Pool, met: NDArray[np.bool_], left: list[int], refuting: Sequence[Counterexample]
) -> list[int]:
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
    table = figures(goals, conditions, pool.subset(left).sets, threads=request.threads)
    withstands = np.ones(len(left), dtype=bool)
    for one, run in zip(refuting, runs, strict=True):
        goal = goals[place[one.goal]]
        if goal.over == "worst":
            fails = goal.normalised(goal.worst(table)[0][:, column[run.run]]) > 1
            withstands &= ~(fails & met[left, place[one.goal]])
    return [k for k, good in zip(left, withstands, strict=True) if good]
