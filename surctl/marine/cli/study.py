"""`surctl study` of missions: what is printed of a study, and the next commands."""

from __future__ import annotations

import math
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import click

from surctl.cli.output import finish, progress, refusal_line, same_command, saving, stoppable
from surctl.cli.study import report_files, weakest
from surctl.marine.cli.claims import claim_line
from surctl.marine.cli.robot_options import at_hand, derive_words, law_words, margin_of_all, trust_option

if TYPE_CHECKING:
    from surctl.assessment import Assessment


@click.command
@click.argument("words", nargs=-1, metavar="[FILE")
@click.option(
    "--vehicle",
    metavar="FILE",
    help="Vehicle (name or file) of the built-in study; a large vehicle gets larger missions.",
)
@click.option("--gains", metavar="FILE", help="Gain set (name or file) to study instead of a sweep.")
@click.option("--film", is_flag=True, help="Show the run of the report also as a MuJoCo film.")
@trust_option
def study(
    words: tuple[str, ...],
    out: Path,
    workers: int,
    vehicle: str | None,
    gains: str | None,
    film: bool,
    trust: bool,
    as_json: bool,
) -> None:
    """Sweep gains, select the best gains, verify the claims, simulate the scenarios, and export and check the C code.

    FILE is a study file or a vehicle file; without FILE, the built-in study runs. If a vehicle cannot sway, or does not
    fit into a built-in scenario, surctl scales three missions to the vehicle: a straight path, a path with a corner,
    and the obstacles of the scenario tank-static.

    For FILE.py:FUNCTION, a system of your own, the report has a simulated run, margins, costs over a sweep of gains,
    and C code. A WORD sets a number of the run (NAME=VALUE), the range of a swept gain (GAIN=LOW..HIGH:COUNT), or the
    range of a state in the box in which to prove a region of attraction (within.STATE=LOW..HIGH).

    Examples: surctl study; surctl study my-vehicle.toml --out results; surctl study --vehicle otter --json >
    study.json; surctl study my_system.py:build --seconds 5
    """
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
    stable = loops.margins and loops.margins[0].stable
    lines += ["", "nominal; each loop alone, all others closed:"] if stable else []
    lines += [f"  {margin.line()}" for margin in loops.margins if stable]
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
    brief = [lines[0], *(f"{line.mark} {line.text}" for line in weakest(result.assessment))]
    finish(
        result.to_dict(), lines,
        as_json=as_json, passed=result.passed, then=then, brief=brief, files=report_files(result.report, out),
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


def _examined(law: str, about: list[str]) -> list[str]:
    """Return the command that checks the gains: `verify`, or `simulate` if no analysis is about the law."""
    from surctl.marine.control import law_source

    _, scenario, *others = about
    simulated = ["surctl", "simulate", scenario, *others, *law_words(law)]
    source = law_source(law)
    return ["surctl", "verify", *about] if source.parts or source.steering is not None else simulated
