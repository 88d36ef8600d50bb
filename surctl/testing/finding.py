"""The exception that a failed check raises, with a message of one line."""

from __future__ import annotations

from surctl.errors import SurctlError

__all__ = ["CheckFailed"]


class CheckFailed(SurctlError, AssertionError):
    """Raised when a check fails; the message states the object (task, limit, backend), the error and the point.

    The class is also an AssertionError, so that test runners count it as a failed test.

    Args:
        what: the object that was checked, for example "task depth" or "limit wall".
        problem: how the object fails the check, without a full stop.
        at: the values at which the object fails the check; "" if it fails at all values.
    """

    def __init__(self, what: str, problem: str, *, at: str = "") -> None:
        self.what, self.problem, self.at = what, problem, at
        super().__init__(" ".join(f"{what}: {problem}{f', at {at}' if at else ''}".split()))
