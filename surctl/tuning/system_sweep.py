"""A system as the subject of a sweep: its costs at every point, each over the same random runs, and the best points."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl import __version__
from surctl.assessment import Assessment, ClosedLoop, Line, assess, cost_verdicts, step_lines
from surctl.errors import InputError, SurctlError
from surctl.recorded_write import Column
from surctl.system import (
    LOST,
    Runs,
    System,
    entry_labels,
    entry_units,
    every_combination,
    periods,
    run_system,
    simulate_system,
)
from surctl.system.loop import ENDED
from surctl.system.record import identity
from surctl.system.runs import loop_program
from surctl.system.subjects import load_subject
from surctl.system.values import check_scalar, run_numbers, unit_of
from surctl.tuning.chunked import Columns, SweepStage, chunk_size
from surctl.tuning.design import MOST_POINTS, ONE_POINT, SEED, Axis, Design, Span, make_design, random_draws, saltelli
from surctl.tuning.sweep import SweepSubject, SweepTable

Array = NDArray[np.float64]

_NONE: Mapping[str, Any] = MappingProxyType({})
_LEAST, _MOST = 64, 4096  # runs in a chunk
_STOPPED, _DURATION, _END = "run.stopped", "run.duration", "run.end."


@dataclass(frozen=True, eq=False)
class SystemSweep(SweepSubject):
    """Runs of a system, as the subject of `sweep`: the costs, how each run ends, and the state at its end.

    Attributes:
        system: the closed loop.
        seconds: duration [s] of a run that no stop ends earlier.
        random: (m,) numbers of the m runs at each point, by name, such as seeds; see also `random_draws`.
        values: numbers of all runs by name, see `run_numbers`.
        threads: number of threads that share the runs of a chunk.
        about: further texts of the file by name, such as the origin of the system.
        source: FILE.py:FUNCTION or subject:NAME that returns the system, for an executor with other processes.

    Raises:
        InputError: when it is swept, if the system has no costs, a name is unknown or not that of one number, there are
            too many runs, or other processes need `source`.
        ToolMissing: when it is swept, if there is no C compiler.
    """

    system: System
    seconds: float
    random: Mapping[str, ArrayLike] = field(default_factory=dict)
    values: Mapping[str, ArrayLike] = field(default_factory=dict)
    threads: int = 1
    about: Mapping[str, str] = field(default_factory=dict)
    source: str = ""

    def draws(self) -> dict[str, Array]:
        """Return the numbers (m,) in which the m runs of a point differ, by name."""
        return {name: np.asarray(value, dtype=float) for name, value in self.random.items()}

    def stages(self, design: Design) -> list[SweepStage]:
        """Return the runs of all points, after a check of their numbers; nothing is compiled."""
        names = (*design.names, *self.random)
        _check(self.system, names, design, self.draws())
        periods(self.system, self.seconds)
        combined = self._combined(design)
        rows = np.column_stack([combined[name] for name in names])
        width = len(self.system.costs) + 2 + self.system.plant.state.size
        return [SweepStage(names, rows, max(_LEAST, chunk_size(len(rows), most=_MOST)), width, counted="runs")]

    def _combined(self, design: Design) -> dict[str, Array]:
        return every_combination({name: design.points[:, k] for k, name in enumerate(design.names)}, self.draws())

    def evaluate(self, stage: int, index: int, values: Mapping[str, Array]) -> Array:
        """Return costs, reason of the end as its index, duration, and state at the end of each run."""
        runs = simulate_system(self.system, self.seconds, {**self.values, **values}, threads=self.threads)
        reasons = _reasons(self.system)
        code = [reasons.index(reason) for reason in runs.stopped.tolist()]
        return np.column_stack([*runs.figures.values(), code, runs.time, runs.state])

    def request(self, design: Design, stages: Sequence[SweepStage]) -> str:
        """Return the SHA-256 of everything that the results depend on."""
        numbers = run_numbers(self.system, {**self.values, **self._combined(design)})
        about = f"{stages[-1].names} {design.kind} {design.shape} {numbers.digest()}"
        return request_digest(self.system, self.seconds, about)

    def quantity(self, name: str) -> tuple[str, str]:
        """Return unit and meaning of a number."""
        return unit_of(self.system, name), name

    def columns(self, design: Design, stored: Columns, dimensions: Sequence[str]) -> Iterator[tuple[str, Column]]:
        """Yield costs, how each run ends, and the state at its end."""
        count = len(self.system.costs)
        for k, (name, cost) in enumerate(self.system.costs.items()):
            yield name, Column(stored(0, k), cost.unit, cost.meaning or name)
        yield _STOPPED, Column(np.array(_reasons(self.system))[stored(0, count).astype(int)], "", "why the run ended")
        yield _DURATION, Column(stored(0, count + 1), "s", "duration of the run")
        state = self.system.plant.state
        for k, (label, unit) in enumerate(zip(entry_labels(state, _END), entry_units(state), strict=True)):
            yield label, Column(stored(0, count + 2 + k), unit, "state at the end of the run")

    def origin(self, design: Design) -> dict[str, Any]:
        """Return names, digests and duration."""
        return {**identity(self.system), **self.about, "seconds": self.seconds}

    def __reduce__(self) -> tuple[Any, ...]:
        if not self.source:
            problem = "is known to this process alone"
            raise InputError(problem, key="system", remedy="give source, FILE.py:FUNCTION, for other processes")
        source = load_subject(self.source, key="source").reference
        digest = loop_program(self.system).digest()
        return _elsewhere, (source, self.seconds, dict(self.values), self.threads, digest)


def _elsewhere(source: str, seconds: float, values: Mapping[str, ArrayLike], threads: int, digest: str) -> SystemSweep:
    """Return the subject in another process, which builds the system itself."""
    system = load_subject(source, key="source").system
    if loop_program(system).digest() != digest:
        raise SurctlError(f"{source.partition('#')[0]} returns another system than the one that is swept")
    return SystemSweep(system, seconds, values=values, threads=threads, source=source)


def choices_and_draws(
    system: System, axes: Sequence[Axis | Span], *, design: str = "grid", points: int | None = None, seeds: int = 1
) -> tuple[Design, dict[str, Array]]:
    """Return the points of a sweep, and the numbers of the runs at each point.

    Seeds are numbers of runs. If a grid has several runs at each point, a range without a count is random as well,
    unless it is that of a gain.

    Raises:
        InputError: the system has nothing random, an axis is not valid, or its name is not that of one
            number.
    """
    for axis in axes:
        check_scalar(system, axis.name)
    listed = [axis for axis in axes if axis.name == SEED]
    if listed and (seeds > 1 or not isinstance(listed[0], Axis)):
        problem = "is given twice" if seeds > 1 else "is a range without a count"
        raise InputError(problem, key="axis seed", remedy="write --seeds N for the seeds 0 to N-1")
    numbers = np.array(listed[0].values if listed and isinstance(listed[0], Axis) else range(seeds), dtype=float)
    random = [a for a in axes if isinstance(a, Span) and design == "grid" and len(numbers) > 1 and "." in a.name]
    others = [axis for axis in axes if axis not in random and axis not in listed]
    draws = {SEED: numbers} if system.blocks.noise and (listed or seeds > 1) else {}
    draws |= random_draws(random, count=len(numbers)) if random else {}
    if seeds > 1 and not draws:
        problem, remedy = "has no noise", "draw a number as well: plant.NAME=LOW..HIGH or start.NAME=LOW..HIGH"
        raise InputError(problem, key="--seeds", value=seeds, remedy=remedy)
    if design == "saltelli":
        return saltelli(others, base=64 if points is None else points), draws
    if draws and not others and points is None:
        return ONE_POINT, draws
    return make_design(design, others, count=points), draws


def runs_of(table: SweepTable, system: System) -> Runs:
    """Return all runs of a sweep of a system, those of a point one after another.

    Raises:
        InputError: the table is not that of a sweep of this system.
    """
    state = np.column_stack([table.column(label).ravel() for label in entry_labels(system.plant.state, _END)])
    figures = {name: table.column(name).ravel() for name in system.costs}
    stopped, duration = table.column(_STOPPED).ravel(), table.column(_DURATION).ravel()
    return Runs(figures, stopped.astype(str), duration, state)


def run_at(table: SweepTable, run: int) -> tuple[dict[str, float], dict[str, float]]:
    """Return the numbers of the point of a run, and its random numbers, by name."""
    point, k = divmod(run, table.each)
    random = {name: float(values[k]) for name, values in table.draws.items()}
    return table.at(table.index(point)), random


_REPEATED = 20_000  # largest number of control periods of a run that is repeated with all its numbers
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
    table: SweepTable,
    system: System,
    values: Mapping[str, ArrayLike] = _NONE,
    ranges: Mapping[str, tuple[float, float]] | None = None,
) -> dict[str, Choice]:
    """Return for each cost the point with its least value at which the bounds of all costs and the margins hold.

    The margins of at most 16 points per cost are judged, the least cost first.

    Args:
        table: the sweep.
        system, values, ranges: as in `ClosedLoop`; the numbers of a point take the place of `values`.
    """
    judged, durations, ends = dict[int, Assessment](), table.column(_DURATION).reshape(-1), table.column(_STOPPED)
    early = (ends != ENDED).reshape(-1, table.each)
    costs = {name: table.worst(name).reshape(-1) for name in system.costs}
    bounded = np.all([costs[n] <= c.at_most for n, c in system.costs.items() if c.at_most is not None], axis=0)
    bounded = np.broadcast_to(bounded, len(early)) & ~early.any(axis=1)

    def assessed(run: int) -> Assessment:
        if run not in judged:
            at, random = run_at(table, run)
            numbers = {**values, **at, **random}
            loop = assess(ClosedLoop(system, numbers, ranges), parts=["loop"])
            point, duration = run // table.each, float(durations[run])
            stopped = np.flatnonzero(early[point])[:1] + point * table.each
            why = [f"the run stops after {durations[k]:.6g} s ({ends.reshape(-1)[k]})" for k in stopped]
            lines = [Line(False, text, "run") for text in why]
            for name, cost in system.costs.items():
                value = float(costs[name][point])
                lines += cost_verdicts(name, cost, value, duration=duration, dt=system.dt)
            seconds = np.clip(duration, system.dt, _REPEATED * system.dt)
            lines += step_lines(run_system(system, float(seconds), numbers))
            judged[run] = loop.with_lines(lines)
        return judged[run]

    choices = {}
    for name, worst in costs.items():
        order = [k for k in np.argsort(worst, kind="stable").tolist() if np.isfinite(worst[k])]
        if not order:
            continue
        # of the run with the largest value; a run without a value is larger
        worst_runs = table.column(name).reshape(-1, table.each).argmax(axis=1)
        runs = {k: k * table.each + int(worst_runs[k]) for k in order}
        tried = [k for k in order if bounded[k]][:_JUDGED]
        point = next((k for k in tried if assessed(runs[k]).accepted()), order[0])
        choices[name] = Choice(point, runs[point], assessed(runs[point]), order.index(point))
    return choices


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


def request_digest(system: System, seconds: float, about: str) -> str:
    """Return the SHA-256 of a system's computations and costs, of the duration of runs [s], and of further text."""
    costs = {name: (cost.how, cost.unit, cost.meaning, cost.at_most) for name, cost in system.costs.items()}
    head = f"surctl {__version__} {loop_program(system).digest()} {float(seconds).hex()}"
    return hashlib.sha256(f"{head} {costs} {list(system.stops)} {about}".encode()).hexdigest()


def _reasons(system: System) -> list[str]:
    return [ENDED, *system.stops, LOST]
