"""What `surctl tune` says about its result besides the table of the goals."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from surctl.cli.vehicle_choice import at_hand

if TYPE_CHECKING:
    from surctl.assessment import Assessment
    from surctl.marine.control import Gains
    from surctl.marine.simulation import Case, Scenario
    from surctl.marine.study import Plan
    from surctl.marine.tuning import Finals, Goal, Miss, Tuning
    from surctl.marine.vehicle import Vehicle

__all__ = ["caps", "check_goal_cases", "floor_lines", "look", "region_words", "unrepresentative"]


def check_goal_cases(goals: Sequence[Goal], plan: Plan, file: str) -> None:
    """Raise InputError if a goal names a scenario in which the vehicle does not fit."""
    from surctl.errors import InputError

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
    from surctl.marine.verification.cascade import has_cascade
    from surctl.marine.verification.linear import cap_above_bearable

    distinct = {(c.vehicle.name, c.scenario.cap): c for c in cases if has_cascade(c.law, c.guidance)}
    texts = (cap_above_bearable(c.vehicle, gains, cap=c.scenario.cap, dt=c.build().dt) for c in distinct.values())
    return [f"warning: {line}" for line in texts if line is not None]


def floor_lines(tuning: Tuning, finals: Finals, plan: Plan, *, trials: int) -> list[str]:
    """Return why the tuned gains miss the least disk margin at the worst corner; nothing if they have it."""
    after = finals.comparison.after
    disk = after.figures.get("disk_margin")
    if disk is None or disk.least is None or disk.enough:
        return []
    names = [goal.name for goal in (*tuning.request.goals, *finals.goals) if goal.metric == disk.name]
    clash = tuning.conflict
    if any(goal.name in names for goal in finals.goals):
        outcome = f"none of the {finals.checked} checked gain sets has it"
    elif set(names) & set(clash):
        together = f" together with {' + '.join(n for n in clash if n not in names)}" if len(clash) > 1 else ""
        outcome = f"no gain set of the searches ({trials} trials each) has it{together}"
    else:
        limits = ", ".join(f"{g.limit:g}" for g in tuning.request.goals if g.name in names)
        outcome = f"the goals ask for {limits or 'none'}"
    head = f"disk margin {disk.value:.3g} at the worst corner ({disk.where}), required {disk.least:g}: {outcome}"
    return [head, f"  {_why(plan, after)}"]


def _why(plan: Plan, after: Assessment) -> str:
    """Return what limits the margin: of gains that follow from the vehicle, or of the corners."""
    from surctl.errors import InputError
    from surctl.marine.control import default_law
    from surctl.marine.tuning import derive_gains

    nominal, least = after.figures["nominal_disk_margin"].value, after.figures["disk_margin"].least
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
        return f"gains derived from the vehicle have {derivation.disk_margin:.3g}: surctl gains derive {about}"
    return derivation.warning.removeprefix("warning: ")


def unrepresentative(tuning: Tuning) -> list[str]:
    """Return a line if goals about a step response of the linear loop do not describe the run, see `ACTIVE`."""
    import numpy as np

    from surctl.marine.tuning import Goal, figures
    from surctl.tuning.representative import not_representative, step_goals

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
    from surctl.errors import NotApplicable
    from surctl.marine.control import PATH_FOLLOWING, default_law, law_source
    from surctl.marine.verification.region import applicable_region

    if law != default_law(vehicle) and PATH_FOLLOWING not in law_source(law).parts:
        return []
    names = ("region-cruise-20", "region-steered-20")
    claim = applicable_region(names, vehicle, gains, cruise=scenario.cruise, cap=scenario.cap)
    return [] if isinstance(claim, NotApplicable) else [claim.name]
