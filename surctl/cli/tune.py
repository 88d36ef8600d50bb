"""`surctl tune`: find gains that meet goals, and verify them with new random runs."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from surctl.cli.output import as_json, doing, finish, finite, progress, same_command, saving, stoppable
from surctl.cli.robot_options import SPEEDS, at_hand, export_command, law_words, trust_option
from surctl.cli.subject import (
    OwnSystem,
    command_line,
    cost_data,
    gain_ranges_of,
    is_system,
    listed_values,
    load_system,
    nominal_gains,
    seconds_option,
)
from surctl.cli.tuning_output import caps, check_goal_cases, floor_lines, look, region_words, unrepresentative
from surctl.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from surctl.assessment import Comparison


@click.command
@click.argument("words", nargs=-1, metavar="[STUDY | FILE.py:FUNCTION [NAME=VALUE,...]...]")
@click.option(
    "--gain", "gain", multiple=True, metavar="NAME[=LOW..HIGH]", help="Gain to tune, with its range; may be repeated."
)
@click.option(
    "--goals", "goals_file", metavar="FILE", help="Goals: name or file (default: the study's, else the built-in goals)."
)
@click.option("--cruise", type=SPEEDS, metavar="U1,U2,...", help="Cruise speeds [m/s] of loop goals that name none.")
@click.option(
    "--trials",
    type=click.IntRange(min=1),
    default=256,
    metavar="N",
    help="Gain sets per round, each simulated in all scenarios (default 256; multiple of 32).",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    metavar="N",
    help="Seed of the search and of the new runs (default 0).",
)
@click.option(
    "--seeds",
    type=click.IntRange(1, 1_000_000),
    default=4,
    metavar="N",
    help="Simulate with the seeds 0 to N-1 (default 4).",
)
@click.option(
    "--vehicle", "vehicles", multiple=True, metavar="FILE", help="Vehicle (name or file) of the runs; may be repeated."
)
@click.option(
    "--guidance",
    metavar="NAME",
    help="Path guidance: los, ilos or alos (default: the study's). Loop margins always use los.",
)
@click.option(
    "--rounds",
    type=click.IntRange(min=1),
    default=3,
    metavar="N",
    help="Largest number of rounds of tuning and verifying (default 3).",
)
@click.option(
    "--monte-carlo",
    "runs",
    type=click.IntRange(min=0),
    default=2000,
    metavar="N",
    help="Random runs that test the gains after each round (default 2000).",
)
@click.option("--workers", type=click.IntRange(min=1), default=2, metavar="N", help="Number of threads (default 2).")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("surctl-out"),
    metavar="DIR",
    help="Output folder (default surctl-out); an interrupted search resumes there.",
)
@click.option("--page", is_flag=True, help="Open a page with sliders instead of a search.")
@click.option("--law", metavar="NAME", help="Law: NAME or FILE.py:FUNCTION (default: the study's).")
@click.option("--scenario", metavar="FILE", help="Scenario of --page (default: the study's first).")
@click.option(
    "--gains", "gains_file", metavar="FILE", help="Gain set at the start: name or file (default: the study's)."
)
@click.option("--port", type=click.IntRange(1, 65535), metavar="N", help="Port of --page (default: a free port).")
@click.option("--no-browser", is_flag=True, help="Print the address of --page, but do not open it.")
@trust_option
@seconds_option
@as_json
def tune(
    words: tuple[str, ...],
    gain: tuple[str, ...],
    goals_file: str | None,
    cruise: tuple[float, ...] | None,
    trials: int,
    seed: int,
    seeds: int,
    vehicles: tuple[str, ...],
    guidance: str | None,
    rounds: int,
    runs: int,
    workers: int,
    out: Path,
    page: bool,
    law: str | None,
    scenario: str | None,
    gains_file: str | None,
    port: int | None,
    no_browser: bool,
    trust: bool,
    seconds: float | None,
    as_json: bool,
) -> None:
    """Search for gains that meet goals; test them, and repeat with runs that fail.

    The gains must meet the hard goals for every scenario, seed and corner of the vehicle's ranges; the soft goals are
    minimised. New random runs and the claims test the tuned gains. Exit status: 1 if a hard goal is not met or fails
    in the test, or if a line of the assessment fails.

    FILE.py:FUNCTION names a system of your own: the search minimises its first cost, with the bounds of the
    other costs and a disk margin of at least 0.3, for every value of NAME=V1,V2. With --goals, the search minimises the
    worst soft goal.

    Examples: surctl tune my-study.toml --gain k_v=0.5..3 --goals my-goals.toml; surctl tune my-system.py:build --page
    """
    ranges = dict(_gain(text) for text in gain)
    if len(ranges) < len(gain):
        raise click.BadParameter("names a gain twice", param_hint="--gain")
    shown = ("page", "port", "no_browser")
    if is_system(words, "gain", "goals_file", "seconds", "trials", "seed", "workers", "out", "as_json", *shown):
        if page:
            from surctl.cli.tuning_output import serve_system_page

            serve_system_page(words, ranges, goals_file, seconds=seconds, port=port, browser=not no_browser)
            return
        search = {"trials": trials, "seed": seed, "workers": workers}
        tune_own_system(words, ranges, seconds=seconds, out=out, goals=goals_file, as_json=as_json, **search)
    if len(words) > 1:
        raise click.UsageError(f"Got unexpected extra argument ({words[1]})")
    file = words[0] if words else None
    if page:
        from surctl.cli.tuning_output import serve_page

        serve_page(
            file, goals_file, vehicles,
            scenario=scenario, gains=gains_file, law=law, cruise=cruise, port=port, browser=not no_browser, trust=trust,
        )  # fmt: skip
        return
    if scenario or port or no_browser:
        raise click.UsageError(_needs_page(scenario))
    from surctl.files import prepare_folder, write_file
    from surctl.ir import find_compiler

    find_compiler()  # thousands of runs: without compiled code, hours
    from surctl.marine.control import default_law, write_gains
    from surctl.marine.study import load_plan
    from surctl.marine.study.conduct import assessed
    from surctl.marine.tuning import (
        CHECKED,
        Request,
        build_cases,
        conditions,
        gain_ranges,
        load_goals,
        summary,
        tuned_gains,
    )
    from surctl.marine.tuning import tune as run_tuning
    from surctl.marine.tuning.evaluation import check_goals, judged_goals
    from surctl.marine.tuning.goals import goals_at, with_floor
    from surctl.marine.tuning.outcome import advice, check_finals, misses, tuning_dict
    from surctl.marine.tuning.pool import default_tuned
    from surctl.marine.tuning.search import BEST
    from surctl.marine.vehicle import load_vehicle
    from surctl.own_code import label

    plan = load_plan(file, trust=trust)
    plan = plan if law is None else plan.with_law(law)
    plan = plan if gains_file is None else plan.with_gains(gains_file)
    if vehicles:
        plan = plan.by([load_vehicle(vehicle) for vehicle in vehicles])
    if plan.unheard:
        prepare_folder(out)
        plan = plan.written(out / "missions")
    stated = plan.goals if goals_file is None else load_goals(goals_file)
    if cruise and not any(goal.linear for goal in stated):
        remedy = "add one, on disk_margin say, or leave the option out"
        raise InputError("no goal is about the linear loop", key="--cruise", value=list(cruise), remedy=remedy)
    derived = [] if plan.derivation is None else plan.derivation.lines()
    for line in derived:
        progress(line)
    pairs = [(leg.scenario, leg.vehicle) for leg in plan.deciding]
    omitted = [f"{leg.scenario.name} by {leg.vehicle.name} is left out: {leg.left_out}" for leg in plan.left_out]
    for line in omitted:
        progress(line)
    check_goal_cases(stated, plan, goals_file or plan.source)
    kind = {"law": plan.law, "guidance": plan.guidance if guidance is None else guidance}
    cases = [build_cases([scenario], [vehicle], gains=plan.gains, **kind)[0] for scenario, vehicle in pairs]
    every = with_floor(stated)
    for goal in every[len(stated) :]:
        progress(f"added goal {goal.name}: {goal.sense} {goal.limit:g}; a goal on {goal.metric} replaces it")
    goals, finals, unjudged = judged_goals(goals_at(every, cruise or plan.cruise), cases)
    own = (
        []
        if set(plan.goals) <= set(load_goals()) and goals_file is None
        else [goal.name for goal in every[: len(stated)]]
    )
    default = [goal for goal in (*finals, *unjudged) if goal.name not in own]
    mine = [goal.name for goal in unjudged if goal.kind == "hard" and goal not in default]
    if mine:
        problem = f"is hard, but surctl has no linear model of law {label(plan.law)}"
        remedy = 'write type = "margins" in place of metric, or drop it'
        raise InputError(problem, file=goals_file or plan.source, key=f"goals.{mine[0]}", remedy=remedy)
    for goal in unjudged:
        omitted.append(f"goal {goal.name} is not judged: tune has no linear model of law {label(plan.law)}")
        progress(omitted[-1])
    if finals:
        names = ", ".join(goal.name for goal in finals)
        progress(f"checked at the end on the best gain sets (at most {CHECKED}), not in the search: {names}")
    if not goals:
        remedy = "add a goal on a metric of the runs, time_s say"
        problem = "has only goals on figures that the search does not compute"
        raise InputError(problem, file=goals_file or plan.source, key="goals", remedy=remedy)
    all_runs = conditions(cases, seeds=range(seeds))
    try:
        check_goals(goals, all_runs)
    except InputError as error:
        if error.value in (cruise or ()):
            raise InputError(error.problem, key="--cruise", value=error.value, remedy=error.remedy) from None
        raise error.inside(goals_file or plan.source) from None
    prepare_folder(out)
    request = Request(
        goals,
        all_runs,
        plan.gains,
        gain_ranges(plan.gains, ranges or default_tuned(plan.gains)),
        seed=seed,
        threads=workers,
    )
    with stoppable(f"the finished trials are in {out}, the best gains in {out / BEST}; to continue: {same_command()}"):
        tuning = run_tuning(request, trials=trials, rounds=rounds, runs=runs, folder=out, progress=progress)
        subject = replace(plan, guidance=cases[0].guidance)
        tuning, checked = check_finals(
            tuning, finals, lambda gains: assessed(subject, gains), default=default, progress=progress
        )
    for goal in checked.undetermined:
        unjudged = (*unjudged, goal)
        omitted.append(f"goal {goal.name} is not judged: the assessment has no {goal.metric}")
    unmet = (*tuning.unmet, *checked.unmet)
    warning = ""
    if unmet:
        warning = f"HARD GOALS NOT MET ({', '.join(unmet)}): best gains found, but do not use them on a vehicle"
    comparison = checked.comparison
    accepted = not unmet and comparison.after.accepted()
    note = warning or ("" if accepted else comparison.after.verdict())
    gains_path = write_file(out / "gains.toml", write_gains(tuned_gains(tuning), warning=note))
    (out / BEST).unlink(missing_ok=True)
    result = tuning_dict(tuning)
    result["left_out"] = [
        {"scenario": leg.scenario.name, "vehicle": leg.vehicle.name, "reason": leg.left_out} for leg in plan.left_out
    ]
    result["not_judged"] = [goal.name for goal in unjudged]
    result["caps"] = over = caps(cases, {**plan.gains.values, **tuning.result.gains})
    result["floor"] = floor = floor_lines(tuning, checked, plan, trials=trials)
    result["not_representative"] = doubtful = unrepresentative(tuning)
    result |= {"accepted": accepted, "unmet": list(unmet), "finals": checked.to_dict()}
    result["assessment"] = comparison.to_dict()
    everything = write_file(out / "tuning.json", json.dumps(finite(result), ensure_ascii=False, indent=1) + "\n")
    pictures = list[Path]()
    with saving("plots"):
        from surctl.marine.report.files import save_tuning

        pictures = save_tuning(tuning, out)
    headline, *figures = comparison.lines()
    lines = [
        headline,
        *floor,
        *figures,
        "",
        *summary(tuning),
        *checked.lines(),
        *doubtful,
        *derived,
        *omitted,
        *over,
        "",
        f"gains {gains_path}",
        f"all   {everything}",
    ]
    lines += [f"plot  {path}" for path in pictures]
    mission, robot = pairs[0]
    about = at_hand(mission, robot, str(gains_path))
    region = region_words(plan.law, mission, robot, tuned_gains(tuning))
    # a region claim needs only the speeds; with --scenario, the safety claim would also affect the exit status
    speeds = ["--cruise", f"{mission.cruise:g}", "--cap", f"{mission.cap:g}"]
    chosen = [] if plan.law == default_law(robot) else law_words(plan.law)
    arguments = [*region, *(speeds if region else about[:2]), *about[2:], *chosen, "--out", str(out / "proofs")]
    options = [*law_words(plan.law), "--guidance", kind["guidance"], "--sensing", "truth"]  # as in the tuning
    then = export_command(about[1], about[3], str(gains_path), law=plan.law, guidance=kind["guidance"], sensing="truth")
    then = [shlex.join(["surctl", "verify", *arguments]), *then]
    if unmet and tuning.accepted:
        lines += ["", warning]
    if not tuning.accepted:
        missed, (remedy, longer) = misses(tuning), advice(tuning, trials=trials)
        lines += ["", warning, *(f"  {miss.text}" for miss in missed), f"  {remedy}"]
        then = (
            [same_command(trials=2 * trials, rounds=rounds + 2)] if longer else look(missed, str(gains_path), options)
        )
    brief = [headline, *([warning] if warning else []), *_verdict(comparison)]
    brief += [*floor, *summary(tuning)[-2:], *doubtful, *over]
    finish(
        result,
        lines,
        as_json=as_json,
        passed=accepted,
        then=then,
        brief=brief,
        files=[f"gains {gains_path}", f"all {everything}"],
    )


def _verdict(comparison: Comparison) -> list[str]:
    """Return the verdict on the tuned gains for a summary; nothing if they are accepted."""
    return [] if comparison.after.accepted() else [comparison.after.verdict()]


def _needs_page(scenario: str | None) -> str:
    """Return the error for options that need --page; the message says how a study file sets their values."""
    if scenario:
        own = f'write [[runs]] with scenario = "{scenario}" in a study file and give the file: surctl tune STUDY.toml'
        return f"--scenario selects the scenario of --page; to tune over chosen scenarios, {own}"
    return "--port and --no-browser need --page"


def _gain(text: str) -> tuple[str, tuple[float, float] | None]:
    name, equals, ends = text.partition("=")
    if not equals:
        return name, None
    low, dots, high = ends.partition("..")
    try:
        if dots:
            return name, (float(low), float(high))
    except ValueError:
        pass
    raise click.BadParameter(f"{text!r} is not NAME=LOW..HIGH", param_hint="--gain")


_SO_FAR = "best-so-far.csv"


def tune_own_system(
    words: Sequence[str],
    ranges: Mapping[str, tuple[float, float] | None],
    *,
    seconds: float | None,
    trials: int,
    seed: int,
    workers: int,
    out: Path,
    goals: str | None,
    as_json: bool,
) -> None:
    """Search gains, write them, print each figure before and after; the exit status is 1 if a bound or a line fails."""
    from surctl.assessment import Comparison
    from surctl.files import prepare_folder
    from surctl.ir import find_compiler
    from surctl.recorded_write import write_csv
    from surctl.tuning.goals import load_system_goals, not_representative, step_goals
    from surctl.tuning.systems import assess_cases, check_tuning, tune_system

    own = load_system(words)
    about_loop, points, about_runs = ((), {}, ()) if goals is None else load_system_goals(goals, own.system)
    duration = own.seconds(seconds) if own.system.costs or seconds is not None else 0.0
    cases, space = _cases(own), gain_ranges_of(own, ranges)
    check_tuning(own.system, space, cases, goals=(*about_loop, *about_runs))
    if own.system.costs:  # its runs are compiled
        find_compiler()
    prepare_folder(out)
    progress(f"up to {trials} gain sets")
    file = out / _SO_FAR

    def note(tried: int, best: Mapping[str, float]) -> None:
        doing(f"{tried} of {trials} gain sets")
        write_csv(file, {name: [value] for name, value in best.items()})

    try:
        message = f"the best gains so far are in {file}, without a check of their disk margin; to continue: "
        with stoppable(message + same_command()):
            note(0, {name: value for name, value in nominal_gains(own).items() if name in space})
            result = tune_system(
                own.system, duration, space,
                cases=cases, trials=trials, seed=seed, threads=workers, out=out, goals=about_loop, points=points,
                run_goals=about_runs, progress=note,
            )  # fmt: skip
    except InputError as error:
        raise (error.inside(goals) if (error.key or "").startswith(("goals.", "point ")) else error) from None
    table: Path | None = None
    with saving("gains"):
        table = write_csv(out / "gains.csv", {name: [value] for name, value in result.gains.items()})
        file.unlink(missing_ok=True)
    comparison = Comparison(
        *(assess_cases(own.system, cases, gains, seconds=duration or None) for gains in ({}, result.gains))
    )
    headline, *figures = comparison.lines()
    doubtful = []
    limited = comparison.after.figures.get("limited_share")
    if limited is not None:
        linear, costs = [goal.name for goal in step_goals(about_loop)], own.system.costs
        late = next((name for name, cost in costs.items() if cost.how == "last_time"), next(iter(costs), None))
        remedy = f'ask it of the run, such as metric = "{late}"' if late else "give the system a cost of its runs"
        limit = f"command {limited.where}"
        doubtful = not_representative(linear, limited.value, limit=limit, run="the run", remedy=remedy)
    earlier = f" ({result.restored} of them before the interruption)" * bool(result.restored)
    runs = f", runs of {duration:g} s" if own.system.costs else ""
    lines = [
        headline,
        *doubtful,
        f"{own.system.title}: {result.trials} gain sets{earlier}{runs}",
        *(f"  {line}" for line in result.lines(own.system)),
        *([f"gains {table}"] if table else []),
        "",
        *figures,
    ]
    data = {
        **own.names,
        "seconds": duration,
        "objective": result.objective,
        "best": {"gains": dict(result.gains), "costs": cost_data(own.system, result.costs)},
        "before": dict(result.before),
        "assessment": comparison.to_dict(),
        "least_disk_margin": result.least_disk_margin,
        "goals": [] if result.goals is None else [score.to_dict() for score in result.goals.scores],
        "run_goals": [goal.to_dict() for goal in result.run_goals],
        "not_representative": doubtful,
        "unmet": list(result.unmet),
        "trials": result.trials,
        "restored": result.restored,
        "gains": None if table is None else str(table),
    }
    numbers = [f"{name}={value!r}" for name, value in result.gains.items()]
    then = [
        command_line("verify", own, *numbers),
        command_line("export", own, *numbers, "--seconds", f"{duration or 100 * own.system.dt:g}"),
    ]
    fine = all(map(math.isfinite, result.costs.values()))
    brief = [headline, *_verdict(comparison), *doubtful, *map(str.strip, result.lines(own.system))]
    finish(
        data, lines, as_json=as_json, passed=fine and not result.unmet and comparison.after.accepted(),
        then=then if fine else (),
        brief=brief, files=[f"gains {table}"] if table else [],
    )  # fmt: skip


def _cases(own: OwnSystem) -> dict[str, NDArray[np.float64]]:
    """Return the values of each name in all cases from words NAME=V1,V2,…; a single value is for all cases."""
    import numpy as np

    from surctl.system.values import check_scalar

    values = listed_values(own.settings)
    for name in values:
        if len(values[name]) > 1:
            check_scalar(own.system, name)
    return {name: np.array(v[0] if len(v) == 1 else v) for name, v in values.items()}
