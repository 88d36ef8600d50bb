"""Study 17: why a robot with sonars is slow among the pool's four cylinders; one cause is removed at a time.

    python analysis/17_pool_static_limits/run.py [--quick]

Prints Markdown. The exit status is 0 if no run with unchanged equipment and vehicle collides, 1 otherwise, and 2 for a
bad option.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from dataclasses import replace
from math import pi, radians

import numpy as np

from surctl.marine.control import load_gains
from surctl.marine.guidance import Path
from surctl.marine.sensing import Equipment, FaultChances, SonarArray
from surctl.marine.simulation import STOPS, Case, Scenario, Sensing, Sensors, load_scenario, simulate_batch
from surctl.marine.vehicle import Vehicle, load_vehicle

NAME = "pool-static"
MARGINS = (0.04, 0.03, 0.02)
MANY = 1000  # seeds for the rows on margins and worse sensors: 200 would show no collision
EXACT = {"noise_sd": 1e-4, "bias": 0.0, "bits": 14}


def eight(degrees: float) -> SonarArray:
    """Return eight sonars, all fired within the cycle of four."""
    azimuths = tuple(k * pi / 4 for k in range(8))
    return SonarArray(azimuths=azimuths, order=tuple(range(8)), firing_period=0.0125, beam_angle=radians(degrees))


def sensors() -> dict[str, Sensors]:
    """Return variants of the equipment, by the change."""
    found = {
        "own position exact": Equipment(own=None),
        "ranges exact": Equipment(array=SonarArray(**EXACT)),
        "position and ranges exact": Equipment(own=None, array=SonarArray(**EXACT)),
        "blind below 0.05 m": Equipment(array=SonarArray(minimum=0.05)),
    }
    found |= {f"beams of {d}°": Equipment(array=SonarArray(beam_angle=radians(d))) for d in (45, 15)}
    found |= {f"eight sonars, beams of {d}°": Equipment(array=eight(d)) for d in (75, 15)}
    return {name: Sensors(equipment) for name, equipment in found.items()}


def trouble() -> dict[str, Sensors]:
    """Return variants with worse sensors, by the change."""
    return {
        **{f"beams of {d}°": Sensors(Equipment(array=SonarArray(beam_angle=radians(d)))) for d in (15, 120)},
        "a tenth of the firings lost": Sensors(chances=FaultChances(dropout=0.1)),
    }


def mirrored(scenario: Scenario) -> Scenario:
    """Return the pool with left and right exchanged; waves, noise and drift keep their seeds, unmirrored."""
    width, standing = scenario.site[1], scenario.obstacles
    return replace(
        scenario,
        path=Path(scenario.path.waypoints * [1, -1] + [0, width]),
        obstacles=tuple(o.model_copy(update={"centre_m": (o.centre_m[0], width - o.centre_m[1])}) for o in standing),
    )


def vehicles(vehicle: Vehicle) -> dict[str, Vehicle]:
    """Return variants of the vehicle, by the change; the controller uses the changed parameters."""

    def changed(**values: float) -> Vehicle:
        return vehicle.with_values(values)

    lighter = {name: 0.8 * vehicle[name] for name in ("radius", "m11", "m22", "m33", "m44")}
    stronger = {name: 1.2 * vehicle[name] for name in ("Fu_max", "Fv_max", "Fr_max")}
    return {
        "thrust doubled": changed(Fu_max=2 * vehicle["Fu_max"], Fv_max=2 * vehicle["Fv_max"]),
        "mass halved": changed(m11=0.5 * vehicle["m11"], m22=0.5 * vehicle["m22"]),
        **{f"hull of {radius:g} m": changed(radius=radius) for radius in (0.18, 0.16, 0.14, 0.12, 0.1)},
        "hull and masses less by a fifth, thrust more by a fifth": changed(**lighter, **stronger),
    }


def row(
    label: str,
    seeds: int,
    scenario: Scenario,
    *,
    sensing: Sensing = "sonar",
    vehicle: Vehicle,
    changed: Mapping[str, float] | None = None,
) -> int:
    """Print a row of the table, with some gains changed; return the number of collisions."""
    gains = load_gains("default").with_values(changed or {})
    runs = simulate_batch(Case(scenario, vehicle, gains, sensing=sensing), seeds=np.arange(seeds), threads=2)
    stopped, took = runs.column("stopped").astype(int), runs.column("time_s")
    counts = {reason: int(np.sum(stopped == k)) for k, reason in enumerate(STOPS)}
    print(
        f"| {label} | {counts['reached']} | {counts['collision']} | {seeds - counts['reached'] - counts['collision']} "
        f"| {np.median(took):.1f} | {took.mean():.1f} | {runs.column('length_m').mean():.2f} "
        f"| {runs.column('min_clearance_m').min():.3f} |",
        flush=True,
    )
    return counts["collision"]


def main(words: list[str]) -> int:
    """Run the study and print the results."""
    parser = argparse.ArgumentParser(prog="run.py", description="Remove the causes of a slow run one at a time.")
    parser.add_argument("--quick", action="store_true", help="few seeds, nothing changed")
    options = parser.parse_args(words)
    seeds = 4 if options.quick else 200
    scenario = load_scenario(NAME)
    vehicle = load_vehicle(scenario.vehicle)
    print(f"## `{NAME}`, {seeds} seeds each\n")
    print("| changed | reached | collided | else | median time [s] | mean [s] | mean way [m] | least clearance [m] |")
    print("|---|---|---|---|---|---|---|---|")
    hit = row("true positions", seeds, scenario, sensing="truth", vehicle=vehicle)
    hit += row("nothing: by sonar", seeds, scenario, vehicle=vehicle)
    if not options.quick:
        for label, other in vehicles(vehicle).items():
            row(label, seeds, scenario, vehicle=other)
        for label, told in sensors().items():
            row(label, seeds, replace(scenario, sensors=told), vehicle=vehicle)
        for margin in MARGINS:
            row(f"margin of {margin:g} m", MANY, scenario, vehicle=vehicle, changed={"margin": margin})
        many = {"whole": scenario, **{label: replace(scenario, sensors=told) for label, told in trouble().items()}}
        for label, mission in (many | {"pool mirrored": mirrored(scenario)}).items():
            row(f"{label}, {MANY} seeds", MANY, mission, vehicle=vehicle)
    return 0 if hit == 0 else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
