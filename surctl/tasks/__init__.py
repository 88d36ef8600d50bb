"""Tasks (a quantity σ of the pose η and its desired value), stacks of tasks in priority order, and velocity limits."""

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
from surctl.tasks.limits import (
    AccelerationLimit,
    Barrier,
    HalfPlane,
    ThrustLimit,
    VelocityBox,
    allowed_closing_speed,
)
from surctl.tasks.stack import RateLimit, SetTask, Stack
from surctl.tasks.task import Kind, Limit, LimitRow, Task, wrap

__all__ = [
    "AccelerationLimit", "Barrier", "HalfPlane", "Kind", "Limit", "LimitRow",
    "RateLimit", "SetTask", "Stack", "Task", "ThrustLimit", "VelocityBox", "allowed_closing_speed", "clearance_task",
    "depth_task", "distance_task", "heading_task", "line_of_sight_task", "position_task", "velocity_task", "wrap",
]  # fmt: skip
