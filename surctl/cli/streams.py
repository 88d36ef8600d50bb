"""Handling of standard output: any encoding, a full disk, or a reader that closes it."""

from __future__ import annotations

import codecs
import errno
import io
import os
import sys
from contextlib import suppress

__all__ = ["discard_stdout", "failed_write", "is_utf8", "prepare_stdout"]

_ESCAPE = "surctl-escape"
_LOSES_TEXT = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS)


def prepare_stdout() -> None:
    r"""Set up stdout to write characters that its encoding lacks as \uXXXX instead of failing.

    An error handler that the user has set (PYTHONIOENCODING=ascii:ignore) stays active.
    """
    codecs.register_error(_ESCAPE, _escaped)
    stream = sys.stdout
    if isinstance(stream, io.TextIOWrapper) and stream.errors in ("strict", "surrogateescape"):
        stream.reconfigure(errors=_ESCAPE)


def is_utf8() -> bool:
    """Return whether stdout can write every character unchanged."""
    named = getattr(sys.stdout, "encoding", None) or "utf-8"
    return codecs.lookup(named).name == "utf-8"


def failed_write(error: OSError) -> str | None:
    """Return the message if the error means that output to stdout or a file was lost; None for any other error."""
    if error.errno not in _LOSES_TEXT:
        return None
    where = f"{error.filename}: " if error.filename else ""
    reason = os.strerror(error.errno).lower()
    return f"{where}the output cannot be written ({reason}); free disk space, or write to another place"


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
