"""The stacks that the shipped laws solve (`--stack`), and the region in which their conditions are decided."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca

from surctl.errors import InputError, nearest
from surctl.priority.diagnosis.findings import Bounds, Parameter
from surctl.tasks import Stack, clearance_task, depth_task, heading_task, velocity_task

SHIPPED_STACKS: Mapping[str, str] = {
    "guarded": "velocity, depth, heading; obstacles and walls are constraints of the priority problem, not tasks",
    "paper": "four sensor sub-tasks (17) by urgency, velocity, depth, heading",
}

_REGION: Bounds = ([-0.2, -0.2, -1.0, -3.1], [0.2, 0.2, 0.0, 3.1])
_ECHOES = {
    "ahead": ([1.0, -1.0], [3.0, 1.0]),
    "left": ([-1.0, 1.0], [1.0, 3.0]),
    "behind": ([-3.0, -1.0], [-1.0, 1.0]),
    "right": ([-1.0, -3.0], [1.0, -1.0]),
}
"""Lower and upper corner of the echo position in each quadrant [m]: on that side of the robot, up to 3 m away."""


@dataclass(frozen=True, eq=False)
class ShippedStack:
    """A stack, and the region of the pose η and of the parameters for which the convergence conditions are decided."""

    stack: Stack
    region: Bounds
    parameters: tuple[Parameter, ...]


def shipped_stack(name: str) -> ShippedStack:
    """Return the stack of a shipped law, by the law's name.

    Gains and targets do not affect the Jacobians; all gains are 1, and the targets lie in the region. The robot is near
    the origin, with one sonar echo in each quadrant. The law sorts the sensor sub-tasks by urgency; the conditions of
    pairs of tasks do not depend on this order.

    Raises:
        InputError: the name is unknown.
    """
    if name not in SHIPPED_STACKS:
        raise InputError("is not a shipped stack", key="stack", value=name, remedy=nearest(name, SHIPPED_STACKS))
    eta, desired = ca.SX.sym("eta", 4), ca.SX.sym("desired", 2)
    lower = (velocity_task(eta, desired), depth_task(eta, -0.5), heading_task(eta, 0.0))
    parameters: list[Parameter] = [(desired, -0.25, 0.25)]
    above = []
    for side, (low, high) in _ECHOES.items() if name == "paper" else ():
        echo = ca.SX.sym(f"echo_{side}", 2)
        above.append(clearance_task(eta, echo, margin=0.3, name=side))
        parameters.append((echo, low, high))
    return ShippedStack(Stack((*above, *lower)), _REGION, tuple(parameters))
