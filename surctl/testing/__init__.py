"""Conformance checks for tasks and limits, which state where a check fails; the system of the examples."""

from surctl.testing.ranges import CheckFailed, Parameter
from surctl.testing.systems import cart_system
from surctl.testing.tasks import TaskReport, check_limit, check_task

__all__ = ["CheckFailed", "Parameter", "TaskReport", "cart_system", "check_limit", "check_task"]
