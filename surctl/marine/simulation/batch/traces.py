"""Signals of many runs over time, recorded from the compiled loop."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.marine.simulation.batch.case import Case, check_values
from surctl.marine.simulation.batch.engines import broadcast, compiled_loop
from surctl.marine.simulation.batch.loop import build_loop
from surctl.marine.simulation.batch.pack import pack, structure_of

__all__ = ["Trace", "trace_batch"]

Columns = NDArray[np.float64]
_TOGETHER = 64  # runs whose signals are in memory at once


@dataclass(frozen=True, eq=False)
class Trace:
    """Signals of one run at its n control steps.

    Attributes:
        plant: (n, …) state of the plant, see `plant_state`: first η (4,), then ν (4,).
        law: (n, nx) state of the law.
        tau: (n, 4) commanded thrust [N, N m].
    """

    plant: Columns
    law: Columns
    tau: Columns


def trace_batch(case: Case, values: Mapping[str, ArrayLike], *, seeds: ArrayLike = 0) -> Iterator[Trace]:
    """Simulate runs as `simulate_batch` does and yield the signals of each run, without its last control step.

    Args:
        case: the simulated setup (scenario, vehicle, law).
        values: parameter values by name: an array (n,) or one number for all runs.
        seeds: (n,) seeds, or one seed for all runs.

    Raises:
        InputError: as for `simulate_batch`.
        ToolMissing: there is no C compiler.
    """
    columns, run_seeds = broadcast(values, seeds)
    check_values(case, columns)
    loop = build_loop(structure_of(case, columns))
    compiled = compiled_loop(loop.structure)
    plant, law, tau = (loop.state.slice(name) for name in ("plant", "law", "last_thrust"))
    for first in range(0, len(run_seeds), _TOGETHER):
        some = slice(first, first + _TOGETHER)
        packed = pack(case, loop, {name: column[some] for name, column in columns.items()}, run_seeds[some])
        state, ended = packed.state, np.full(len(packed.state), packed.steps)
        plants, laws, taus = [], [], []
        for k in range(packed.steps):
            after = compiled.run(state, packed.parameters, steps=1)  # one thread: to start more takes longer
            plants.append(state[:, plant])
            laws.append(state[:, law])
            taus.append(after[:, tau])
            ended[(after[:, 0] != 0) & (state[:, 0] == 0)] = k
            if after[:, 0].all():
                break
            state = after
        signals = [np.stack(rows, axis=1) for rows in (plants, laws, taus)]
        for run, count in enumerate(ended):
            yield Trace(*(signal[run, :count] for signal in signals))
