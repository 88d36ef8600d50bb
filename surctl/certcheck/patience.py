"""How long a check may take: processor time of its thread, so that a busy machine changes no verdict."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from surctl.certcheck.document import Rejected

__all__ = ["PATIENCE", "go_on", "patient"]

PATIENCE = 8.0
"""Seconds of processor time that the check of a file may take."""

_END: ContextVar[tuple[float, float]] = ContextVar("end", default=(math.inf, math.inf))


@contextmanager
def patient(seconds: float) -> Iterator[None]:
    """What is checked inside may take so long [s]."""
    before = _END.set((time.thread_time() + seconds, seconds))
    try:
        yield
    finally:
        _END.reset(before)


def go_on() -> None:
    """Raise Rejected when the time is up; every loop whose length a file decides asks here."""
    end, seconds = _END.get()
    if time.thread_time() > end:
        raise Rejected(f"it takes more than {seconds:g} s of processor time to check")
