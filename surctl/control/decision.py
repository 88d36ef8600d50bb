"""The decision of a law (tasks by priority, barriers and next state), and expressions that all laws share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import casadi as ca

from surctl.control.reference import DesiredMotion
from surctl.ir import Port
from surctl.tasks import HalfPlane, Task, depth_task, heading_task

__all__ = ["DECISION_PORTS", "Decision", "Scan", "TaskLevel", "lower_levels", "weakest_acceleration"]

DECISION_PORTS = (
    Port("side", (1,), "1", "latched passing side: 0 none, +1 obstacle on the right, -1 on the left"),
    Port("blocker", (2,), "m", "x, y in {E} of the contact that blocked the desired velocity in the last step"),
    Port("last_velocity", (2,), "m/s", "horizontal velocity commanded in the last step, in {E}"),
)


class TaskLevel(NamedTuple):
    """A priority level as symbolic expressions: J ν should equal `reference` (k, 1) [unit]; J has shape (k, 4)."""

    name: str
    J: ca.SX
    reference: ca.SX
    unit: str

    @staticmethod
    def of(task: Task) -> TaskLevel:
        """Return the priority level of a task."""
        return TaskLevel(task.name, task.jacobian(), task.reference(), task.rate_unit)


@dataclass(frozen=True)
class Decision:
    """The priority problem and the next state that a law decides on.

    Attributes:
        levels: tasks, highest priority first; a level with zero Jacobian and zero reference has no effect.
        rows: limit rows of the barriers on ν, for the priority modes with inequalities.
        velocity: commanded horizontal velocity (2, 1) in {E} [m/s].
        avoiding: 1 while a contact changes the desired velocity.
        degraded: 1 if no course satisfies the bounds of all contacts.
        state: next state by port name; a port that is not named keeps its value.
        stopped: 1 while the robot stops, or nearly stops, because it does not know what is ahead.

    Example:
        >>> import casadi as ca
        >>> from surctl.control import Decision
        >>> from surctl.tasks import depth_task
        >>> eta = ca.SX.sym("eta", 4)
        >>> [level.name for level in Decision([depth_task(eta, -0.5, gain=0.4)]).levels]
        ['depth']
    """

    levels: Sequence[TaskLevel | Task]
    rows: Sequence[HalfPlane] = ()
    velocity: ca.SX = field(default_factory=lambda: ca.SX.zeros(2))
    avoiding: ca.SX = field(default_factory=lambda: ca.SX(0))
    degraded: ca.SX = field(default_factory=lambda: ca.SX(0))
    state: Mapping[str, ca.SX] = field(default_factory=dict)
    stopped: ca.SX = field(default_factory=lambda: ca.SX(0))

    def task_levels(self) -> list[TaskLevel]:
        """Return the levels, each task as its Jacobian and reference."""
        return [level if isinstance(level, TaskLevel) else TaskLevel.of(level) for level in self.levels]


class Scan(NamedTuple):
    """The inputs, other than the contacts, of a law that scans with sonars; see `ports.scan_inputs`."""

    unknown: ca.SX
    sonars: ca.SX
    placed: ca.SX


def lower_levels(
    eta: ca.SX, desired: DesiredMotion, p: Mapping[str, ca.SX], scan: Scan | None = None
) -> tuple[TaskLevel, TaskLevel]:
    """Return the priority levels below the velocity task: depth, then heading.

    A law with sonars turns all the time instead of holding a heading. Its yaw rate is `spin`, or less if the yaw
    thrusters cannot sustain this rate. While the robot does not know its position, it keeps its depth rate at 0.
    """
    depth = TaskLevel.of(depth_task(eta, p["depth"], gain=p["k2"]))
    if scan is None:
        return depth, TaskLevel.of(heading_task(eta, desired.heading, gain=p["k_psi"]))
    turning = ca.fmin(ca.fmax(p["spin_limit"], -p["spin"]), p["spin"])
    depth = depth._replace(reference=ca.if_else(scan.placed, depth.reference, 0))
    return depth, TaskLevel("scan", ca.SX([[0, 0, 0, 1]]), turning, "rad/s")


def weakest_acceleration(p: Mapping[str, ca.SX]) -> ca.SX:
    """Return the least horizontal acceleration [m/s²] at full thrust: smaller thrust limit divided by larger mass."""
    return ca.fmin(p["thrust_limit"][0], p["thrust_limit"][1]) / ca.fmax(p["mass"][0], p["mass"][1])
