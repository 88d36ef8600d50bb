"""Study 8: memory and time of a large sweep.

    python analysis/08_sweep_scale/run.py [--runs N] [--out DIR]

Prints Markdown. The exit status is 0 if memory and fit meet their limits, and 1 otherwise.
"""

from __future__ import annotations

import argparse
import resource
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from surctl.errors import InputError
from surctl.files import Strict, load_model, prepare_folder
from surctl.marine.control import load_gains
from surctl.marine.simulation import Case, load_scenario
from surctl.marine.tuning import MissionSweep
from surctl.marine.vehicle import load_vehicle
from surctl.tuning import LocalExecutor, Span, spread, sweep

CONFIG = Path(__file__).with_name("config.toml")


class Config(Strict):
    """The contents of config.toml."""

    scenario: str
    runs: tuple[int, ...]
    full: tuple[float, ...]
    workers: int
    most_memory_mib: float
    least_fit: float
    ranges: dict[str, tuple[float, float]]


@dataclass(frozen=True)
class Measured:
    """One sweep: runs, seconds of the clock and of all processors, and memory.

    `peak` and `worker_peak` are the most that this process and any worker had resident so far [MiB].
    """

    runs: int
    seconds: float
    cpu: float
    peak: float
    worker_peak: float
    file_mib: float


def main(arguments: list[str]) -> int:
    """Run the study, print the results, and return the exit status."""
    parser = argparse.ArgumentParser(prog="run.py", description="Memory and time of a sweep against its runs.")
    parser.add_argument("--runs", type=int, help="runs of the largest sweep; default: the small ones of config.toml")
    parser.add_argument("--out", type=Path, help="folder of the tables; default: a temporary one")
    options = parser.parse_args(arguments)
    try:
        config = load_model(CONFIG, Config)
        if options.runs is not None and options.runs < 64:
            raise InputError("is too few", key="--runs", value=options.runs, remedy="write 64 or more")
        sizes = config.runs if options.runs is None else tuple(round(options.runs * share) for share in config.full)
        if options.out is not None:
            return study(config, sizes, prepare_folder(options.out))
        with tempfile.TemporaryDirectory(prefix="surctl-scale-") as folder:
            return study(config, sizes, Path(folder))
    except InputError as error:
        print(error, file=sys.stderr)
        return error.exit_status


def study(config: Config, sizes: tuple[int, ...], out: Path) -> int:
    """Sweep and print; return 0 if the limits hold."""
    measure(config, min(64, *sizes), out / "compile")  # exclude the time of the compiler
    found = [measure(config, runs, out / str(runs)) for runs in sizes]
    print("| runs | seconds | of the processors | runs/s | peak memory [MiB] | of a worker [MiB] | table [MiB] |")
    print("|---|---|---|---|---|---|---|")
    for m in found:
        row = [f"{m.seconds:.1f}", f"{m.cpu:.1f}", f"{m.runs / m.seconds:.0f}", f"{m.peak:.0f}", f"{m.worker_peak:.0f}"]
        print(f"| {m.runs} | {' | '.join(row)} | {m.file_mib:.1f} |")
    runs, cpu = np.array([m.runs for m in found], dtype=float), np.array([m.cpu for m in found])
    slope, offset = np.polyfit(runs, cpu, 1)
    fit = 1.0 - np.sum((cpu - slope * runs - offset) ** 2) / np.sum((cpu - cpu.mean()) ** 2)
    line = f"{offset:.2f} s + {1e3 * slope:.4f} ms a run, R² = {fit:.4f} (bar {config.least_fit:g})"
    print(f"\nTime of the processors = {line}")
    peak = max(m.peak + config.workers * m.worker_peak for m in found)
    print(f"Peak memory, all processes together: at most {peak:.0f} MiB (bar {config.most_memory_mib:.0f} MiB)")
    return 0 if fit >= config.least_fit and peak <= config.most_memory_mib else 1


def measure(config: Config, runs: int, out: Path) -> Measured:
    """Run a sweep of the given number of points, one run each."""
    scenario = load_scenario(config.scenario)
    case = Case(scenario, load_vehicle(scenario.vehicle), load_gains("default"))
    design = spread("lhs", [Span(name, *ends) for name, ends in config.ranges.items()], count=runs)
    start, spent = time.perf_counter(), processors()
    subject, executor = MissionSweep((case,), linear=False), LocalExecutor(config.workers)
    sweep(subject, design, executor=executor, out=out, progress=tell)
    seconds, cpu = time.perf_counter() - start, processors() - spent
    own, workers = (resource.getrusage(w).ru_maxrss / 1024 for w in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return Measured(runs, seconds, cpu, own, workers, (out / "sweep.nc").stat().st_size / 2**20)


def processors() -> float:
    """Return the processor time [s] of this process and its finished workers."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


def tell(line: str) -> None:
    """Print progress on stderr."""
    print(f"  {line}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
