"""Contenders of the benchmark, timing of their turns, and comparison of the times."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

__all__ = ["Contender", "Fit", "fit", "race", "ratio"]

Array = NDArray[np.float64]


@dataclass(eq=False)
class Contender:
    """An implementation that simulates runs of a case.

    Attributes:
        name: in the tables.
        fly: runs a turn and returns the number of simulated control periods.
        runs: number of runs in a turn.
        every: number of rounds per turn of this contender.
        cpu, wall: processor time and wall-clock time of each turn [s]. steps: control periods of each turn.
    """

    name: str
    fly: Callable[[], float]
    runs: int
    every: int = 1
    cpu: list[float] = field(default_factory=list)
    wall: list[float] = field(default_factory=list)
    steps: list[float] = field(default_factory=list)

    def turn(self) -> None:
        """Simulate once and store the time."""
        wall, cpu = time.perf_counter(), time.process_time()
        steps = self.fly()
        self.cpu.append(time.process_time() - cpu)
        self.wall.append(time.perf_counter() - wall)
        self.steps.append(steps)

    def per_step(self, *, clock: bool = False) -> Array:
        """Return the time per control period [µs], one number per turn."""
        return 1e6 * np.array(self.wall if clock else self.cpu) / np.array(self.steps)


def race(contenders: Sequence[Contender], *, rounds: int) -> None:
    """Run all once without timing, then alternately, in an order that changes from round to round."""
    rng = np.random.default_rng(0)
    for contender in contenders:
        contender.fly()
    for turn in range(rounds):
        for k in rng.permutation(len(contenders)):
            if turn % contenders[k].every == 0:
                contenders[k].turn()


def ratio(slow: Contender, fast: Contender) -> float:
    """Return the ratio of the processor times per step of the two contenders, from their shortest turns."""
    return float(slow.per_step().min() / fast.per_step().min())


@dataclass(frozen=True)
class Fit:
    """The line y = slope x + intercept by least squares, and R²."""

    slope: float
    intercept: float
    r2: float


def fit(x: Sequence[float], y: Sequence[float]) -> Fit:
    """Return the line through the points; R² is NaN if all y are equal."""
    a, b = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    slope, intercept = np.polyfit(a, b, 1)
    total = float(np.sum((b - b.mean()) ** 2))
    left = float(np.sum((b - slope * a - intercept) ** 2))
    return Fit(float(slope), float(intercept), 1.0 - left / total if total > 0 else float("nan"))
