"""`surctl tune` of missions: goals added or refused, gain file, lines about margins, page with sliders."""

from __future__ import annotations

import shlex
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click

from surctl.cli.options import Count, collected, option, options
from surctl.cli.output import progress
from surctl.cli.tune import More, Task, TuneOptions
from surctl.errors import InputError, NotApplicable
from surctl.marine.cli import lib
from surctl.marine.cli.robot_options import SPEEDS, TRUST, at_hand, export_command, law_words


@dataclass(frozen=True, eq=False, repr=False)
class TunedMissions:
    """The options about the missions of a study; None: the study's own.

    `seeds` simulate each gain set, and `cruise` are the speeds [m/s] of goals about the loop without speeds.
    """

    cruise: tuple[float, ...] | None = option(
        "--cruise", "Cruise speeds [m/s] of loop goals that state none.", type=SPEEDS, metavar="U1,U2,..."
    )
    seeds: int = option(
        "--seeds", "Simulate each gain set with the seeds 0 to N-1 (default 4).", 4, type=Count(1, 1_000_000)
    )
    vehicles: tuple[str, ...] = option(
        "--vehicle", "Vehicle, repeatable: name or file (default: STUDY's).", (), metavar="FILE"
    )
    guidance: str | None = option(
        "--guidance",
        "Path guidance of simulated runs: los, ilos, alos (default: that of STUDY). Margins always use los.",
        metavar="NAME",
    )
    law: str | None = option("--law", "Law: NAME or FILE.py:FUNCTION (default: that of STUDY).", metavar="NAME")
    scenario: str | None = option("--scenario", "Scenario of --page (default: the first of the study).", metavar="FILE")
    gains_file: str | None = option(
        "--gains", "Initial gain set: name or file (default: that of STUDY).", metavar="FILE"
    )
    trust: bool = option("--trust", TRUST, False)


@click.command
@click.argument("words", nargs=-1, metavar="[STUDY")
@options(missions=TunedMissions)
@collected(options=TuneOptions)
def tune(words: Sequence[str], options: TuneOptions, missions: TunedMissions, **_: Any) -> Task | lib.Bench:
    """Search for gains that meet goals, test the gains in random runs, and search again with the runs that fail.

    The gains must meet the hard goals in every scenario, for every seed and at every corner of the parameter ranges of
    the vehicle; the search minimises the soft goals. With the tuned gains, surctl searches for counterexamples to the
    corrected claims of the paper by Li, Guo and Guo. Exit status: 1 if the gains miss a hard goal in search or test, or
    if a line says FAIL.

    For FILE.py:FUNCTION, a system of your own, the search minimises the first cost or, with --goals, the largest soft
    goal (value/bound). NAME=V1,V2 defines two cases, NAME = V1 and NAME = V2; in each case, the disk margin must be at
    least 0.3, and each cost that is not minimised must meet its bound.

    Examples: surctl tune my-study.toml --gain k_v=0.5..3 --goals my-goals.toml; surctl tune my-system.py:build --page
    """
    if len(words) > 1:
        raise click.UsageError(f"Got unexpected extra argument ({words[1]})")
    file = words[0] if words else None
    if options.page:
        return _bench(file, options.goals_file, missions)
    if missions.scenario:
        own = f'write [[runs]] with scenario = "{missions.scenario}" in a study file and give the file'
        text = (
            f"--scenario selects the scenario of --page; to tune over chosen scenarios, {own}: surctl tune STUDY.toml"
        )
        raise click.UsageError(text)
    lib.find_compiler()  # thousands of runs: without compiled code, hours
    return _tuned(mission_plan(file, missions, options.out), options, missions)


def _printed(lines: list[str]) -> list[str]:
    for line in lines:
        progress(line)
    return lines


@dataclass(frozen=True, eq=False)
class _Missions(Task):
    request: lib.Request
    plan: lib.Plan
    unjudged: Sequence[lib.Goal]
    derived: list[str]
    omitted: list[str]

    @property
    def cases(self) -> Sequence[lib.Case]:
        return self.request.cases

    def assessed(
        self, gains: Mapping[str, float], parts: Collection[str] | None, computed: Mapping[str, lib.Part] | None
    ) -> lib.Assessment:

        plan = replace(self.plan, guidance=self.cases[0].guidance)
        return lib.assess(lib.assessed(plan, plan.gains.with_values(dict(gains))), parts=parts, computed=computed)

    def gain_file(self, tuning: lib.Tuning, out: Path, warning: str) -> tuple[Path, str]:
        return out / "gains.toml", lib.write_gains(lib.tuned_gains(tuning), warning=warning)

    def more(self, tuning: lib.Tuning, checked: lib.Finals, gains: str, trials: int) -> More:
        plan, case = self.plan, self.cases[0]
        unjudged = [goal.name for goal in (*self.unjudged, *checked.undetermined)]
        late = [f"goal {g.name} is not judged: the assessment has no {g.metric}" for g in checked.undetermined]
        out = [(leg.scenario.name, leg.vehicle.name, leg.left_out) for leg in plan.left_out]
        left = [dict(zip(("scenario", "vehicle", "reason"), one, strict=True)) for one in out]
        over = caps(self.cases, {**plan.gains.values, **tuning.result.gains})
        floor = floor_lines(tuning, checked, plan, trials=trials)
        mission, robot = case.scenario, case.vehicle
        about = at_hand(mission, robot, gains)
        region = region_words(plan.law, mission, robot, lib.tuned_gains(tuning))
        # a region claim needs only the speeds; with --scenario, the safety claim would also affect the exit status
        speeds = ["--cruise", f"{mission.cruise:g}", "--cap", f"{mission.cap:g}"]
        chosen = [*law_words(plan.law, vehicle=robot), "--sensing", "truth"]
        proofs = ["--out", str(Path(gains).parent / "proofs")]
        arguments = [*region, *(speeds if region else about[:2]), *about[2:], *chosen, *proofs]
        shipped = export_command(about[1], about[3], gains, law=plan.law, form=case, sensing="truth")
        data = {"left_out": left, "not_judged": unjudged, "caps": over, "floor": floor}
        notes = [*self.derived, *self.omitted, *late, *over]
        then = [shlex.join(["surctl", "verify", *arguments]), *shipped]
        return More(data, then, floor, notes, over)

    def pictures(self, tuning: lib.Tuning, out: Path) -> list[Path]:
        return lib.save_tuning(tuning, out)

    def look(self, missed: Sequence[lib.Miss], gains: str) -> list[str]:
        options = [*law_words(self.plan.law), "--guidance", self.cases[0].guidance, "--sensing", "truth"]
        return look(missed, gains, options)  # as in the tuning


def mission_plan(file: str | None, missions: TunedMissions, out: Path) -> lib.Plan:
    """Return the study whose missions are tuned, with the options of the command line in place of its own values."""
    plan = lib.load_plan(file, trust=missions.trust)
    plan = plan if missions.law is None else plan.with_law(missions.law)
    plan = plan if missions.gains_file is None else plan.with_gains(missions.gains_file)
    plan = plan.by([lib.load_vehicle(vehicle) for vehicle in missions.vehicles]) if missions.vehicles else plan
    if all(leg.scenario.source for leg in plan.legs):
        return plan
    lib.prepare_folder(out)  # the commands that are printed at the end name the file of a mission
    return plan.written(out / "missions")


def _tuned(plan: lib.Plan, options: TuneOptions, missions: TunedMissions) -> Task:
    """Return the tuning of the missions of a study.

    Raises:
        InputError: a goal does not fit the missions, or a gain is unknown.
    """
    goals_file, cruise = options.goals_file, missions.cruise or ()
    file = goals_file or plan.source
    stated = plan.goals if goals_file is None else lib.load_goals(goals_file)
    if cruise and not any(goal.linear for goal in stated):
        remedy = "add one, on disk_margin say, or leave the option out"
        raise InputError("no goal is about the linear loop", key="--cruise", value=list(cruise), remedy=remedy)
    derived = _printed([] if plan.derivation is None else plan.derivation.lines())
    omitted = [f"{leg.scenario.name} by {leg.vehicle.name} is left out: {leg.left_out}" for leg in plan.left_out]
    _printed(omitted)
    check_goal_cases(stated, plan, file)
    kind = {"law": plan.law, "guidance": plan.guidance if missions.guidance is None else missions.guidance}
    cases = [lib.build_cases([leg.scenario], [leg.vehicle], gains=plan.gains, **kind)[0] for leg in plan.deciding]
    every = lib.with_floor(stated)
    for goal in every[len(stated) :]:
        progress(f"added goal {goal.name}: {goal.sense} {goal.limit:g}; a goal on {goal.metric} replaces it")
    goals, finals, unjudged = lib.judged_goals(lib.goals_at(every, cruise or plan.cruise), cases)
    own = [goal.name for goal in stated]
    if set(plan.goals) <= set(lib.load_goals()) and goals_file is None:
        own = []
    default = [goal for goal in (*finals, *unjudged) if goal.name not in own]
    mine = [goal.name for goal in unjudged if goal.kind == "hard" and goal not in default]
    if mine:
        problem = f"is hard, but surctl has no linear model of law {lib.label(plan.law)}"
        remedy = 'write type = "margins" in place of metric, or drop it'
        raise InputError(problem, file=file, key=f"goals.{mine[0]}", remedy=remedy)
    model = f"tune has no linear model of law {lib.label(plan.law)}"
    omitted += _printed([f"goal {goal.name} is not judged: {model}" for goal in unjudged])
    if finals:
        names = ", ".join(goal.name for goal in finals)
        progress(
            f"checked at the end on the best gain sets (at most {lib.Request.checked}), not in the search: {names}"
        )
    if not goals:
        problem = "has only goals on figures that the search does not compute"
        raise InputError(problem, file=file, key="goals", remedy="add a goal on a metric of the runs, time_s say")
    runs = lib.conditions(cases, seeds=range(missions.seeds))
    try:
        lib.check_goals(goals, runs)
    except InputError as error:
        if error.value in cruise:
            raise InputError(error.problem, key="--cruise", value=error.value, remedy=error.remedy) from None
        raise error.inside(file) from None
    space = lib.gain_ranges(plan.gains, options.ranges or lib.default_tuned(plan.gains))
    request = lib.Request(goals, runs, plan.gains, space, seed=options.seed, threads=options.workers)
    remedy = 'ask it of runs, such as metric = "time_s" or "deviation_m"'
    limit = {"command": "a thrust", "run": "{}", "remedy": remedy}
    return _Missions(request, finals, default, limit, 2000, plan, unjudged, derived, omitted)


def check_goal_cases(goals: Sequence[lib.Goal], plan: lib.Plan, file: str) -> None:
    """Raise InputError if a goal names a scenario in which the vehicle does not fit."""
    deciding = {leg.scenario.name for leg in plan.deciding}
    omitted = {leg.scenario.name: leg.left_out for leg in plan.left_out if leg.scenario.name not in deciding}
    for goal in goals:
        for name in goal.cases:
            if name in omitted:
                remedy = "remove the scenario from the goal"
                key = f"goals.{goal.name}.cases"
                raise InputError(f"is left out: {omitted[name]}", file=file, key=key, value=name, remedy=remedy)


def caps(cases: Sequence[lib.Case], gains: Mapping[str, float]) -> list[str]:
    """Return one line for each vehicle whose speed limit exceeds the largest speed with a stable linear loop."""
    distinct = {(c.vehicle.name, c.scenario.cap): c for c in cases if lib.has_cruise_loop(c.law, c.guidance)}
    texts = (
        lib.cap_above(
            c.vehicle,
            lib.bearable_speed(lib.corners(c.vehicle).alone, gains, dt=c.build().dt, law=c.law),
            cap=c.scenario.cap,
        )
        for c in distinct.values()
    )
    return [f"warning: {line}" for line in texts if line is not None]


def floor_lines(tuning: lib.Tuning, finals: lib.Finals, plan: lib.Plan, *, trials: int) -> list[str]:
    """Return why the tuned gains miss a least margin at the worst corner; nothing if they have both."""
    after = finals.comparison.after
    known = [after.figures[name] for name in ("disk_margin", "delay_margin_s") if name in after.figures]
    missed = [figure for figure in known if not figure.enough]
    heads = [_missed(figure, tuning, finals, trials=trials) for figure in missed]
    return [*heads, *(f"  {_why(plan, after, figure)}" for figure in missed[:1])]


def _missed(figure: lib.Figure, tuning: lib.Tuning, finals: lib.Finals, *, trials: int) -> str:
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
    return f"{lib.short_margin(figure.unit, figure.least or 0.0, figure.value, f'at {figure.where}')}: {outcome}"


def _why(plan: lib.Plan, after: lib.Assessment, missed: lib.Figure) -> str:
    """Return what limits the margin: of gains that follow from the vehicle, or of the corners."""
    nominal, least = after.figures[f"nominal_{missed.name}"].value, missed.least
    if plan.law != lib.default_law(plan.vehicle):
        if least is not None and nominal >= least:
            return f"the nominal vehicle has {nominal:.3g}: narrower ranges in the vehicle file raise it"
        return f"the nominal vehicle has {nominal:.3g}: lower the cruise speed, or tune further gains with --gain"
    cruise = max(leg.scenario.cruise for leg in plan.deciding)
    try:
        derivation = lib.derive_gains(plan.vehicle, cruise=cruise)
    except InputError as error:
        return f"gains cannot be derived: {error.problem}"
    if derivation.reached:
        about = shlex.join(["--vehicle", plan.vehicle.source or plan.vehicle.name, "--cruise", f"{cruise:g}"])
        both = f"{derivation.disk_margin:.3g} and {derivation.delay_margin_s:.3g} s"
        return f"gains derived from the vehicle have {both}: surctl gains derive {about}"
    return derivation.warning.removeprefix("warning: ")


def look(missed: Sequence[lib.Miss], gains: str, law: Sequence[str]) -> list[str]:
    """Return the command that repeats the worst run of a missed goal, with the nominal vehicle parameters."""
    runs = [miss.nominal for miss in missed if miss.nominal is not None and miss.ending is not None]
    if not runs:
        return []
    _, mission, *about = at_hand(runs[0].case.scenario, runs[0].case.vehicle, gains)
    return [shlex.join(["surctl", "simulate", mission, *about, *law, "--seed", str(runs[0].seed), "--explain"])]


def region_words(law: str, scenario: lib.Scenario, vehicle: lib.Vehicle, gains: lib.Gains) -> list[str]:
    """Return the region claim to suggest next."""
    names = ("region-cruise-20", "region-steered-20")
    claim = lib.applicable_region(names, vehicle, gains, law=law, cruise=scenario.cruise, cap=scenario.cap)
    return [] if isinstance(claim, NotApplicable) else [claim.name]


def _bench(study: str | None, goals: str | None, options: TunedMissions) -> lib.Bench:
    """Return what the page of a law of the robot shows; options that are None take the study's values."""
    vehicles, scenario = options.vehicles, options.scenario
    plan = lib.load_plan(study, trust=options.trust)
    if vehicles:
        plan = plan.by([lib.load_vehicle(vehicles[0])])
    first = plan.deciding[0]
    mission = first.scenario if scenario is None else lib.load_scenario(scenario)
    own = {leg.scenario.name: leg.vehicle for leg in plan.legs}
    vehicle = lib.load_vehicle(vehicles[0]) if vehicles else own.get(mission.name) or lib.load_vehicle(mission.vehicle)
    for finding in lib.findings(mission, vehicle):
        if finding.level == "error":
            progress(f"{mission.name} by {vehicle.name}: {finding.text}")
    start, cruise = options.gains_file, options.cruise or plan.cruise
    gains = plan.gains if start is None else lib.load_gains(start)
    chosen = lib.goals_at(plan.goals if goals is None else lib.load_goals(goals), cruise)
    lib.check_held(options.cruise or (), vehicle, cap=mission.cap, key="--cruise")
    reference = plan.law if options.law is None else lib.law_ref(options.law, key="--law")
    others = tuple(lib.load_vehicle(name) for name in vehicles[1:])
    named = (vehicles[0] if vehicles else "", scenario or "")
    bench = lib.Bench(vehicle, mission, gains, chosen, tuple(cruise), reference, others, named)
    progress("compiling the closed loop; the next start uses the compiled file")
    values = {one.name: one.value for one in bench.sliders}
    bench.simulate(values)
    bench.judge(values)
    return bench
