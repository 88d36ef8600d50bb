"""The output of all commands: a text summary or one JSON object on stdout, and progress on stderr."""

from __future__ import annotations

import json
import math
import os
import re
import shlex
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

import click

from surctl.cli.streams import is_utf8
from surctl.errors import SurctlError

if TYPE_CHECKING:
    from surctl.verification.verdict import Inapplicable

__all__ = [
    "LOST",
    "FiniteRange",
    "Stopped",
    "as_json",
    "finish",
    "finite",
    "interrupted",
    "noting_interrupts",
    "out_folder",
    "print_message",
    "printable",
    "raise_lost_interrupt",
    "refusal_line",
    "same_command",
    "saving",
    "stoppable",
    "together",
]

C = TypeVar("C", bound=Callable[..., Any])

LOST = 3
"""Exit status of a command whose result is as expected, but some of whose output could not be written."""
_LOST_FILES = "surctl.lost_files"  # key of the command's context


class FiniteRange(click.FloatRange):
    """A finite number in a range (NaN passes every comparison of `click.FloatRange`)."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the number; fail if it is NaN or infinite."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number", param, ctx)
        return number


def together(*options: Callable[[C], C]) -> Callable[[C], C]:
    """Combine several options into one decorator; the help lists the options in this order."""

    def decorate(command: C) -> C:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


as_json = click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout.")
out_folder = click.option(
    "--out", type=click.Path(path_type=Path), metavar="DIR", help="Folder for plots and files (default: no files)."
)


def finite(value: Any) -> Any:
    """Return the data with null for every number that JSON cannot represent (NaN and infinities)."""
    if isinstance(value, Mapping):
        return {str(k): finite(v) for k, v in value.items()}
    if isinstance(value, str):
        return value
    if isinstance(value, Sequence):
        return [finite(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def printable(lines: Sequence[str]) -> list[str]:
    """Return the lines with control and format characters escaped as in JSON."""
    return [
        line if line.isprintable() else "".join(c if c.isprintable() else json.dumps(c)[1:-1] for c in line)
        for line in lines
    ]


def finish(
    result: Mapping[str, Any], lines: Sequence[str], *, as_json: bool, passed: bool, then: Sequence[str] = ()
) -> None:
    """Print the result and the suggested next commands, and exit with status 0 if `passed`, otherwise 1."""
    shown = [*lines, "next", *(f"  {command}" for command in then)] if then else lines
    data = {**result, "next": list(then)} if then else result
    lines = printable([json.dumps(finite(data), ensure_ascii=not is_utf8())]) if as_json else shown
    text = "\n".join(lines)
    sys.stdout.write((text if as_json or not _has_colours() else _coloured(text)) + "\n")
    sys.stdout.flush()
    context = click.get_current_context()
    context.exit(1 if not passed else LOST if context.meta.get(_LOST_FILES) else 0)


def _has_colours() -> bool:
    plain = os.environ.get("NO_COLOR") or os.environ.get("TERM", "dumb") == "dumb"
    return sys.stdout.isatty() and not plain


_COLOURS = {"ok": "green", "FAIL": "red", "open": "yellow", "n/a": "yellow"}


def _coloured(text: str) -> str:
    """Return the text with a colour for the mark at the start of each line."""
    mark = re.compile(rf"^(?:{'|'.join(_COLOURS)})(?= )", flags=re.MULTILINE)
    return mark.sub(lambda word: click.style(word[0], fg=_COLOURS[word[0]]), text)


@contextmanager
def saving(what: str) -> Iterator[None]:
    """Print one line on stderr if the files inside the `with` statement cannot be drawn or written.

    The command continues, since its results do not depend on these files; `finish` exits with status `LOST`.
    """
    try:
        yield
    except Exception as error:
        if interrupted(error) or isinstance(error, click.Abort):
            raise
        reason = str(error) if isinstance(error, SurctlError) else f"{type(error).__name__}: {error}"
        print_message(f"{what} not saved: {reason}")
        click.get_current_context().meta[_LOST_FILES] = True


class Stopped(click.Abort):
    """The user stopped the command; the message says which results are saved and how to continue."""


@contextmanager
def stoppable(message: str, lines: Sequence[str] = (), *, as_json: bool = False) -> Iterator[None]:
    """Turn Ctrl-C inside the `with` statement into `Stopped`, after `lines` are printed (except with --json)."""
    try:
        yield
    except (Exception, KeyboardInterrupt) as error:
        if not interrupted(error):
            raise
        if lines and not as_json:
            sys.stdout.write("\n".join(lines) + "\n")
            sys.stdout.flush()
        raise Stopped(message) from None


def interrupted(error: BaseException | None) -> bool:
    """Return whether an exception is due to Ctrl-C, which a library may have replaced (see `noting_interrupts`)."""
    if isinstance(error, Stopped):  # already reported, by an inner part of the command
        return False
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or (None if error.__suppress_context__ else error.__context__)
    _raised.extend(_interrupts[len(_raised) :])
    return error is not None or bool(_interrupts)


def raise_lost_interrupt() -> None:
    """Raise KeyboardInterrupt if Ctrl-C was pressed where exceptions are lost, as in a finaliser or a callback of C."""
    if len(_raised) < len(_interrupts):
        _raised.extend(_interrupts[len(_raised) :])
        raise KeyboardInterrupt


_interrupts: list[int] = []  # a lock, as of threading.Event, could wait for itself in a signal handler
_raised: list[int] = []  # those of them that have reached the command


@contextmanager
def noting_interrupts() -> Iterator[None]:
    """Note every Ctrl-C inside the `with` statement, for `interrupted`.

    CasADi replaces KeyboardInterrupt inside a conversion by an exception that names neither a cause nor a context.
    """

    def note(number: int, frame: FrameType | None) -> NoReturn:
        _interrupts.append(number)
        signal.default_int_handler(number, frame)

    before = signal.getsignal(signal.SIGINT)
    if before is not signal.default_int_handler or threading.current_thread() is not threading.main_thread():
        yield  # Ctrl-C is ignored, or is another program's
        return
    signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        _interrupts.clear()
        _raised.clear()


def refusal_line(refused: Inapplicable) -> str:
    """Return one line for a claim that is not applicable."""
    return f"n/a  {refused.claim:<22} {refused.sentence}"


def same_command(**changed: int) -> str:
    """Return the command line of this process, quoted for a shell, with the values of some options replaced."""
    words, typed = [], iter(sys.argv[1:])
    for word in typed:
        if word.partition("=")[0].removeprefix("--") in changed and word.startswith("--"):
            if "=" not in word:
                next(typed, None)
            continue
        words.append(word)
    words += [word for name, value in changed.items() for word in (f"--{name}", str(value))]
    return shlex.join(["surctl", *words])


def print_message(text: str) -> None:
    """Print one line on stderr that names this program."""
    with suppress(OSError):  # if stderr cannot be written, the exit status still reports the error
        sys.stderr.write("surctl: " + " ".join(text.split()) + "\n")
