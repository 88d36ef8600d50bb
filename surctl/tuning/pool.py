"""The request of a search for gains, the runs and goals that it judges by; score and order of gain sets."""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl import __version__
from surctl.errors import check_known
from surctl.tuning.chunked import Progress
from surctl.tuning.goals import RunGoal

Floats = NDArray[np.float64]
Sets = Mapping[str, Floats]
Figures = Mapping[str, Floats]  # metric → (n, conditions)
Simulated: TypeAlias = Callable[[Sequence[RunGoal], Sequence["Condition"], Sets], Figures]
"""A function that simulates gain sets, such as `SearchRequest.figures`."""


@dataclass(frozen=True)
class Condition:
    """One closed-loop run that evaluates a gain set: case, seed and plant.

    Attributes:
        case: what is simulated, with its `name` and the names by which goals may name it, `known_as`.
        seed: seed of the surroundings and of the noise.
        plant: numbers of the simulated plant (`plant.…`) that differ from those of the case; the controller's model
            stays that of the case.
        goals: names of the goals for which the run counts; None for all goals. A counterexample counts only for the
            goal that it refutes.
    """

    case: Any
    seed: int = 0
    plant: Mapping[str, float] = field(default_factory=dict)
    goals: tuple[str, ...] | None = None

    @property
    def run(self) -> tuple[str, int, tuple[tuple[str, float], ...]]:
        """Case, seed and plant: the key that identifies a simulated run, independent of its goals."""
        return self.case.name, self.seed, tuple(sorted(self.plant.items()))

    @property
    def label(self) -> str:
        """Case, seed and changed plant parameters as readable text."""
        off = ", ".join(f"{name.removeprefix('plant.')} = {value:.4g}" for name, value in self.plant.items())
        return f"{self.case.name}, seed {self.seed}" + (f", {off}" if off else "")


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Evaluation of m goals for n gain sets.

    Attributes:
        goals: the m goals.
        normalised: (n, m): normalised value of each goal for each gain set; at most 1 if the goal is met.
        figure: (n, m): value of the goal's metric, in its unit: the value of the worst run or the mean over the runs;
            NaN if a run did not succeed. For a goal at several places (cruise speeds, operating points), the value of a
            run is that at the worst place.
        place: (n, m): place at which the goal is worst in its worst run, see `RunGoal.columns`; NaN for a goal without
            places.
        excess: (n, m): mean over the goal's runs of max(0, normalised value - 1), limited to 1 in each run; 0 if the
            goal is met.
        effort: (n,): mean of |horizontal thrust| over all runs [N]; 0 for a system.
    """

    goals: tuple[RunGoal, ...]
    normalised: NDArray[np.float64]
    figure: NDArray[np.float64]
    place: NDArray[np.float64]
    excess: NDArray[np.float64]
    effort: NDArray[np.float64]

    @property
    def feasible(self) -> NDArray[np.bool_]:
        """Array (n,): whether the gain set meets every hard goal."""
        hard = [g.kind == "hard" for g in self.goals]
        met: NDArray[np.bool_] = np.all(self.normalised[:, hard] <= 1, axis=1)
        return met


def merged(conditions: Iterable[Condition]) -> tuple[Condition, ...]:
    """Merge conditions of the same run (case, seed and plant) into one condition that names all their goals."""
    counted: dict[object, tuple[Condition, dict[str, None]]] = {}
    for one in conditions:
        counted.setdefault(one.run, (one, {}))[1].update(dict.fromkeys(one.goals or ()))
    return tuple(replace(one, goals=tuple(goals)) for one, goals in counted.values())


def scope(goal: RunGoal, conditions: Sequence[Condition]) -> list[int]:
    """Return the indices of the conditions that count for a goal.

    Raises:
        InputError: the goal names a case that is not simulated.
    """
    names = {name for c in conditions for name in c.case.known_as}
    for name in goal.cases:
        check_known(name, names, "no such case", key=f"goals.{goal.name}.cases")
    return [
        k
        for k, c in enumerate(conditions)
        if (c.goals is None or goal.name in c.goals)
        and (goal.plants == "all" or not c.plant)
        and (not goal.cases or set(c.case.known_as) & set(goal.cases))
    ]


def judged(goals: Sequence[RunGoal], conditions: Sequence[Condition], table: Figures) -> Evaluation:
    """Evaluate the goals from the metrics of the runs."""
    count = len(table["effort_n"])
    shape = (count, len(goals))
    normalised, figure, excess = np.zeros(shape), np.full(shape, np.nan), np.zeros(shape)
    place = np.full(shape, np.nan)
    for j, goal in enumerate(goals):
        own, places = (values[:, scope(goal, conditions)] for values in goal.worst(table))
        each = goal.normalised(own)
        worst = each.argmax(axis=1)
        place[:, j] = places[np.arange(count), worst]
        if goal.over == "mean":
            figure[:, j] = own.mean(axis=1)
            each = goal.normalised(figure[:, [j]])
            normalised[:, j] = each[:, 0]
        else:
            figure[:, j], normalised[:, j] = own[np.arange(count), worst], each.max(axis=1)
        excess[:, j] = np.clip(each - 1, 0, 1).mean(axis=1)
    effort = table["effort_n"].mean(axis=1)
    return Evaluation(tuple(goals), normalised, figure, place, excess, effort)


def row(sets: Sets, k: int) -> dict[str, float]:
    """Return the k-th gain set: the value of each gain by name."""
    return {name: float(values[k]) for name, values in sets.items()}


@dataclass(frozen=True)
class SearchRange:
    """A searched number and its range low … high, which includes both ends; a range above 0 has a log scale."""

    name: str
    low: float
    high: float

    @property
    def log(self) -> bool:
        """Whether the search uses a log scale."""
        return self.low > 0

    def clip(self, value: float) -> float:
        """Clip a value to the range."""
        return min(max(value, self.low), self.high)

    def place(self, unit: Floats) -> Floats:
        """Convert shares 0 … 1 of the range, on its scale, to values."""
        share = np.asarray(unit, dtype=float)
        at = self.low * (self.high / self.low) ** share if self.log else self.low + (self.high - self.low) * share
        return np.clip(at, self.low, self.high)

    def unit(self, values: Floats) -> Floats:
        """Convert values to shares of the range, limited to 0 … 1; the inverse of `place`."""
        at = np.asarray(values, dtype=float)
        share = np.log(at / self.low) / np.log(self.high / self.low) if self.log else at - self.low
        return np.clip(share if self.log else share / (self.high - self.low), 0.0, 1.0)


@dataclass(frozen=True)
class ClaimPoint:
    """A point of a claim's domain at which the claim failed by more than `threshold` (in the unit of the claim)."""

    name: str
    values: Mapping[str, float]
    threshold: float


CAP = 10.0  # upper limit of a normalised value in a score, so that one hopeless goal does not hide the others
_PENALTY = 10.0  # penalty of one unit of violation, relative to the score


@dataclass(frozen=True, eq=False)
class SearchRequest(ABC):
    """The request of a search: all inputs on which the search depends.

    Attributes:
        goals: the goals.
        conditions: the runs for which the goals are evaluated.
        base: what is tuned, with its start gains; gains outside the search space keep their values.
        space: the searched gains with their ranges.
        seed: seed of the search.
        claims: points of claims' domains at which the claims must hold, as constraints of the search.
        threads: number of threads of the compiled loop; no result depends on it.
        size: number of gain sets that are simulated together.
    """

    goals: tuple[Any, ...]
    conditions: tuple[Condition, ...]
    base: Any
    space: tuple[SearchRange, ...]
    seed: int = 0
    claims: tuple[ClaimPoint, ...] = ()
    threads: int = 1
    size: int = 32

    others: ClassVar[int] = 8
    """Gain sets that a round passes on besides its best set."""
    checked: ClassVar[int] = 4
    """Best gain sets of a search on which goals are checked at its end."""
    descends: ClassVar[bool] = True
    """Whether a descent from the best gain sets follows the differential evolution."""

    @property
    @abstractmethod
    def start(self) -> Mapping[str, float]:
        """Return the start gains by name."""

    @property
    @abstractmethod
    def identity(self) -> list[str]:
        """Return lines with everything on which the figures of a gain set depend."""

    @abstractmethod
    def figures(self, goals: Sequence[Any], conditions: Sequence[Condition], sets: Sets) -> dict[str, Floats]:
        """Return an array (n gain sets, conditions) for each column of the goals and for `effort_n`, by name.

        A value is NaN if the run does not succeed, or if no goal needs it under this condition.
        """

    @abstractmethod
    def ending(self, condition: Condition, gains: Mapping[str, float]) -> str:
        """Return how and when the run of a condition ends with a gain set."""

    @abstractmethod
    def fresh(self, *, runs: int, first: int) -> tuple[Condition, ...]:
        """Return random runs with seeds that no other tuning uses, from the number `first` on; () if nothing varies."""

    @abstractmethod
    def so_far(self, gains: Mapping[str, float], warning: str) -> tuple[str, str]:
        """Return name and text of the file with the best gains of an unfinished tuning."""

    def check(self) -> None:  # noqa: B027  # most requests need no check
        """Raise InputError if goals do not fit the conditions."""

    def first_sets(self, progress: Progress) -> list[dict[str, float]]:
        """Return further gain sets, within the search space, with which a search begins."""
        return []

    def refuted_claims(self, gains: Mapping[str, float]) -> tuple[ClaimPoint, ...]:
        """Return points at which claims that should hold fail with these gains."""
        return ()

    def excess(self, sets: Sets) -> NDArray[np.float64]:
        """Return by how much the claims exceed their thresholds at their points, (n gain sets, claims)."""
        return np.zeros((len(next(iter(sets.values()))), 0))

    @property
    def begun(self) -> dict[str, float]:
        """Return the start gains of the search space."""
        return {span.name: self.start[span.name] for span in self.space}

    @property
    def cases(self) -> tuple[Any, ...]:
        """The simulation cases without duplicates, in order."""
        return tuple({id(c.case): c.case for c in self.conditions}.values())

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the request without `threads`, by which the journal knows its batches."""
        lines = [f"surctl {__version__}", f"goals {self.goals!r}", f"space {self.space!r}", f"seed {self.seed}"]
        lines += [
            f"base {dict(self.start)!r}",
            f"claims {[(p.name, sorted(p.values.items())) for p in self.claims]}",
        ]
        lines += self.identity
        lines += [f"run {c.label} {sorted(c.plant.items())!r} {c.goals}" for c in self.conditions]
        return hashlib.sha256("\n".join(lines).encode()).hexdigest()

    def simulate(self, sets: Sets, figures: Simulated | None = None) -> tuple[Pool, Figures]:
        """Simulate gain sets; return a `Pool` and the metrics of every run.

        The `Pool` holds the values of the searched gains in each gain set, and for each gain set the evaluated goals
        and claims. The metrics are arrays (gain sets, conditions) by metric name, as `figures` returns them, by default
        those of the request.
        """
        table = (figures or self.figures)(self.goals, self.conditions, sets)
        values = {span.name: np.asarray(sets[span.name], dtype=float) for span in self.space}
        pool = Pool(values, judged(self.goals, self.conditions, table), self.excess(sets))
        return pool, table

    def judge(self, sets: Sets, figures: Simulated | None = None) -> Pool:
        """Simulate gain sets and return them as a pool with evaluated goals."""
        return self.simulate(sets, figures)[0]

    def named(self, sets: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        """Return the values (n,) of each searched gain by name, from sets (n, gains)."""
        return {span.name: sets[:, k] for k, span in enumerate(self.space)}

    @property
    def width(self) -> int:
        """Length of the rows of `Pool.table`."""
        return len(self.space) + 4 * len(self.goals) + 1 + len(self.claims)

    def pool(self, table: NDArray[np.float64]) -> Pool:
        """Return the pool with a `Pool.table`."""
        d, m = len(self.space), len(self.goals)
        ends = [d + k * m for k in range(5)] + [d + 4 * m + 1]
        sets, normalised, figure, place, excess, effort, claims = np.split(table, ends, axis=1)
        return Pool(self.named(sets), Evaluation(self.goals, normalised, figure, place, excess, effort[:, 0]), claims)


@dataclass(frozen=True, eq=False)
class Pool:
    """Pool of simulated gain sets, with their goals and claims evaluated.

    Attributes:
        sets: values (n,) of each gain, by gain name.
        evaluation: the evaluated goals.
        claims: (n, c): excess of the claim at each of c points over its threshold; at most 0 if the claim holds at the
            point.
    """

    sets: Sets
    evaluation: Evaluation
    claims: NDArray[np.float64]

    @property
    def feasible(self) -> NDArray[np.bool_]:
        """Array (n,): whether the gain set meets every hard goal and every claim holds at its points."""
        held: NDArray[np.bool_] = self.evaluation.feasible & (self.claims <= 0).all(axis=1)
        return held

    @property
    def constraints(self) -> NDArray[np.float64]:
        """Constraint values (n, hard goals + c), for the hard goals and the c points of claims; at most 0 if met.

        The value of a missed goal grows with the number of runs that miss it and with the distance by which they miss
        it.
        """
        e = self.evaluation
        hard = [g.kind == "hard" for g in e.goals]
        graded = np.where(e.excess[:, hard] > 0, e.excess[:, hard], np.minimum(e.normalised[:, hard] - 1, 0.0))
        return np.hstack([graded, np.minimum(self.claims, CAP)])

    def score(self, start: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the score (n,) of the gain sets, which compares the soft goals with those of the start gains.

        The score is the largest normalised value of a soft goal, divided by the value of this goal with the start
        gains; a goal that the start gains miss is not divided.

        If the score is below 1, every soft goal is met and better than with the start gains. `start` holds the
        normalised values (m,) of the goals with the start gains.
        """
        soft = np.array([g.kind == "soft" for g in self.evaluation.goals])
        # a goal that the start gains meet must not get worse; 1e-3 avoids a division by almost zero
        reference = np.clip(start[soft], 1e-3, 1.0)
        capped = np.minimum(self.evaluation.normalised, CAP)[:, soft]
        worst: NDArray[np.float64] = (capped / reference).max(axis=1, initial=-np.inf if soft.any() else 0.0)
        return worst

    def merit(self, start: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the merit (n,) of the gain sets: score plus a penalty on every unmet constraint."""
        broken = np.maximum(self.constraints, 0).sum(axis=1)
        # even a barely missed constraint costs at least as much as a score can gain
        merit: NDArray[np.float64] = self.score(start) + _PENALTY * (broken + (broken > 0))
        return merit

    def ranked(self, start: NDArray[np.float64]) -> list[int]:
        """Return the indices of all sets by merit, the best first."""
        order: list[int] = np.argsort(self.merit(start), kind="stable").tolist()
        return order

    def best(self, start: NDArray[np.float64]) -> int:
        """Return the index of the feasible set with the least score, otherwise of the set with the least violation."""
        return int(np.argmin(self.merit(start)))

    def standing(self, start: NDArray[np.float64]) -> str:
        """Return the progress of a search: the best score of sets that meet all hard goals, or what is missed."""
        hard = [g.name for g in self.evaluation.goals if g.kind == "hard"]
        held = int(self.feasible.sum())
        if not held:
            broken = self.constraints > 0
            count = broken.sum(axis=1)
            fewest = int(np.lexsort((self.merit(start), count))[0])
            names = [*hard, *(f"claim point {k + 1}" for k in range(self.claims.shape[1]))]
            missed = ", ".join(name for name, b in zip(names, broken[fewest], strict=True) if b)
            return f"no gain set meets the hard goals yet; fewest violated: {count[fewest]} of {len(names)} ({missed})"
        if len(hard) == len(self.evaluation.goals):
            return f"{held} gain sets meet the hard goals" if held > 1 else "1 gain set meets the hard goals"
        return f"best score {self.score(start)[self.best(start)]:.5g}"

    def front(self, start: NDArray[np.float64]) -> list[int]:
        """Return the indices of the Pareto-optimal feasible sets (score and thrust), least score first."""
        score, effort = self.score(start), self.evaluation.effort
        indices: list[int] = []
        for k in np.lexsort((effort, score)):
            if self.feasible[k] and (not indices or effort[k] < effort[indices[-1]]):
                indices.append(int(k))
        return indices

    def subset(self, which: Sequence[int]) -> Pool:
        """Return a pool that holds only the gain sets with the given indices."""
        e, k = self.evaluation, list(which)
        part = Evaluation(e.goals, e.normalised[k], e.figure[k], e.place[k], e.excess[k], e.effort[k])
        return Pool({name: values[k] for name, values in self.sets.items()}, part, self.claims[k])

    @property
    def table(self) -> NDArray[np.float64]:
        """All numbers of the pool, a row for each gain set: gains, evaluated goals, and claims."""
        e = self.evaluation
        parts = (e.normalised, e.figure, e.place, e.excess, e.effort, self.claims)
        return np.column_stack([*self.sets.values(), *parts])

    def gains(self, k: int) -> dict[str, float]:
        """Return the k-th gain set: the value of each gain by name."""
        return row(self.sets, k)


def joined_pools(pools: Sequence[Pool]) -> Pool:
    """Join several pools with the same goals into one pool."""
    sets = {name: np.concatenate([p.sets[name] for p in pools]) for name in pools[0].sets}
    evaluations = [p.evaluation for p in pools]
    numbers = ("normalised", "figure", "place", "excess", "effort")
    joined = [np.concatenate([getattr(e, name) for e in evaluations]) for name in numbers]
    return Pool(sets, Evaluation(evaluations[0].goals, *joined), np.concatenate([p.claims for p in pools]))
