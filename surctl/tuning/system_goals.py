"""Goals files for a system: goals about the loop, and operating points."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from surctl.errors import InputError
from surctl.files import load_model, pick
from surctl.tuning.goal_file import LIBRARY, GoalsFile
from surctl.tuning.loop_goal_file import PointTable, check_points, loop_goal
from surctl.tuning.loop_goals import LoopGoal

__all__ = ["load_loop_goals"]


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
    path = pick(str(path), LIBRARY, what="goals")
    content = load_model(path, GoalsFile)
    try:
        for table in content.goals:
            if table.type is None:
                problem, remedy = "is a metric of the robot", "write type = ..., see the guide `Tune the gains`"
                raise InputError(problem, key=f"goals.{table.name}.metric", value=table.metric, remedy=remedy)
        points = _points(content.points)
        goals = tuple(loop_goal(table.loop()) for table in content.goals)
        names = [goal.name for goal in goals]
        for name in names:
            if names.count(name) > 1:
                raise InputError("is the name of two goals", key="goals.name", value=name, remedy="rename one")
        check_points(goals, points)
    except InputError as error:
        raise error.inside(path) from None
    return goals, points


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
