"""Study 22: every scenario with sonars, as it is and with random vehicles and lost echoes; and random worlds.

    python analysis/22_every_scenario/run.py [--quick] [--write]

Prints Markdown; --write writes the README from it. The exit status is 1 if a limit does not hold, and 2 for a bad
option.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from math import inf
from pathlib import Path

import numpy as np

from surctl.marine.control import load_gains
from surctl.marine.reproduction.scenarios import scenario_names
from surctl.marine.sensing import FaultChances
from surctl.marine.simulation import Case, Sensors, load_scenario, simulate_batch
from surctl.marine.simulation.campaign.campaign import Campaign, run_campaign
from surctl.marine.simulation.campaign.worlds import WORLDS_VEHICLE, MonteCarlo, Plan, RandomWorlds, world_template
from surctl.marine.vehicle import load_vehicle

SEEDS, RUNS, WORLDS = 200, 2000, 500
MOST_ERROR = {"tank": 0.04, "pool": 0.08}  # [m] rms of a series
MOST_LATE = 0.005  # share of a scenario's runs beyond the time limit
LEAST_REACHED = 0.95  # of the drawn worlds
LOST = FaultChances(dropout=0.05)


def case_of(name: str, sensors: Sensors) -> Case:
    """Return a scenario of the library with its own vehicle and with sonars."""
    scenario = replace(load_scenario(name), sensors=sensors)
    return Case(scenario, load_vehicle(scenario.vehicle), load_gains("default"), sensing="sonar")


def nominal(names: list[str], sensors: Sensors, seeds: int) -> tuple[list[str], dict[str, bool]]:
    """Return lines and limits of the unchanged scenarios."""
    lines = [
        "| scenario | reached | collided | else | mean time [s] | slowest [s] | paper [s] "
        "| path error, mean / max [m] | least clearance [m] |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    touched, late, squares = 0, 0.0, {"tank": list[float](), "pool": list[float]()}
    for name in names:
        case = case_of(name, sensors)
        runs = simulate_batch(case, seeds=np.arange(seeds), threads=2)
        reached, hit = (int(runs.column(which).sum()) for which in ("reached", "collided"))
        took, error = runs.column("time_s"), runs.column("path_error_m")
        error = error[np.isfinite(error)]  # a run that avoids obstacles to its end has no path error
        squares[name.split("-")[0]] += list(error**2)
        touched, late = touched + hit, max(late, (seeds - reached - hit) / seeds)
        paper = case.scenario.paper
        told = f"{paper.time_kind} {paper.time_s:g}" if paper is not None and paper.time_s is not None else ""
        lines.append(
            f"| `{name}` | {reached} | {hit} | {seeds - reached - hit} | {took.mean():.1f} | {took.max():.1f} | {told} "
            f"| {error.mean():.3f} / {error.max():.3f} | {runs.column('min_clearance_m').min():.3f} |"
        )
    series = {where: float(np.sqrt(np.mean(e))) for where, e in squares.items() if e}
    told = ", ".join(f"{where} {rms:.3f} m" for where, rms in series.items())
    lines += ["", f"Path error of all runs of a series, rms: {told}."]
    near = {
        f"as they are: path error of the {w} series at most {MOST_ERROR[w]} m": r <= MOST_ERROR[w]
        for w, r in series.items()
    }
    return lines, {
        **near,
        "as they are: no collision": touched == 0,
        f"as they are: at most {MOST_LATE:.1%} of a scenario's runs are late": late <= MOST_LATE,
    }


def flown(plan: Plan, runs: int) -> Campaign:
    """Run a campaign on two threads, and print its progress on stderr."""
    return run_campaign(plan, runs=runs, threads=2, progress=lambda line: print(line, file=sys.stderr))


def campaign_row(flight: Campaign) -> str:
    """Return its row of the table."""
    s = flight.summary
    stopped = s.stopped
    bound = (
        f"{s.inside.count} of {s.inside.runs}, ≤ {s.inside.at_most():.2%}" if s.inside is not None else "no such run"
    )
    broken = ", ".join(f"{name} {count}" for name, count in s.broken.items()) or "-"
    late = stopped["time limit"].count + stopped["standstill"].count + stopped["fault"].count
    cells = (
        f"`{flight.plan.name}`",
        stopped["reached"].count,
        stopped["collision"].count,
        bound,
        broken,
        stopped["dead end"].count,
        late,
        f"{s.clearance_m.get(0, inf):.3f}",
    )
    return f"| {' | '.join(map(str, cells))} |"


HEAD = [
    "| drawn | reached | collided | of those whose assumptions hold, with 95 % confidence | collisions: what is broken "
    "| dead ends | late | least clearance [m] |",
    "|---|---|---|---|---|---|---|---|",
]


def study(*, quick: bool) -> tuple[str, bool]:
    """Return the Markdown text, and whether every limit holds."""
    names = ["pool-behind"] if quick else scenario_names()
    seeds, runs, worlds = (4, 20, 0) if quick else (SEEDS, RUNS, WORLDS)
    lost = Sensors(chances=LOST)
    lines, bars = nominal(names, lost if quick else Sensors(), seeds)  # the quick form compiles one loop
    out = [f"## As they are: seeds 0-{seeds - 1} of each", "", *lines]
    drawn = [flown(MonteCarlo(case_of(name, lost), 0), runs) for name in names]
    bars["drawn vehicles: no collision of a run whose assumptions hold"] = not any(
        c.summary.broken.get("none", 0) for c in drawn
    )
    out += ["", f"## Drawn vehicles and obstacles, {LOST.dropout:.0%} of the firings lost: {runs} runs of each", ""]
    out += [*HEAD, *map(campaign_row, drawn)]
    if worlds:
        vehicle = load_vehicle(WORLDS_VEHICLE)
        template = Case(world_template(vehicle), vehicle, load_gains("default"), sensing="sonar")
        found = flown(RandomWorlds(template, 0, False), worlds)
        stopped = found.summary.stopped
        bars["drawn worlds: no collision"] = stopped["collision"].count == 0
        bars[f"drawn worlds: at least {LEAST_REACHED:.0%} reached"] = stopped["reached"].count >= LEAST_REACHED * worlds
        out += ["", f"## {worlds} drawn worlds", "", *HEAD, campaign_row(found)]
    out += ["", "## Bars", ""]
    out += [f"- {what}: {'holds' if holds else '**does not hold**'}" for what, holds in bars.items()]
    return "\n".join(out), all(bars.values())


def main() -> int:
    """Run the study and print the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--quick", action="store_true", help="one scenario, few runs, all with lost echoes; no drawn worlds"
    )
    parser.add_argument("--write", action="store_true", help="write README.md beside this file")
    options = parser.parse_args()
    text, held = study(quick=options.quick)
    print(text)
    if options.write:
        folder = Path(__file__).parent
        folder.joinpath("README.md").write_text(f"{folder.joinpath('about.md').read_text()}\n{text}\n")
    return 0 if held else 1


if __name__ == "__main__":
    sys.exit(main())
