"""A conformance check for tasks, which states where it fails; the system of the examples."""

from surctl.tasks.ranges import Parameter
from surctl.testing.ranges import CheckFailed
from surctl.testing.systems import cart_system
from surctl.testing.tasks import TaskReport, check_task

__all__ = ["CheckFailed", "Parameter", "TaskReport", "cart_system", "check_task"]
