"""`surctl study` of missions: what is printed of a study, and the next commands."""

from __future__ import annotations

import math
import shlex
from dataclasses import dataclass
from pathlib import Path

import click

from surctl.cli.options import option, options
from surctl.cli.output import progress, refusal_line, saving
from surctl.cli.study import conduct_study
from surctl.marine.cli import lib
from surctl.marine.cli.claims import claim_line
from surctl.marine.cli.robot_options import SPEEDS, TRUST, at_hand, derive_words, law_words, margin_of_all


@dataclass(frozen=True, eq=False, repr=False)
class _Options:
    """What is studied; None: as the study file, or the built-in study, has it."""

    vehicle: str | None = option(
        "--vehicle",
        "Vehicle (name or file) of the built-in study; a large vehicle gets larger missions.",
        metavar="FILE",
    )
    gains: str | None = option(
        "--gains", "Gain set to study: name or file (default: the best of its sweep).", metavar="FILE"
    )
    cruise: tuple[float, ...] | None = option(
        "--cruise",
        "Cruise speeds [m/s] of the loop margins; the worst margin counts (default: speeds of the missions).",
        type=SPEEDS,
        metavar="U1,U2,...",
    )
    film: bool = option("--film", "Show the run of the report also as a MuJoCo film.", False)
    trust: bool = option("--trust", TRUST, False)


@click.command
@click.argument("words", nargs=-1, metavar="[FILE")
@options(options=_Options)
def study(words: tuple[str, ...], out: Path, workers: int, options: _Options, as_json: bool) -> None:
    """Sweep gains, select the best gains, verify the claims, simulate the scenarios, and export and check the C code.

    FILE is a study file or a vehicle file; without FILE, the built-in study runs. If a vehicle cannot sway, or fits
    into no built-in scenario, surctl scales three missions to the vehicle: a straight path, a path with a corner,
    and the obstacles of the scenario tank-static.

    For FILE.py:FUNCTION, a system of your own, the report has a simulated run, margins, costs over a sweep of gains,
    and C code. A WORD sets a parameter of the run (NAME=VALUE), the range of a swept gain (GAIN=LOW..HIGH:COUNT), or
    the range of a state in the box in which to prove a region of attraction (within.STATE=LOW..HIGH).

    Examples: surctl study; surctl study my-vehicle.toml --out results; surctl study --vehicle otter --json >
    study.json; surctl study my_system.py:build --seconds 5
    """
    if len(words) > 1:
        raise click.UsageError(f"Got unexpected extra argument ({words[1]})")
    lib.find_compiler()  # before the imports and the plan, which take seconds
    file, vehicle, gains, cruise = words[0] if words else None, options.vehicle, options.gains, options.cruise
    chosen = [f"--vehicle {vehicle}"] if vehicle else [file] if file else []
    chosen += [f"--gains {gains}"] if gains else []
    chosen += [f"--cruise {','.join(f'{speed:g}' for speed in cruise)}"] if cruise else []
    command = " ".join(["surctl study", *chosen, f"--out {out}", *["--film"] * options.film])
    plan = lib.load_plan(file, vehicle=vehicle, trust=options.trust)
    plan = plan if gains is None else plan.with_gains(gains)
    plan = plan if cruise is None else plan.at_speeds(cruise, key="--cruise")
    if options.film:
        lib.check_pictures()
    study = lib.Study(plan=plan, workers=workers, progress=progress, command=command, film=options.film, saving=saving)

    def below() -> list[str]:
        margins, data = study.analysis.margins, study.data
        stable = margins and margins[0].stable
        lines = ["", "nominal; each loop alone, all others closed:"] if stable else []
        lines += [f"  {margin.line()}" for margin in margins if stable]
        return [*lines, "", *map(claim_line, data.verdicts), *map(refusal_line, data.inapplicable)]

    def then() -> list[str]:
        about = at_hand(study.plan.deciding[0].scenario, plan.vehicle, str(study.gain_file))
        cruise = None if plan.derivation is None else plan.derivation.cruise
        subject = [file] if file else ["--vehicle", vehicle] if vehicle else []
        tuning = ["surctl", "tune", *subject, *(["--trust"] if options.trust else [])]
        search = [shlex.join(tuning)] if tunable(study.assessment) else []
        return [*changes(study.assessment, about[3], cruise), *search, shlex.join(_examined(plan, about))]

    above = [] if plan.derivation is None else [f"started from {line.strip()}" for line in plan.derivation.lines()]
    conduct_study(study, out, above=above, below=below, then=then, as_json=as_json)


def changes(assessment: lib.Assessment, vehicle: str, cruise: float | None) -> list[str]:
    """Return the command that derives gains with the gain `margin` that is missing; nothing if none is.

    `cruise` is the speed [m/s] for which the assessed gains were derived, or None.
    """
    margin = margin_of_all(assessment)
    if cruise is None or not math.isfinite(margin):
        return []
    return [derive_words(vehicle, cruise, "gains.toml", margin=margin)]


def tunable(assessment: lib.Assessment) -> bool:
    """Return whether a search of gains can change the result: a no-contact margin is stated, not searched."""
    contact = assessment.parts.get("no contact")
    stated = () if contact is None or contact.source is None else contact.lines  # None: not judged for this law
    left = [line for line in assessment.lines if line.counts and line.passed is not True]
    return not left or any(line not in stated for line in left)


def _examined(plan: lib.Plan, about: list[str]) -> list[str]:
    """Return the command that checks the gains: `verify`, or `simulate` if no analysis is about the law."""
    law, (_, scenario, *others) = plan.law, about
    simulated = ["surctl", "simulate", scenario, *others, *law_words(law)]
    source = lib.law_source(law)
    verified = ["surctl", "verify", *about, *law_words(law, vehicle=plan.vehicle)]
    return verified if source.parts or source.steering is not None else simulated
