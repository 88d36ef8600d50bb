"""Time limit of a check. It counts the processor time of the thread, so a busy machine does not change a verdict."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from surctl.certcheck.document import Rejected

__all__ = ["PATIENCE", "go_on", "patient"]

PATIENCE = 8.0
"""Processor time that the check of a file may take [s]."""

_END: ContextVar[tuple[float, float]] = ContextVar("end", default=(math.inf, math.inf))


@contextmanager
def patient(seconds: float) -> Iterator[None]:
    """Limit the processor time of a check inside the `with` block to `seconds` [s]."""
    before = _END.set((time.thread_time() + seconds, seconds))
    try:
        yield
    finally:
        _END.reset(before)


def go_on() -> None:
    """Raise Rejected if the time limit is exceeded; every loop whose length depends on the file calls this function."""
    end, seconds = _END.get()
    if end < math.inf and time.thread_time() > end:  # the clock is slow
        raise Rejected(f"the check takes more than {seconds:g} s of processor time")
