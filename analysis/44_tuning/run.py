"""Study 44: is any figure of the assessment worse after a tuning without being named, and is the least margin kept?

    python analysis/44_tuning/run.py [--quick] [--out DIR] [VEHICLE…]

Tunes 13 built-in vehicles at 1.0, 0.3 and 0.5 times the largest cruise speed that derived gains bear, by the command
`surctl tune`, and compares its text with the figures in its file. Prints Markdown. The exit status is 0 if the first
line names every figure that is worse, and the disk margin at the worst corner is sufficient or the text says why no
gains have it; else 1. `--quick` tunes one vehicle at one speed with a quarter of the trials.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

from surctl.marine.control import default_law, law_source
from surctl.marine.simulation.scaling import mission_size, two_leg_mission
from surctl.marine.simulation.scenario import scenario_table
from surctl.marine.simulation.toml_text import toml_text
from surctl.marine.tuning import default_cruise, derive_gains, gains_for
from surctl.marine.vehicle import Vehicle, load_vehicle

VEHICLES = (
    "sur400", "sur540-light", "sur540-flooded", "bluerov2-wu", "bluerov2-vonbenzon", "bluerov2-heavy", "girona500",
    "rexrov", "cybership2", "otter", "remus100", "lauv", "eca-a9",
)  # fmt: skip
QUICK, SHARE = "sur400", 0.3  # its region is proved soon, and the tuned gains make it smaller
SHARES = (1.0, 0.3, 0.5)
TRIALS = 32
WORDS = ("--rounds", "1", "--seeds", "1", "--monte-carlo", "2", "--verbose")
STUDY = """kind = "study"
name = "tuning"
vehicle = "{vehicle}"
runs = [{{ scenario = "mission.toml" }}]
[[goals]]
name = "arrive"
metric = "reached"
at_least = {{ value = 1.0, unit = "1" }}
kind = "hard"
[[goals]]
name = "stay near the path"
metric = "deviation_m"
at_most = {{ value = {deviation}, unit = "m" }}
"""


class Row(NamedTuple):
    """One tuning: what it shows, and what is wrong with it."""

    vehicle: str
    cruise: float
    before: float
    after: float
    worse: tuple[str, ...]
    reason: str
    faults: tuple[str, ...]


def main(arguments: list[str]) -> int:
    """Run the study, print the table, and return the exit status."""
    parser = argparse.ArgumentParser(prog="run.py", description="Tune vehicles and check what the command says.")
    parser.add_argument("--quick", action="store_true", help="one vehicle at one speed")
    parser.add_argument("--out", type=Path, help="folder of the tunings; finished ones are read; default: a new one")
    parser.add_argument("vehicles", nargs="*", metavar="VEHICLE", help="default: 13 built-in vehicles")
    options = parser.parse_args(arguments)
    out = options.out or Path(tempfile.mkdtemp(prefix="surctl-tunings-"))
    vehicles = options.vehicles or ((QUICK,) if options.quick else VEHICLES)
    print("| vehicle | cruise [m/s] | disk margin before | after | worse figures | below the least margin | wrong |")
    print("|---|---|---|---|---|---|---|")
    rows = []
    trials = TRIALS // 4 if options.quick else TRIALS
    for share, name in product((SHARE,) if options.quick else SHARES, vehicles):
        cruise = float(f"{share * largest_cruise(name):.3g}")
        rows.append(tuned(load_vehicle(name), cruise, out / f"{name}-{share:g}", trials))
        one = rows[-1]
        cells = (f"{one.before:.3f}", f"{one.after:.3f}", ", ".join(one.worse), one.reason, "; ".join(one.faults))
        print(f"| {one.vehicle} | {one.cruise:g} | {' | '.join(cells)} |", flush=True)
    wrong = sum(bool(one.faults) for one in rows)
    print(
        f"\n{len(rows)} tunings, {wrong} wrong; {sum(bool(one.worse) for one in rows)} name figures that are worse; ",
        end="",
    )
    print(f"{sum(bool(one.reason) for one in rows)} below the least margin, with the reason.")
    return int(wrong > 0)


@cache
def largest_cruise(name: str) -> float:
    """Return the largest cruise speed [m/s] of a vehicle that derived gains bear; the default one if that is none."""
    vehicle = load_vehicle(name)
    usual = default_cruise(vehicle)
    derivation = derive_gains(vehicle, cruise=2.0 * usual)
    return 2.0 * usual if derivation.reached else derivation.bearable or usual


def tuned(vehicle: Vehicle, cruise: float, folder: Path, trials: int) -> Row:
    """Tune a vehicle by the command, unless the folder holds the result, and check what it says."""
    text = folder / "text"
    if not text.exists():
        folder.mkdir(parents=True, exist_ok=True)
        own = law_source(default_law(vehicle)).gains  # without sway force, the law has gains of its own
        gains, _ = gains_for(None, vehicle, cruise=cruise, own=own)
        mission = two_leg_mission(vehicle, cruise=cruise, size=mission_size(vehicle, gains, cruise=cruise))
        (folder / "mission.toml").write_text(toml_text(scenario_table(mission)))
        study = STUDY.format(vehicle=vehicle.name, deviation=round(0.5 * vehicle["radius"], 3))
        (folder / "study.toml").write_text(study)
        words = ("--trials", str(trials), *WORDS, "--out", "out")
        command = [sys.executable, "-m", "surctl", "tune", "study.toml", *words]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, env=os.environ, check=False)
        if done.returncode not in (0, 1):
            fault = done.stderr.strip().splitlines()[-1]
            return Row(vehicle.name, cruise, math.nan, math.nan, (), "", (fault,))
        text.write_text(done.stdout)
    both = json.loads((folder / "out" / "tuning.json").read_text())["assessment"]
    return judged(vehicle.name, cruise, text.read_text(), both["before"]["figures"], both["after"]["figures"])


def judged(
    name: str, cruise: float, text: str, before: Mapping[str, dict[str, Any]], after: Mapping[str, dict[str, Any]]
) -> Row:
    """Return the row of a tuning from its text and the figures of its file."""
    lines = text.splitlines()
    first = lines[0]
    worse = tuple(n for n in before if is_worse(before[n], after.get(n)))
    faults = [f"first line is silent about {n}" for n in worse if f" {n} " not in first]
    if not worse and "WORSE" in first:
        faults.append("first line names a figure that is not worse")
    disks = [number(one.get("disk_margin", {}).get("value")) for one in (before, after)]
    least = after.get("disk_margin", {}).get("least") or 0.0
    said = [k for k, line in enumerate(lines) if line.startswith("disk margin ") and "worst corner" in line]
    reason = f"{lines[said[0]]}; {lines[said[0] + 1].strip()}" if said else ""
    if not disks[1] >= least and not reason:
        faults.append("the margin is too small without a reason")
    return Row(name, cruise, *disks, worse, reason, tuple(faults))


def is_worse(old: Mapping[str, Any], new: Mapping[str, Any] | None) -> bool:
    """Return whether a figure is worse by more than 1e-5 of its value, or lost."""
    first, last = number(old["value"]), number((new or {}).get("value"))
    if old["better"] is None or math.isnan(first):
        return False
    lost = last - first if old["better"] == "low" else first - last
    return math.isnan(last) or lost > 1e-8 + 1e-5 * abs(first)


def number(value: Any) -> float:
    """Return a number of a JSON file; NaN if it has none."""
    return math.nan if value is None else float(value)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
