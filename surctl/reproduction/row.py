"""A row: one thing that the paper prints, beside the same thing computed here."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from surctl.errors import InputError, SurctlError

__all__ = ["WORDS", "Item", "Result", "Row", "Word", "agrees", "differs", "unreadable", "wrong_in_print"]

Word = Literal["agrees", "differs", "wrong in print", "unreadable in our copy"]
WORDS: tuple[Word, ...] = get_args(Word)


@dataclass(frozen=True)
class Result:
    """What a computation came to.

    Attributes:
        ours: the computed figure with its unit.
        word: the verdict.
        reason: why it differs, or the counterexample; empty where it agrees.
        numbers: the figures behind `ours` by name, the unit in the name.
        safe: for a flight: every run arrived and none collided; None for what is no flight.
    """

    ours: str
    word: Word
    reason: str = ""
    numbers: Mapping[str, float] = field(default_factory=dict)
    safe: bool | None = None

    def __post_init__(self) -> None:
        if self.word not in WORDS:
            raise InputError("is no verdict", key="verdict", value=self.word, remedy=", ".join(WORDS))
        if self.word in ("differs", "wrong in print") and not self.reason:
            raise InputError("needs its reason", key="verdict", value=self.word)

    @property
    def verdict(self) -> str:
        """The word, with the reason after a colon."""
        return f"{self.word}: {self.reason}" if self.reason else self.word


def agrees(ours: str, **numbers: float) -> Result:
    """The print holds."""
    return Result(ours, "agrees", numbers=numbers)


def differs(ours: str, why: str, **numbers: float) -> Result:
    """Ours is another figure, for that reason."""
    return Result(ours, "differs", why, numbers)


def wrong_in_print(ours: str, counterexample: str, **numbers: float) -> Result:
    """The print does not hold: the counterexample shows it."""
    return Result(ours, "wrong in print", counterexample, numbers)


def unreadable(ours: str, **numbers: float) -> Result:
    """What can be read does not hold, but the copy may be damaged there."""
    return Result(ours, "unreadable in our copy", numbers=numbers)


@dataclass(frozen=True)
class Item:
    """A row before it is computed.

    Attributes:
        id: of the row.
        group: `claims`, `tables`, `errata`, `scenarios` or `position errors`.
        what: what is compared.
        paper: as printed, with the place.
        expected: the verdict that the computation must come to; None leaves it to the numbers of a flight.
        compute: the computation; every figure of the row comes from it.
        command: a command that computes the same.
    """

    id: str
    group: str
    what: str
    paper: str
    expected: Word | None
    compute: Callable[[], Result]
    command: str

    def row(self) -> Row:
        """Compute it."""
        began = time.perf_counter()
        try:
            result = self.compute()
        except SurctlError as error:  # the other rows are still worth having
            result = Result("nothing", "differs", f"could not be computed: {error}", safe=False)
        return Row(self, result, time.perf_counter() - began)


@dataclass(frozen=True)
class Row:
    """A computed row and the time it took [s]."""

    item: Item
    result: Result
    seconds: float = field(compare=False)

    @property
    def as_expected(self) -> bool:
        """The verdict that is recorded with the row; of a flight: arrived, and nothing touched."""
        if self.item.expected is None:
            return self.result.safe is not False
        return self.result.word == self.item.expected and self.result.safe is not False

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {
            "id": self.item.id,
            "group": self.item.group,
            "what": self.item.what,
            "paper": self.item.paper,
            "ours": self.result.ours,
            "verdict": self.result.verdict,
            "expected": self.item.expected,
            "as_expected": self.as_expected,
            "numbers": dict(self.result.numbers),
            "command": self.item.command,
            "seconds": round(self.seconds, 3),
        }
