"""Tables of a goals file: goals about metrics of runs, goals about loops, operating points."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from surctl.errors import InputError
from surctl.files import Quantity, Strict
from surctl.tuning.loop_goal_file import LoopGoalTable, PointTable

__all__ = ["LIBRARY", "GoalTable", "GoalsFile", "Over", "Plants"]

LIBRARY = Path(__file__).parent / "library"

Over = Literal["worst", "mean"]
Plants = Literal["all", "nominal"]


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


class GoalsFile(Strict):
    """Content of a goals file."""

    kind: Literal["goals"]
    name: str = Field(min_length=1)
    note: str = ""
    points: tuple[PointTable, ...] = ()
    goals: tuple[GoalTable, ...] = Field(min_length=1)
