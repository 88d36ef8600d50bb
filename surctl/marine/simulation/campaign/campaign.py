"""Simulate many random runs with the compiled loop, chunk by chunk."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import inf

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.simulation.batch import simulate_batch
from surctl.marine.simulation.campaign.assumptions import assumptions
from surctl.marine.simulation.campaign.plan import Plan, SampledRun
from surctl.marine.simulation.campaign.replay import Replay, replay_of
from surctl.marine.simulation.campaign.summary import Summary, summarise
from surctl.marine.simulation.campaign.table import RunTable
from surctl.marine.simulation.metrics import METRICS
from surctl.marine.simulation.store import ChunkStore

__all__ = ["CHUNK", "FASTEST", "Campaign", "run_campaign"]

CHUNK = 128
"""Number of runs that are simulated and stored together."""

FASTEST = 0.15
"""Largest obstacle speed [m/s] for which a collision counts against the law (*chosen*)."""


@dataclass(frozen=True, eq=False)
class Campaign:
    """A finished campaign: its plan of runs, the table of results, and the summary."""

    plan: Plan
    table: RunTable
    summary: Summary

    def worst(self, count: int) -> list[Replay]:
        """Return the worst runs, the worst first, in a form that can be saved to files, see `RunTable.worst`."""
        return [
            replay_of(self.plan.run(k), self.table.row(k), campaign=self.plan.name) for k in self.table.worst(count)
        ]


def run_campaign(
    plan: Plan,
    *,
    runs: int,
    threads: int = 1,
    chunk: int = CHUNK,
    store: ChunkStore | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Campaign:
    """Simulate the first `runs` runs of a plan.

    The result does not depend on the number of threads, the chunk size, or the chunks that the store already holds.

    Args:
        plan: the plan of the runs.
        runs: number of runs, at least 1.
        threads: number of threads of the compiled loop.
        chunk: number of runs that are simulated together.
        store: open store with chunks of this size; the campaign reads finished chunks from it and writes new chunks to
            it.
        progress: function that receives one line of text after each chunk.

    Raises:
        InputError: the number of runs is 0, a drawn number is out of its bounds, or a chunk of runs cannot be written.
    """
    for key, value in (("runs", runs), ("chunk", chunk)):
        if value < 1:
            raise InputError("must be at least 1", key=key, value=value)
    parts, start, simulated = [], time.monotonic(), 0
    for index, (first, count) in enumerate(_cut(runs, chunk)):
        shape = (count, 1 + len(METRICS) + len(plan.names))
        if store is not None and store.has(index, shape):
            parts.append(np.column_stack([store.column(index, shape, k) for k in range(shape[1])]))
        else:
            parts.append(_simulate_chunk(plan, first, count, threads))
            simulated += count
            if store is not None:
                store.write(index, parts[-1])
        rate = simulated / max(time.monotonic() - start, 1e-9)
        progress(
            f"{plan.name}: {first + count}/{runs} runs"
            + (f", {rate:.3g} per second" if simulated else ", from the store")
        )
    table = _table(plan, np.vstack(parts))
    return Campaign(plan, table, summarise(table))


def _cut(runs: int, chunk: int) -> Iterator[tuple[int, int]]:
    return ((first, min(chunk, runs - first)) for first in range(0, runs, chunk))


def _simulate_chunk(plan: Plan, first: int, count: int, threads: int) -> NDArray[np.float64]:
    # one line per run: seed, metrics, drawn values
    seeds, values = plan.seeds(first, count), plan.values(first, count)
    batch = simulate_batch(plan.case, values, seeds=seeds, threads=threads)
    return np.column_stack([seeds, batch.table, *(values[name] for name in plan.names)])


def _table(plan: Plan, whole: NDArray[np.float64]) -> RunTable:
    wide = 1 + len(METRICS)
    figures = whole[:, 1:wide]
    broken = tuple(_broken(plan.run(k)) for k in range(len(whole)))
    values = {name: whole[:, wide + k] for k, name in enumerate(plan.names)}
    return RunTable(whole[:, 0].astype(np.int64), figures, values, broken)


def _broken(run: SampledRun) -> tuple[str, ...]:
    # with true positions the detection range is infinite
    case = run.case
    sees = case.scenario.sensors.equipment.array.maximum if case.sensing == "sonar" else inf
    return assumptions(case, run.draw, detection=sees, fastest=FASTEST)
