"""Tuning of any system: minimise one cost over the gains, with bounds on the other costs and the disk margin."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.assessment import Assessment, ClosedLoop, Figure, assess, worst_of
from surctl.errors import InputError, nearest
from surctl.system import ENDED, System, every_combination, simulate_system
from surctl.system.values import check_scalar, run_numbers
from surctl.tuning.goals import GOALS, NO_POINTS, GoalSearch, RunGoal
from surctl.tuning.loop_goals import LoopGoal
from surctl.tuning.loop_scores import LoopScores
from surctl.tuning.search import Batches, Journal, SearchRange, evolve
from surctl.tuning.system_sweep import request_digest
from surctl.verification.linear import LEAST_DISK_MARGIN

Array: TypeAlias = NDArray[np.float64]

_POPULATION = 15  # gain sets of a generation per gain
_EXAMINED = 50  # most gain sets whose disk margin is computed, cheapest first
_MARGINS = {"disk_margin": "disk margin", "delay_margin_s": "delay margin"}
_TINY = 1e-12  # a bound of 0 is compared with this number
_MOST = 1e6  # larger excesses over bounds count alike
_WORSE = 1e9  # cost from which a gain set counts as one that breaks a bound


@dataclass(frozen=True)
class SystemTuning:
    """The result of `tune_system`.

    Attributes:
        objective: name of the minimised cost, or `GOALS` for the largest normalised value of the soft goals.
        gains: the chosen gains by name; if no gain set satisfies all bounds, the gains that are nearest to the bounds.
        costs: costs of the chosen gains as means over the cases; infinite if a run ends early.
        worst: the same costs, each in its worst case: bounds and hard goals are about these.
        before: costs of the system's own gains, as means.
        margins: disk margin of all loops at once and least delay margin, at the worst corners of the ranges that the
            system declares and in the worst case, with what is required; none if the loop has no equilibrium there.
        least_disk_margin: bound of the disk margin.
        trials: number of gain sets simulated.
        unmet: names of the bounds that the chosen gains break; empty if the tuning succeeded.
        goals, goals_before: scores of the goals with the chosen gains and with the system's own gains; None without
            goals.
        run_goals: the goals about costs of the runs.
        restored: how many of the gain sets an interrupted search had simulated.
    """

    objective: str
    gains: Mapping[str, float]
    costs: Mapping[str, float]
    worst: Mapping[str, float]
    before: Mapping[str, float]
    margins: tuple[Figure, ...]
    least_disk_margin: float
    trials: int
    unmet: tuple[str, ...]
    goals: LoopScores | None = None
    goals_before: LoopScores | None = None
    run_goals: tuple[RunGoal, ...] = ()
    restored: int = 0

    def lines(self, system: System) -> list[str]:
        """Return lines of text: gains, costs with bounds, goals, and disk margin; `system` is the tuned one."""
        lines = [f"{name} = {value:.6g}" for name, value in self.gains.items()]
        for name, cost in system.costs.items():
            bound = "" if cost.at_most is None else f", at most {cost.at_most:g}"
            what = "minimised" if name == self.objective else "not bounded" if cost.at_most is None else "bounded"
            known = math.isfinite(self.costs[name])
            value = f"{self.costs[name]:.6g} {cost.unit}" if known else "none, because a run is not finite"
            value += f", {self.worst[name]:.6g} in the worst case" * (known and self.worst[name] != self.costs[name])
            lines.append(f"{self._mark(name)}{name}: {value} (before {self.before[name]:.6g}), {what}{bound}")
        lines += [] if self.goals is None else self.goals.lines()
        for goal in self.run_goals:
            hard = goal.kind == "hard"
            reached, before = (self.worst if hard else self.costs)[goal.metric], self.before[goal.metric]
            share = float(goal.normalised(np.array(reached)))
            text = f"{reached:.4g} {goal.unit} for {goal.limit:.4g} (before {before:.4g}), run"
            lines.append(f"{'met    ' if share <= 1 else 'NOT MET'} {goal.name} ({goal.kind}): {share:.3f}, {text}")
        for one in self.margins:
            name, unit = _MARGINS[one.name], "" if one.unit == "1" else f" {one.unit}"
            what = f"{name} at the worst corner: {one.value:.3f}{unit}, at least {one.least:g}{unit}"
            lines.append(f"{self._mark(name)}{what}")
        return lines if self.margins else [*lines, "margins: not judged, there is no equilibrium"]

    @property
    def disk_margin(self) -> float | None:
        """The disk margin; None if the loop has no equilibrium."""
        return next((one.value for one in self.margins if one.name == "disk_margin"), None)

    def _mark(self, name: str) -> str:
        return "NOT MET  " if name in self.unmet else ""


def tune_system(
    system: System,
    seconds: float,
    ranges: Mapping[str, tuple[float, float]],
    *,
    cases: Mapping[str, ArrayLike] | None = None,
    objective: str | None = None,
    trials: int = 1024,
    least_disk_margin: float = LEAST_DISK_MARGIN,
    seed: int = 0,
    threads: int = 1,
    out: Path | None = None,
    goals: Sequence[LoopGoal] = (),
    points: Mapping[str, Mapping[str, ArrayLike]] = NO_POINTS,
    run_goals: Sequence[RunGoal] = (),
    progress: Callable[[int, Mapping[str, float]], object] = lambda *_: None,
) -> SystemTuning:
    """Search gains that minimise a cost of a system, by differential evolution over compiled runs.

    With soft `goals`, the largest normalised value of them is minimised instead, as `systune` does; costs with a bound
    keep it. Hard goals are bounds.

    A gain set is feasible if, in every case, no run ends early, every cost is at most its bound (`Cost.at_most`), the
    disk margin is at least `least_disk_margin`, and the delay margin at least one control period. The system's own
    gains are the first set, if they are in the ranges. The margins are computed only for the sets with the least cost,
    because their computation takes longer than a run.

    Args:
        system: the closed loop.
        seconds: duration of a run [s].
        ranges: search range (low, high) of each tuned gain, by name; `K[0]` is an entry of a port. A range of positive
            numbers is searched on a log scale.
        cases: numbers of the runs of every gain set (see `run_numbers`), such as initial states; default: one run with
            the numbers of the system. The mean over the cases is minimised, bounds are about the worst case.
        objective: cost to minimise; default: the first cost of the system.
        trials: number of gain sets.
        least_disk_margin: least disk margin of all loops at once, at commands or measurements, at the worst corner of
            the ranges that the system declares; 0 for no bound.
        seed: seed of the search.
        threads: number of threads that share the runs.
        out: folder in which finished gain sets are stored until the search ends, so that an identical call resumes an
            interrupted search, also with more trials; None stores nothing.
        goals: goals about the loop.
        points: operating points of the goals, by name, as in `operating_loops`.
        run_goals: goals about costs of the runs.
        progress: function that receives the number of gain sets so far and the best of them; their disk margin is
            computed at the end.

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
    name = check_tuning(system, ranges, cases or {}, objective=objective, goals=(*goals, *run_goals))
    for point, values in points.items():
        for gain in values.keys() & ranges.keys():
            remedy = f"drop it from the point; {gain} has one value at all points"
            raise InputError("is searched", key=f"point {point}", value=gain, remedy=remedy)
    judged = GoalSearch(system, tuple(goals), points) if goals else None
    size = max(5, min(_POPULATION * len(ranges), trials))
    journal, request = Journal(out), ""
    if out is not None:
        first = run_numbers(
            system, every_combination({gain: bounds[0] for gain, bounds in ranges.items()}, cases or {})
        )
        aims = [str(goal.to_dict()) for goal in goals], [(p, sorted(v.items())) for p, v in points.items()], run_goals
        about = f"{name} {size} {seed} own {sorted(ranges.items())} {first.digest()} {aims}"
        request = request_digest(system, seconds, about)
    with journal.held():
        batches = journal.batches(request, width=len(ranges) + 2 * len(system.costs) + 3)
        search = _Search(
            system, seconds, list(ranges), dict(cases or {}), name, threads, batches, judged, tuple(run_goals)
        )

        def value(sets: Array) -> Array:
            values = search.penalised(sets)
            progress(*search.best)
            return values

        space = [SearchRange(gain, *map(float, ends)) for gain, ends in ranges.items()]
        own = [search.nominal(gain) for gain in ranges]
        inside = all(one.low <= x <= one.high for one, x in zip(space, own, strict=True))
        evolve(value, space, size=size, batches=trials // size, seed=seed, first=[own] if inside else ())
        chosen = search.chosen(least_disk_margin)
    journal.remove(request)
    return chosen


def check_tuning(
    system: System,
    ranges: Mapping[str, tuple[float, float]],
    cases: Mapping[str, ArrayLike],
    *,
    objective: str | None = None,
    goals: Sequence[LoopGoal | RunGoal] = (),
) -> str:
    """Return the name of what is minimised, a cost or `GOALS`, after a check of the arguments; nothing is compiled.

    Raises:
        InputError: as in `tune_system`.
    """
    soft = any(goal.kind == "soft" for goal in goals)
    name = (GOALS if soft else next(iter(system.costs), "")) if objective is None else objective
    if name not in system.costs and not (soft and name == GOALS):
        problem = "has no costs" if not system.costs else "no such cost"
        remedy = "give System(..., costs={...}) or a soft goal" if not system.costs else nearest(name, system.costs)
        raise InputError(problem, key="objective", value=objective, remedy=remedy)
    if not ranges:
        raise InputError("nothing is tuned", key="ranges", remedy="name at least one gain with (low, high)")
    for gain, ends in ranges.items():
        if not (np.isfinite(ends).all() and ends[0] < ends[1]):
            raise InputError("is not a range", key=gain, value=tuple(ends), remedy="give (low, high) with low < high")
        if gain.startswith(("plant.", "reference.", "disturbance.", "start.")):
            raise InputError("is not a gain", key=gain, remedy="tune gains of the controller; put it into the cases")
        if gain in cases:
            raise InputError(
                "is both a tuned gain and a value of the cases", key=gain, remedy="keep it out of one of them"
            )
        check_scalar(system, gain)
    run_numbers(system, every_combination({gain: ends[0] for gain, ends in ranges.items()}, cases))
    return name


class _Search:
    """All gain sets that were simulated, with their costs."""

    def __init__(
        self,
        system: System,
        seconds: float,
        names: list[str],
        cases: dict[str, ArrayLike],
        objective: str,
        threads: int,
        batches: Batches,
        goals: GoalSearch | None,
        run_goals: tuple[RunGoal, ...],
    ) -> None:
        self.system, self.seconds, self.names, self.objective, self.threads = system, seconds, names, objective, threads
        arrays = {name: np.asarray(value, dtype=float) for name, value in cases.items()}
        self.count = max((len(a) for a in arrays.values() if a.ndim), default=1)
        self.cases = arrays
        self.goals, self.run_goals, self.batches = goals, run_goals, batches
        self.sets: list[Array] = []
        self.figures: list[Array] = []  # means over the cases
        self.worsts: list[Array] = []
        self.scores: list[Array] = []  # largest normalised soft goal, excess of the hard ones
        self.least, self.leading = np.inf, dict[str, float]()
        self.lasted = np.zeros(0)  # share of the duration, of the sets simulated last

    def costs(self, sets: Array) -> Array:
        """Return the costs (sets, 2 costs) of gain sets (sets, gains): means over the cases, then those of the worst.

        They are infinite if a run of a case ends early.
        """
        n, k = len(sets), self.count
        if not self.system.costs:
            self.lasted = np.ones(n)
            return np.zeros((n, 0))
        values = every_combination(dict(zip(self.names, sets.T, strict=True)), self.cases)
        runs = simulate_system(self.system, self.seconds, values, threads=self.threads)
        whole = runs.stopped == ENDED
        self.lasted = np.where(whole, 1.0, runs.time / self.seconds).reshape(n, k).mean(axis=1)
        each = [np.where(whole, runs[name], np.inf).reshape(n, k) for name in self.system.costs]
        return np.column_stack([*(one.mean(axis=1) for one in each), *(one.max(axis=1) for one in each)])

    def results(self, sets: Array) -> Array:
        """Return costs, scores of the goals about the loop, and share of the duration (sets, 2 costs + 3)."""
        figures = self.costs(sets)
        scores = np.zeros((len(sets), 2)) if self.goals is None else self.goals.scores(self.names, sets)
        return np.column_stack([figures, scores, self.lasted])

    def excess(self, figures: Array) -> Array:
        """Return (sets, costs) by how much each cost exceeds its bound, relative to the bound; 0 within the bound."""
        bounds = np.array([np.inf if c.at_most is None else c.at_most for c in self.system.costs.values()])
        bounded, finite = np.isfinite(bounds), np.isfinite(figures)
        over = np.zeros(figures.shape)
        both = bounded & finite
        np.divide(figures - np.where(bounded, bounds, 0), np.maximum(np.abs(bounds), _TINY), out=over, where=both)
        return np.maximum(np.where(finite, over, np.inf), 0.0)

    def penalised(self, sets: Array) -> Array:
        """Simulate gain sets, store them with their costs, and return the values that the search minimises.

        For a set that breaks a bound, the value is a large number that grows with the excess. For a set with runs that
        end early, the value is a still larger number, which decreases if the runs end later.
        """
        table = self.batches.evaluated(sets, self.results)
        figures, worst = np.split(table[:, len(self.names) : -3], 2, axis=1)
        scores, self.lasted = table[:, -3:-1].copy(), table[:, -1]
        for goal in self.run_goals:
            share = self.share(goal, figures if goal.kind == "soft" else worst)
            if goal.kind == "soft":
                scores[:, 0] = np.maximum(scores[:, 0], share)
            else:
                scores[:, 1] += np.maximum(share - 1, 0.0)
        self.sets.append(sets)
        self.figures.append(figures)
        self.worsts.append(worst)
        self.scores.append(scores)
        excess = np.minimum(self.excess(worst).sum(axis=1) + np.minimum(scores[:, 1], _MOST), _MOST)
        excess[self.lasted < 1] = _MOST * (2 - self.lasted[self.lasted < 1])
        value = self.value(figures, scores)
        penalised = np.where((excess > 0) | ~np.isfinite(value), _WORSE * (1 + excess), np.minimum(value, _WORSE))
        k = int(np.argmin(penalised))
        if penalised[k] < self.least or not self.leading:
            self.least, self.leading = float(penalised[k]), dict(zip(self.names, sets[k].tolist(), strict=True))
        return penalised

    @property
    def best(self) -> tuple[int, dict[str, float]]:
        """Number of gain sets so far, and the one with the least penalised value."""
        return sum(map(len, self.sets)), self.leading

    def chosen(self, least: float) -> SystemTuning:
        """Return the gain set with the least cost that satisfies every bound, or else the set nearest to the bounds."""
        sets, figures, worst, scores = map(np.vstack, (self.sets, self.figures, self.worsts, self.scores))
        value = self.value(figures, scores)
        excess = self.excess(worst).sum(axis=1) + scores[:, 1]
        order = np.lexsort((np.where(np.isfinite(value), value, np.inf), excess))
        feasible = [int(k) for k in order[:_EXAMINED] if excess[k] == 0]
        best, margins = int(order[0]), self.margins(sets[order[0]], least)
        for k in feasible[1:]:
            if min(_shares(margins), default=1.0) >= 1:
                break
            others = self.margins(sets[k], least)
            if others and min(_shares(others)) > min(_shares(margins)):
                best, margins = k, others
        broken = [name for j, name in enumerate(self.system.costs) if self.excess(worst[best][None])[0, j] > 0]
        broken += [_MARGINS[one.name] for one in margins if not one.enough]
        nominal = np.array([self.nominal(name) for name in self.names])
        own = self.costs(nominal[None])[0, : len(self.system.costs)]
        after, before = (
            None if self.goals is None else self.goals.judged(self.names, gains) for gains in (sets[best], nominal)
        )
        if after is not None:
            broken += [s.goal.name for s in after.worst() if s.goal.kind == "hard" and not s.judgement.met]
        for goal in self.run_goals:
            met = self.share(goal, worst[best : best + 1])[0] <= 1
            broken += [goal.name] if goal.kind == "hard" and not met else []
        return SystemTuning(
            self.objective,
            dict(zip(self.names, sets[best].tolist(), strict=True)),
            dict(zip(self.system.costs, figures[best].tolist(), strict=True)),
            dict(zip(self.system.costs, worst[best].tolist(), strict=True)),
            dict(zip(self.system.costs, own.tolist(), strict=True)),
            margins,
            least,
            len(sets),
            tuple(broken),
            after,
            before,
            self.run_goals,
            self.batches.restored,
        )

    def value(self, figures: Array, scores: Array) -> Array:
        """Return what is minimised, (sets,)."""
        return scores[:, 0] if self.objective == GOALS else figures[:, list(self.system.costs).index(self.objective)]

    def share(self, goal: RunGoal, figures: Array) -> Array:
        """Return the normalised value (sets,) of a goal about runs from costs (sets, costs)."""
        return goal.normalised(figures[:, list(self.system.costs).index(goal.metric)])

    def margins(self, gains: Array, least: float) -> tuple[Figure, ...]:
        """Return disk and delay margin of the assessment, with this least disk margin; none without an equilibrium."""
        about_loop = {name: value for name, value in self.cases.items() if not name.startswith("start.")}
        figures = assess_cases(self.system, about_loop, dict(zip(self.names, gains.tolist(), strict=True))).figures
        chosen = [figures[name] for name in _MARGINS if name in figures]
        return tuple(replace(one, least=least) if one.name == "disk_margin" else one for one in chosen)

    def nominal(self, name: str) -> float:
        """Return the system's own value of a gain."""
        gains, (port, _, entry) = self.system.controller.gains, name.partition("[")
        return float(gains.pack()[gains.slice(port)][int(entry.rstrip("]") or 0)])


def assess_cases(
    system: System, cases: Mapping[str, ArrayLike], gains: Mapping[str, float], *, seconds: float | None = None
) -> Assessment:
    """Return what is assessed of a system with these gains in all cases: of each figure the worst, and every line.

    Args:
        system: the closed loop.
        cases: numbers of the cases, as in `tune_system`.
        gains: the gains by name.
        seconds: duration of a run [s]; None: the loop alone.

    Example:
        >>> from surctl.testing import cart_system
        >>> from surctl.tuning.systems import assess_cases
        >>> result = assess_cases(cart_system(), {"start.speed": [4.0, 1.0]}, {"k": 2.0}, seconds=2.0)
        >>> result.figures["cost.way"].where
        'start.speed=4'
    """
    arrays = {name: np.asarray(value, dtype=float) for name, value in cases.items()}
    count = max((len(a) for a in arrays.values() if a.ndim), default=1)
    parts = ["loop"] if seconds is None else None
    named: dict[str, Assessment] = {}
    for k in range(count):
        values = {name: a if a.ndim == 0 else a[k] for name, a in arrays.items()}
        label = ", ".join(f"{name}={values[name]:g}" for name, a in arrays.items() if a.ndim and len(a) > 1)
        named[label] = assess(ClosedLoop(system, {**values, **gains}, seconds=seconds), parts=parts)
    return worst_of(named)


def _shares(margins: Sequence[Figure]) -> list[float]:
    # margins over the required values; NaN counts as 0
    return [0.0 if np.isnan(one.value) else one.value / one.least if one.least else np.inf for one in margins]
