"""What a sweep changes: knobs with values, or with a range that a design fills."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from surctl.errors import InputError

__all__ = ["MOST_POINTS", "SEED", "Axis", "Span", "parse_axis"]

MOST_POINTS = 10_000_000
"""Points of a sweep at most: they and a column of the table are held in memory."""

SEED = "seed"
"""The axis of this name sets the seed of every run instead of a knob."""


@dataclass(frozen=True)
class Axis:
    """One knob and its values, ascending.

    Raises:
        InputError: no value, values that are not finite or do not ascend, or seeds that are no whole numbers ≥ 0.
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
    """One knob and the range low … high that a design fills, evenly or evenly in the logarithm.

    Raises:
        InputError: a bound that is not finite, an empty or reversed range, a logarithm of what is not positive.
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
            raise InputError("has no logarithm", key=key, value=shown, remedy="start above 0 or leave :log away")
        _check_seeds(self.name, (self.low, self.high))

    def axis(self, count: int) -> Axis:
        """`count` ≥ 2 values over the range, the ends exact."""
        if count < 2:
            raise InputError(
                "a range needs at least two points", key=f"axis {self.name}", value=count, remedy="write :2 or more"
            )
        if count > MOST_POINTS:
            remedy = f"at most {MOST_POINTS}"
            raise InputError("are too many points", key=f"axis {self.name}", value=count, remedy=remedy)
        # geomspace and linspace both put the given ends in
        values = np.geomspace(self.low, self.high, count) if self.log else np.linspace(self.low, self.high, count)
        return Axis(self.name, tuple(values.tolist()))

    def at(self, share: np.ndarray) -> np.ndarray:
        """Values at shares 0 ≤ share < 1 of the range, any shape; for seeds every whole number equally often."""
        if self.name == SEED:
            return np.floor(self.low + share * (self.high + 1.0 - self.low))
        if self.log:
            values = np.exp(math.log(self.low) + share * (math.log(self.high) - math.log(self.low)))
        else:
            values = self.low + share * (self.high - self.low)
        return np.clip(values, self.low, self.high)  # rounding must not lead out of a knob's bounds


def parse_axis(text: str) -> Axis | Span:
    """An axis as the command line has it.

    `k_v=1,1.5,2` gives values; `k_v=0.5..3:9` nine of them from 0.5 to 3, `k_v=0.5..3:9:log` evenly in the logarithm;
    `k_v=0.5..3` or `k_v=0.5..3:log` is a range for a design to fill.

    Raises:
        InputError: the text is none of these, or the values are not good.

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
        remedy="write PARAMETER=V1,V2,... or PARAMETER=LOW..HIGH:COUNT, and :log if so",
    )


def _check_seeds(name: str, values: tuple[float, ...]) -> None:
    if name == SEED and any(not 0 <= v <= 2**53 or v != int(v) for v in values):
        raise InputError("must be whole numbers, at least 0", key="axis seed", value=values, remedy="write 0,1,2,...")
