"""The tree of errors; each carries its payload and says the next step.

::

    SurctlError                 whatever this package raises on purpose
    ├── InputError              a user's mistake: file, key, value, remedy; the CLI exits with status 2
    │   ├── NotApplicable       a claim that is about other vehicles, speeds or gains than those at hand
    │   ├── ToolMissing         an outside program (compiler, ...) that the job needs is not there
    │   └── UnsupportedOperation  an operation that the instruction list does not carry
    ├── SolverError             a solver broke its contract (never raised for an infeasible problem)
    └── SelfTestError           two lives of one law disagree
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
    """Whatever this package raises on purpose; `exit_status` is what the command line ends with."""

    exit_status = 1


class InputError(SurctlError):
    """A user's mistake, told in one line: where, what, and what to do about it.

    Args:
        problem: what is wrong, without a full stop.
        file: the file that holds the mistake, if any.
        key: dotted key inside the file, or the option's name.
        value: the offending value.
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
        """The same mistake, told with the file (and key) in which it was made."""
        return InputError(self.problem, file=file, key=key or self.key, value=self.value, remedy=self.remedy)


class NotApplicable(InputError):
    """A claim assumes what the case at hand violates: no mistake of the user's, and no verdict on the claim.

    Args:
        because: the violated assumption with its numbers: "m11 = 50 kg and m22 = 60 kg differ and …".
        to: what the claim does not apply to.
        key: name of the claim, if known.
    """

    def __init__(self, because: str, *, to: str = "this vehicle", key: str | None = None) -> None:
        self.because, self.to = because, to
        super().__init__(f"not applicable to {to}, because {because}", key=key)

    def inside(self, file: object, key: str | None = None) -> NotApplicable:
        """The same, told with the file that holds the claim."""
        return NotApplicable(self.because, to=self.to, key=key or str(file))


class ToolMissing(InputError):
    """An outside program that the job needs is not installed."""


class UnsupportedOperation(InputError):
    """A symbolic operation that the instruction list refuses, by name, with its substitute."""


class SolverError(SurctlError):
    """A numerical solver broke its contract; infeasibility is a result, not an error."""


class SelfTestError(SurctlError):
    """Two lives of one law (Python, instruction list, C) do not give the same numbers."""


def nearest(name: str, known: Iterable[str]) -> str:
    """Remedy text that names the known name nearest to `name`, or lists what there is.

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
