"""Output of all commands: summary of five lines, --json, progress, colours, Ctrl-C, files not saved, lost stdout."""

from __future__ import annotations

import codecs
import errno
import io
import json
import math
import os
import re
import shlex
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import wraps
from pathlib import Path
from textwrap import wrap
from types import FrameType
from typing import TYPE_CHECKING, Any, NoReturn, TextIO, TypeVar, cast

import click

from surctl.cli import lib
from surctl.errors import LOSSES, LOST, SurctlError

if TYPE_CHECKING:
    from sys import UnraisableHookArgs


_ESCAPE = "surctl-escape"


class OutputLost(Exception):
    """Standard output cannot be written; the message is empty if only its reader has ended, as `head` does."""


def open_closed_streams() -> None:
    """Connect closed standard streams (`>&-`, a service, pythonw) to the null device.

    Otherwise the next file that the process opens takes the descriptor, and a compiler's messages go into that file.
    """
    number = 0
    while number < 3:
        number = os.open(os.devnull, os.O_RDWR)
        if number < 3:
            os.set_inheritable(number, True)
    os.close(number)
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open(mode, encoding="utf-8"))  # noqa: SIM115  # open until the end


@contextmanager
def guarded_stdout() -> Iterator[None]:
    r"""Inside the `with` statement, stdout writes \uXXXX for characters that its encoding lacks.

    An error handler that the user has set (PYTHONIOENCODING=ascii:ignore) stays active.

    Raises:
        OutputLost: stdout cannot be written.
    """
    codecs.register_error(_ESCAPE, _escaped)
    stream = sys.stdout
    if isinstance(stream, io.TextIOWrapper) and stream.errors in ("strict", "surrogateescape"):
        stream.reconfigure(errors=_ESCAPE)
    sys.stdout = cast("TextIO", _Guarded(stream))
    try:
        yield
    finally:
        sys.stdout = stream


class _Guarded:
    """A text stream whose failures cannot be taken for those of another file."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        with _reported():
            return self._stream.write(text)

    def flush(self) -> None:
        with _reported():
            self._stream.flush()


@contextmanager
def _reported() -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise OutputLost("" if error.errno == errno.EPIPE else _lost_text(error)) from None


def is_utf8() -> bool:
    """Return whether stdout can write every character unchanged."""
    named = getattr(sys.stdout, "encoding", None) or "utf-8"
    return codecs.lookup(named).name == "utf-8"


def failed_write(error: OSError) -> str | None:
    """Return the message if the error means that output to a file was lost; None for any other error."""
    if error.errno not in LOSSES:
        return None
    return (f"{error.filename}: " if error.filename else "") + _lost_text(error)


def _lost_text(error: OSError) -> str:
    reason = os.strerror(error.errno or errno.EIO).lower()
    return f"the output cannot be written ({reason}); free disk space, or write to another place"


def discard(stream: TextIO) -> None:
    """Let later writes to the stream succeed without effect: Python tries at its end what it could not write before."""
    with suppress(OSError, ValueError):  # a stream in memory has no descriptor
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, stream.fileno())
        os.close(nothing)


def _escaped(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    codes = map(ord, error.object[error.start : error.end])
    return "".join(f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}" for code in codes), error.end


_LONGEST = 60.0  # s between two signs of life
_WORTH_TELLING = 2.0  # s


@dataclass
class _Activity:
    text: str = ""
    shown: float = 0.0  # time at which a line was printed [s]
    over: threading.Event = field(default_factory=threading.Event)

    def print(self, text: str) -> None:
        self.shown = time.monotonic()
        with suppress(OSError):  # a log that cannot be written does not stop the computation
            sys.stderr.write(f"  {text}\n")
            sys.stderr.flush()


_activity = _Activity()


def progress(text: str) -> None:
    """Print one line of progress on stderr."""
    doing(text)
    _activity.print(text)


@contextmanager
def timed(name: str, limit: float | None = None) -> Iterator[None]:
    """Print the name and the limit of the processor time [s], and at the end the time that the work took."""
    began, worked = time.monotonic(), time.process_time()
    progress(name if limit is None else f"{name}: at most {limit:g} s of processor time (--time-limit)")
    yield
    clock = time.monotonic() - began
    if clock >= _WORTH_TELLING:
        progress(f"{name}: {time.process_time() - worked:.1f} s of processor time, {clock:.1f} s by the clock")


def doing(text: str) -> None:
    """Set what the next sign of life says; this prints nothing, and raises an interrupt that was lost."""
    _activity.text = text
    raise_lost_interrupt()


def waiting() -> None:
    """Print no more signs of life, because the command waits for its user."""
    _activity.over.set()


@contextmanager
def signs_of_life(patience: float = 10.0) -> Iterator[None]:
    """Inside the `with` statement, print what the command does when it has printed nothing for `patience` [s].

    The lines become rarer, down to one a minute, until the command itself prints a line.
    """
    global _activity
    _activity = activity = _Activity(shown=time.monotonic())
    began = activity.shown

    def watch() -> None:
        wait, latest = patience, began
        while not activity.over.wait(patience / 10):
            if activity.shown != latest:
                wait, latest = patience, activity.shown
            if time.monotonic() - latest >= wait:
                activity.print(f"{activity.text or 'still working'} ({time.monotonic() - began:.0f} s so far)")
                wait, latest = min(2 * wait, _LONGEST), activity.shown

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        activity.over.set()
        thread.join()


C = TypeVar("C", bound=Callable[..., Any])

_WIDTH, _MOST = 100, 5  # of a summary: columns, lines
_FOLDER = "surctl.folder"  # key of the command's context: folder of files, and what it contained
_LOST_FILES = "surctl.lost_files"  # key of the command's context: what was not saved, counted by kind


_VERBOSE, _BEGAN = "surctl.verbose", "surctl.began"  # keys of the command's context


def _set_verbose(context: click.Context, option: click.Parameter, value: bool) -> None:
    context.meta[_VERBOSE] = value


def as_json(command: C) -> C:
    """Add the options of the output, `--json` and `--verbose`, to a command that ends with `finish`."""

    @wraps(command)
    def call(**values: Any) -> Any:
        click.get_current_context().meta[_BEGAN] = time.time()
        with stoppable(""):
            return command(**values)

    text = f"Print all lines, not only a summary of {_MOST} lines."
    kind: dict[str, Any] = {"expose_value": False, "envvar": "SURCTL_VERBOSE", "callback": _set_verbose, "help": text}
    call = click.option("--verbose", "-v", is_flag=True, **kind)(call)
    text = "Print the results as one JSON object on stdout."
    return cast("C", click.option("--json", "as_json", is_flag=True, help=text)(call))


def _finished(said: str) -> str:
    """Return that files of this command are in its folder, if there are any, and `said` does not name the folder."""
    context = click.get_current_context(silent=True)
    out = None if context is None else context.params.get("out")
    if context is None or out is None or not out.is_dir() or str(out) in said:
        return ""
    return f"what is finished is in {out}" * any(f.stat().st_mtime >= context.meta[_BEGAN] for f in out.iterdir())


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
    result: Mapping[str, Any],
    lines: Sequence[str],
    *,
    as_json: bool,
    passed: bool,
    then: Sequence[str] = (),
    brief: Sequence[str] | None = None,
    files: Sequence[str] = (),
    whole: bool = False,
) -> None:
    """Print the result and the suggested next commands, and exit with status 0 if `passed`, otherwise 1.

    Without --verbose, a summary of at most five lines is printed: what decides, where the files are, what is next.

    Args:
        result: data for --json.
        lines: all lines.
        as_json: print `result` in place of the lines.
        passed: whether the result is as expected.
        then: commands to suggest next, the most useful one first; an export only if `passed`.
        brief: what decides, most important first; None: the lines that are not indented.
        files: what was written where.
        whole: print all lines in any case, as for the text of a file.
    """
    context = click.get_current_context()
    if (known := context.meta.get(_FOLDER)) is not None and (replaced := known[1]()):
        text = "contained results of another command, which this command replaced"
        progress(f"{known[0]} {text}: {', '.join(replaced)}")
    then = [command for command in then if passed or not command.startswith("surctl export ")]
    lost: Counter[str] = context.meta.get(_LOST_FILES, Counter())
    if lost.total() > len(lost):
        print_message(f"{lost.total() - len(lost)} more not saved, for the same reason")
    files = ["some files are not saved"] if lost else files
    everything = "\n".join([*lines, *(["next", *(f"  {command}" for command in then)] if then else ())])
    if as_json:
        data = {**result, "next": list(then)} if then else result
        (text,) = printable([json.dumps(finite(data), ensure_ascii=not is_utf8())])
    elif whole or context.meta.get(_VERBOSE):
        text = everything
    else:
        text = "\n".join(_summary(everything.split("\n"), lines if brief is None else brief, files, then))
    sys.stdout.write((text if as_json or not _has_colours() else _coloured(text)) + "\n")
    sys.stdout.flush()
    context.exit(1 if not passed else LOST if lost else 0)


def _summary(
    everything: Sequence[str], brief: Sequence[str], files: Sequence[str], then: Sequence[str]
) -> Sequence[str]:
    """Return at most `_MOST` lines of at most `_WIDTH` columns; all lines if they are as few and as short."""
    if len(everything) <= _MOST and all(len(line) <= _WIDTH for line in everything):
        return everything
    decisive = [line for line in "\n".join(brief).split("\n") if line and not line.startswith(" ")]
    decisive = [*decisive[:1], *sorted(decisive[1:], key=lambda line: not line.startswith(_FAILS))]
    tail = _folded(", ".join(files), 1) if files else []
    commands = [_command_lines(command, first=not k) for k, command in enumerate(then)]
    left = "(more: --verbose)"
    # what got worse is named whole, before any next step
    first = len(_folded(f"{decisive[0]} {left}", _MOST)) if decisive and decisive[0].startswith("WORSE") else 2
    if commands and len(commands[0]) <= _MOST - first - len(tail):
        tail += commands.pop(0)
    body: list[str] = []
    for k, line in enumerate(decisive):
        free, others = _MOST - len(tail) - len(body), len(decisive) - k - 1
        body += _folded(line, min(free, max(free - others, 1 if k else first)))
    while commands and len(body) + len(tail) + len(commands[0]) <= _MOST:
        tail += commands.pop(0)
    if len(body) + len(tail) < _MOST:
        return [*body, left, *tail]
    return [*body[:-1], _shortened(body[-1], _WIDTH - len(left) - 1) + f" {left}", *tail]


_FAILS = ("FAIL", "NOT accepted", "exported; NOT accepted", "WORSE", "HARD GOALS", "warning", "error", "open", "n/a")


_NUMBER_AND_UNIT = re.compile(r"(\d) (?=[^\W\d_]{1,3}\b|[%°])")


def _folded(text: str, most: int) -> list[str]:
    """Return the text as lines of at most `_WIDTH` columns; the last of `most` lines ends with … if words are left."""
    joined = _NUMBER_AND_UNIT.sub("\\1\u00a0", text)  # no line ends between a number and its unit
    lines = wrap(joined, _WIDTH, subsequent_indent="     ", break_on_hyphens=False, break_long_words=False)
    lines = [line.replace("\u00a0", " ") for line in lines]
    if len(lines) > most > 0:
        lines[most - 1] = " ".join([lines[most - 1], *map(str.strip, lines[most:])])
    return [_shortened(line, _WIDTH) for line in lines[:most]]


def _shortened(line: str, width: int) -> str:
    """Return at most `width` columns of a line, cut after a word, and in its last third after a clause."""
    if len(line) <= width:
        return line
    words = line[: width - 1].rpartition(" ")[0]
    if words.count("(") > words.count(")") and 2 * words.rindex("(") >= width:  # no half of a parenthesis
        words = words[: words.rindex("(") - 1]
    clause = max((end.start() for end in re.finditer(r"[,;:](?= )", words + " ")), default=0)
    return (words[:clause] if 3 * clause >= 2 * width else words) + " …"


def _command_lines(command: str, *, first: bool) -> list[str]:
    """Return a command as lines that a shell reads as one."""
    lines = ["next " if first else "     "]
    for word in re.findall(r"(?:'[^']*'|\S)+", command):  # a quoted word may contain spaces
        if len(lines[-1]) + len(word) > _WIDTH - 3:
            lines[-1] += " \\"
            lines.append("       ")
        lines[-1] += f" {word}"
    return lines


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
        lost = click.get_current_context().meta.setdefault(_LOST_FILES, Counter())
        kind = f"{what} not saved: {getattr(error, 'problem', reason)}"
        if not lost[kind]:  # a full disk is reported once, not for each of a hundred runs
            print_message(f"{what} not saved: {reason}")
        lost[kind] += 1


class Stopped(click.Abort):
    """The user stopped the command; the message says which results are saved and how to continue."""


@contextmanager
def stoppable(
    message: str, lines: Sequence[str] = (), *, above: str = "", as_json: bool = False
) -> Iterator[None]:  # fmt: skip
    """Turn Ctrl-C inside the `with` statement into `Stopped`, after `lines` are printed (except with --json).

    The text `above` is about the printed lines: it is left out where there are none.
    """
    try:
        yield
    except (Exception, KeyboardInterrupt) as error:
        if isinstance(error, click.exceptions.Exit) or not interrupted(error):
            raise
        if lines and not as_json:
            sys.stdout.write("\n".join(lines) + "\n")
            sys.stdout.flush()
        else:
            above = ""
        said = "; ".join(filter(None, (above, message)))
        raise Stopped("; ".join(filter(None, (said, _finished(said)))) or "no result was finished") from None


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
    print_lost = sys.unraisablehook

    def pass_over(what: UnraisableHookArgs) -> None:
        if not issubclass(what.exc_type, KeyboardInterrupt):  # noted above; `raise_lost_interrupt` raises it again
            print_lost(what)

    signal.signal(signal.SIGINT, note)
    sys.unraisablehook = pass_over
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        sys.unraisablehook = print_lost
        _interrupts.clear()
        _raised.clear()


def warnings_in(lines: Sequence[str]) -> list[str]:
    """Return the indented warnings among lines, for a summary."""
    return [line.strip() for line in lines if line.startswith("  warning: ")]


def refusal_line(refused: lib.Inapplicable) -> str:
    """Return one line for a claim that is not applicable."""
    return f"n/a  {refused.claim:<22} {refused.sentence}"


def same_command(**changed: object) -> str:
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


def result_command() -> str:
    """Return the command line of this process without the options about its output on the terminal."""
    return shlex.join(word for word in shlex.split(same_command()) if word not in ("--json", "--verbose", "-v"))


def note_replaced(file: Path, command: str) -> None:
    """Print a line if a JSON file of results, which this command replaces, states another command that wrote it."""
    before = command
    with suppress(OSError, ValueError, LookupError, TypeError, AttributeError):
        table = json.loads(file.read_text(encoding="utf-8"))
        before = table.get("evidence", table)["command"]
    if before != command:
        progress(f"{file.parent} contains results of another command, which this command replaces: {before}")


def prepare_out(folder: Path) -> None:
    """Create the folder of `--out`; `finish` names the files of other commands in it that this command replaces."""
    lib.prepare_folder(folder)
    click.get_current_context().meta[_FOLDER] = (folder, lib.changes(folder))


def print_message(text: str) -> None:
    """Print one line on stderr that names this program."""
    with suppress(OSError):  # if stderr cannot be written, the exit status still reports the error
        sys.stderr.write("surctl: " + " ".join(text.split()) + "\n")
