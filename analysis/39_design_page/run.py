"""Study 39: how long the design page computes after a slider moves, for four closed loops.

    python analysis/39_design_page/run.py            # 20 gain sets for each loop
    python analysis/39_design_page/run.py --quick    # 3 gain sets for two loops

Prints Markdown: processor time in the server, median and largest. Status 0 if the median of the linear views is at most
150 ms and that of a run at most 1.5 s, else 1.
"""

from __future__ import annotations

import argparse
import sys
import time
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np

from surctl.marine.control import load_gains
from surctl.marine.report.bench import Bench
from surctl.marine.simulation import load_scenario
from surctl.marine.vehicle import load_vehicle
from surctl.report.design_bench import DesignBench, SystemBench
from surctl.report.page_parts import respond
from surctl.tuning import Margins, SensitivityBound

HERE = Path(__file__).parent
LINEAR, RUN = 0.15, 1.5  # [s] bars


def example(name: str) -> ModuleType:
    """A module of study 26."""
    folder = str(HERE.parent / "26_examples")
    if folder not in sys.path:
        sys.path.append(folder)
    return import_module(name)


def cart_pole() -> SystemBench:
    """Cart and pole from three starts, with two goals."""
    pendulum_lqr = example("pendulum_lqr")
    k = pendulum_lqr.gain(np.array([4.0, 25.0, 0.0, 0.0]))
    ranges = {f"K[{j}]": tuple(sorted((0.5 * v, 2.0 * v))) for j, v in enumerate(k)}
    places = {f"start {a:g}": {"start.angle": a, "K": k[None]} for a in (0.0, 0.1, 0.2)}
    goals = (SensitivityBound(name="peak", at="tau", at_most=2.0), Margins(name="robust", at="tau", phase_deg=30.0))
    return SystemBench(pendulum_lqr.system, "pendulum_lqr.py", 10.0, ranges, places, goals)


def ship() -> SystemBench:
    """CyberShip II at three loads."""
    cybership2 = example("cybership2")
    places = {f"load {w:g}": {"disturbance.waves": np.array([[w, -w, 0.0]])} for w in (0.0, 0.3, 0.6)}
    ranges = {"omega": (0.1, 1.6), "zeta": (0.3, 3.0), "n": (3.0, 60.0)}
    goals = (SensitivityBound(name="peak", at="tau[0]", at_most=2.0),)
    return SystemBench(cybership2.system, "cybership2.py", 60.0, ranges, places, goals)


def robot() -> Bench:
    """The built-in law at three cruise speeds."""
    return Bench(load_vehicle("sur400"), load_scenario("pool-behind"), load_gains("default"), (), (0.05, 0.22))


def wall() -> Bench:
    """A law of one's own, linear about its run."""
    folder = HERE.parent / "27_own_law"
    scenario = load_scenario(str(folder / "wall.toml"))
    law = f"{folder / 'wall.py'}:wall"
    return Bench(load_vehicle(scenario.vehicle), scenario, load_gains("default"), (), law=law)


def measured(bench: DesignBench, sets: int) -> dict[str, list[float]]:
    """Processor time [s] of each kind of request, for random gain sets."""
    rng = np.random.default_rng(0)
    start = {one.name: one.value for one in bench.sliders}
    names = bench.loop(start, bench.points[0]).names
    end = f"measured.{names.outputs[0]}"
    source = f"reference.{names.references[0]}" if names.references else end
    taken: dict[str, list[float]] = {kind: [] for kind in ("linear", "goals", "details", "run")}
    for k in range(sets + 1):
        values = {name: value * float(rng.uniform(0.98, 1.02)) for name, value in start.items()}
        request = {
            "values": values, "compared": None, "points": list(bench.points[:3]), "opening": names.commands[0],
            "source": source, "end": end, "locus": bench.sliders[0].name,
        }  # fmt: skip
        for kind, times in taken.items():
            began = time.process_time()
            found = respond(bench, kind, request)
            if k:  # the first request compiles
                times.append(time.process_time() - began)
            if "error" in found:
                raise SystemExit(found["error"])
    return taken


def main() -> int:
    """Print the table; 1 if a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="3 gain sets for two loops")
    quick = parser.parse_args().quick
    benches = {"cart and pole": cart_pole} if quick else {"cart and pole": cart_pole, "CyberShip II": ship}
    benches |= {"robot, law guarded": robot} if quick else {"robot, law guarded": robot, "own law, wall": wall}
    print("| loop | points | linear views [ms] | goals [ms] | margins and locus [ms] | runs and figures [ms] |")
    print("|---|---|---|---|---|---|")
    good = True
    for name, build in benches.items():
        bench = build()
        taken = measured(bench, 3 if quick else 20)
        cells = [f"{1e3 * np.median(t):.0f} ({1e3 * max(t):.0f})" for t in taken.values()]
        print(f"| {name} | {min(3, len(bench.points))} | " + " | ".join(cells) + " |")
        good &= bool(np.median(taken["linear"]) <= LINEAR and np.median(taken["run"]) <= RUN)
    print()
    print("Processor time in the server: median (largest).", "Bars met." if good else "A BAR IS MISSED.")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
