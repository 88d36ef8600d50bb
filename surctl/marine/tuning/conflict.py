"""Find a minimal subset of demands that no gain set meets together, from known gain sets and further searches."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from surctl.marine.tuning.evaluation import Condition, merged
from surctl.marine.tuning.goals import Goal
from surctl.marine.tuning.pool import Pool, Request, joined_pools
from surctl.marine.tuning.search import search
from surctl.tuning.chunked import Progress

__all__ = ["Demand", "conflict", "demands", "minimal_subset"]

_KNOWN_SETS = 64  # gain sets of the pool that are tried before a search


@dataclass(frozen=True)
class Demand:
    """A demand on the gains: one goal that they must meet in some runs.

    Attributes:
        label: name of the demand, as `find_conflict` returns it.
        goal: the goal as a hard goal, with a name that only this demand uses.
        conditions: the runs in which the goal must be met.
    """

    label: str
    goal: Goal
    conditions: tuple[Condition, ...]


def minimal_subset(count: int, together: Callable[[tuple[int, ...]], bool]) -> tuple[int, ...]:
    """Return a minimal subset of the demands 0 … count - 1 that cannot be met together.

    Every proper subset of this subset can be met together.

    QuickXplain (Junker 2004) calls `together` at most 2 k (1 + log₂(n / k)) times for n demands and a subset of size k.

    Args:
        count: number of demands; all of them cannot be met together.
        together: function that returns whether the demands of a subset can be met together.
    """

    def explained(beside: tuple[int, ...], added: bool, candidates: tuple[int, ...]) -> tuple[int, ...]:
        """Return the candidates that belong to the minimal subset if the demands `beside` belong to it.

        `added` is true if `beside` has grown since the last call.
        """
        if added and not together(tuple(sorted(beside))):
            return ()
        if len(candidates) == 1:
            return candidates
        first, second = candidates[: len(candidates) // 2], candidates[len(candidates) // 2 :]
        later = explained((*beside, *first), True, second)
        return (*explained((*beside, *later), bool(later), first), *later)

    return tuple(sorted(explained((), False, tuple(range(count)))))


def demands(goals: Sequence[Goal], conditions: Sequence[Condition], refuted: Sequence[str]) -> tuple[Demand, ...]:
    """Return demands for hard goals and refuted soft goals.

    Demands over requested runs and demands over counterexamples are separate.
    """
    requested = [c for c in conditions if c.goals is None]
    result: list[Demand] = []
    for goal in goals:
        if goal.kind == "hard" or goal.name in refuted:
            own = [c for c in requested if not goal.cases or {c.case.name, c.case.scenario.name} & set(goal.cases)]
            result.append(_demand(goal, own, len(result), goal.name))
    refuting: dict[tuple[str, str], list[Condition]] = {}
    for condition in conditions:
        for name in condition.goals or ():
            refuting.setdefault((name, condition.case.name), []).append(condition)
    named = {goal.name: goal for goal in goals}
    for (name, case), own in refuting.items():
        where = own[0].label if len(own) == 1 else f"{len(own)} runs of {case} that refuted other gains"
        result.append(_demand(named[name], own, len(result), f"{name} in {where}"))
    return tuple(result)


def _demand(goal: Goal, conditions: Sequence[Condition], k: int, label: str) -> Demand:
    own = f"demand {k}"
    return Demand(
        label, replace(goal, name=own, kind="hard", cases=()), tuple(replace(c, goals=(own,)) for c in conditions)
    )


def conflict(
    request: Request, pool: Pool, refuted: Sequence[str], *, trials: int, progress: Progress = lambda _: None
) -> tuple[str, ...]:
    """Return the labels of a minimal set of demands that no known gain set meets together.

    The result rests on searches and is not a proof. The result is empty if some gain set meets all demands.

    Args:
        request: the request, with all runs and claim points that refuted a gain set.
        pool: gain sets to try first.
        refuted: names of the refuted goals; the soft goals among them become demands too.
        trials: number of trials of the search for each subset of demands.
        progress: function that receives one line of text for each search.
    """
    every = demands(request.goals, request.conditions, refuted)
    if not every:
        return ()
    whole = _of(request, every)
    near = pool.ranked(pool.evaluation.normalised[0])[:_KNOWN_SETS]
    known = whole.judge(pool.subset(near).sets)

    def together(subset: tuple[int, ...]) -> bool:
        nonlocal known
        held = (known.claims <= 0).all(axis=1) & (known.evaluation.normalised[:, list(subset)] <= 1).all(axis=1)
        if held.any():
            return True
        part = _of(request, [every[k] for k in subset])
        result = search(part, trials=trials, first=[known.gains(_nearest(known, subset))])
        best = result.best(result.evaluation.normalised[0])
        known = joined_pools([known, whole.judge(result.subset([best]).sets)])
        met = bool(result.feasible[best])
        progress(f"{len(subset)} of {len(every)} demands together: {'met' if met else 'not met'}")
        return met

    everything = tuple(range(len(every)))
    return () if together(everything) else tuple(every[k].label for k in minimal_subset(len(every), together))


def _of(request: Request, chosen: Sequence[Demand]) -> Request:
    # each run is simulated once
    return replace(
        request, goals=tuple(d.goal for d in chosen), conditions=merged(c for d in chosen for c in d.conditions)
    )


def _nearest(known: Pool, subset: Sequence[int]) -> int:
    return int(known.evaluation.excess[:, list(subset)].sum(axis=1).argmin())
