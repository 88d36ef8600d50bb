"""Study 33: random worlds, or drawn vehicles, obstacles and dropouts.

    python analysis/33_echoes/drawn.py [--runs N] [--first N] [--echoes NAME] [--dropout P]
        [--scenario NAME [--reflectors N]] [--quick]

Without --scenario it simulates N random worlds, otherwise N Monte Carlo runs of this scenario. Each firing drops out
with the probability P. With --reflectors, each of N equal shares of the runs has other reflectors: each obstacle and
each wall answers at any angle, within 22.5 degrees of its normal or as a rough surface, drawn at random. Prints
Markdown, and the seeds of the runs that collide with what they violate. The exit status is 1 if a run collides that
violates no assumption besides `echoes`, and 2 for a bad option.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace

import numpy as np

from surctl.marine.control import load_gains
from surctl.marine.reproduction.scenarios import scenario_names
from surctl.marine.sensing import FaultChances
from surctl.marine.simulation import ECHOES, Case, Scenario, load_scenario
from surctl.marine.simulation.campaign.campaign import run_campaign
from surctl.marine.simulation.campaign.worlds import WORLDS_VEHICLE, MonteCarlo, RandomWorlds, world_template
from surctl.marine.vehicle import load_vehicle

KINDS = ("ideal", "webots", "diffuse")  # what the law assumes, or more
WEAK = "echoes"  # the assumption that every surface answers, which all models but `ideal` violate in every run


def plan_of(
    name: str | None, echoes: str, dropout: float, first: int, draw: int | None = None
) -> MonteCarlo | RandomWorlds:
    """Return the plan of the runs of a scenario, or of random worlds.

    The reflectors are those of the echo model, or the draw of this number.
    """
    vehicle = load_vehicle(load_scenario(name).vehicle if name else WORLDS_VEHICLE)
    scenario = load_scenario(name) if name else world_template(vehicle)
    sensors = replace(scenario.sensors.hearing(echoes), chances=FaultChances(dropout=dropout))
    scenario = replace(scenario, sensors=sensors)
    if draw is not None:
        scenario = with_reflectors(scenario, np.random.default_rng(draw))
    case = Case(scenario, vehicle, load_gains("default"), sensing="sonar")
    return MonteCarlo(case, first) if name else RandomWorlds(case, first)


def with_reflectors(scenario: Scenario, rng: np.random.Generator) -> Scenario:
    """Return the scenario with a drawn reflector for each obstacle and each wall."""
    obstacles = tuple(o.model_copy(update={"reflector": str(rng.choice(KINDS))}) for o in scenario.obstacles)
    walls = tuple(str(kind) for kind in rng.choice(KINDS, 4))
    return replace(scenario, obstacles=obstacles, reflectors=replace(scenario.reflectors, walls=walls))


def main() -> int:
    """Simulate the runs and print the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=500, help="number of runs (default 500)")
    parser.add_argument("--first", type=int, default=0, help="first seed (default 0)")
    parser.add_argument("--echoes", choices=list(ECHOES), default="webots", help="echo model (default webots)")
    parser.add_argument("--dropout", type=float, default=0.0, help="probability that a firing drops out (default 0)")
    parser.add_argument("--scenario", choices=scenario_names(), help="Monte Carlo runs of it instead of worlds")
    parser.add_argument("--reflectors", type=int, metavar="N", help="draws of reflectors (default: as --echoes)")
    parser.add_argument("--quick", action="store_true", help="two runs")
    options = parser.parse_args()
    draws = options.reflectors
    if draws is not None and (draws < 1 or options.scenario is None):
        parser.error("--reflectors needs --scenario and at least 1 draw")
    runs = 2 if options.quick else options.runs
    shares = [runs] if draws is None else [len(share) for share in np.array_split(np.arange(runs), draws) if len(share)]
    arrived, hit, failed, first, lines = 0, 0, 0, options.first, []
    for draw, share in enumerate(shares):
        plan = plan_of(options.scenario, options.echoes, options.dropout, first, None if draws is None else draw)
        table = run_campaign(plan, runs=share, threads=1).table
        arrived += int(np.sum(table.column("reached") > 0))
        for k in np.flatnonzero(table.column("collided") > 0).tolist():
            broken = [name for name in table.broken[k] if name != WEAK]
            hit, failed = hit + 1, failed + (not broken)
            least = 1000 * table.column("min_clearance_m")[k]
            which = "" if draws is None else f" of draw {draw}"
            what = ", ".join(broken) or "nothing"
            lines.append(f"- seed {first + k}{which} collides by {-least:.1f} mm; violated: {what}")
        first += share
    print("| runs | echoes | dropouts | number | arrived | collided | within the other assumptions |")
    print("|---|---|---|---|---|---|---|")
    echoes = options.echoes if draws is None else f"{len(shares)} draws"
    print(f"| `{plan.name}` | {echoes} | {options.dropout:.0%} | {runs} | {arrived} | {hit} | {failed} |")
    print("", *lines, sep="\n")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
