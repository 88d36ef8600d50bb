"""Steps that the examples share: random numbers of runs, the choice of gains, margins, and the comparison with C."""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.export import build_bundle, build_controller, compare_runs, write_bundle
from surctl.system import Linearisation, Record, Runs, System, every_combination, linearise, simulate_system
from surctl.verification import system_disk_margin, system_margins

Array = NDArray[np.float64]

LEAST = 0.75  # disk margin at the commands, all opened at once: gains from 0.45 to 2.2


def sizes(description: str | None) -> tuple[int, int]:
    """Return the number of gain sets and of initial states: 100 and 100, with --quick 10 and 10."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--quick", action="store_true", help="100 runs instead of 10,000")
    return (10, 10) if parser.parse_args().quick else (100, 100)


def half_turn(angle: ca.SX) -> ca.SX:
    """Return the angle in (-π, π]."""
    return ca.atan2(ca.sin(angle), ca.cos(angle))


def draw(count: int, seed: int, ranges: Mapping[str, tuple[ArrayLike, ArrayLike]]) -> dict[str, Array]:
    """Return uniform random numbers by name: (count,) between two numbers, (count, k) between two vectors."""
    rng = np.random.default_rng(seed)
    return {name: rng.uniform(low, high, (count, *np.shape(low))) for name, (low, high) in ranges.items()}


def mean_cost(runs: Runs, sets: int) -> Array:
    """Return the mean cost of each gain set over its initial states; infinite if one of its runs ended early."""
    cost = np.where(runs.stopped == "time", runs["cost"], np.inf)
    return cost.reshape(sets, -1).mean(axis=1)


def sweep(system: System, seconds: float, gains: Mapping[str, Array], starts: Mapping[str, Array]) -> Array:
    """Simulate every gain set from every initial state; print what was run, and return the cost of each set."""
    values = every_combination(gains, starts)
    simulate_system(system, system.dt)  # compiled before the clock runs
    began = time.process_time()
    runs = simulate_system(system, seconds, values)
    spent = time.process_time() - began
    ended = ", ".join(f"{reason} {np.sum(runs.stopped == reason):,}" for reason in np.unique(runs.stopped))
    print(f"sweep: {len(runs.time):,} runs of {seconds:g} s in {spent:.2f} s of processor time; ended by: {ended}")
    cost = mean_cost(runs, len(next(iter(gains.values()))))
    print(f"cost of a gain set: best {cost.min():.4g}, median {np.median(cost):.4g}")
    return cost


def choose(
    system: System, gains: Mapping[str, Array], cost: Array, commands: tuple[str, ...], fixed: Mapping[str, ArrayLike]
) -> dict[str, Array]:
    """Return the cheapest gain set with a disk margin of `LEAST` when all commands are opened; end if there is none."""
    for k in np.argsort(cost)[: int(np.isfinite(cost).sum())]:
        best = one(gains, int(k))
        margin = system_disk_margin(linearise(system, {**best, **fixed}), *commands).guaranteed
        if margin >= LEAST:
            print(f"chosen: {named(best)}, cost {cost[k]:.4g}, disk margin {margin:.2f} at the commands")
            return best
    raise SystemExit(f"no gain set has a disk margin of {LEAST}")


def named(gains: Mapping[str, ArrayLike]) -> str:
    """Return the gains as text."""
    return ", ".join(f"{name} = {', '.join(f'{v:.3g}' for v in np.ravel(value))}" for name, value in gains.items())


def one(gains: Mapping[str, Array], k: int) -> dict[str, Array]:
    """Return gain set k as numbers of one run."""
    return {name: value[k : k + 1] if value.ndim > 1 else value[k] for name, value in gains.items()}


def print_margins(linear: Linearisation, *openings: str) -> bool:
    """Print the margins of each loop and of all loops at once; return whether the loop is stable."""
    print("| loop | gain margin | least gain | phase margin | delay margin | disk margin |")
    print("|---|---|---|---|---|---|")
    for m in system_margins(linear, *openings):
        print(
            f"| `{m.name}` | {m.gain_margin:.2f} | {m.least_gain:.2f} | {m.phase_margin_deg:.1f}° "
            f"| {1e3 * m.delay_margin_s:.0f} ms | {m.disk_margin:.2f} |"
        )
    disk = system_disk_margin(linear, *openings)
    print(f"all {len(openings)} at once: disk margin {disk.guaranteed:.2f}, gains from %.2f to %.2f" % disk.gain)
    return bool(disk.stable)


def back_to_back(record: Record) -> bool:
    """Export the controller of a recorded run as C, compare it with Python at each step; return whether they agree."""
    controller = record.system.controller
    bundle = build_bundle(controller, controller.gains.unpack(record.controller[2]))
    with tempfile.TemporaryDirectory() as folder:
        files = write_bundle(bundle, Path(folder, bundle.name))
        compiled = build_controller(controller, bundle, Path(folder, bundle.name))
        (report,) = compare_runs(compiled, [record])
    print(
        f"C: {len(files)} files, {report.code_bytes:,} bytes of code and constants, {report.steps} steps; largest "
        f"difference to Python: command {report.tau.absolute:.1e}, state {report.state.absolute:.1e}; invalid inputs: "
        f"{report.fault_cases} cases, {len(report.fault_failures)} failures"
    )
    return bool(report.passed)
