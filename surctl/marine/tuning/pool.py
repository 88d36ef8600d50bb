"""The request of a search for gains, and the pool of gain sets that the search has simulated."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from surctl import __version__
from surctl.marine.control import Gains
from surctl.marine.simulation import Case
from surctl.marine.tuning.claim_points import ClaimPoint, excess
from surctl.marine.tuning.evaluation import Condition, Evaluation, Figures, Sets, figures, judged, row
from surctl.marine.tuning.goals import Goal
from surctl.marine.tuning.measure import law_digest
from surctl.marine.tuning.space import GainRange

__all__ = ["Pool", "Request", "joined_pools"]

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
