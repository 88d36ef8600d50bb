"""`surctl study`: sweep, verify, simulate and export in one command; of a system, also the order of the steps."""

from __future__ import annotations

import math
import shlex
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from surctl.cli.claims import claim_line
from surctl.cli.output import (
    FOLDER,
    Count,
    as_json,
    finish,
    progress,
    refusal_line,
    same_command,
    saving,
    stoppable,
    timed,
)
from surctl.cli.robot_options import at_hand, derive_words, law_words, margin_of_all, trust_option
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
    from surctl.verification import LoopMargins


@click.command
@click.argument("words", nargs=-1, metavar="[FILE | FILE.py:FUNCTION [WORD]...]")
@click.option(
    "--out", type=FOLDER, default=Path("surctl-out"), help="Folder for report, gains and code (default surctl-out)."
)
@click.option("--workers", type=Count(1), default=2, help="Number of processes of the sweep (default 2).")
@click.option(
    "--vehicle", metavar="FILE", help="Vehicle of the built-in study; its missions are scaled if the vehicle is large."
)
@click.option("--gains", metavar="FILE", help="Study this gain set (name or file), without a sweep.")
@click.option("--film", is_flag=True, help="Also show the report's animated run in MuJoCo.")
@seconds_option
@trust_option
@as_json
def study(
    words: tuple[str, ...],
    out: Path,
    workers: int,
    vehicle: str | None,
    gains: str | None,
    film: bool,
    seconds: float | None,
    trust: bool,
    as_json: bool,
) -> None:
    """Sweep gains, select the best point, verify the claims, simulate the scenarios, and export and check the C code.

    FILE is a study file or a vehicle file; without FILE, the built-in study runs. For a vehicle that cannot sway, or
    does not fit into a built-in scenario, the study scales three missions to the vehicle: a straight path, two legs,
    and the obstacles of the scenario tank-static.

    FILE.py:FUNCTION names a system of your own: the report has a run, margins, costs over gains, and C code. A WORD
    sets a value of the run (NAME=VALUE), a swept gain (GAIN=LOW..HIGH:COUNT), or the box of a state for the region of
    attraction (within.STATE=LOW..HIGH).

    Examples: surctl study; surctl study my-vehicle.toml --out results; surctl study --vehicle otter --json >
    study.json; surctl study my_system.py:build --seconds 5
    """
    if is_system(words, "words", "gains", "out", "workers", "seconds", "as_json"):
        study_system(words, seconds=seconds, workers=workers, out=out, as_json=as_json)
    if len(words) > 1:
        raise click.UsageError(f"Got unexpected extra argument ({words[1]})")
    from surctl.ir.cache import find_compiler

    find_compiler()  # before the imports and the plan, which take seconds
    from surctl.marine.study import conduct, load_plan

    file = words[0] if words else None

    chosen = [f"--vehicle {vehicle}"] if vehicle else [file] if file else []
    chosen += [f"--gains {gains}"] if gains else []
    command = " ".join(["surctl study", *chosen, f"--out {out}", *["--film"] * film])
    plan = load_plan(file, vehicle=vehicle, trust=trust)
    plan = plan if gains is None else plan.with_gains(gains)
    if film:
        from surctl.marine.engine.pictures import check_pictures

        check_pictures()
    with stoppable(f"the finished points are in {out}; to continue: {same_command()}"):
        result = conduct(plan, out, workers=workers, progress=progress, command=command, film=film, saving=saving)
    lines = [f"study {result.plan.name}: {result.assessment.verdict()}"]
    lines += [] if plan.derivation is None else [f"started from {line.strip()}" for line in plan.derivation.lines()]
    lines += [f"{line.mark} {line.text}" for line in result.notes]
    loops = result.loops
    lines += ["", f"{'nominal loop':<12} {'gain':>10} {'phase':>10} {'delay':>10} {'disk':>6}"] if loops.margins else []
    if loops.margins and not loops.margins[0].stable:
        lines.append("unstable      margins of an unstable loop are 0")
    for m in loops.margins if loops.margins and loops.margins[0].stable else ():
        lines.append(_margin_line(m))
    lines += ["", *(claim_line(v) for v in result.verdicts), *(refusal_line(v) for v in result.inapplicable)]
    lines += ["", f"gains  {result.gain_file}", f"code   {out / 'export'}"]
    lines += [f"report {result.report}"] if result.report else []
    tuning = ["surctl", "tune", *([file] if file else []), *(["--trust"] if trust else [])]
    about = at_hand(result.plan.deciding[0].scenario, plan.vehicle, str(result.gain_file))
    cruise = None if plan.derivation is None else plan.derivation.cruise
    then = changes(result.assessment, about[3], cruise)
    # a search about missions that the study has made for the vehicle has no study file
    then += [shlex.join(tuning)] if tunable(result.assessment) and not plan.unheard else []
    then.append(shlex.join(_examined(plan.law, about)))
    brief = [lines[0], *(f"{line.mark} {line.text}" for line in _weakest(result.assessment))]
    finish(
        result.to_dict(), lines,
        as_json=as_json, passed=result.passed, then=then, brief=brief, files=_files(result.report, out),
    )  # fmt: skip


def changes(assessment: Assessment, vehicle: str, cruise: float | None) -> list[str]:
    """Return the command that derives gains with the gain `margin` that is missing; nothing if none is.

    `cruise` is the speed [m/s] for which the assessed gains were derived, or None.
    """
    margin = margin_of_all(assessment)
    if cruise is None or not math.isfinite(margin):
        return []
    return [derive_words(vehicle, cruise, "gains.toml", margin=margin)]


def tunable(assessment: Assessment) -> bool:
    """Return whether a search of gains can change the result: a no-contact margin is stated, not searched."""
    contact = assessment.parts.get("no contact")
    left = [line for line in assessment.lines if line.counts and line.passed is not True]
    return not left or any(contact is None or line not in contact.lines for line in left)


def _weakest(assessment: Assessment) -> Sequence[Line]:
    """Return the weakest lines behind the banner, which itself is about the worst line unless all holds."""
    return assessment.weakest(3)[assessment.passed is not True :]


def _files(report: Path | None, out: Path) -> list[str]:
    return [*([f"report {report}"] if report else []), f"code {out / 'export'}"]


def _margin_line(margin: LoopMargins) -> str:
    gain, phase, delay = (
        "never lost" if math.isinf(value) else f"{value:{form}}{unit}"
        for value, form, unit in (
            (margin.gain_margin, ".2f", ""),
            (margin.phase_margin_deg, ".1f", "°"),
            (margin.delay_margin_s, ".2f", "s"),
        )
    )
    return f"{margin.name:<12} {gain:>10} {phase:>10} {delay:>10} {margin.disk_margin:6.2f}"


def _examined(law: str, about: list[str]) -> list[str]:
    """Return the command that checks the gains: `verify`, or `simulate` if no analysis is about the law."""
    from surctl.marine.control import law_source

    _, scenario, *others = about
    simulated = ["surctl", "simulate", scenario, *others, *law_words(law)]
    source = law_source(law)
    return ["surctl", "verify", *about] if source.parts or source.steering is not None else simulated


_AXES, _POINTS = 2, 9  # of the sweep, if no axis is given
_REGION = 60.0  # largest processor time of the region of a system [s]


def study_system(words: Sequence[str], *, seconds: float | None, workers: int, out: Path, as_json: bool) -> None:
    """Write report.html and the C code of the controller; exit with status 1 if a check of the report fails."""
    from surctl import __version__
    from surctl.assessment import ClosedLoop, assess
    from surctl.cli.export import system_bundle, system_evidence
    from surctl.cli.subject import loop_data, mode_text, region_words, resting
    from surctl.cli.sweep import best_line, best_points
    from surctl.export.bundle import check_folder, write_bundle
    from surctl.export.evidence import with_evidence
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
    axes = axes or _default_axes(own, values)
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
            files = write_bundle(with_evidence(bundle, system_evidence(own, record, assessment, sil)), out / "export")
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
        brief=[lines[0], *(f"{line.mark} {line.text}" for line in _weakest(assessment))], files=_files(report, out),
    )  # fmt: skip


def _default_axes(own: OwnSystem, values: Mapping[str, object]) -> list[str]:
    """Return axes from half to twice the default of the first gains; none without costs."""
    gains = [port for port in own.system.controller.gains if port.size == 1 and port.default > 0]
    free = [port for port in gains if port.name not in values] if own.system.costs else []
    return [f"{port.name}={port.default / 2:.4g}..{port.default * 2:.4g}:{_POINTS}" for port in free[:_AXES]]


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
