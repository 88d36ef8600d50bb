"""Goals about the loop and the runs of a system, as bounds and objective of a search over gains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError
from surctl.system import System
from surctl.tuning.loop_goals import LoopGoal
from surctl.tuning.loop_scores import LoopScores, judge_loops, operating_loops

__all__ = ["GOALS", "NO_POINTS", "GoalSearch", "RunGoal"]

Array = NDArray[np.float64]

GOALS = "goals"
"""Name of the objective of a search that minimises the largest normalised value of the soft goals."""

NO_POINTS: Mapping[str, Mapping[str, Any]] = MappingProxyType({})
_MOST = 1e6  # largest normalised value that is distinguished


@dataclass(frozen=True)
class RunGoal:
    """A bound on a cost of the runs of a system, as a mean over the cases.

    Attributes:
        name: name of the goal.
        cost: name of the cost.
        at_most: the bound, in the unit of the cost, > 0.
        kind: a hard goal must be met; the normalised value of a soft one, cost / bound, is minimised.

    Example:
        >>> import numpy as np
        >>> from surctl.tuning import RunGoal
        >>> RunGoal("quick", "settling", 4.0).normalised(np.array([3.0, 6.0])).tolist()
        [0.75, 1.5]
    """

    name: str
    cost: str
    at_most: float
    kind: Literal["hard", "soft"] = "soft"

    def normalised(self, value: Array) -> Array:
        """Return cost / bound (n,): at most 1 if the goal is met."""
        return np.asarray(value, dtype=float) / self.at_most

    def line(self, value: float, before: float, unit: str) -> str:
        """Return the goal with its value and the value before, in one line."""
        share = float(self.normalised(np.array(value)))
        mark = "met    " if share <= 1 else "NOT MET"
        text = f"{value:.4g} {unit} for {self.at_most:.4g} (before {before:.4g}), run"
        return f"{mark} {self.name} ({self.kind}): {share:.3f}, {text}"


class GoalSearch:
    """The goals of a system at its operating points, judged for sets of gains."""

    def __init__(
        self, system: System, goals: tuple[LoopGoal, ...], points: Mapping[str, Mapping[str, ArrayLike]]
    ) -> None:
        self.system, self.goals = system, goals
        self.points = dict(points) or {"nominal": {}}
        self.judged([], np.zeros(0))  # reports unknown signals before the search

    def judged(self, names: Sequence[str], gains: Array) -> LoopScores:
        """Return the scores for one gain set (gains,)."""
        chosen = dict(zip(names, gains.tolist(), strict=True))
        points = {name: {**values, **chosen} for name, values in self.points.items()}
        return judge_loops(self.goals, operating_loops(self.system, points))

    def scores(self, names: Sequence[str], sets: Array) -> Array:
        """Return, for each gain set, the largest normalised value of the soft goals and the excess of the hard ones."""
        rows = []
        for gains in sets:
            try:
                scores = self.judged(names, gains).scores
            except InputError:  # no equilibrium
                rows.append((_MOST, _MOST * len(self.goals)))
                continue
            values = [(s.goal.kind, min(s.judgement.normalised, _MOST)) for s in scores]
            soft = max((value for kind, value in values if kind == "soft"), default=0.0)
            rows.append((soft, sum(max(value - 1, 0.0) for kind, value in values if kind == "hard")))
        return np.array(rows)
