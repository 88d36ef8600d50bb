"""One search for gains: differential evolution by batches of compiled runs, then a descent from the best gain sets.

The search minimises the score. As in MATLAB's systune, the score is the largest normalised value of a soft goal. If the
start gains meet a goal, its normalised value is first divided by the value with the start gains. An unmet hard goal or
claim adds a penalty (`Pool.merit`).
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

from surctl.marine.control import write_gains
from surctl.marine.tuning.descent import descend
from surctl.marine.tuning.pool import Pool, Request, joined_pools
from surctl.tuning.chunked import Progress
from surctl.tuning.search import Array, Journal, evolve

__all__ = ["BATCH", "BEST", "search"]

BATCH = 32  # gain sets that are simulated together: the population of the differential evolution

BEST = "best-so-far.toml"
"""Name of the gain file that an unfinished tuning leaves in its folder."""


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
        trials: number of gain sets of the evolution, rounded up to whole batches; the descent adds about as many.
        first: gain sets to try right after the start gains, for example the best sets of an earlier search.
        journal: journal of the finished batches; an interrupted search with an identical request resumes from it and
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
    journal = journal or Journal(None)
    batches = journal.batches(request.digest, width=request.width)
    count = -(-trials // BATCH)
    done = 0
    while done < count and batches.known(BATCH, after=done) is not None:
        done += 1
    if done:
        progress(f"{done * BATCH} trials of the same request are resumed")
    pools, began = list[Pool](), time.perf_counter()

    def merit(sets: Array) -> Array:
        table = batches.evaluated(sets, lambda sets: request.judge(request.named(sets)).table[:, sets.shape[1] :])
        pools.append(request.pool(table))
        start = pools[0].evaluation.normalised[0]
        if len(pools) > done:
            whole = joined_pools(pools)
            best = request.base.with_values(whole.gains(whole.best(start)), how="so-far")
            journal.note_best(BEST, write_gains(best, warning="the best gains of an unfinished tuning"))
            rate = (len(pools) - done) * BATCH / (time.perf_counter() - began)
            speed = f"{rate:.3g} trials/s, ETA {(count - len(pools)) * BATCH / rate:.0f} s"
            progress(f"trial {len(pools) * BATCH}/{count * BATCH}, {speed}: {whole.standing(start)}")
        return pools[-1].merit(start)

    begun = [[s.clip(gains[s.name]) for s in request.space] for gains in ({**request.base.values}, *first)]
    evolve(merit, request.space, size=BATCH, batches=count, seed=request.seed, first=begun)
    return descend(request, joined_pools(pools), trials=trials, journal=journal, progress=progress)
