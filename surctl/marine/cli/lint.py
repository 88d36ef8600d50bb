"""`surctl lint` of the robot's files: findings by kind of file, margins that do not suffice."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from surctl.cli.lint import Linted
from surctl.errors import Finding, InputError, check_known
from surctl.marine.cli import lib
from surctl.marine.cli.robot_options import choose_vehicle, derive_words, margin_of_all

_NEXT = {
    "vehicle": ("tune --vehicle {} --out tuned", "study {}"),
    "gains": ("verify --gains {}", "simulate pool-static --gains {}"),
    "goals": ("tune --goals {}",),
    "barrier": ("verify {}",),
    "claim": ("verify {}",),
    "lyapunov": ("verify {}",),
    "region": ("verify {}",),
    "scenario": ("simulate {}",),
    "study": ("study {}", "tune {}"),
}
_IN_VEHICLES = ("scenario", "study")  # kinds of files to which --vehicle applies


def _file_findings(loaded: object, file: str) -> list[Finding]:
    # entries that cannot work

    if isinstance(loaded, lib.Vehicle) and set(loaded.name) & set("/\\"):
        remedy = "remove / and \\"
        raise InputError("cannot be part of a file name", file=file, key="name", value=loaded.name, remedy=remedy)
    if isinstance(loaded, lib.Vehicle):
        free = lib.undamped({key: parameter.value for key, parameter in loaded.parameters.items()})
        text = "no drag, but thrust: the speed has no bound; state the drag, or fit it to a log (vehicle from-log)"
        undriven = [Finding("warning", f"drag ({axis})", text) for axis in free]
        advice = "; surctl verify --vehicle FILE says how much the margin depends on it"
        assumed = [Finding("info", one.name, one.text + advice) for one in lib.assumptions(loaded)]
        return [*undriven, *lib.thruster_findings(loaded), *assumed]
    if isinstance(loaded, lib.RegionStatement) and loaded.loop == "cruise":
        cruise, cap = loaded.cruise_m_per_s, loaded.cap_m_per_s
        if cruise >= cap:
            text = f"the cruise speed of {cruise:g} m/s is not below the cap of {cap:g} m/s"
            return [Finding("error", "cruise_m_per_s", text)]
    return []


def _loop_findings(mission: lib.Mission, derive_for: str | None) -> tuple[list[Finding], list[str]]:
    """Return margins that do not suffice, a cap above the largest stable speed, and the defaults that decide.

    The margins are those of the loop, and the gain `margin` that the no-contact claim of each scenario needs. The
    second list has the command that writes derived gains with it; `derive_for` is the vehicle's name or file if the
    gains are derived, else None.
    """
    keys = {"cap": "cap_m_per_s", "margins": "gains", "runs": "gains.margin"}
    result = lib.assess(mission, parts=["loop", "no contact"])
    lines = [line for line in result.lines if line.passed is False or line.about == "cap"]
    gains = f"with the gains {mission.gains.name!r}"
    warnings = [Finding("warning", keys[line.about], f"{line.text}, {gains}") for line in lines]
    margin, then = margin_of_all(result), []
    if derive_for is not None and math.isfinite(margin):
        then.append(derive_words(derive_for, mission.cruise, "gains.toml", margin=margin))
    return [*warnings, *(Finding("info", one.name, one.text) for one in result.assumptions)], then


def _goal_findings(plan: lib.Plan) -> list[Finding]:
    # goals of the file that `tune` cannot judge for its law; the built-in goals are left out there with a line

    built_in = lib.load_goals()
    left = [goal for goal in lib.judged_goals(plan.goals, plan.sweep_cases)[2] if goal not in built_in]
    why = f"is not judged, because surctl has no linear model of law {lib.label(plan.law)}"
    why += ': write type = "margins" in place of metric'
    return [Finding("error" if goal.kind == "hard" else "warning", f"goals.{goal.name}", why) for goal in left]


@click.command
@click.argument("words", nargs=-1, metavar="")
@click.option("--vehicle", metavar="FILE", help="Vehicle (name or file) with which to check a scenario.")
def lint(words: Sequence[str], vehicle: str | None, **_: Any) -> Linted:
    """Check vehicle, scenario, study, gain, goal and claim files, or a system of your own (FILE.py:FUNCTION), and print
    which entries of the files cannot work, and why. Exit status: 1 if an entry of a file cannot work.

    Examples: surctl lint my-vehicle.toml my-mission.toml; surctl lint pool-static --vehicle sur540-flooded; surctl lint
    my_system.py:build
    """
    [file] = words
    path, kind = _path_and_kind(file)
    every = click.get_current_context().params["words"]
    if vehicle is not None and not any(_path_and_kind(word)[1] in _IN_VEHICLES for word in every):
        raise InputError("applies only to a scenario or a study", key="--vehicle", value=vehicle, remedy="drop it")
    problems, derive = [], list[str]()
    plain: dict[str, Callable[[str], object]] = {
        "vehicle": lib.load_vehicle,
        "gains": lib.load_gains,
        "goals": lambda file: (
            lib.load_loop_goals(file) if "points" in lib.read_toml(Path(file)) else lib.load_goals(file)
        ),
        "barrier": lambda file: lib.load_problem(Path(file)),
        "claim": lambda file: lib.load_claim(Path(file)),
        "lyapunov": lambda file: lib.load_problem(Path(file)),
        "region": lambda file: lib.load_region(Path(file)),
    }
    if kind == "scenario":
        scenario = lib.load_scenario(path)
        word = choose_vehicle(vehicle, (scenario.name, scenario.vehicle)).word
        robot = lib.load_vehicle(word)
        gains, derivation = lib.gains_for(None, robot, cruise=scenario.cruise)
        problems = lib.findings(scenario, robot)
        wrong = any(one.level == "error" for one in problems)  # no claim is about it then
        mission = lib.Mission(robot, gains, scenario.cruise, scenario.cap, scenarios=() if wrong else (scenario,))
        about_loop, derive = _loop_findings(mission, word if derivation else None)
        problems += about_loop
    elif kind == "study":
        plan = lib.load_plan(path)
        for leg in plan.legs:
            problems += lib.findings(leg.scenario, leg.vehicle)
        wrong = any(one.level == "error" for one in problems)
        # another law is linearised about its runs, which `study` simulates
        if not wrong and lib.has_cruise_loop(plan.law, plan.guidance):
            source = Path(plan.vehicle.source)
            word = plan.vehicle.name if source.parent == lib.VEHICLES else str(source)
            about_loop, derive = _loop_findings(lib.assessed(plan, plan.gains), word if plan.derivation else None)
            problems += about_loop
        problems += _goal_findings(plan)
    elif isinstance(kind, str) and kind in plain:
        problems = _file_findings(plain[kind](path), path)
    else:
        known = ", ".join(f'"{name}"' for name in sorted([*plain, "scenario"]))
        remedy = f'write kind = {known} or "study"'
        raise InputError("is not a kind of file", file=path, key="kind", value=kind, remedy=remedy)
    option = "" if vehicle is None or kind not in _IN_VEHICLES else f" --vehicle {shlex.quote(vehicle)}"
    then = [f"surctl {words.format(shlex.quote(file))}{option}" for words in _NEXT[kind]]
    return Linted(path, kind, problems, then + derive)


def _path_and_kind(file: str) -> tuple[str, Any]:
    """Return the path of a file or of a built-in scenario or vehicle, and the kind that it states."""
    built_in = {path.stem: path for library in (lib.SCENARIOS, lib.VEHICLES) for path in library.glob("*.toml")}
    if not (Path(file).suffix or set("/\\") & set(file)):  # a bare name
        check_known(file, built_in, "unknown scenario or vehicle", key="file")
    path = str(built_in.get(file, file))
    return path, lib.read_toml(Path(path)).get("kind")
