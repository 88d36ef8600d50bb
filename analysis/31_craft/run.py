"""Study 31: published vehicles with the gains that follow from them, on missions scaled to them.

    python analysis/31_craft/run.py [--quick] [--write] [VEHICLE...]

Each vehicle (default: those of `CRAFT` that the library has) gets the gains derived for its cruise speed, or for the
largest speed that derived gains bear. It then runs a straight mission of 20 hull lengths, a mission of two legs, and
`tank-static` scaled to its size with 20 seeds. Prints Markdown; --write writes the README from it. The exit status is 1
if a limit does not hold, and 2 for a bad option. --quick: one vehicle, two seeds.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from surctl.errors import InputError
from surctl.marine.control import Gains, build_law, default_law, law_source
from surctl.marine.simulation import Case, Metrics, load_scenario, simulate, simulate_batch
from surctl.marine.simulation.scaling import disturbed, mission_size, scaled_scenario, straight_mission, two_leg_mission
from surctl.marine.tuning import default_cruise, derive_gains
from surctl.marine.vehicle import Vehicle, load_vehicle
from surctl.marine.verification import law_corners
from surctl.verification.linear import LEAST_DISK_MARGIN


@dataclass(frozen=True)
class Craft:
    """A vehicle of the study: name or file, and cruise speed [m/s] (None: 35 % of its top speed)."""

    vehicle: str
    cruise: float | None = None


CRAFT = (
    Craft("sur400", 0.15),
    Craft("sur540-flooded", 0.15),
    Craft("sur540-light", 0.15),
    Craft("bluerov2-wu", 0.47),
    Craft("bluerov2-vonbenzon", 0.17),
    Craft("rexrov", 0.66),
    Craft("girona500", 0.51),
    Craft("bluerov2-heavy"),
    Craft("cybership2"),
    Craft("otter", 0.77),
    Craft("remus100", 0.87),
    Craft("lauv", 0.64),
    Craft("eca-a9", 0.79),
)
"""The vehicles: to add one, add its line."""

QUICK = ("bluerov2-vonbenzon",)

MOST_CRAB = 15.0  # [deg] mean crab angle of a mission, and largest crab angle of the straight one
SEEDS, SHARE = 20, 0.02
HEAD = (
    "vehicle", "cruise [m/s]", "disk margin", "simulated at [m/s], disk margin", "straight: end, time [s]",
    "crab mean / max [deg]", "wasted", "two legs: end, time [s]", "crab mean / max [deg]", "tank: reached, collided",
    "least clearance [radii]", "holds",
)  # fmt: skip


@dataclass(frozen=True)
class Row:
    """The results of one vehicle; `cells` are those of the table."""

    cells: tuple[str, ...]
    defects: tuple[str, ...]


def shown_margin(vehicle: Vehicle, gains: Gains, cruise: float) -> float:
    """Return the disk margin at the worst corner of the vehicle's ranges; 0 if the loop is unstable there."""
    return law_corners(build_law(default_law(vehicle)), vehicle, gains, cruise=cruise).disk


def examined(craft: Craft, vehicle: Vehicle, *, seeds: int) -> Row:
    """Return the margins and runs of one vehicle."""
    cruise, own = craft.cruise or default_cruise(vehicle), law_source(default_law(vehicle)).gains
    derivation = derive_gains(vehicle, cruise=cruise)
    gains = derivation.gains.with_own(own)
    margin, speed = shown_margin(vehicle, gains, cruise), cruise
    if not derivation.reached:
        speed = derivation.bearable
        gains = derive_gains(vehicle, cruise=speed).gains.with_own(own)
    held = shown_margin(vehicle, gains, speed)
    defects = [] if held >= LEAST_DISK_MARGIN else [f"disk margin {held:.2f} at {speed:g} m/s"]
    runs = []
    size = mission_size(vehicle, gains, cruise=speed)
    for mission in (
        straight_mission(vehicle, cruise=speed, size=size),
        two_leg_mission(vehicle, cruise=speed, size=size),
    ):
        scenario = disturbed(mission, vehicle, share=SHARE)  # without a push, a loop that crabs stays on its path
        m = simulate(scenario, vehicle, gains=gains).metrics
        runs.append(m)
        defects += [] if m.reached else [f"{scenario.name}: {m.stopped_because}"]
        defects += [] if m.crab_angle_deg <= MOST_CRAB else [f"{scenario.name}: crabs {m.crab_angle_deg:.0f} deg"]
    if runs[0].max_crab_angle_deg > MOST_CRAB:
        defects.append(f"straight: crabs up to {runs[0].max_crab_angle_deg:.0f} deg")
    tank, cells = in_tank(vehicle, gains, speed, size, seeds)
    defects += tank
    return Row(
        (
            vehicle.name,
            f"{cruise:g}",
            f"{margin:.2f}",
            f"{speed:g}, {held:.2f}" if speed != cruise else "as cruise",
            *_cells(runs[0]),
            f"{runs[0].wasted_share:.0%}",
            *_cells(runs[1]),
            *cells,
            "yes" if not defects else f"**no**: {'; '.join(defects)}",
        ),
        tuple(defects),
    )


def in_tank(vehicle: Vehicle, gains: Gains, cruise: float, size: float, seeds: int) -> tuple[list[str], list[str]]:
    """Return defects and cells of the scaled tank with true positions."""
    template = load_scenario("tank-static")
    tank = disturbed(scaled_scenario(template, vehicle, cruise=cruise, size=size), vehicle, share=SHARE)
    runs = simulate_batch(Case(tank, vehicle, gains, default_law(vehicle)), seeds=np.arange(seeds), threads=2)
    reached, collided = (int(runs.column(name).sum()) for name in ("reached", "collided"))
    least = float(runs.column("min_clearance_m").min())
    defects = [f"tank: {collided} collisions"] * (collided > 0)
    defects += [f"tank: {reached} of {seeds} reached"] * (reached < seeds)
    return defects, [f"{reached}, {collided} of {seeds}", f"{least / vehicle['radius']:.2f}"]


def _cells(m: Metrics) -> list[str]:
    return [f"{m.stopped_because}, {m.time_s:.0f}", f"{m.crab_angle_deg:.1f} / {m.max_crab_angle_deg:.1f}"]


def study(crafts: list[Craft], *, seeds: int) -> tuple[str, bool]:
    """Return the Markdown text, and whether every limit holds."""
    lines = [f"| {' | '.join(HEAD)} |", "|" + "---|" * len(HEAD)]
    missing, held = [], True
    for craft in crafts:
        try:
            vehicle = load_vehicle(craft.vehicle)
        except InputError as error:
            if error.problem != "unknown vehicle":
                raise
            missing.append(craft.vehicle)
            continue
        print(craft.vehicle, file=sys.stderr)
        row = examined(craft, vehicle, seeds=seeds)
        held = held and not row.defects
        lines.append(f"| {' | '.join(row.cells)} |")
    lines += ["", f"Not in the library, so left out: {', '.join(missing)}."] if missing else []
    return "\n".join(lines), held


def named(word: str) -> Craft:
    """Return the vehicle of the study with this name or this file name, else a further vehicle."""
    known = {craft.vehicle: craft for craft in CRAFT}
    craft = known.get(Path(word).stem, Craft(word))
    return Craft(word, craft.cruise)


def main() -> int:
    """Run the study and print the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("vehicles", nargs="*", metavar="VEHICLE")
    parser.add_argument("--quick", action="store_true", help="one vehicle, two seeds")
    parser.add_argument("--write", action="store_true", help="write README.md beside this file")
    options = parser.parse_args()
    crafts = [named(word) for word in options.vehicles or (QUICK if options.quick else [c.vehicle for c in CRAFT])]
    text, held = study(crafts, seeds=2 if options.quick else SEEDS)
    print(text)
    if options.write:
        folder = Path(__file__).parent
        folder.joinpath("README.md").write_text(f"{folder.joinpath('about.md').read_text()}\n{text}\n")
    return 0 if held else 1


if __name__ == "__main__":
    sys.exit(main())
