"""Assessment: figures, verdicts, banner, what is not assessed, worst of cases, before and after; of any system."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict, dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from surctl.errors import InputError, NotApplicable
from surctl.system import Cost, Record, System, run_system
from surctl.system.linear import unresponsive
from surctl.system.loop import ENDED
from surctl.system.values import checked_ranges, run_numbers
from surctl.verification.linear import LEAST_DISK_MARGIN, margin_text, short_margins
from surctl.verification.loops import LEAST_DELAY_MARGIN
from surctl.verification.sampled_margins import LoopCorners, system_corners
from surctl.verification.verdict import Inapplicable

if TYPE_CHECKING:
    from surctl.lyapunov import Solution

__all__ = [
    "SATURATED", "Assessment", "Assumption", "ClosedLoop", "Comparison", "Figure", "Line", "Part", "Subject",
    "assess", "cost_verdicts",
]  # fmt: skip

# An assessment: every figure and verdict about one subject, in the form that every page, command and status reads


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

    @property
    def required(self) -> str:
        """The least sufficient value as text; empty if there is none."""
        return "" if self.least is None else f"{'≥' if self.better == 'high' else '≤'} {self.least:g}"

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

    def parts(self) -> Mapping[str, Callable[[], Part | None]]:
        """Return the parts that concern the subject, cheapest first; None is returned for what is not asked for."""


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

    def accepted(self, *parts: str) -> bool:
        """Whether no line that counts fails, and each line of these parts holds: a command then ends with status 0."""
        lines = [line for name in parts if name in self.parts for line in self.parts[name].lines if line.counts]
        return self.passed is not False and all(line.passed for line in lines)

    def verdict(self, *parts: str) -> str:
        """Return whether the subject is accepted (see `accepted`), and the banner: the line that every command prints.

        Example:
            >>> from surctl.assessment import ClosedLoop, assess
            >>> from surctl.testing import cart_system
            >>> assess(ClosedLoop(cart_system()), parts=["loop"]).verdict()
            'accepted: All that is assessed holds.'
        """
        if not any(line.counts for line in self.lines):
            return self.banner
        return f"{'accepted' if self.accepted(*parts) else 'NOT accepted'}: {self.banner}"

    def decisive(self, about: str = "") -> list[str]:
        """Return the lines that fail or are not decided, with their marks; `about` selects those about one part."""
        return [f"{line.mark} {line.text}" for line in self.lines if line.rank < 2 and about in ("", line.about)]

    @property
    def caveats(self) -> list[str]:
        """The remarks on what a proved region does not cover: the start of the run."""
        return [line.text for line in self.lines if line.about == "region" and line.rank == 3 and not line.passed]

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

    def weakest(self, count: int, *first: str) -> tuple[Line, ...]:
        """Return the worst lines that count, at most `count`; of equal ones, those about the parts `first` lead."""
        lines = sorted(self.lines, key=lambda line: (line.rank, line.about not in first))
        return tuple(line for line in lines if line.counts)[:count]

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
        name: part
        for name, compute in known.items()
        if (parts is None or name in parts) and (part := ready[name] if name in ready else compute()) is not None
    }
    figures = {figure.name: figure for part in done.values() for figure in part.figures}
    lines = [line for part in done.values() for line in part.lines]
    omitted = tuple(name for name in known if name not in done)
    lines += [Line(None, f"{name}: not assessed", counts=False) for name in omitted]
    assumed = tuple(one for part in done.values() for one in part.assumptions)
    lines += [Line(None, one.text, "margins", counts=False) for one in assumed]
    return Assessment(subject.name, MappingProxyType(figures), _sorted(lines), MappingProxyType(done), omitted, assumed)


def worst_of(assessments: Mapping[str, Assessment]) -> Assessment:
    """Return several assessments of one subject as one: of each figure the worst, and the lines of each.

    Args:
        assessments: the assessments by the name of their case; a line that all cases share is stated once.
    """
    first = next(iter(assessments.values()))
    if len(assessments) == 1:
        return first
    figures = dict[str, Figure]()
    for case, one in assessments.items():
        for name, figure in one.figures.items():
            if name not in figures or figure.worse(figures[name]):
                figures[name] = replace(figure, where=f"{case}: {figure.where}" if figure.where else case)
    times = Counter(line for one in assessments.values() for line in set(one.lines))
    lines = [
        line if times[line] == len(assessments) else replace(line, text=f"{case}: {line.text}")
        for case, one in assessments.items()
        for line in one.lines
    ]
    parts = {f"{case}: {name}": part for case, one in assessments.items() for name, part in one.parts.items()}
    omitted = tuple(dict.fromkeys(name for one in assessments.values() for name in one.omitted))
    return replace(
        first, figures=MappingProxyType(figures), lines=_sorted(dict.fromkeys(lines)), parts=MappingProxyType(parts),
        omitted=omitted,
    )  # fmt: skip


def _sorted(lines: Collection[Line]) -> tuple[Line, ...]:
    return tuple(sorted(lines, key=lambda line: line.rank))


# The figures of a linear loop and their verdict: one definition for vehicles, laws and systems


SATURATED = 0.5
"""Share of time at a limit above which the linear figures do not describe a run."""

STEP = "run-step"  # `Line.about` of a line about the integration step

_DISK = "all loops at once, at commands or measurements, at the worst corner of the ranges"
_DELAY = "least delay margin of one loop alone"


def loop_figures(corners: LoopCorners, *, least_delay: float = LEAST_DELAY_MARGIN) -> dict[str, Figure]:
    """Return the figures of a linear loop by name; `least_delay` is the least sufficient delay margin [s]."""
    nominal, late = corners.nominal, corners.delay
    single = min(nominal.judged, key=lambda m: m.disk_margin)
    first = min(nominal.judged, key=lambda m: m.delay_margin_s)
    figures = (
        Figure("disk_margin", corners.disk, "1", _DISK, "high", LEAST_DISK_MARGIN, corners.corner),
        Figure("nominal_disk_margin", nominal.disk, "1", "disk margin, nominal", "high"),
        Figure(
            "single_loop_disk_margin", single.disk_margin, "1", "least disk margin of one loop alone, nominal",
            "high", where=single.name,
        ),
        Figure(
            "delay_margin_s", late.delay_s, "s", f"{_DELAY}, at the worst corner of the ranges",
            "high", least_delay, late.where,
        ),
        Figure("nominal_delay_margin_s", first.delay_margin_s, "s", f"{_DELAY}, nominal", "high", where=first.name),
        Figure("slowest_pole_per_s", nominal.slowest_per_s, "1/s", "largest real part of a pole, nominal", "low"),
        Figure(
            "corner_slowest_pole_per_s", corners.slowest_per_s, "1/s", "largest real part of a pole, corners", "low"
        ),
    )  # fmt: skip
    return {figure.name: figure for figure in figures}


def loop_line(figures: dict[str, Figure], *, stable: bool, place: str, unstable: str, marginal: str = "") -> Line:
    """Return the verdict on a linear loop; `unstable` or `marginal` say what is wrong with one that is not stable."""
    disk, nominal, delay, on_time = (figures[name] for name in _JUDGED)
    if marginal:
        return Line(None, f"the linear loop {place} is marginal (|z| = 1){marginal}", "margins")
    if not stable:
        text = f"the linear loop {place} is UNSTABLE"
        if nominal.value > 0:
            text += f" at the corner {disk.where}; the nominal disk margin is {nominal.value:.2f}"
        else:
            text += unstable
        return Line(False, text, "margins")
    short = short_margins(
        (disk.value, f"at {disk.where}"), (delay.value, f"in {delay.where}"), least_delay=delay.least or 0.0
    )
    worst, first, late, later = (margin_text(f.value, f.least or 0.0) for f in (disk, nominal, delay, on_time))
    text = f"margins {place}: disk margin {worst} at the worst corner, {first} nominal; "
    text += f"least delay margin {late} s at the worst corner, {later} s nominal ({on_time.where})"
    if short:
        text += f"; too small: {short}"
    undetermined = np.isnan(disk.value) and delay.enough
    return Line(None if undetermined else not short, text, "margins")


_REST = "at the equilibrium"
_JUDGED = ("disk_margin", "nominal_disk_margin", "delay_margin_s", "nominal_delay_margin_s")


# Two assessments of one subject, before and after a change: every figure of both, and what got worse


@dataclass(frozen=True, eq=False)
class Comparison:
    """An assessment before and after a change of the gains."""

    before: Assessment
    after: Assessment

    @property
    def rows(self) -> list[tuple[Figure, Figure]]:
        """Every figure of one of both, before and after; NaN where one has none. What got worse comes first."""
        known = {**self.after.figures, **self.before.figures}
        pairs = [tuple(_of(one, figure) for one in (self.before, self.after)) for figure in known.values()]
        return sorted(((old, new) for old, new in pairs), key=lambda pair: -_loss(*pair))

    @property
    def worse(self) -> list[tuple[Figure, Figure]]:
        """The figures that got worse, the largest share first."""
        return [(old, new) for old, new in self.rows if new.worse(old)]

    @property
    def gained(self) -> list[str]:
        """What got better: costs first, each group with the largest share first."""
        pairs = [(old, new) for old, new in self.rows if old.worse(new)]
        pairs.sort(key=lambda pair: (not pair[0].name.startswith("cost."), -_loss(pair[1], pair[0])))
        return [f"{old.name} {_text(old)} -> {_text(new)}" for old, new in pairs]

    @property
    def headline(self) -> str:
        """What got worse, or that nothing did, in one line."""
        if not self.worse:
            return "no figure of the assessment is worse than before"
        changes = ", ".join(f"{old.name} {_text(old)} -> {_text(new)}" for old, new in self.worse)
        return f"WORSE than before: {changes}"

    def lines(self) -> list[str]:
        """Return the headline, the table of all figures, and what fails or is not decided after the change."""
        table = [f"{'figure':<28}{'unit':<6}{'required':>10}{'before':>12}{'after':>12}"]
        for old, new in self.rows:
            mark = "  worse" if new.worse(old) else ""
            table.append(f"{new.name:<28}{new.unit:<6}{new.required:>10}{_text(old):>12}{_text(new):>12}{mark}")
        better = [f"better than before: {', '.join(self.gained)}"] if self.gained else []
        return [self.headline, *better, *table, self.after.verdict(), *self.after.decisive()]

    def to_dict(self) -> dict[str, Any]:
        """Return both assessments and the names of the figures that got worse as plain data for JSON."""
        worse = [new.name for _, new in self.worse]
        return {"before": self.before.to_dict(), "after": self.after.to_dict(), "worse": worse}


def _of(one: Assessment, figure: Figure) -> Figure:
    missing = Figure(figure.name, float("nan"), figure.unit, figure.meaning, figure.better, figure.least)
    return one.figures.get(figure.name, missing)


def _loss(old: Figure, new: Figure) -> float:
    # share of the value that is lost; 0 or less if nothing is
    if not new.worse(old):
        return 0.0
    lost = abs(new.value - old.value) / max(abs(old.value), 1e-9)
    return float(lost) if np.isfinite(lost) else float("inf")


def _text(figure: Figure) -> str:
    return "none" if np.isnan(figure.value) else f"{figure.value:.3g}"


def step_lines(record: Record) -> list[Line]:
    """Return a line about the integration step of a run if it is too long, otherwise none."""
    return [Line(None, record.rough, STEP)] if record.rough else []


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """A system with its numbers, the run in which it is judged, and the region that is claimed.

    Attributes:
        system: the closed loop.
        values: numbers of one run by name, see `run_numbers`.
        ranges: ranges of uncertain numbers; None: those that the system declares.
        record: the run; None: it is simulated, if there are `seconds`.
        seconds: duration of the run [s]; None: no run is judged.
        region: function that decides the claimed region, or raises `NotApplicable`; None: none is claimed.
    """

    system: System
    values: Mapping[str, ArrayLike] = field(default_factory=dict)
    ranges: Mapping[str, tuple[float, float]] | None = None
    record: Record | None = None
    seconds: float | None = None
    region: Callable[[], Solution] | None = None

    @property
    def name(self) -> str:
        """Names of plant and controller."""
        return self.system.title

    def parts(self) -> Mapping[str, Callable[[], Part | None]]:
        """Return the parts of the assessment."""
        return {"loop": self._loop, "run": self._run, "region": self._region}

    def _loop(self) -> Part:
        run_numbers(self.system, self.values)  # a mistake is raised, unlike a loop without equilibrium
        checked_ranges(self.system, self.system.ranges if self.ranges is None else self.ranges)
        try:
            corners = system_corners(self.system, self.values, self.ranges)
        except InputError as error:
            line = Line(None, f"margins: not judged, because {error.problem}", "margins", counts=False)
            return Part((), (line,), error)
        figures = loop_figures(corners, least_delay=self.system.dt)  # a command may be applied one period late
        unstable = f": the largest pole is |z| = {np.abs(corners.nominal.poles).max(initial=0.0):.6g}"
        line = loop_line(figures, stable=corners.stable, place=_REST, unstable=unstable, marginal=corners.marginal)
        if line.passed and corners.idle:
            why = (
                f"{', '.join(corners.idle)} does not respond there (at a limit, or in a dead zone), so its loop is open"
            )
            line = Line(None, f"{line.text}; {why}", "margins")
        if corners.lost:
            line = Line(False, f"the loop has no equilibrium at the corner {corners.corner}", "margins")
        return Part(tuple(figures.values()), (line,), corners)

    def _run(self) -> Part | None:
        record = self.record
        if record is None:
            if self.seconds is None:
                return None
            record = run_system(self.system, self.seconds, self.values)
        whole, why = record.stopped == ENDED, record.lost or record.stopped  # a stop is a failure
        lines = [Line(whole, f"the run {'ends' if whole else 'stops'} after {record.duration:.6g} s ({why})", "run")]
        lines += [Line(None, f"no state changes in this run; {record.at_rest}", "run")] if record.at_rest else []
        figures = []
        for name, cost in self.system.costs.items():
            value = record.figures[name]
            meaning = cost.meaning or f"{cost.how} over the run"
            figures.append(Figure(f"cost.{name}", value, cost.unit, meaning, "low", cost.at_most))
            lines += cost_verdicts(name, cost, value, duration=record.duration, dt=self.system.dt)
        lines += step_lines(record)
        shares = unresponsive(record)
        if shares:
            worst = max(shares, key=lambda name: shares[name])
            meaning = "share of the run in which a command does not respond: at a limit, or in a dead zone"
            figures.append(Figure("limited_share", shares[worst], "1", meaning, "low", where=worst))
            if shares[worst] > SATURATED:
                text = f"command {worst} does not respond {shares[worst]:.0%} of the run"
                lines.append(Line(None, f"{text}, so the linear margins do not describe this run", "run"))
        return Part(tuple(figures), tuple(lines), record)

    def _region(self) -> Part | None:
        if self.region is None:
            return None
        try:
            solution = self.region()
        except NotApplicable as reason:
            text = f"region of attraction of {reason.to}: not assessed, because {reason.because}"
            return Part((), (Line(None, text, "region"),), Inapplicable.of("region of attraction", reason))
        proved = solution.verdict == "proved" and not solution.vacuous
        passed = (None if solution.fallback else True) if proved else False if solution.verdict == "refuted" else None
        line = Line(passed, f"region of attraction: {' '.join(solution.lines()[0].split())}", "region")
        if (level := solution.level) is None:
            return Part((), (line,), solution)
        share = level / solution.falsified if proved and solution.falsified else float("nan") if proved else 0.0
        meaning = "certified level over the least level with a counterexample"
        figures, lines = [Figure("region_share", share, "1", meaning, "high")], [line]
        start = run_numbers(self.system, self.values).start[0] if proved else []
        if proved and not np.isnan(value := solution.value([*start, *self.system.controller.initial_state()])):
            inside, covered = value < level, value < level and solution.sampled
            at = f"at V = {value:.4g}, {'inside' if inside else 'outside'} the region (V < {level:.4g})"
            at = at if np.isfinite(value) else "outside the box of the proof"
            text = f"the run starts {at}: {'the proof covers it' if covered else 'simulated, not proved'}"
            lines.append(Line(covered or None, text, "region", counts=False))
            figures.append(Figure("start_share", value / level, "1", "V at the start of the run over the level", None))
        return Part(tuple(figures), tuple(lines), solution)


def cost_verdicts(name: str, cost: Cost, value: float, *, duration: float, dt: float) -> list[Line]:
    """Return the verdict on the bound of a cost, and whether a last time is only the end of the run.

    Args:
        name: name of the cost.
        cost: the cost.
        value: its value.
        duration: duration of the run [s]; a last time at its end is not the true one, which is not known.
        dt: control period [s].

    Example:
        >>> from surctl.assessment import cost_verdicts
        >>> from surctl.system import Cost
        >>> cost = Cost(lambda s: s.x["speed"], "final", "m/s", at_most=0.5)
        >>> [line] = cost_verdicts("end", cost, 0.2, duration=5.0, dt=0.1)
        >>> line.passed, line.text
        (True, 'end = 0.2 m/s, at most 0.5 m/s')
    """
    lasts = cost.how == "last_time" and value > max(duration - 1.5 * dt, 0.0)
    if cost.at_most is None and not lasts:
        return []
    bound = "" if cost.at_most is None else f", at most {cost.at_most:g} {cost.unit}"
    passed = None if cost.at_most is None else bool(value <= cost.at_most)
    more = " until the end of the run, so the last time is not known" if lasts else ""
    text = f"{name} has no value{bound}" if np.isnan(value) else f"{name} = {value:.6g} {cost.unit}{more}{bound}"
    return [Line(None if lasts and passed else passed, text, "run", counts=cost.at_most is not None)]
