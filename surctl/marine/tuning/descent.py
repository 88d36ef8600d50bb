"""Descent from the best gain sets towards the least score, a minimax problem, by sequential linear programming.

The score and the constraints are maxima over goals and runs (Madsen 1975; Conn, Gould and Toint 2000 for the trust
region). Every function that enters one of these maxima is linearised by finite differences, in gains scaled to the unit
cube. A linear program then minimises the maximum of the linearised functions within several trust-region radii. The
proposed gain sets are simulated, and the descent continues from the best set so far. The metrics of a run jump where
the law switches; there the steps become shorter and shorter, and the descent then continues from another gain set.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surctl.marine.tuning.evaluation import Figures, scope
from surctl.marine.tuning.pool import CAP, Pool, Request, joined_pools
from surctl.tuning.chunked import Progress
from surctl.tuning.search import Journal

__all__ = ["descend"]

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
    request: Request, pool: Pool, *, trials: int, journal: Journal, progress: Progress = lambda _: None
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


def _next(request: Request, pool: Pool, visited: list[Array], start: Array) -> _At | None:
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


def _iteration(request: Request, pool: Pool, at: _At) -> Pool:
    """Simulate the neighbours of `at` for the linearisation, then the proposed gain sets; return all as one pool."""
    beside = _beside(at)
    near, table = request.simulate(_sets(request, np.vstack([beside, at.place])))
    objective, constraint = _functions(request, near, table, pool.evaluation.normalised[0])
    width = (beside[0::2] - beside[1::2]).sum(axis=1)

    def slope(values: Array) -> Array:
        gradient: Array = (values[0:-1:2] - values[1:-1:2]).T / width
        return gradient

    lines = (objective[-1], slope(objective)), (constraint[-1], slope(constraint))
    proposed = np.array([_least(at.place, *lines, factor * at.step) for factor in _STEP_FACTORS])
    return joined_pools([near.subset(range(len(beside))), request.judge(_sets(request, proposed))])


def _beside(at: _At) -> Array:
    # neighbours (2 d, d): one step up and one step down in each direction, within the cube
    d, far = len(at.place), min(_DIFFERENCE, at.step / 2)
    both = np.repeat(np.eye(d), 2, axis=0) * np.tile([far, -far], d)[:, None]
    places: Array = np.clip(at.place + both, 0.0, 1.0)
    return places


def _sets(request: Request, places: Array) -> dict[str, Array]:
    return {s.name: s.place(places[:, k]) for k, s in enumerate(request.space)}


def _functions(request: Request, pool: Pool, table: Figures, start: Array) -> tuple[Array, Array]:
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


def _move(request: Request, at: _At, batch: Pool, start: Array) -> None:
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
