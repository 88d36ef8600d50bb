"""`surctl study FILE.py:FUNCTION`: run, margins, region, sweep and C code of a system of the user's own on one page."""

from __future__ import annotations

import tempfile
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from surctl.cli.activity import progress
from surctl.cli.output import finish, saving
from surctl.cli.system_option import OwnSystem, assigned, command_line, load_system
from surctl.cli.system_simulate import cost_data, cost_lines, end_text

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from surctl.lyapunov import Solution
    from surctl.tuning.design import Design

__all__ = ["study_system"]

_AXES, _POINTS = 2, 9  # of the sweep, if no axis is given


def study_system(
    words: Sequence[str],
    *,
    seconds: float | None,
    workers: int,
    out: Path,
    as_json: bool,
    reserved: Collection[str] = (),
) -> None:
    """Write report.html and the C code of the controller; exit with status 1 if a check of the report fails."""
    from surctl import __version__
    from surctl.assessment import ClosedLoop, assess
    from surctl.cli.system_region import region_words
    from surctl.cli.system_sweep import best_line, best_points
    from surctl.cli.system_verify import loop_data, mode_text, resting
    from surctl.errors import InputError
    from surctl.export.bundle import build_bundle, check_folder, write_bundle
    from surctl.export.process import build_controller
    from surctl.export.sil import compare_runs
    from surctl.files import prepare_folder, write_file
    from surctl.lyapunov import solve
    from surctl.report.system_page import SystemStudy, export_line, render_system_page
    from surctl.system import run_system
    from surctl.tuning import sweep_system

    own = load_system(words)
    own.exported_name(reserved=reserved)
    axes = stated = [word for word in own.settings if ".." in word and word.partition("..")[2].count(":")]
    others, region, uncertain = region_words([word for word in own.settings if word not in stated], own.system)
    duration, values = own.seconds(seconds), assigned(others)
    problem = None if region is None else region.problem(own.system, values)
    axes = axes or _default_axes(own, values)
    design = _design(own, axes, values)
    prepare_folder(out)
    check_folder(out / "export")
    progress("run")
    record = run_system(own.system, duration, values)
    controller = own.system.controller
    progress("comparing C with Python")
    bundle = build_bundle(controller, controller.gains.unpack(record.controller[2]))
    files = write_bundle(bundle, out / "export")
    with tempfile.TemporaryDirectory(prefix="surctl-sil-") as scratch:
        (sil,) = compare_runs(build_controller(controller, bundle, Path(scratch, bundle.name)), [record])

    def solved() -> Solution:
        assert problem is not None  # the subject asks only then
        progress("region of attraction")
        return solve(problem, first=True, progress=progress)

    subject = ClosedLoop(
        own.system, values, {**own.system.ranges, **uncertain}, record, region=None if problem is None else solved
    )
    assessment = assess(subject).with_lines([export_line(sil)])
    loop, solution = assessment.sources["loop"], assessment.sources.get("region")
    judged = not isinstance(loop, InputError)
    swept = None
    if design is not None:
        progress(f"sweep of {len(design[0].points)} points")
        swept = sweep_system(own.system, design[0], duration, draws=design[1], values=values, threads=workers)
    best = {} if swept is None else best_points(swept)
    about = [word for word in others if not word.startswith("start.")]
    study = SystemStudy(
        title=f"Study of {own.title}", record=record, assessment=assessment,
        resting=resting(own.system, loop.nominal.at) if judged else {}, mode=mode_text(loop.nominal) if judged else "",
        swept=swept, best=[] if swept is None else [best_line(swept, name, row) for name, row in best.items()], sil=sil,
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
    passed = assessment.passed is not False and (solution is None or solution.verdict == "proved")
    lines = [f"study {own.title}: {'passed' if passed else 'NOT passed'}: {assessment.banner}"]
    lines += [f"{line.mark} {line.text}" for line in assessment.lines]
    lines += [end_text(own, record), *cost_lines(own.system, record.figures), *study.best]
    lines += ["", f"code   {out / 'export'} ({len(files)} files)", *([f"report {report}"] if report else [])]
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
    if best:
        at = next(iter(best.values()))["at"]
        then = [command_line("verify", own, *about, *(f"{name}={value!r}" for name, value in at.items()))]
    finish(data, lines, as_json=as_json, passed=passed, then=then if passed else ())


def _default_axes(own: OwnSystem, values: Mapping[str, object]) -> list[str]:
    """Return axes from half to twice the default of the first gains; none without costs."""
    gains = [port for port in own.system.controller.gains if port.size == 1 and port.default > 0]
    free = [port for port in gains if port.name not in values] if own.system.costs else []
    return [f"{port.name}={port.default / 2:.4g}..{port.default * 2:.4g}:{_POINTS}" for port in free[:_AXES]]


def _design(
    own: OwnSystem, axes: Sequence[str], values: Mapping[str, object]
) -> tuple[Design, Mapping[str, ArrayLike]] | None:
    """Return the grid of the sweep, and the numbers of the runs at each point; None without axes."""
    from surctl.cli.system_sweep import choices_and_draws
    from surctl.errors import InputError
    from surctl.tuning import parse_axis

    if not axes:
        return None
    design, draws = choices_and_draws(own, [parse_axis(axis) for axis in axes])
    for name in (*design.names, *draws):
        if name in values:
            raise InputError("is given twice", key=name, remedy="give a value or an axis")
    return design, draws
