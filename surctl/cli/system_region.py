"""The region of attraction of a system of the user's own: words `within.STATE=LOW..HIGH` of `surctl verify`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from surctl.lyapunov import Problem
    from surctl.system import System

__all__ = ["RegionWords", "region_words"]

_WITHIN, _CLAIM = "within.", "lyapunov."


@dataclass(frozen=True)
class RegionWords:
    """What the words of the command line say about a region of attraction.

    Attributes:
        within: lower and upper bound of each state.
        ranges: lower and upper bound of uncertain numbers.
        claim: texts of `function`, `level` and `rate`.
    """

    within: Mapping[str, tuple[float, float]]
    ranges: Mapping[str, tuple[float, float]]
    claim: Mapping[str, str]

    def problem(self, system: System, values: Mapping[str, ArrayLike]) -> Problem:
        """Return the problem of finding and proving a region of attraction of the system.

        Raises:
            InputError: see `sampled_dynamics`; or the function, the level or the rate is not valid.
        """
        from surctl.errors import InputError
        from surctl.lyapunov import Problem, sampled_dynamics
        from surctl.verification.formula import parse, variable

        dynamics = sampled_dynamics(system, self.within, values=values, ranges=self.ranges)
        dynamics.require_equilibrium()
        numbers: dict[str, float | None] = {}
        for key in ("level", "rate"):
            text = self.claim.get(key)
            numbers[key] = None if text is None else _number(text, f"{_CLAIM}{key}")
            if text is not None and not (numbers[key] or 0.0) > 0:
                raise InputError("is not positive", key=f"{_CLAIM}{key}", value=text, remedy="give a positive number")
        function = None
        if "function" in self.claim:
            known = {name: variable(name) for name in dynamics.names}
            function = parse(self.claim["function"], known, key=f"{_CLAIM}function")
        elif numbers["level"] is not None:
            raise InputError("is given without a function", key=f"{_CLAIM}level", remedy="give lyapunov.function too")
        return Problem(dynamics, "lyapunov", function, numbers["level"], numbers["rate"])


def region_words(
    words: Sequence[str], system: System
) -> tuple[list[str], RegionWords | None, dict[str, tuple[float, float]]]:
    """Separate the words about a region of attraction and the ranges from the others.

    Without words `within.STATE`, the box is that of the system; if it has none, no region is asked for (None).

    Raises:
        InputError: a range is not LOW..HIGH, a name is given twice, or a claim is stated without `within.STATE`.
    """
    from surctl.errors import InputError, nearest

    others: list[str] = []
    within: dict[str, tuple[float, float]] = {}
    ranges: dict[str, tuple[float, float]] = {}
    claim: dict[str, str] = {}
    for word in words:
        name, _, text = (part.strip() for part in word.partition("="))
        if name.startswith(_CLAIM):
            key = name.removeprefix(_CLAIM)
            if key not in ("function", "level", "rate"):
                raise InputError("is not known", key=name, remedy=nearest(key, ("function", "level", "rate")))
            _once(claim, key, name)
            claim[key] = text
        elif name.startswith(_WITHIN) or ".." in text:
            table = within if name.startswith(_WITHIN) else ranges
            key = name.removeprefix(_WITHIN)
            _once(table, key, name)
            table[key] = _range(text, name)
        else:
            others.append(word)
    within = within or dict(system.within)
    if not within:
        if claim:
            key = f"{_CLAIM}{next(iter(claim))}"
            remedy = "add within.STATE=LOW..HIGH for every state"
            raise InputError("asks for a region of attraction, whose box is missing", key=key, remedy=remedy)
        return others, None, ranges
    return others, RegionWords(within, ranges, claim), ranges


def _once(table: Mapping[str, object], key: str, name: str) -> None:
    from surctl.errors import InputError

    if key in table:
        raise InputError("is given twice", key=name, remedy="give it once")


def _range(text: str, name: str) -> tuple[float, float]:
    from surctl.errors import InputError

    low, dots, high = text.partition("..")
    if not dots:
        raise InputError("is not a range", key=name, value=text, remedy=f"write {name}=-1..1")
    return _number(low, name), _number(high, name)


def _number(text: str, name: str) -> float:
    from math import isfinite

    from surctl.errors import InputError

    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not isfinite(value):
        raise InputError("is not a number", key=name, value=text, remedy="write such as 1.5")
    return value
