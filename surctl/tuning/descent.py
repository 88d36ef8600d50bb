"""Descent to the least score from the best gain sets: a minimax problem, by sequential linear programming.

Score and constraints are largest values over goals and runs (Madsen 1975; Conn, Gould and Toint 2000 for the trust
region): each is linearised for itself by differences in the unit cube of the ranges, and a linear program moves towards
the least largest value within some distances. What it proposes is flown; the best so far is where it goes on. The
figures of a run jump where the law switches: there the steps get shorter, until the next start is tried.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surctl.tuning.evaluation import Figures, scope
from surctl.tuning.journal import Journal
from surctl.tuning.pool import CAP, Pool, Progress, Request, joined
from surctl.tuning.trials import frozen, remembered

__all__ = ["descend"]

Array = NDArray[np.float64]

_FIRST = 0.1  # first step, of the width of each range on its log scale
_LAST = 1e-3  # a start is left where its step gets shorter
_SHORTER = 0.1  # factor on the step where no proposal is better
_STEP_FACTORS = (2.0, 1.0, 0.5, 0.25, 0.1, 0.04)  # of the step: a proposal each
_DIFFERENCE = 0.01  # most distance of a difference
_APART = 0.15  # least distance between two starts, or from where one ended
_SLACK = 10.0  # weight of the largest constraint that is missed, against the score


@dataclass(eq=False)
class _At:
    """Where a descent stands: place (d,) in the unit cube, its merit, and the step."""

    place: Array
    merit: float
    step: float = _FIRST


def descend(request: Request, pool: Pool, *, trials: int, shelf: Journal, progress: Progress = lambda _: None) -> Pool:
    """The pool and what is flown on the way down from its best sets.

    Args:
        request: what is searched for.
        pool: what was flown, the start gains first.
        trials: about as many are flown; whole iterations of 2 d + 6 for d gains.
        shelf: keeps the trials; a descent of the same request and pool resumes from it.
        progress: told one line at the end.
    """
    start, size = pool.evaluation.normalised[0], 2 * len(request.space) + len(_STEP_FACTORS)
    name = f"{request.digest} descent {trials}"
    done, pools, visited = shelf.trials(name), [pool], list[Array]()
    at = _next(request, pool, visited, start)
    for k in range(-(-trials // size)):
        if at is None:
            break
        known = done[k * size : (k + 1) * size]
        if len(known) == size:
            batch = remembered(request, known)
        else:
            batch = _iteration(request, pool, at)
            # a kill may have left a part of this iteration behind: it is the same part
            shelf.append(name, frozen(request, batch, start)[len(known) :])
        pools.append(batch)
        _move(request, at, batch, start)
        if at.step < _LAST:
            visited.append(at.place)
            at = _next(request, pool, visited, start)
    whole = joined(pools)
    score = whole.score(start)[whole.best(start)]
    progress(f"descended in {sum(p.evaluation.effort.size for p in pools[1:])} trials, best score {score:.4f}")
    return whole


def _next(request: Request, pool: Pool, visited: list[Array], start: Array) -> _At | None:
    """The best set of the pool that is apart from every start and end so far; from now on it is one of them."""
    merit = pool.merit(start)
    places = np.column_stack([s.unit(pool.sets[s.name]) for s in request.space])
    for k in np.argsort(merit, kind="stable"):
        if all(np.abs(places[k] - other).max() > _APART for other in visited):
            visited.append(places[k])
            return _At(places[k].copy(), float(merit[k]))
    return None


def _iteration(request: Request, pool: Pool, at: _At) -> Pool:
    """The neighbours by which the figures are linearised, and the proposals."""
    beside = _beside(at)
    near, table = request.simulate(_sets(request, np.vstack([beside, at.place])))
    objective, constraint = _functions(request, near, table, pool.evaluation.normalised[0])
    width = (beside[0::2] - beside[1::2]).sum(axis=1)

    def slope(values: Array) -> Array:
        gradient: Array = (values[0:-1:2] - values[1:-1:2]).T / width
        return gradient

    lines = (objective[-1], slope(objective)), (constraint[-1], slope(constraint))
    proposed = np.array([_least(at.place, *lines, factor * at.step) for factor in _STEP_FACTORS])
    return joined([near.subset(range(len(beside))), request.judge(_sets(request, proposed))])


def _beside(at: _At) -> Array:
    """(2 d, d): one step up and one down in each direction, within the cube."""
    d, far = len(at.place), min(_DIFFERENCE, at.step / 2)
    both = np.repeat(np.eye(d), 2, axis=0) * np.tile([far, -far], d)[:, None]
    places: Array = np.clip(at.place + both, 0.0, 1.0)
    return places


def _sets(request: Request, places: Array) -> dict[str, Array]:
    return {s.name: s.place(places[:, k]) for k, s in enumerate(request.space)}


def _functions(request: Request, pool: Pool, table: Figures, start: Array) -> tuple[Array, Array]:
    """(n, f) soft goals as they count in the score, (n, g) hard goals and claims, at most 0 where met; a run each."""
    soft, hard = [np.zeros((len(pool.claims), 1))], [np.minimum(pool.claims, CAP)]
    for goal, first in zip(request.goals, start, strict=True):
        own = scope(goal, request.conditions)
        if goal.over == "mean":
            figure = goal.worst(table)[0][:, own].mean(axis=1, keepdims=True)
        else:  # each speed for itself: their worst has no slope where it changes from one to the other
            figure = np.hstack([table[name][:, own] for name in goal.columns])
        if goal.kind == "soft":
            soft.append(np.minimum(goal.normalised(figure), CAP) / np.clip(first, 1e-3, 1.0))
        else:
            # by the figure, which has a slope where the normalised value has none: at a clearance of 0 and below
            over = (figure - goal.limit) / abs(goal.limit) * (1.0 if goal.sense == "at most" else -1.0)
            hard.append(np.clip(np.where(np.isnan(over), CAP, over), -CAP, CAP))
    return np.hstack(soft), np.hstack(hard)


def _least(place: Array, objective: tuple[Array, Array], constraint: tuple[Array, Array], far: float) -> Array:
    """The place within `far` of this one where the largest of the linearised functions is least; (values, slopes)."""
    from scipy.optimize import linprog

    d = len(place)
    (f, df), (g, dg) = objective, constraint
    # unknowns: the move, the largest objective, the largest constraint that is missed
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
    """To the best of what was flown if it is better; the step becomes that of the proposal, or shorter."""
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
