"""Goals of a loop judged at several operating points of a system; the worst point decides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from numpy.typing import ArrayLike

from surctl.errors import InputError
from surctl.plotted import Plotted
from surctl.system import LinearLoop, System, linearise
from surctl.tuning.goals import check_points
from surctl.tuning.loop_goals import Judgement, LoopGoal


@dataclass(frozen=True, eq=False)
class Score:
    """One goal judged at one operating point.

    Attributes:
        goal: the goal.
        point: name of the operating point.
        judgement: its value, bound, normalised value and curve.
    """

    goal: LoopGoal
    point: str
    judgement: Judgement

    def __str__(self) -> str:
        """Return the goal, its normalised value, its value and bound, and the operating point, in one line."""
        one = self.judgement
        unit = "" if one.unit == "1" else f" {one.unit}"
        value = "no value" if one.value != one.value else f"{one.value:.4g}{unit} for {one.limit:.4g}"
        mark = "met    " if one.met else "NOT MET"
        place = f", {one.where}" if one.where else ""
        return f"{mark} {self.goal.name} ({self.goal.kind}): {one.normalised:.3f}, {value}{place}; {self.point}"

    def to_dict(self) -> dict[str, Any]:
        """Return the score as plain data for JSON."""
        one = self.judgement
        numbers = {"value": one.value, "unit": one.unit, "limit": one.limit, "normalised": one.normalised}
        return {"goal": self.goal.name, "kind": self.goal.kind, "point": self.point, **numbers, "where": one.where}


@dataclass(frozen=True, eq=False)
class LoopScores(Plotted):
    """The scores of all goals at all operating points; `plot()` draws each goal with its violated region.

    Attributes:
        scores: the scores, goal by goal.
    """

    PLOT = "surctl.report.page_parts:plot_loop_goals"

    scores: tuple[Score, ...]

    @property
    def met(self) -> bool:
        """Whether every hard goal is met at every one of its points."""
        return all(score.judgement.met for score in self.scores if score.goal.kind == "hard")

    def worst(self) -> tuple[Score, ...]:
        """Return, for each goal, the score at its worst operating point."""
        best: dict[str, Score] = {}
        for score in self.scores:
            known = best.get(score.goal.name)
            if known is None or score.judgement.normalised > known.judgement.normalised:
                best[score.goal.name] = score
        return tuple(best.values())

    def lines(self) -> list[str]:
        """Return a line of text for each goal, at its worst operating point."""
        return [str(score) for score in self.worst()]


def operating_loops(system: System, points: Mapping[str, Mapping[str, ArrayLike]]) -> dict[str, LinearLoop]:
    """Return the linear loop of a system at each operating point, by its name.

    Args:
        system: the closed loop.
        points: numbers of each operating point by name, as in `run_numbers`; without points, the system's own numbers.

    Raises:
        InputError: a point has no equilibrium, or `run_numbers` rejects its numbers.

    Example:
        >>> from surctl.testing import cart_system
        >>> from surctl.tuning import operating_loops
        >>> loops = operating_loops(cart_system(2.0), {"soft": {"k": 1.0}, "stiff": {"k": 4.0}})
        >>> {name: round(float(abs(loop.poles()[0])), 2) for name, loop in loops.items()}
        {'soft': 0.9, 'stiff': 0.6}
    """
    loops: dict[str, LinearLoop] = {}
    for name, values in (points or {"nominal": {}}).items():
        try:
            loops[name] = linearise(system, values)
        except InputError as error:
            raise InputError(error.problem, key=f"point {name}: {error.key}", remedy=error.remedy) from None
    return loops


def judge_loops(goals: Sequence[LoopGoal], loops: Mapping[str, LinearLoop]) -> LoopScores:
    """Return the score of every goal at each of its operating points.

    Raises:
        InputError: a goal names a signal or an operating point that does not exist.

    Example:
        >>> from surctl.system import linearise
        >>> from surctl.testing import cart_system
        >>> from surctl.tuning import Margins, SensitivityBound, judge_loops
        >>> peak = SensitivityBound(name="peak", at="force", at_most=2.0)
        >>> goals = [peak, Margins(name="phase", at="force", phase_deg=60.0)]
        >>> for line in judge_loops(goals, {"nominal": linearise(cart_system(2.0))}).lines():
        ...     print(line)
        met     peak (soft): 0.556, 1.111 for 2, at 31.4 rad/s; nominal
        met     phase (soft): 0.712, 84.26 deg for 60, phase margin 84.3 deg at force; nominal
    """
    check_points(goals, loops)
    return LoopScores(
        tuple(
            Score(goal, name, goal.judge(loop))
            for goal in goals
            for name, loop in loops.items()
            if not goal.points or name in goal.points
        )
    )
