"""Study 41: the library's law by sonar with other allowances in its map: touches, times, and the map beside the truth.

    python analysis/41_one_sonar_law/budget.py [--quick] [--allow NAME=VALUE ...] [--scenario NAME ...] [--echoes NAME]
        [--first N] [--seeds N] [--map]

Prints Markdown. The exit status is 2 for a bad option.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from dataclasses import replace

import numpy as np
import recorded
from numpy.typing import NDArray

from surctl.marine.control import load_gains, perception
from surctl.marine.reproduction.scenarios import scenario_names
from surctl.marine.simulation import ECHOES, Case, load_scenario, simulate_batch
from surctl.marine.vehicle import load_vehicle

ALLOWANCES = {
    "reading": "_READING",
    "cell": "_DIAGONAL",
    "around": "_AROUND_A_MARK",
    "cells": "CELLS_A_HULL",
    "position": "_MARGIN_SD",
}
HEAD = (
    "| scenario | echoes | arrived | collided | else | mean time [s] | median [s] | slowest [s] | least clearance [m] |"
    "\n|---|---|---|---|---|---|---|---|---|"
)
MAP = (
    "| scenario | echoes | directions | median [cm] | 99 % of sizes [cm] | least [cm] | most [cm] | above 3 cm [%] "
    "| lost | not measured |\n|---|---|---|---|---|---|---|---|---|---|"
)


def case_of(name: str, echoes: str) -> Case:
    """Return a scenario of the library by sonar."""
    scenario = load_scenario(name)
    scenario = replace(scenario, sensors=scenario.sensors.hearing(echoes))
    return Case(scenario, load_vehicle(scenario.vehicle), load_gains("default"), sensing="sonar")


def row(case: Case, echoes: str, seeds: NDArray[np.int_], *, quick: bool) -> None:
    """Print what became of the runs."""
    values = {"scenario.time_limit": 2.0} if quick else {}
    runs = simulate_batch(case, values, seeds=seeds, threads=2, engine="vm" if quick else "auto")
    reached, hit = runs.column("reached") > 0, int(runs.column("collided").sum())
    took, arrived = runs.column("time_s")[reached], int(reached.sum())
    told = f"{took.mean():.1f} | {np.median(took):.1f} | {took.max():.1f}" if arrived else "- | - | -"
    least = runs.column("min_clearance_m").min()
    counts = f"{arrived} | {hit} | {len(seeds) - arrived - hit}"
    print(f"| `{case.scenario.name}` | {echoes} | {counts} | {told} | {least:.3f} |", flush=True)


def main(words: list[str]) -> int:
    """Run the trial and print its table."""
    parser = argparse.ArgumentParser(prog="budget.py", description="Change the allowances of the law by sonar.")
    parser.add_argument("--quick", action="store_true", help="pool-static, ideal echoes, two seeds, 2 s each")
    parser.add_argument("--allow", nargs="+", default=[], metavar="NAME=VALUE", help=", ".join(ALLOWANCES))
    parser.add_argument("--scenario", nargs="+", choices=scenario_names(), help="only these scenarios")
    parser.add_argument("--echoes", choices=list(ECHOES), help="only this echo model")
    parser.add_argument("--first", type=int, default=0, help="first seed (default 0)")
    parser.add_argument("--seeds", type=int, default=200, help="seeds of each row (default 200)")
    parser.add_argument("--map", action="store_true", help="errors of the map instead of runs, as in tracker.py")
    options = parser.parse_args(words)
    for name, _, value in (one.partition("=") for one in options.allow):
        if name not in ALLOWANCES:
            parser.error(f"--allow {name}: must be one of {', '.join(ALLOWANCES)}")
        try:
            setattr(perception, ALLOWANCES[name], float(value))
        except ValueError:
            parser.error(f"--allow {name}: {value!r} is not a number")
    recorded.AROUND, recorded.CELLS = perception._AROUND_A_MARK, perception.CELLS_A_HULL  # type: ignore[assignment]
    count = 2 if options.quick else options.seeds
    seeds = np.arange(options.first, options.first + count)
    print(MAP if options.map else HEAD)
    # the cache knows the source code, but not the changed numbers
    with tempfile.TemporaryDirectory() as folder:
        os.environ["SURCTL_CACHE"] = folder
        for echoes in [options.echoes] if options.echoes else ["ideal"] if options.quick else list(ECHOES):
            for name in options.scenario or (["pool-static"] if options.quick else scenario_names()):
                if options.map:
                    limit = 2.0 if options.quick else None
                    runs = [recorded.record(name, echoes, int(seed), limit=limit) for seed in seeds]
                    print(f"| `{name}` | {echoes} | {recorded.cells([recorded.present(run) for run in runs])} |")
                else:
                    row(case_of(name, echoes), echoes, seeds, quick=options.quick)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
