"""Parameter sweeps: closed-loop and linear metrics at many points, computed in chunks, so that a sweep can resume."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from surctl import __version__
from surctl.errors import InputError, nearest
from surctl.marine.control import Gains, GainSpec
from surctl.marine.simulation import Case
from surctl.marine.simulation.batch.case import case_parameters
from surctl.marine.tuning.measure import (
    CASE_COLUMNS,
    LINEAR_COLUMNS,
    RUN_COLUMNS,
    ColumnSpec,
    SweepEvaluation,
    check_request,
    law_digest,
    linear_names,
    request_digest,
)
from surctl.own_code import label
from surctl.recorded_write import Column
from surctl.tuning.chunked import (
    Columns,
    Executor,
    Progress,
    SweepStage,
    Variables,
    axis_columns,
    chunk_size,
    netcdf_name,
    swept_file,
)
from surctl.tuning.design import SEED, Design
from surctl.verification.linear import LEAST_DISK_MARGIN
from surctl.verification.loops import LEAST_DELAY_MARGIN

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True, eq=False)
class SweptAxis:
    """A parameter of a sweep with its unit and values: the values of a grid, or one value per point otherwise."""

    name: str
    unit: str
    meaning: str
    values: NDArray[np.float64] = field(repr=False)


@dataclass(frozen=True, eq=False)
class SweepTable:
    """A finished sweep.

    Attributes:
        dataset: xarray dataset; its dimensions are the axes of a grid, or `point` for other designs. Every column of
            results is a data variable with the attributes `units` and `long_name`. Columns whose name starts with
            `case_` hold the results of single cases and have `case` as first dimension. Values are read from the file
            on access.
    """

    dataset: xr.Dataset = field(repr=False)

    @property
    def is_grid(self) -> bool:
        """Whether the design is a full grid: every combination of the axes' values was evaluated."""
        return bool(self.dataset.attrs["design"] == "grid")

    @cached_property
    def axes(self) -> tuple[SweptAxis, ...]:
        """The parameters that the sweep varies, in the order of the dimensions."""
        axes = []
        for name in json.loads(self.dataset.attrs["axes"]):
            values = self.dataset[netcdf_name(name)]
            axes.append(SweptAxis(name, values.attrs["units"], values.attrs["long_name"], np.asarray(values.values)))
        return tuple(axes)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of a column."""
        return tuple(self.dataset[self.columns[0]].shape)

    @cached_property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns that cover all cases together."""
        return tuple(name for name, dims in self._dimensions.items() if "case" not in dims)

    @cached_property
    def _dimensions(self) -> Mapping[str, tuple[str, ...]]:
        # of every data variable; xarray builds an object each time that it is asked for one
        return {str(name): tuple(map(str, v.dims)) for name, v in self.dataset.data_vars.items()}

    @property
    def units(self) -> Mapping[str, str]:
        """Unit of every column."""
        return {name: str(self.dataset[name].attrs["units"]) for name in self.columns}

    @cached_property
    def cases(self) -> tuple[str, ...]:
        """Names of the cases that were simulated at every point."""
        return tuple(str(name) for name in self.dataset["case"].values)

    @property
    def path(self) -> Path | None:
        """The file from which the results are read; None for results in memory."""
        source = self.dataset.encoding.get("source")
        return Path(source) if source else None

    def column(self, name: str, *, case: str | None = None) -> NDArray[np.float64]:
        """Return a column, over all cases or of one case, in the shape of the design.

        If there is no such column, the InputError suggests a similar name.
        """
        known = self.columns
        if case is not None:
            known = tuple(v.removeprefix("case_") for v in self._dimensions if v.startswith("case_"))
        if name not in known:
            raise InputError("no such column", key="column", value=name, remedy=nearest(name, known))
        if case is None:
            return np.asarray(self.dataset.variables[name].values)
        if case not in self.cases:
            raise InputError("no such case", key="case", value=case, remedy=nearest(case, self.cases))
        return np.asarray(self.dataset.variables["case_" + name][self.cases.index(case)].values)

    @property
    def picked(self) -> tuple[int, ...] | None:
        """Index of the feasible point with the least score; None if no point is feasible.

        The score is the mean deviation in hull radii plus the largest ratio of arrival time to ideal time. A point is
        feasible if every run arrives without contact and, where margins were computed, the margins suffice.
        """
        score = np.where(self.column("feasible") > 0.5, self.column("score"), np.inf)
        if not np.isfinite(score).any():
            return None
        return tuple(int(k) for k in np.unravel_index(int(np.nanargmin(score)), score.shape))

    def at(self, index: tuple[int, ...]) -> dict[str, float]:
        """Return the values of the axes at a point."""
        if self.is_grid:
            return {axis.name: float(axis.values[k]) for axis, k in zip(self.axes, index, strict=True)}
        return {axis.name: float(axis.values[index]) for axis in self.axes}

    def row(self, index: tuple[int, ...]) -> dict[str, float]:
        """Return the values of the axes and of every column at a point."""
        return self.at(index) | {name: float(self.dataset.variables[name][index].values) for name in self.columns}

    def rows(self) -> list[dict[str, float]]:
        """Return the values of the axes and of every column at every point, in C order."""
        columns = {name: self.column(name).reshape(-1) for name in self.columns}
        points = [self.at(index) for index in np.ndindex(self.shape)]
        return [p | {name: float(values[k]) for name, values in columns.items()} for k, p in enumerate(points)]

    @property
    def base(self) -> Gains:
        """The base gains: the gains that the cases had before the sweep varied them."""
        stored = json.loads(self.dataset.attrs["gains"])
        own = {name: GainSpec(**spec) for name, spec in stored.pop("own", {}).items()}
        return Gains(**stored, own=own)

    @property
    def gains(self) -> Gains:
        """The base gains with the values of the best feasible point; the base gains if there is no choice of points."""
        if self.picked is None or np.prod(self.shape) == 1:
            return self.base
        chosen = self.at(self.picked)
        what = ", ".join(f"{name} = {value:g}" for name, value in chosen.items())
        return self.base.with_values(
            {name: value for name, value in chosen.items() if name in self.base.values},
            provenance=f"{self.base.provenance}; picked by a {self.dataset.attrs['design']} sweep: {what}",
            how="picked",
        )


def judged(columns: Mapping[str, NDArray[np.float64]]) -> dict[str, NDArray[np.float64]]:
    """Return the columns of score and feasibility, which are computed from the given columns.

    The path error is not part of the score, because it covers only the time outside avoidance, and the gains change
    this time.
    """
    feasible = (columns["reached_worst"] > 0.5) & (columns["min_clearance_m_worst"] > 0)
    if "delay_margin_s" in columns:
        feasible &= (columns["delay_margin_s"] >= LEAST_DELAY_MARGIN) & (columns["disk_margin"] >= LEAST_DISK_MARGIN)
    return {"score": columns["strayed"] + columns["time_ratio"], "feasible": feasible.astype(float)}


def load_sweep(path: Path | str) -> SweepTable:
    """Load a finished sweep from its netCDF file; the columns are read on access.

    Raises:
        InputError: the file does not exist, or it is not the table of a sweep.

    Example:
        >>> from pathlib import Path
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import build_cases, load_sweep, sweep
        >>> from surctl.tuning import grid, parse_axis
        >>> cases = build_cases([load_scenario("pool-behind")], gains=load_gains("default"), law="closed_form")
        >>> _ = sweep(cases, grid([parse_axis("k_v=1,1.5,2")]), linear=False, out=Path("swept"))
        >>> table = load_sweep("swept/sweep.nc")
        >>> table.axes[0].values.tolist(), table.column("time_s").round(2).tolist(), table.units["time_s"]
        ([1.0, 1.5, 2.0], [21.4, 20.45, 20.15], 's')
    """
    import xarray as xr  # takes seconds to import

    path = Path(path)
    if not path.is_file():
        raise InputError("no such file", file=path, remedy="give the sweep.nc of a finished sweep")
    dataset: Any = None
    try:
        dataset = xr.open_dataset(path.resolve(), engine="netcdf4", cache=False)
        missing = {"design", "axes", "request", "gains"} - set(dataset.attrs)
    except (OSError, ValueError, RuntimeError) as error:
        raise InputError(
            f"is not a readable netCDF file ({type(error).__name__})", file=path, remedy="run the sweep again"
        ) from None
    if missing:
        dataset.close()
        raise InputError("is not the table of a sweep", file=path, remedy="give the sweep.nc of a finished sweep")
    return SweepTable(dataset)


def _quantity(name: str, cases: tuple[Case, ...]) -> tuple[str, str]:
    if name == SEED:
        return "1", "seed of every run"
    parameter = next(table[name] for table in map(case_parameters, cases) if name in table)
    return parameter.unit, parameter.meaning


def provenance(evaluation: SweepEvaluation, design: Design, *, request: str) -> dict[str, str]:
    """Return attributes with the origin of the results, without date and time: equal requests must give equal files."""
    gains = evaluation.cases[0].gains
    cases = [
        {"name": c.name, "law": label(c.law), "priority_mode": c.mode, "seeds": list(evaluation.seeds_of(c))}
        | ({} if c.model is None else {"model": c.model.name})
        for c in evaluation.cases
    ]
    return {
        "title": f"surctl sweep over {', '.join(design.names)}",
        "source": f"surctl {__version__}",
        "request": request,
        "design": design.kind,
        "points": design.description if design.kind != "grid" else f"{len(design.points)} on a grid",
        "axes": json.dumps(design.names),
        **({} if design.kind == "grid" else {"coordinates": " ".join(netcdf_name(name) for name in design.names)}),
        "cases": json.dumps(cases),
        "law_sha256": ", ".join(dict.fromkeys(law_digest(c) for c in evaluation.cases)),
        "gains": json.dumps(
            {
                "name": gains.name,
                "values": dict(gains.values),
                "provenance": gains.provenance,
                "source": gains.source,
                **({"own": {name: asdict(spec) for name, spec in gains.own.items()}} if gains.own else {}),
            }
        ),
    }


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
    with swept_file(
        job.function, job.stages, job.variables, out=out, request=job.request, executor=executor, progress=progress
    ) as path:
        table = load_sweep(path)
        if out is not None:
            return table
        loaded = table.dataset.load()
        table.dataset.close()
    loaded.encoding.pop("source", None)
    return SweepTable(loaded)


@dataclass
class _Job:
    # first the chunks of linear metrics, then the chunks of simulated runs
    function: SweepEvaluation
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
            width, chunks = len(self.function.linear_columns), -(-len(whole) // together)
            self.stages.append(SweepStage(whole, together, width, "linear figures of", "sets"))
        runs = self.function.runs_per_point
        size = chunk_size(len(points), most=max(1, _MOST_RUNS // runs))
        width = len(RUN_COLUMNS) + len(self.function.cases) * len(CASE_COLUMNS)
        self.stages.append(SweepStage(points, size, width, each=runs))
        self.request = request_digest(self.function, self.design, linear=together, chunk=size)
        self.function = replace(self.function, linear_chunks=chunks)

    def variables(self, stored: Columns) -> Variables:
        cases = self.function.cases
        sizes, axes = axis_columns(self.design, lambda name: _quantity(name, cases))
        names = Column(np.array([c.name for c in cases]), "", "scenario, vehicle and sensing", ("case",))
        columns = chain(axes.items(), [("case", names)], self._results(stored, tuple(sizes)))
        return {**sizes, "case": len(cases)}, columns, provenance(self.function, self.design, request=self.request)

    def _results(self, stored: Columns, point: tuple[str, ...]) -> Iterator[tuple[str, Column]]:
        # a column is read from the stored chunks only when it is written
        inputs: dict[str, Floats] = {}

        def described(quantity: ColumnSpec, values: Floats, *, by_case: bool = False) -> Column:
            meaning = quantity.meaning + ", by case" * by_case
            return Column(values, quantity.unit, meaning, ("case", *point) if by_case else point)

        def of_runs(k: int) -> Floats:
            return stored(len(self.stages) - 1, k)

        def of_loops(k: int) -> Floats:
            return np.asarray(stored(0, k)[self.inverse])

        for k, (name, quantity) in enumerate(RUN_COLUMNS.items()):
            yield name, described(quantity, of_runs(k))
        for k, (name, quantity) in enumerate(self.function.linear_columns.items() if self.linear else ()):
            yield name, described(quantity, of_loops(k))
        for name in ("strayed", "time_ratio", "reached_worst", "min_clearance_m_worst"):
            inputs[name] = of_runs(list(RUN_COLUMNS).index(name))
        for name in ("delay_margin_s", "disk_margin") if self.linear and self.function.has_margins else ():
            inputs[name] = of_loops(list(LINEAR_COLUMNS).index(name))
        verdict = judged(inputs)
        meaning = "mean deviation in hull radii plus worst time ratio"
        yield "score", described(ColumnSpec("1", meaning), verdict["score"])
        meaning = "1 if the point may be picked, otherwise 0"
        yield "feasible", described(ColumnSpec("1", meaning), verdict["feasible"])
        count = len(self.function.cases)
        for k, (name, quantity) in enumerate(CASE_COLUMNS.items()):
            places = [len(RUN_COLUMNS) + c * len(CASE_COLUMNS) + k for c in range(count)]
            yield f"case_{name}", described(quantity, np.concatenate([of_runs(p) for p in places]), by_case=True)
