"""A comparison: one statement or number printed in the paper, its computed result, and the verdict expected."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from surctl.errors import InputError, SurctlError

Word = Literal["agrees", "differs", "wrong in print", "unreadable in our copy"]
WORDS: tuple[Word, ...] = get_args(Word)


@dataclass(frozen=True)
class Result:
    """The result of one comparison.

    Attributes:
        ours: the result computed by this project, with its unit.
        word: the verdict.
        reason: reason for a difference from the paper, or the counterexample; empty if the result agrees with the
            paper.
        numbers: the numbers in the text `ours` by name; each name contains the unit.
        safe: for simulations, whether every run arrived and none collided; None if arrivals and collisions do not
            decide the comparison.
        independent: for simulations, the result in an independent engine; empty if it was not requested.
        webots: for simulations with sonars, the result with echoes as in the paper's simulator; empty if it was not
            requested.
    """

    ours: str
    word: Word
    reason: str = ""
    numbers: Mapping[str, float] = field(default_factory=dict)
    safe: bool | None = None
    independent: str = ""
    webots: str = ""

    def __post_init__(self) -> None:
        if self.word not in WORDS:
            remedy = f"give one of {', '.join(WORDS)}"
            raise InputError("is not a verdict", key="verdict", value=self.word, remedy=remedy)
        if self.word in ("differs", "wrong in print") and not self.reason:
            raise InputError("needs a reason", key="verdict", value=self.word, remedy="give the reason")

    @property
    def verdict(self) -> str:
        """The verdict on the printed statement, followed by a colon and the reason if there is a reason."""
        return f"{self.word}: {self.reason}" if self.reason else self.word


def agrees(ours: str, **numbers: float) -> Result:
    """Return a result that agrees with the paper."""
    return Result(ours, "agrees", numbers=numbers)


def differs(ours: str, why: str, **numbers: float) -> Result:
    """Return a result that differs from the paper for the given reason."""
    return Result(ours, "differs", why, numbers)


def wrong_in_print(ours: str, counterexample: str, **numbers: float) -> Result:
    """Return a result whose counterexample shows that the printed statement is wrong."""
    return Result(ours, "wrong in print", counterexample, numbers)


@dataclass(frozen=True)
class Item:
    """A comparison before its computation.

    Attributes:
        id: id of the comparison.
        group: `claims`, `tables`, `errata`, `scenarios` or `position errors`.
        what: the quantity or statement that is compared.
        paper: the printed statement, with its location in the paper.
        expected: the verdict that the computation must give; None if the arrivals and collisions of simulated runs
            decide.
        compute: function that computes all numbers of the comparison.
        command: a command of the program that computes the same numbers; by default `reproduce` with the id.
        options: options of `reproduce` that add a result to the comparison: `independent`, `webots`.
    """

    id: str
    group: str
    what: str
    paper: str
    expected: Word | None
    compute: Callable[[], Result]
    command: str = ""
    options: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "command", self.command or f"surctl reproduce {self.id}")

    def row(self) -> Row:
        """Compute the comparison; return it with the duration of the computation."""
        began = time.perf_counter()
        try:
            result = self.compute()
        except SurctlError as error:  # the other rows are still useful
            result = Result("no result", "differs", f"the row could not be computed: {error}", safe=False)
        return Row(self, result, time.perf_counter() - began)


@dataclass(frozen=True)
class Row:
    """A computed comparison, with the duration of its computation [s]."""

    item: Item
    result: Result
    seconds: float = field(compare=False)

    @property
    def as_expected(self) -> bool:
        """Whether the comparison has its expected verdict, and its runs (if any) arrived without collision."""
        if self.item.expected is None:
            return self.result.safe is not False
        return self.result.word == self.item.expected and self.result.safe is not False

    def to_dict(self) -> dict[str, Any]:
        """Return the comparison as plain data for JSON."""
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
            "independent": self.result.independent or None,
            "webots": self.result.webots or None,
            "command": self.item.command,
            "seconds": round(self.seconds, 3),
        }
