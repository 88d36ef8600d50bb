"""`surctl simulate` of missions: single runs, --save, --explain; which runs fail the command."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from surctl.cli.options import FILE, options
from surctl.cli.output import prepare_out
from surctl.cli.simulate import Ran, check_save, conduct_runs
from surctl.errors import InputError
from surctl.marine.cli import lib
from surctl.marine.cli.robot_options import TRUST, RobotOptions, choose_gains, choose_law, choose_vehicle
from surctl.marine.cli.run_options import ControllerOptions, PlantOptions, check_animate
from surctl.marine.cli.runs import CampaignOptions, RunOutput, series_lines, simulate_again
from surctl.marine.cli.sensor_options import SensorOptions, sensor_data, split_faults


@click.command
@click.argument("words", nargs=-1, metavar="SCENARIO...")
@options(
    robot=RobotOptions,
    sensors=SensorOptions,
    link=ControllerOptions,
    physics=PlantOptions,
    campaign=CampaignOptions,
    show=RunOutput,
)
@click.option("--from", "replayed", type=FILE, help="Repeat a worst run that a campaign saved as FILE.")
@click.option("--trust", is_flag=True, help=TRUST)
def simulate(
    words: tuple[str, ...],
    robot: RobotOptions,
    sensors: SensorOptions,
    link: ControllerOptions,
    physics: PlantOptions,
    campaign: CampaignOptions,
    show: RunOutput,
    replayed: Path | None,
    trust: bool,
    as_json: bool,
) -> None:
    """Simulate scenarios, or a system of your own. Exit status: 1 if a run collides or does not arrive.
    Example: surctl simulate tank-static --runs 9
    """
    link.check(campaign=campaign.any or replayed is not None)
    out, runs, seed = show.out, campaign.runs, campaign.seed
    count = 1 if replayed is not None else runs * len(words)
    check_animate(show.animate, runs=count, campaign=campaign.any and replayed is None, film=physics.film)
    if replayed is not None:
        simulate_again(replayed, show, trust=trust, as_json=as_json)
    if trust:
        remedy = "drop it: a law that --law names runs without it"
        raise InputError("applies only to a saved run", key="--trust", remedy=remedy)
    sensed = robot.sensing or "truth"
    physics = replace(physics, threads=None) if campaign.any else physics
    engine = physics.check(campaign=campaign.any, runs=count, controller=link.controller, sensing=sensed)
    apart = replace(campaign, threads=None) if engine is not None else campaign
    apart.check(scenarios=words, explained=show.explained, out=out)
    _check_fallback(robot.fallback, mode=robot.priority_mode, explained=show.explained, campaign=campaign.any)
    _check_save(show, campaign=campaign.any)
    if out is not None:
        (lib.prepare_folder if campaign.any else prepare_out)(out)
    names = [lib.load_scenario(name).vehicle for name in words] if robot.vehicle is None else [robot.vehicle]
    law, above = choose_law(robot.law, [lib.load_vehicle(name) for name in names])
    own = lib.law_source(law).gains
    if robot.gains is not None:
        lib.load_gains(robot.gains, own=own)  # reports a mistake before anything is built
    alone = "simulate without --monte-carlo and --random-worlds" if campaign.any else None
    faults, broken = split_faults(sensors.faults, refused=alone)
    sensors = replace(sensors, faults=faults)
    sensors.check(sensing=sensed)
    if campaign.any:
        plans = campaign.plans(words, robot, sensors, law=law)
        campaign.run(plans, above, vehicle=robot.vehicle, out=out, as_json=as_json)
    missions = [sensors.over(lib.load_scenario(name)) for name in words]
    choices = [choose_vehicle(robot.vehicle, (scenario.name, scenario.vehicle)) for scenario in missions]
    vehicles = [lib.load_vehicle(choice.word) for choice in choices]
    physics.fit(engine, vehicles)
    speeds = [scenario.cruise for scenario in missions]
    tuned = [choose_gains(robot.gains, v, cruise=u, own=own) for v, u in zip(vehicles, speeds, strict=True)]
    cases = [robot.case(law, s, v, one.gains) for s, v, one in zip(missions, vehicles, tuned, strict=True)]
    # built after the other checks, because it takes a second
    laws, gone = [case.build(robot.fallback) for case in cases], list[str]()

    def simulated(case: lib.Case, built: lib.Law, common: dict[str, Any]) -> Iterator[Ran]:
        with link.opened(case, built) as linked:
            for run, report in physics.runs(
                engine, case, built, range(seed, seed + runs), fallback=robot.fallback, faults=tuple(broken),
                linked=linked, compiled=link.compiled,
            ):  # fmt: skip
                data = run.to_dict() | common
                yield show.ran(run, data, middle=physics.output(run, engine, data), link=report)
                if report is not None and report.gone_s is not None:
                    gone.append(f"  {report.line()}")
                    return

    def each_case() -> Iterator[tuple[list[str], Iterator[Ran]]]:
        for case, built, choice, one in zip(cases, laws, choices, tuned, strict=True):
            common: dict[str, Any] = {"vehicle_from": choice.origin, "derived_gains": one.data}
            common |= {"thruster_faults": [fault.to_dict() for fault in broken]} if broken else {}
            common |= {"sensors": sensor_data(case.scenario)} if sensed == "sonar" else {}
            yield [choice.line(case.vehicle.name), *one.lines], simulated(case, built, common)

    conduct_runs(
        each_case(), out=out, as_json=as_json, single=count == 1, above=above,
        series=lambda several: [*series_lines(several), *gone], short=runs > 1 and out is None and not show.explained,
        beside="" if show.save else " (plots only; --save csv adds the signals)",
    )  # fmt: skip


def _check_fallback(fallback: str, *, mode: str, explained: bool, campaign: bool) -> None:
    if fallback == "exact":
        return
    lib.check_fallback(fallback, mode=mode)
    if campaign:
        raise InputError("applies only to single runs", key="--fallback", value=fallback, remedy="drop --monte-carlo")
    if explained:
        raise InputError("cannot be explained", key="--fallback", value=fallback, remedy="drop --explain")


def _check_save(show: RunOutput, *, campaign: bool) -> None:
    save, frame = show.save, show.frame
    if frame is not None:
        lib.check_frame(frame, key="--frame")
        if save is None:
            raise InputError("needs --save", key="--frame", value=frame, remedy="add --save csv, mat, nc or mcap")
    if save is not None and campaign:
        raise InputError("cannot be combined with a campaign", key="--save", remedy="use the campaign's file runs.csv")
    check_save(save, lib.RUN_FORMATS, out=show.out)
    if save == "mcap" and frame == "ned":
        raise InputError("is not a frame of Foxglove", key="--frame", value=frame, remedy="use enu for mcap")
