"""Grid sweep over two gains: closed-loop metrics and linear margins at every point, and the point that is picked."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from surctl.control import GAINS, Gains, build_law
from surctl.control.build import LawName
from surctl.errors import InputError, nearest
from surctl.ir import lower
from surctl.simulation import Scenario, Sensing, simulate
from surctl.tuning.store import Store
from surctl.vehicle import Vehicle
from surctl.verification import loop_margins

__all__ = ["COLUMNS", "DELAY_FLOOR", "DISK_FLOOR", "Axis", "Flight", "Sweep", "sweep"]

MEASURED: Mapping[str, str] = {
    "deviation_m": "m",
    "path_error_m": "m",
    "time_s": "s",
    "min_clearance_m": "m",
    "effort_n": "N",
    "delay_margin_s": "s",
    "disk_margin": "1",
    "strayed": "1",
    "time_ratio": "1",
    "arrived": "1",
}
"""What is measured at a point, with units: means over the flights, least clearance and margins, mean deviation in hull
radii, largest time over ideal time, and whether every flight arrived."""

COLUMNS: Mapping[str, str] = {**MEASURED, "score": "1", "feasible": "1"}
"""The table's columns with their units: what is measured, and what follows from it."""

DELAY_FLOOR = 0.2  # [s] least delay margin of a point that may be picked: four control periods (*chosen*)
DISK_FLOOR = 0.6  # least disk margin of a point that may be picked: 33° and a factor 1.86 at once (*chosen*)


@dataclass(frozen=True)
class Axis:
    """One swept gain and its values, ascending.

    Raises:
        InputError: unknown gain, fewer than two values, values that do not ascend, or one out of its bounds.
    """

    name: str
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        if self.name not in GAINS:
            raise InputError("no such gain", key="axis", value=self.name, remedy=nearest(self.name, GAINS))
        values = tuple(float(v) for v in self.values)
        if len(values) < 2 or any(not b > a for a, b in pairwise(values)):
            raise InputError(
                "needs at least two values in ascending order",
                key=f"axis {self.name}",
                value=values,
                remedy="sort them",
            )
        object.__setattr__(self, "values", values)

    @property
    def unit(self) -> str:
        """Unit of the gain."""
        return GAINS[self.name].unit


@dataclass(frozen=True)
class Flight:
    """One closed-loop run that every point of a sweep flies."""

    scenario: Scenario
    vehicle: Vehicle
    seed: int = 0
    sensing: Sensing = "truth"


@dataclass(frozen=True, eq=False)
class Sweep:
    """A finished sweep.

    Attributes:
        axes: the two gains.
        table: column name → (len(axes[0]), len(axes[1])); see `COLUMNS`.
        picked: grid index of the feasible point with the least score (mean deviation in hull radii plus the slowest
            flight's time over its ideal time); None when no point is feasible.
        gains: the base gains with the picked values; the base itself when nothing is feasible.
        scenarios: what every point flew.
    """

    axes: tuple[Axis, Axis]
    table: Mapping[str, NDArray[np.float64]] = field(repr=False)
    picked: tuple[int, int] | None
    gains: Gains
    scenarios: tuple[str, ...]

    columns = tuple(COLUMNS)
    units = COLUMNS

    def column(self, name: str) -> NDArray[np.float64]:
        """One column on the grid; InputError with the nearest known name."""
        if name not in self.table:
            raise InputError("no such column", key="column", value=name, remedy=nearest(name, self.table))
        return self.table[name]


def sweep(
    gains: Gains,
    axes: tuple[Axis, Axis],
    *,
    flights: Sequence[Flight],
    law: LawName = "guarded",
    workers: int = 2,
    store: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Sweep:
    """Fly every flight at every point of the grid.

    Args:
        gains: all other gains.
        axes: two different gains.
        flights: at least one.
        law: the law that is flown, closed form.
        workers: processes; the result does not depend on their number.
        store: CSV file that each finished point is appended to; a sweep of the same request resumes from it.
        progress: called with (points done, points in all).

    Raises:
        InputError: the same gain twice, no flight, a value out of its bounds, or a store that cannot be written.
    """
    if axes[0].name == axes[1].name:
        raise InputError("is swept twice", key="axis", value=axes[0].name, remedy="name two different gains")
    if not flights:
        raise InputError("has nothing to fly", key="sweep", remedy="name at least one scenario")
    grid = [(i, j) for i in range(len(axes[0].values)) for j in range(len(axes[1].values))]
    sets = {
        (i, j): gains.with_values({axes[0].name: axes[0].values[i], axes[1].name: axes[1].values[j]}) for i, j in grid
    }
    shelf = Store(store, request=_request(gains, axes, flights, law), columns=tuple(MEASURED))
    done = shelf.load()
    todo = [point for point in grid if point not in done]
    if progress:
        progress(len(done), len(grid))
    for point, row in _evaluate(todo, sets, flights, law, workers):
        done[point] = row
        shelf.append(point, row)
        if progress:
            progress(len(done), len(grid))
    shape = (len(axes[0].values), len(axes[1].values))
    table = _judged({name: np.array([done[p][k] for p in grid]).reshape(shape) for k, name in enumerate(MEASURED)})
    picked = _pick(table)
    return Sweep(axes, table, picked, _picked_gains(gains, sets, picked, axes), tuple(f.scenario.name for f in flights))


def _evaluate(
    todo: Sequence[tuple[int, int]],
    sets: Mapping[tuple[int, int], Gains],
    flights: Sequence[Flight],
    law: LawName,
    workers: int,
) -> Iterator[tuple[tuple[int, int], tuple[float, ...]]]:
    if workers <= 1 or len(todo) <= 1:
        for point in todo:
            yield point, _fly_point(sets[point], tuple(flights), law)
        return
    with ProcessPoolExecutor(
        min(workers, len(todo)),
        mp_context=get_context("spawn"),  # a forked child would inherit the locks of numerical libraries
        initializer=signal.signal,
        initargs=(signal.SIGINT, signal.SIG_IGN),  # Ctrl-C is the parent's affair
    ) as pool:
        jobs = {pool.submit(_fly_point, sets[point], tuple(flights), law): point for point in todo}
        try:
            for job in as_completed(jobs):
                yield jobs[job], job.result()
        finally:
            for job in jobs:
                job.cancel()


def _fly_point(gains: Gains, flights: tuple[Flight, ...], law: LawName) -> tuple[float, ...]:
    """What is measured at one point, in the order of `MEASURED`."""
    built = build_law(law)
    runs = [
        simulate(f.scenario, f.vehicle, gains=gains, law=built, sensing=f.sensing, seed=f.seed).metrics for f in flights
    ]
    fastest = {(f.vehicle.source, f.vehicle.name): f for f in sorted(flights, key=lambda f: f.scenario.cruise)}
    margins = [
        m
        for f in fastest.values()
        for m in loop_margins(f.vehicle, gains.values, cruise=f.scenario.cruise, dt=built.dt)
    ]
    # a run that is one long avoidance has no path error
    errors = [r.path_error_m for r in runs if np.isfinite(r.path_error_m)]
    ideal = [f.scenario.path.length / f.scenario.cruise for f in flights]
    return (
        float(np.mean([r.deviation_m for r in runs])),
        float(np.mean(errors)) if errors else float("nan"),
        float(np.mean([r.time_s for r in runs])),
        min(r.min_clearance_m for r in runs),
        float(np.mean([r.effort_n for r in runs])),
        min(m.delay_margin_s for m in margins),
        min(m.disk_margin for m in margins),
        float(np.mean([r.deviation_m / f.vehicle["radius"] for r, f in zip(runs, flights, strict=True)])),
        max(r.time_s / t for r, t in zip(runs, ideal, strict=True)),
        float(all(r.reached for r in runs)),
    )


def _judged(measured: Mapping[str, NDArray[np.float64]]) -> dict[str, NDArray[np.float64]]:
    """The table with score and feasibility. The path error is not in the score: it counts only what lies outside
    avoidance, and the gains change how much that is."""
    feasible = (
        (measured["arrived"] > 0.5)
        & (measured["min_clearance_m"] > 0)
        & (measured["delay_margin_s"] >= DELAY_FLOOR)
        & (measured["disk_margin"] >= DISK_FLOOR)
    )
    score = measured["strayed"] + measured["time_ratio"]
    return {**measured, "score": score, "feasible": feasible.astype(float)}


def _pick(table: Mapping[str, NDArray[np.float64]]) -> tuple[int, int] | None:
    score = np.where(table["feasible"] > 0.5, table["score"], np.inf)
    if not np.isfinite(score).any():
        return None
    i, j = np.unravel_index(int(np.argmin(score)), score.shape)
    return int(i), int(j)


def _picked_gains(
    gains: Gains, sets: Mapping[tuple[int, int], Gains], picked: tuple[int, int] | None, axes: tuple[Axis, Axis]
) -> Gains:
    if picked is None:
        return gains
    chosen = {axis.name: axis.values[k] for axis, k in zip(axes, picked, strict=True)}
    what = ", ".join(f"{name} = {value:g}" for name, value in chosen.items())
    return sets[picked].with_values({}, provenance=f"{gains.provenance}; picked by a grid sweep: {what}")


def _request(gains: Gains, axes: tuple[Axis, Axis], flights: Sequence[Flight], law: LawName) -> str:
    """Everything that the result depends on, as text."""
    lines = [f"law {lower(build_law(law).function).digest()}", f"axes {axes!r}", f"gains {dict(gains.values)!r}"]
    lines += [f"flight {f.scenario!r} {dict(f.vehicle.parameters)!r} {f.seed} {f.sensing}" for f in flights]
    return "\n".join(lines)
