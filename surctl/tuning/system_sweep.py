"""Sweep of any system: its costs at every point of a design, each over the same random runs, with resume."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl import __version__
from surctl.assessment import Assessment, ClosedLoop, Line, assess, cost_verdicts
from surctl.errors import InputError, SurctlError
from surctl.recorded_write import Column
from surctl.system import (
    ENDED,
    LOST,
    Runs,
    System,
    entry_labels,
    entry_units,
    every_combination,
    periods,
    simulate_system,
)
from surctl.system.record import identity
from surctl.system.runs import loop_program
from surctl.system.subjects import load_subject
from surctl.system.values import check_scalar, run_numbers, unit_of
from surctl.tuning.chunked import (
    Columns,
    Executor,
    Progress,
    SweepStage,
    Variables,
    axis_columns,
    chunk_size,
    swept_file,
)
from surctl.tuning.design import MOST_POINTS, SEED, Design

Array = NDArray[np.float64]

_NONE: Mapping[str, Any] = MappingProxyType({})
_LEAST, _MOST = 64, 4096  # runs in a chunk


@dataclass(frozen=True, eq=False)
class SystemSweep:
    """A finished sweep of a system: n points, and m runs at each point.

    Random numbers such as seeds are no choice: a point is judged by the worst of its m runs.

    Attributes:
        system: the closed loop.
        design: the n points.
        draws: (m,) numbers in which the runs of a point differ, by name, the same at all points; empty if m is 1.
        runs: the n·m runs, those of a point one after another.
        path: the netCDF file; None if nothing was stored.
    """

    system: System
    design: Design
    draws: Mapping[str, Array]
    runs: Runs = field(repr=False)
    path: Path | None = None

    @cached_property
    def each(self) -> int:
        """Number m of runs at each point."""
        return len(self.runs.time) // len(self.design.points)

    def over_runs(self, name: str) -> Array:
        """Return a cost (n, m); InputError if there is no such cost."""
        return self.runs[name].reshape(-1, self.each)

    def worst(self, name: str) -> Array:
        """Return the largest value (n,) of a cost over the runs of each point; NaN if a run has no value."""
        return np.asarray(self.over_runs(name).max(axis=1))

    def mean(self, name: str) -> Array:
        """Return the mean (n,) of a cost over the runs of each point; NaN if a run has no value."""
        return np.asarray(self.over_runs(name).mean(axis=1))

    def best(self, name: str) -> int | None:
        """Return the index of the point whose worst run has the least cost; None if no point has a value.

        The margins there are not judged: see `chosen_points`.
        """
        worst = self.worst(name)
        return int(np.nanargmin(worst)) if np.isfinite(worst).any() else None

    def worst_run(self, name: str, point: int) -> int:
        """Return the index of the run with the largest value of a cost at a point; a run without a value is larger."""
        return point * self.each + int(np.argmax(self.over_runs(name)[point]))

    @cached_property
    def swept(self) -> dict[str, Array]:
        """Numbers (n·m,) of all runs by name."""
        return _combined(self.design, self.draws)

    def at(self, point: int) -> dict[str, float]:
        """Return the numbers of a point by name."""
        return dict(zip(self.design.names, self.design.points[point].tolist(), strict=True))

    def random_of(self, run: int) -> dict[str, float]:
        """Return the random numbers of a run by name."""
        return {name: float(values[run % self.each]) for name, values in self.draws.items()}

    def table(self) -> dict[str, list[Any]]:
        """Return the columns of a table with one row for each run: numbers, costs with units, end and duration."""
        columns: dict[str, list[Any]] = {name: values.tolist() for name, values in self.swept.items()}
        for name, cost in self.system.costs.items():
            columns[f"{name} [{cost.unit}]"] = self.runs[name].tolist()
        return columns | {"stopped": self.runs.stopped.tolist(), "duration [s]": self.runs.time.tolist()}


_JUDGED = 16  # points of a cost whose linear loop is judged, the least cost first


@dataclass(frozen=True, eq=False)
class Choice:
    """The point of a sweep with the least worst cost among those that are accepted.

    Attributes:
        point: index of the point; that of the least cost if no judged point is accepted.
        run: index of its worst run.
        assessment: its margins with the random numbers of this run, and the bounds of its costs.
        passed_over: number of points with a lower cost, each with a bound or a margin that is not met.
    """

    point: int
    run: int
    assessment: Assessment
    passed_over: int


def chosen_points(
    swept: SystemSweep, values: Mapping[str, ArrayLike] = _NONE, ranges: Mapping[str, tuple[float, float]] | None = None
) -> dict[str, Choice]:
    """Return for each cost the point with its least value at which the bounds of all costs and the margins hold.

    The margins of at most 16 points per cost are judged, the least cost first.

    Args:
        swept: the sweep.
        values, ranges: as in `ClosedLoop`; the numbers of a point take the place of `values`.
    """
    system, judged = swept.system, dict[tuple[int, int], Assessment]()
    bounded = np.all([swept.worst(n) <= c.at_most for n, c in system.costs.items() if c.at_most is not None], axis=0)
    bounded = np.broadcast_to(bounded, len(swept.design.points))

    def assessed(point: int, run: int) -> Assessment:
        if (point, run) not in judged:
            numbers = {**values, **swept.at(point), **swept.random_of(run)}
            loop = assess(ClosedLoop(system, numbers, ranges), parts=["loop"])
            lines, duration = list[Line](), float(swept.runs.time[run])
            for name, cost in system.costs.items():
                value = float(swept.worst(name)[point])
                lines += cost_verdicts(name, cost, value, duration=duration, dt=system.dt)
            judged[point, run] = loop.with_lines(lines)
        return judged[point, run]

    choices = {}
    for name in system.costs:
        worst = swept.worst(name)
        order = [k for k in np.argsort(worst, kind="stable").tolist() if np.isfinite(worst[k])]
        if not order:
            continue
        runs = {k: swept.worst_run(name, k) for k in order}
        tried = [k for k in order if bounded[k]][:_JUDGED]
        point = next((k for k in tried if assessed(k, runs[k]).accepted()), order[0])
        choices[name] = Choice(point, runs[point], assessed(point, runs[point]), order.index(point))
    return choices


def sweep_system(
    system: System,
    design: Design,
    seconds: float,
    *,
    draws: Mapping[str, ArrayLike] = _NONE,
    values: Mapping[str, ArrayLike] = _NONE,
    threads: int = 1,
    out: Path | None = None,
    about: Mapping[str, str] = _NONE,
    source: str = "",
    executor: Executor | None = None,
    progress: Progress = lambda _: None,
) -> SystemSweep:
    """Simulate a system at every point of a design, with the same random runs at each point; a sweep can resume.

    Args:
        system: the closed loop.
        design: the points; see `grid`, `spread`, `saltelli`, `make_design`, and `ONE_POINT` for random runs alone.
        seconds: duration [s] of a run that no stop ends earlier.
        draws: (m,) numbers of the m runs at each point, by name, such as seeds; see also `random_draws`.
        values: numbers of all runs by name, see `run_numbers`.
        threads: number of threads that share the runs of a chunk.
        out: folder of `sweep.nc`; None stores no file. Until the file is complete, finished chunks are stored beside
            it, and an identical request resumes from them, also after a crash. A finished `sweep.nc` of another request
            is renamed.
        about: further texts of the file by name, such as the origin of the system.
        source: FILE.py:FUNCTION or subject:NAME that returns the system, for an executor with other processes.
        executor: executor of the chunks; by default the calling process. The results do not depend on it.
        progress: function that receives one line of text at each step of the work.

    Raises:
        InputError: the system has no costs, a name is unknown or not that of one number, there are too many runs, the
            folder cannot be written, or other processes need `source`. Finished chunks remain.
        ToolMissing: there is no C compiler.

    Example:
        >>> from surctl.testing import cart_system
        >>> from surctl.tuning import Span, grid, parse_axis, random_draws, sweep_system
        >>> system = cart_system()
        >>> draws = random_draws([Span("start.speed", 0.5, 1.5)], count=20)
        >>> swept = sweep_system(system, grid([parse_axis("k=1,2")]), 5.0, draws=draws)
        >>> swept.worst("way").round(2).tolist(), swept.mean("way").round(2).tolist(), swept.at(swept.best("way"))
        ([1.43, 0.72], [1.01, 0.51], {'k': 2.0})
    """
    fixed = {name: np.asarray(value, dtype=float) for name, value in values.items()}
    random = {name: np.asarray(value, dtype=float) for name, value in draws.items()}
    names = (*design.names, *random)
    _check(system, names, design, random)
    periods(system, seconds)
    combined = _combined(design, random)
    rows = np.column_stack([combined[name] for name in names])
    request = _request(system, design, seconds, names, {**fixed, **combined})
    size, width = max(_LEAST, chunk_size(len(rows), most=_MOST)), len(system.costs) + 2 + system.plant.state.size
    stage = SweepStage(rows, size, width, counted="runs")
    function = _Evaluator(system, names, seconds, fixed, threads, source, loop_program(system).digest())

    def variables(stored: Columns) -> Variables:
        origin = {**identity(system), **about, "seconds": seconds, "request": request}
        return *_columns(system, design, random, stored), origin

    with swept_file(
        function, [stage], variables, out=out, request=request, executor=executor, progress=progress
    ) as path:
        runs = _loaded(system, path)
    return SystemSweep(system, design, random, runs, None if out is None else path)


def _columns(
    system: System, design: Design, random: Mapping[str, Array], stored: Columns
) -> tuple[dict[str, int], dict[str, Column]]:
    """Return the dimensions and variables of the file."""
    count = len(system.costs)
    sizes, columns = axis_columns(design, lambda name: (unit_of(system, name), name))
    if random:
        run = SEED if SEED in random else "draw"
        sizes[run] = len(next(iter(random.values())))
        for name, values in random.items():
            columns[name] = Column(values, unit_of(system, name), name, (run,))
    for k, (name, cost) in enumerate(system.costs.items()):
        columns[name] = Column(stored(0, k), cost.unit, cost.meaning or name)
    stopped = np.array(_reasons(system))[stored(0, count).astype(int)]
    columns["run.stopped"] = Column(stopped, "", "why the run ended")
    columns["run.duration"] = Column(stored(0, count + 1), "s", "duration of the run")
    for k, (label, unit) in enumerate(zip(*_states(system), strict=True)):
        columns[label] = Column(stored(0, count + 2 + k), unit, "state at the end of the run")
    return sizes, columns


def _combined(design: Design, draws: Mapping[str, Array]) -> dict[str, Array]:
    return every_combination({name: design.points[:, k] for k, name in enumerate(design.names)}, draws)


def _check(system: System, names: tuple[str, ...], design: Design, random: Mapping[str, Array]) -> None:
    """Raise InputError for numbers that cannot be swept; nothing is compiled."""
    if not system.costs:
        raise InputError("has no costs", key="system", remedy="give System(..., costs={...})")
    if not names:
        raise InputError("nothing to sweep", key="axis", remedy="name at least one parameter")
    for name in names:
        if names.count(name) > 1:
            raise InputError("is given twice", key=name, remedy="give it once")
        if name == SEED and not system.blocks.noise:
            problem = "the system has no noise, so every seed gives the same run"
            raise InputError(problem, key=SEED, remedy="drop it, or draw numbers: plant.NAME=LOW..HIGH")
        if name in system.costs:
            raise InputError("is the name of a cost too", key=name, remedy="rename the cost")
        check_scalar(system, name)
    count = len(design.points) * max((len(values) for values in random.values()), default=1)
    if count > MOST_POINTS:
        raise InputError("are too many", key="runs", value=count, remedy=f"use at most {MOST_POINTS} in one sweep")


def _request(
    system: System, design: Design, seconds: float, names: tuple[str, ...], values: Mapping[str, Array]
) -> str:
    return request_digest(
        system, seconds, f"{names} {design.kind} {design.shape} {run_numbers(system, values).digest()}"
    )


def request_digest(system: System, seconds: float, about: str) -> str:
    """Return the SHA-256 of a system's computations and costs, of the duration of runs [s], and of further text."""
    costs = {name: (cost.how, cost.unit, cost.meaning, cost.at_most) for name, cost in system.costs.items()}
    head = f"surctl {__version__} {loop_program(system).digest()} {float(seconds).hex()}"
    return hashlib.sha256(f"{head} {costs} {list(system.stops)} {about}".encode()).hexdigest()


@dataclass(frozen=True, eq=False)
class _Evaluator:
    """Evaluator of a chunk: costs, reason of the end as its index, duration, and state at the end of each run."""

    system: System
    names: tuple[str, ...]
    seconds: float
    values: Mapping[str, Array]
    threads: int
    source: str
    digest: str

    def __call__(self, index: int, points: Array) -> Array:
        swept = {name: points[:, k] for k, name in enumerate(self.names)}
        runs = simulate_system(self.system, self.seconds, {**self.values, **swept}, threads=self.threads)
        reasons = _reasons(self.system)
        code = [reasons.index(reason) for reason in runs.stopped.tolist()]
        return np.column_stack([*runs.figures.values(), code, runs.time, runs.state])

    def __reduce__(self) -> tuple[Any, ...]:
        if not self.source:
            problem = "is known to this process alone"
            raise InputError(problem, key="system", remedy="give source, FILE.py:FUNCTION, for other processes")
        source = load_subject(self.source, key="source").reference
        return _elsewhere, (source, self.names, self.seconds, dict(self.values), self.threads, self.digest)


def _elsewhere(
    source: str, names: tuple[str, ...], seconds: float, values: Mapping[str, Array], threads: int, digest: str
) -> _Evaluator:
    """Return the evaluator in another process, which builds the system itself."""
    system = load_subject(source, key="source").system
    if loop_program(system).digest() != digest:
        raise SurctlError(f"{source.partition('#')[0]} returns another system than the one that is swept")
    return _Evaluator(system, names, seconds, values, threads, source, digest)


def _reasons(system: System) -> list[str]:
    return [ENDED, *system.stops, LOST]


def _states(system: System) -> tuple[list[str], list[str]]:
    return entry_labels(system.plant.state, "run.end."), entry_units(system.plant.state)


def _loaded(system: System, path: Path) -> Runs:
    import netCDF4

    with netCDF4.Dataset(path) as file:
        file.set_auto_mask(False)
        figures = {name: np.ravel(file[name][:]) for name in system.costs}
        state = np.column_stack([np.ravel(file[label][:]) for label in _states(system)[0]])
        stopped = np.ravel(file["run.stopped"][:]).astype(str)
        return Runs(figures, stopped, np.ravel(file["run.duration"][:]), state)
