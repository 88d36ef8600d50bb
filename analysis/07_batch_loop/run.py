"""Study 7: the time of a control period of the compiled closed loop, compared with other implementations.

    python analysis/07_batch_loop/run.py [--check] [--out DIR] [--bars]

Prints Markdown and saves `results.csv`. The exit status is 0 if all contenders simulate the same runs, and 1 otherwise;
with --bars it is also 1 if a speed limit is missed; 2 for a bad option or folder, or without a C compiler.
"""

from __future__ import annotations

import argparse
import csv
import os
import platform
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE / "peers"), str(HERE.parents[1])]

from contender import Contender, fit, race, ratio  # noqa: E402
from hand import FLAGS, HandLoop  # noqa: E402
from python_loop import control_step, flown_by, matched, scipy_step  # noqa: E402
from scene import COUNTED, luck_of, scene_of  # noqa: E402

from surctl.errors import InputError, ToolMissing  # noqa: E402
from surctl.files import Strict, load_model, prepare_folder  # noqa: E402
from surctl.ir import to_casadi  # noqa: E402
from surctl.ir.cache import compiler_version  # noqa: E402
from surctl.marine.control import GAINS, Gains, load_gains  # noqa: E402
from surctl.marine.simulation import METRICS, Case, Sensing, load_scenario, simulate, simulate_batch  # noqa: E402
from surctl.marine.simulation.batch.engines import Packed, structure_of  # noqa: E402
from surctl.marine.simulation.batch.loop import build_loop  # noqa: E402
from surctl.marine.vehicle import load_vehicle, plant_parameters  # noqa: E402
from surctl.priority import Mode  # noqa: E402
from tests.oracles.mission_loop import simulate as in_numpy  # noqa: E402

Array: TypeAlias = NDArray[np.float64]

OURS, REFERENCE, THREADS = "simulate_batch", "simulate", "2 threads"
MAP, ACCUM, NUMBA, HAND = "CasADi map", "CasADi mapaccum", "numba", "hand-written C"
SCIPY, CONTROL = "scipy solve_ivp", "python-control"
PACKAGES = ("numpy", "casadi", "scipy", "control", "numba")
VARIED = ("k_v", "lookahead", "k_psi", "k1")  # gains that a turn varies at random for every run, by up to 10 %
_DT = 0.05


class Size(Strict):
    """How much is simulated."""

    cases: tuple[tuple[str, Sensing, Mode], ...]
    builds: tuple[str, ...]
    longest_s: float = float("inf")
    rounds: int
    runs: int
    machine_runs: int
    machine_ticks: int
    machine_every: int
    python_ticks: int
    growth: bool
    numba: bool
    gain_sets: int
    steps: int
    many_rounds: int


class Config(Strict):
    """The contents of config.toml."""

    kind: Literal["batch-loop"]
    gains: str
    seed: int
    tolerance: float
    bars: dict[str, float]
    full: Size
    quick: Size


def main(arguments: list[str]) -> int:
    """Run the study; the exit status."""
    parser = argparse.ArgumentParser(
        prog="run.py", description="Compare the time of the closed loop with other implementations."
    )
    parser.add_argument("--check", action="store_true", help="few runs: shows that all agree; times are not reliable")
    parser.add_argument("--out", type=Path, help="folder of results.csv; default: a new temporary one")
    parser.add_argument("--bars", action="store_true", help="exit status 1 if a speed limit is missed")
    options = parser.parse_args(arguments)
    try:
        config = load_model(HERE / "config.toml", Config)
        out = prepare_folder(options.out or Path(tempfile.mkdtemp(prefix="surctl-batch-")))
        return study(config, config.quick if options.check else config.full, out, strict=options.bars)
    except (InputError, ToolMissing) as error:
        print(error, file=sys.stderr)
        return 2


def study(config: Config, size: Size, out: Path, *, strict: bool) -> int:
    """Time every case, then the growth and many gain sets; print and save."""
    print_machine()
    gains, right, held = load_gains(config.gains), True, True
    table: list[list[str]] = []
    with tempfile.TemporaryDirectory() as folder:
        hand = {name: HandLoop(Path(folder), flags) for name, flags in FLAGS.items() if name in size.builds}
        for name, sensing, mode in size.cases:
            scenario = load_scenario(name)
            scenario = replace(scenario, time_limit=min(scenario.time_limit, size.longest_s))
            case = Case(scenario, load_vehicle(scenario.vehicle), gains, mode=mode, sensing=sensing)
            start = time.perf_counter()
            simulate_batch(case, seeds=config.seed)
            print(f"\n## {name}, {sensing}, {mode}\n\nReady after {time.perf_counter() - start:.1f} s (0 when cached).")
            right &= agree(case, hand, config, numba=size.numba)
            contenders = list(taking_part(case, hand, size, config.seed))
            race(contenders, rounds=size.rounds)
            table += print_times([name, sensing, mode], contenders)
            held &= print_bars(contenders, config.bars)
            held &= print_many(case, size, wanted=config.bars[THREADS])
    if size.growth:
        print_growth(Case(*first_case(size), gains), size)
    save(table, out / "results.csv")
    print(f"\nTable: {out / 'results.csv'}")
    return 0 if right and (held or not strict) else 1


def first_case(size: Size) -> tuple[Any, Any]:
    """Return scenario and vehicle of the first case."""
    scenario = load_scenario(size.cases[0][0])
    return scenario, load_vehicle(scenario.vehicle)


def drawn(gains: Gains, runs: int) -> dict[str, Array]:
    """Return gains of the given number of runs, by name."""
    rng = np.random.default_rng(1)
    return {name: gains[name] * rng.uniform(0.9, 1.1, runs) for name in VARIED}


def gain_table(gains: Gains, values: dict[str, Array], runs: int) -> Array:
    """Return gains (runs, 17) in the order of `GAINS`; the hand-written loops have no sonars, use LOS and never stop
    in dead ends.
    """
    kept = [name for name in GAINS if name not in ("spin", "ilos_sigma", "alos_gamma", "patience")]
    return np.column_stack([values.get(name, np.full(runs, gains[name])) for name in kept])


def agree(case: Case, hand: dict[str, HandLoop], config: Config, *, numba: bool) -> bool:
    """Print and return whether all get the metrics of `simulate` for one run, and of `simulate_batch` for some runs."""
    runs, seeds = 8, np.arange(config.seed, config.seed + 8)
    values = drawn(case.gains, runs)
    batch = simulate_batch(case, values, seeds=seeds).table
    scene, gains = scene_for(case), gain_table(case.gains, values, runs)
    luck = luck_of(case.scenario, case.vehicle, seeds)
    others = {f"{HAND} {name}": loop.run(scene, gains, luck, seeds.astype(np.uint64)) for name, loop in hand.items()}
    if numba and find_spec("numba"):
        import numba_loop

        others[NUMBA] = numba_loop.fly_many(scene, gains, luck, seeds.astype(np.uint64))
    chosen = case.gains.with_values({name: float(column[0]) for name, column in values.items()})
    once = simulate(
        case.scenario, case.vehicle, gains=chosen, law=case.build(), sensing=case.sensing, seed=int(seeds[0])
    )
    gaps = {REFERENCE: gap(np.array([once.metrics.row()]), batch[:1])}
    gaps |= {name: gap(table[:, COUNTED], batch[:, COUNTED]) for name, table in others.items()}
    print_rows(["the same runs", "largest difference of a figure"], [[n, f"{g:.1e}"] for n, g in gaps.items()])
    wrong = [name for name, size in gaps.items() if not size <= config.tolerance]
    for name in wrong:
        print(f"\n**Wrong**: {name} simulates something else.")
    return not wrong


def gap(found: Array, wanted: Array) -> float:
    """Return the largest difference; inf if only one value is a number."""
    if (np.isnan(found) != np.isnan(wanted)).any():
        return float("inf")
    same = (found == wanted) | np.isnan(found)
    return float(np.max(np.where(same, 0.0, np.abs(np.where(same, 0.0, found) - np.where(same, 0.0, wanted)))))


def scene_for(case: Case) -> Array:
    """Return the case for the hand-written loops."""
    sonar, projected = case.sensing == "sonar", case.mode == "projected"
    return scene_of(case.scenario, case.vehicle, sonar=sonar, projected=projected)


def steps_of(table: Array) -> float:
    """Return the number of control periods of all runs."""
    return float(np.sum(np.rint(table[:, list(METRICS).index("time_s")] / _DT) + 1))


def taking_part(case: Case, hand: dict[str, HandLoop], size: Size, seed: int) -> Iterator[Contender]:
    """Return all contenders of a case; fast ones simulate whole runs, those in Python the first steps of one run."""
    runs = size.runs
    values, seeds = drawn(case.gains, runs), np.arange(seed, seed + runs)
    scene, gains = scene_for(case), gain_table(case.gains, values, runs)

    def by_hand(run: Callable[..., Array]) -> Callable[[], float]:
        whole = seeds.astype(np.uint64)
        return lambda: steps_of(run(scene, gains, luck_of(case.scenario, case.vehicle, seeds), whole))

    yield Contender(OURS, lambda: steps_of(simulate_batch(case, values, seeds=seeds).table), runs)
    for name, loop in hand.items():
        yield Contender(f"{HAND} {name}", by_hand(loop.run), runs)
    if size.numba and find_spec("numba"):
        import numba_loop

        yield Contender(NUMBA, by_hand(numba_loop.fly_many), runs)
    yield from through_machine(case, values, size, seeds)

    short = replace(case.scenario, time_limit=size.python_ticks * _DT)
    law = case.build()

    def fly(run_of: Callable[..., Any] = simulate) -> float:
        run = run_of(short, case.vehicle, gains=case.gains, law=law, sensing=case.sensing, seed=seed)
        return float(len(run.record.time))

    def other(step: Any) -> Callable[[], float]:
        def flown() -> float:
            with flown_by(step):
                return fly(in_numpy)

        return flown

    yield Contender(REFERENCE, fly, 1)
    record = simulate(case.scenario, case.vehicle, gains=case.gains, law=law, sensing=case.sensing, seed=seed).record
    ticks = list(ticks_of(case, record))
    for name, make in ((SCIPY, lambda rtol: scipy_step("RK45", rtol)), (CONTROL, control_step)):
        rtol, error = matched(make, ticks)
        print(f"\n{name}: tolerance {rtol:.0e}, error per step {error:.1e}.")
        yield Contender(name, other(make(rtol)), 1)


def through_machine(case: Case, values: dict[str, Array], size: Size, seeds: NDArray[np.int_]) -> Iterator[Contender]:
    """Return CasADi's virtual machine: one step of all runs per call (`map`), and many steps of a run per call
    (`mapaccum`).
    """
    runs, ticks = size.machine_runs, size.machine_ticks
    few = {name: column[:runs] for name, column in values.items()}
    short = replace(case, scenario=replace(case.scenario, time_limit=ticks * _DT))
    machine = {"seeds": seeds[:runs], "engine": "vm"}
    yield Contender(MAP, lambda: steps_of(simulate_batch(short, few, **machine).table), runs, size.machine_every)
    loop = build_loop(structure_of(case, few))
    packed = Packed(case, loop, few, seeds[:runs].astype(np.int64))
    many = to_casadi(loop.step).mapaccum(ticks)

    def accumulated() -> float:
        many(packed.state[0], np.tile(packed.parameters[0][:, None], ticks))
        return float(ticks)

    yield Contender(ACCUM, accumulated, 1, size.machine_every)


def ticks_of(case: Case, record: Any) -> Iterator[tuple[Array, Array, Array, Array]]:
    """Return state, thrust command, disturbance and parameters of some steps; the thrust lags behind the previous
    command.
    """
    p = plant_parameters(case.vehicle)
    still = np.array([*case.scenario.disturbance.current_m_per_s, *[0.0] * 5])
    for k in range(1, len(record.time), max(1, len(record.time) // 8)):
        yield np.concatenate([record.eta[k], record.nu[k], record.tau[k - 1]]), record.tau[k], still, p


def print_times(case: list[str], contenders: Sequence[Contender]) -> list[list[str]]:
    """Print one row per contender; return the rows to save."""
    ours, rows = contenders[0], []
    for c in contenders:
        cpu, wall = c.per_step(), c.per_step(clock=True)
        per_second = np.max(np.array(c.runs) / np.array(c.wall))
        whole = f"{per_second:.3g}" if c.runs > 1 and not c.name.startswith("CasADi") else ""
        times = f"{ratio(c, ours):.3g}"
        usual = f"{np.median(cpu) / np.median(ours.per_step()):.3g}"
        rows.append([c.name, f"{cpu.min():.4g}", f"{np.median(cpu):.4g}", f"{wall.min():.4g}", whole, times, usual])
    header = ["who", "µs a step", "median", "µs of the clock", "runs a second", "of ours", "medians"]
    print_rows(header, rows)
    return [[*case, *row] for row in rows]


def print_bars(contenders: Sequence[Contender], bars: dict[str, float]) -> bool:
    """Print the limits for one thread; return whether all hold. Of several builds of a contender the fastest counts."""
    ours, rows, held = contenders[0], [], True
    for name, wanted in bars.items():
        if name == THREADS:
            continue
        ratios = [ratio(c, ours) for c in contenders if c.name == name or (name == HAND and c.name.startswith(HAND))]
        measured = min(ratios, default=float("nan"))
        verdict = "not measured" if not ratios else "holds" if measured >= wanted else "**missed**"
        held &= verdict == "holds"
        rows.append([f"{name} / {OURS}", f"{measured:.3g}", f"{wanted:g}", verdict])
    print_rows(["bar", "measured", "required", ""], rows)
    return held


def print_growth(case: Case, size: Size) -> None:
    """Print the growth of the time of a batch with steps, runs, obstacles and threads."""
    rows = []

    def measured(what: str, unit: str, points: Sequence[tuple[float, Callable[[], Any]]]) -> None:
        turns = [Contender(f"{x:g}", lambda go=go: steps_of(go().table), 1) for x, go in points]
        race(turns, rounds=size.rounds)
        x, y = [p[0] for p in points], [min(t.cpu) for t in turns]
        line = fit(x, y)
        shown = ", ".join(f"{a:g}: {b:.3g} s" for a, b in zip(x, y, strict=True))
        rows.append([what, shown, f"{line.slope:.3g} s {unit}", f"{line.intercept:.2g} s", f"{line.r2:.5f}"])

    def batch(runs: int, ticks: int, obstacles: int) -> Callable[[], Any]:
        scenario = replace(case.scenario, time_limit=ticks * _DT, obstacles=case.scenario.obstacles[:obstacles])
        values = drawn(case.gains, runs)
        return lambda: simulate_batch(replace(case, scenario=scenario), values)

    runs = size.runs
    measured("steps", "a step", [(n, batch(runs, n, 4)) for n in (100, 200, 400, 800)])
    measured("runs", "a run", [(n, batch(n, 400, 4)) for n in (runs, 2 * runs, 3 * runs, 4 * runs)])
    measured("obstacles", "an obstacle", [(n, batch(runs, 400, n)) for n in (0, 2, 4)])
    print(f"\n## Growth of {case.name}, one thread, time of the processor ({runs} runs, 400 steps, 4 obstacles)")
    print_rows(["grows with", "points", "slope", "intercept", "R²"], rows)


def print_many(case: Case, size: Size, *, wanted: float) -> bool:
    """Time many gain sets on one thread and on two, alternately; return whether two reach the required ratio."""
    scenario = replace(case.scenario, time_limit=size.steps * _DT)
    values = drawn(case.gains, size.gain_sets)
    print(f"\n### {size.gain_sets} gain sets, up to {size.steps} steps each")
    spent: dict[int, list[tuple[float, float]]] = {1: [], 2: []}
    flown = 0.0
    for _ in range(size.many_rounds):
        for threads, turns in spent.items():
            start, cpu = time.perf_counter(), time.process_time()
            table = simulate_batch(replace(case, scenario=scenario), values, threads=threads).table
            turns.append((time.perf_counter() - start, time.process_time() - cpu))
            flown = steps_of(table)
    least = {threads: [min(column) for column in zip(*turns, strict=True)] for threads, turns in spent.items()}
    rows = [[str(n), f"{clock:.3g}", f"{cpu:.3g}", f"{flown:.4g}"] for n, (clock, cpu) in least.items()]
    print_rows(["threads", "wall-clock time [s]", "processor time [s]", "steps simulated"], rows)
    faster = least[1][0] / least[2][0]
    verdict = "holds" if faster >= wanted else "**missed**"
    row = ["one thread / two, wall-clock time", f"{faster:.3g}", f"{wanted:g}", verdict]
    print_rows(["bar", "measured", "required", ""], [row])
    return faster >= wanted


def print_rows(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A Markdown table."""
    print("\n| " + " | ".join(header) + " |\n" + "|---" * len(header) + "|")
    for row in rows:
        print("| " + " | ".join(row) + " |")


def print_machine() -> None:
    """Print processor, load, system, compiler, flags and versions."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    name = next((line.partition(": ")[2] for line in lines if line.startswith("model name")), platform.processor())
    print(f"Machine: {name}, {os.cpu_count()} cores, {platform.system()} {platform.machine()}, {compiler_version()}")
    print(f"\nLoad before: {', '.join(f'{x:.1f}' for x in os.getloadavg())} (runnable programs over 1, 5, 15 minutes)")
    print(f"\nVersions: Python {platform.python_version()}, {', '.join(filter(None, map(installed, PACKAGES)))}")
    print(f"\nFlags of the loop by hand: {'; '.join(' '.join(flags) for flags in FLAGS.values())}")


def installed(package: str) -> str:
    """Return name and version of a package, or an empty text."""
    try:
        return f"{package} {version(package)}"
    except PackageNotFoundError:
        return ""


def save(table: list[list[str]], path: Path) -> None:
    """Save one line per case and contender."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        times = "us us_median us_clock runs_per_s of_ours of_ours_median"
        writer.writerow(["scenario", "sensing", "mode", "who", *times.split()])
        writer.writerows(table)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
