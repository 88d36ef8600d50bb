"""An assessment: every figure and verdict about one subject, in the form that every page, command and status reads."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict, dataclass, replace
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np

__all__ = ["Assessment", "Assumption", "Figure", "Line", "Part", "Subject", "assess"]


@dataclass(frozen=True)
class Figure:
    """A number that describes a subject.

    Attributes:
        name: key of the figure, the same in every table, file and page.
        value: the number; NaN if it could not be determined.
        unit, meaning: as in a table head.
        better: whether high or low values are better; None if neither is.
        least: least sufficient value (largest, if low is better); None if there is none.
        where: the corner, loop or mission that decides the value; may be empty.
    """

    name: str
    value: float
    unit: str
    meaning: str
    better: Literal["high", "low"] | None
    least: float | None = None
    where: str = ""

    @property
    def enough(self) -> bool:
        """Whether the value is sufficient; a value that could not be determined is not."""
        if self.least is None:
            return True
        return bool(self.value >= self.least if self.better == "high" else self.value <= self.least)

    def worse(self, before: Figure) -> bool:
        """Return whether the value is worse than that of `before` by more than rounding; NaN is the worst."""
        if self.better is None or np.isnan(before.value):
            return False
        if np.isnan(self.value):
            return True
        lost = self.value - before.value if self.better == "low" else before.value - self.value
        return bool(lost > 1e-9 + 1e-6 * abs(before.value))


@dataclass(frozen=True)
class Line:
    """One verdict of an assessment as a sentence.

    Attributes:
        passed: whether it holds; None if that is not known.
        text: the sentence.
        about: the part of a page that shows the details; may be empty.
        counts: whether the line counts towards the result; a remark does not.
    """

    passed: bool | None
    text: str
    about: str = ""
    counts: bool = True

    @property
    def rank(self) -> int:
        """0 for a line that fails, 1 for one that is not decided, 2 for one that holds, 3 for a remark."""
        return 3 if not self.counts else {False: 0, None: 1, True: 2}[self.passed]

    @property
    def mark(self) -> str:
        """The line's mark in front of its text in a terminal."""
        return ("FAIL", "open", "ok  ", "    ")[self.rank]


@dataclass(frozen=True)
class Assumption:
    """A value that is assumed because the vehicle file states none.

    Attributes:
        name: the parameter, or "ranges".
        value: the assumed value, in words.
        margins: disk margin at the worst corner with half of the value, the value, and double of it; NaN if it was not
            computed or the vehicle cannot hold the cruise speed.
    """

    name: str
    value: str
    margins: tuple[float, float, float]

    @property
    def text(self) -> str:
        """The assumption and its influence as one sentence."""
        text = f"assumption: {self.name} {self.value}, because the vehicle file states none"
        if np.isnan(self.margins).all():
            return text
        half, value, double = ("none" if np.isnan(m) else f"{m:.2f}" for m in self.margins)
        return f"{text}; disk margin {value}, {half} with half of it, {double} with double"


class Part(NamedTuple):
    """Figures and lines of one part of an assessment, the objects that they come from, and the defaults it assumes."""

    figures: tuple[Figure, ...]
    lines: tuple[Line, ...]
    source: Any = None
    assumptions: tuple[Assumption, ...] = ()


class Subject(Protocol):
    """What is assessed: the parts by name, each a function that computes it."""

    @property
    def name(self) -> str:
        """Name for messages."""

    def parts(self) -> Mapping[str, Callable[[], Part]]:
        """Return the parts that concern the subject, cheapest first."""


@dataclass(frozen=True, eq=False)
class Assessment:
    """What is known about a subject.

    Attributes:
        subject: its name.
        figures: figures by name.
        lines: verdicts, worst first.
        parts: the parts that were computed, by name.
        omitted: parts that were not assessed.
        assumptions: defaults on which the figures depend; each is also a remark among the lines.
    """

    subject: str
    figures: Mapping[str, Figure]
    lines: tuple[Line, ...]
    parts: Mapping[str, Part]
    omitted: tuple[str, ...] = ()
    assumptions: tuple[Assumption, ...] = ()

    @property
    def sources(self) -> Mapping[str, Any]:
        """The objects behind each part, by name of the part."""
        return {name: part.source for name, part in self.parts.items()}

    def with_lines(self, lines: Collection[Line]) -> Assessment:
        """Return the assessment with further lines, of a page that knows more about the subject."""
        return replace(self, lines=_sorted([*self.lines, *lines]))

    @property
    def passed(self) -> bool | None:
        """False if a line fails, None if one is not decided (or none counts), True if all that count hold."""
        ranks = [line.rank for line in self.lines if line.counts]
        return (False, None, True)[min(ranks, default=1)]

    @property
    def failures(self) -> list[str]:
        """The texts of the lines that fail."""
        return [line.text for line in self.lines if line.rank == 0]

    @property
    def banner(self) -> str:
        """The verdict in one sentence: the worst line, and how many others are like it."""
        if self.passed is True:
            return "All that is assessed holds."
        like = [line for line in self.lines if line.rank == (0 if self.passed is False else 1)]
        if not like:
            return "Nothing is assessed."
        more = f" (and {len(like) - 1} more)" if len(like) > 1 else ""
        lead = "Fails" if self.passed is False else "Nothing fails; open"
        return f"{lead}: {like[0].text}{more}"

    def weakest(self, count: int) -> tuple[Line, ...]:
        """Return the worst lines that count, at most `count`."""
        return tuple(line for line in self.lines if line.counts)[:count]

    def to_dict(self) -> dict[str, Any]:
        """Return the assessment as plain data for JSON; the writer converts numbers that are not finite."""
        return {
            "subject": self.subject,
            "passed": self.passed,
            "banner": self.banner,
            "figures": {name: asdict(figure) for name, figure in self.figures.items()},
            "lines": [asdict(line) for line in self.lines],
            "not_assessed": list(self.omitted),
            "assumptions": [asdict(assumption) for assumption in self.assumptions],
        }


def assess(
    subject: Subject, *, parts: Collection[str] | None = None, computed: Mapping[str, Part] | None = None
) -> Assessment:
    """Assess a subject.

    Args:
        subject: what is assessed, such as a `Mission`.
        parts: names of the parts to compute; None: all. The assessment says which parts of the subject are omitted.
        computed: parts of an earlier assessment of the same subject (`Assessment.parts`), which are not computed again.

    Example:
        >>> from surctl.marine.assessment import Mission
        >>> from surctl.assessment import assess
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> robot = Mission(load_vehicle("sur400"), load_gains("default"), cruise=0.15, cap=0.22)
        >>> result = assess(robot, parts=["loop"])
        >>> result.passed, result.figures["disk_margin"].where, result.omitted
        (True, 'mass -5%, drag -20%', ('region',))
    """
    known, ready = subject.parts(), computed or {}
    done = {
        name: ready[name] if name in ready else compute()
        for name, compute in known.items()
        if parts is None or name in parts
    }
    figures = {figure.name: figure for part in done.values() for figure in part.figures}
    lines = [line for part in done.values() for line in part.lines]
    omitted = tuple(name for name in known if name not in done)
    lines += [Line(None, f"{name}: not assessed", counts=False) for name in omitted]
    assumed = tuple(one for part in done.values() for one in part.assumptions)
    lines += [Line(None, one.text, "margins", counts=False) for one in assumed]
    return Assessment(subject.name, MappingProxyType(figures), _sorted(lines), MappingProxyType(done), omitted, assumed)


def _sorted(lines: Collection[Line]) -> tuple[Line, ...]:
    return tuple(sorted(lines, key=lambda line: line.rank))
