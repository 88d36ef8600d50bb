"""Contenders of the benchmark, and the timing of their turns."""

from __future__ import annotations

import gc
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from time import perf_counter_ns
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = ["Contender", "Missing", "Timing", "race", "warm_up"]

Array: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True)
class Contender:
    """Somebody who answers ticks.

    Attributes:
        name: in the tables.
        problem: what is solved: contenders with the same word are compared with one another.
        run: the arguments of one tick → v (n,), or None without an answer. This is timed.
        ticks: the arguments of each tick, made beforehand; None where this problem cannot be posed.
        ours: whether it is this toolkit.
        read: the answer and the arguments of its tick → v in the coordinates that answers are compared in; not timed.
    """

    name: str
    problem: str
    run: Callable[..., Any]
    ticks: Sequence[tuple[Any, ...] | None]
    ours: bool = False
    read: Callable[..., Any] = lambda v, *tick: v


@dataclass(frozen=True)
class Missing:
    """A contender that could not take part, and the reason."""

    name: str
    reason: str = "not installed"


@dataclass
class Timing:
    """Solutions by the number of the step (None: no solution), and times of single steps [ns], round by round."""

    answers: dict[int, Array | None] = field(default_factory=dict)
    ns: list[int] = field(default_factory=list)

    def rounds(self) -> Array:
        """Times (rounds, possible steps) [ns]; only complete rounds are run."""
        return np.array(self.ns, dtype=float).reshape(-1, len(self.answers))


def warm_up(contenders: Sequence[Contender]) -> dict[str, Timing]:
    """Let every contender solve every step once without timing; copy the solutions."""
    timings = {}
    for contender in contenders:
        timing = timings[contender.name] = Timing()
        for at, tick in enumerate(contender.ticks):
            if tick is not None:
                v = contender.run(*tick)
                timing.answers[at] = None if v is None else np.array(contender.read(v, *tick), dtype=float)
    return timings


def race(contenders: Sequence[Contender], timings: dict[str, Timing], *, rounds: int, turn: int, budget: float) -> None:
    """Time single ticks: `turn` of them each, then the next contender, and so on, `rounds` times over all ticks.

    After `budget` seconds of its own a contender sits out the rounds that are left.
    """
    count = max((len(contender.ticks) for contender in contenders), default=0)
    gc.collect()
    gc.disable()
    try:
        for turned in range(rounds):
            # nobody always runs after the same one
            order = [*contenders[turned % len(contenders) :], *contenders[: turned % len(contenders)]]
            active = [c for c in order if sum(timings[c.name].ns) < budget * 1e9]
            for first in range(0, count, turn):
                for contender in active:
                    _turn(contender, timings[contender.name].ns, contender.ticks[first : first + turn])
    finally:
        gc.enable()


def _turn(contender: Contender, ns: list[int], ticks: Sequence[tuple[Any, ...] | None]) -> None:
    run, posed = contender.run, [tick for tick in ticks if tick is not None]
    for tick in posed[-2:]:  # untimed: the first ticks would pay for what the contender before has left in the caches
        run(*tick)
    for tick in posed:
        begin = perf_counter_ns()
        run(*tick)
        ns.append(perf_counter_ns() - begin)
