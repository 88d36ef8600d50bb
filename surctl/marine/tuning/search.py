"""One search for gains: optuna's NSGA-II with batches of compiled runs, then a descent from the best gain sets.

The search minimises two objectives: the score and the mean thrust. As in MATLAB's systune, the score is the largest
normalised value of a soft goal. If the start gains meet a goal, its normalised value is first divided by the value with
the start gains. Two objectives can be plotted; with one objective per goal, nearly every trial would be Pareto-optimal.
Hard goals and claims are constraints.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from surctl.marine.control import write_gains
from surctl.marine.tuning.descent import descend
from surctl.marine.tuning.evaluation import row
from surctl.marine.tuning.pool import Pool, Request, joined_pools
from surctl.marine.tuning.trials import distributions, objectives, remembered, user_attributes
from surctl.tuning.chunked import Progress
from surctl.tuning.journal import Journal, quiet_optuna

if TYPE_CHECKING:
    from optuna import Study
    from optuna.trial import FrozenTrial, Trial

__all__ = ["BATCH", "search"]

BATCH = 32  # trials that are simulated together: the population of NSGA-II


def search(
    request: Request,
    *,
    trials: int,
    first: Sequence[Mapping[str, float]] = (),
    journal: Journal | None = None,
    progress: Progress = lambda _: None,
) -> Pool:
    """Search for gains and return all simulated gain sets; the start gains come first.

    Args:
        request: the request of the search.
        trials: number of trials of NSGA-II, rounded up to whole batches; the descent adds about as many trials.
        first: gain sets to try right after the start gains, for example the best sets of an earlier search.
        journal: journal of the trials; an interrupted search with an identical request resumes from this journal and
            ends with the result of an uninterrupted search.
        progress: function that receives one line of text for each batch.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import Goal, Request, build_cases, conditions, gain_ranges, search
        >>> gains = load_gains("default")
        >>> runs = conditions(build_cases([load_scenario("pool-behind")], gains=gains, law="closed_form"), seeds=[0])
        >>> request = Request((Goal("soon", "time_s", "s", 20.0),), runs, gains, gain_ranges(gains, ["k_v"]))
        >>> pool = search(request, trials=32)
        >>> pool.gains(0), pool.evaluation.normalised[0].round(2).tolist()  # the start gains
        ({'k_v': 1.5}, [1.02])
        >>> pool.evaluation.normalised.min().round(2).item()  # at most 1: the goal is met
        0.99
    """
    shelf, name = journal or Journal(None), request.digest
    done = shelf.trials(name)
    batches = -(-trials // BATCH)
    pools = [remembered(request, done[k : k + BATCH]) for k in range(0, len(done) // BATCH * BATCH, BATCH)][:batches]
    known = list(done[: len(pools) * BATCH])
    start = pools[0].evaluation.normalised[0] if pools else request.judge(_start(request)).evaluation.normalised[0]
    clock = _Clock(batches, len(pools), progress)
    for k in range(len(pools), batches):
        memory = _study(known)  # a new study, so that the samples depend only on the finished trials
        proposed = _propose(memory, request, k, [row(_start(request), 0), *first] if k == 0 else [])
        sets = {s.name: np.array([t.params[s.name] for t in proposed]) for s in request.space}
        pool = request.judge(sets)
        finished = _finish(memory, proposed, pool, start)
        # after an interruption the journal may hold the first trials of this batch; they are identical
        shelf.append(name, finished[max(0, len(done) - k * BATCH) :])
        known += finished
        pools.append(pool)
        whole = joined_pools(pools)
        best = request.base.with_values(whole.gains(whole.best(start)), how="so-far")
        shelf.note_best(write_gains(best, warning="the best gains of an unfinished tuning"))
        clock.report(k + 1, whole, start)
    whole = joined_pools(pools)
    return descend(request, whole, trials=trials, shelf=shelf, progress=progress)


class _Clock:
    def __init__(self, batches: int, done: int, progress: Progress) -> None:
        self.batches, self.done, self.progress, self.began = batches, done, progress, time.perf_counter()
        if done:
            progress(f"{done * BATCH} trials of the same request are resumed")

    def report(self, k: int, pool: Pool, start: NDArray[np.float64]) -> None:
        rate = (k - self.done) * BATCH / (time.perf_counter() - self.began)
        left = (self.batches - k) * BATCH / rate
        speed = f"{rate:.3g} trials/s, ETA {left:.0f} s"
        self.progress(f"trial {k * BATCH}/{self.batches * BATCH}, {speed}: {pool.standing(start)}")


def _start(request: Request) -> dict[str, NDArray[np.float64]]:
    return {s.name: np.array([s.clip(request.base[s.name])]) for s in request.space}


def _study(trials: Sequence[FrozenTrial]) -> Study:
    # in memory, because a study on the disk needs ten disk accesses per trial
    optuna = quiet_optuna()
    study = optuna.create_study(directions=["minimize", "minimize"])
    study.add_trials(trials)
    sampler = optuna.samplers.NSGAIISampler(population_size=BATCH)
    for generation in range(1, len(trials) // BATCH):  # choose the parents of each generation again, in order
        sampler.get_parent_population(study, generation)
    return study


def _propose(study: Study, request: Request, batch: int, first: Sequence[Mapping[str, float]]) -> list[Trial]:
    # every trial has its own seed, so that a resumed search repeats the proposals
    optuna = quiet_optuna()
    space = distributions(request)
    for gains in first[:BATCH]:
        study.enqueue_trial({s.name: s.clip(gains[s.name]) for s in request.space})
    proposed = []
    for k in range(batch * BATCH, (batch + 1) * BATCH):
        seed = int(np.random.SeedSequence([request.seed, k]).generate_state(1)[0])
        study.sampler = optuna.samplers.NSGAIISampler(population_size=BATCH, seed=seed)
        proposed.append(study.ask(space))
    return proposed


def _finish(study: Study, proposed: Sequence[Trial], pool: Pool, start: NDArray[np.float64]) -> list[FrozenTrial]:
    constraints, reached, finished = pool.constraints, objectives(pool, start), []
    for k, trial in enumerate(proposed):
        for name, value in user_attributes(pool, k).items():
            trial.set_user_attr(name, value)
        for j, value in enumerate(constraints[k]):
            trial.set_constraint(f"{j}", float(value))
        finished.append(study.tell(trial, reached[k]))
    return finished
