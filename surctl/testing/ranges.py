"""A failed check, and the type of what is checked."""

from __future__ import annotations

from surctl.errors import InputError, SurctlError


class CheckFailed(SurctlError, AssertionError):
    """Raised when a check fails; the message states the object (task, law), the error and the point.

    The class is also an AssertionError, so that test runners count it as a failed test.

    Args:
        what: the object that was checked, for example "task depth" or "law hover".
        problem: how the object fails the check, without a full stop.
        at: the values at which the object fails the check; "" if it fails at all values.
    """

    def __init__(self, what: str, problem: str, *, at: str = "") -> None:
        self.what, self.problem, self.at = what, problem, at
        super().__init__(" ".join(f"{what}: {problem}{f', at {at}' if at else ''}".split()))


def checked_type(value: object, kind: type, *, key: str) -> None:
    """Raise an InputError unless the value is an instance of a class; a function in its place is to be called."""
    if not isinstance(value, kind):
        remedy = "give what the function returns" if callable(value) else f"give a surctl {kind.__name__}"
        raise InputError(f"got {type(value).__name__}, not {kind.__name__}", key=key, remedy=remedy)
