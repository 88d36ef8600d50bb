"""What the design page needs of a closed loop: sliders, runs, assessment; gain files that it saves and reads."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from surctl import __version__
from surctl.assessment import Assessment, ClosedLoop, assess, cost_verdicts
from surctl.errors import InputError
from surctl.files import quoted, read_toml, write_file
from surctl.ir import Layout
from surctl.lyapunov import solve
from surctl.report.motion_plots import plot_motion
from surctl.report.panel import Panel
from surctl.report.system_plots import run_panels
from surctl.system import LinearLoop, System, entry_labels, entry_units, linearise, run_system
from surctl.tuning.loop_goals import LoopGoal

Array = NDArray[np.float64]
Values = Mapping[str, float]
View = Literal["loop", "run", "decision"]

_MOST_TIMES = 1500
_MARKS = {True: "good", None: "", False: "bad"}


@dataclass(frozen=True)
class Slider:
    """A gain with its slider: unit, meaning, ends and start value."""

    name: str
    unit: str
    meaning: str
    low: float
    high: float
    value: float


@dataclass(frozen=True, eq=False)
class RunView:
    """Runs for one set of gains.

    Attributes:
        rows: (label, text, name, mark) of each figure; mark is "good", "bad" or "".
        panels: signals over time.
        picture: further picture with its text, or None.
    """

    rows: Sequence[tuple[str, str, str, str]]
    panels: Sequence[Panel]
    picture: tuple[Figure, str] | None = None


@dataclass(frozen=True, eq=False)
class SlowView:
    """What takes seconds: claims or a region, as lines of text with their marks, and a picture."""

    lines: Sequence[tuple[str, str]]
    picture: tuple[Figure, str] | None = None


class DesignBench(Protocol):
    """A closed loop as the design page shows it; methods take the values of all gains by name."""

    def __hash__(self) -> int:
        """Return a hash of the object itself: loops are cached for it."""

    @property
    def title(self) -> str:
        """Return what is designed, in one line."""

    @property
    def sliders(self) -> Sequence[Slider]:
        """Return the gains with their ranges."""

    @property
    def points(self) -> Sequence[str]:
        """Return the names of the operating points."""

    @property
    def goals(self) -> Sequence[LoopGoal]:
        """Return the goals about the loop."""

    def loop(self, values: Values, point: str) -> LinearLoop:
        """Return the linear loop at an operating point."""

    def run(self, values: Values, points: Sequence[str]) -> RunView:
        """Return runs of the closed loop."""

    def decide(self, values: Values) -> SlowView:
        """Return what takes seconds."""

    def command(self, values: Values, view: View) -> str:
        """Return a command for the same vehicle and gains as a view."""

    def save(self, values: Values, file: str) -> str:
        """Write the gains to a file; return what to do with it."""

    def load(self, file: str) -> dict[str, float]:
        """Read gains from a file."""


@dataclass(frozen=True, eq=False)
class SystemBench:
    """A system of the user's own on the design page.

    Attributes:
        system: the closed loop.
        label: FILE.py:FUNCTION, for the title, the provenance and commands.
        seconds: duration of a run [s].
        ranges: range of each gain with a slider, by label.
        places: numbers of each operating point by its name, as in `run_numbers`.
        goals: goals about the loop.
        region: problem of the region of attraction for given gains, or None.
        about: further identity for saved gains, such as the SHA-256 of the file.
        uncertain: ranges of uncertain numbers; None: those that the system declares.
    """

    system: System
    label: str
    seconds: float
    ranges: Mapping[str, tuple[float, float]]
    places: Mapping[str, Mapping[str, ArrayLike]]
    goals: tuple[LoopGoal, ...] = ()
    region: Any = None
    about: Mapping[str, str] = field(default_factory=dict)
    uncertain: Mapping[str, tuple[float, float]] | None = None

    @property
    def title(self) -> str:
        """Return plant, controller and file."""
        return f"{self.system.title}, {self.label}"

    @property
    def points(self) -> tuple[str, ...]:
        """Return the names of the operating points."""
        return tuple(self.places)

    @property
    def sliders(self) -> tuple[Slider, ...]:
        """Return the gains with their ranges."""
        gains = self.system.controller.gains
        labels, units = entry_labels(gains), entry_units(gains)
        values = dict(zip(labels, gains.pack().tolist(), strict=True))
        meanings = {label: port.meaning for port in gains for label in entry_labels(Layout((port,)))}
        unit = dict(zip(labels, units, strict=True))
        return tuple(
            Slider(name, unit[name], meanings[name], min(low, values[name]), max(high, values[name]), values[name])
            for name, (low, high) in self.ranges.items()
        )

    def loop(self, values: Values, point: str) -> LinearLoop:
        """Return the linear loop at an operating point."""
        return linearise(self.system, {**self.places[point], **values})

    def run(self, values: Values, points: Sequence[str]) -> RunView:
        """Return one run at each operating point: its costs, signals and the activity of each command."""
        runs = {p: run_system(self.system, self.seconds, {**self.places[p], **values}) for p in points}
        rows = []
        for point, record in runs.items():
            mark = "" if record.stopped == "time" else "bad"
            rows.append((f"end, {point}", f"{record.stopped}, {record.duration:.4g} s", f"end {point}", mark))
            for name, value in record.figures.items():
                cost = self.system.costs[name]
                judged = cost_verdicts(name, cost, value, duration=record.duration, dt=record.system.dt)
                text = _quantity(value, cost.unit) + ("" if cost.at_most is None else f", at most {cost.at_most:g}")
                mark = next((_MARKS[line.passed] for line in judged), "")
                rows.append((f"{cost.meaning or name}, {point}", text, f"cost {name} {point}", mark))
            for _, label, unit, moved in record.entries("command"):
                rows.append((f"{label}, {point}", activity(moved, record.system.dt, unit), f"act {label} {point}", ""))
        return RunView(rows, run_panels(runs, most=_MOST_TIMES))

    def assess(self, values: Values) -> Assessment:
        """Return the assessment at the first operating point."""
        numbers = {**next(iter(self.places.values())), **values}
        region = None if self.region is None else lambda: solve(self.region(values), time_limit=30.0)
        return assess(ClosedLoop(self.system, numbers, self.uncertain, seconds=self.seconds, region=region))

    def decide(self, values: Values) -> SlowView:
        """Assess the gains; the picture shows a region of attraction with the least level that has a counterexample."""
        assessment = self.assess(values)
        lines, solution = assessed_lines(assessment), assessment.sources.get("region")
        if solution is None or solution.level is None:
            return SlowView(lines)
        function, level = solution.decision.claim.function, solution.level
        figure = plot_motion(solution.dynamics, function, level=level, falsified=solution.falsified)
        return SlowView(lines, (figure, "Region of attraction: certified level, and the least level that is falsified"))

    def command(self, values: Values, view: View) -> str:
        """Return a command with the same values at the first operating point."""
        numbers = next(iter(self.places.values()))
        words = [
            f"{name}={np.asarray(value, dtype=float).item():g}"
            for name, value in numbers.items()
            if np.ndim(value) == 0
        ]
        words += [f"{name}={value:.6g}" for name, value in values.items()]
        options = ["--seconds", f"{self.seconds:g}", "--out", "pictures"] if view == "run" else []
        return shlex.join(["surctl", "simulate" if view == "run" else "verify", self.label, *words, *options])

    def save(self, values: Values, file: str) -> str:
        """Write the gains with their origin; return the command that uses them."""
        path = replaceable(gain_file(file), "system-gains")
        rows = "".join(f"{json.dumps(name)} = {float(value)!r}\n" for name, value in values.items())
        about = {"system": self.label, **self.about, "source": f"surctl {__version__} tune --page"}
        origin = "".join(f"{name} = {quoted(text)}\n" for name, text in about.items())
        points = "".join(f"# point {json.dumps(name)}: {dict(numbers)}\n" for name, numbers in self.places.items())
        write_file(path, f'kind = "system-gains"\n\n[gains]\n{rows}\n[provenance]\n{origin}{points}')
        words = [self.label, *(f"{name}={float(value)!r}" for name, value in values.items())]
        return f"saved {path}; surctl verify {shlex.join(words)}"

    def load(self, file: str) -> dict[str, float]:
        """Read gains that `save` wrote."""
        path = gain_file(file)
        table = read_toml(path).get("gains")
        known = {one.name for one in self.sliders}
        if not isinstance(table, dict) or not table.keys() <= known:
            raise InputError("has no gains for this system", file=path, key="gains", remedy="save it on this page")
        for name, value in table.items():
            if isinstance(value, bool) or not isinstance(value, float | int) or not np.isfinite(value):
                raise InputError("is not a number", file=path, key=f"gains.{name}", value=value, remedy="correct it")
        return {name: float(value) for name, value in table.items()}


def gain_file(file: str) -> Path:
    """Return the path of a gain file.

    Raises:
        InputError: the name does not end in .toml.
    """
    path = Path(file.strip()).expanduser()
    if path.suffix != ".toml":
        raise InputError("is not the name of a gain file", key="save", value=file, remedy="end the path in .toml")
    return path


def replaceable(path: Path, kind: str) -> Path:
    """Return a path to which a gain file may be written.

    Raises:
        InputError: the path is that of a file of another kind, which would be lost.
    """
    if path.exists():
        with suppress(InputError):
            if read_toml(path).get("kind") == kind:
                return path
        remedy = "choose another name, or remove that file"
        raise InputError(
            "is another kind of file, which would be overwritten", key="save", value=str(path), remedy=remedy
        )
    return path


def assessed_lines(assessment: Assessment) -> list[tuple[str, str]]:
    """Return banner, lines and figures of an assessment with their marks."""
    marks = ("bad", "none", "good", "")
    lines = [(assessment.verdict(), marks[{False: 0, None: 1, True: 2}[assessment.passed]])]
    lines += [(line.text, marks[line.rank]) for line in assessment.lines]
    for f in assessment.figures.values():
        where = f", at {f.where}" if f.where else ""
        lines.append((f"{f.name} = {_quantity(f.value, f.unit)}: {f.meaning}{where}", ""))
    return lines


def activity(values: Array, dt: float, unit: str) -> str:
    """Return how a command moves: root mean square, changes of sign, and share of time at its largest size."""
    known = values[np.isfinite(values)]
    if not known.any():
        return "none" if known.size else "no values"
    rms, most = float(np.sqrt(np.mean(known**2))), float(np.abs(known).max())
    signs = np.sign(known[np.abs(known) > 1e-3 * most]) if most > 0 else np.zeros(0)
    changes = int(np.count_nonzero(np.diff(signs)))
    held = np.abs(known) >= most * (1 - 1e-9)
    share = float(held.mean()) if held.sum() > 1 else 0.0
    per_second = changes / (len(known) * dt)
    held_text = f"{100 * share:.3g} % of the time at {most:.3g}"
    return f"rms {_quantity(rms, unit)}, {per_second:.3g} sign changes per s, {held_text}"


def _quantity(value: float, unit: str) -> str:
    return f"{value:.4g}" + ("" if unit == "1" else f" {unit}")
