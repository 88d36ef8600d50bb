"""Output about runs: how they ended, metrics, weak loops; campaigns (--monte-carlo) and repeated runs (--from)."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from surctl.cli.options import FILE, Count, changed, option, typed
from surctl.cli.output import finish, finite, prepare_out, progress, same_command, saving, stoppable
from surctl.cli.simulate import Ran, conduct_runs
from surctl.errors import InputError
from surctl.marine.cli import lib
from surctl.marine.cli.robot_options import RobotOptions, choose_gains, choose_vehicle

if TYPE_CHECKING:
    from surctl.marine.cli.sensor_options import SensorOptions

_ROUNDING = 1e-9  # [N/s], [N m/s] variation of a thrust below which it is that of rounding
_CRABBING = 15.0  # [deg] mean crab angle from which the line of a run says that the hull crabs


def run_line(run: lib.Run) -> str:
    """Return one line with the scenario, the vehicle, how the run ended, and its main metrics."""
    m = run.metrics
    missed = (
        f", a corner missed by {m.missed_corner_m:.3f} m" if m.missed_corner_m > run.scenario.arrival_radius else ""
    )
    crab = f", but crabbing {m.crab_angle_deg:.0f} deg" if m.crab_angle_deg > _CRABBING else ""
    error = "no path error, because the whole run counts as avoidance"
    if m.path_error_m >= 0:
        error = f"rms path error {m.path_error_m:.3f} m outside avoidance"
    return (
        f"{run.scenario.name} by {run.vehicle.name}, {run.sensing}, seed {run.seed}: {m.stopped_because} at "
        f"{m.time_s:.2f} s{crab}, least clearance {m.min_clearance_m:.3f} m, {error}{missed}"
    )


def activity_line(run: lib.Run) -> str:
    """Return one line with crab angle, heading error, thrust activity and wasted thrust of a run."""
    m = run.metrics
    angles = f"crab angle {m.crab_angle_deg:.0f} deg (largest {m.max_crab_angle_deg:.0f}), " * (m.crab_angle_deg >= 0)
    angles += f"heading error {m.heading_error_deg:.0f} deg; " * (m.heading_error_deg >= 0)
    axes = (m.variation_surge_n_per_s, m.variation_sway_n_per_s, m.variation_heave_n_per_s, m.variation_yaw_n_m_per_s)
    varies = ", ".join(f"{one if abs(one) > _ROUNDING else 0:.2g}" for one in axes)
    return (
        f"  {angles}thrust varies by {varies} (N/s in surge, sway, heave, N m/s in yaw); most sign changes of an axis: "
        f"{m.axis_sign_changes_per_s:.2g}/s; longest time of an axis at its limit: {m.axis_saturated_share:.0%} of the "
        f"run; wasted thrust (beyond the drag along the path): {m.wasted_impulse_n_s:.0f} N s ({m.wasted_share:.0%} of "
        "the horizontal thrust)"
    )


def series_lines(runs: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return at most five lines about runs of one scenario that differ in the seed.

    The lines name two runs that collide or do not arrive, and what all runs share: echoes that hide obstacles, or else
    a low margin of the linear loop.
    """
    times = [run["time_s"] for run in runs if run["reached"]]
    worst = min(runs, key=lambda run: run["min_clearance_m"])
    collided = sum(run["min_clearance_m"] <= 0 for run in runs)
    arrivals = f"arrival after {min(times):.2f} to {max(times):.2f} s, " if times else ""
    lines = [
        f"{worst['scenario']} by {worst['vehicle']}, {worst['sensing']}: {len(times)} of {len(runs)} runs arrive, "
        f"{collided} collide",
        f"  {arrivals}least clearance {worst['min_clearance_m']:.3f} m (seed {worst['seed']}); --seed N prints one run",
    ]
    failing = [run for run in runs if not (run["reached"] and run["min_clearance_m"] > 0)]
    lines += [
        f"  seed {run['seed']}: {run['stopped_because']} at {run['time_s']:.2f} s, least clearance "
        f"{run['min_clearance_m']:.3f} m"
        for run in failing[:2]
    ]
    linear = worst["linear"] or {}
    if texts := [*worst.get("start_warnings", ()), *worst.get("echo_warnings", ())]:
        lines.append(f"  {texts[0]}")
    elif not linear.get("stable", True):
        lines.append(f"  the linear loop at {linear['cruise_m_per_s']:g} m/s is unstable")
    elif linear.get("short"):
        lines.append(f"  the linear loop has {linear['short']}")
    return lines


def loop_lines_of_run(run: lib.Run, result: dict[str, Any]) -> list[str]:
    """Add to `result` whether the linear loop at cruise speed is stable; return lines to print if its margin is low."""
    crab = run.metrics.crab_angle_deg
    result["linear"], lines = linear_warning(
        run.vehicle, run.gains, run.law, cruise=run.scenario.fastest,
        crab=f", mean crab angle {crab:.0f} deg" if crab >= 0 else "",
    )  # fmt: skip
    return lines


def linear_warning(
    vehicle: lib.Vehicle,
    gains: lib.Gains,
    law: lib.Law,
    *,
    cruise: float,
    model: lib.Vehicle | None = None,
    crab: str = "",
) -> tuple[dict[str, Any] | None, list[str]]:
    """Return the stability and the margins of the linear loop of a run as data, and lines about a defect.

    There are lines if the loop is unstable, or if a margin at the worst corner is below the least one. The data is
    None if the law has no linear loop about a cruise, or if the thrust cannot hold the speed (which lint reports).
    `crab` is appended to the first line.
    """
    steered = lib.law_source(law.ref).steering is not None
    if not (steered or lib.has_cruise_loop(law.ref, law.guidance)):
        return None, []
    try:
        least = lib.law_corners(law, vehicle, gains, cruise=cruise, model=model, proved=steered)
    except InputError:
        return None, []
    stable = least.nominal.stable
    data: dict[str, Any] = {"cruise_m_per_s": cruise, "stable": stable, "disk_margin": least.disk}
    data |= {"corner": least.corner, "delay_margin_s": least.delay.delay_s, "short": least.short}
    if least.enough:
        return data, []
    about: dict[str, Any] = {"cruise": cruise, "dt": law.dt, "model": model, "law": law.ref}
    mode = None if steered else lib.slowest_mode(vehicle, gains.values, **about)
    data["mode"] = None if mode is None else mode.to_dict()
    if stable:
        word = f"has {least.short}" if least.disk > 0 else f"is unstable at {least.corner}"
        return data, [f"  the linear loop at {cruise:g} m/s {word}{crab}"]
    lines = [] if mode is None else [f"    {line.strip()}" for line in mode.lines()]
    return data, [f"  the linear loop at {cruise:g} m/s is unstable{crab}{':' if lines else ''}", *lines]


@dataclass(frozen=True, eq=False, repr=False)
class RunOutput:
    """What is printed and written of each run.

    Attributes:
        out: folder of files, or None.
        save: format of `--save`, or None.
    """

    out: Path | None = None
    save: str | None = None
    explained: bool = option("--explain", "Print which limits override tasks of the law, and when.", False)
    animate: Path | None = option("--animate", "Write an animation of the run: FILE.gif or FILE.mp4.", type=FILE)
    frame: str | None = option("--frame", "Axes in the files of --save: enu (default) or ned.", metavar="NAME")

    def ran(
        self, run: lib.Run, data: dict[str, Any], *, head: str = "", passed: bool = True, middle: Sequence[str] = (),
        link: Any = None,
    ) -> Ran:  # fmt: skip
        """Return what a run shows, and write its files.

        Args:
            run: the run.
            data: its plain data, to which further ones are added.
            head: the first line, if it is not `run_line`.
            passed: whether the run is as expected apart from its end.
            middle: lines about its physics.
            link: report of what computed its control steps in place of the law, or None.
        """
        first = head or run_line(run)
        weak = loop_lines_of_run(run, data)
        echoes = lib.level_findings(run.scenario, run.vehicle) if run.sensing == "sonar" else []
        data["echo_warnings"] = [one.text for one in echoes]
        data["start_warnings"] = [
            f"{one.text}; this is no collision, because walls stop a run only after the hull was clear of them"
            for one in lib.start_findings(run.scenario, run.vehicle)
            if one.clearance_m is not None and one.clearance_m < 0
        ]
        warnings = [*data["start_warnings"], *data["echo_warnings"]]
        brief = [first, *(f"warning: {text.strip(' :')}" for text in (*warnings, *weak[:1]))]
        lines = [first, activity_line(run), *middle, *(f"  {text}" for text in warnings), *weak]
        if reason := lib.stop_reason(run):
            data["stop_reason"] = reason
            brief.append(f"{run.metrics.stopped_because}: {reason}")
            lines.append(f"  {brief[-1]}")
        if self.save is not None and self.out is not None:
            with saving("record"):
                data["file"] = str(lib.save_record(run, self.out, kind=self.save, frame=self.frame or "enu"))
                lines.append(f"  {data['file']}")
        lines += self.further(run, data)
        if link is not None:
            data["link"] = link.to_dict()
            brief.append(link.line())
            lines.append(f"  {brief[-1]}")
            passed = passed and not data["link"]["differing"]
        return Ran(data, lines, brief, passed and lib.failure(run) is None)

    def further(self, run: lib.Run, data: dict[str, Any]) -> list[str]:
        """Return lines about depth changes, thrusters, explanations, plots and animation, and write the last two."""
        lines = [f"  {change}" for change in lib.depth_changes(run)]
        if (use := lib.thruster_use(run)) is not None:
            data["thrusters"] = use.to_dict()
            lines.append(f"  {use.line()}")
        if self.explained:
            explanations = lib.explain(run)
            data["explanations"] = [asdict(one) for one in explanations]
            lines += [f"  {one.time_s:6.2f} s  {one.text}" for one in explanations]
        if self.out is not None:
            with saving("plots"):
                lines.append(f"  {lib.save_run(run, self.out)}")
                if self.explained:
                    priorities = lib.plot_priority(lib.priority_timeline(run), title=lib.describe(run))
                    lines.append(f"  {lib.save_figure(priorities, self.out, (*lib.run_labels(run), 'priority'))}")
        if self.animate is not None:
            with saving("animation"):
                data["animation"] = str(lib.save_animation(run, self.animate))
                lines.append(f"  {data['animation']}")
        return lines


MOST_ROWS = 100  # largest number of runs printed as JSON; the files in the output folder hold all runs


@dataclass(frozen=True, eq=False, repr=False)
class CampaignOptions:
    """The options about seeds and campaigns; an option that is not given has the value None."""

    seed: int = option("--seed", "Seed of the first run (default 0).", 0, type=Count(0))
    runs: int = option("--runs", "Runs per scenario, one for each seed (default 1).", 1, type=Count(1))
    monte_carlo: bool = option("--monte-carlo", "Campaign: vary vehicle and obstacles of each run at random.", False)
    worlds: int | None = option("--random-worlds", "Campaign: simulate N random missions.", type=Count(1, 1_000_000))
    worst: int | None = option("--worst", "Save the N worst campaign runs (default 5).", type=Count(0, 1000))
    threads: int | None = option("--threads", "Parallel runs (default 2; MuJoCo 1).", type=Count(1, 1024))
    fresh: bool = option("--fresh", "Do not resume the campaign in --out; start it again.", False)

    @property
    def any(self) -> bool:
        """Return whether the options request a campaign of random runs."""
        return self.monte_carlo or self.worlds is not None

    def check(self, *, scenarios: tuple[str, ...], explained: bool, out: Path | None) -> None:
        """Raise InputError for options that exclude each other, or that require another option that is not given."""
        if not self.any:
            for key, value in changed(replace(self, seed=0, runs=1)).items():
                remedy = "add --monte-carlo or --random-worlds N, or drop this option"
                raise InputError("applies only to a campaign", key=key, value=value, remedy=remedy)
        elif explained:
            remedy = "simulate one run of DIR/worst: --from FILE --explain"
            raise InputError("applies only to single runs", key="--explain", remedy=remedy)
        elif out is None and (self.fresh or self.worst is not None):
            key = "--fresh" if self.fresh else "--worst"
            raise InputError("needs an output folder", key=key, remedy="add --out DIR")
        if self.worlds is not None and scenarios:
            remedy = "drop the scenario or this option"
            raise InputError("draws its own scenarios", key="--random-worlds", value=scenarios[0], remedy=remedy)
        if self.worlds is not None and self.runs != 1:
            raise InputError(
                "already sets the number of runs", key="--random-worlds", value=self.worlds, remedy="drop --runs"
            )
        if self.worlds is None and not scenarios:
            raise InputError("needs a scenario", key="SCENARIOS", remedy="choose one of: surctl list")
        if len(set(scenarios)) < len(scenarios) and self.any:
            raise InputError("is named twice", key="SCENARIOS", value=" ".join(scenarios), remedy="name each once")

    def plans(
        self, scenarios: tuple[str, ...], robot: RobotOptions, sensors: SensorOptions, *, law: str
    ) -> list[lib.CampaignPlan]:
        """Return the plans of the requested campaigns.

        Raises:
            InputError: a name is unknown, or the law or a scenario does not support an option.
        """
        vehicles = [] if robot.vehicle is None else [lib.load_vehicle(robot.vehicle)]
        if self.worlds is None:
            missions = [sensors.over(lib.load_scenario(name)) for name in scenarios]
        else:
            vehicles = vehicles or [lib.load_vehicle(lib.WORLDS_VEHICLE)]
            missions = [sensors.over(lib.world_template(vehicles[0]))]
        own, cases, lines = lib.law_source(law).gains, list[lib.Case](), list[str]()
        for mission in missions:
            craft = vehicles[0] if vehicles else lib.load_vehicle(mission.vehicle)
            tuned = choose_gains(robot.gains, craft, cruise=mission.cruise, own=own)
            lines += tuned.lines
            cases.append(robot.case(law, mission, craft, tuned.gains))
        for line in dict.fromkeys(lines):
            progress(line)
        plans: list[lib.CampaignPlan] = [lib.MonteCarlo(case, self.seed) for case in cases]
        if self.worlds is not None:
            plans = [lib.RandomWorlds(case, self.seed, self.monte_carlo) for case in cases]
        for plan in plans[:1]:
            lib.law_of(plan)  # reports a mistake before any file is written
        return plans

    def run(
        self,
        plans: list[lib.CampaignPlan],
        first: Sequence[str] = (),
        *,
        vehicle: str | None,
        out: Path | None,
        as_json: bool,
    ) -> None:
        """Simulate the campaigns, store them in `out`, print the lines `first` and the results, and end the command.

        `vehicle` is the value of the option `--vehicle`, or None.
        """
        names, runs = [plan.name for plan in plans], self.worlds or self.runs
        if len(set(names)) < len(names):
            raise InputError(
                "two scenarios have the same name", key="SCENARIOS", value=" ".join(names), remedy="rename one"
            )
        folder = None if out is None else lib.CampaignFolder(out, tuple(plans))
        if folder is not None:
            folder.prepare(fresh=self.fresh)
        reports, lines, brief, good = [], list(first), list[str](), True
        nothing = "the runs are not saved; with --out DIR the same command would continue"
        message = nothing if out is None else f"the finished runs are in {out}; to continue: {same_command()}"
        for plan in plans:
            with (
                stoppable(message, lines, as_json=as_json),
                nullcontext() if folder is None else folder.store(plan) as store,
            ):
                campaign = lib.run_campaign(plan, runs=runs, threads=self.threads or 2, store=store, progress=progress)
            worst = 5 if self.worst is None else self.worst
            files = list[Path]()
            if folder is not None:
                with saving(f"table of {plan.name}"):
                    files = folder.write(campaign, worst=worst)
            reports.append(_report(campaign, files, worst))
            own = None if self.worlds is not None else (plan.case.scenario.name, plan.case.scenario.vehicle)
            choice = choose_vehicle(vehicle, own)
            reports[-1]["vehicle_from"] = choice.origin
            case = plan.case  # with the unchanged scenario and vehicle
            reports[-1]["linear"], warning = linear_warning(
                case.vehicle, case.gains, lib.law_of(plan), cruise=case.scenario.cruise, model=case.model
            )
            lines += [choice.line(plan.case.vehicle.name), *_lines(campaign, files, worst), *warning]
            counts = campaign.summary.stopped
            ends = [f"{one.count} {name}" for name, one in counts.items() if one.count]
            collided = f"collisions with 95 % confidence at most {counts['collision'].at_most():.3%}"
            brief.append(f"{_head(campaign)} {', '.join(ends)}; {collided}")
            brief += [f"warning: {line.strip(' :')}" for line in warning[:1]]
            good = good and campaign.summary.stopped["reached"].count == runs
        if out is not None:
            with saving("summary"):
                lib.write_file(out / "summary.json", json.dumps(finite({"campaigns": reports}), indent=1) + "\n")
        finish({"campaigns": reports}, lines, as_json=as_json, passed=good, brief=brief,
               files=[] if out is None else [f"files {out}"])  # fmt: skip


def _report(campaign: lib.Campaign, files: list[Path], worst: int) -> dict[str, Any]:
    case, table = campaign.plan.case, campaign.table
    rows = [table.row(k) for k in table.worst(worst)]
    for row, file in zip(rows, files, strict=False):
        row["file"] = f"worst/{file.name}"
    head = {
        "campaign": campaign.plan.name,
        "scenario": case.scenario.name,
        "vehicle": case.vehicle.name,
        "law": lib.label(case.law),
        **case.options,
        "gains": case.gains.name,
        "sampling": dict(campaign.plan.settings()),
        "number_of_runs": len(table),
    }
    if lib.BARRIER in lib.law_source(case.law).parts:
        head["claim"] = _claim(case).to_dict()
    few = {"runs": [table.row(k) for k in range(len(table))]} if len(table) <= MOST_ROWS else {}
    return {**head, **campaign.summary.to_dict(), "worst": rows, **few}


def _claim(case: lib.Case) -> lib.SafetyClaim | lib.Inapplicable:
    # for the unchanged scenario and the vehicle's parameter ranges

    kind: dict[str, Any] = {"sonar": case.sensing == "sonar", "barrier": case.barrier, "movers": case.movers}
    return lib.judged_contact(case.scenario, case.model or case.vehicle, case.gains, **kind)


def _head(campaign: lib.Campaign) -> str:
    case = campaign.plan.case
    about = f"law {lib.label(case.law)}, {case.sensing}, {len(campaign.table)} runs:"
    return f"{campaign.plan.name} by {case.vehicle.name}, {about}"


def _lines(campaign: lib.Campaign, files: list[Path], worst: int) -> list[str]:
    case, table = campaign.plan.case, campaign.table
    lines = [_head(campaign)]
    claim = lib.BARRIER in lib.law_source(case.law).parts
    lines += campaign.summary.lines(claim=claim)
    if claim and campaign.summary.violated:
        stated = _claim(case)
        text = stated.sentence if isinstance(stated, lib.Inapplicable) else stated.statement
        lines.append(f"  the no-contact claim: {text}")
    for place, k in enumerate(table.worst(worst)):
        time, clear = table.column("time_s")[k], table.column("min_clearance_m")[k]
        broken = f", violated: {', '.join(table.broken[k])}" if table.broken[k] else ""
        saved = f"  {files[place]}" if place < len(files) else ""
        lines.append(
            f"  worst {place + 1}: seed {table.seeds[k]}, {table.stopped(k)} at {time:.2f} s, "
            f"clearance {clear:.4f} m{broken}{saved}"
        )
    return lines


def simulate_again(path: Path, show: RunOutput, *, trust: bool, as_json: bool) -> None:
    """Simulate a saved run as a single run, compare the result with the campaign, and end the command.

    The exit status is 1 if the result differs from the campaign or if the run does not arrive.
    """
    for one in typed("replayed", "trust", "explained", "out", "animate"):
        what = one.opts[0] if isinstance(one, click.Option) else "the scenarios"
        remedy = f"drop {what}, or edit the file"
        raise InputError(f"already sets {what}", key="--from", value=str(path), remedy=remedy)
    if show.out is not None:
        prepare_out(show.out)
    replay = lib.load_replay(path, trust=trust)

    def again() -> Iterator[Ran]:
        run = replay.run.simulate()
        difference = replay.difference(run)
        same = difference <= SAME
        verdict = "as in the campaign" if same else f"NOT as in the campaign ({replay.stopped_because})"
        head = f"{run_line(run)}: {verdict}, largest difference {difference:.1g}"
        data = run.to_dict() | {"campaign": replay.campaign, "same": same, "largest_difference": difference}
        yield show.ran(run, data, head=head, passed=same)

    conduct_runs([((), again())], out=show.out, as_json=as_json, series=series_lines)


SAME = 1e-9
"""The largest difference allowed between the compiled loop and a single run; see `Replay.difference`."""
