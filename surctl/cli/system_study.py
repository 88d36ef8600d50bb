"""The study of a system: its run, margins, region, costs over gains, and the commands to run next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from surctl import __version__
from surctl.assessment import Assessment, ClosedLoop, assess
from surctl.cli.export import replay_of, system_bundle
from surctl.cli.output import progress, saving, timed
from surctl.cli.subject import OwnSystem, assigned, load_system, mode_text, region_words
from surctl.cli.sweep import best_line, best_points
from surctl.errors import InputError, NotApplicable, mistakes_in
from surctl.export import Bundle, Exportable
from surctl.export.evidence import ReplayedRun
from surctl.ir.cache import find_compiler
from surctl.lyapunov import Solution, solve
from surctl.study import StudyParts
from surctl.system import run_system
from surctl.tuning import SystemSweep, parse_axis, sweep
from surctl.tuning.design import Design
from surctl.tuning.system_sweep import choices_and_draws, chosen_points
from surctl.verification.sampled_margins import LoopCorners

_AXES = 2  # of the sweep, if none is given
_REGION = 60.0  # largest processor time of the region of a system [s]


class _SystemStudy(StudyParts):
    decided = ("region",)

    def __init__(self, own: OwnSystem, seconds: float | None, out: Path, workers: int) -> None:
        axes = stated = [word for word in own.settings if ".." in word and word.partition("..")[2].count(":")]
        self.judged = [word for word in own.settings if word not in stated]
        others, region, uncertain = region_words(self.judged, own.system)
        self.own, self.duration, self.values = own, own.seconds(seconds), assigned(others)
        axes = axes or own.default_axes(self.values)[:_AXES]
        with mistakes_in(own.word):
            self.problem = None if region is None else region.problem(own.system, self.values)
        self.design, self.ranges = _design(own, axes, self.values), {**own.system.ranges, **uncertain}
        self.about = [word for word in others if not word.startswith("start.")]
        self.best, self.best_lines = dict[str, Any](), list[str]()
        time = ("--seconds", f"{self.duration:g}")
        self.commands = {
            "run": own.command("simulate", *others, *time, "--out", "run"),
            "verify": own.command("verify", *self.judged, "--out", "proofs"),
            "sweep": own.command("sweep", *axes, *self.about, *time),
        }
        command = own.command("study", *own.settings, *time, "--out", str(out))
        super().__init__(command=command, workers=workers, progress=progress, saving=saving)

    @property
    def title(self) -> str:
        return self.own.system.title

    def export(self, out: Path) -> tuple[Exportable, Bundle]:
        return self.own.system.controller, system_bundle(self.own, self.values)

    def simulate(self) -> Sequence[ReplayedRun]:
        self.record = run_system(self.own.system, self.duration, self.values)
        self.ran += [self.own.end_text(self.record), *self.own.cost_lines(self.record.figures)]
        return [replay_of(self.own, self.record)]

    def assess(self) -> Assessment:
        region = None if self.problem is None else self._solved
        with self.timed("assessment"):
            return assess(ClosedLoop(self.own.system, self.values, self.ranges, self.record, region=region))

    def _solved(self) -> Solution:
        if isinstance(self.problem, NotApplicable):
            raise self.problem
        assert self.problem is not None  # the subject asks only then
        with timed(f"region of attraction, at most {_REGION:g} s of processor time"):
            return solve(self.problem, first=True, time_limit=_REGION, progress=progress)

    def explore(self, out: Path) -> None:
        if self.design is None:
            return
        system, (points, draws) = self.own.system, self.design
        origin: dict[str, Any] = {"about": self.own.origin, "source": self.own.word}
        job = SystemSweep(system, self.duration, draws, self.values, self.workers, **origin)
        with self.timed("sweep"), saving("sweep"):
            self.sweep = swept = sweep(job, points, out=out, progress=progress)
            choices = chosen_points(swept, system, self.values, self.ranges)
            self.best = best_points(swept, system, choices)
            self.best_lines = [best_line(swept, system, name, row, choices[name]) for name, row in self.best.items()]
            for name in [name for name, row in self.best.items() if row["accepted"]][:1]:
                self.suggestion = f"Next: least {name}."

    @property
    def _loop(self) -> LoopCorners | None:
        loop = self.assessment.sources["loop"]
        return None if isinstance(loop, InputError) else loop

    def page(self) -> str:
        from surctl.report import study_page as parts

        system, loop, verify, swept = self.own.system, self._loop, self.commands["verify"], self.sweep
        rest, mode = ({}, "") if loop is None else (self.own.resting(loop), mode_text(loop.nominal))
        sweep = None
        if swept is not None:
            sweep = parts.costs_section(swept, system, self.best_lines, self.commands["sweep"])
        return parts.study_page(
            title=f"Study of {self.title}",
            about=f"Plant {system.plant.name}, controller {system.controller.name}, control period {system.dt:g} s.",
            command=self.command,
            version=__version__,
            assessment=self.assessment,
            decided=self.decided,
            evidence=[
                parts.run_section(self.record, self.commands["run"]),
                parts.margins_section(self.assessment, rest, mode, verify),
                parts.region_section(self.assessment, verify),
            ],
            sweep=sweep,
            export=parts.export_section("The step of the controller as C99.", self.files, self.sil),
            seconds=self.seconds,
            numbers=[parts.signals_section(self.record)],
        )

    def to_dict(self) -> dict[str, Any]:
        loop, solution = self._loop, self.assessment.sources.get("region")
        return {
            **self.own.names,
            **self.common(),
            "stopped": self.record.stopped,
            "costs": self.own.cost_data(self.record.figures),
            "linear": None if loop is None else self.own.loop_data(loop),
            "region": None if solution is None else solution.to_dict(),
            "best": self.best,
        }

    def lines(self) -> list[str]:
        return [*self.ran, *self.best_lines]

    def next_commands(self) -> list[str]:
        if not self.passed:
            return []
        at = next((row["at"] for row in self.best.values() if row["accepted"]), None)
        if at is None:
            return [self.commands["run"]]
        return [self.own.command("verify", *self.judged, *(f"{name}={value!r}" for name, value in at.items()))]


def study_of(words: Sequence[str], *, seconds: float | None, workers: int, out: Path) -> _SystemStudy:
    """Return the study of the system that the words of the command line name; InputError if they are not valid."""
    own = load_system(words)
    find_compiler()
    own.exported_name()
    return _SystemStudy(own, seconds, out, workers)


def _design(
    own: OwnSystem, axes: Sequence[str], values: Mapping[str, object]
) -> tuple[Design, Mapping[str, ArrayLike]] | None:
    """Return the grid of the sweep, and the numbers of the runs at each point; None without axes."""
    if not axes or not own.costs:
        return None
    design, draws = choices_and_draws(own.system, [parse_axis(axis) for axis in axes])
    for name in (*design.names, *draws):
        if name in values:
            raise InputError("is given twice", key=name, remedy="give a value or an axis")
    return design, draws
