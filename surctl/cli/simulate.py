"""`surctl simulate`: simulate scenarios in closed loop."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from surctl.cli.output import as_json, finish, out_folder, progress, saving, stoppable
from surctl.cli.robot_options import (
    GAINS_HELP,
    barrier_options,
    choose_gains,
    choose_law,
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

if TYPE_CHECKING:
    from surctl.system import Record

__all__ = ["simulate", "simulate_own_system"]


@click.command
@click.argument("scenarios", nargs=-1, metavar="SCENARIO... | FILE.py:FUNCTION NAME=VALUE...")
@seconds_option
@click.option("--vehicle", metavar="FILE", help="Vehicle: name or file (default: the scenario's).")
@click.option("--gains", metavar="FILE", help=GAINS_HELP)
@law_option
@click.option(
    "--avoidance",
    default="corrected",
    metavar="NAME",
    help="Eq. (20): corrected (default), consistent or printed.",
)
@click.option("--guidance", default="los", metavar="NAME", help="Path guidance: los (default), ilos or alos.")
@priority_options
@click.option("--sensing", default="truth", metavar="NAME", help="Obstacle positions from truth (default) or sonar.")
@barrier_options
@sensor_options
@simulated_echoes
@controller_options
@plant_options
@click.option("--seed", type=click.IntRange(min=0), default=0, metavar="N", help="First seed (default 0).")
@click.option(
    "--runs", type=click.IntRange(min=1), default=1, metavar="N", help="Runs per scenario, one seed each (default 1)."
)
@click.option("--explain", "explained", is_flag=True, help="Print which limits override which tasks.")
@animate_option
@click.option("--save", metavar="FORMAT", help="Save each run in DIR as csv, mat, nc or mcap.")
@click.option("--frame", metavar="NAME", help="Frame of --save: enu (default) or ned.")
@campaign_options
@trust_option
@out_folder
@as_json
def simulate(
    scenarios: tuple[str, ...],
    seconds: float | None,
    vehicle: str | None,
    gains: str | None,
    law: str | None,
    avoidance: str,
    guidance: str,
    priority_mode: str,
    fallback: str,
    barrier: str,
    movers: str,
    sensing: str,
    faults: tuple[str, ...],
    chances: tuple[str, ...],
    beam: float | None,
    own_state: str | None,
    echoes: str | None,
    controller: str | None,
    link_loss: float | None,
    link_delay: float | None,
    link_deadline: float | None,
    link_compact: bool,
    link_timeout: float | None,
    plant: str,
    film: Path | None,
    view: bool,
    seed: int,
    runs: int,
    explained: bool,
    animate: Path | None,
    save: str | None,
    frame: str | None,
    monte_carlo: bool,
    worlds: int | None,
    worst: int | None,
    threads: int | None,
    fresh: bool,
    replayed: Path | None,
    trust: bool,
    out: Path | None,
    as_json: bool,
) -> None:
    """Simulate scenarios, or a system of your own (surctl new system NAME).

    Exit status: 1 if a run collides or does not arrive; campaigns resume in DIR.
    Example: surctl simulate tank-static --runs 9 --monte-carlo
    """
    if is_system(scenarios, "seconds", "out", "save", "as_json"):
        _check_save(save, None, out=out, campaign=False)
        simulate_own_system(scenarios, seconds=seconds, out=out, save=save or "csv", as_json=as_json)
    campaign = CampaignOptions(monte_carlo, worlds, worst, threads, fresh)
    link = ControllerOptions(controller, link_loss, link_delay, link_deadline, link_timeout, link_compact)
    link.check(campaign=campaign.any or replayed is not None)
    run_count = 1 if replayed is not None else runs * len(scenarios)
    check_animate(animate, runs=run_count, campaign=campaign.any and replayed is None, film=film)
    if replayed is not None:
        simulate_again(replayed, trust=trust, explained=explained, out=out, animate=animate, as_json=as_json)
    if trust:
        from surctl.errors import InputError

        remedy = "drop it: a law that --law names runs without it"
        raise InputError("applies only to a saved run", key="--trust", remedy=remedy)
    chosen = PlantOptions(plant, film, view, None if campaign.any else threads)
    physics = chosen.check(campaign=campaign.any, runs=run_count, controller=controller, sensing=sensing)
    apart = replace(campaign, threads=None) if physics is not None else campaign
    apart.check(scenarios=scenarios, runs=runs, explained=explained, out=out)
    _check_fallback(fallback, mode=priority_mode, explained=explained, campaign=campaign.any)
    from surctl.cli.robot_options import choose_vehicle
    from surctl.files import prepare_folder
    from surctl.marine.control import build_law, law_source, load_gains
    from surctl.marine.simulation import Case, law_numbers, load_scenario, save_record, stop_reason, time_limit_reason
    from surctl.marine.vehicle import load_vehicle

    _check_save(save, frame, out=out, campaign=campaign.any)
    if out is not None:
        prepare_folder(out)
    names = [load_scenario(name).vehicle for name in scenarios] if vehicle is None else [vehicle]
    law, lines = choose_law(law, [load_vehicle(name) for name in names])
    own = law_source(law).gains
    if gains is not None:
        load_gains(gains, own=own)  # reports a mistake before anything is built
    alone = "simulate without --monte-carlo and --random-worlds" if campaign.any else None
    faults, broken = split_faults(faults, refused=alone)
    sensors = SensorOptions(faults, chances, beam, own_state, echoes)
    sensors.check(law=law, sensing=sensing)
    if campaign.any:
        campaign_plans = campaign.plans(
            scenarios,
            vehicle,
            gains,
            sensors,
            law=law,
            avoidance=avoidance,
            guidance=guidance,
            mode=priority_mode,
            barrier=barrier,
            movers=movers,
            sensing=sensing,
            seed=seed,
        )
        campaign.run(campaign_plans, lines, vehicle=vehicle, runs=worlds or runs, out=out, as_json=as_json)
    plans = [sensors.over(load_scenario(name)) for name in scenarios]
    choices = [choose_vehicle(vehicle, (scenario.name, scenario.vehicle)) for scenario in plans]
    vehicles = [load_vehicle(choice.word) for choice in choices]
    chosen.fit(physics, vehicles)
    laws = [  # built after the other checks, because it takes a second
        build_law(
            law,
            avoidance=avoidance,
            mode=priority_mode,
            sonar=sensing == "sonar",
            equipment=scenario.sensors.on(robot["radius"]),
            guidance=guidance,
            barrier=barrier,
            movers=movers,
            fallback=fallback,
            depths=scenario.depths is not None,
            actuators=robot.actuators,
        )
        for scenario, robot in zip(plans, vehicles, strict=True)
    ]
    results: list[dict[str, Any]] = []
    message = "the runs above are finished" + (f", files in {out}" if out else "") + "; --seed N starts at another seed"
    with stoppable(message if runs * len(plans) > 1 else "the run was not finished", lines, as_json=as_json):
        for scenario, choice, simulated, built in zip(plans, choices, vehicles, laws, strict=True):
            tuned = choose_gains(gains, simulated, cruise=scenario.cruise, own=own)
            gains_used = tuned.gains
            lines += [choice.line(simulated.name), *tuned.lines]
            p = law_numbers(scenario, gains_used, simulated)
            case = Case(
                scenario,
                simulated,
                gains_used,
                law,
                mode=built.mode,
                sensing="sonar" if sensing == "sonar" else "truth",
                avoidance=built.avoidance,
                guidance=built.guidance,
                barrier=built.barrier,
                movers=built.movers,
            )
            start, first = len(lines), len(results)
            with link.opened(built, p, scenario, simulated) as line:
                stepper = partial(link.linked, built, p, line, scenario, simulated)
                seeds = range(seed, seed + runs)
                for run, report in chosen.runs(
                    physics, case, built, seeds, fallback=fallback, faults=tuple(broken), linked=stepper,
                    compiled=link.compiled,
                ):  # fmt: skip
                    results.append(run.to_dict() | {"vehicle_from": choice.origin, "derived_gains": tuned.data})
                    if broken:
                        results[-1]["thruster_faults"] = [fault.to_dict() for fault in broken]
                    if sensing == "sonar":
                        results[-1]["sensors"] = sensor_data(scenario)
                    lines += [run_line(run), activity_line(run)]
                    if as_json:
                        progress(lines[-2])
                    lines += chosen.output(run, physics, results[-1])
                    lines += loop_lines_of_run(run, results[-1])
                    if run.metrics.stopped_because in ("standstill", "dead end", "fault"):
                        results[-1]["stop_reason"] = stop_reason(run)
                        lines.append(f"  {run.metrics.stopped_because}: {results[-1]['stop_reason']}")
                    if run.metrics.stopped_because == "time limit" and (why := time_limit_reason(run)):
                        results[-1]["stop_reason"] = why
                        lines.append(f"  time limit: {why}")
                    if save is not None and out is not None:
                        with saving("record"):
                            results[-1]["file"] = str(save_record(run, out, kind=save, frame=frame or "enu"))
                            lines.append(f"  {results[-1]['file']}")
                    lines += further_output(run, results[-1], explained=explained, out=out, animate=animate)
                    if report is not None:
                        results[-1]["link"] = report.to_dict()
                        lines.append(f"  {report.line()}")
                        if report.gone_s is not None:
                            break
                    elif runs > 1 and out is None and not explained:
                        lines[start:] = series_lines(results[first:])
    good = all(r["reached"] and r["min_clearance_m"] > 0 for r in results)  # as `failure` says of one run
    good = good and not any("link" in r and r["link"]["differing"] for r in results)
    finish({"runs": results}, lines, as_json=as_json, passed=good)


def _check_fallback(fallback: str, *, mode: str, explained: bool, campaign: bool) -> None:
    if fallback == "exact":
        return
    from surctl.errors import InputError
    from surctl.priority import check_fallback

    check_fallback(fallback, mode=mode)
    if campaign:
        raise InputError("applies only to single runs", key="--fallback", value=fallback, remedy="drop --monte-carlo")
    if explained:
        raise InputError("cannot be explained", key="--fallback", value=fallback, remedy="drop --explain")


def _check_save(save: str | None, frame: str | None, *, out: Path | None, campaign: bool) -> None:
    if save is None and frame is None:
        return
    from surctl.errors import InputError, nearest
    from surctl.marine.simulation import RUN_FORMATS
    from surctl.marine.vehicle import check_frame

    if frame is not None:
        check_frame(frame, key="--frame")
    if save is None:
        raise InputError("needs --save", key="--frame", value=frame, remedy="add --save csv, mat, nc or mcap")

    if save not in RUN_FORMATS:
        raise InputError("is not known", key="--save", value=save, remedy=nearest(save, RUN_FORMATS))
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
    from surctl.files import prepare_folder
    from surctl.system import LOST, run_system

    own = load_system(words)
    duration, values = own.seconds(seconds), assigned(own.settings)
    if out is not None:
        prepare_folder(out)
    record = run_system(own.system, duration, values)
    lines = [end_text(own, record), *cost_lines(own.system, record.figures)]
    files = [] if out is None else _write(own, record, out, save)
    lines += [f"  {file}" for file in files]
    data = {
        **own.names,
        "values": {name: value.ravel().tolist() for name, value in values.items()},
        "stopped": record.stopped,
        "not_finite": record.lost or None,
        "duration_s": record.duration,
        "costs": cost_data(own.system, record.figures),
        "files": [str(file) for file in files],
    }
    fine = record.stopped != LOST
    then = [command_line("verify", own, *own.settings), _sweep(own, duration)] if fine else []
    finish(data, lines, as_json=as_json, passed=fine, then=[command for command in then if command])


def _write(own: OwnSystem, record: Record, out: Path, kind: str) -> list[Path]:
    from surctl.files import file_name
    from surctl.system import save_record

    name = file_name(f"{own.system.plant.name}-{own.system.controller.name}")
    origin = own.origin | {"values": json.dumps({n: v.tolist() for n, v in assigned(own.settings).items()})}
    files = list[Path]()
    with saving("record"):
        files.append(save_record(record, out / f"{name}.{kind}", about=origin))
    with saving("plot"):
        from surctl.report.system_plots import save_record_plot

        files.insert(0, save_record_plot(record, out, name=name))
    return files


def _sweep(own: OwnSystem, seconds: float) -> str:
    """Return the command that sweeps the first gain about its nominal value; "" if no gain can be swept."""
    swept = [port for port in own.system.controller.gains if port.size == 1 and port.default > 0]
    if not swept or not own.system.costs:
        return ""
    axis = f"{swept[0].name}={swept[0].default / 2:.4g}..{swept[0].default * 2:.4g}:9"
    return command_line("sweep", own, axis, "--seconds", f"{seconds:g}", "--out", "sweep")
