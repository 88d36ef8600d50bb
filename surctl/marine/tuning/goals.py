"""Goals of a tuning of missions: metrics and figures that they bound, cruise speeds, built-in goals on margins.

The normalised value of a goal is defined as in MATLAB's Control System Tuner (systune, viewGoal): the goal is met if
the value is at most 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from surctl.errors import InputError, check_known, check_once, mistakes_in
from surctl.files import load_model, pick
from surctl.marine.simulation import METRICS
from surctl.marine.simulation.metrics import MetricSpec
from surctl.marine.verification import LINEAR_METRICS
from surctl.marine.verification.speeds import cruise_speeds
from surctl.tuning.goals import LIBRARY, TWICE, GoalsFile, GoalTable, RunGoal, loop_goal
from surctl.tuning.loop_goals import LoopGoal

ASSESSED: Mapping[str, MetricSpec] = {
    "nominal_disk_margin": MetricSpec("1", "disk margin of the nominal vehicle, all loops at once", "high"),
    "nominal_delay_margin_s": MetricSpec("s", "least delay margin of one loop alone, nominal vehicle", "high"),
    "corner_slowest_pole_per_s": MetricSpec("1/s", "largest real part of a pole over the corners", "low"),
    "region_m": MetricSpec("m", "distance beside the path from which the return is proved", "high"),
    "region_within_m": MetricSpec("m", "distance within which the motion ends, proved", "low"),
    "contact_margin_m": MetricSpec("m", "gain margin beyond the one that braking needs", "high"),
    "time_ratio": MetricSpec("1", "arrival time over the ideal time (path length / cruise speed)", "low"),
}
"""Figures of an assessment by name; goals on them are checked at the end of a tuning (`finals`)."""

PART_OF: Mapping[str, str] = {
    **dict.fromkeys(
        (
            "disk_margin", "single_loop_disk_margin", "delay_margin_s", "slowest_pole_per_s",
            "nominal_disk_margin", "nominal_delay_margin_s", "corner_slowest_pole_per_s",
        ),
        "loop",
    ),
    "region_m": "region",
    "region_within_m": "region",
    "contact_margin_m": "no contact",
    "time_ratio": "runs",
}  # fmt: skip
"""Part of an assessment with each figure that is checked at the end; those of the linear loop only for a law without a
linear model."""


LOOP_METRIC = "loop_goal"
"""Name of the metric of goals about the loop: the normalised value of the `LoopGoal`."""

_LOOP_SPEC = MetricSpec("1", "normalised value of the goal about the loop", "low")
_FLOOR = ("delay_margin_s", "disk_margin")  # figures of which the assessment requires a least value
_SIGNED = (
    "slowest_pole_per_s",
    "corner_slowest_pole_per_s",
)  # the bound on the real part of a pole is negative; all other bounds are positive


@dataclass(frozen=True)
class Goal(RunGoal):
    """A goal about missions: a bound on one metric of the closed loop.

    Attributes:
        metric: name of a metric, either of a run (METRICS of `surctl.marine.simulation`) or of the linear loop
            (LINEAR_METRICS), or of a figure of the assessment (ASSESSED), which is checked at the end of a tuning.
        unit: unit of `limit`; it must be the unit of the metric.
        cruise: cruise speeds [m/s], slowest first, at each of which the linear loop must meet the goal; empty: the
            scenario's own speed.
        loop: a goal about the loop of the law that runs (`LoopGoal`), for the metric `LOOP_METRIC`, which is its
            normalised value.

    Raises:
        InputError: the metric is unknown, the unit is wrong, the sense contradicts the metric, the limit has the wrong
            sign, a speed is not valid, or the goal has speeds but is not about the linear loop.
    """

    cruise: tuple[float, ...] = ()
    loop: LoopGoal | None = None

    def __post_init__(self) -> None:
        known = {**METRICS, **LINEAR_METRICS, **ASSESSED, **({} if self.loop is None else {LOOP_METRIC: _LOOP_SPEC})}
        key = f"goals.{self.name}"
        check_known(self.metric, known, "no such metric", key=f"{key}.metric")
        spec = known[self.metric]
        bound = f"{key}.{self.sense.replace(' ', '_')}"
        if self.unit != spec.unit:
            raise InputError("wrong unit", key=f"{bound}.unit", value=self.unit, remedy=f"give it in {spec.unit}")
        if spec.better is not None and self.sense != ("at most" if spec.better == "low" else "at least"):
            other = "at_least" if self.sense == "at most" else "at_most"
            raise InputError(f"bounds {spec.meaning} in the wrong direction", key=bound, remedy=f"write {other}")
        signed = self.metric in _SIGNED
        if not np.isfinite(self.limit) or (self.limit >= 0 if signed else self.limit <= 0):
            side = "less than 0" if signed else "greater than 0"
            raise InputError(f"must be finite and {side}", key=bound, value=self.limit, remedy="correct the limit")
        if self.final and (self.cases or self.over == "mean"):
            remedy = "leave out cases and over: the assessment states the worst of all missions"
            raise InputError("is a figure of the assessment", key=f"{key}.metric", value=self.metric, remedy=remedy)
        if self.cruise:
            object.__setattr__(self, "cruise", cruise_speeds(self.cruise, key=self.cruise_key))
            if not self.linear:
                remedy = "leave it out: a simulated run has the speed of its scenario"
                raise InputError("is for goals about the linear loop", key=self.cruise_key, remedy=remedy)

    @property
    def linear(self) -> bool:
        """Whether the metric describes the linear loop; a linear metric does not depend on the seed."""
        return self.metric in LINEAR_METRICS or self.loop is not None

    @property
    def final(self) -> bool:
        """Whether the metric is a figure of the assessment that the search does not compute."""
        return self.metric in ASSESSED

    @property
    def cruise_key(self) -> str:
        """Key of the cruise speeds in a goals file."""
        return f"goals.{self.name}.cruise_m_per_s"

    @property
    def columns(self) -> Mapping[str, float | None]:
        """Cruise speed [m/s] of each metric column that the goal bounds, by column name.

        None means the scenario's own cruise speed.
        """
        name = self.metric if self.loop is None else f"{self.metric} {self.name}"
        return {f"{name} at {u!r} m/s": u for u in self.cruise} or {name: None}

    def place_text(self, place: float) -> str:
        """Return at which cruise speed the goal is worst, for a table; empty if it names no speed."""
        return f"worst at {place:g} m/s" if self.cruise else ""

    def place_dict(self, place: float) -> dict[str, Any]:
        """Return the cruise speed as plain data for JSON; NaN for a goal at the scenario's own speed."""
        return {"worst_cruise_m_per_s": place}

    @property
    def absent(self) -> str:
        """Return the text for a metric without a value."""
        return "undefined" if self.linear else "no arrival"

    @property
    def part(self) -> str:
        """Part of the assessment with the metric, for a goal that is checked at the end of a tuning."""
        return PART_OF[self.metric]

    def to_dict(self) -> dict[str, Any]:
        """The goal as plain data for JSON."""
        about = {} if self.loop is None else {"loop": self.loop.to_dict()}
        runs = {"cases": list(self.cases), "plants": self.plants, "cruise_m_per_s": list(self.cruise)}
        return {**super().to_dict(), **runs, **about}


def load_goals(name_or_path: str = "default") -> tuple[Goal, ...]:
    """Load built-in goals by name, or a goals file by path.

    Raises:
        InputError: the file is unreadable or a goal is wrong; the message names file, key and remedy.

    Example:
        >>> from surctl.marine.tuning import load_goals
        >>> [(goal.metric, goal.sense, goal.limit, goal.unit) for goal in load_goals("default") if goal.kind == "soft"]
        [('deviation_m', 'at most', 0.5, 'm'), ('time_s', 'at most', 53.0, 's'), ('effort_n', 'at most', 4.2, 'N')]
    """
    path = pick(str(name_or_path), LIBRARY, what="goals")
    content = load_model(path, GoalsFile)
    if content.points:
        remedy = "use cruise_m_per_s and plants of each goal; [[points]] are for a system: surctl tune FILE.py:FUNCTION"
        raise InputError(_OF_SYSTEMS, file=path, key="points", remedy=remedy)
    return goals_from_tables(content.goals, file=path)


_OF_SYSTEMS = "apply only to a system of your own, not to the robot"


def goals_from_tables(tables: Sequence[GoalTable], *, file: object) -> tuple[Goal, ...]:
    """Build the goals that the `[[goals]]` tables of a file describe; an InputError names the file."""
    with mistakes_in(file):
        check_once((table.name for table in tables), **TWICE)
        return tuple(_goal(table) for table in tables)


def _goal(table: GoalTable) -> Goal:
    key = f"goals.{table.name}"
    if (table.type is None) == (table.metric is None):
        remedy = "write metric = ... for one number of a run or loop, or type = ... for a goal about the loop"
        raise InputError("needs either a metric or a type", key=key, remedy=remedy)
    if table.metric is not None:
        goal = _metric_goal(table, table.metric)
    elif table.points:
        remedy = "use cruise_m_per_s: operating points of the robot are its cruise speeds"
        raise InputError(_OF_SYSTEMS, key=f"{key}.points", remedy=remedy)
    else:
        about = loop_goal(table)
        goal = Goal(table.name, LOOP_METRIC, "1", 1.0, kind=table.kind, plants=table.plants, loop=about)
    if table.cruise_m_per_s is None:
        return goal
    return replace(goal, cruise=cruise_speeds(table.cruise_m_per_s, key=goal.cruise_key))


def _metric_goal(table: GoalTable, metric: str) -> Goal:
    own = {"name", "metric", "at_most", "at_least", "kind", "over", "cases", "plants", "cruise_m_per_s"}
    for name in sorted(table.model_fields_set - own):
        remedy = "write type instead of metric, or leave the key out"
        raise InputError("is not a valid key of a goal with a metric", key=f"goals.{table.name}.{name}", remedy=remedy)
    spec = {**METRICS, **LINEAR_METRICS, **ASSESSED}.get(metric)  # if it is unknown, Goal raises the error
    sense, bound = table.bound(None if spec is None else spec.unit)
    about = (table.kind, table.over, table.cases, table.plants)
    return Goal(table.name, metric, bound.unit, bound.value, sense, *about)


def goals_at(goals: Sequence[Goal], cruise: Sequence[float]) -> tuple[Goal, ...]:
    """Return the goals; every goal about the linear loop that names no speed gets the given cruise speeds [m/s]."""
    return tuple(replace(g, cruise=tuple(cruise)) if g.linear and not g.cruise else g for g in goals)


def with_floor(goals: Sequence[Goal]) -> tuple[Goal, ...]:
    """Return the goals, and the built-in hard goals on disk margin and delay margin that no goal bounds."""
    known, names = {goal.metric for goal in goals}, {goal.name for goal in goals}
    floor = [goal for goal in load_goals() if goal.metric in _FLOOR and goal.metric not in known]
    return (*goals, *(replace(goal, name=f"least {goal.name}") if goal.name in names else goal for goal in floor))
