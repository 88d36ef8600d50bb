"""Study 33: random worlds, or drawn vehicles, obstacles and dropouts, with the configuration for smooth surfaces.

    python analysis/33_echoes/drawn.py [--runs N] [--first N] [--echoes NAME] [--dropout P] [--scenario NAME] [--quick]

Without --scenario it simulates N random worlds, otherwise N Monte Carlo runs of this scenario. Each firing drops out
with the probability P. Prints Markdown, and the seeds of the runs that collide with what they violate. The exit status
is 1 if a run collides that violates no assumption besides `echoes`, and 2 for a bad option.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace

import numpy as np
from run import equipped

from surctl.control import load_gains
from surctl.reproduction.simulations import scenario_names
from surctl.sensing import FaultChances
from surctl.simulation import ECHOES, Case, load_scenario
from surctl.simulation.campaign import WORLDS_VEHICLE, MonteCarlo, RandomWorlds, run_campaign, world_template
from surctl.vehicle import load_vehicle

PITCH = -18.0  # [deg] the water surface stays silent
WEAK = "echoes"  # the assumption that every surface answers, which all models but `ideal` violate in every run


def plan_of(name: str | None, echoes: str, dropout: float, first: int) -> MonteCarlo | RandomWorlds:
    """Return the plan of the runs of a scenario, or of random worlds, with smooth surfaces, pitch and floor."""
    vehicle = load_vehicle(load_scenario(name).vehicle if name else WORLDS_VEHICLE)
    scenario = load_scenario(name) if name else world_template(vehicle)
    scenario = equipped(scenario, echoes, "smooth", PITCH, floor=True)
    scenario = replace(scenario, sensors=replace(scenario.sensors, chances=FaultChances(dropout=dropout)))
    case = Case(scenario, vehicle, load_gains("default"), sensing="sonar")
    return MonteCarlo(case, first) if name else RandomWorlds(case, first)


def main() -> int:
    """Simulate the runs and print the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=500, help="number of runs (default 500)")
    parser.add_argument("--first", type=int, default=0, help="first seed (default 0)")
    parser.add_argument("--echoes", choices=list(ECHOES), default="webots", help="echo model (default webots)")
    parser.add_argument("--dropout", type=float, default=0.0, help="probability that a firing drops out (default 0)")
    parser.add_argument("--scenario", choices=scenario_names(), help="Monte Carlo runs of it instead of worlds")
    parser.add_argument("--quick", action="store_true", help="two runs")
    options = parser.parse_args()
    runs = 2 if options.quick else options.runs
    plan = plan_of(options.scenario, options.echoes, options.dropout, options.first)
    table = run_campaign(plan, runs=runs, threads=1).table
    ended = {name: np.flatnonzero(table.column(name) > 0) for name in ("reached", "collided")}
    failed, lines = 0, []
    for k in ended["collided"].tolist():
        broken = [name for name in table.broken[k] if name != WEAK]
        failed += not broken
        least = 1000 * table.column("min_clearance_m")[k]
        lines.append(f"- seed {plan.first + k} collides by {-least:.1f} mm; violated: {', '.join(broken) or 'nothing'}")
    print("| runs | echoes | dropouts | number | arrived | collided | within the other assumptions |")
    print("|---|---|---|---|---|---|---|")
    arrived, hit = (len(rows) for rows in ended.values())
    print(f"| `{plan.name}` | {options.echoes} | {options.dropout:.0%} | {runs} | {arrived} | {hit} | {failed} |")
    print("", *lines, sep="\n")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
