"""Simulate many runs in compiled C, or in CasADi's machine without a compiler; the C text of a loop in the cache."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError, SurctlError, check_known
from surctl.ir import Batch, to_casadi, without_libm
from surctl.ir.batch import batch_source, compile_batch_source
from surctl.ir.cache import cached_bytes, source_digest
from surctl.ir.folding import fused
from surctl.marine.control.build import LAW_SOURCES
from surctl.marine.simulation.batch.case import Case, check_values
from surctl.marine.simulation.batch.counting import metrics_table
from surctl.marine.simulation.batch.loop import build_loop
from surctl.marine.simulation.batch.pack import pack, structure_of
from surctl.marine.simulation.batch.structure import Structure
from surctl.marine.simulation.metrics import METRICS
from surctl.own_code import is_own
from surctl.system.runs import Engine, final_states

_FURTHER = (
    *(f"surctl.{name}" for name in ("files", "own_code", "units")),
    *(f"surctl.marine.{name}" for name in ("allocation", "simulation", "world")),
)
"""Packages besides `LAW_SOURCES` whose source code determines the programs of a closed loop."""


def loop_sources() -> str:
    """Return a digest of the source code that determines the programs of a closed loop; raises as `source_digest`."""
    return source_digest(*LAW_SOURCES) + source_digest(*_FURTHER)


class StoredLoop(NamedTuple):
    """Digest of the step of a closed loop for many runs, and the C text that `compile_batch_source` compiles."""

    digest: str
    source: str


@cache
def stored_loop(structure: Structure) -> StoredLoop:
    """Return the digest and the C text of a loop, from the cache on disk if a process with this source code stored it.

    A loop with a law of the user's own is built again in every process, because the modules that its file imports may
    have changed. So is a loop with thrusters, whose numbers have no exact text.
    """
    if is_own(structure.law) or structure.actuators is not None:
        return _built(structure)
    try:
        sources = loop_sources()
    except SurctlError:  # the source code is missing or changed since the import, so it cannot identify a cached loop
        return _built(structure)
    key = hashlib.sha256(f"{sources}\0{structure!r}".encode()).hexdigest()
    stored = cached_bytes(key, ".loop", lambda: "\n".join(_built(structure)).encode())
    return StoredLoop(*stored.decode().split("\n", 1))


def _built(structure: Structure) -> StoredLoop:
    step = build_loop(structure).step
    return StoredLoop(step.digest(), batch_source(fused(without_libm(step))))


Columns = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BatchResult:
    """Metrics of n runs: `table` (n, len(METRICS)), and the engine that simulated them, `c` or `vm`."""

    table: Columns = field(repr=False)
    engine: Engine

    @property
    def runs(self) -> int:
        """Number of runs n."""
        return len(self.table)

    def column(self, name: str) -> Columns:
        """Return the values (n,) of one metric; if the name is unknown, InputError suggests the most similar name."""
        check_known(name, METRICS, "no such metric", key="metric")
        return self.table[:, list(METRICS).index(name)]


def simulate_batch(
    case: Case,
    values: Mapping[str, ArrayLike] | None = None,
    *,
    seeds: ArrayLike = 0,
    threads: int = 1,
    engine: Engine = "auto",
) -> BatchResult:
    """Simulate one run for each set of parameter values with its seed; a single value or seed holds for all runs.

    The result of a run depends only on its own parameter values and seed, not on `threads` or the other runs. The
    metrics equal those of `simulate` with the same setup and seed, except for the last digits. A run that starts inside
    an obstacle counts as a collision at its start.

    Args:
        values: parameter values by name, see `parameters`: an array (n,) or one number for all runs.
        engine: `c`, `vm` or `auto`, see `surctl.system.runs.final_states`.

    Raises:
        InputError: a parameter or the engine is unknown, a value is out of bounds, a seed is negative, or the shapes
            do not match.
        ToolMissing: the engine is `c`, but there is no compiler.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import Case, load_scenario, simulate_batch
        >>> from surctl.marine.vehicle import load_vehicle
        >>> case = Case(load_scenario("pool-behind"), load_vehicle("sur400"), load_gains("default"), law="closed_form")
        >>> runs = simulate_batch(case, {"k_v": [1.0, 1.5, 2.0]}, seeds=7, engine="vm")
        >>> runs.column("time_s").round(2).tolist(), runs.column("min_clearance_m").round(3).tolist()
        ([21.3, 20.35, 20.05], [0.093, 0.096, 0.097])
    """
    columns, run_seeds = broadcast(values or {}, seeds)
    check_values(case, columns)
    loop = build_loop(structure_of(case, columns))
    if len(run_seeds) == 0:
        return BatchResult(np.empty((0, len(METRICS))), "c" if engine == "c" else "vm")
    packed = pack(case, loop, columns, run_seeds)
    final, used = final_states(
        packed.state, packed.parameters, steps=packed.steps, compiled=lambda: compiled_loop(loop.structure),
        machine=lambda: _machine(loop.structure), engine=engine, threads=threads,
    )  # fmt: skip
    return BatchResult(metrics_table(loop.law, loop.state, final), used)


@cache
def compiled_loop(structure: Structure) -> Batch:
    """Return the compiled loop of a loop structure, compiled now or from the cache of compiled loops.

    Raises:
        ToolMissing: there is no C compiler.
    """
    return compile_batch_source(stored_loop(structure).source)


@cache
def _machine(structure: Structure) -> Any:
    return to_casadi(build_loop(structure).step)


def broadcast(values: Mapping[str, ArrayLike], seeds: ArrayLike) -> tuple[dict[str, Columns], NDArray[np.int64]]:
    """Return values and seeds as arrays (n,) for n runs; raise InputError if they do not match."""
    try:
        arrays = {name: np.asarray(value, dtype=float) for name, value in values.items()}
    except (TypeError, ValueError):
        raise InputError("must be numbers", key="values", value=sorted(values)) from None
    seed = np.asarray(seeds)
    whole = seed.dtype.kind in "iu" or (seed.dtype.kind == "f" and bool(np.all(seed == np.floor(seed))))
    if not whole or np.any(seed < 0):
        raise InputError("must be whole numbers, at least 0", key="seeds", value=seed.ravel()[:3].tolist())
    try:
        shape = np.broadcast_shapes(seed.shape, *(v.shape for v in arrays.values()))
    except ValueError:
        shape = (0, 0)
    if len(shape) > 1:
        sizes = {name: v.shape for name, v in arrays.items()}
        raise InputError("do not match", key="values, seeds", value=sizes, remedy="give arrays (n,) or numbers")
    n = shape[0] if shape else 1
    spread = {name: np.broadcast_to(v, (n,)) for name, v in arrays.items()}
    return spread, np.broadcast_to(seed, (n,)).astype(np.int64)


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


def trace_batch(case: Case, values: Mapping[str, ArrayLike]) -> Iterator[Trace]:
    """Simulate runs as `simulate_batch` does and yield the signals of each run, without its last control step.

    Raises:
        InputError, ToolMissing: as for `simulate_batch`.
    """
    columns, run_seeds = broadcast(values, 0)
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
