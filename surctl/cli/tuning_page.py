"""`surctl tune --page`: the web page with sliders."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import click

from surctl.cli.activity import progress, waiting

if TYPE_CHECKING:
    from surctl.report.design_bench import DesignBench

__all__ = ["serve_page", "serve_system_page"]

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
    from surctl.marine.tuning import goals_at, load_goals
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
    from surctl.cli.system_option import assigned, listed_values, load_system
    from surctl.cli.system_region import region_words
    from surctl.cli.system_tune import gain_ranges_of
    from surctl.errors import InputError
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
