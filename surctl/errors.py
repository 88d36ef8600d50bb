"""Exception classes with their exit status; findings of lint; remedies for unknown names; files that cannot be written.

::

    SurctlError                 base class of every error that this package raises deliberately
    ├── InputError              a user's mistake: file, key, value, remedy; the command line exits with status 2
    │   ├── NotApplicable       a claim whose assumptions the given vehicle, speed or gains do not meet
    │   ├── ToolMissing         an external program (compiler, ...) that the job needs is not installed
    │   └── UnsupportedOperation  a symbolic operation that the instruction list does not support
    └── SolverError             a numerical solver failed (never raised for an infeasible problem)

Every function may raise InputError for a wrong argument or file; the functions that a package exports say when.
"""

from __future__ import annotations

import difflib
import errno
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from math import isfinite
from numbers import Integral
from typing import Any, Literal, cast

__all__ = [
    "LOSSES", "LOST", "EmptyDomain", "Finding", "InputError", "NotApplicable", "SolverError", "SurctlError",
    "ToolMissing", "UnsupportedOperation", "cannot_write", "check_count", "check_known", "check_number", "check_once",
    "nearest",
]  # fmt: skip


LOST = 3
"""Exit status of a command some of whose output is lost: the disk is full or read-only, or stdout is closed."""

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
LOSSES = (*_FULL, errno.EIO, errno.EROFS)
"""Error numbers of a file system that takes no more output, whatever the name of the file is."""


class SurctlError(Exception):
    """Base class of every error that this package raises deliberately.

    The command line exits with the class's `exit_status`.
    """

    exit_status = 1


class InputError(SurctlError):
    """A user's mistake, reported in one line: where it is, what is wrong, and what to do.

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
        """Return the same error with the file (and key) that contains the mistake."""
        return InputError(self.problem, file=file, key=key or self.key, value=self.value, remedy=self.remedy)


@contextmanager
def mistakes_in(file: object, key: str | None = None) -> Iterator[None]:
    """Name the file (and key) that contains the mistake in an InputError of the block, see `InputError.inside`.

    A key that ends with a dot or colon is put before that of the error. Without a key, an error that names a file is
    raised unchanged.
    """
    try:
        yield
    except InputError as error:
        if error.file and key is None:
            raise
        if key is not None and key.endswith((".", ":")):
            key = f"{key}{error.key or ''}".rstrip(".:")
        raise error.inside(file, key) from None


@contextmanager
def writing(place: object, **options: Any) -> Iterator[None]:
    """Raise the error of `cannot_write` for an OSError of the block; `options` are arguments of that function."""
    try:
        yield
    except OSError as error:
        raise cannot_write(place, error, **options) from None


class NotApplicable(InputError):
    """The given case violates an assumption of a claim, so the claim is neither proved nor refuted.

    Args:
        because: the violated assumption with its numbers, such as "m11 = 50 kg and m22 = 60 kg differ and …".
        to: the case to which the claim does not apply.
        key: name of the claim, if known.
    """

    def __init__(self, because: str, *, to: str = "this vehicle", key: str | None = None) -> None:
        self.because, self.to = because, to
        super().__init__(f"not applicable to {to}, because {because}", key=key)

    def inside(self, file: object, key: str | None = None) -> NotApplicable:
        """Return the same error with the file that contains the claim."""
        return NotApplicable(self.because, to=self.to, key=key or str(file))


class EmptyDomain(InputError):
    """No sample lies in the domain of a claim, which may be empty."""


class ToolMissing(InputError):
    """An external program that the job needs is not installed."""


class UnsupportedOperation(InputError):
    """The instruction list does not support a symbolic operation; the message names it and a substitute."""


class SolverError(SurctlError):
    """A numerical solver failed; an infeasible problem is a regular result and never raises this error."""


@dataclass(frozen=True)
class Finding:
    """One finding about an entry of a file: an error (it cannot work), a warning, or a note (`info`).

    `clearance_m` is the distance [m] from a hull to a wall or obstacle that an error reports, negative for an overlap.
    """

    level: Literal["error", "warning", "info"]
    key: str
    text: str
    clearance_m: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the finding as plain data for JSON; `clearance_m` is present only if the finding has a clearance."""
        return {name: value for name, value in asdict(self).items() if value is not None}


def cannot_write(
    place: object, error: Exception, *, key: str | None = None, more: str = "", remedy: str | None = None
) -> InputError:
    """Return the InputError for a file or folder that cannot be written; its exit status is 3 for the `LOSSES`.

    Args:
        place: the file or folder.
        error: the exception of the attempt.
        key: option that names the place, if the message shall name it.
        more: what else the message says about the problem.
        remedy: what to do; default: what the cause suggests.

    Example:
        >>> from surctl.errors import cannot_write
        >>> full = cannot_write("out", OSError(28, "No space left on device"))
        >>> full.problem, full.remedy, full.exit_status
        ('cannot be written (No space left on device)', 'free disk space', 3)
        >>> cannot_write("out", OSError(13, "Permission denied")).remedy
        'choose a folder that you may write to'
    """
    number = getattr(error, "errno", None)
    if remedy is None:
        another = "choose a folder that you may write to"
        unclear = f"free disk space, or {another}"  # the library that writes gives no error number of the system
        remedy = "free disk space" if number in _FULL else another if (number or 0) > 0 else unclear
    problem = f"cannot be written ({getattr(error, 'strerror', None) or error}){more}"
    file, value = (place, None) if key is None else (None, place)
    outcome = InputError(problem, file=file, key=key, value=value, remedy=remedy)
    if number in LOSSES:
        outcome.exit_status = LOST
    return outcome


def nearest(name: object, known: Iterable[str]) -> str:
    """Return a remedy text that suggests the known name most similar to `name`, or lists all known names.

    Examples:
        >>> from surctl.errors import nearest
        >>> nearest("sur4000", ["sur400", "bluerov2-wu"])
        "did you mean 'sur400'?"
        >>> nearest("k_v", ["lookahead", "brake"])
        'known: brake, lookahead'
    """
    names = sorted(known)
    if not names:
        return "no name is known here"
    close = difflib.get_close_matches(str(name), names, n=1, cutoff=0.5)
    return f"did you mean {close[0]!r}?" if close else "known: " + ", ".join(names)


def check_known(
    name: object, known: Iterable[str], problem: str = "is not known", *, key: str, file: object = None
) -> None:
    """Raise InputError with the problem, and with the remedy of `nearest`, unless the name is one of the known names.

    Example:
        >>> from surctl.errors import check_known
        >>> check_known("sonr", ["sonar", "truth"], key="sensing")
        Traceback (most recent call last):
            ...
        surctl.errors.InputError: sensing = 'sonr': is not known; did you mean 'sonar'?
    """
    known = list(known)
    if name not in known:
        raise InputError(problem, file=file, key=key, value=name, remedy=nearest(name, known))


def check_once(names: Iterable[str], problem: str, *, key: str, remedy: str) -> None:
    """Raise InputError with the problem for the first name that occurs more than once.

    Example:
        >>> from surctl.errors import check_once
        >>> check_once(["yaw", "surge", "yaw"], "occurs twice", key="axis", remedy="drop one")
        Traceback (most recent call last):
            ...
        surctl.errors.InputError: axis = 'yaw': occurs twice; drop one
    """
    counts = Counter(names)
    for name, count in counts.items():
        if count > 1:
            raise InputError(problem, key=key, value=name, remedy=remedy)


def check_number(key: str, value: float, *, unit: str, zero: bool = False) -> None:
    """Raise InputError unless a number is finite and greater than 0, or with `zero` at least 0.

    Example:
        >>> from surctl.errors import check_number
        >>> check_number("latency", -0.1, unit="s", zero=True)
        Traceback (most recent call last):
            ...
        surctl.errors.InputError: latency = -0.1: must be at least 0; give s
    """
    problem = "must be at least 0" if zero else "must be greater than 0"
    try:
        good = isfinite(value) and (value >= 0 if zero else value > 0)
    except (TypeError, ValueError, OverflowError):  # a text, an array, an integer that no double holds
        good, problem = False, "is not a number"
    if not good:
        raise InputError(problem, key=key, value=value, remedy=f"give {unit}")


def check_count(key: str, value: object, *, least: int = 0) -> None:
    """Raise InputError unless a value is a whole number of at least `least`.

    Example:
        >>> from surctl.errors import check_count
        >>> check_count("trials", 0, least=1)
        Traceback (most recent call last):
            ...
        surctl.errors.InputError: trials = 0: must be at least 1; give a whole number
    """
    whole = isinstance(value, Integral) and not isinstance(value, bool)
    if not (whole and cast("int", value) >= least):
        problem = f"must be at least {least}" if whole else "is not a whole number"
        raise InputError(problem, key=key, value=value, remedy="give a whole number")
