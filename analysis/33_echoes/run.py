"""Study 33: every scenario with the four echo models; and the echo model against brute-force rays.

    python analysis/33_echoes/run.py [--quick] [--write] [--seeds N] [--first N] [--echoes NAME] [--level]
        [--search-limit SECONDS] [--law NAME]

Prints Markdown; --write writes the README from it. The exit status is 1 if a limit does not hold, and 2 for a bad
option.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rays import agreement, corner_table

from surctl.marine.control import load_gains
from surctl.marine.reproduction.scenarios import scenario_names
from surctl.marine.simulation import ECHOES, STOPS, Case, load_scenario, simulate_batch
from surctl.marine.vehicle import load_vehicle

SEEDS = 200
STOPPED = [STOPS.index(reason) for reason in ("dead end", "standstill")]
HEAD = [
    "| scenario | echoes | arrived | collided | stopped | late | time of those that arrived, mean / median / slowest "
    "[s] | least clearance [m] | thrust varies, surge / sway [N/s] |",
    "|---|---|---|---|---|---|---|---|---|",
]


def case_of(name: str, echoes: str, *, level: bool = False, search: float | None = None, law: str = "guarded") -> Case:
    """Return a scenario of the library with its own vehicle, sonars and an echo model.

    With `level`, the sonars look horizontally and the law knows no floor.
    """
    scenario = load_scenario(name)
    sensors = scenario.sensors.hearing(echoes)
    equipment = replace(sensors.equipment, search_limit=search)
    if level:
        equipment = replace(equipment, array=replace(equipment.array, pitch=0.0), floor=None)
    scenario = replace(scenario, sensors=replace(sensors, equipment=equipment))
    return Case(scenario, load_vehicle(scenario.vehicle), load_gains("default"), law=law, sensing="sonar")


def row(case: Case, echoes: str, first: int, seeds: int, *, quick: bool) -> tuple[str, list[int]]:
    """Return a row of the table, and how many runs arrived, collided, stopped and were late.

    In the `quick` form the runs end after a few seconds, and no loop is compiled.
    """
    values, engine = ({"scenario.time_limit": 2.0}, "vm") if quick else ({}, "auto")
    name = case.scenario.name
    runs = simulate_batch(case, values, seeds=np.arange(first, first + seeds), threads=2, engine=engine)  # type: ignore[arg-type]
    reached = runs.column("reached") > 0
    arrived, hit = int(reached.sum()), int(runs.column("collided").sum())
    stopped = int(np.isin(runs.column("stopped"), STOPPED).sum())
    counts = [arrived, hit, stopped, seeds - arrived - hit - stopped]
    times = runs.column("time_s")[reached]
    took = f"{times.mean():.1f} / {np.median(times):.1f} / {times.max():.1f}" if arrived else "-"
    least = runs.column("min_clearance_m").min()
    varies = " / ".join(f"{runs.column(f'variation_{axis}_n_per_s').mean():.1f}" for axis in ("surge", "sway"))
    print(name, echoes, counts, took, file=sys.stderr, flush=True)
    return f"| `{name}` | {echoes} | {' | '.join(map(str, counts))} | {took} | {least:.3f} | {varies} |", counts


def study(options: argparse.Namespace) -> tuple[str, bool]:
    """Return the Markdown text, and whether every limit holds."""
    quick, only, first = options.quick, options.echoes, options.first
    seeds = options.seeds or (2 if quick else SEEDS)
    names = ["pool-behind"] if quick else scenario_names()
    models = [only] if only else ["specular"] if quick else list(ECHOES)
    law = f"Law `{options.law}`"
    law += ", level sonars, no floor known" if options.level else ""
    law += f", search limit {options.search_limit:g} s" if options.search_limit else ""
    out = [f"## {law}: seeds {first}-{first + seeds - 1} of each", "", *HEAD]
    totals: dict[str, NDArray[np.int64]] = {}
    for echoes in models:
        for name in names:
            case = case_of(name, echoes, level=options.level, search=options.search_limit, law=options.law)
            line, counts = row(case, echoes, first, seeds, quick=quick)
            out.append(line)
            totals[echoes] = totals.get(echoes, np.zeros(4, dtype=int)) + counts
    out += [
        "",
        "Sums of all scenarios:",
        "",
        "| echoes | arrived | collided | stopped | late |",
        "|---|---|---|---|---|",
    ]
    out += [f"| {echoes} | {' | '.join(map(str, counts))} |" for echoes, counts in totals.items()]
    lines, bars = agreement(quick=quick)
    corner, close = corner_table(quick=quick)
    bars |= close
    title = "## A silent corner ahead: distance [m] from the hull at which it is first heard"
    out += ["", "## The echo model against rays", "", *lines, "", title, "", *corner, "", "## Bars", ""]
    out += [f"- {what}: {'holds' if holds else '**does not hold**'}" for what, holds in bars.items()]
    return "\n".join(out), all(bars.values())


def main() -> int:
    """Run the study and print the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one scenario and echo model, few runs and rays")
    parser.add_argument("--write", action="store_true", help="write README.md beside this file")
    parser.add_argument("--seeds", type=int, help=f"seeds of each scenario (default {SEEDS})")
    parser.add_argument("--echoes", choices=list(ECHOES), help="only this echo model")
    parser.add_argument("--first", type=int, default=0, help="first seed (default 0)")
    parser.add_argument("--level", action="store_true", help="level sonars, and no floor that the law knows")
    parser.add_argument("--search-limit", type=float, help="search limit of the law [s] (default none)")
    parser.add_argument("--law", choices=["guarded", "calm"], default="guarded", help="law (default guarded)")
    options = parser.parse_args()
    text, held = study(options)
    print(text)
    if options.write:
        folder = Path(__file__).parent
        folder.joinpath("README.md").write_text(f"{folder.joinpath('about.md').read_text()}\n{text}\n")
    return 0 if held else 1


if __name__ == "__main__":
    sys.exit(main())
