"""What `surctl tune` says about its result besides the table of the goals, and its page with sliders."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import click

from surctl.cli.output import progress, waiting
from surctl.cli.robot_options import at_hand
from surctl.errors import InputError, NotApplicable

if TYPE_CHECKING:
    from surctl.assessment import Assessment, Figure
    from surctl.marine.control import Gains
    from surctl.marine.simulation import Case, Scenario
    from surctl.marine.study import Plan
    from surctl.marine.tuning import Finals, Goal, Miss, Tuning
    from surctl.marine.vehicle import Vehicle
    from surctl.report.design_bench import DesignBench


def check_goal_cases(goals: Sequence[Goal], plan: Plan, file: str) -> None:
    """Raise InputError if a goal names a scenario in which the vehicle does not fit."""
    deciding = {leg.scenario.name for leg in plan.deciding}
    omitted = {leg.scenario.name: leg.left_out for leg in plan.left_out if leg.scenario.name not in deciding}
    for goal in goals:
        for name in goal.cases:
            if name in omitted:
                remedy = "remove the scenario from the goal"
                key = f"goals.{goal.name}.cases"
                raise InputError(f"is left out: {omitted[name]}", file=file, key=key, value=name, remedy=remedy)


def caps(cases: Sequence[Case], gains: Mapping[str, float]) -> list[str]:
    """Return one line for each vehicle whose speed limit exceeds the largest speed with a stable linear loop."""
    from surctl.marine.verification.cruise_loop import has_cruise_loop
    from surctl.marine.verification.linear import cap_above_bearable

    distinct = {(c.vehicle.name, c.scenario.cap): c for c in cases if has_cruise_loop(c.law, c.guidance)}
    texts = (
        cap_above_bearable(c.vehicle, gains, cap=c.scenario.cap, dt=c.build().dt, law=c.law) for c in distinct.values()
    )
    return [f"warning: {line}" for line in texts if line is not None]


def floor_lines(tuning: Tuning, finals: Finals, plan: Plan, *, trials: int) -> list[str]:
    """Return why the tuned gains miss a least margin at the worst corner; nothing if they have both."""
    after = finals.comparison.after
    known = [after.figures[name] for name in ("disk_margin", "delay_margin_s") if name in after.figures]
    missed = [figure for figure in known if not figure.enough]
    heads = [_missed(figure, tuning, finals, trials=trials) for figure in missed]
    return [*heads, *(f"  {_why(plan, after, figure)}" for figure in missed[:1])]


def _missed(figure: Figure, tuning: Tuning, finals: Finals, *, trials: int) -> str:
    names = [goal.name for goal in (*tuning.request.goals, *finals.goals) if goal.metric == figure.name]
    clash = tuning.conflict
    if any(goal.name in names for goal in finals.goals):
        outcome = f"none of the {finals.checked} checked gain sets has it"
    elif set(names) & set(clash):
        together = f" together with {' + '.join(n for n in clash if n not in names)}" if len(clash) > 1 else ""
        outcome = f"no gain set of the searches ({trials} trials each) has it{together}"
    else:
        limits = ", ".join(f"{g.limit:g}" for g in tuning.request.goals if g.name in names)
        outcome = f"the goals ask for {limits or 'none'}"
    word, unit = ("disk margin", "") if figure.unit == "1" else ("delay margin", f" {figure.unit}")
    at = f"{figure.value:.3g}{unit} at the worst corner ({figure.where})"
    return f"{word} {at}, required {figure.least:g}{unit}: {outcome}"


def _why(plan: Plan, after: Assessment, missed: Figure) -> str:
    """Return what limits the margin: of gains that follow from the vehicle, or of the corners."""
    from surctl.marine.control import default_law
    from surctl.marine.tuning import derive_gains

    nominal, least = after.figures[f"nominal_{missed.name}"].value, missed.least
    if plan.law != default_law(plan.vehicle):
        if least is not None and nominal >= least:
            return f"the nominal vehicle has {nominal:.3g}: narrower ranges in the vehicle file raise it"
        return f"the nominal vehicle has {nominal:.3g}: lower the cruise speed, or tune further gains with --gain"
    cruise = max(leg.scenario.cruise for leg in plan.deciding)
    try:
        derivation = derive_gains(plan.vehicle, cruise=cruise)
    except InputError as error:
        return f"gains cannot be derived: {error.problem}"
    if derivation.reached:
        about = shlex.join(["--vehicle", plan.vehicle.source or plan.vehicle.name, "--cruise", f"{cruise:g}"])
        both = f"{derivation.disk_margin:.3g} and {derivation.delay_margin_s:.3g} s"
        return f"gains derived from the vehicle have {both}: surctl gains derive {about}"
    return derivation.warning.removeprefix("warning: ")


def unrepresentative(tuning: Tuning) -> list[str]:
    """Return a line if goals about a step response of the linear loop do not describe the run, see `ACTIVE`."""
    import numpy as np

    from surctl.marine.tuning import Goal, figures
    from surctl.tuning.goals import not_representative, step_goals

    names = [
        goal.name
        for goal in tuning.request.goals
        if goal.metric.startswith(("settling_time_s.", "overshoot."))
        or (goal.loop is not None and step_goals([goal.loop]))
    ]
    if not names:
        return []
    limit = Goal("limit", "axis_saturated_share", "1", 1.0)
    runs = tuning.request.conditions[: tuning.requested]
    (shares,) = figures([limit], runs, tuning.tuned.sets, threads=tuning.request.threads)[limit.metric]
    worst = int(np.argmax(np.nan_to_num(shares)))
    remedy = 'ask it of runs, such as metric = "time_s" or "deviation_m"'
    return not_representative(names, float(shares[worst]), limit="a thrust", run=runs[worst].label, remedy=remedy)


def look(missed: Sequence[Miss], gains: str, law: Sequence[str]) -> list[str]:
    """Return the command that repeats the worst run of a missed goal, with the nominal vehicle parameters."""
    runs = [miss.nominal for miss in missed if miss.nominal is not None and miss.ending is not None]
    if not runs:
        return []
    _, mission, *about = at_hand(runs[0].case.scenario, runs[0].case.vehicle, gains)
    return [shlex.join(["surctl", "simulate", mission, *about, *law, "--seed", str(runs[0].seed), "--explain"])]


def region_words(law: str, scenario: Scenario, vehicle: Vehicle, gains: Gains) -> list[str]:
    """Return the region claim to suggest next."""
    from surctl.marine.verification.region import applicable_region

    names = ("region-cruise-20", "region-steered-20")
    claim = applicable_region(names, vehicle, gains, law=law, cruise=scenario.cruise, cap=scenario.cap)
    return [] if isinstance(claim, NotApplicable) else [claim.name]


_PERIODS = 600  # of a run, without --seconds


def serve_page(
    study: str | None,
    goals: str | None,
    vehicles: Sequence[str],
    *,
    scenario: str | None,
    gains: str | None,
    law: str | None,
    cruise: Sequence[float] | None,
    port: int | None,
    browser: bool,
    trust: bool,
) -> None:
    """Serve the page for a law of the robot until Ctrl-C; arguments that are None take the study's values."""
    from surctl.marine.control import law_ref, load_gains
    from surctl.marine.report.bench import Bench
    from surctl.marine.simulation import findings, load_scenario
    from surctl.marine.study import load_plan
    from surctl.marine.tuning import load_goals
    from surctl.marine.tuning.goals import goals_at
    from surctl.marine.vehicle import load_vehicle
    from surctl.marine.verification import check_held

    plan = load_plan(study, trust=trust)
    if vehicles:
        plan = plan.by([load_vehicle(vehicles[0])])
    first = plan.deciding[0]
    mission = first.scenario if scenario is None else load_scenario(scenario)
    own = {leg.scenario.name: leg.vehicle for leg in plan.legs}
    vehicle = load_vehicle(vehicles[0]) if vehicles else own.get(mission.name) or load_vehicle(mission.vehicle)
    for finding in findings(mission, vehicle):
        if finding.level == "error":
            progress(f"{mission.name} by {vehicle.name}: {finding.text}")
    start = plan.gains if gains is None else load_gains(gains)
    chosen = goals_at(plan.goals if goals is None else load_goals(goals), cruise or plan.cruise)
    check_held(cruise or (), vehicle, cap=mission.cap, key="--cruise")
    reference = plan.law if law is None else law_ref(law, key="--law")
    others = tuple(load_vehicle(name) for name in vehicles[1:])
    named = (vehicles[0] if vehicles else "", scenario or "")
    bench = Bench(vehicle, mission, start, chosen, tuple(cruise or plan.cruise), reference, others, named)
    progress("compiling the closed loop; the next start uses the compiled file")
    values = {one.name: one.value for one in bench.sliders}
    bench.simulate(values)
    bench.judge(values)
    _serve(bench, port=port, browser=browser)


def serve_system_page(
    words: Sequence[str],
    ranges: Mapping[str, tuple[float, float] | None],
    goals: str | None,
    *,
    seconds: float | None,
    port: int | None,
    browser: bool,
) -> None:
    """Serve the page for a system of the user's own until Ctrl-C; NAME=V1,V2 gives the operating points."""
    from surctl.cli.subject import assigned, gain_ranges_of, listed_values, load_system, region_words
    from surctl.report.design_bench import SystemBench
    from surctl.tuning import judge_loops, load_loop_goals

    own = load_system(words)
    others, region, uncertain = region_words(own.settings, own.system)
    about_loop, stated = ((), {}) if goals is None else load_loop_goals(goals)
    values = listed_values(others)
    swept = {name: numbers for name, numbers in values.items() if len(numbers) > 1}
    fixed = {name: numbers[0] for name, numbers in values.items() if len(numbers) == 1}
    if len(swept) > 1:
        raise InputError(
            "are two lists", key=", ".join(swept), remedy="vary one number; use [[points]] of a goals file"
        )
    places = {name: {**fixed, **numbers} for name, numbers in stated.items()}
    for name, numbers in swept.items():
        places |= {f"{name}={number:g}": {**fixed, name: number} for number in numbers}
    places = places or {"nominal": dict(fixed)}
    gains = {name for name in fixed if "." not in name}
    if gains:
        raise InputError("is a gain", key=min(gains), remedy="move its slider")
    duration = own.seconds(seconds or own.system.duration or _PERIODS * own.system.dt)

    def problem(gains: Mapping[str, float]) -> object:
        return None if region is None else region.problem(own.system, {**assigned(()), **fixed, **gains})

    bench = SystemBench(
        own.system, own.word, duration, gain_ranges_of(own, ranges), places, about_loop,
        None if region is None else problem, own.origin, {**own.system.ranges, **uncertain},
    )  # fmt: skip
    start = {one.name: one.value for one in bench.sliders}
    loops = {point: bench.loop(start, point) for point in bench.points}
    judge_loops(about_loop, loops)  # reports unknown signals here
    if region is not None:
        problem(start)
    _serve(bench, port=port, browser=browser)


def _serve(bench: DesignBench, *, port: int | None, browser: bool) -> None:
    from surctl.report.serve import serve

    def ready(address: str) -> None:
        waiting()
        click.echo(f"{address}  (Ctrl-C stops the page)")
        sys.stdout.flush()
        if browser:
            click.launch(address)

    try:
        serve(bench, port=port, ready=ready)
    except KeyboardInterrupt:
        click.echo("surctl: stopped; saved files stay", err=True)
        sys.stdout.flush()
        os._exit(130)  # a normal exit would wait for the threads of an open page; all files are complete
