"""`surctl simulate` of missions: single runs, --save, --explain; which runs fail the command."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from surctl.cli.output import Count, collected, finish, progress, saving, stoppable
from surctl.cli.simulate import check_save, where
from surctl.errors import InputError
from surctl.marine.cli.robot_options import (
    GAINS_HELP,
    RobotOptions,
    barrier_options,
    choose_gains,
    choose_law,
    choose_vehicle,
    law_option,
    priority_options,
    trust_option,
)
from surctl.marine.cli.run_options import (
    ControllerOptions,
    PlantOptions,
    animate_option,
    check_animate,
    controller_options,
    plant_options,
)
from surctl.marine.cli.runs import (
    CampaignOptions,
    activity_line,
    campaign_options,
    further_output,
    loop_lines_of_run,
    run_line,
    series_lines,
    simulate_again,
)
from surctl.marine.cli.sensor_options import SensorOptions, sensor_data, sensor_options, simulated_echoes, split_faults

if TYPE_CHECKING:
    from surctl.marine.simulation import Sensing


@click.command
@click.argument("words", nargs=-1, metavar="SCENARIO...")
@click.option("--vehicle", metavar="FILE", help="Vehicle: name or file (default: that of the scenario).")
@click.option("--gains", metavar="FILE", help=GAINS_HELP)
@law_option
@click.option(
    "--avoidance",
    default="corrected",
    metavar="NAME",
    help="Eq. (20): corrected (default), printed, consistent (signs).",
)
@click.option(
    "--guidance", default="los", metavar="NAME", help="Path guidance: los (default); for currents ilos or alos."
)
@priority_options
@click.option("--sensing", default="truth", metavar="NAME", help="Obstacles: true positions (truth, default) or sonar.")
@barrier_options
@sensor_options
@simulated_echoes
@controller_options
@plant_options
@click.option("--seed", type=Count(0), default=0, help="Seed of the first run (default 0).")
@click.option("--runs", type=Count(1), default=1, help="Runs per scenario, each with its seed (default 1).")
@click.option("--explain", "explained", is_flag=True, help="Print when which limits override which tasks of the law.")
@animate_option
@click.option("--frame", metavar="NAME", help="Axes in the files of --save: enu (default) or ned.")
@campaign_options
@trust_option
@collected(
    robot=RobotOptions, sensors=SensorOptions, link=ControllerOptions, physics=PlantOptions, campaign=CampaignOptions
)
def simulate(
    words: tuple[str, ...],
    robot: RobotOptions,
    sensors: SensorOptions,
    link: ControllerOptions,
    physics: PlantOptions,
    campaign: CampaignOptions,
    seed: int,
    runs: int,
    explained: bool,
    animate: Path | None,
    save: str | None,
    frame: str | None,
    replayed: Path | None,
    trust: bool,
    out: Path | None,
    as_json: bool,
) -> None:
    """Simulate scenarios, or a system of your own. Exit status: 1 if a run collides or does not arrive.
    Example: surctl simulate tank-static --runs 9
    """
    scenarios = words
    link.check(campaign=campaign.any or replayed is not None)
    run_count = 1 if replayed is not None else runs * len(scenarios)
    check_animate(animate, runs=run_count, campaign=campaign.any and replayed is None, film=physics.film)
    if replayed is not None:
        simulate_again(replayed, trust=trust, explained=explained, out=out, animate=animate, as_json=as_json)
    if trust:
        remedy = "drop it: a law that --law names runs without it"
        raise InputError("applies only to a saved run", key="--trust", remedy=remedy)
    physics = replace(physics, threads=None) if campaign.any else physics
    engine = physics.check(
        campaign=campaign.any, runs=run_count, controller=link.controller, sensing=robot.sensing or "truth"
    )
    apart = replace(campaign, threads=None) if engine is not None else campaign
    apart.check(scenarios=scenarios, runs=runs, explained=explained, out=out)
    _check_fallback(robot.fallback, mode=robot.priority_mode, explained=explained, campaign=campaign.any)
    from surctl.files import prepare_folder
    from surctl.marine.control import law_source, load_gains
    from surctl.marine.simulation import Case, law_numbers, load_scenario, save_record
    from surctl.marine.simulation.explanation import stop_reason
    from surctl.marine.vehicle import load_vehicle

    _check_save(save, frame, out=out, campaign=campaign.any)
    if out is not None:
        prepare_folder(out)
    names = [load_scenario(name).vehicle for name in scenarios] if robot.vehicle is None else [robot.vehicle]
    law, lines = choose_law(robot.law, [load_vehicle(name) for name in names])
    own = law_source(law).gains
    if robot.gains is not None:
        load_gains(robot.gains, own=own)  # reports a mistake before anything is built
    alone = "simulate without --monte-carlo and --random-worlds" if campaign.any else None
    faults, broken = split_faults(sensors.faults, refused=alone)
    sensors = replace(sensors, faults=faults)
    sensors.check(sensing=robot.sensing or "truth")
    if campaign.any:
        plans = campaign.plans(scenarios, robot, sensors, law=law, seed=seed)
        campaign.run(plans, lines, vehicle=robot.vehicle, runs=campaign.worlds or runs, out=out, as_json=as_json)
    missions = [sensors.over(load_scenario(name)) for name in scenarios]
    choices = [choose_vehicle(robot.vehicle, (scenario.name, scenario.vehicle)) for scenario in missions]
    vehicles = [load_vehicle(choice.word) for choice in choices]
    physics.fit(engine, vehicles)
    # built after the other checks, because it takes a second
    laws = [robot.build(law, scenario, vehicle) for scenario, vehicle in zip(missions, vehicles, strict=True)]
    results: list[dict[str, Any]] = []
    brief: list[str] = []
    one = runs * len(missions) == 1
    message = "the run was not finished" if one else "--seed N starts at another seed"
    above = "" if one else "the runs above are finished" + (f", files in {out}" if out else "")
    with stoppable(message, lines, above=above, as_json=as_json):
        for scenario, choice, simulated, built in zip(missions, choices, vehicles, laws, strict=True):
            tuned = choose_gains(robot.gains, simulated, cruise=scenario.cruise, own=own)
            gains_used = tuned.gains
            lines += [choice.line(simulated.name), *tuned.lines]
            p = law_numbers(scenario, gains_used, simulated)
            positions: Sensing = "sonar" if robot.sensing == "sonar" else "truth"
            case = Case(scenario, simulated, gains_used, law, mode=built.mode, sensing=positions, **robot.forms)
            start, first, said = len(lines), len(results), len(brief)
            with link.opened(built, p, scenario, simulated) as line:
                stepper = partial(link.linked, built, p, line, scenario, simulated)
                seeds = range(seed, seed + runs)
                for run, report in physics.runs(
                    engine, case, built, seeds, fallback=robot.fallback, faults=tuple(broken), linked=stepper,
                    compiled=link.compiled,
                ):  # fmt: skip
                    results.append(run.to_dict() | {"vehicle_from": choice.origin, "derived_gains": tuned.data})
                    if broken:
                        results[-1]["thruster_faults"] = [fault.to_dict() for fault in broken]
                    if robot.sensing == "sonar":
                        results[-1]["sensors"] = sensor_data(scenario)
                    lines += [run_line(run), activity_line(run)]
                    if as_json:
                        progress(lines[-2])
                    lines += physics.output(run, engine, results[-1])
                    weak = loop_lines_of_run(run, results[-1])
                    lines += weak
                    brief += [run_line(run), *(f"warning: {line.strip(' :')}" for line in weak[:1])]
                    if why := stop_reason(run):
                        results[-1]["stop_reason"] = why
                        brief.append(f"{run.metrics.stopped_because}: {why}")
                        lines.append(f"  {brief[-1]}")
                    if save is not None and out is not None:
                        with saving("record"):
                            results[-1]["file"] = str(save_record(run, out, kind=save, frame=frame or "enu"))
                            lines.append(f"  {results[-1]['file']}")
                    lines += further_output(run, results[-1], explained=explained, out=out, animate=animate)
                    if report is not None:
                        results[-1]["link"] = report.to_dict()
                        brief.append(report.line())
                        lines.append(f"  {brief[-1]}")
                        if report.gone_s is not None:
                            break
                    elif runs > 1 and out is None and not explained:
                        lines[start:] = series_lines(results[first:])
            if len(results) - first > 1:
                brief[said:] = [line.strip() for line in series_lines(results[first:])]
    good = all(r["reached"] and r["min_clearance_m"] > 0 for r in results)  # as `failure` says of one run
    good = good and not any("link" in r and r["link"]["differing"] for r in results)
    finish({"runs": results}, lines, as_json=as_json, passed=good, brief=brief, files=where(out))


def _check_fallback(fallback: str, *, mode: str, explained: bool, campaign: bool) -> None:
    if fallback == "exact":
        return
    from surctl.priority import check_fallback

    check_fallback(fallback, mode=mode)
    if campaign:
        raise InputError("applies only to single runs", key="--fallback", value=fallback, remedy="drop --monte-carlo")
    if explained:
        raise InputError("cannot be explained", key="--fallback", value=fallback, remedy="drop --explain")


def _check_save(save: str | None, frame: str | None, *, out: Path | None, campaign: bool) -> None:
    from surctl.marine.simulation import RUN_FORMATS
    from surctl.marine.vehicle.motion_log import check_frame

    if frame is not None:
        check_frame(frame, key="--frame")
        if save is None:
            raise InputError("needs --save", key="--frame", value=frame, remedy="add --save csv, mat, nc or mcap")
    if save is not None and campaign:
        raise InputError("cannot be combined with a campaign", key="--save", remedy="use the campaign's file runs.csv")
    check_save(save, RUN_FORMATS, out=out)
    if save == "mcap" and frame == "ned":
        raise InputError("is not a frame of Foxglove", key="--frame", value=frame, remedy="use enu for mcap")
