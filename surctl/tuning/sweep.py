"""Sweeps: a table of the results of any subject at the points of a design, in chunks, so that a sweep can resume."""

from __future__ import annotations

import json
import math
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, check_known
from surctl.recorded_write import Column, write_netcdf
from surctl.tuning.chunked import (
    TABLE,
    Columns,
    Executor,
    LocalExecutor,
    Progress,
    SweepStage,
    evaluated_chunks,
    finished_table,
)
from surctl.tuning.design import Axis, Design, Span

Floats = NDArray[np.float64]
Index = tuple[int, ...]


@dataclass(frozen=True, eq=False)
class SweptAxis:
    """A parameter of a sweep with its unit and values: the values of a grid, or one value per point otherwise."""

    name: str
    unit: str
    meaning: str
    values: Floats = field(repr=False)


@dataclass(frozen=True, eq=False)
class SweepTable:
    """A finished sweep: columns of results at its points, of one or several runs each.

    Random numbers such as seeds are no choice: where the runs of a point have columns of their own, the worst counts.

    `sweep` and `load_sweep` return it; xarray reads its file as a dataset, `xarray.open_dataset(table.path)`, whose
    dimensions are the axes of a grid, or `point` for other designs, and `seed` or `draw` if a point has several runs.

    Attributes:
        attributes: attributes of the file with the origin of the results.
        about: unit, meaning and dimensions of each variable. Columns whose name starts with `case_` hold the results of
            single cases and have `case` as first dimension.
        values: function that returns the values of a variable at an index; those of a file are read when it is called.
        path: the file; None for results in memory.
    """

    attributes: Mapping[str, Any]
    about: Mapping[str, tuple[str, str, tuple[str, ...]]]
    values: Callable[[str, Any], NDArray[Any]] = field(repr=False)
    path: Path | None = None

    @property
    def is_grid(self) -> bool:
        """Whether the design is a full grid: every combination of the axes' values was evaluated."""
        return bool(self.attributes["design"] == "grid")

    @cached_property
    def axes(self) -> tuple[SweptAxis, ...]:
        """The parameters that the sweep varies, in the order of the dimensions."""
        names = {name: _netcdf_name(name) for name in json.loads(self.attributes["axes"])}
        return tuple(SweptAxis(name, *self.about[own][:2], self.values(own, ...)) for name, own in names.items())

    @cached_property
    def draws(self) -> Mapping[str, Floats]:
        """Numbers (m,) in which the m runs of a point differ, by name, the same at all points; empty if m is 1."""
        return {name: self.values(name, ...) for name in json.loads(self.attributes["draws"])}

    @cached_property
    def each(self) -> int:
        """Number m of runs at each point that have columns of their own."""
        return max(map(len, self.draws.values()), default=1)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the design."""
        if self.is_grid:
            return tuple(len(axis.values) for axis in self.axes)
        return (len(self.axes[0].values),)

    @cached_property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns of results that cover all cases together."""
        others = {*self.draws, *(_netcdf_name(axis.name) for axis in self.axes)}
        return tuple(name for name, (*_, dims) in self.about.items() if "case" not in dims and name not in others)

    @property
    def units(self) -> Mapping[str, str]:
        """Unit of every axis and column, and of every number in which runs differ."""
        known = {axis.name: axis.unit for axis in self.axes}
        return known | {name: self.about[name][0] for name in (*self.draws, *self.columns)}

    @cached_property
    def cases(self) -> tuple[str, ...]:
        """Names of the cases that were simulated at every point."""
        return tuple(map(str, self.values("case", ...)))

    def column(self, name: str, *, case: str | None = None) -> NDArray[Any]:
        """Return a column, over all cases or of one case, in the shape of the design, then of the runs of a point.

        If there is no such column, the InputError suggests a similar name.
        """
        known = self.columns
        if case is not None:
            known = tuple(name.removeprefix("case_") for name in self.about if name.startswith("case_"))
        check_known(name, known, "no such column", key="column")
        if case is None:
            return self.values(name, ...)
        check_known(case, self.cases, "no such case", key="case")
        return self.values("case_" + name, self.cases.index(case))

    def worst(self, name: str) -> Floats:
        """Return the largest value of a column over the runs of each point; NaN if a run has no value."""
        return np.asarray(self._runs(name).max(axis=-1))

    def mean(self, name: str) -> Floats:
        """Return the mean of a column over the runs of each point; NaN if a run has no value."""
        return np.asarray(self._runs(name).mean(axis=-1))

    def _runs(self, name: str) -> Floats:
        return self.column(name).reshape(*self.shape, self.each)

    def best(self, name: str) -> Index | None:
        """Return the index of the point whose worst run has the least value of a column; None without such a point.

        Points whose column `feasible` is 0 do not count. The margins of a system are not judged: see `chosen_points`.
        """
        worst = self.worst(name)
        if "feasible" in self.columns:
            worst = np.where(self.worst("feasible") > 0.5, worst, np.inf)
        if not np.isfinite(worst).any():
            return None
        return self.index(int(np.nanargmin(worst)))

    @property
    def picked(self) -> Index | None:
        """Index of the feasible point with the least `score`; None if no point is feasible, or has a score."""
        return self.best("score") if "score" in self.columns else None

    def index(self, point: int) -> Index:
        """Return the index of the point with this number in C order."""
        return tuple(int(k) for k in np.unravel_index(point, self.shape))

    def at(self, index: Index) -> dict[str, float]:
        """Return the values of the axes at a point."""
        if self.is_grid:
            return {axis.name: float(axis.values[k]) for axis, k in zip(self.axes, index, strict=True)}
        return {axis.name: float(axis.values[index]) for axis in self.axes}

    def row(self, index: Index) -> dict[str, float]:
        """Return the values of the axes and of every column at a point with one run."""
        return self.at(index) | {name: float(self.values(name, index)) for name in self.columns}

    def numbers(self) -> dict[str, Floats]:
        """Return the axes and the numbers in which runs differ, for all runs, those of a point one after another."""
        values = [axis.values for axis in self.axes]
        points = np.meshgrid(*values, indexing="ij") if self.is_grid else values
        swept = {axis.name: np.repeat(one, self.each) for axis, one in zip(self.axes, points, strict=True)}
        return swept | {name: np.tile(values, math.prod(self.shape)) for name, values in self.draws.items()}

    def rows(self) -> list[dict[str, Any]]:
        """Return the numbers and every column of every run, in C order, those of a point one after another."""
        table = {n: v.tolist() for n, v in self.numbers().items()}
        table |= {name: self.column(name).reshape(-1).tolist() for name in self.columns}
        return [dict(zip(table, row, strict=True)) for row in zip(*table.values(), strict=True)]


class SweepSubject(ABC):
    """What a sweep computes at the points of a design; other processes can run it if it can be pickled."""

    @abstractmethod
    def stages(self, design: Design) -> list[SweepStage]:
        """Return the rows that are evaluated; those of the last stage are the points, or the runs of the points.

        Raises:
            InputError: the subject cannot be evaluated at these points.
        """

    @abstractmethod
    def evaluate(self, stage: int, index: int, values: Mapping[str, Floats]) -> Floats:
        """Return the results (rows, columns) of rows of a stage, whose numbers (rows,) are given by name.

        `index` is that of the chunk, counted through all stages.
        """

    @abstractmethod
    def request(self, design: Design, stages: Sequence[SweepStage]) -> str:
        """Return the SHA-256 of all inputs that determine the results and their division into chunks."""

    @abstractmethod
    def quantity(self, name: str) -> tuple[str, str]:
        """Return unit and meaning of a parameter."""

    @abstractmethod
    def columns(self, design: Design, stored: Columns, dimensions: Sequence[str]) -> Iterable[tuple[str, Column]]:
        """Yield the columns of the table by name; `dimensions` are those of the points, then that of their runs."""

    @abstractmethod
    def origin(self, design: Design) -> Mapping[str, Any]:
        """Return attributes with the origin of the results, without date and time: equal requests give equal files."""

    def draws(self) -> Mapping[str, Floats]:
        """Return the numbers (m,) in which the m runs of a point differ, by name."""
        return {}

    def labels(self) -> Mapping[str, Column]:
        """Return the texts along each further dimension of columns, by the name of the dimension."""
        return {}


@dataclass(frozen=True)
class _Evaluator:
    # of a chunk; `ends` are the indices at which the chunks of each stage end
    subject: SweepSubject
    names: tuple[tuple[str, ...], ...]
    ends: tuple[int, ...]

    def __call__(self, index: int, points: Floats) -> Floats:
        stage = int(np.searchsorted(self.ends, index, side="right"))
        values = {name: points[:, k] for k, name in enumerate(self.names[stage])}
        return self.subject.evaluate(stage, index, values)


def sweep(
    subject: SweepSubject,
    design: Design,
    *,
    executor: Executor | None = None,
    out: Path | None = None,
    progress: Progress = lambda _: None,
) -> SweepTable:
    """Evaluate a subject at every point of a design; a sweep can resume.

    Args:
        subject: what is computed: `SystemSweep` of any closed loop, `surctl.marine.tuning.MissionSweep` of missions.
        design: the points; see `grid`, `spread`, `saltelli`, `make_design`, and `ONE_POINT` for random runs alone.
        executor: executor of the chunks; by default the calling process. The results do not depend on the executor.
        out: folder of `sweep.nc`; None stores no file. Until the file is complete, finished chunks are stored beside
            it, and an identical request resumes from them, also after a crash. A finished `sweep.nc` of another request
            is renamed, and `progress` reports this.
        progress: function that receives one line of text at each step of the work.

    Raises:
        InputError: the subject cannot be evaluated at these points, the folder cannot be written, or the disk is full.
            Finished chunks remain.

    Example:
        >>> from surctl.testing import cart_system
        >>> from surctl.tuning import Span, SystemSweep, grid, parse_axis, random_draws, sweep
        >>> draws = random_draws([Span("start.speed", 0.5, 1.5)], count=20)
        >>> table = sweep(SystemSweep(cart_system(), 5.0, draws), grid([parse_axis("k=1,2")]))
        >>> table.worst("way").round(2).tolist(), table.mean("way").round(2).tolist(), table.at(table.best("way"))
        ([1.43, 0.72], [1.01, 0.51], {'k': 2.0})
    """
    stages = subject.stages(design)
    request = subject.request(design, stages)
    ends = np.cumsum([-(-len(stage.rows) // stage.size) for stage in stages]).tolist()
    function = _Evaluator(subject, tuple(stage.names for stage in stages), tuple(ends))
    with tempfile.TemporaryDirectory(prefix="surctl-sweep-") as scratch:
        folder = Path(scratch) if out is None else out
        path = finished_table(folder, request, progress=progress)
        if path is not None:
            return load_sweep(path)
        with evaluated_chunks(
            function, stages, out=folder, request=request, executor=executor or LocalExecutor(), progress=progress
        ) as stored:
            sizes, columns, attributes = _variables(subject, design, stored, request)
            if out is not None:
                write_netcdf(out / TABLE, columns, sizes=sizes, attributes=attributes, checksums=True)
                return load_sweep(out / TABLE)
            variables = dict(columns)
    about = {
        name: (column.unit, column.meaning, column.dimensions or tuple(sizes)) for name, column in variables.items()
    }
    shapes = {name: [sizes[dimension] for dimension in dimensions] for name, (*_, dimensions) in about.items()}
    return SweepTable(attributes, about, lambda name, at: variables[name].values.reshape(shapes[name])[at])


def _variables(
    subject: SweepSubject, design: Design, stored: Columns, request: str
) -> tuple[dict[str, int], Iterable[tuple[str, Column]], dict[str, Any]]:
    """Return the dimensions, variables and attributes of a table."""
    is_grid, names = design.kind == "grid", [_netcdf_name(name) for name in design.names]
    sizes = dict(zip(names if is_grid else ["point"], design.shape, strict=True))
    known = dict[str, Column]()
    axes: tuple[Axis | Span, ...] = design.axes
    for k, (name, axis) in enumerate(zip(names, axes, strict=True)):
        values = np.array(axis.values) if isinstance(axis, Axis) else design.points[:, k]
        known[name] = Column(values, *subject.quantity(axis.name), (name if is_grid else "point",))
    draws = subject.draws()
    if draws:
        run = "seed" if "seed" in draws else "draw"
        sizes[run] = len(next(iter(draws.values())))
        known |= {name: Column(values, *subject.quantity(name), (run,)) for name, values in draws.items()}
    results = subject.columns(design, stored, tuple(sizes))
    labels = subject.labels()
    sizes |= {name: len(column.values) for name, column in labels.items()}
    attributes = {
        **subject.origin(design),
        "request": request,
        "design": design.kind,
        "points": f"{len(design.points)} on a grid" if is_grid else design.description,
        "axes": json.dumps(design.names),
        "draws": json.dumps(list(draws)),
        **({} if is_grid else {"coordinates": " ".join(names)}),
    }
    return sizes, chain(known.items(), labels.items(), results), attributes


def load_sweep(path: Path | str) -> SweepTable:
    """Load a finished sweep from its netCDF file; the columns are read on access.

    Raises:
        InputError: the file does not exist, or it is not the table of a sweep.

    Example:
        >>> from pathlib import Path
        >>> from surctl.testing import cart_system
        >>> from surctl.tuning import SystemSweep, grid, load_sweep, parse_axis, sweep
        >>> _ = sweep(SystemSweep(cart_system(), 5.0), grid([parse_axis("k=1,2")]), out=Path("swept"))
        >>> table = load_sweep("swept/sweep.nc")
        >>> table.axes[0].values.tolist(), table.column("way").round(2).tolist(), table.units["way"]
        ([1.0, 2.0], [0.99, 0.5], 'm')
    """
    import netCDF4

    path = Path(path)
    if not path.is_file():
        raise InputError("no such file", file=path, remedy="give the sweep.nc of a finished sweep")
    try:
        # stays open, because opening it takes longer than reading a column; closed with the table
        file = netCDF4.Dataset(path, keepweakref=True)
        file.set_auto_mask(False)
        attributes = {name: file.getncattr(name) for name in file.ncattrs()}
        about = {
            name: (getattr(variable, "units", ""), variable.long_name, variable.dimensions)
            for name, variable in file.variables.items()
        }
    except (OSError, RuntimeError, AttributeError) as error:
        raise InputError(
            f"is not a readable netCDF file ({type(error).__name__})", file=path, remedy="run the sweep again"
        ) from None
    try:
        named = {name for key in ("axes", "draws") for name in map(_netcdf_name, json.loads(attributes[key]))}
    except (KeyError, TypeError, ValueError, AttributeError):
        named = {""}
    if not {"design", "request"} <= set(attributes) or not named <= set(about):
        raise InputError("is not the table of a sweep", file=path, remedy="give the sweep.nc of a finished sweep")
    return SweepTable(attributes, about, lambda name, at: np.asarray(file[name][at]), path)


def _netcdf_name(name: str) -> str:
    # without slashes, because netCDF reads a slash as the separator of a path
    return name.replace("/", "|")
