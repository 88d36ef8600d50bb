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
    """A solver or library that takes part in the benchmark.

    Attributes:
        name: its name in the tables.
        problem: the name of the solved problem; contenders with the same problem are compared.
        run: the timed function: the arguments of one step → v (n,), or None without a solution.
        ticks: the arguments of each step, prepared beforehand; None if this problem cannot be posed.
        ours: whether it belongs to this toolkit.
        read: solution and arguments of its step → v in the coordinates of the comparison; not timed.
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
    """Time single steps: each contender runs `turn` steps, then the next one, `rounds` times over all steps.

    After `budget` seconds of its own a contender omits the remaining rounds.
    """
    count = max((len(contender.ticks) for contender in contenders), default=0)
    gc.collect()
    gc.disable()
    try:
        for turned in range(rounds):
            # a contender must not always run after the same one
            order = [*contenders[turned % len(contenders) :], *contenders[: turned % len(contenders)]]
            active = [c for c in order if sum(timings[c.name].ns) < budget * 1e9]
            for first in range(0, count, turn):
                for contender in active:
                    _turn(contender, timings[contender.name].ns, contender.ticks[first : first + turn])
    finally:
        gc.enable()


def _turn(contender: Contender, ns: list[int], ticks: Sequence[tuple[Any, ...] | None]) -> None:
    run, posed = contender.run, [tick for tick in ticks if tick is not None]
    for tick in posed[-2:]:  # untimed: the first steps depend on the caches that the last contender left
        run(*tick)
    for tick in posed:
        begin = perf_counter_ns()
        run(*tick)
        ns.append(perf_counter_ns() - begin)
