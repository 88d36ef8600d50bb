"""Conformance checks for systems, tasks and limits; a failed check states where it fails."""

from surctl.testing.ranges import CheckFailed, Parameter
from surctl.testing.systems import cart_system, check_controller, check_plant
from surctl.testing.tasks import TaskReport, check_limit, check_task

__all__ = [
    "CheckFailed", "Parameter", "TaskReport", "cart_system", "check_controller", "check_limit",
    "check_plant", "check_task",
]  # fmt: skip
