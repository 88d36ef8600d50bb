"""`surctl simulate`: single runs of scenarios or of a system, --save, --explain; which runs fail the command."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from surctl.cli.output import Count, as_json, collected, finish, out_folder, progress, saving, stoppable
from surctl.cli.robot_options import (
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
from surctl.cli.run_options import (
    ControllerOptions,
    PlantOptions,
    animate_option,
    check_animate,
    controller_options,
    plant_options,
)
from surctl.cli.runs import (
    CampaignOptions,
    activity_line,
    campaign_options,
    further_output,
    loop_lines_of_run,
    run_line,
    series_lines,
    simulate_again,
    where,
)
from surctl.cli.sensor_options import SensorOptions, sensor_data, sensor_options, simulated_echoes, split_faults
from surctl.cli.subject import (
    OwnSystem,
    assigned,
    command_line,
    cost_data,
    cost_lines,
    end_text,
    is_system,
    load_system,
    seconds_option,
)
from surctl.errors import InputError, check_known

if TYPE_CHECKING:
    from surctl.marine.simulation import Sensing
    from surctl.system import Record


@click.command
@click.argument("scenarios", nargs=-1, metavar="SCENARIO... | FILE.py:FUNCTION NAME=VALUE...")
@seconds_option
@click.option("--vehicle", metavar="FILE", help="Vehicle: name or file (default: the scenario's).")
@click.option("--gains", metavar="FILE", help=GAINS_HELP)
@law_option
@click.option(
    "--avoidance", default="corrected", metavar="NAME", help="Avoidance law: corrected (default), consistent, printed."
)
@click.option("--guidance", default="los", metavar="NAME", help="Path guidance: los (default), ilos or alos.")
@priority_options
@click.option("--sensing", default="truth", metavar="NAME", help="Obstacle positions from truth (default) or sonar.")
@barrier_options
@sensor_options
@simulated_echoes
@controller_options
@plant_options
@click.option("--seed", type=Count(0), default=0, help="First seed (default 0).")
@click.option("--runs", type=Count(1), default=1, help="Runs per scenario, one seed each (default 1).")
@click.option("--explain", "explained", is_flag=True, help="Print which limits override which tasks.")
@animate_option
@click.option("--save", metavar="FORMAT", help="Save each run in DIR as csv, mat, nc or mcap.")
@click.option("--frame", metavar="NAME", help="Frame of --save: enu (default) or ned.")
@campaign_options
@trust_option
@out_folder
@as_json
@collected(
    robot=RobotOptions, sensors=SensorOptions, link=ControllerOptions, physics=PlantOptions, campaign=CampaignOptions
)
def simulate(
    scenarios: tuple[str, ...],
    seconds: float | None,
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
    """Simulate scenarios, or a system of your own (surctl new system). Interrupted campaigns resume in --out DIR.
    Exit status: 1 if a run collides or does not arrive.
    Example: surctl simulate tank-static --runs 9 --monte-carlo
    """
    if is_system(scenarios, "seconds", "gains", "out", "save", "as_json"):
        _check_save(save, None, out=out, campaign=False, own=True)
        simulate_own_system(scenarios, seconds=seconds, out=out, save=save or "csv", as_json=as_json)
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
    from surctl.marine.simulation.explanation import stop_reason, time_limit_reason
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
    sensors.check(law=law, sensing=robot.sensing or "truth")
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
                    if run.metrics.stopped_because in ("standstill", "dead end", "fault"):
                        results[-1]["stop_reason"] = stop_reason(run)
                        brief.append(f"{run.metrics.stopped_because}: {results[-1]['stop_reason']}")
                        lines.append(f"  {brief[-1]}")
                    if run.metrics.stopped_because == "time limit" and (why := time_limit_reason(run)):
                        results[-1]["stop_reason"] = why
                        brief.append(f"time limit: {why}")
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


def _check_save(
    save: str | None, frame: str | None, *, out: Path | None, campaign: bool, own: bool = False
) -> None:  # fmt: skip
    if save is None and frame is None:
        return
    from surctl.marine.simulation import RUN_FORMATS
    from surctl.marine.vehicle.motion_log import check_frame
    from surctl.recorded_write import RECORD_FORMATS

    if frame is not None:
        check_frame(frame, key="--frame")
    if save is None:
        raise InputError("needs --save", key="--frame", value=frame, remedy="add --save csv, mat, nc or mcap")

    check_known(save, RECORD_FORMATS if own else RUN_FORMATS, key="--save")
    if save == "mcap" and frame == "ned":
        raise InputError("is not a frame of Foxglove", key="--frame", value=frame, remedy="use enu for mcap")
    if campaign:
        raise InputError("cannot be combined with a campaign", key="--save", remedy="use the campaign's file runs.csv")
    if out is None:
        raise InputError("needs an output folder", key="--save", remedy="add --out DIR")


def simulate_own_system(
    words: Sequence[str], *, seconds: float | None, out: Path | None, save: str, as_json: bool
) -> None:
    """Simulate one run, print how it ended and its costs, and write signals (as csv, mat or nc) and plot to `out`."""
    from surctl.assessment import ClosedLoop, assess
    from surctl.files import prepare_folder
    from surctl.system import LOST, run_system

    own = load_system(words)
    duration, values = own.seconds(seconds), assigned(own.settings)
    if out is not None:
        prepare_folder(out)
    record = run_system(own.system, duration, values)
    assessment = assess(ClosedLoop(own.system, values, record=record), parts=["run"])
    judged = [f"{line.mark} {line.text}".strip() for line in assessment.lines if line.about]
    lines = [end_text(own, record), *cost_lines(own.system, record.figures), *judged]
    files = [] if out is None else _write(own, record, out, save)
    lines += [f"  {file}" for file in files]
    data = {
        **own.names,
        "values": {name: value.ravel().tolist() for name, value in values.items()},
        "stopped": record.stopped,
        "not_finite": record.lost or None,
        "duration_s": record.duration,
        "costs": cost_data(own.system, record.figures),
        "assessment": assessment.to_dict(),
        "files": [str(file) for file in files],
    }
    fine = record.stopped != LOST
    then = [command_line("verify", own, *own.settings), _sweep(own, duration)] if fine else []
    good = [line for line in judged if line.startswith("ok ")]
    brief = [lines[0], *(line for line in judged if line not in good)]
    brief += [" ".join(line.split()) for line in cost_lines(own.system, record.figures)] + good
    steps = [command for command in then if command]
    finish(data, lines, as_json=as_json, passed=assessment.accepted(), then=steps, brief=brief, files=where(out))


def _write(own: OwnSystem, record: Record, out: Path, kind: str) -> list[Path]:
    from surctl.files import file_name
    from surctl.system import save_record

    name = file_name(f"{own.system.plant.name}-{own.system.controller.name}")
    origin = own.origin | {"values": json.dumps({n: v.tolist() for n, v in assigned(own.settings).items()})}
    files = list[Path]()
    with saving("record"):
        files.append(save_record(record, out / f"{name}.{kind}", about=origin))
    with saving("plot"):
        from surctl.report.theme import save_figure

        files.insert(0, save_figure(record.plot(), out, (name,)))
    return files


def _sweep(own: OwnSystem, seconds: float) -> str:
    """Return the command that sweeps the first gain about its nominal value; "" if no gain can be swept."""
    swept = [port for port in own.system.controller.gains if port.size == 1 and port.default > 0]
    if not swept or not own.system.costs:
        return ""
    axis = f"{swept[0].name}={swept[0].default / 2:.4g}..{swept[0].default * 2:.4g}:9"
    return command_line("sweep", own, axis, "--seconds", f"{seconds:g}", "--out", "sweep")
