"""What a search is asked for, and the gain sets that it flew."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from surctl import __version__
from surctl.control import Gains
from surctl.simulation import Case
from surctl.tuning.claim_points import ClaimPoint, excess
from surctl.tuning.evaluation import Condition, Evaluation, Figures, Sets, figures, judged, row
from surctl.tuning.goals import Goal
from surctl.tuning.measure import law_digest
from surctl.tuning.space import GainRange

__all__ = ["Pool", "Progress", "Request", "joined"]

Progress = Callable[[str], None]

CAP = 10.0  # normalised values count up to this, so that one hopeless goal does not hide the others
_PENALTY = 10.0  # of one unit of violation, against the score


@dataclass(frozen=True, eq=False)
class Request:
    """Everything that a search depends on.

    Attributes:
        goals: the goals.
        conditions: the runs that they are taken over.
        base: the start: also every gain that is not searched.
        space: the gains searched.
        seed: of the search.
        claims: points of claims that must hold.
        threads: of the compiled loop; nothing depends on them.
        begun: words for what the search begins with, where that is not the start gains alone.
    """

    goals: tuple[Goal, ...]
    conditions: tuple[Condition, ...]
    base: Gains
    space: tuple[GainRange, ...]
    seed: int = 0
    claims: tuple[ClaimPoint, ...] = ()
    threads: int = 1
    begun: str = ""

    @property
    def cases(self) -> tuple[Case, ...]:
        """What is flown, each case once, in order."""
        return tuple({id(c.case): c.case for c in self.conditions}.values())

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all of it but the threads: the name of the study in the journal."""
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
        lines += [f"begun {self.begun}"] * bool(self.begun)
        lines += [f"run {c.label} {sorted(c.plant.items())!r} {c.goals}" for c in self.conditions]
        return hashlib.sha256("\n".join(lines).encode()).hexdigest()

    def simulate(self, sets: Sets) -> tuple[Pool, Figures]:
        """Fly gain sets: what the goals make of them, and the figure of every run."""
        table = figures(self.goals, self.conditions, sets, threads=self.threads)
        values = {span.name: np.asarray(sets[span.name], dtype=float) for span in self.space}
        pool = Pool(values, judged(self.goals, self.conditions, table), excess(self.claims, self.base.values, sets))
        return pool, table

    def judge(self, sets: Sets) -> Pool:
        """Fly gain sets."""
        return self.simulate(sets)[0]


@dataclass(frozen=True, eq=False)
class Pool:
    """Gain sets that were flown.

    Attributes:
        sets: gain → (n,).
        evaluation: of the goals.
        claims: (n, c) by how much each point of a claim fails, over its threshold; at most 0 where it holds.
    """

    sets: Sets
    evaluation: Evaluation
    claims: NDArray[np.float64]

    @property
    def feasible(self) -> NDArray[np.bool_]:
        """(n,): every hard goal is met and every point of a claim holds."""
        held: NDArray[np.bool_] = self.evaluation.feasible & (self.claims <= 0).all(axis=1)
        return held

    @property
    def constraints(self) -> NDArray[np.float64]:
        """(n, hard + c): at most 0 where met. Beyond, bounded: a goal counts by how many runs miss it and how far."""
        e = self.evaluation
        hard = [g.kind == "hard" for g in e.goals]
        graded = np.where(e.excess[:, hard] > 0, e.excess[:, hard], np.minimum(e.normalised[:, hard] - 1, 0.0))
        return np.hstack([graded, np.minimum(self.claims, CAP)])

    def score(self, start: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,): the largest soft goal over what the start gains make of it, or over its limit if they miss it.

        Below 1 every soft goal is met and better than with the start gains. `start` (m,): their normalised values.
        """
        soft = np.array([g.kind == "soft" for g in self.evaluation.goals])
        # a goal that the start gains meet is not given back; never divided by a value near zero
        reference = np.clip(start[soft], 1e-3, 1.0)
        capped = np.minimum(self.evaluation.normalised, CAP)[:, soft]
        worst: NDArray[np.float64] = (capped / reference).max(axis=1, initial=0.0)
        return worst

    def merit(self, start: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,): score plus a penalty on every unmet constraint."""
        broken = np.maximum(self.constraints, 0).sum(axis=1)
        # a constraint that is missed by a hair costs at least as much as a score can gain
        merit: NDArray[np.float64] = self.score(start) + _PENALTY * (broken + (broken > 0))
        return merit

    def ranked(self, start: NDArray[np.float64]) -> list[int]:
        """Indices of all sets by merit, the best first."""
        order: list[int] = np.argsort(self.merit(start), kind="stable").tolist()
        return order

    def best(self, start: NDArray[np.float64]) -> int:
        """Index of the feasible set with the least score; where none is feasible, of the one that misses least."""
        return int(np.argmin(self.merit(start)))

    def front(self, start: NDArray[np.float64]) -> list[int]:
        """Indices of the feasible sets that none beats in both score and thrust, least score first."""
        score, effort = self.score(start), self.evaluation.effort
        indices: list[int] = []
        for k in np.lexsort((effort, score)):
            if self.feasible[k] and (not indices or effort[k] < effort[indices[-1]]):
                indices.append(int(k))
        return indices

    def subset(self, which: Sequence[int]) -> Pool:
        """Some of the sets."""
        e, k = self.evaluation, list(which)
        part = Evaluation(e.goals, e.normalised[k], e.figure[k], e.speed[k], e.excess[k], e.effort[k])
        return Pool({name: values[k] for name, values in self.sets.items()}, part, self.claims[k])

    def gains(self, k: int) -> dict[str, float]:
        """The k-th set by name."""
        return row(self.sets, k)


def joined(pools: Sequence[Pool]) -> Pool:
    """One pool of several with the same goals."""
    sets = {name: np.concatenate([p.sets[name] for p in pools]) for name in pools[0].sets}
    e = [p.evaluation for p in pools]
    whole = Evaluation(
        e[0].goals,
        np.concatenate([x.normalised for x in e]),
        np.concatenate([x.figure for x in e]),
        np.concatenate([x.speed for x in e]),
        np.concatenate([x.excess for x in e]),
        np.concatenate([x.effort for x in e]),
    )
    return Pool(sets, whole, np.concatenate([p.claims for p in pools]))


def _kind(case: Case) -> tuple[str, ...]:
    """What chooses the law of a case, but the senses."""
    return case.law, case.avoidance, case.mode, case.guidance, case.barrier, case.movers
