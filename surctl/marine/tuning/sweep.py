"""Parameter sweeps: closed-loop and linear metrics at many points, computed in chunks, so that a sweep can resume."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from surctl.marine.simulation import Case
from surctl.marine.simulation.store import ChunkStore, cannot_write
from surctl.marine.tuning.measure import (
    CASE_COLUMNS,
    LINEAR_COLUMNS,
    RUN_COLUMNS,
    Evaluation,
    Quantity,
    check_request,
    linear_names,
    request_digest,
)
from surctl.marine.tuning.netcdf import Column, provenance, request_of, write_netcdf
from surctl.marine.tuning.table import SweepTable, judged, load_sweep
from surctl.tuning.design import Design
from surctl.tuning.executors import Chunk, Evaluator, Executor, LocalExecutor

__all__ = ["TABLE", "Progress", "run_chunks", "sweep"]

Floats = NDArray[np.float64]
Progress = Callable[[str], None]

TABLE = "sweep.nc"
_MOST_CHUNKS = 64  # chunks of a small sweep, so that an interruption loses little and every worker has work
_MOST_RUNS = 4096  # runs in one chunk
_MOST_LINEAR = 64  # points in one chunk of linear metrics
_LEAST_LINEAR = 16  # as long as there are so many: together they take little longer than one


def sweep(
    cases: Sequence[Case],
    design: Design,
    *,
    seeds: Sequence[int] = (0,),
    linear: bool = True,
    cruise: Sequence[float] = (),
    executor: Executor | None = None,
    out: Path | None = None,
    progress: Progress = lambda _: None,
) -> SweepTable:
    """Simulate every case at every point of a design, and compute metrics of the linearised loops at these points.

    Args:
        cases: one or more simulation cases; all of them must have equal gains.
        design: the points of the sweep; see `grid`, `spread`, `saltelli`, `make_design`.
        seeds: seeds with which every case is simulated at every point; a case that does not depend on the seed is
            simulated once per point.
        linear: whether to compute the linear metrics too; they are computed once for each combination of the parameters
            on which they depend.
        cruise: cruise speeds [m/s] of the linear metrics; every metric is the worst over these speeds, and the column
            `disk_margin_at_m_per_s` is the speed with the least disk margin. By default, the linear metrics of a
            vehicle are computed at its largest cruise speed.
        executor: executor of the chunks; by default the calling process. The results do not depend on the executor.
        out: folder of `sweep.nc`; None stores no file. Until the file is complete, finished chunks are stored beside
            it; an identical request resumes from these chunks. A finished `sweep.nc` of another request is renamed, and
            `progress` reports this.
        progress: function that receives one line of text at each step of the work.

    Raises:
        InputError: `check_request` finds an error, the folder cannot be written, or the disk is full. Finished chunks
            remain.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import build_cases, sweep
        >>> from surctl.tuning import grid, parse_axis
        >>> cases = build_cases([load_scenario("pool-behind")], gains=load_gains("default"), law="closed_form")
        >>> table = sweep(cases, grid([parse_axis("k_v=1,2"), parse_axis("lookahead=0.4,0.8,1.2")]))
        >>> table.shape, table.column("disk_margin").round(2).tolist()
        ((2, 3), [[0.76, 0.76, 0.76], [0.72, 0.74, 0.74]])
        >>> table.column("time_s").round(1).tolist()
        [[21.4, 21.4, 21.6], [20.0, 20.2, 20.4]]
    """
    cases, seeds = tuple(cases), tuple(int(s) for s in seeds)
    check_request(cases, design, seeds, cruise)
    job = _Job(Evaluation(cases, design.names, seeds, cruise=tuple(cruise)), design, linear)
    if out is not None:
        return _stored_sweep(job, out, executor or LocalExecutor(), progress)
    with tempfile.TemporaryDirectory(prefix="surctl-sweep-") as folder:
        table = _stored_sweep(job, Path(folder), executor or LocalExecutor(), progress)
        loaded = table.dataset.load()
        table.dataset.close()
        loaded.encoding.pop("source", None)
        return SweepTable(loaded)


def run_chunks(
    function: Evaluator,
    chunks: Sequence[Chunk],
    *,
    store: ChunkStore,
    executor: Executor,
    finished: Callable[[int], None] = lambda _: None,
) -> None:
    """Evaluate chunks, and store each result as soon as it is available.

    Args:
        function: the evaluator of a chunk.
        chunks: chunks that the store does not contain yet.
        store: open store of finished chunks.
        executor: executor of the chunks.
        finished: function that receives the index of each chunk once the chunk is stored.

    Raises:
        InputError: a chunk cannot be written.
    """
    with closing(executor.map_chunks(function, chunks)) as results:  # after an error here the workers stop too
        for index, table in results:
            store.write(index, table)
            finished(index)


@dataclass
class _Job:
    # first the chunks of linear metrics, then the chunks of simulated runs
    evaluation: Evaluation
    design: Design
    linear: bool
    chunks: list[Chunk] = field(init=False)
    linear_count: int = field(init=False, default=0)
    inverse: NDArray[np.int64] = field(init=False)
    request: str = field(init=False)

    def __post_init__(self) -> None:
        points, names = self.design.points, self.design.names
        self.chunks, together = [], 0
        if self.linear:
            matter = [k for k, name in enumerate(names) if name in linear_names(names)]
            different, inverse = np.unique(points[:, matter], axis=0, return_inverse=True)
            self.inverse = inverse.reshape(-1)
            whole = np.tile(points[:1], (len(different), 1))  # the values of the other axes do not matter
            whole[:, matter] = different
            together = max(_LEAST_LINEAR, _size(len(different), _MOST_LINEAR))
            self.chunks += _cut(whole, together, first=0)
            self.linear_count = len(self.chunks)
        size = _size(len(points), max(1, _MOST_RUNS // self.evaluation.runs_per_point))
        self.chunks += _cut(points, size, first=self.linear_count)
        self.request = request_digest(self.evaluation, self.design, linear=together, chunk=size)
        self.evaluation = replace(self.evaluation, linear_chunks=self.linear_count)

    def width(self, index: int) -> int:
        if index < self.linear_count:
            return len(self.evaluation.linear_columns)
        return len(RUN_COLUMNS) + len(self.evaluation.cases) * len(CASE_COLUMNS)

    def columns(self, store: ChunkStore) -> Iterator[Column]:
        # the values of a column are read from the stored chunks only when needed
        inputs: dict[str, Floats] = {}
        run_parts = self.chunks[self.linear_count :]

        def of_runs(k: int) -> Floats:
            return np.concatenate([store.column(i, (len(p), self.width(i)), k) for i, p in run_parts])

        def of_loops(k: int) -> Floats:
            parts = [store.column(i, (len(p), self.width(i)), k) for i, p in self.chunks[: self.linear_count]]
            return np.asarray(np.concatenate(parts)[self.inverse])

        for k, (name, quantity) in enumerate(RUN_COLUMNS.items()):
            yield name, quantity, [partial(of_runs, k)], False
        for k, (name, quantity) in enumerate(self.evaluation.linear_columns.items() if self.linear else ()):
            yield name, quantity, [partial(of_loops, k)], False
        for name in ("strayed", "time_ratio", "reached_worst", "min_clearance_m_worst"):
            inputs[name] = of_runs(list(RUN_COLUMNS).index(name))
        for name in ("delay_margin_s", "disk_margin") if self.linear and self.evaluation.has_margins else ():
            inputs[name] = of_loops(list(LINEAR_COLUMNS).index(name))
        verdict = judged(inputs)
        meaning = "mean deviation in hull radii plus worst time ratio"
        yield "score", Quantity("1", meaning), [lambda: verdict["score"]], False
        yield (
            "feasible",
            Quantity("1", "1 if the point may be picked, otherwise 0"),
            [lambda: verdict["feasible"]],
            False,
        )
        count = len(self.evaluation.cases)
        for k, (name, quantity) in enumerate(CASE_COLUMNS.items()):
            places = [len(RUN_COLUMNS) + c * len(CASE_COLUMNS) + k for c in range(count)]
            by_case = Quantity(quantity.unit, f"{quantity.meaning}, by case")
            yield f"case_{name}", by_case, [partial(of_runs, place) for place in places], True


def _stored_sweep(job: _Job, out: Path, executor: Executor, progress: Progress) -> SweepTable:
    target = out / TABLE
    aside = out / f"sweep-{job.request[:12]}.nc"
    for path in (target, aside):
        if path.exists() and request_of(path) == job.request:
            progress(f"sweep {len(job.design.points)}/{len(job.design.points)} points: {path} has them all")
            return load_sweep(path)
    store = ChunkStore(out / "sweep.chunks" / job.request[:16], job.request)
    with store.open():
        todo = [(i, p) for i, p in job.chunks if not store.has(i, (len(p), job.width(i)))]
        pace = _Pace(job, todo, progress)
        run_chunks(job.evaluation, todo, store=store, executor=executor, finished=pace.finished)
        _set_aside(target, progress)
        attributes = provenance(job.evaluation, job.design, request=job.request)
        write_netcdf(target, job.design, job.columns(store), evaluation=job.evaluation, attributes=attributes)
    store.remove()
    return load_sweep(target)


def _set_aside(target: Path, progress: Progress) -> None:
    # the file belongs to another request
    if not target.exists():
        return
    other = target.with_name(f"sweep-{(request_of(target) or 'unreadable')[:12]}.nc")
    try:
        target.replace(other)
    except OSError as error:
        raise cannot_write(target, error) from None
    progress(f"{target} contained the table of another request; it is now {other}")


def _size(count: int, most: int) -> int:
    # does not depend on the executor, so that any executor can resume a sweep
    return max(1, min(most, -(-count // _MOST_CHUNKS)))


def _cut(points: Floats, size: int, *, first: int) -> list[Chunk]:
    return [(first + k, points[at : at + size]) for k, at in enumerate(range(0, len(points), size))]


class _Pace:
    # at most two lines a second
    def __init__(self, job: _Job, todo: Sequence[Chunk], progress: Progress) -> None:
        self.progress, self.linear_count = progress, job.linear_count
        self.left = {index: len(points) for index, points in todo}
        self.stages = []
        for name, unit, each, chunks in (
            ("linear figures of", "sets", 1, job.chunks[: job.linear_count]),
            ("sweep", "runs", job.evaluation.runs_per_point, job.chunks[job.linear_count :]),
        ):
            whole = sum(len(points) for _, points in chunks)
            self.stages.append(_Stage(name, unit, each, whole, whole - sum(self.left.get(i, 0) for i, _ in chunks)))
        self.last = time.monotonic()
        self.progress(f"sweep {self.stages[1].done}/{self.stages[1].whole} points")

    def finished(self, index: int) -> None:
        linear, simulated = self.stages
        stage = linear if index < self.linear_count else simulated
        stage.done += self.left.pop(index)
        now = time.monotonic()
        if stage is linear:
            simulated.start = now
        if not self.left or now - self.last >= 0.5:
            self.last = now
            self.progress(stage.line(now))


@dataclass
class _Stage:
    name: str
    unit: str
    each: int
    whole: int
    done: int

    def __post_init__(self) -> None:
        self.before, self.start = self.done, time.monotonic()

    def line(self, now: float) -> str:
        rate = (self.done - self.before) / max(now - self.start, 1e-9)
        left = round((self.whole - self.done) / rate)
        eta = f"{left // 3600}:{left // 60 % 60:02d}:{left % 60:02d}"
        return f"{self.name} {self.done}/{self.whole} points, {rate * self.each:.3g} {self.unit}/s, ETA {eta}"
