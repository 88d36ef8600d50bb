"""Goals files; goals on costs of a system's runs; which linear goals do not describe a run at a limit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from surctl.errors import InputError, check_once, mistakes_in, nearest
from surctl.files import Quantity, Strict, load_model, pick
from surctl.system import System
from surctl.tuning.loop_goal_file import LoopGoalTable, PointTable, check_points, loop_goal
from surctl.tuning.loop_goals import LoopGoal
from surctl.tuning.loop_time_goals import Overshoot, Settling, StepRejection, StepTracking
from surctl.verification.loops import worst_place

if TYPE_CHECKING:
    from surctl.assessment import Assessment

LIBRARY = Path(__file__).parent / "library"

Over = Literal["worst", "mean"]
Plants = Literal["all", "nominal"]
Kind = Literal["hard", "soft"]
Sense = Literal["at most", "at least"]


class GoalTable(LoopGoalTable):
    """Content of a `[[goals]]` table in a goals file or a study file; with `type`, a goal about the loop."""

    type: str | None = None  # type: ignore[assignment]
    metric: str | None = None
    at_least: Quantity | None = None
    over: Over = "worst"
    cases: tuple[str, ...] = ()
    plants: Plants = "all"
    cruise_m_per_s: tuple[float, ...] | None = None

    def loop(self) -> LoopGoalTable:
        """Return the table of a goal about the loop.

        Raises:
            InputError: it has a key of a goal about a metric.
        """
        for name in ("metric", "at_least", "over", "cases"):
            if name in self.model_fields_set:
                problem = f"is not a key of a goal of type {self.type}"
                raise InputError(problem, key=f"goals.{self.name}.{name}", remedy="leave it out, or drop type")
        left = self.model_dump(by_alias=True, exclude_unset=True)
        return LoopGoalTable.model_validate({k: v for k, v in left.items() if k not in ("plants", "cruise_m_per_s")})

    def bound(self, unit: str | None) -> tuple[Sense, Quantity]:
        """Return the sense and the bound of a goal about a metric, in its unit; None: in the stated one.

        Raises:
            InputError: there is no bound, there are two, or its unit is not one of the metric.
        """
        bounds: Mapping[Sense, Quantity | None] = {"at most": self.at_most, "at least": self.at_least}
        stated = [(sense, bound) for sense, bound in bounds.items() if bound is not None]
        if len(stated) != 1:
            remedy = 'write at_most = { value = ..., unit = "..." }, or at_least'
            raise InputError("needs one bound", key=f"goals.{self.name}", remedy=remedy)
        [(sense, bound)] = stated
        with mistakes_in(None, f"goals.{self.name}.{sense.replace(' ', '_')}.unit"):
            return sense, bound if unit is None else bound.within(unit)


TWICE: Mapping[str, str] = {"problem": "is the name of two goals", "key": "goals.name", "remedy": "rename one"}
"""What is wrong with the tables of goals of which two have the same name, see `check_once`."""


class GoalsFile(Strict):
    """Content of a goals file."""

    kind: Literal["goals"]
    name: str = Field(min_length=1)
    note: str = ""
    points: tuple[PointTable, ...] = ()
    goals: tuple[GoalTable, ...] = Field(min_length=1)


Array = NDArray[np.float64]

GOALS = "goals"
"""Name of the objective of a search that minimises the largest normalised value of the soft goals."""

NO_NUMBERS: Mapping[str, Any] = MappingProxyType({})


@dataclass(frozen=True)
class RunGoal:
    """A bound on one number of the runs, such as a cost of a system.

    Attributes:
        name: name of the goal in tables and plots.
        metric: name of the number.
        unit: unit of `limit`.
        limit: the bound.
        sense: "at most" or "at least": on which side of the limit the number must lie.
        kind: a hard goal must be met; the normalised value of a soft goal is minimised.
        over: "worst" if every run must meet the limit, "mean" if the mean of the runs must meet it. Costs of a system
            are means over the cases of its tuning.
        cases: names of the cases to which the goal applies; if empty, it applies to all.
        plants: "all", or "nominal" to exclude runs with another plant than that of the case (property Models of
            systune).

    Example:
        >>> import numpy as np
        >>> from surctl.tuning import RunGoal
        >>> RunGoal("quick", "settling", "s", 4.0).normalised(np.array([3.0, 6.0])).tolist()
        [0.75, 1.5]
    """

    name: str
    metric: str
    unit: str
    limit: float
    sense: Sense = "at most"
    kind: Kind = "soft"
    over: Over = "worst"
    cases: tuple[str, ...] = ()
    plants: Plants = "all"

    @property
    def linear(self) -> bool:
        """Whether the metric describes the linear loop; a linear metric does not depend on the seed."""
        return False

    @property
    def part(self) -> str:
        """Part of the assessment with the metric, for a goal that is checked at the end of a tuning."""
        return "loop"

    @property
    def columns(self) -> Mapping[str, float | None]:
        """Place of each column of figures that the goal bounds, by its name; a place is a number, or None."""
        return {self.metric: None}

    def worst(self, table: Mapping[str, Array]) -> tuple[Array, Array]:
        """Return two arrays, each shaped like a column: the worst value over the places, and its place, or NaN."""
        each = np.stack([table[name] for name in self.columns])
        ill = self.badness(each)
        place = np.array([np.nan if at is None else at for at in self.columns.values()])
        return np.take_along_axis(each, ill.argmax(axis=0)[None], axis=0)[0], place[worst_place(ill)]

    def place_text(self, place: float) -> str:
        """Return at which place the goal is worst, for a table; empty without places."""
        return ""

    def place_dict(self, place: float) -> dict[str, Any]:
        """Return the place as plain data for JSON."""
        return {}

    @property
    def absent(self) -> str:
        """Return the text for a metric without a value."""
        return "undefined" if self.linear else "no value"

    @property
    def sign(self) -> str:
        """The sense as a sign."""
        return "≤" if self.sense == "at most" else "≥"

    def badness(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the metric values with the sign for which larger is worse (shape unchanged); NaN becomes inf."""
        figure = np.asarray(values, dtype=float)
        return np.where(np.isnan(figure), np.inf, figure if self.sense == "at most" else -figure)

    def normalised(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the normalised metric values (shape unchanged): at most 1 if the goal is met, larger if worse.

        The normalised value is metric / limit for a goal `at most` with a positive limit. For every other goal, it is
        limit / metric. The quotient limit / metric is inf for a metric that is 0 or on the wrong side of 0. NaN gives
        inf.
        """
        figure, limit = np.asarray(values, dtype=float), self.limit
        if self.sense == "at most" and limit > 0:
            out = figure / limit
        else:
            # a metric below a negative limit corresponds to a metric above a positive limit
            size, bound = (figure, limit) if limit > 0 else (-figure, -limit)
            out = np.full(figure.shape, np.inf)
            np.divide(bound, size, out=out, where=size > 0)
        return np.where(np.isnan(figure), np.inf, out)

    def to_dict(self) -> dict[str, Any]:
        """The goal as plain data for JSON."""
        bound = {"metric": self.metric, "unit": self.unit, "limit": self.limit, "sense": self.sense}
        return {"name": self.name, **bound, "kind": self.kind, "over": self.over}


def load_loop_goals(path: Path | str) -> tuple[tuple[LoopGoal, ...], dict[str, dict[str, Any]]]:
    """Load the goals about the loop from a goals file, and its operating points by name (values as in `run_numbers`).

    Raises:
        InputError: the file is unreadable, or a goal is wrong or about a metric of the robot's runs.

    Example:
        >>> from pathlib import Path
        >>> from surctl.tuning import load_loop_goals
        >>> text = '''kind = "goals"
        ... name = "tank"
        ... [[points]]
        ... name = "rain"
        ... values = { "disturbance.rain" = 0.1 }
        ... [[goals]]
        ... name = "robust"
        ... type = "sensitivity"
        ... at = "flow"
        ... at_most = { value = 1.6, unit = "1" }
        ... '''
        >>> _ = Path("tank.toml").write_text(text)
        >>> goals, points = load_loop_goals("tank.toml")
        >>> goals[0].name, points
        ('robust', {'rain': {'disturbance.rain': 0.1}})
    """
    goals, points, _ = _load(path, None)
    return goals, points


def load_system_goals(
    path: Path | str, system: System
) -> tuple[tuple[LoopGoal, ...], dict[str, dict[str, Any]], tuple[RunGoal, ...]]:
    """Load the goals of a system: those about the loop, the operating points by name, and those about costs of runs.

    A goal with `metric`, the name of a cost of the system, bounds this cost.

    Raises:
        InputError: as for `load_loop_goals`, or the system has no such cost.
    """
    return _load(path, system)


def _load(
    path: Path | str, system: System | None
) -> tuple[tuple[LoopGoal, ...], dict[str, dict[str, Any]], tuple[RunGoal, ...]]:
    path = pick(str(path), LIBRARY, what="goals")
    content = load_model(path, GoalsFile)
    with mistakes_in(path):
        check_once((table.name for table in content.goals), **TWICE)
        runs = tuple(_run_goal(table, system) for table in content.goals if table.type is None)
        points = _points(content.points)
        goals = tuple(loop_goal(table.loop()) for table in content.goals if table.type is not None)
        check_points(goals, points)
    return goals, points, runs


def _run_goal(table: GoalTable, system: System | None) -> RunGoal:
    key = f"goals.{table.name}"
    if system is None:
        problem, remedy = "is about a run", "write type = ..., see the guide `Tune the gains`"
        raise InputError(problem, key=f"{key}.metric", value=table.metric, remedy=remedy)
    cost = table.metric or ""
    if cost not in system.costs:
        remedy = nearest(cost, system.costs) if system.costs else "give System(..., costs={...})"
        raise InputError("is not a cost of the system", key=f"{key}.metric", value=cost, remedy=remedy)
    for name in sorted(table.model_fields_set - {"name", "metric", "at_most", "at_least", "kind"}):
        raise InputError("is not a key of a goal on a cost", key=f"{key}.{name}", remedy="leave it out")
    sense, bound = table.bound(system.costs[cost].unit)
    if not (np.isfinite(bound.value) and bound.value > 0):
        where = f"{key}.{sense.replace(' ', '_')}"
        raise InputError("must be finite and greater than 0", key=where, value=bound.value, remedy="correct it")
    return RunGoal(table.name, cost, bound.unit, bound.value, sense, table.kind, "mean")


def _points(tables: tuple[PointTable, ...]) -> dict[str, dict[str, Any]]:
    """Return the values of each operating point by its name."""
    points: dict[str, dict[str, Any]] = {}
    for table in tables:
        if table.name in points:
            raise InputError("is the name of two points", key="points.name", value=table.name, remedy="rename one")
        points[table.name] = {
            name: [list(value)] if isinstance(value, tuple) else value for name, value in table.values.items()
        }
    return points


_ACTIVE = 0.01
"""Share of time at a limit above which a step response of the linear loop does not describe a run."""

_STEP_METRICS = ("settling_time_s.", "overshoot.")
_STEPS = (Overshoot, Settling, StepRejection, StepTracking)


def not_representative(
    goals: Sequence[RunGoal], after: Assessment, *, command: str, run: str, remedy: str
) -> list[str]:
    """Return a line that says that linear goals do not describe a run; nothing if no limit is active.

    Args:
        goals: the goals of a tuning; those about a step response of the linear loop count.
        after: the assessment of the tuned gains, whose figure `limited_share` is the share of time at a limit.
        command, run: what is at its limit, and in which run; `{}` stands for the place of the figure.
        remedy: how the goal is asked of the run.
    """
    names = [
        goal.name
        for goal in goals
        if goal.metric.startswith(_STEP_METRICS) or isinstance(getattr(goal, "loop", None), _STEPS)
    ]
    limited = after.figures.get("limited_share")
    if not names or limited is None or not limited.value > _ACTIVE:
        return []
    at = f"{command} is at its limit {limited.value:.0%} of {run}".format(limited.where)
    return [f"not representative: {', '.join(names)} (linear): {at}; {remedy}"]
