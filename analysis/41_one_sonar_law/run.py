"""Study 41: which error of perceived obstacles costs which time, for law `guarded` and for a fan of courses.

    python analysis/41_one_sonar_law/run.py [--quick] [--seeds N] [--law NAME] [--scenario NAME]

Prints Markdown. The exit status is 1 if a run without an injected error collides, and 2 for a bad option.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from surctl.marine.control import load_gains
from surctl.marine.simulation import STOPS, Case, load_scenario, simulate_batch
from surctl.marine.vehicle import load_vehicle

FOLDER = Path(__file__).parent
NAMES = ("guarded", "fan", "to_go")
SCENARIOS = ("pool-static", "tank-static", "tank-slalom")
BUDGETS = (0.0, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06)  # m
LAGS = (1.0, 2.0, 3.0)  # s
HEAD = (
    "| law | budget [m] | error [m] | lag [s] | arrived | collided | else | mean time [s] | median [s] | slowest [s] "
    "| least clearance [m] |\n|---|---|---|---|---|---|---|---|---|---|---|"
)


def rows(case: Case, law: str, errors: list[tuple[float, float, float]], seeds: int, *, quick: bool) -> int:
    """Print a row for each budget, error and lag, over the same seeds; return the collisions without an error."""
    table = np.repeat(np.array(errors), seeds, axis=0)
    values = {} if law == "to_go" else {name: table[:, k] for k, name in enumerate(("budget", "wander", "lag"))}
    if quick:
        values["scenario.time_limit"] = np.full(len(table), 2.0)
    runs = simulate_batch(case, values, seeds=np.tile(np.arange(seeds), len(errors)), engine="vm" if quick else "auto")
    stopped, times = runs.column("stopped").astype(int), runs.column("time_s")
    least, hit = runs.column("min_clearance_m"), 0
    for k, error in enumerate(errors):
        part = slice(k * seeds, (k + 1) * seeds)
        counts = {reason: int(np.sum(stopped[part] == n)) for n, reason in enumerate(STOPS)}
        arrived, collided = counts["reached"], counts["collision"]
        took = times[part][stopped[part] == STOPS.index("reached")]
        told = f"{took.mean():.1f} | {np.median(took):.1f} | {took.max():.1f}" if arrived else "- | - | -"
        print(
            f"| {law} | {' | '.join(f'{one:g}' for one in error)} | {arrived} | {collided} "
            f"| {seeds - arrived - collided} | {told} | {least[part].min():.3f} |",
            flush=True,
        )
        hit += 0 if error[1] or error[2] else collided
    return hit


def case_of(name: str, law: str) -> Case:
    """Return a scenario with exact positions and a law of this study."""
    scenario = load_scenario(name)
    file = f"to_go.py:{name.replace('-', '_')}" if law == "to_go" else f"laws.py:{law}"
    return Case(scenario, load_vehicle(scenario.vehicle), load_gains("default"), law=f"{FOLDER / file}")


def main(words: list[str]) -> int:
    """Run the study and print its tables."""
    parser = argparse.ArgumentParser(prog="run.py", description="Inject errors into exact positions of obstacles.")
    parser.add_argument("--quick", action="store_true", help="pool-static, a row or two, two seeds, 2 s each")
    parser.add_argument("--seeds", type=int, default=20, help="seeds of each row (default 20)")
    parser.add_argument("--law", choices=NAMES, help="only this law")
    parser.add_argument("--scenario", choices=SCENARIOS, help="only this scenario")
    options = parser.parse_args(words)
    if options.seeds < 1:
        parser.error("--seeds: must be at least 1")
    seeds, hit = (2 if options.quick else options.seeds), 0
    pool = [(budget, 0.0, 0.0) for budget in BUDGETS]
    pool += [(budget, budget, 0.0) for budget in BUDGETS[1:]]
    pool += [(0.03, error, lag) for error in (0.0, 0.03) for lag in LAGS]
    for name in [options.scenario] if options.scenario else SCENARIOS[:1] if options.quick else SCENARIOS:
        print(f"## `{name}`, exact positions, seeds 0-{seeds - 1}\n\n{HEAD}")
        for law in [options.law] if options.law else NAMES[1:] if options.quick else NAMES:
            wanted = pool if name == "pool-static" and law != "to_go" else pool[:1]
            hit += rows(case_of(name, law), law, wanted[:: 18 if options.quick else 1], seeds, quick=options.quick)
        print()
    return min(hit, 1)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
