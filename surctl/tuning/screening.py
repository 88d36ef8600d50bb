"""The sets of a search against many training runs, best first: what a few runs let through, many do not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from surctl.tuning.claim_points import ClaimPoint
from surctl.tuning.evaluation import figures, merged
from surctl.tuning.montecarlo import APART, Counterexample, fresh, monte_carlo
from surctl.tuning.pool import Pool, Progress, Request

__all__ = ["TRAINING", "Screened", "harder", "reduced_pool", "screen"]

TRAINING = 10  # training runs for one that verifies: a set that none of 10 n refutes, n fresh ones seldom do
_FIRST = APART // 2  # of their seeds: beyond those of fresh runs
_EACH = 10  # of the runs that refute a set, kept for each goal and case
_SHORT = 64  # sets of a search that are looked at again over all runs, and as many of its front


@dataclass(frozen=True, eq=False)
class Screened:
    """What the training runs left of a search.

    Attributes:
        request: the request with each refuting run a condition of its goal.
        gains: the best set that is left; where none is, the one that misses least.
        counterexamples: the refuting runs.
    """

    request: Request
    gains: dict[str, float]
    counterexamples: tuple[Counterexample, ...]


def harder(request: Request, counterexamples: Sequence[Counterexample], claims: Sequence[ClaimPoint] = ()) -> Request:
    """The request with each refuting run a condition of its goals, and each refuting point one of its claim."""
    requested = [c for c in request.conditions if c.goals is None]
    known = [c for c in request.conditions if c.goals is not None]
    refuting = merged((*known, *(c.condition(request.cases) for c in counterexamples)))
    return replace(request, conditions=(*requested, *refuting), claims=(*request.claims, *claims))


def screen(request: Request, pool: Pool, *, runs: int, progress: Progress = lambda _: None) -> Screened:
    """Fly training runs with the best set; what refutes it is flown with the others, and the best that is left is next.

    The training runs are the same for every set and every round of a tuning, and no fresh ones. Only goals count that
    a set meets over the runs of the search. It ends with a set that no training run refutes, or with none left.

    Args:
        request: what was searched for.
        pool: what the search flew, the start gains first.
        runs: training runs.
        progress: told one line at the end.
    """
    start = pool.evaluation.normalised[0]
    met = pool.evaluation.normalised <= 1
    left = [k for k in pool.ranked(start) if pool.feasible[k]]
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
    progress(_message(runs, tried, added))
    return Screened(tougher, pool.gains(left[0]), tuple(counterexamples))


def _message(runs: int, failed: int, added: int) -> str:
    """What the training runs showed, in a sentence."""
    if not failed:
        return f"None of the candidate gain sets failed in {runs:,} training runs."
    sets = "candidate gain set" + "s" * (failed != 1)
    failed_runs = "failed run" + "s" * (added != 1)
    return f"{failed} {sets} failed in {runs:,} training runs; {added} {failed_runs} join the tuning runs."


def reduced_pool(request: Request, pool: Pool, *others: Mapping[str, float]) -> Pool:
    """The start gains, the best sets of a pool and its front, and others, over the runs of the request."""
    start = pool.evaluation.normalised[0]
    best = pool.ranked(start)[:_SHORT]
    front = pool.front(start)
    spread = [front[int(k)] for k in np.unique(np.linspace(0, len(front) - 1, _SHORT).astype(int))] if front else []
    chosen = pool.subset(list(dict.fromkeys([0, *best, *spread]))).sets
    return request.judge({n: np.append(values, [o[n] for o in others]) for n, values in chosen.items()})


def _withstanding(
    request: Request, pool: Pool, met: NDArray[np.bool_], left: list[int], refuting: Sequence[Counterexample]
) -> list[int]:
    """Those of the sets that no refuting run refutes in a goal which they met; a mean is not refuted by one run."""
    if not left:
        return []
    place = {g.name: j for j, g in enumerate(request.goals)}
    goals = [replace(g, cases=()) for g in request.goals]  # the runs are those of the goal already
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
