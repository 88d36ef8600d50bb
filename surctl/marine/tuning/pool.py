"""The request of a search for gains, its space, and the pool of gain sets that the search has simulated."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from surctl import __version__
from surctl.errors import EmptyDomain, InputError, nearest
from surctl.marine.control import PATH_FOLLOWING, Gains, law_source
from surctl.marine.simulation import Case
from surctl.marine.tuning.evaluation import Condition, Evaluation, Figures, Sets, figures, judged, row
from surctl.marine.tuning.goals import Goal
from surctl.marine.tuning.measure import law_digest
from surctl.marine.verification.library import claims
from surctl.tuning.design import default_range
from surctl.tuning.search import SearchRange
from surctl.verification.counterexample import evaluate
from surctl.verification.falsifier import falsify
from surctl.verification.verdict import Verdict

TUNED = ("k1", "lookahead", "k_psi", "k_v", "k_r", "kappa", "reaction", "brake")
"""Gains that are tuned if no gain is named: they shape the motion and do not describe the sensors."""


@dataclass(frozen=True)
class GainRange(SearchRange):
    """One tuned gain and its search range low … high, which includes both ends.

    `below` is the largest value that the gain may have, `zero` whether it may be 0.

    Raises:
        InputError: the ends are not 0 < low < high ≤ below, or low is 0 and the gain may not be 0.
    """

    below: float = float("inf")
    zero: bool = False

    def __post_init__(self) -> None:
        key, top = f"--gain {self.name}", self.below
        shown = f"{self.low:g}..{self.high:g}"
        if not (np.isfinite([self.low, self.high]).all() and 0 <= self.low < self.high):
            least = "0 ≤" if self.zero else "0 <"
            raise InputError("is not a range", key=key, value=shown, remedy=f"write LOW..HIGH with {least} LOW < HIGH")
        if self.low == 0 and not self.zero:
            problem = "begins at 0, and the gain must be greater"
            raise InputError(problem, key=key, value=shown, remedy="raise the lower end")
        if self.high > top:
            raise InputError(f"is above its bound of {top:.3g}", key=key, value=self.high, remedy="lower the upper end")


def gain_ranges(
    base: Gains, ranges: Mapping[str, tuple[float, float] | None] | Sequence[str] = TUNED
) -> tuple[GainRange, ...]:
    """Return the gains to tune, with their ranges.

    Args:
        base: gains that set the default ranges: a quarter of the value to four times the value, within the bounds of
            the gain.
        ranges: mapping from gain name to (low, high), or to None for the default range; or a sequence of gain names,
            which all get their default range.

    Raises:
        InputError: no gain is named, a gain is unknown, a range is not valid, or a gain of 0 has no range.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.tuning import gain_ranges
        >>> for gain in gain_ranges(load_gains("default"), {"k_v": None, "lookahead": (0.4, 1.2)}):
        ...     print(gain.name, gain.low, gain.high)
        k_v 0.375 6.0
        lookahead 0.4 1.2
    """
    table = ranges if isinstance(ranges, Mapping) else dict.fromkeys(ranges)
    if not table:
        raise InputError("nothing is tuned", key="--gain", remedy="name at least one gain")
    for name in table:
        if name not in base.specs:
            raise InputError("no such gain", key="--gain", value=name, remedy=nearest(name, base.specs))
    stated = ((name, ends or _default(name, base)) for name, ends in table.items())
    specs = base.specs
    return tuple(
        GainRange(name, low, high, specs[name].below, specs[name].zero_allowed) for name, (low, high) in stated
    )


def default_tuned(base: Gains) -> tuple[str, ...]:
    """Return the names of the gains that are tuned if no gain is named.

    If the law defines additional gains, these are tuned together with the gains of the velocity loops; otherwise the
    gains in `TUNED` are tuned.
    """
    # not what follows from the vehicle, nor a gain that may be 0, which is a choice; it is tuned if it is named
    own = [name for name in base.own if name in base.specs and base.ranges.get(name, (1.0, 1.0))[0] > 0]
    return (*own, "k_v", "k_r") if base.own else TUNED


def _default(name: str, base: Gains) -> tuple[float, float]:
    if name in base.own and name in base.ranges:
        return base.ranges[name]
    value = base[name]
    if value <= 0:
        raise InputError("is 0 and so has no default range", key=f"--gain {name}", remedy=f"write {name}=LOW..HIGH")
    low, high = default_range(value)
    return low, min(high, base.specs[name].below)


@dataclass(frozen=True)
class ClaimPoint:
    """A point of a claim's domain at which the claim failed by more than `threshold` (in the unit of the claim)."""

    name: str
    values: Mapping[str, float]
    threshold: float


@cache
def expected_to_hold() -> tuple[str, ...]:
    """Names of the paper's claims that should not be refuted; claims about braking need a vehicle and are omitted."""
    return tuple(claim.name for claim in claims() if claim.paper and claim.expected != "refuted")


def refuted_claims(gains: Mapping[str, float], cases: Sequence[Case], *, seed: int = 0) -> tuple[Verdict, ...]:
    """Return the verdicts of the claims that should hold but are refuted with these gains.

    The claims are about path following by equations (8)-(12): there are none if no case's law contains it.
    """
    if not any(PATH_FOLLOWING in law_source(case.law).parts and case.guidance == "los" for case in cases):
        return ()
    return _refuted(tuple(sorted(gains.items())), seed)


@lru_cache(maxsize=16)
def _refuted(gains: tuple[tuple[str, float], ...], seed: int) -> tuple[Verdict, ...]:
    # cached, because several rounds may end at the same gains and the falsifier takes seconds
    verdicts = list[Verdict]()
    for claim in claims(dict(gains), expected_to_hold()):
        with suppress(EmptyDomain):  # nothing refutes it
            verdicts.append(falsify(claim, seed=seed))
    return tuple(v for v in verdicts if v.verdict == "refuted")


def excess(
    points: Sequence[ClaimPoint], base: Mapping[str, float], sets: Mapping[str, NDArray[np.float64]]
) -> NDArray[np.float64]:
    """Return by how much the claims exceed their thresholds, as an array (n gain sets, points).

    The value is -1 for a point outside the claim's domain.
    """
    count = len(next(iter(sets.values())))
    table = np.full((count, len(points)), -1.0)
    for k in range(count if points else 0):
        gains = {**base, **{name: float(values[k]) for name, values in sets.items()}}
        for j, point in enumerate(points):
            margin, inside = evaluate(claims(gains, [point.name])[0], point.values)
            if inside:
                table[k, j] = margin - point.threshold
    return table


CAP = 10.0  # upper limit of a normalised value in a score, so that one hopeless goal does not hide the others
_PENALTY = 10.0  # penalty of one unit of violation, relative to the score


@dataclass(frozen=True, eq=False)
class Request:
    """The request of a search: all inputs on which the search depends.

    Attributes:
        goals: the goals.
        conditions: the runs for which the goals are evaluated.
        base: the start gains; every gain outside the search space keeps its value from them.
        space: the searched gains with their ranges.
        seed: seed of the search.
        claims: points of claims' domains at which the claims must hold, as constraints of the search.
        threads: number of threads of the compiled loop; no result depends on it.
    """

    goals: tuple[Goal, ...]
    conditions: tuple[Condition, ...]
    base: Gains
    space: tuple[GainRange, ...]
    seed: int = 0
    claims: tuple[ClaimPoint, ...] = ()
    threads: int = 1

    @property
    def cases(self) -> tuple[Case, ...]:
        """The simulation cases without duplicates, in order."""
        return tuple({id(c.case): c.case for c in self.conditions}.values())

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the request without `threads`, by which the journal knows its batches."""
        lines = [f"surctl {__version__}", f"goals {self.goals!r}", f"space {self.space!r}", f"seed {self.seed}"]
        lines += [
            f"base {dict(self.base.values)!r}",
            f"claims {[(p.name, sorted(p.values.items())) for p in self.claims]}",
        ]
        laws = {_kind(c): c for c in self.cases}
        lines += [f"law {which} {law_digest(c)}" for which, c in laws.items()]
        for case in self.cases:
            model = None if case.model is None else dict(case.model.parameters)
            lines.append(f"case {case.name} {case.scenario!r} {dict(case.vehicle.parameters)!r} {model!r}")
            lines.append(f"law {_kind(case)} {dict(case.gains.values)!r}")
        lines += [f"run {c.label} {sorted(c.plant.items())!r} {c.goals}" for c in self.conditions]
        return hashlib.sha256("\n".join(lines).encode()).hexdigest()

    def simulate(self, sets: Sets) -> tuple[Pool, Figures]:
        """Simulate gain sets; return a `Pool` and the metrics of every run.

        The `Pool` holds the values of the searched gains in each gain set, and for each gain set the evaluated goals
        and claims. The metrics are arrays (gain sets, conditions) by metric name, as `figures` returns them.
        """
        table = figures(self.goals, self.conditions, sets, threads=self.threads)
        values = {span.name: np.asarray(sets[span.name], dtype=float) for span in self.space}
        pool = Pool(values, judged(self.goals, self.conditions, table), excess(self.claims, self.base.values, sets))
        return pool, table

    def judge(self, sets: Sets) -> Pool:
        """Simulate gain sets and return them as a pool with evaluated goals."""
        return self.simulate(sets)[0]

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
        sets, normalised, figure, speed, excess, effort, claims = np.split(table, ends, axis=1)
        return Pool(self.named(sets), Evaluation(self.goals, normalised, figure, speed, excess, effort[:, 0]), claims)


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
        worst: NDArray[np.float64] = (capped / reference).max(axis=1, initial=0.0)
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
        return f"best score {self.score(start)[self.best(start)]:.4f}"

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
        part = Evaluation(e.goals, e.normalised[k], e.figure[k], e.speed[k], e.excess[k], e.effort[k])
        return Pool({name: values[k] for name, values in self.sets.items()}, part, self.claims[k])

    @property
    def table(self) -> NDArray[np.float64]:
        """All numbers of the pool, a row for each gain set: gains, evaluated goals, and claims."""
        e = self.evaluation
        parts = (e.normalised, e.figure, e.speed, e.excess, e.effort, self.claims)
        return np.column_stack([*self.sets.values(), *parts])

    def gains(self, k: int) -> dict[str, float]:
        """Return the k-th gain set: the value of each gain by name."""
        return row(self.sets, k)


def joined_pools(pools: Sequence[Pool]) -> Pool:
    """Join several pools with the same goals into one pool."""
    sets = {name: np.concatenate([p.sets[name] for p in pools]) for name in pools[0].sets}
    evaluations = [p.evaluation for p in pools]
    numbers = ("normalised", "figure", "speed", "excess", "effort")
    joined = [np.concatenate([getattr(e, name) for e in evaluations]) for name in numbers]
    return Pool(sets, Evaluation(evaluations[0].goals, *joined), np.concatenate([p.claims for p in pools]))


def _kind(case: Case) -> tuple[str, ...]:
    """Return the options of a case that determine its control law, without those of its perception."""
    return case.law, case.avoidance, case.mode, case.guidance, case.barrier, case.movers
