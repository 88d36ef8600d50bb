"""`surctl study` of a system: run, code, margins, region, sweep and report, in this order; next commands."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from surctl.cli.application import to_application
from surctl.cli.output import FOLDER, Count, as_json, finish, finite, progress, saving, stoppable, timed
from surctl.cli.subject import (
    OwnSystem,
    assigned,
    command_line,
    cost_data,
    cost_lines,
    end_text,
    is_system,
    load_system,
    seconds_option,
)
from surctl.errors import InputError, NotApplicable

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from surctl.assessment import Assessment, Line
    from surctl.export import ExportedFile
    from surctl.lyapunov import Solution
    from surctl.tuning.design import Design


@click.command
@click.argument("words", nargs=-1, metavar="FILE.py:FUNCTION [WORD]...]")
@click.option(
    "--out", type=FOLDER, default=Path("surctl-out"), help="Folder for report, gains and code (default surctl-out)."
)
@click.option("--workers", type=Count(1), default=2, help="Number of processes of the sweep (default 2).")
@seconds_option
@as_json
def study(words: tuple[str, ...], out: Path, workers: int, seconds: float | None, as_json: bool, **_: Any) -> None:
    """Simulate, verify, sweep and export in one command, and write one report."""
    if is_system(words):
        study_system(words, seconds=seconds, workers=workers, out=out, as_json=as_json)
    to_application(words)


def weakest(assessment: Assessment) -> Sequence[Line]:
    """Return the weakest lines behind the banner, which itself is about the worst line unless all holds."""
    return assessment.weakest(3)[assessment.passed is not True :]


def report_files(report: Path | None, out: Path) -> list[str]:
    """Return where report and code of a study are, for its summary."""
    return [*([f"report {report}"] if report else []), f"code {out / 'export'}"]


_AXES = 2  # of the sweep, if none is given
_REGION = 60.0  # largest processor time of the region of a system [s]


def study_system(words: Sequence[str], *, seconds: float | None, workers: int, out: Path, as_json: bool) -> None:
    """Write report.html and the C code of the controller; exit with status 1 if a check of the report fails."""
    from surctl import __version__
    from surctl.assessment import ClosedLoop, assess
    from surctl.cli.export import replayed_run, system_bundle
    from surctl.cli.subject import loop_data, mode_text, region_words, resting
    from surctl.cli.sweep import best_line, best_points
    from surctl.export.bundle import check_folder, write_bundle
    from surctl.export.evidence import evidence_of, with_evidence
    from surctl.export.process import build_controller
    from surctl.export.sil import compare_runs
    from surctl.files import prepare_folder, write_file
    from surctl.ir.cache import find_compiler
    from surctl.lyapunov import solve
    from surctl.report.system_page import SystemStudy, export_line, render_system_page
    from surctl.system import run_system
    from surctl.tuning import SystemSweep, sweep
    from surctl.tuning.system_sweep import chosen_points

    own = load_system(words)
    find_compiler()
    own.exported_name()
    axes = stated = [word for word in own.settings if ".." in word and word.partition("..")[2].count(":")]
    others, region, uncertain = region_words([word for word in own.settings if word not in stated], own.system)
    duration, values = own.seconds(seconds), assigned(others)
    problem = None if region is None else region.problem(own.system, values)
    axes = axes or own.default_axes(values)[:_AXES]
    design = _design(own, axes, values)
    prepare_folder(out)
    check_folder(out / "export")
    progress("run")
    record = run_system(own.system, duration, values)
    controller = own.system.controller
    progress("comparing C with Python")
    bundle = system_bundle(own, values, record)
    files: Sequence[ExportedFile] = ()
    with saving("code"):
        files = write_bundle(bundle, out / "export")
    with tempfile.TemporaryDirectory(prefix="surctl-sil-") as scratch:
        (sil,) = compare_runs(build_controller(controller, bundle, Path(scratch, bundle.name)), [record])

    def solved() -> Solution:
        if isinstance(problem, NotApplicable):
            raise problem
        assert problem is not None  # the subject asks only then
        with timed(f"region of attraction, at most {_REGION:g} s of processor time"):
            return solve(problem, first=True, time_limit=_REGION, progress=progress)

    subject = ClosedLoop(
        own.system, values, {**own.system.ranges, **uncertain}, record, region=None if problem is None else solved
    )
    ran = [end_text(own, record), *cost_lines(own.system, record.figures)]
    swept = None
    with stoppable(f"the code is in {out / 'export'}; not finished: margins, region, sweep", ran, as_json=as_json):
        assessment = assess(subject).with_lines([export_line(sil)])
        with saving("code"):
            evidence = evidence_of(run=replayed_run(own, record), sil=sil)
            evidence["assessment"] = finite(assessment.to_dict())
            files = write_bundle(with_evidence(bundle, evidence), out / "export")
        if design is not None:
            progress(f"sweep of {len(design[0].points)} points")
            with saving("sweep"):
                swept = sweep(SystemSweep(own.system, duration, design[1], values, workers), design[0])
    loop, solution = assessment.sources["loop"], assessment.sources.get("region")
    judged = not isinstance(loop, InputError)
    choices = {} if swept is None else chosen_points(swept, own.system, values, subject.ranges)
    best = {} if swept is None else best_points(swept, own.system, choices)
    best_lines = [best_line(swept, own.system, name, row, choices[name]) for name, row in best.items()] if swept else []
    about = [word for word in others if not word.startswith("start.")]
    study = SystemStudy(
        title=f"Study of {own.system.title}", record=record, assessment=assessment,
        resting=resting(own.system, loop.nominal.at) if judged else {}, mode=mode_text(loop.nominal) if judged else "",
        swept=swept, files=files, sil=sil,
        best=best_lines,
        commands={
            "study": command_line("study", own, *own.settings, "--seconds", f"{duration:g}", "--out", str(out)),
            "run": command_line("simulate", own, *others, "--seconds", f"{duration:g}", "--out", "run"),
            "verify": command_line("verify", own, *[w for w in own.settings if w not in stated], "--out", "proofs"),
            "sweep": command_line("sweep", own, *axes, *about, "--seconds", f"{duration:g}"),
        },
        version=__version__,
    )  # fmt: skip
    report: Path | None = None
    with saving("report"):
        report = write_file(out / "report.html", render_system_page(study))
    passed = assessment.accepted("region")
    lines = [f"study {own.system.title}: {assessment.verdict('region')}"]
    lines += [f"{line.mark} {line.text}" for line in assessment.lines]
    lines += [*ran, *study.best]
    lines += ["", *([f"code   {out / 'export'} ({len(files)} files)"] if files else [])]
    lines += [f"report {report}"] if report else []
    data: dict[str, Any] = {
        **own.names,
        "passed": passed,
        "assessment": assessment.to_dict(),
        "stopped": record.stopped,
        "costs": cost_data(own.system, record.figures),
        "linear": loop_data(own, loop) if judged else None,
        "region": None if solution is None else solution.to_dict(),
        "best": best,
        "sil": sil.to_dict(),
        "report": None if report is None else str(report),
    }
    then = [study.commands["run"]]
    if at := next((row["at"] for row in best.values() if row["accepted"]), None):
        then = [command_line("verify", own, *about, *(f"{name}={value!r}" for name, value in at.items()))]
    finish(
        data, lines, as_json=as_json, passed=passed, then=then if passed else (),
        brief=[lines[0], *(f"{line.mark} {line.text}" for line in weakest(assessment))],
        files=report_files(report, out),
    )  # fmt: skip


def _design(
    own: OwnSystem, axes: Sequence[str], values: Mapping[str, object]
) -> tuple[Design, Mapping[str, ArrayLike]] | None:
    """Return the grid of the sweep, and the numbers of the runs at each point; None without axes."""
    from surctl.tuning import parse_axis
    from surctl.tuning.system_sweep import choices_and_draws

    if not axes or not own.costs:
        return None
    design, draws = choices_and_draws(own.system, [parse_axis(axis) for axis in axes])
    for name in (*design.names, *draws):
        if name in values:
            raise InputError("is given twice", key=name, remedy="give a value or an axis")
    return design, draws
