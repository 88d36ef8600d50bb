"""Tuning by counterexamples: rounds of search and test, when they end, which round wins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, check_count, check_once
from surctl.tuning.chunked import Journal, Progress
from surctl.tuning.gain_search import conflict, search
from surctl.tuning.montecarlo import (
    APART,
    MOST_SEED,
    TRAINING,
    Counterexample,
    MonteCarlo,
    Screened,
    harder,
    monte_carlo,
    reduced_pool,
    screen,
    stored_figures,
)
from surctl.tuning.pool import ClaimPoint, Pool, SearchRequest, joined_pools


@dataclass(frozen=True)
class Round:
    """One round of a tuning: a search, training runs that screen its gain sets, and fresh runs that verify one set.

    Attributes:
        gains: the gains that the round chose, by name.
        score: score of the chosen gains; see `Pool.score`.
        feasible: whether the chosen gains meet every hard goal over the runs known at the end of the round.
        missed: names of the goals that the chosen gains miss over the runs known at the end of the round.
        training: training runs that refuted other gain sets, which ranked better in the search than the chosen gains.
        verified: result of the fresh runs; None if no fresh runs were made.
        claims: points at which a claim that should hold fails with the chosen gains.
        others: the gain sets that rank next after the chosen set over the known runs, best first; the next search also
            starts from these sets.
    """

    gains: Mapping[str, float]
    score: float
    feasible: bool
    missed: tuple[str, ...]
    training: tuple[Counterexample, ...]
    verified: MonteCarlo | None
    claims: tuple[ClaimPoint, ...]
    others: tuple[Mapping[str, float], ...]

    @property
    def refuted(self) -> tuple[str, ...]:
        """Names of the goals that fresh runs refute, and of the claims that fail."""
        goals = () if self.verified is None else self.verified.refuted
        return (*goals, *(p.name for p in self.claims))

    @property
    def fresh(self) -> tuple[Counterexample, ...]:
        """The fresh runs that refute a goal although the tuned gains meet this goal over the known runs."""
        counterexamples = () if self.verified is None else self.verified.counterexamples
        return tuple(c for c in counterexamples if c.goal not in self.missed)

    def to_dict(self) -> dict[str, Any]:
        """The round as plain data for JSON."""
        return {"monte_carlo" if name == "verified" else name: value for name, value in asdict(self).items()}


_WORTH = 0.01  # smallest relative improvement of the score for which tuning continues


@dataclass(frozen=True, eq=False)
class Tuning:
    """A finished tuning.

    A run refutes a gain set if the gain set misses a goal in this run. Fresh runs have seeds that no earlier run used.

    Attributes:
        request: the request of the last search, extended by the training runs that refuted gain sets of that search.
        requested: number of conditions in the original request; all further conditions are counterexamples.
        hand: pool that holds one gain set: the start gains, simulated under all conditions.
        tuned: pool of one gain set, the tuned gains, simulated under all conditions.
        front: Pareto front of the last round: the gain sets for which no other set has both a better score and less
            thrust.
        rounds: the rounds of the tuning, in order.
        chosen: index of the round that supplies the tuned gains: the best round over all runs known at the end. A round
            that is refuted or infeasible is chosen only if all rounds are.
        conflict: minimal set of demands for which no gain set was found that meets all of them; empty if the chosen
            round is feasible and not refuted.
    """

    request: SearchRequest
    requested: int
    hand: Pool
    tuned: Pool
    front: Pool
    rounds: tuple[Round, ...]
    chosen: int
    conflict: tuple[str, ...]

    @property
    def result(self) -> Round:
        """The round that supplies the tuned gains."""
        return self.rounds[self.chosen]

    @property
    def unmet(self) -> tuple[str, ...]:
        """Names of the hard goals and claims that the tuned gains miss, or that fresh runs refute."""
        shares = zip(self.request.goals, self.tuned.evaluation.normalised[0], strict=True)
        points = zip(self.request.claims, self.tuned.claims[0], strict=True)
        hard = {g.name for g in self.request.goals if g.kind == "hard"} | {p.name for p in self.result.claims}
        missed = [g.name for g, share in shares if g.name in hard and not share <= 1]
        missed += [p.name for p, over in points if not over <= 0]
        return tuple(dict.fromkeys([*missed, *(name for name in self.result.refuted if name in hard)]))

    @property
    def accepted(self) -> bool:
        """Whether the tuned gains meet every hard goal and every claim, and no fresh run refutes a hard goal."""
        return not self.unmet

    @property
    def better(self) -> tuple[bool, ...]:
        """One flag per goal: whether its normalised value is lower with the tuned gains than with the start gains."""
        less = self.tuned.evaluation.normalised[0] < self.hand.evaluation.normalised[0]
        return tuple(bool(b) for b in less)


def tune(
    request: SearchRequest,
    *,
    trials: int = 256,
    rounds: int = 3,
    runs: int = 2000,
    folder: Path | None = None,
    progress: Progress = lambda _: None,
) -> Tuning:
    """Tune gains; while counterexamples refute the result, add them to the tuning and tune again.

    Counterexamples are training runs, fresh runs and claims that refute the result. The tuning ends at the latest after
    `rounds` rounds.

    Args:
        request: goals, runs, start gains and search space.
        trials: number of trials of each search. If a round misses a hard goal but adds no counterexample, the search of
            this round continues once, for another `trials` trials.
        rounds: largest number of rounds, at least 1.
        runs: number of fresh runs that verify the gains of each round. Before them, ten times as many training runs
            screen the gain sets of the round. With 0, neither kind of run is simulated.
        folder: folder that stores all trials and test runs; an interrupted tuning with an identical request resumes
            from it.
        progress: function that receives one line of text at each step of the work.

    Raises:
        InputError: a number of trials, rounds or runs is too small or too large, two cases have the same name, a gain
            is out of bounds, the folder cannot be used, or `check_goals` finds an error.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import Goal, Request, build_cases, conditions, gain_ranges
        >>> from surctl.tuning import tune
        >>> gains = load_gains("default")
        >>> runs = conditions(build_cases([load_scenario("pool-behind")], gains=gains, law="closed_form"), seeds=[0])
        >>> request = Request((Goal("soon", "time_s", "s", 20.0),), runs, gains, gain_ranges(gains, ["k_v"]))
        >>> tuning = tune(request, trials=8, rounds=1, runs=0)
        >>> tuning.result.feasible, round(tuning.result.score, 2), tuning.result.gains["k_v"] > 1.5
        (True, 0.99, True)
    """
    _check(request, trials, rounds, runs)
    runs = runs if request.fresh(runs=1, first=0) else 0
    journal = Journal(folder)
    done: list[Round] = []
    current, requested = request, len(request.conditions)
    with journal.held():
        if journal.batches(request.digest, width=request.width).known(request.size) is None:
            # a file of best gains from the first moment on
            journal.note_best(*request.so_far({}, "the start gains of a tuning without a finished trial"))
        used = 1 + max(c.seed for c in request.conditions)
        for k in range(rounds):
            progress(f"round {k + 1} of at most {rounds}: {len(current.conditions)} runs for each gain set")
            longer = 2 if done and _barren(done[-1]) else 1  # the last round added no counterexample
            searched = _searched(current, done, longer * trials, journal, progress)
            last, pool = _round(current, searched, runs, k, journal, progress, used=used)
            journal.note_best(*request.so_far(last.gains, f"the gains of round {k + 1} of an unfinished tuning"))
            done.append(last)
            if _ended(done) or k + 1 == rounds:
                break
            if not _barren(last):
                current = harder(current, (*last.training, *last.fresh), last.claims)
        final = harder(current, last.training)
    hand = final.judge({name: np.array([value]) for name, value in request.begun.items()})
    candidates = final.judge({s.name: np.array([r.gains[s.name] for r in done]) for s in request.space})
    start = hand.evaluation.normalised[0]
    chosen = _chosen(done, candidates, start)
    last, clash = done[chosen], tuple[str, ...]()
    if last.refuted or not last.feasible:
        progress("searching for the demands that cannot be met together")
        clash = conflict(harder(final, last.fresh, last.claims), pool, last.refuted, trials=trials, progress=progress)
    front = pool.subset(pool.front(pool.evaluation.normalised[0]))
    return Tuning(final, requested, hand, candidates.subset([chosen]), front, tuple(done), chosen, clash)


def _chosen(done: Sequence[Round], candidates: Pool, start: NDArray[np.float64]) -> int:
    """Return the index of the best round, see `Tuning.chosen`.

    Every round is judged over all runs, because runs of a later round may refute the gains of an earlier round.
    """
    merit = candidates.merit(start)
    sound = [k for k, one in enumerate(done) if candidates.feasible[k] and not one.refuted]
    return min(sound or range(len(done)), key=lambda k: float(merit[k]))


def _check(request: SearchRequest, trials: int, rounds: int, runs: int) -> None:
    # a counterexample identifies its case by name
    check_once((c.name for c in request.cases), "occurs twice", key="case", remedy="give each vehicle its own name")
    request.check()
    if request.seed > MOST_SEED:
        raise InputError(
            "leaves no seeds for fresh runs", key="--seed", value=request.seed, remedy=f"write at most {MOST_SEED}"
        )
    for key, value, least in (("--trials", trials, 1), ("--rounds", rounds, 1), ("--monte-carlo", runs, 0)):
        check_count(key, value, least=least)
    most = APART // 2 // (1 + max(rounds, TRAINING))
    if runs > most:
        raise InputError(
            "needs more seeds than are available", key="--monte-carlo", value=runs, remedy=f"write at most {most}"
        )


def _ended(done: Sequence[Round]) -> bool:
    # the last round added no counterexample, or it improved the score by less than 1 %
    last = done[-1]
    if _barren(last):
        return last.feasible or (len(done) > 1 and _barren(done[-2]))
    before = [r.score for r in done[:-1] if r.feasible and not r.refuted]
    return last.feasible and not last.refuted and last.score > (1 - _WORTH) * min(before, default=np.inf)


def _barren(one: Round) -> bool:
    # the round adds no counterexample to the request of the next round
    return not (one.training or one.claims or (one.fresh and one.feasible))


def _searched(request: SearchRequest, done: Sequence[Round], trials: int, journal: Journal, progress: Progress) -> Pool:
    """Search once and, if no gain set meets all hard goals, search again for the hard goals alone.

    The search of the first round starts from `first_sets` of the request, that of a later round from the best sets of
    the previous round.
    """
    first: Sequence[Mapping[str, float]] = [done[-1].gains, *done[-1].others] if done else []
    if not done:
        first = request.first_sets(progress)
    pool = search(request, trials=trials, first=first, journal=journal, progress=progress)
    hard = tuple(g for g in request.goals if g.kind == "hard")
    if pool.feasible.any() or len(hard) in (0, len(request.goals)):
        return pool
    progress("no gain set meets all hard goals; searching for the hard goals alone")
    names = {g.name for g in hard}
    conditions = tuple(c for c in request.conditions if c.goals is None or names & set(c.goals))
    alone = replace(request, goals=hard, conditions=conditions)
    first, most = _leading(pool, 1 + request.others), 1 + request.others
    leading = _leading(search(alone, trials=trials, first=first, journal=journal, progress=progress), most)
    return joined_pools(
        [pool, request.judge({s.name: np.array([gains[s.name] for gains in leading]) for s in request.space})]
    )


def _leading(pool: Pool, most: int) -> list[dict[str, float]]:
    # as many sets as a round passes to the next round
    return [pool.gains(k) for k in pool.ranked(pool.evaluation.normalised[0])[:most]]


def _round(
    request: SearchRequest, pool: Pool, runs: int, number: int, journal: Journal, progress: Progress, *, used: int
) -> tuple[Round, Pool]:
    """Complete a round after its search; return the round and a pool of its best gain sets, the chosen set last.

    The best gain sets are the best over all known runs.
    """
    left, verified = Screened(request, pool.gains(pool.best(pool.evaluation.normalised[0])), ()), None
    figures = stored_figures(request, journal, progress)
    if runs:
        progress(f"testing the best gain sets with {TRAINING * runs} training runs and {runs} fresh ones")
        left = screen(request, pool, runs=TRAINING * runs, figures=figures, progress=progress)
        conditions = request.fresh(runs=runs, first=used + number * runs)
        verified = monte_carlo(figures, request.goals, conditions, left.gains)
        word = ", ".join(verified.refuted) or "nothing"
        progress(f"{runs} fresh runs, seeds {verified.seeds[0]} to {verified.seeds[1]}, refute {word}")
    points = request.refuted_claims(left.gains)
    known = reduced_pool(left.request, pool, left.gains, figures=figures)
    start, own = known.evaluation.normalised[0], len(known.claims) - 1
    missed = tuple(g.name for g, n in zip(request.goals, known.evaluation.normalised[own], strict=True) if not n <= 1)
    others = [k for k in known.ranked(start) if k != own][: request.others]
    score, feasible = float(known.score(start)[own]), bool(known.feasible[own])
    progress(f"over {len(left.request.conditions)} runs: {known.subset([own]).standing(start)}")
    further = tuple(known.gains(k) for k in others)
    return Round(left.gains, score, feasible, missed, left.counterexamples, verified, points, further), known
