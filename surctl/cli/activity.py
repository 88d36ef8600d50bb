"""Progress on stderr: the lines of a command, and a sign of life whenever it prints none for some seconds."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field

from surctl.cli.output import raise_lost_interrupt

__all__ = ["doing", "progress", "signs_of_life", "timed", "waiting"]

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
