"""Handling of the standard streams: closed ones, any encoding, a full disk, or a reader that ends first."""

from __future__ import annotations

import codecs
import errno
import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TextIO, cast

__all__ = ["OutputLost", "discard_stdout", "failed_write", "guarded_stdout", "is_utf8", "open_closed_streams"]

_ESCAPE = "surctl-escape"
_LOSES_TEXT = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS)


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
    if error.errno not in _LOSES_TEXT:
        return None
    return (f"{error.filename}: " if error.filename else "") + _lost_text(error)


def _lost_text(error: OSError) -> str:
    reason = os.strerror(error.errno or errno.EIO).lower()
    return f"the output cannot be written ({reason}); free disk space, or write to another place"


def discard_stdout() -> None:
    """Let later writes to stdout succeed without effect: after a failed write, Python writes the rest at its end."""
    with suppress(OSError, ValueError):  # a stream in memory has no descriptor
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, sys.stdout.fileno())
        os.close(nothing)


def _escaped(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    codes = map(ord, error.object[error.start : error.end])
    return "".join(f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}" for code in codes), error.end
