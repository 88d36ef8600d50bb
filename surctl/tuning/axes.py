"""Axes of a parameter sweep: a parameter with listed values (`Axis`), or with a range of values (`Span`).

The design of the sweep, for example a Latin hypercube, chooses values within the range.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from surctl.errors import InputError

__all__ = ["MOST_POINTS", "SEED", "Axis", "Span", "default_range", "parse_axis"]

_SPREAD = 4.0

MOST_POINTS = 10_000_000
"""Largest number of points of a sweep: the points and one column of the table must fit in memory."""

SEED = "seed"
"""Name of the axis that sets the seed of every run instead of a gain or a plant parameter."""


@dataclass(frozen=True)
class Axis:
    """One parameter of a parameter sweep, with its values in ascending order.

    Raises:
        InputError: there is no value, a value is not finite, the values do not ascend, or a value of the parameter
            `seed` is not a whole number ≥ 0.
    """

    name: str
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        values = tuple(float(v) for v in self.values)
        key = f"axis {self.name}"
        if not values or not all(map(math.isfinite, values)):
            raise InputError("needs finite values", key=key, value=values, remedy="write at least one number")
        if any(not b > a for a, b in pairwise(values)):
            raise InputError("needs values in ascending order, each once", key=key, value=values, remedy="sort them")
        _check_seeds(self.name, values)
        object.__setattr__(self, "values", values)


@dataclass(frozen=True)
class Span:
    """One parameter of a sweep and its range low … high.

    The points are evenly spaced on a linear scale, or on a log scale if `log` is true.

    Raises:
        InputError: a bound is not finite, the range is empty or reversed, or a logarithmic range does not start above
            0.
    """

    name: str
    low: float
    high: float
    log: bool = False

    def __post_init__(self) -> None:
        key, shown = f"axis {self.name}", f"{self.low:g}..{self.high:g}"
        if not (math.isfinite(self.low) and math.isfinite(self.high)):
            raise InputError("needs finite bounds", key=key, value=shown, remedy="write numbers")
        if not self.low < self.high:
            problem = "is an empty range" if self.low == self.high else "is a reversed range"
            raise InputError(problem, key=key, value=shown, remedy="write LOW..HIGH with LOW below HIGH")
        if self.log and not self.low > 0:
            raise InputError("has no logarithm", key=key, value=shown, remedy="start above 0 or omit :log")
        _check_seeds(self.name, (self.low, self.high))

    def axis(self, count: int) -> Axis:
        """Return an axis with `count` ≥ 2 values over the range; the first value is low, the last value is high."""
        if count < 2:
            raise InputError(
                "a range needs at least two points", key=f"axis {self.name}", value=count, remedy="write :2 or more"
            )
        if count > MOST_POINTS:
            remedy = f"write at most {MOST_POINTS}"
            raise InputError("too many points", key=f"axis {self.name}", value=count, remedy=remedy)
        # geomspace and linspace return the two bounds exactly
        values = np.geomspace(self.low, self.high, count) if self.log else np.linspace(self.low, self.high, count)
        return Axis(self.name, tuple(values.tolist()))

    def at(self, share: np.ndarray) -> np.ndarray:
        """Convert shares of the range (0 ≤ share < 1, any shape) to values.

        For the parameter `seed`, the values are whole numbers, and equally distributed shares give equally likely
        values.
        """
        if self.name == SEED:
            return np.floor(self.low + share * (self.high + 1.0 - self.low))
        if self.log:
            values = np.exp(math.log(self.low) + share * (math.log(self.high) - math.log(self.low)))
        else:
            values = self.low + share * (self.high - self.low)
        return np.clip(values, self.low, self.high)  # rounding must not exceed the parameter's bounds


def parse_axis(text: str) -> Axis | Span:
    """Parse the axis of a sweep from its command-line text.

    `k_v=1,1.5,2` lists values. `k_v=0.5..3:9` gives nine values from 0.5 to 3, and `k_v=0.5..3:9:log` spaces them
    evenly in the logarithm. `k_v=0.5..3` and `k_v=0.5..3:log` are ranges, in which the design of the sweep chooses the
    values.

    Raises:
        InputError: the text has none of the forms above, or its values are not valid.

    Example:
        >>> from surctl.tuning import parse_axis
        >>> parse_axis("k_v=0.5..4:4:log")
        Axis(name='k_v', values=(0.5, 1.0, 2.0, 4.0))
        >>> parse_axis("lookahead=0.3..1.2")
        Span(name='lookahead', low=0.3, high=1.2, log=False)
    """
    name, equals, spec = (part.strip() for part in text.partition("="))
    if not (name and equals and spec):
        raise _unreadable(text)
    low, dots, rest = spec.partition("..")
    try:
        if not dots:
            return Axis(name, tuple(float(v) for v in spec.split(",")))
        high, *how = rest.split(":")
        log = how[-1:] == ["log"]
        span = Span(name, float(low), float(high), log)
        counts = how[:-1] if log else how
        if len(counts) > 1:
            raise ValueError
        return span.axis(int(counts[0])) if counts else span
    except ValueError:
        raise _unreadable(text) from None


def _unreadable(text: str) -> InputError:
    return InputError(
        "is not an axis",
        key="axis",
        value=text,
        remedy="write PARAMETER=V1,V2,... or PARAMETER=LOW..HIGH:COUNT, and append :log for logarithmic spacing",
    )


def _check_seeds(name: str, values: tuple[float, ...]) -> None:
    if name == SEED and any(not 0 <= v <= 2**53 or v != int(v) for v in values):
        raise InputError("must be whole numbers, at least 0", key="axis seed", value=values, remedy="write 0,1,2,...")


def default_range(value: float) -> tuple[float, float]:
    """Return the default search range of a gain: from a quarter of a value to four times this value, in order."""
    return min(value / _SPREAD, value * _SPREAD), max(value / _SPREAD, value * _SPREAD)
