"""`surctl study`: sweep, verify, simulate and export in one command."""

from __future__ import annotations

import math
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import click

from surctl.cli.activity import progress
from surctl.cli.claim_lines import claim_line
from surctl.cli.law_option import law_words, trust_option
from surctl.cli.output import as_json, finish, refusal_line, same_command, saving, stoppable
from surctl.cli.system_option import is_system, seconds_option
from surctl.cli.system_study import study_system
from surctl.cli.vehicle_choice import at_hand

if TYPE_CHECKING:
    from surctl.verification import LoopMargins

__all__ = ["study"]


@click.command
@click.argument("words", nargs=-1, metavar="[FILE | FILE.py:FUNCTION [WORD]...]")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("surctl-out"),
    metavar="DIR",
    help="Folder for report, gains and code (default surctl-out).",
)
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    default=2,
    metavar="N",
    help="Number of processes of the sweep (default 2).",
)
@click.option("--vehicle", metavar="FILE", help="Vehicle of the built-in study; a large one gets scaled missions.")
@click.option("--gains", metavar="FILE", help="Gains to study, name or file, in place of the study's sweep.")
@click.option("--film", is_flag=True, help="Also show the report's animated run in MuJoCo's scene.")
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

    FILE is a study file or a vehicle file; without FILE, the built-in study runs. A vehicle that cannot sway, or fits
    no built-in scenario, gets three missions scaled to it: a straight path, two legs, and the obstacles of the
    scenario tank-static.

    FILE.py:FUNCTION names a system of your own: the page has its run, margins, costs over gains, and C code. A WORD is
    NAME=VALUE of the run, GAIN=LOW..HIGH:COUNT of the sweep, or within.STATE=LOW..HIGH of a region of attraction.

    Examples: surctl study; surctl study my-vehicle.toml --out results; surctl study --vehicle otter --json >
    study.json; surctl study my_system.py:build --seconds 5
    """
    if is_system(words, "words", "out", "workers", "seconds", "as_json"):
        from surctl.marine.control import LAW_NAMES

        study_system(words, seconds=seconds, workers=workers, out=out, as_json=as_json, reserved=LAW_NAMES)
    if len(words) > 1:
        raise click.UsageError(f"Got unexpected extra argument ({words[1]})")
    file = words[0] if words else None
    from surctl.marine.study import conduct, load_plan

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
    lines = [f"study {result.plan.name}: {'passed' if result.passed else 'NOT passed'}: {result.assessment.banner}"]
    lines += [] if plan.derivation is None else [f"started from {line.strip()}" for line in plan.derivation.lines()]
    lines += [f"{line.mark} {line.text}" for line in result.notes]
    loops = result.loops
    lines += ["", f"{'loop':<12} {'gain':>10} {'phase':>10} {'delay':>10} {'disk':>6}"] if loops.margins else []
    if loops.margins and not loops.margins[0].stable:
        lines.append("unstable      margins of an unstable loop are 0")
    for m in loops.margins if loops.margins and loops.margins[0].stable else ():
        lines.append(_margin_line(m))
    lines += ["", *(claim_line(v) for v in result.verdicts), *(refusal_line(v) for v in result.inapplicable)]
    lines += ["", f"gains  {result.gain_file}", f"code   {out / 'export'}"]
    lines += [f"report {result.report}"] if result.report else []
    tuning = ["surctl", "tune", *([file] if file else []), *(["--trust"] if trust else [])]
    about = at_hand(result.plan.deciding[0].scenario, plan.vehicle, str(result.gain_file))
    # a search about missions that the study has made for the vehicle has no study file
    then = [shlex.join(words) for words in ((tuning,) if not plan.unheard else ())]
    then.append(shlex.join(_examined(plan.law, about)))
    finish(result.to_dict(), lines, as_json=as_json, passed=result.passed, then=then)


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
