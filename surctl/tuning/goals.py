"""Goals: bounds on figures of the closed loop, each with its unit, as control engineers state them.

The normalised value of a goal is the habit of the Control System Tuner (systune, viewGoal): at most 1 means met.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from surctl.errors import InputError, nearest
from surctl.files import Quantity, Strict, load_model, pick
from surctl.simulation import METRICS
from surctl.verification import LINEAR_METRICS, cruise_speeds, worst_place

__all__ = [
    "LIBRARY",
    "Goal",
    "GoalTable",
    "Kind",
    "Over",
    "Plants",
    "Sense",
    "goals_at",
    "goals_from_tables",
    "load_goals",
]

LIBRARY = Path(__file__).parent / "library"

Kind = Literal["hard", "soft"]
Sense = Literal["at most", "at least"]
Over = Literal["worst", "mean"]
Plants = Literal["all", "nominal"]

_SIGNED = ("slowest_pole_per_s",)  # a bound on a real part is below 0; every other figure is bounded by a positive one


@dataclass(frozen=True)
class Goal:
    """One bound on one figure.

    Attributes:
        name: what the tables and pictures call it.
        metric: a figure of a run (`surctl.simulation`'s METRICS) or of the linear loop (LINEAR_METRICS).
        unit: of `limit`; it must be the metric's own.
        limit: the bound.
        sense: whether the figure is to be at most or at least the limit.
        kind: a hard goal must be met; a soft one is brought as low as can be.
        over: taken at its worst run, or at the mean of the runs.
        cases: names of scenarios or of cases that it is about; empty for all.
        plants: "nominal" leaves out the runs whose plant is not the case's vehicle (systune's property Models).
        cruise: speeds [m/s], slowest first, at each of which the linear loop is to meet it; empty: the scenario's own.

    Raises:
        InputError: unknown metric, wrong unit, the sense against the metric's own, a limit that bounds nothing, speeds
            that are none, or of a goal that is not about the linear loop.
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
    cruise: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        known = {**METRICS, **LINEAR_METRICS}
        key = f"goals.{self.name}"
        if self.metric not in known:
            raise InputError(
                "no such metric", key=f"{key}.metric", value=self.metric, remedy=nearest(self.metric, known)
            )
        spec = known[self.metric]
        bound = f"{key}.{self.sense.replace(' ', '_')}"
        if self.unit != spec.unit:
            raise InputError("wrong unit", key=f"{bound}.unit", value=self.unit, remedy=f"give it in {spec.unit}")
        if spec.better is not None and self.sense != ("at most" if spec.better == "low" else "at least"):
            other = "at_least" if self.sense == "at most" else "at_most"
            raise InputError(f"bounds {spec.meaning} on the good side", key=bound, remedy=f"write {other} instead")
        signed = self.metric in _SIGNED
        if not np.isfinite(self.limit) or (self.limit >= 0 if signed else self.limit <= 0):
            side = "less than 0" if signed else "greater than 0"
            raise InputError(f"must be finite and {side}", key=bound, value=self.limit, remedy="correct the limit")
        if self.cruise:
            object.__setattr__(self, "cruise", cruise_speeds(self.cruise, key=self.cruise_key))
            if not self.linear:
                remedy = "leave it out: what is flown has its scenario's speed"
                raise InputError("is for goals about the linear loop", key=self.cruise_key, remedy=remedy)

    @property
    def linear(self) -> bool:
        """Whether the figure is one of the linear loop, which no seed changes."""
        return self.metric in LINEAR_METRICS

    @property
    def cruise_key(self) -> str:
        """What a goals file calls the speeds."""
        return f"goals.{self.name}.cruise_m_per_s"

    @property
    def columns(self) -> Mapping[str, float | None]:
        """The columns of figures that it is about, and the cruise speed [m/s] of each; None: the scenario's own."""
        return {f"{self.metric} at {u!r} m/s": u for u in self.cruise} or {self.metric: None}

    def badness(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """The figures, same shape, turned so that larger is worse; NaN is worst."""
        figure = np.asarray(values, dtype=float)
        return np.where(np.isnan(figure), np.inf, figure if self.sense == "at most" else -figure)

    def worst(self, table: Mapping[str, NDArray[np.float64]]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The worst figure over the speeds, and its speed [m/s] (NaN: the scenario's own); as a column's shape."""
        each = np.stack([table[name] for name in self.columns])
        ill = self.badness(each)
        speed = np.array([np.nan if u is None else u for u in self.columns.values()])
        return np.take_along_axis(each, ill.argmax(axis=0)[None], axis=0)[0], speed[worst_place(ill)]

    def normalised(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """The normalised value of each figure, same shape: at most 1 where the goal is met, rising as it gets worse.

        Figure over limit where it is to be at most that, limit over figure where at least; on the wrong side of zero
        the latter is inf, and so is NaN.
        """
        figure, limit = np.asarray(values, dtype=float), self.limit
        if self.sense == "at most" and limit > 0:
            out = figure / limit
        else:
            # a figure below a negative limit is the mirror of one above a positive limit
            size, bound = (figure, limit) if limit > 0 else (-figure, -limit)
            out = np.full(figure.shape, np.inf)
            np.divide(bound, size, out=out, where=size > 0)
        return np.where(np.isnan(figure), np.inf, out)

    def bad_side(self) -> Literal["above", "below"]:
        """Where a picture shades: the side of the limit that misses the goal."""
        return "above" if self.sense == "at most" else "below"

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        bound = {"metric": self.metric, "unit": self.unit, "limit": self.limit, "sense": self.sense}
        over = {"over": self.over, "cases": list(self.cases), "plants": self.plants}
        return {"name": self.name, **bound, "kind": self.kind, **over, "cruise_m_per_s": list(self.cruise)}


class GoalTable(Strict):
    """A `[[goals]]` table of a goals file or a study file."""

    name: str = Field(min_length=1)
    metric: str
    at_most: Quantity | None = None
    at_least: Quantity | None = None
    kind: Kind = "soft"
    over: Over = "worst"
    cases: tuple[str, ...] = ()
    plants: Plants = "all"
    cruise_m_per_s: tuple[float, ...] | None = None


class _GoalsFile(Strict):
    kind: Literal["goals"]
    name: str = Field(min_length=1)
    note: str = ""
    goals: tuple[GoalTable, ...] = Field(min_length=1)


def load_goals(name_or_path: str = "default") -> tuple[Goal, ...]:
    """Built-in goals by name, or a goals file by path.

    Raises:
        InputError: unreadable file, or a goal that is wrong; the message names file, key and remedy.

    Example:
        >>> from surctl.tuning import load_goals
        >>> [(goal.metric, goal.sense, goal.limit, goal.unit) for goal in load_goals("default") if goal.kind == "soft"]
        [('deviation_m', 'at most', 0.5, 'm'), ('time_s', 'at most', 53.0, 's'), ('effort_n', 'at most', 4.2, 'N')]
    """
    path = pick(str(name_or_path), LIBRARY, what="goals")
    return goals_from_tables(load_model(path, _GoalsFile).goals, file=path)


def goals_from_tables(tables: Sequence[GoalTable], *, file: object) -> tuple[Goal, ...]:
    """Goals from the tables of a file; InputError names it.

    Example:
        >>> from surctl.tuning import GoalTable, goals_from_tables
        >>> table = GoalTable(name="soon", metric="time_s", at_most={"value": 20.0, "unit": "s"}, kind="hard")
        >>> [goal] = goals_from_tables([table], file="my-study.toml")
        >>> goal.metric, goal.sense, goal.limit, goal.kind
        ('time_s', 'at most', 20.0, 'hard')
    """
    goals: dict[str, Goal] = {}
    try:
        for table in tables:
            if table.name in goals:
                raise InputError("two goals have one name", key="goals.name", value=table.name, remedy="rename one")
            goals[table.name] = _goal(table)
    except InputError as error:
        raise error.inside(file) from None
    return tuple(goals.values())


def _goal(table: GoalTable) -> Goal:
    bounds: Mapping[Sense, Quantity | None] = {"at most": table.at_most, "at least": table.at_least}
    stated = [(sense, bound) for sense, bound in bounds.items() if bound is not None]
    if len(stated) != 1:
        raise InputError(
            "needs one bound",
            key=f"goals.{table.name}",
            remedy='write at_most = { value = ..., unit = "..." }, or at_least',
        )
    sense, bound = stated[0]
    spec = {**METRICS, **LINEAR_METRICS}.get(table.metric)
    if spec is not None:  # else the goal itself says so
        try:
            bound = bound.within(spec.unit)
        except InputError as error:
            raise error.inside(None, f"goals.{table.name}.{sense.replace(' ', '_')}.unit") from None
    about = (table.kind, table.over, table.cases, table.plants)
    goal = Goal(table.name, table.metric, bound.unit, bound.value, sense, *about)
    if table.cruise_m_per_s is None:
        return goal
    return replace(goal, cruise=cruise_speeds(table.cruise_m_per_s, key=goal.cruise_key))


def goals_at(goals: Sequence[Goal], cruise: Sequence[float]) -> tuple[Goal, ...]:
    """The goals, those about the linear loop at these cruise speeds [m/s] where they name none of their own.

    Example:
        >>> from surctl.tuning import Goal, goals_at
        >>> [goal] = goals_at([Goal("robust", "disk_margin", "1", 0.6, "at least")], (0.05, 0.2))
        >>> goal.cruise
        (0.05, 0.2)
    """
    return tuple(replace(g, cruise=tuple(cruise)) if g.linear and not g.cruise else g for g in goals)
