"""Limits of a check: processor time of its thread (--time-limit), memory of its intermediate results.

A busy machine does not change a verdict: the time is that of the thread, and the memory is counted from the numbers and
lengths of what is stored, at sizes of CPython.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

from surctl.certcheck.document import Rejected

__all__ = ["MEMORY", "PATIENCE", "Account", "afford", "go_on", "patient"]

PATIENCE = 8.0
"""Processor time that the check of a file may take [s]."""

MEMORY = 24_000_000
"""Memory of the intermediate results of a check [bytes]; the data of the file, and the interpreter, are not counted."""


@dataclass
class _Limits:
    seconds: float = 0.0  # up to `end`, for the message
    end: float = math.inf
    memory: float = math.inf
    held: int = 0


_LIMITS: ContextVar[_Limits] = ContextVar("limits", default=_Limits())  # noqa: B039 (never exceeded)


@contextmanager
def patient(seconds: float) -> Iterator[None]:
    """Limit the processor time of a check inside the `with` block to `seconds` [s], and its memory to `MEMORY`."""
    before = _LIMITS.set(_Limits(seconds, time.thread_time() + seconds, MEMORY))
    try:
        yield
    finally:
        _LIMITS.reset(before)


def go_on() -> None:
    """Raise Rejected if the time limit is exceeded; every loop whose length depends on the file calls this function."""
    limits = _LIMITS.get()
    if limits.end < math.inf and time.thread_time() > limits.end:  # the clock is slow
        raise Rejected(f"the check takes more than {limits.seconds:g} s of processor time")


def afford(size: float) -> None:
    """Raise Rejected if a result of `size` bytes, with all that is stored, exceeds the memory of a check."""
    _within(_LIMITS.get(), size)


class Account:
    """Memory that one object stores [bytes]; when the object is deleted, the memory is free again."""

    def __init__(self) -> None:
        self._limits, self.held = _LIMITS.get(), 0

    def hold(self, size: int) -> None:
        """Count `size` more bytes; raise Rejected if a check may not store as many."""
        self.held += size
        self._limits.held += size
        _within(self._limits, 0)

    def __del__(self) -> None:
        self._limits.held -= self.held


def _within(limits: _Limits, more: float) -> None:
    if limits.held + more > limits.memory:
        raise Rejected(f"the check needs more than {MEMORY / 1e6:g} MB of memory")
