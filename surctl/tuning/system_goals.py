"""Goals files for a system: goals about the loop and about runs, and operating points."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from surctl.errors import InputError, nearest
from surctl.files import load_model, pick
from surctl.system import System
from surctl.tuning.goal_file import LIBRARY, GoalsFile, GoalTable
from surctl.tuning.goal_search import RunGoal
from surctl.tuning.loop_goal_file import PointTable, check_points, loop_goal
from surctl.tuning.loop_goals import LoopGoal

__all__ = ["load_loop_goals", "load_system_goals"]


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

    Example:
        >>> from pathlib import Path
        >>> from surctl.ir import Layout, Port
        >>> from surctl.system import Controller, Cost, Plant, System
        >>> from surctl.tuning import load_system_goals
        >>> speed, force = Port("speed", (1,), "m/s", "of the cart", 1.0), Port("force", (1,), "m/s^2", "over the mass")
        >>> cart = Plant("cart", Layout((speed,)), Layout((force,)), lambda x, f, d, p: {"speed": f["force"]})
        >>> law = Controller("brake", 0.1, Layout((speed,)), Layout((force,)), lambda x, u, p: -u["speed"])
        >>> rest = Cost(lambda s: s.x["speed"] - 0.1, "last_time", "s")
        >>> text = "kind = 'goals'\\nname = 'cart'\\n[[goals]]\\nname = 'quick'\\nmetric = 'rest'\\nat_most = '4 s'"
        >>> _ = Path("cart.toml").write_text(text)
        >>> load_system_goals("cart.toml", System(cart, law, costs={"rest": rest}))[2]
        (RunGoal(name='quick', cost='rest', at_most=4.0, kind='soft'),)
    """
    return _load(path, system)


def _load(
    path: Path | str, system: System | None
) -> tuple[tuple[LoopGoal, ...], dict[str, dict[str, Any]], tuple[RunGoal, ...]]:
    path = pick(str(path), LIBRARY, what="goals")
    content = load_model(path, GoalsFile)
    try:
        names = [table.name for table in content.goals]
        for name in names:
            if names.count(name) > 1:
                raise InputError("is the name of two goals", key="goals.name", value=name, remedy="rename one")
        runs = tuple(_run_goal(table, system) for table in content.goals if table.type is None)
        points = _points(content.points)
        goals = tuple(loop_goal(table.loop()) for table in content.goals if table.type is not None)
        check_points(goals, points)
    except InputError as error:
        raise error.inside(path) from None
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
    for name in sorted(table.model_fields_set - {"name", "metric", "at_most", "kind"}):
        raise InputError("is not a key of a goal on a cost", key=f"{key}.{name}", remedy="leave it out")
    if table.at_most is None:
        raise InputError("needs a bound", key=key, remedy="write at_most = ...")
    try:
        bound = table.at_most.within(system.costs[cost].unit).value
    except InputError as error:
        raise error.inside(None, f"{key}.at_most.unit") from None
    if not (np.isfinite(bound) and bound > 0):
        raise InputError("must be finite and greater than 0", key=f"{key}.at_most", value=bound, remedy="correct it")
    return RunGoal(table.name, cost, bound, table.kind)


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
