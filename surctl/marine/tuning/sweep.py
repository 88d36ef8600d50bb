"""Parameter sweeps: closed-loop and linear metrics at many points, computed in chunks, so that a sweep can resume."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from surctl.marine.simulation import Case
from surctl.marine.tuning.measure import (
    CASE_COLUMNS,
    LINEAR_COLUMNS,
    RUN_COLUMNS,
    ColumnSpec,
    SweepEvaluation,
    check_request,
    linear_names,
    request_digest,
)
from surctl.marine.tuning.netcdf import coordinates, provenance, sizes_of
from surctl.marine.tuning.table import SweepTable, judged, load_sweep
from surctl.recorded_write import Column, write_netcdf
from surctl.tuning.chunked import TABLE, Columns, Progress, SweepStage, chunk_size, evaluated_chunks, finished_table
from surctl.tuning.design import Design
from surctl.tuning.executors import Executor, LocalExecutor

__all__ = ["sweep"]

Floats = NDArray[np.float64]

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
    job = _Job(SweepEvaluation(cases, design.names, seeds, cruise=tuple(cruise)), design, linear)
    if out is not None:
        return _stored_sweep(job, out, executor or LocalExecutor(), progress)
    with tempfile.TemporaryDirectory(prefix="surctl-sweep-") as folder:
        table = _stored_sweep(job, Path(folder), executor or LocalExecutor(), progress)
        loaded = table.dataset.load()
        table.dataset.close()
        loaded.encoding.pop("source", None)
        return SweepTable(loaded)


@dataclass
class _Job:
    # first the chunks of linear metrics, then the chunks of simulated runs
    evaluation: SweepEvaluation
    design: Design
    linear: bool
    stages: list[SweepStage] = field(init=False)
    inverse: NDArray[np.int64] = field(init=False)
    request: str = field(init=False)

    def __post_init__(self) -> None:
        points, names = self.design.points, self.design.names
        self.stages, together, chunks = [], 0, 0
        if self.linear:
            matter = [k for k, name in enumerate(names) if name in linear_names(names)]
            different, inverse = np.unique(points[:, matter], axis=0, return_inverse=True)
            self.inverse = inverse.reshape(-1)
            whole = np.tile(points[:1], (len(different), 1))  # the values of the other axes do not matter
            whole[:, matter] = different
            together = max(_LEAST_LINEAR, chunk_size(len(different), most=_MOST_LINEAR))
            width, chunks = len(self.evaluation.linear_columns), -(-len(whole) // together)
            self.stages.append(SweepStage(whole, together, width, "linear figures of", "sets"))
        runs = self.evaluation.runs_per_point
        size = chunk_size(len(points), most=max(1, _MOST_RUNS // runs))
        width = len(RUN_COLUMNS) + len(self.evaluation.cases) * len(CASE_COLUMNS)
        self.stages.append(SweepStage(points, size, width, each=runs))
        self.request = request_digest(self.evaluation, self.design, linear=together, chunk=size)
        self.evaluation = replace(self.evaluation, linear_chunks=chunks)

    def columns(self, stored: Columns) -> Iterator[tuple[str, Column]]:
        # a column is read from the stored chunks only when it is written
        inputs: dict[str, Floats] = {}
        point = tuple(sizes_of(self.design))

        def described(quantity: ColumnSpec, values: Floats, *, by_case: bool = False) -> Column:
            meaning = quantity.meaning + ", by case" * by_case
            return Column(values, quantity.unit, meaning, ("case", *point) if by_case else point)

        def of_runs(k: int) -> Floats:
            return stored(len(self.stages) - 1, k)

        def of_loops(k: int) -> Floats:
            return np.asarray(stored(0, k)[self.inverse])

        yield from coordinates(self.design, self.evaluation.cases)
        for k, (name, quantity) in enumerate(RUN_COLUMNS.items()):
            yield name, described(quantity, of_runs(k))
        for k, (name, quantity) in enumerate(self.evaluation.linear_columns.items() if self.linear else ()):
            yield name, described(quantity, of_loops(k))
        for name in ("strayed", "time_ratio", "reached_worst", "min_clearance_m_worst"):
            inputs[name] = of_runs(list(RUN_COLUMNS).index(name))
        for name in ("delay_margin_s", "disk_margin") if self.linear and self.evaluation.has_margins else ():
            inputs[name] = of_loops(list(LINEAR_COLUMNS).index(name))
        verdict = judged(inputs)
        meaning = "mean deviation in hull radii plus worst time ratio"
        yield "score", described(ColumnSpec("1", meaning), verdict["score"])
        meaning = "1 if the point may be picked, otherwise 0"
        yield "feasible", described(ColumnSpec("1", meaning), verdict["feasible"])
        count = len(self.evaluation.cases)
        for k, (name, quantity) in enumerate(CASE_COLUMNS.items()):
            places = [len(RUN_COLUMNS) + c * len(CASE_COLUMNS) + k for c in range(count)]
            yield f"case_{name}", described(quantity, np.concatenate([of_runs(p) for p in places]), by_case=True)


def _stored_sweep(job: _Job, out: Path, executor: Executor, progress: Progress) -> SweepTable:
    path = finished_table(out, job.request, progress=progress)
    if path is not None:
        return load_sweep(path)
    stages, request = job.stages, job.request
    with evaluated_chunks(
        job.evaluation, stages, out=out, request=request, executor=executor, progress=progress
    ) as stored:
        path = write_netcdf(
            out / TABLE,
            job.columns(stored),
            sizes={**sizes_of(job.design), "case": len(job.evaluation.cases)},
            attributes=provenance(job.evaluation, job.design, request=request),
            checksums=True,
        )
    return load_sweep(path)
