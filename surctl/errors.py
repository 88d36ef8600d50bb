"""The hierarchy of errors; each error carries its data and names the next step.

::

    SurctlError                 base class of all errors that this package raises on purpose
    ├── InputError              a user's mistake: file, key, value, remedy; the command line exits with status 2
    │   ├── NotApplicable       a claim does not apply to the given vehicle, speeds or gains
    │   ├── ToolMissing         a required external program (compiler, ...) is not installed
    │   └── UnsupportedOperation  the instruction list does not support an operation
    ├── SolverError             a solver violated its specification (never raised for an infeasible problem)
    └── SelfTestError           two implementations of one law disagree
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable

__all__ = [
    "InputError",
    "NotApplicable",
    "SelfTestError",
    "SolverError",
    "SurctlError",
    "ToolMissing",
    "UnsupportedOperation",
    "nearest",
]


class SurctlError(Exception):
    """Base class of all errors that this package raises on purpose; `exit_status` is that of the command line."""

    exit_status = 1


class InputError(SurctlError):
    """A user's mistake; the message says in one line where it is, what is wrong, and what to do.

    Args:
        problem: what is wrong, without a full stop.
        file: the file that contains the mistake, if any.
        key: dotted key inside the file, or name of the option.
        value: the wrong value.
        remedy: what to write or do instead.
    """

    exit_status = 2

    def __init__(
        self,
        problem: str,
        *,
        file: object = None,
        key: str | None = None,
        value: object = None,
        remedy: str | None = None,
    ) -> None:
        self.problem, self.file, self.key, self.value, self.remedy = problem, file, key, value, remedy
        where = "" if file is None else f"{file}: "
        what = "" if key is None else key
        if value is not None:
            shown = repr(value)
            what += f" = {shown if len(shown) <= 60 else shown[:57] + '...'}"
        text = where + (f"{what.strip()}: " if what else "") + problem
        if remedy:
            text += f"; {remedy}"
        super().__init__(" ".join(text.split()))

    def inside(self, file: object, key: str | None = None) -> InputError:
        """Return the same error with the file (and key) that contains the mistake."""
        return InputError(self.problem, file=file, key=key or self.key, value=self.value, remedy=self.remedy)


class NotApplicable(InputError):
    """The given case violates an assumption of a claim: this is not a user's mistake and not a verdict on the claim.

    Args:
        because: the violated assumption with its numbers: "m11 = 50 kg and m22 = 60 kg differ and …".
        to: the vehicle, speed or other case to which the claim does not apply.
        key: name of the claim, if known.
    """

    def __init__(self, because: str, *, to: str = "this vehicle", key: str | None = None) -> None:
        self.because, self.to = because, to
        super().__init__(f"not applicable to {to}, because {because}", key=key)

    def inside(self, file: object, key: str | None = None) -> NotApplicable:
        """Return the same error with the file that contains the claim."""
        return NotApplicable(self.because, to=self.to, key=key or str(file))


class ToolMissing(InputError):
    """A required external program is not installed."""


class UnsupportedOperation(InputError):
    """The instruction list does not support a symbolic operation; the message names the operation and a substitute."""


class SolverError(SurctlError):
    """A numerical solver violated its specification; an infeasible problem is a result, not an error."""


class SelfTestError(SurctlError):
    """Two implementations of one law (Python, instruction list, C) do not give the same numbers."""


def nearest(name: str, known: Iterable[str]) -> str:
    """Return a remedy that suggests the known name most similar to `name`, or lists all known names.

    Examples:
        >>> from surctl.errors import nearest
        >>> nearest("sur4000", ["sur400", "bluerov2-wu"])
        "did you mean 'sur400'?"
        >>> nearest("k_v", ["lookahead", "brake"])
        'known: brake, lookahead'
    """
    names = sorted(known)
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    return f"did you mean {close[0]!r}?" if close else "known: " + ", ".join(names)
