"""What a law decides: tasks by priority, barriers, and its next state; and the symbols that all laws share."""

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
    Port("blocker", (2,), "m", "what blocked the wish at the last step, x, y in {E}"),
    Port("last_velocity", (2,), "m/s", "horizontal velocity commanded at the last step, in {E}"),
)


class TaskLevel(NamedTuple):
    """A priority level in symbols: J ν should be `reference` (k, 1) [unit]; J (k, 4)."""

    name: str
    J: ca.SX
    reference: ca.SX
    unit: str

    @staticmethod
    def of(task: Task) -> TaskLevel:
        """What a task asks for."""
        return TaskLevel(task.name, task.jacobian(), task.reference(), task.rate_unit)


@dataclass(frozen=True)
class Decision:
    """What a law asks the priority solver for.

    Attributes:
        levels: tasks, highest first; a level may be switched off by a zero Jacobian and reference.
        rows: barriers on ν for modes that take inequalities.
        velocity: horizontal velocity asked for (2, 1) in {E} [m/s].
        avoiding: 1 while a contact changes the wish.
        degraded: 1 when no course satisfied every contact.
        state: next state by port name.
        halted: 1 while it stands, or nearly so, because it does not know what is ahead.
    """

    levels: Sequence[TaskLevel]
    rows: Sequence[HalfPlane]
    velocity: ca.SX
    avoiding: ca.SX
    degraded: ca.SX
    state: dict[str, ca.SX]
    stopped: ca.SX = field(default_factory=lambda: ca.SX(0))


class Scan(NamedTuple):
    """What a law that scans is told beside the contacts, as `ports.scan_inputs` has it."""

    unknown: ca.SX
    sonars: ca.SX
    placed: ca.SX


def lower_levels(
    eta: ca.SX, desired: DesiredMotion, p: Mapping[str, ca.SX], scan: Scan | None = None
) -> tuple[TaskLevel, TaskLevel]:
    """Below the velocity: depth, then heading.

    A law with sonars turns all the time in place of the heading, with `spin` or as fast as the yaw thrust holds, and
    keeps its depth rate at 0 while it does not know where it is.
    """
    depth = TaskLevel.of(depth_task(eta, p["depth"], gain=p["k2"]))
    if scan is None:
        return depth, TaskLevel.of(heading_task(eta, desired.heading, gain=p["k_psi"]))
    turning = ca.fmin(ca.fmax(p["spin_limit"], -p["spin"]), p["spin"])
    depth = depth._replace(reference=ca.if_else(scan.placed, depth.reference, 0))
    return depth, TaskLevel("scan", ca.SX([[0, 0, 0, 1]]), turning, "rad/s")


def weakest_acceleration(p: Mapping[str, ca.SX]) -> ca.SX:
    """What the horizontal thrust gives at the least [m/s²]."""
    return ca.fmin(p["thrust_limit"][0], p["thrust_limit"][1]) / ca.fmax(p["mass"][0], p["mass"][1])
