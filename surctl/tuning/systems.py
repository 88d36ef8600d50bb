"""Tuning of any system: costs, bounds, cases, goals, least margins of the search; `best-so-far.csv`."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.assessment import Assessment, ClosedLoop, Line, Part, assess, worst_of
from surctl.errors import InputError, check_count, check_number, nearest
from surctl.ir.cache import find_compiler
from surctl.system import LinearLoop, System, every_combination, linearise, simulate_system
from surctl.system.loop import ENDED
from surctl.system.values import check_scalar, default_of, run_numbers
from surctl.tuning.cegis import tune
from surctl.tuning.chunked import Progress
from surctl.tuning.design import Span, random_draws
from surctl.tuning.goals import GOALS, NO_NUMBERS, RunGoal
from surctl.tuning.loop_goals import LoopGoal, judge_loops, operating_loops
from surctl.tuning.montecarlo import APART
from surctl.tuning.outcome import Tuned, check_finals
from surctl.tuning.pool import CAP, Condition, SearchRange, SearchRequest, Sets, row
from surctl.tuning.system_sweep import request_digest
from surctl.units import as_range
from surctl.verification.linear import LEAST_DISK_MARGIN

Array = NDArray[np.float64]

_POPULATION = 15  # gain sets of a generation per gain
_TINY = 1e-12  # stands for a bound of 0
_LOOPS = 10  # cases whose loops are assessed; each takes as long as many runs
_LASTING = "run.cut_short"  # 1 for a whole run; 2 for one that ends at its start


@dataclass(frozen=True)
class PointGoal(RunGoal):
    """A goal about the loop at operating points of a system; the metric is its normalised value.

    Attributes:
        points: names of the operating points.
        loop: the goal; None is not valid.
    """

    points: tuple[str, ...] = ()
    loop: LoopGoal | None = None

    @property
    def linear(self) -> bool:
        """Whether the metric describes the linear loop: always."""
        return True

    @property
    def columns(self) -> Mapping[str, float | None]:
        """Index of the operating point of each column."""
        return {f"{self.metric} {self.name} at {point}": float(k) for k, point in enumerate(self.points)}

    def place_text(self, place: float) -> str:
        """Return at which operating point the goal is worst, for a table."""
        return f"worst at {self.points[int(place)]}"

    def place_dict(self, place: float) -> dict[str, Any]:
        """Return the operating point as plain data for JSON."""
        return {"worst_point": self.points[int(place)]}


@dataclass(frozen=True)
class LeastCost(RunGoal):
    """A cost to minimise; its limit is the value with the start gains, infinite if these have none."""

    def normalised(self, values: Array) -> Array:
        """Return 1 for the value of the start gains, and less for lower costs; high values approach `CAP`."""
        start = self.limit if np.isfinite(self.limit) else 0.0
        share = 1 + (np.asarray(values, dtype=float) - start) / (abs(start) or 1.0)
        bent = CAP - (CAP / 2) ** 2 / np.maximum(share, CAP / 2)  # with the slope of the straight part
        return np.where(np.isnan(share), np.inf, np.where(share > CAP / 2, bent, share))


@dataclass(frozen=True, eq=False)
class SystemCase:
    """Numbers of one run of a tuned system by name, each with one row; see `run_numbers`."""

    name: str
    values: Mapping[str, Array]

    @property
    def known_as(self) -> tuple[str, ...]:
        """Names by which a goal may name it."""
        return (self.name,)


@dataclass(frozen=True, eq=False)
class SystemRequest(SearchRequest):
    """The request of a search for gains of a system; see `SearchRequest`.

    The numbers `plant` of a condition may be any of `run_numbers`.

    Attributes:
        base: the system.
        seconds: duration of its runs [s].
        points: numbers of its operating points, by name.
        case_values: numbers of its cases, by name.
    """

    base: System
    seconds: float = 0.0
    points: Mapping[str, Mapping[str, ArrayLike]] = field(default_factory=dict)
    case_values: Mapping[str, ArrayLike] = field(default_factory=dict)

    others: ClassVar[int] = 49  # the margins are checked at the end only, because they take longer than a run
    checked: ClassVar[int] = 50
    descends: ClassVar[bool] = False

    @property
    def start(self) -> Mapping[str, float]:
        """Return the system's own gains by name."""
        return {span.name: default_of(self.base, span.name) for span in self.space}

    @property
    def identity(self) -> list[str]:
        """Return lines with everything on which the figures of a gain set depend."""
        points = sorted((point, sorted(values.items())) for point, values in self.points.items())
        numbers = run_numbers(self.base, every_combination(self.start, self.numbers(self.conditions)))
        return [request_digest(self.base, self.seconds, f"{points} {numbers.digest()} {self.size}")]

    def numbers(self, conditions: Sequence[Condition]) -> dict[str, Array]:
        """Return the numbers of runs by name, a row for each condition."""
        noise = self.base.blocks.noise
        rows = [{**c.case.values, **({"seed": c.seed} if noise else {}), **c.plant} for c in conditions]
        names = dict.fromkeys(name for row in rows for name in row)
        return {name: np.array([row.get(name, default_of(self.base, name)) for row in rows]) for name in names}

    def figures(self, goals: Sequence[RunGoal], conditions: Sequence[Condition], sets: Sets) -> dict[str, Array]:
        """Return costs, normalised values of goals about the loop, and how much of each run is cut short."""
        count = len(next(iter(sets.values())))
        shape = (count, len(conditions))
        names = ("effort_n", *(name for goal in goals for name in goal.columns))
        table = {name: np.full(shape, 0.0 if name == "effort_n" else np.nan) for name in names}
        if self.base.costs:
            values = every_combination(sets, self.numbers(conditions))
            runs = simulate_system(self.base, self.seconds, values, threads=self.threads)
            whole = runs.stopped == ENDED
            measured = {name: np.where(whole, values, np.nan) for name, values in runs.figures.items()}
            measured[_LASTING] = np.where(whole, 1.0, 2 - runs.time / self.seconds)
            table |= {name: values.reshape(shape) for name, values in measured.items() if name in table}
        about = [goal for goal in goals if isinstance(goal, PointGoal)]
        for k in range(count) if about else ():
            loops = self.loops(row(sets, k))
            for goal in about:
                for name, point in zip(goal.columns, goal.points, strict=True):
                    if point in loops and goal.loop is not None:
                        table[name][k] = goal.loop.judge(loops[point]).normalised
        return table

    def loops(self, gains: Mapping[str, float]) -> Mapping[str, LinearLoop]:
        """Return the linear loop at each operating point that has an equilibrium with these gains."""
        loops = {}
        for name, values in self.points.items():
            with suppress(InputError):
                loops[name] = linearise(self.base, {**values, **gains})
        return loops

    def ending(self, condition: Condition, gains: Mapping[str, float]) -> str:
        """Return how and when the run of a condition ends with a gain set."""
        values: dict[str, Any] = {**self.numbers([condition]), **gains}
        runs = simulate_system(self.base, self.seconds, values)
        return f"{runs.stopped[0]} at {runs.time[0]:.6g} s"

    def fresh(self, *, runs: int, first: int) -> tuple[Condition, ...]:
        """Return runs with random numbers in the ranges of the system, and with the noise of other seeds."""
        spans = [Span(name, *ends) for name, ends in self.base.ranges.items() if ends[0] < ends[1]]
        if not (spans or self.base.blocks.noise):
            return ()
        conditions, counted = list[Condition](), tuple(g.name for g in self.goals if not isinstance(g, LeastCost))
        for k in range(runs):
            seed = self.seed * APART + first + k
            draws = random_draws(spans, count=1, seed=seed)
            plant = {name: float(value[0]) for name, value in draws.items()}
            conditions.append(Condition(self.cases[k % len(self.cases)], seed, plant, counted))
        return tuple(conditions)

    def assessed(
        self, gains: Mapping[str, float], parts: Collection[str] | None = None, computed: object = None
    ) -> Assessment:
        """Return what is assessed with these gains in all cases; with `parts`, of the loop alone."""
        seconds = self.seconds if parts is None and self.base.costs else None
        return assess_cases(self.base, self.case_values, gains, seconds=seconds)

    def costs(self, gains: Mapping[str, float]) -> dict[str, float]:
        """Return the costs with these gains as means over the cases; NaN if a run ends early."""
        about = [RunGoal(name, name, cost.unit, 1.0) for name, cost in self.base.costs.items()]
        runs = [condition for condition in self.conditions if condition.goals is None]
        table = self.figures(about, runs, {name: np.array([value]) for name, value in gains.items()})
        return {goal.name: float(table[goal.name].mean()) for goal in about}

    def scores(self, gains: Mapping[str, float]) -> list[str]:
        """Return a line for each goal about the loop at its worst point; none without an equilibrium at all points."""
        about = [goal.loop for goal in self.goals if isinstance(goal, PointGoal) and goal.loop is not None]
        loops = self.loops(gains) if about else {}
        return judge_loops(about, loops).lines() if len(loops) == len(self.points) else []

    def so_far(self, gains: Mapping[str, float], warning: str) -> tuple[str, str]:
        """Return name and text of the table with the best gains of an unfinished tuning."""
        values = {**self.start, **gains}
        return SO_FAR, ",".join(values) + "\n" + ",".join(map(repr, values.values())) + "\n"


SO_FAR = "best-so-far.csv"
"""Name of the table with the best gains of an unfinished tuning of a system."""


def system_request(
    system: System,
    seconds: float,
    ranges: Mapping[str, tuple[float, float]],
    *,
    cases: Mapping[str, ArrayLike] = NO_NUMBERS,
    objective: str | None = None,
    trials: int = 1024,
    seed: int = 0,
    threads: int = 1,
    goals: Sequence[LoopGoal] = (),
    points: Mapping[str, Mapping[str, ArrayLike]] = NO_NUMBERS,
    run_goals: Sequence[RunGoal] = (),
) -> SystemRequest:
    """Return the request of `tune_system`; only the start gains are simulated.

    Raises:
        InputError: as in `tune_system`.
    """
    check_count("trials", trials, least=1)
    check_count("seed", seed)
    name = _checked(system, ranges, cases, objective, (*goals, *run_goals))
    for point, values in points.items():
        for gain in values.keys() & ranges.keys():
            remedy = f"drop it from the point; {gain} has one value at all points"
            raise InputError("is searched", key=f"point {point}", value=gain, remedy=remedy)
    points = dict(points) or {"nominal": {}}
    if goals:
        judge_loops(goals, operating_loops(system, points))  # reports unknown signals before the search
    about = [PointGoal(g.name, "loop_goal", "1", 1.0, "at most", g.kind, points=g.points or tuple(points), loop=g)
             for g in goals]  # fmt: skip
    bounded = {name: cost for name, cost in system.costs.items() if cost.at_most is not None}
    bounds = [RunGoal(n, n, c.unit, c.at_most or _TINY, kind="hard") for n, c in bounded.items()]
    bounds += [RunGoal("whole run", _LASTING, "1", 1.0, kind="hard")] * bool(system.costs)
    space = tuple(SearchRange(gain, *map(float, ends)) for gain, ends in ranges.items())
    size = max(5, min(_POPULATION * len(space), trials))
    stated = (replace(goal, over="mean" if goal.kind == "soft" else "worst") for goal in run_goals)
    every = (*about, *stated, *bounds)
    request = SystemRequest(every, _conditions(cases), system, space, seed, (), threads, size, seconds, points, cases)
    if name == GOALS:
        return request
    least = LeastCost(f"least {name}", name, system.costs[name].unit, np.inf, over="mean")
    value = request.costs(request.start)[name]
    return replace(request, goals=(*every, replace(least, limit=np.inf if np.isnan(value) else value)))


def _conditions(cases: Mapping[str, ArrayLike]) -> tuple[Condition, ...]:
    arrays = {name: np.asarray(value, dtype=float) for name, value in cases.items()}
    count = max((len(array) for array in arrays.values() if array.ndim), default=1)
    conditions = []
    for k in range(count):
        values = {name: array[min(k, len(array) - 1)] if array.ndim else array for name, array in arrays.items()}
        seed = int(values.pop("seed", np.array(0.0)))
        listed = [f"{name} = {value:g}" for name, value in values.items() if arrays[name].shape == (count,)]
        label = (f"case {k + 1}" + f" ({', '.join(listed)})" * bool(listed)) if count > 1 else "the run"
        conditions.append(Condition(SystemCase(label, values), seed))
    return tuple(conditions)


def margin_goals(system: System, least_disk_margin: float = LEAST_DISK_MARGIN) -> tuple[RunGoal, ...]:
    """Return the goals on disk margin and delay margin of the assessment, which a search checks at its end."""
    disk = RunGoal("disk margin", "disk_margin", "1", least_disk_margin, "at least", "hard")
    delay = RunGoal("delay margin", "delay_margin_s", "s", float(system.dt), "at least", "hard")
    return (disk, delay) if least_disk_margin > 0 else (delay,)


def tune_system(
    system: System,
    seconds: float,
    ranges: Mapping[str, tuple[float, float]],
    *,
    cases: Mapping[str, ArrayLike] = NO_NUMBERS,
    objective: str | None = None,
    trials: int = 1024,
    least_disk_margin: float = LEAST_DISK_MARGIN,
    seed: int = 0,
    threads: int = 1,
    out: Path | None = None,
    goals: Sequence[LoopGoal] = (),
    points: Mapping[str, Mapping[str, ArrayLike]] = NO_NUMBERS,
    run_goals: Sequence[RunGoal] = (),
    rounds: int = 1,
    runs: int = 0,
    progress: Progress = lambda _: None,
) -> Tuned:
    """Search gains that minimise a cost of a system, by differential evolution over compiled runs.

    With soft `goals`, the largest normalised value of them is minimised instead, as `systune` does; costs with a bound
    keep it. Hard goals are bounds.

    A gain set is feasible if, in every case, no run ends early, every cost is at most its bound (`Cost.at_most`), the
    disk margin is at least `least_disk_margin`, and the delay margin at least one control period. The system's own
    gains are the first set. The margins are computed only for the sets with the least cost, because their computation
    takes longer than a run.

    Args:
        system: the closed loop.
        seconds: duration of a run [s].
        ranges: search range (low, high) of each tuned gain, by name; `K[0]` is an entry of a port. A range of positive
            numbers is searched on a log scale.
        cases: numbers of the runs of every gain set (see `run_numbers`), such as initial states; default: one run with
            the numbers of the system. The minimised cost and soft goals are means over the cases.
        objective: cost to minimise; default: the first cost of the system.
        trials: number of gain sets, rounded up to whole batches.
        least_disk_margin: least disk margin of all loops at once, at commands or measurements, at the worst corner of
            the ranges that the system declares; 0 for no bound.
        seed: seed of the search.
        threads: number of threads that share the runs.
        out: folder in which finished gain sets are stored, so that an identical call resumes an interrupted search,
            also with more trials; None stores nothing.
        goals: goals about the loop.
        points: operating points of the goals, by name, as in `operating_loops`.
        run_goals: goals about costs of the runs.
        rounds, runs: as for `tune`: random runs in the ranges of the system, and with noise of other seeds, test the
            gains; the next round keeps the goals in the runs that refuted them.
        progress: function that receives one line of text at each step of the work.

    Raises:
        InputError: there is neither a cost nor a soft goal, no gain is named, a name is unknown, a range is not valid,
            or the folder cannot be written; see also `run_numbers`.
        ToolMissing: there is no C compiler.

    Example:
        >>> from surctl.system import Cost
        >>> from surctl.testing import cart_system
        >>> from surctl.tuning import tune_system
        >>> cost = Cost(lambda s: s.x["speed"] ** 2 + 0.1 * s.f["force"] ** 2, "integral", "m^2/s")
        >>> tuned = tune_system(cart_system(costs={"cost": cost}), 5.0, {"k": (0.2, 8.0)}, trials=90)
        >>> 2.5 < tuned.gains["k"] < 3.0, tuned.unmet
        (True, ())
    """
    request = system_request(
        system, seconds, ranges, cases=cases, objective=objective, trials=trials, seed=seed, threads=threads,
        goals=goals, points=points, run_goals=run_goals,
    )  # fmt: skip
    check_number("least_disk_margin", least_disk_margin, unit="a ratio", zero=True)
    tuning = tune(request, trials=trials, rounds=rounds, runs=runs, folder=out, progress=progress)
    finals = margin_goals(system, least_disk_margin)
    return check_finals(tuning, finals, request.assessed, default=finals, progress=progress)


def assess_cases(
    system: System, cases: Mapping[str, ArrayLike], gains: Mapping[str, float], *, seconds: float | None = None
) -> Assessment:
    """Return what is assessed of a system with these gains in all cases: of each figure the worst, and every line.

    Margins are judged in at most 10 cases whose loops differ; a remark counts the others.

    Args:
        system: the closed loop.
        cases: numbers of the cases, as in `tune_system`.
        gains: the gains by name.
        seconds: duration of a run [s]; None: the loop alone.
    """
    loops, named, omitted = dict[tuple[bytes, ...], Part](), dict[str, Assessment](), 0
    for condition in _conditions(cases):
        case = condition.case
        values = {name: value[None] if value.ndim else value for name, value in case.values.items()}
        # the loop does not depend on where a run starts, nor on its noise
        about = {name: value for name, value in values.items() if not name.startswith("start.")}
        key = tuple(value.tobytes() for value in about.values())
        if key not in loops and len(loops) < _LOOPS:
            named[case.name] = assess(ClosedLoop(system, {**about, **gains}, seconds=seconds), parts=["loop"])
            loops[key] = named[case.name].parts["loop"]
        omitted += key not in loops
        if seconds is not None:
            noise = {"seed": condition.seed} if system.blocks.noise else {}
            subject = ClosedLoop(system, {**values, **noise, **gains}, seconds=seconds)
            known = {"loop": loops[key]} if key in loops else {}
            named[case.name] = assess(subject, parts=None if known else ["run"], computed=known)
    result = worst_of(named)
    if not omitted:
        return result
    text = f"margins: judged in {_LOOPS} cases with different loops; {omitted} others have loops of their own"
    return replace(result, lines=(*result.lines, Line(None, text, "margins", counts=False)))


def _checked(
    system: System,
    ranges: Mapping[str, tuple[float, float]],
    cases: Mapping[str, ArrayLike],
    objective: str | None,
    goals: Sequence[LoopGoal | RunGoal],
) -> str:
    """Return the name of what is minimised, a cost or `GOALS`, after a check of the arguments; nothing is compiled."""
    soft = any(goal.kind == "soft" for goal in goals)
    name = (GOALS if soft else next(iter(system.costs), "")) if objective is None else objective
    if name not in system.costs and not (soft and name == GOALS):
        problem = "has no costs" if not system.costs else "no such cost"
        remedy = "give System(..., costs={...}) or a soft goal" if not system.costs else nearest(name, system.costs)
        raise InputError(problem, key="objective", value=objective, remedy=remedy)
    if not isinstance(cast("object", ranges), Mapping) or not ranges:
        raise InputError("nothing is tuned", key="ranges", value=ranges, remedy='write {"k": (1, 4)}')
    for gain, ends in ranges.items():
        low, high = as_range(ends, key=gain)
        if low == high:
            raise InputError("is not a range", key=gain, value=(low, high), remedy="give (low, high) with low < high")
        if gain.startswith(("plant.", "reference.", "disturbance.", "start.")):
            raise InputError("is not a gain", key=gain, remedy="tune gains of the controller; put it into the cases")
        if gain in cases:
            raise InputError(
                "is both a tuned gain and a value of the cases", key=gain, remedy="keep it out of one of them"
            )
        check_scalar(system, gain)
    run_numbers(system, every_combination({gain: ends[0] for gain, ends in ranges.items()}, cases))
    if system.costs:  # its runs are compiled
        find_compiler()
    return name
