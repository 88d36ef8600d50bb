"""The parameters of the range tracker, and the numbers that follow from them and from the sonar array."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache, cached_property
from math import ceil, erf, log, sqrt

import numpy as np

from surctl.errors import check_number
from surctl.marine.sensing.sonar.array import SonarArray

NEVER = 1e6
"""Longer than any run [s], and more than any turn [rad]."""

MOST_REPEATS = 9
"""Largest count of repetitions of a firing's samples; further repetitions are not counted."""

_REPEAT = 0.01  # if a working sensor repeats a sample set more rarely than this, one repetition is suspicious


@dataclass(frozen=True, kw_only=True)
class TrackerParameters:
    """The parameters of a `RangeTracker`.

    Attributes:
        array: the sonar array.
        dt: period of the steps [s].
        obstacle_speed: largest speed of an obstacle [m/s]; the bound grows at this speed while readings are overdue.
        tolerance: largest difference [m] between a reading and the range of a known wall at which the two agree; a
            reading that exceeds the wall's range by more is a fault. `tolerance` covers noise and the error of the
            robot's own position.
        yaw_tolerance: error of the robot's own heading that the bound covers while the beam turns [rad].
        longest_delay: longest delay of readings after a gap that the tracker considers [s].
        hold: time [s] for which the tracker keeps an echo that vanished without explanation while the beam does not
            turn (default: for ever, because a fault may never end).
    """

    array: SonarArray = field(default_factory=SonarArray)
    dt: float = 0.05
    obstacle_speed: float = 0.25
    tolerance: float = 0.1
    yaw_tolerance: float = 0.03
    longest_delay: float = 0.8
    hold: float = NEVER

    def __post_init__(self) -> None:
        positive = {"dt": "s", "tolerance": "m", "yaw_tolerance": "rad", "longest_delay": "s", "hold": "s"}
        for name, unit in positive.items():
            check_number(f"tracker.{name}", getattr(self, name), unit=unit)
        check_number("tracker.obstacle_speed", self.obstacle_speed, unit="m/s", zero=True)

    @cached_property
    def due(self) -> float:
        """Time between two arrivals of a sensor's samples [s]: the array's cycle time, rounded up to whole steps."""
        return self.dt * ceil(self.array.cycle / self.dt - 1e-9)

    @cached_property
    def repeats(self) -> int:
        """Number of repetitions of the same samples after which a sensor counts as stuck; 0 if the noise is too small.

        Two successive firings of a working sensor give the same samples with a probability of at most p, at the worst
        position between two conversion steps. The number r of repetitions satisfies p^r < 1e-4.
        """
        chance = _chance_of_equal_sets(self.array)
        needed = ceil(log(1e-4) / log(min(max(chance, 1e-12), 0.999)))
        return needed if needed <= MOST_REPEATS else 0

    @cached_property
    def sigma(self) -> float:
        """Standard deviation of the mean of a firing's samples [m]."""
        a = self.array
        spread = sqrt(a.noise_sd**2 + a.resolution**2 / 12.0)
        # noise much smaller than a conversion step does not dither it: a mean of equal codes keeps the rounding error
        return max(1.1 * spread / sqrt(a.samples), a.resolution / sqrt(12.0))

    @cached_property
    def one_repeat(self) -> bool:
        """Whether one repetition of the same samples is suspicious."""
        return self.repeats > 0 and _chance_of_equal_sets(self.array) < _REPEAT

    @property
    def stuck(self) -> float:
        """Number of repetitions of a firing's samples above which a sensor counts as stuck."""
        return max(self.repeats, 1) - 0.5

    @property
    def rate_variance(self) -> float:
        """Variance of the rate of the range [m²/s²] before any estimate of the rate."""
        return max(self.obstacle_speed, 0.05) ** 2


@cache
def _chance_of_equal_sets(array: SonarArray) -> float:
    # at the same range
    if array.noise_sd == 0.0:
        return 1.0
    largest = 0.0
    for offset in np.linspace(0.0, 0.5, 11):
        edges = (np.arange(-400, 402) - 0.5 - offset) * array.resolution / (array.noise_sd * sqrt(2.0))
        below = np.array([0.5 * (1.0 + erf(edge)) for edge in edges])
        largest = max(largest, float(np.sum(np.diff(below) ** 2)))
    return largest**array.samples
