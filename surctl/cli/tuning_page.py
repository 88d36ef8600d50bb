"""`surctl tune --page`: the web page with sliders."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

import click

from surctl.cli.output import progress

__all__ = ["serve_page"]


def serve_page(
    study: str | None,
    goals: str | None,
    vehicles: Sequence[str],
    *,
    scenario: str | None,
    gains: str | None,
    cruise: Sequence[float] | None,
    port: int | None,
    browser: bool,
) -> None:
    """Serve the tuning page until Ctrl-C; arguments that are None take the study's values."""
    from importlib.util import find_spec

    from surctl.control import load_gains
    from surctl.errors import ToolMissing
    from surctl.report.bench import Bench
    from surctl.report.serve import serve
    from surctl.simulation import findings, load_scenario
    from surctl.study import load_plan
    from surctl.tuning import goals_at, load_goals
    from surctl.vehicle import load_vehicle
    from surctl.verification import check_held

    if find_spec("marimo") is None:  # checked before the compilation
        remedy = 'pip install "surctl[notebooks]"'
        raise ToolMissing("the tuning page needs marimo, which is not installed", remedy=remedy)
    if len(vehicles) > 1:
        raise click.BadParameter("the page simulates one vehicle only", param_hint="--vehicle")
    plan = load_plan(study)
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
    bench = Bench(vehicle, mission, start, chosen, tuple(cruise or plan.cruise))
    progress("compiling the closed loop; the next start uses the compiled file")
    bench.simulate(start)
    bench.judge(start)

    def ready(address: str) -> None:
        click.echo(f"{address}  (Ctrl-C stops the page)")
        if browser:
            click.launch(address)

    try:
        serve(bench, port=port, ready=ready)
    except KeyboardInterrupt:
        click.echo("surctl: stopped; saved files stay", err=True)
        sys.stdout.flush()
        os._exit(130)  # a normal exit would wait for the threads of an open page; all files are complete
