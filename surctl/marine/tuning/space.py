"""The search space of a tuning: the tuned gains with their ranges; the search uses a log scale, from 0 a linear one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from surctl.errors import InputError, nearest
from surctl.marine.control import Gains
from surctl.tuning.axes import default_range
from surctl.tuning.search import SearchRange

__all__ = ["TUNED", "GainRange", "default_tuned", "gain_ranges"]

TUNED = ("k1", "lookahead", "k_psi", "k_v", "k_r", "kappa", "reaction", "brake")
"""Gains that are tuned if no gain is named: they shape the motion and do not describe the sensors."""


@dataclass(frozen=True)
class GainRange(SearchRange):
    """One tuned gain and its search range low … high, which includes both ends.

    `below` is the largest value that the gain may have, `zero` whether it may be 0.

    Raises:
        InputError: the ends are not 0 < low < high ≤ below, or low is 0 and the gain may not be 0.
    """

    below: float = float("inf")
    zero: bool = False

    def __post_init__(self) -> None:
        key, top = f"--gain {self.name}", self.below
        shown = f"{self.low:g}..{self.high:g}"
        if not (np.isfinite([self.low, self.high]).all() and 0 <= self.low < self.high):
            least = "0 ≤" if self.zero else "0 <"
            raise InputError("is not a range", key=key, value=shown, remedy=f"write LOW..HIGH with {least} LOW < HIGH")
        if self.low == 0 and not self.zero:
            problem = "begins at 0, and the gain must be greater"
            raise InputError(problem, key=key, value=shown, remedy="raise the lower end")
        if self.high > top:
            raise InputError(f"is above its bound of {top:.3g}", key=key, value=self.high, remedy="lower the upper end")


def gain_ranges(
    base: Gains, ranges: Mapping[str, tuple[float, float] | None] | Sequence[str] = TUNED
) -> tuple[GainRange, ...]:
    """Return the gains to tune, with their ranges.

    Args:
        base: gains that set the default ranges: a quarter of the value to four times the value, within the bounds of
            the gain.
        ranges: mapping from gain name to (low, high), or to None for the default range; or a sequence of gain names,
            which all get their default range.

    Raises:
        InputError: no gain is named, a gain is unknown, a range is not valid, or a gain of 0 has no range.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.tuning import gain_ranges
        >>> for gain in gain_ranges(load_gains("default"), {"k_v": None, "lookahead": (0.4, 1.2)}):
        ...     print(gain.name, gain.low, gain.high)
        k_v 0.375 6.0
        lookahead 0.4 1.2
    """
    table = ranges if isinstance(ranges, Mapping) else dict.fromkeys(ranges)
    if not table:
        raise InputError("nothing is tuned", key="--gain", remedy="name at least one gain")
    for name in table:
        if name not in base.specs:
            raise InputError("no such gain", key="--gain", value=name, remedy=nearest(name, base.specs))
    stated = ((name, ends or _default(name, base)) for name, ends in table.items())
    specs = base.specs
    return tuple(
        GainRange(name, low, high, specs[name].below, specs[name].zero_allowed) for name, (low, high) in stated
    )


def default_tuned(base: Gains) -> tuple[str, ...]:
    """Return the names of the gains that are tuned if no gain is named.

    If the law defines additional gains, these are tuned together with the gains of the velocity loops; otherwise the
    gains in `TUNED` are tuned.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.tuning import default_tuned
        >>> default_tuned(load_gains("default"))[:3]
        ('k1', 'lookahead', 'k_psi')
    """
    # not what follows from the vehicle, nor a gain that may be 0, which is a choice; it is tuned if it is named
    own = [name for name in base.own if name in base.specs and base.ranges.get(name, (1.0, 1.0))[0] > 0]
    return (*own, "k_v", "k_r") if base.own else TUNED


def _default(name: str, base: Gains) -> tuple[float, float]:
    if name in base.own and name in base.ranges:
        return base.ranges[name]
    value = base[name]
    if value <= 0:
        raise InputError("is 0 and so has no default range", key=f"--gain {name}", remedy=f"write {name}=LOW..HIGH")
    low, high = default_range(value)
    return low, min(high, base.specs[name].below)
