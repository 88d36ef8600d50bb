"""What the robot should do: tasks σ(η), the ordered stack, and the limits it must keep."""

from __future__ import annotations

from surctl.tasks.library import (
    clearance_task,
    depth_task,
    distance_task,
    heading_task,
    line_of_sight_task,
    position_task,
    velocity_task,
)
from surctl.tasks.limits import HalfPlane, Limit, LimitRow, VelocityBox
from surctl.tasks.stack import Stack
from surctl.tasks.task import Task

__all__ = [
    "HalfPlane",
    "Limit",
    "LimitRow",
    "Stack",
    "Task",
    "VelocityBox",
    "clearance_task",
    "depth_task",
    "distance_task",
    "heading_task",
    "line_of_sight_task",
    "position_task",
    "velocity_task",
]
