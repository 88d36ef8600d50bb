"""What a check found, in one line."""

from __future__ import annotations

from surctl.errors import SurctlError

__all__ = ["CheckFailed"]


class CheckFailed(SurctlError, AssertionError):
    """A check failed: what (a task, a limit, a backend), how, and at which point.

    Also an AssertionError, so that test runners count it as a failed test.

    Args:
        what: what was checked, as "task depth" or "limit wall".
        problem: how it fails, without a full stop.
        at: the values at which it does; "" if it always does.
    """

    def __init__(self, what: str, problem: str, *, at: str = "") -> None:
        self.what, self.problem, self.at = what, problem, at
        super().__init__(" ".join(f"{what}: {problem}{f', at {at}' if at else ''}".split()))
