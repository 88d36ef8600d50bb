"""One search for gains: differential evolution, then a descent; and the goals that cannot be met together.

The search minimises the score. As in MATLAB's systune, the score is the largest normalised value of a soft goal. If the
start gains meet a goal, its normalised value is first divided by the value with the start gains. An unmet hard goal or
claim adds a penalty (`Pool.merit`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from surctl.tuning.chunked import Journal, Progress
from surctl.tuning.goals import RunGoal
from surctl.tuning.pool import (
    CAP,
    Condition,
    Figures,
    Pool,
    SearchRange,
    SearchRequest,
    joined_pools,
    merged,
    scope,
)

Array = NDArray[np.float64]

_FIRST = 0.1  # first step as a share of each range's width on its scale
_LAST = 1e-3  # the descent from a start ends when its step is shorter
_SHORTER = 0.1  # factor on the step if no proposal is better
_STEP_FACTORS = (2.0, 1.0, 0.5, 0.25, 0.1, 0.04)  # factors on the step; each gives one proposal
_DIFFERENCE = 0.01  # largest step of a finite difference
_APART = 0.15  # least distance of a start from other starts and from their ends
_SLACK = 10.0  # weight of the largest missed constraint relative to the score


@dataclass(eq=False)
class _At:
    # a point (d,) in the unit cube
    place: Array
    merit: float
    step: float = _FIRST


def descend(
    request: SearchRequest, pool: Pool, *, trials: int, journal: Journal, progress: Progress = lambda _: None
) -> Pool:
    """Run a descent from the best sets of the pool; return the pool with all gain sets that the descent simulates.

    Args:
        request: the request of the search.
        pool: simulated gain sets, the start gains first.
        trials: approximate number of trials; each iteration takes 2 d + 6 trials for d gains.
        journal: journal of the iterations; an interrupted descent with an identical request and pool resumes from it.
        progress: function that receives one line of text at the end.
    """
    start, size = pool.evaluation.normalised[0], 2 * len(request.space) + len(_STEP_FACTORS)
    batches = journal.batches(f"{request.digest} descent {trials}", width=request.width)
    pools, visited = [pool], list[Array]()
    at = _next(request, pool, visited, start)
    for _ in range(-(-trials // size)):
        if at is None:
            break
        known = batches.known(size)
        batch = _iteration(request, pool, at) if known is None else request.pool(known)
        batches.add(batch.table, restored=known is not None)
        pools.append(batch)
        _move(request, at, batch, start)
        if at.step < _LAST:
            visited.append(at.place)
            at = _next(request, pool, visited, start)
    whole = joined_pools(pools)
    progress(f"descended in {sum(p.evaluation.effort.size for p in pools[1:])} trials: {whole.standing(start)}")
    return whole


def _next(request: SearchRequest, pool: Pool, visited: list[Array], start: Array) -> _At | None:
    """Return the best gain set of the pool that is far from all earlier starts and ends of the descent.

    The function adds this gain set to `visited`.
    """
    merit = pool.merit(start)
    places = np.column_stack([s.unit(pool.sets[s.name]) for s in request.space])
    for k in np.argsort(merit, kind="stable"):
        if all(np.abs(places[k] - other).max() > _APART for other in visited):
            visited.append(places[k])
            return _At(places[k].copy(), float(merit[k]))
    return None


def _iteration(request: SearchRequest, pool: Pool, at: _At) -> Pool:
    """Simulate the neighbours of `at` for the linearisation, then the proposed gain sets; return all as one pool."""
    # neighbours (2 d, d): one step up and one step down in each direction, within the cube
    d, far = len(at.place), min(_DIFFERENCE, at.step / 2)
    both = np.repeat(np.eye(d), 2, axis=0) * np.tile([far, -far], d)[:, None]
    beside = np.clip(at.place + both, 0.0, 1.0)
    near, table = request.simulate(_sets(request, np.vstack([beside, at.place])))
    objective, constraint = _functions(request, near, table, pool.evaluation.normalised[0])
    width = (beside[0::2] - beside[1::2]).sum(axis=1)

    def slope(values: Array) -> Array:
        gradient: Array = (values[0:-1:2] - values[1:-1:2]).T / width
        return gradient

    lines = (objective[-1], slope(objective)), (constraint[-1], slope(constraint))
    proposed = np.array([_least(at.place, *lines, factor * at.step) for factor in _STEP_FACTORS])
    return joined_pools([near.subset(range(len(beside))), request.judge(_sets(request, proposed))])


def _sets(request: SearchRequest, places: Array) -> dict[str, Array]:
    return {s.name: s.place(places[:, k]) for k, s in enumerate(request.space)}


def _functions(request: SearchRequest, pool: Pool, table: Figures, start: Array) -> tuple[Array, Array]:
    # soft goals (n, f), scaled as in the score; hard goals and claims (n, g), at most 0 if met
    soft, hard = [np.zeros((len(pool.claims), 1))], [np.minimum(pool.claims, CAP)]
    for goal, first in zip(request.goals, start, strict=True):
        own = scope(goal, request.conditions)
        if goal.over == "mean":
            figure = goal.worst(table)[0][:, own].mean(axis=1, keepdims=True)
        else:  # one column per speed: the worst over speeds has no slope where the worst speed changes
            figure = np.hstack([table[name][:, own] for name in goal.columns])
        if goal.kind == "soft":
            soft.append(np.minimum(goal.normalised(figure), CAP) / np.clip(first, 1e-3, 1.0))
        else:
            # the metric has a slope even where the normalised value has none: at a clearance of 0 and below
            over = (figure - goal.limit) / abs(goal.limit) * (1.0 if goal.sense == "at most" else -1.0)
            hard.append(np.clip(np.where(np.isnan(over), CAP, over), -CAP, CAP))
    return np.hstack(soft), np.hstack(hard)


def _least(place: Array, objective: tuple[Array, Array], constraint: tuple[Array, Array], far: float) -> Array:
    """Return the point within the distance `far` of `place` that minimises the linearised maximum.

    `objective` and `constraint` are pairs of values and slopes.
    """
    from scipy.optimize import linprog

    d = len(place)
    (f, df), (g, dg) = objective, constraint
    # unknowns: the move, the largest objective, the largest missed constraint
    rows = np.block(
        [[df, -np.ones((len(f), 1)), np.zeros((len(f), 1))], [dg, np.zeros((len(g), 1)), -np.ones((len(g), 1))]]
    )
    ends = [(max(-far, -x), min(far, 1.0 - x)) for x in place]
    cost = [*[0.0] * d, 1.0, _SLACK]
    result = linprog(cost, A_ub=rows, b_ub=-np.concatenate([f, g]), bounds=[*ends, (None, None), (0.0, None)])
    move = result.x[:d] if result.status == 0 else np.zeros(d)
    there: Array = np.clip(place + move, 0.0, 1.0)
    return there


def _move(request: SearchRequest, at: _At, batch: Pool, start: Array) -> None:
    """Move to the best simulated set and adapt the step length; shorten the step if no set improves the merit."""
    merit = batch.merit(start)
    best = int(merit.argmin())
    if not merit[best] < at.merit:
        at.step *= _SHORTER
        return
    at.place = np.array([float(s.unit(batch.sets[s.name][best])) for s in request.space])
    at.merit = float(merit[best])
    proposal = best - (len(merit) - len(_STEP_FACTORS))
    if proposal >= 0:
        at.step = min(at.step * _STEP_FACTORS[proposal], 1.0)


def search(
    request: SearchRequest,
    *,
    trials: int,
    first: Sequence[Mapping[str, float]] = (),
    journal: Journal | None = None,
    progress: Progress = lambda _: None,
) -> Pool:
    """Search for gains and return all simulated gain sets; the start gains come first.

    Args:
        request: the request of the search.
        trials: number of gain sets of the evolution, rounded up to whole batches; the descent adds about as many.
        first: gain sets to try right after the start gains, for example the best sets of an earlier search.
        journal: journal of the finished batches; an interrupted search with an identical request resumes from it and
            ends with the result of an uninterrupted search.
        progress: function that receives one line of text for each batch.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import Goal, Request, build_cases, conditions, gain_ranges
        >>> from surctl.tuning import search
        >>> gains = load_gains("default")
        >>> runs = conditions(build_cases([load_scenario("pool-behind")], gains=gains, law="closed_form"), seeds=[0])
        >>> request = Request((Goal("soon", "time_s", "s", 20.0),), runs, gains, gain_ranges(gains, ["k_v"]))
        >>> pool = search(request, trials=32)
        >>> pool.gains(0), pool.evaluation.normalised[0].round(2).tolist()  # the start gains
        ({'k_v': 1.5}, [1.02])
        >>> pool.evaluation.normalised.min().round(2).item()  # at most 1: the goal is met
        0.99
    """
    journal = journal or Journal(None)
    batches = journal.batches(request.digest, width=request.width)
    size = request.size
    count, done = -(-trials // size), 0
    while done < count and batches.known(size, after=done) is not None:
        done += 1
    if done:
        progress(f"{done * size} trials of the same request are resumed")
    pools, began, shown = list[Pool](), time.perf_counter(), -np.inf

    def merit(sets: Array) -> Array:
        nonlocal shown
        table = batches.evaluated(sets, lambda sets: request.judge(request.named(sets)).table[:, sets.shape[1] :])
        pools.append(request.pool(table))
        start = pools[0].evaluation.normalised[0]
        if len(pools) > done and (len(pools) == count or time.perf_counter() - shown > _PAUSE):
            shown = time.perf_counter()
            whole = joined_pools(pools)
            journal.note_best(*request.so_far(whole.gains(whole.best(start)), "the best gains of an unfinished tuning"))
            rate = (len(pools) - done) * size / (time.perf_counter() - began)
            speed = f"{rate:.3g} trials/s, ETA {(count - len(pools)) * size / rate:.0f} s"
            progress(f"trial {len(pools) * size}/{count * size}, {speed}: {whole.standing(start)}")
        return pools[-1].merit(start)

    begun = [[s.clip(gains[s.name]) for s in request.space] for gains in ({**request.start}, *first)]
    _evolve(merit, request.space, size=size, batches=count, seed=request.seed, first=begun)
    if not request.descends:
        return joined_pools(pools)
    return descend(request, joined_pools(pools), trials=trials, journal=journal, progress=progress)


def _evolve(
    value: Callable[[Array], Array],
    ranges: Sequence[SearchRange],
    *,
    size: int,
    batches: int,
    seed: int,
    first: Sequence[Sequence[float]] = (),
) -> None:
    """Minimise a function of sets of numbers by scipy's differential evolution, whose generations are the batches.

    The proposals of a batch depend on the seed and on the values of the batches before, but not on their number.

    Args:
        value: function from sets (n, numbers) to values (n,); smaller is better.
        ranges: the numbers.
        size: about the number of sets in a batch, at least 5.
        batches: number of batches.
        seed: seed of the proposals.
        first: sets with which the first batch begins; the others of this batch fill the ranges evenly.
    """
    from scipy.optimize import differential_evolution

    count = len(ranges)
    begun = [list(one) for one in first[:size]]
    start: Array | str = "latinhypercube"
    if begun:
        from scipy.stats import qmc  # takes half a second to import

        own = np.column_stack([r.unit(column) for r, column in zip(ranges, np.array(begun).T, strict=True)])
        start = np.vstack([own, qmc.LatinHypercube(count, rng=seed).random(size - len(begun))])

    def of(points: Array) -> Array:
        nonlocal begun
        sets = np.column_stack([r.place(share) for r, share in zip(ranges, points, strict=True)])
        sets[: len(begun)] = begun or sets[:0]  # exactly, not by way of its share of the range
        begun = []
        return value(sets)

    differential_evolution(
        of, [(0.0, 1.0)] * count, init=start, popsize=max(1, round(size / count)), maxiter=max(0, batches - 1),
        seed=seed, polish=False, vectorized=True, updating="deferred", tol=0,
    )  # fmt: skip


_PAUSE = 0.2  # s between two lines of progress
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
    goal: RunGoal
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


def demands(goals: Sequence[RunGoal], conditions: Sequence[Condition], refuted: Sequence[str]) -> tuple[Demand, ...]:
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


def _demand(goal: RunGoal, conditions: Sequence[Condition], k: int, label: str) -> Demand:
    own = f"demand {k}"
    return Demand(
        label, replace(goal, name=own, kind="hard", cases=()), tuple(replace(c, goals=(own,)) for c in conditions)
    )


def conflict(
    request: SearchRequest, pool: Pool, refuted: Sequence[str], *, trials: int, progress: Progress = lambda _: None
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
        nearest = int(known.evaluation.excess[:, list(subset)].sum(axis=1).argmin())
        result = search(part, trials=trials, first=[known.gains(nearest)])
        best = result.best(result.evaluation.normalised[0])
        known = joined_pools([known, whole.judge(result.subset([best]).sets)])
        met = bool(result.feasible[best])
        progress(f"{len(subset)} of {len(every)} demands together: {'met' if met else 'not met'}")
        return met

    everything = tuple(range(len(every)))
    return () if together(everything) else tuple(every[k].label for k in minimal_subset(len(every), together))


def _of(request: SearchRequest, chosen: Sequence[Demand]) -> SearchRequest:
    # each run is simulated once
    return replace(
        request, goals=tuple(d.goal for d in chosen), conditions=merged(c for d in chosen for c in d.conditions)
    )
