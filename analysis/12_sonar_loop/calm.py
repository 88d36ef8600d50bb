"""Study 12: law `calm` beside law `guarded`: every scenario, dead ends, and a plant that is not the law's model.

    python analysis/12_sonar_loop/calm.py [--quick]

Prints Markdown. The exit status is 0 if no run collides, and 1 otherwise.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from surctl.marine.control import load_gains
from surctl.marine.simulation import STOPS, Case, Obstacle, Scenario, load_scenario, simulate_batch
from surctl.marine.vehicle import load_vehicle

LAWS = ("guarded", "calm")
NAMES = (
    "tank-static", "tank-slalom", "tank-moving", "tank-speed-010", "tank-speed-015", "tank-speed-020",
    "tank-speed-025", "pool-static", "pool-ahead", "pool-behind", "pool-speed-010", "pool-speed-015",
    "pool-speed-020", "pool-speed-025",
)  # fmt: skip
HEAD = (
    "reached | collided | else | mean time [s] | slowest [s] | path error [m] | least clearance [m] "
    "| thrust varies [N/s] | sign changes [1/s] | at its limit | energy [N^1.5 s] |"
)
LINE = "|---" * 13 + "|"
FIRST, DEAD_END_LIMIT = 1000, 480.0  # first seed; s


def box(x: float, y: float, length: float, width: float) -> Obstacle:
    """Return a box with its centre and sides [m]."""
    return Obstacle(name=f"box at {x:g} {y:g}", shape="box", centre_m=(x, y), size_m=(length, width))


DEAD_ENDS = {
    "a U across the tank": ("tank-static", (box(5, 2.5, 0.3, 5), box(3.9, 0.9, 1.8, 0.3), box(3.9, 4.1, 1.8, 0.3))),
    "a gap narrower than the hull": ("tank-static", (box(5, 1.125, 0.3, 2.25), box(5, 3.875, 0.3, 2.25))),
    "a box as wide as the pool": ("pool-static", (box(1.6, 1, 0.3, 2),)),
}
PLANTS = {
    "thrust lag 0.6 s instead of 0.3 s": {"plant.thrust_lag": 0.6},
    "masses 0.7 times": {"plant.m11": 66.5, "plant.m22": 66.5, "plant.m33": 66.5},
    "masses 1.4 times": {"plant.m11": 133.0, "plant.m22": 133.0, "plant.m33": 133.0},
}


def row(label: str, law: str, scenario: Scenario, seeds: int, values: Mapping[str, float] | None = None) -> int:
    """Print the results of a law in a scenario; return the number of collisions."""
    case = Case(scenario, load_vehicle(scenario.vehicle), load_gains("default"), law=law, sensing="sonar")
    runs = simulate_batch(case, values or {}, seeds=np.arange(FIRST, FIRST + seeds), threads=2)
    count = np.bincount(runs.column("stopped").astype(int), minlength=len(STOPS))
    named = {reason: int(n) for reason, n in zip(STOPS, count, strict=True)}
    others = ", ".join(f"{n} {why}" for why, n in named.items() if n and why not in ("reached", "collision"))
    time, mean = runs.column("time_s"), {name: runs.column(name).mean() for name in COLUMNS}
    varies = " / ".join(f"{mean[f'variation_{axis}_n_per_s']:.1f}" for axis in ("surge", "sway", "heave"))
    print(
        f"| {label} | `{law}` | {named['reached']} | {named['collision']} | {others or '-'} | {time.mean():.1f} "
        f"| {time.max():.1f} | {np.nanmean(runs.column('path_error_m')):.3f} "
        f"| {runs.column('min_clearance_m').min():.3f} | {varies} | {mean['axis_sign_changes_per_s']:.2f} "
        f"| {mean['axis_saturated_share']:.0%} | {mean['energy_n15_s']:.0f} |",
        flush=True,
    )
    return named["collision"]


COLUMNS = (
    *(f"variation_{axis}_n_per_s" for axis in ("surge", "sway", "heave")),
    "axis_sign_changes_per_s", "axis_saturated_share", "energy_n15_s",
)  # fmt: skip


def main(words: list[str]) -> int:
    """Run the comparison and print its tables."""
    parser = argparse.ArgumentParser(prog="calm.py", description="Compare law calm with law guarded by sonar.")
    parser.add_argument("--quick", action="store_true", help="one scenario, few seeds")
    quick = parser.parse_args(words).quick
    seeds, hit = (2 if quick else 100), 0
    print(f"## Every scenario, seeds {FIRST}-{FIRST + seeds - 1}\n\n| scenario | law | {HEAD}\n{LINE}")
    for name in NAMES[:1] if quick else NAMES:
        hit += sum(row(f"`{name}`", law, load_scenario(name), seeds) for law in LAWS)
    if not quick:
        print(f"\n## Another plant than the law's model, `tank-static`\n\n| plant | law | {HEAD}\n{LINE}")
        for label, values in PLANTS.items():
            hit += sum(row(label, law, load_scenario("tank-static"), 40, values) for law in LAWS)
        print(f"\n## Dead ends, {DEAD_END_LIMIT:g} s at most, 16 seeds\n\n| scene | law | {HEAD}\n{LINE}")
        for scene, (name, boxes) in DEAD_ENDS.items():
            scenario = replace(load_scenario(name), obstacles=boxes, time_limit=DEAD_END_LIMIT)
            hit += sum(row(scene, law, scenario, 16) for law in LAWS)
    return min(hit, 1)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
