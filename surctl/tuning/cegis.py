"""Tuning by counterexamples: tune, look for runs that refute a goal, make them part of the goal, tune again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.tuning.claim_points import ClaimPoint, refuted_claims
from surctl.tuning.conflict import conflict
from surctl.tuning.evaluation import check_goals
from surctl.tuning.journal import Journal
from surctl.tuning.montecarlo import APART, MOST_SEED, fresh, monte_carlo
from surctl.tuning.pool import Pool, Progress, Request, joined
from surctl.tuning.rounds import Record, Round
from surctl.tuning.screening import TRAINING, Screened, harder, reduced_pool, screen
from surctl.tuning.search import BATCH, search
from surctl.tuning.start import starting_sets

__all__ = ["Tuning", "tune"]

_WORTH = 0.01  # share of the score that makes another round worth while
_OTHERS = 8  # sets that a round hands to the next beside its best


@dataclass(frozen=True, eq=False)
class Tuning:
    """A finished tuning.

    Attributes:
        request: what the last search was asked for, with all counterexamples.
        requested: number of the conditions that were asked for: the rest are counterexamples.
        hand: one set: the start gains, over all conditions.
        tuned: one set: the tuned gains, over the same.
        front: undominated sets in score and thrust, of the last round.
        rounds: what happened.
        chosen: index of the round whose gains are the tuned ones: of the rounds that nothing refutes, or of all where
            each is refuted, the best over all runs that are known in the end.
        conflict: demands that were not met together; empty when the chosen round is not refuted.
    """

    request: Request
    requested: int
    hand: Pool
    tuned: Pool
    front: Pool
    rounds: tuple[Round, ...]
    chosen: int
    conflict: tuple[str, ...]

    @property
    def result(self) -> Round:
        """The chosen round."""
        return self.rounds[self.chosen]

    @property
    def unmet(self) -> tuple[str, ...]:
        """Names of the hard goals and claims that the tuned gains miss, or that fresh runs refute."""
        shares = zip(self.request.goals, self.tuned.evaluation.normalised[0], strict=True)
        points = zip(self.request.claims, self.tuned.claims[0], strict=True)
        hard = {g.name for g in self.request.goals if g.kind == "hard"} | {p.name for p in self.result.claims}
        found = [g.name for g, share in shares if g.name in hard and not share <= 1]
        found += [p.name for p, over in points if not over <= 0]
        return tuple(dict.fromkeys([*found, *(name for name in self.result.refuted if name in hard)]))

    @property
    def accepted(self) -> bool:
        """Whether the tuned gains meet every hard goal, and neither fresh runs nor a claim refute one."""
        return not self.unmet

    @property
    def better(self) -> tuple[bool, ...]:
        """For each goal, whether the tuned gains do better than the start gains."""
        less = self.tuned.evaluation.normalised[0] < self.hand.evaluation.normalised[0]
        return tuple(bool(b) for b in less)


def tune(
    request: Request,
    *,
    trials: int = 256,
    rounds: int = 3,
    runs: int = 2000,
    descend: bool = False,
    folder: Path | None = None,
    progress: Progress = lambda _: None,
) -> Tuning:
    """Tune, and while training runs, fresh runs or claims refute a goal, tune again with the runs that do.

    Args:
        request: goals, runs, start gains and search space.
        trials: of each search; one that finds nothing that meets the hard goals goes on for as many more, once.
        rounds: most rounds; at least 1.
        runs: fresh runs that verify each round, and a tenth of the training runs that sift its sets; 0 for neither.
        descend: let the first search start from a descent along exact gradients as well (`starting_sets`).
        folder: keeps trials and rounds: a killed tuning of the same request resumes there.
        progress: told one line at a time what is going on.

    Raises:
        InputError: nonsensical numbers, one case twice, a value out of bounds, a folder that cannot be used, or as
            `check_goals`.

    Example:
        >>> from surctl.control import load_gains
        >>> from surctl.simulation import load_scenario
        >>> from surctl.tuning import Goal, Request, build_cases, conditions, gain_ranges, tune
        >>> gains = load_gains("default")
        >>> runs = conditions(build_cases([load_scenario("pool-behind")], gains=gains, law="closed_form"), seeds=[0])
        >>> request = Request((Goal("soon", "time_s", "s", 20.0),), runs, gains, gain_ranges(gains, ["k_v"]))
        >>> tuning = tune(request, trials=32, rounds=1, runs=0)
        >>> tuning.result.feasible, round(tuning.result.score, 2), tuning.result.gains["k_v"] > 1.5
        (True, 0.99, True)
    """
    _check(request, trials, rounds, runs)
    request = replace(request, begun="descent" if descend else "")  # its trials are not those of one without
    record = Record(folder, f"{request.digest} {trials} {runs}")
    journal = Journal(None if folder is None else folder / "trials.journal")
    done: list[Round] = []
    current, requested = request, len(request.conditions)
    try:
        for k in range(rounds):
            known = record.round(k)
            progress(f"round {k + 1} of at most {rounds}: {len(current.conditions)} runs a gain set")
            pool = None
            if known is None:
                pool = _searched(current, done, _longer(trials, done), journal, progress, descend=descend)
                known, pool = _round(current, pool, runs, k, progress, used=1 + max(c.seed for c in request.conditions))
                record.add(known)
            done.append(known)
            if _ended(done) or k + 1 == rounds:
                break
            if not _barren(known):
                current = harder(current, (*known.training, *known.fresh), known.claims)
        final = harder(current, done[-1].training)
        if pool is None:  # every round was known already
            pool = _searched(current, done[:-1], _longer(trials, done[:-1]), journal, progress, descend=descend)
            pool = reduced_pool(final, pool, done[-1].gains)
    finally:
        journal.close()
    hand, candidates = (
        final.judge({s.name: np.array([request.base[s.name]]) for s in request.space}),
        _candidates(final, done),
    )
    start = hand.evaluation.normalised[0]
    chosen = _chosen(done, candidates, start)
    last, clash = done[chosen], tuple[str, ...]()
    if last.refuted or not last.feasible:
        progress("looking for the demands that do not hold together")
        clash = conflict(harder(final, last.fresh, last.claims), pool, last.refuted, trials=trials, progress=progress)
    front = pool.subset(pool.front(pool.evaluation.normalised[0]))
    return Tuning(final, requested, hand, candidates.subset([chosen]), front, tuple(done), chosen, clash)


def _candidates(request: Request, done: Sequence[Round]) -> Pool:
    """What each round found, over all runs."""
    return request.judge({s.name: np.array([r.gains[s.name] for r in done]) for s in request.space})


def _chosen(done: Sequence[Round], candidates: Pool, start: NDArray[np.float64]) -> int:
    """See `Tuning.chosen`; a later round's runs may refute an earlier round's gains."""
    merit = candidates.merit(start)
    sound = [k for k, one in enumerate(done) if candidates.feasible[k] and not one.refuted]
    return min(sound or range(len(done)), key=lambda k: float(merit[k]))


def _check(request: Request, trials: int, rounds: int, runs: int) -> None:
    names = [case.name for case in request.cases]
    for name in names:
        if names.count(name) > 1:  # a counterexample knows its case by name
            raise InputError("is flown twice", key="case", value=name, remedy="give each vehicle a name of its own")
    check_goals(request.goals, request.conditions)
    if request.seed > MOST_SEED:
        raise InputError(
            "leaves no seeds for fresh runs", key="--seed", value=request.seed, remedy=f"at most {MOST_SEED}"
        )
    for key, value, least in (("--trials", trials, 1), ("--rounds", rounds, 1), ("--monte-carlo", runs, 0)):
        if value < least:
            raise InputError(f"must be at least {least}", key=key, value=value, remedy="correct it")
    most = APART // 2 // (1 + max(rounds, TRAINING))
    if runs > most:
        raise InputError(
            "asks for more seeds than there are", key="--monte-carlo", value=runs, remedy=f"at most {most}"
        )


def _ended(done: Sequence[Round]) -> bool:
    """Whether another round could not do better: nothing new was learnt, or it gains next to nothing any more."""
    last = done[-1]
    if _barren(last):
        return last.feasible or (len(done) > 1 and _barren(done[-2]))
    before = [r.score for r in done[:-1] if r.feasible and not r.refuted]
    return last.feasible and not last.refuted and last.score > (1 - _WORTH) * min(before, default=np.inf)


def _barren(one: Round) -> bool:
    """Whether the next round asks for nothing that this one did not."""
    return not (one.training or one.claims or (one.fresh and one.feasible))


def _longer(trials: int, done: Sequence[Round]) -> int:
    """Trials of the next search: twice as many of the same one where it found nothing that meets the hard goals."""
    return 2 * trials if done and _barren(done[-1]) else trials


def _searched(
    request: Request, done: Sequence[Round], trials: int, journal: Journal, progress: Progress, *, descend: bool
) -> Pool:
    """One search, and where it meets not all hard goals one for these alone.

    It begins where the last round ended, the first one with `starting_sets`.
    """
    first: Sequence[Mapping[str, float]] = [done[-1].gains, *done[-1].others] if done else []
    if not done and len(journal.trials(request.digest)) < BATCH:
        first = starting_sets(request, descend=descend, progress=progress)
    pool = search(request, trials=trials, first=first, journal=journal, progress=progress)
    hard = tuple(g for g in request.goals if g.kind == "hard")
    if pool.feasible.any() or len(hard) in (0, len(request.goals)):
        return pool
    progress("no gain set meets all hard goals: they alone are searched for")
    names = {g.name for g in hard}
    conditions = tuple(c for c in request.conditions if c.goals is None or names & set(c.goals))
    alone = replace(request, goals=hard, conditions=conditions)
    leading = _leading(search(alone, trials=trials, first=_leading(pool), journal=journal, progress=progress))
    return joined(
        [pool, request.judge({s.name: np.array([gains[s.name] for gains in leading]) for s in request.space})]
    )


def _leading(pool: Pool) -> list[dict[str, float]]:
    """The best sets of a pool, as many as a round hands to the next."""
    return [pool.gains(k) for k in pool.ranked(pool.evaluation.normalised[0])[: 1 + _OTHERS]]


def _round(
    request: Request, pool: Pool, runs: int, number: int, progress: Progress, *, used: int
) -> tuple[Round, Pool]:
    """The round that a search ends, and its best sets over the runs known then, the chosen one last."""
    left, verified = Screened(request, pool.gains(pool.best(pool.evaluation.normalised[0])), ()), None
    if runs:
        left = screen(request, pool, runs=TRAINING * runs, progress=progress)
        conditions = fresh(request.cases, runs=runs, first=used + number * runs, tuning=request.seed)
        verified = monte_carlo(request.goals, conditions, left.gains, threads=request.threads)
        word = ", ".join(verified.refuted) or "nothing"
        progress(f"{runs} fresh runs, seeds {verified.seeds[0]} to {verified.seeds[1]}, refute {word}")
    failing = refuted_claims({**request.base.values, **left.gains}, seed=request.seed)
    points = tuple(
        ClaimPoint(v.claim.name, dict(v.counterexample.values), v.threshold) for v in failing if v.counterexample
    )
    known = reduced_pool(left.request, pool, left.gains)
    start, own = known.evaluation.normalised[0], len(known.claims) - 1
    missed = tuple(g.name for g, n in zip(request.goals, known.evaluation.normalised[own], strict=True) if not n <= 1)
    others = [k for k in known.ranked(start) if k != own][:_OTHERS]
    score, feasible = float(known.score(start)[own]), bool(known.feasible[own])
    progress(
        f"score {score:.4f}{'' if feasible else ', not all hard goals met'} over {len(left.request.conditions)} runs"
    )
    further = tuple(known.gains(k) for k in others)
    return Round(left.gains, score, feasible, missed, left.counterexamples, verified, points, further), known
