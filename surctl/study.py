"""A study of a closed loop: gains, code, runs, assessment, comparison of C and Python, evidence, page, data."""

from __future__ import annotations

import tempfile
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from surctl.assessment import Assessment, Line
from surctl.export import Bundle, Exportable, ExportedFile, SilReport, build_controller, compare_runs, write_bundle
from surctl.export.bundle import check_folder
from surctl.export.evidence import ReplayedRun, write_evidence
from surctl.files import prepare_folder, write_file
from surctl.ir.cache import find_compiler
from surctl.tuning import SweepTable

Progress = Callable[[str], None]
Saving = Callable[[str], AbstractContextManager[object]]


@dataclass(eq=False, kw_only=True)
class StudyParts(ABC):
    """What a study is about, and its results: a subclass brings the parts that differ between a system and a robot.

    `conduct_parts` calls the methods in their order below and sets the results.

    Attributes:
        command: the command line that the report shows.
        workers: number of processes or threads of the sweep.
        progress: function that receives one line of text at each step of the work.
        saving: returns a context for the named part of the report, which may suppress the errors of that part.
        ran: one line for each simulated run, and its costs.
        gain_file: file of the chosen gains, or None.
        sweep: the sweep over gains; None if nothing was swept.
        assessment: the figures and the lines of the summary, worst first.
        files: the exported files.
        replays: the runs that the exported C repeated.
        sil: comparison of C and Python (software in the loop) in each of them.
        report: the written page; None if it could not be drawn or written.
        seconds: computing time [s] of each part.
        suggestion: sentence that says why the next command has the numbers that it has; may be empty.
    """

    command: str = ""
    workers: int = 2
    progress: Progress = lambda _: None
    saving: Saving = nullcontext
    ran: list[str] = field(default_factory=list)
    gain_file: Path | None = None
    sweep: SweepTable | None = None
    assessment: Assessment = field(init=False)
    files: Sequence[ExportedFile] = ()
    replays: Sequence[ReplayedRun] = ()
    sil: tuple[SilReport, ...] = ()
    report: Path | None = None
    seconds: dict[str, float] = field(default_factory=dict)
    suggestion: str = ""

    decided: ClassVar[tuple[str, ...]] = ()
    """Parts of the assessment that must hold; an undecided line of another part is accepted."""

    @property
    @abstractmethod
    def title(self) -> str:
        """Name of the study."""

    @abstractmethod
    def export(self, out: Path) -> tuple[Exportable, Bundle]:
        """Return the controller and its bundle; a study that chooses the gains does so first."""

    @abstractmethod
    def simulate(self) -> Sequence[ReplayedRun]:
        """Simulate the runs; return those that the exported C repeats, that of its default mission first."""

    @abstractmethod
    def assess(self) -> Assessment:
        """Return all that is assessed but the exported C, which is compiled meanwhile."""

    def explore(self, out: Path) -> None:  # noqa: B027  # optional
        """Compute what the verdict does not depend on, such as costs over gains."""

    @abstractmethod
    def page(self) -> str:
        """Return the page as HTML; see `surctl.report.study_page.study_page`."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Return the study as plain data; the writer converts numbers that are not finite."""

    @property
    def passed(self) -> bool:
        """Whether the study is accepted: no line that counts fails, and all of the parts in `decided` hold."""
        return self.assessment.accepted(*self.decided)

    @property
    def verdict(self) -> str:
        """The first line of the page and of the output."""
        return self.assessment.verdict(*self.decided)

    @property
    def notes(self) -> tuple[Line, ...]:
        """The lines of the summary, worst first."""
        return self.assessment.lines

    def common(self) -> dict[str, Any]:
        """Return what the data of every study have in common."""
        names = ("system", "scenario", "vehicle")
        pairs = zip(self.replays, self.sil, strict=True)
        swept, code = self.sweep, Path(self.files[0].path).parent if self.files else Path()
        return {
            "study": self.title,
            "passed": self.passed,
            "assessment": self.assessment.to_dict(),
            "sweep": None if swept is None else {
                "axes": {axis.name: axis.values.tolist() for axis in swept.axes},
                "table": str(swept.path),
                "columns": {name: swept.column(name).tolist() for name in swept.columns},
            },
            "export": {
                "files": [str(file.path) for file in self.files],
                "sha256": {file.path.relative_to(code).as_posix(): file.sha256 for file in self.files},
                "sil": [{k: r.about[k] for k in names if k in r.about} | sil.to_dict() for r, sil in pairs],
            },
            "report": None if self.report is None else str(self.report),
            "seconds": self.seconds,
        }  # fmt: skip

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Inside the `with` statement, measure the time of a part of the study."""
        self.progress(f"{stage} ...")
        start = time.perf_counter()
        yield
        self.seconds[stage] = round(time.perf_counter() - start, 2)
        self.progress(f"{stage} done in {self.seconds[stage]:.1f} s")


def conduct_parts(study: StudyParts, out: Path) -> None:
    """Conduct a study; its attributes are the results.

    Args:
        study: what the study is about.
        out: folder of the page, the exported code and the table of the sweep.

    Raises:
        InputError: the folder cannot be written, there is no compiler, or the study cannot be conducted. These errors
            are raised before the long computations start.
    """
    find_compiler()
    code, timed, saving = out / "export", study.timed, study.saving
    prepare_folder(out)
    check_folder(code)
    with tempfile.TemporaryDirectory(prefix="surctl-sil-") as scratch, ThreadPoolExecutor(1) as beside:
        controller, bundle = study.export(out)
        with saving("code"):
            study.files = write_bundle(bundle, code)
        compiling = beside.submit(build_controller, controller, bundle, Path(scratch, bundle.name))
        with timed("runs"):
            study.replays = study.simulate()
        study.assessment = study.assess()
        with timed("software in the loop"):
            study.sil = compare_runs(compiling.result(), [replay.record for replay in study.replays])
    study.assessment = study.assessment.with_lines([_export_line(study.sil)])
    with saving("code"):
        study.files = write_evidence(bundle, code, study.replays, study.sil, study.assessment, command=study.command)
    study.explore(out)
    with timed("report"), saving("report"):
        study.report = write_file(out / "report.html", study.page())


def _export_line(sil: Sequence[SilReport]) -> Line:
    worst = max(max(each.tau.mixed, each.state.mixed, each.telemetry.mixed) for each in sil)
    steps, cases = sum(each.steps for each in sil), sum(each.fault_cases for each in sil)
    text = f"export: C and Python differ by at most {worst:.1e} over {steps} steps of {len(sil)} "
    text += f"run{'s' * (len(sil) != 1)}; {cases} invalid inputs tried"
    return Line(all(each.conclusive for each in sil), text, "export")
