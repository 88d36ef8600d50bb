"""Study 12: the closed loop with sonars, intact and with faults; speed of the loop and cost of the perception.

    python analysis/12_sonar_loop/run.py [--quick]

Prints Markdown. The exit status is 0 if every limit holds, 1 otherwise, and 2 for a bad option.
"""

from __future__ import annotations

import argparse
import sys
import time
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from surctl.errors import ToolMissing
from surctl.ir import Block, memory
from surctl.marine.control import build_law, load_gains
from surctl.marine.sensing import BaseStation, Delivery, Equipment, Fault, FaultChances, OwnState, SonarArray
from surctl.marine.simulation import STOPS, BatchResult, Case, Sensors, load_scenario, simulate_batch
from surctl.marine.simulation.batch.engines import structure_of
from surctl.marine.simulation.batch.loop import build_loop
from surctl.marine.vehicle import load_vehicle
from tests.stack import stack_bytes

INSTRUCTIONS = 2  # of a Cortex-M4F per operation: assumption of the cost estimate
RATE, CLOCK = 20.0, 168e6  # steps a second, Hz
HEAVY = {"plant.m11": 125.0, "plant.m22": 125.0, "plant.Fu_max": 4.25, "plant.Fv_max": 4.25}
SLOW_TO_TURN = {"plant.Nr": 1.0, "plant.Nrr": 3.0, "plant.Fr_max": 0.425}
WORST = HEAVY | SLOW_TO_TURN  # of sur540-flooded's ranges, unknown to its controller


def conditions() -> dict[str, tuple[Sensors, bool]]:
    """Return the sensors by name, and whether a limit applies to them."""
    found: dict[str, tuple[Sensors, bool]] = {"nominal": (Sensors(), True)}
    for k, where in enumerate(("front", "left", "rear", "right")):
        found[f"{where} dead"] = (Sensors(faults=(Fault(sensor=k, kind="dead"),)), True)
    found["10 % lost"] = (Sensors(chances=FaultChances(dropout=0.1)), True)
    for degrees in (15, 120):
        array = SonarArray(beam_angle=float(np.radians(degrees)))
        found[f"beams of {degrees}°"] = (Sensors(Equipment(array=array)), True)
    for kind in ("stuck", "zero", "maximum", "second_echo", "crosstalk"):
        found[f"front {kind} from 5 s"] = (Sensors(faults=(Fault(sensor=0, kind=kind, start_s=5.0),)), False)
    late = Fault(sensor=0, kind="delay", start_s=5.0, delay_s=0.4)
    found["front late by 0.4 s from 5 s"] = (Sensors(faults=(late,)), False)
    found["5 % spikes"] = (Sensors(chances=FaultChances(spike=0.05)), False)
    deaf = Equipment(station=BaseStation(messages=Delivery(loss=0.3)))
    found["30 % of messages lost"] = (Sensors(deaf), False)
    lost = Equipment(own=OwnState(fixes=Delivery(gaps=((10.0, 15.0),))))
    found["no fix from 10 to 15 s"] = (Sensors(lost), False)
    return found


def flown(name: str, sensors: Sensors, seeds: int, values: Mapping[str, float] | None = None) -> BatchResult:
    """Simulate all seeds of a scenario with these sensors."""
    return simulate_batch(case_of(name, sensors), values or {}, seeds=np.arange(seeds), threads=2)


def case_of(name: str, sensors: Sensors) -> Case:
    """Return a scenario with these sensors."""
    scenario = replace(load_scenario(name), sensors=sensors)
    return Case(scenario, load_vehicle(scenario.vehicle), load_gains("default"), sensing="sonar")


def row(condition: str, name: str, runs: BatchResult) -> int:
    """Print a row of the table; return the number of collisions."""
    stopped, took = runs.column("stopped").astype(int), runs.column("time_s")
    counts = {reason: int(np.sum(stopped == k)) for k, reason in enumerate(STOPS)}
    hit = [int(k) for k in np.flatnonzero(stopped == STOPS.index("collision"))]
    others = ", ".join(f"{reason} {n}" for reason, n in counts.items() if n and reason not in ("reached", "collision"))
    told = f"{len(hit)}" + (f" (seeds {hit})" if hit else "")
    least = runs.column("min_clearance_m").min()
    print(
        f"| {condition} | `{name}` | {counts['reached']} | {told} | {others or '-'} | {np.median(took):.1f} "
        f"| {least:.3f} | {thrust_used(runs)} |",
        flush=True,
    )
    return len(hit)


def thrust_used(runs: BatchResult) -> str:
    """Return the mean thrust activity of the runs as cells of the table."""
    varies = (runs.column(f"variation_{axis}_n_per_s").mean() for axis in ("surge", "sway", "heave"))
    signs, share = (runs.column(f"axis_{name}").mean() for name in ("sign_changes_per_s", "saturated_share"))
    return f"{' / '.join(f'{one:.1f}' for one in varies)} | {signs:.2f} | {share:.0%}"


def speed(seeds: int) -> float:
    """Return the simulated seconds per second of one core."""
    scenario = load_scenario("tank-static")
    case = Case(scenario, load_vehicle(scenario.vehicle), load_gains("default"), sensing="sonar")
    simulate_batch(case, seeds=0)  # compiled by now
    start = time.process_time()
    runs = simulate_batch(case, seeds=np.arange(seeds), threads=1)
    return float(runs.column("time_s").sum() / (time.process_time() - start))


def ram(block: Block) -> tuple[int, int | None]:
    """Return the bytes of a block's arrays in float32 (with inputs and outputs), and this plus the stack if gcc
    reports it.
    """
    given = sum(size for _, size in (*block.inputs, *block.outputs))
    try:
        return 4 * memory(block), 4 * given + stack_bytes(block, real="float32")
    except ToolMissing:
        return 4 * memory(block), None


def main(words: list[str]) -> int:
    """Run the study and print the results."""
    parser = argparse.ArgumentParser(prog="run.py", description="Simulate the scenarios with sonars.")
    parser.add_argument("--quick", action="store_true", help="few seeds, one scenario, one condition")
    options = parser.parse_args(words)
    config = tomllib.loads(Path(__file__).with_name("config.toml").read_text(encoding="utf-8"))
    size, bars = config["quick" if options.quick else "full"], config["bars"]
    names = ["pool-behind"] if options.quick else config["scenarios"]
    chosen = list(conditions().items())
    if options.quick:  # the loop that study 22 compiles too
        chosen = [one for one in chosen if one[0] == "10 % lost"]
    collisions = 0
    print(f"## {size['seeds']} seeds each\n")
    print(
        "| sensors | scenario | reached | collided | else | median time [s] | least clearance [m] "
        "| thrust varies, surge / sway / heave [N/s] | sign changes of the worst axis [1/s] | at its limit |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    for condition, (sensors, judged) in chosen:
        for name in names:
            hit = row(condition, name, flown(name, sensors, size["seeds"]))
            collisions += hit if judged and (options.quick or name in config["judged"]) else 0
    if not options.quick:
        for name in ("tank-static", "tank-moving"):
            row("vehicle at its worst", name, flown(name, Sensors(), size["seeds"], WORST))
    held = [collisions <= bars["collisions"]]
    print(f"\n- collisions where a bar is set: {collisions}, bar {bars['collisions']}: {_word(held[-1])}")
    if not options.quick:  # a busy machine decides nothing
        times = speed(max(size["seeds"], 8))
        held.append(times >= bars["real_time"])
        print(f"- compiled loop, one thread: {times:.0f} times real time, bar {bars['real_time']}: {_word(held[-1])}")
    if options.quick:  # the law that has just run
        law = build_loop(structure_of(case_of(names[0], chosen[0][1][0]), {})).law
    else:
        law = build_law(sonar=True)
    assert law.perception is not None
    operations = law.perception.block.operations
    share = operations * INSTRUCTIONS * RATE / CLOCK
    held.append(share <= bars["cortex_share"])
    print(
        f"- perception: {operations} operations per step, at {INSTRUCTIONS} instructions each and {RATE:g} Hz "
        f"{100 * share:.1f} % of a 168 MHz core, bar {100 * bars['cortex_share']:.0f} %: {_word(held[-1])}"
    )
    counted, told = (4 * memory(law.perception.block), None) if options.quick else ram(law.perception.block)
    held.append(max(counted, told or 0) <= 1024 * bars["cortex_kb"])
    stack = f"{told / 1024:.1f} kB with the stack by -Os here" if told else "the stack is not reported"
    print(
        f"- their memory in float32: state, next state and all arrays {counted / 1024:.1f} kB, {stack}, "
        f"bar {bars['cortex_kb']} kB: {_word(held[-1])}"
    )
    return 0 if all(held) else 1


def _word(held: bool) -> str:
    return "holds" if held else "**missed**"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
