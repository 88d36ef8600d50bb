"""Study 19: whole runs with the exported controller, in its own process and on an emulated Cortex-M4F.

    python analysis/19_processor_in_the_loop/run.py [--quick]

Prints Markdown. The exit status is 0 if every statement holds, 1 otherwise, and 2 for a bad option or a missing tool.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from surctl.errors import InputError
from surctl.export import REALS, SerialLine, connect, emulated, emulated_target, write_bundle
from surctl.export.precision import Rounded
from surctl.ir import Real
from surctl.ir.cache import compile_program
from surctl.marine.control import Gains, Law, build_law, load_gains
from surctl.marine.export import LinkedLaw, LinkFaults, build_bundle, closed_form
from surctl.marine.export.compiled_law import LinkReport
from surctl.marine.simulation import Run, Scenario, Sensing, law_numbers, load_scenario, simulate
from surctl.marine.simulation.loop import Stepper
from surctl.marine.vehicle import Vehicle, load_vehicle

SCENARIO = "pool-static"
PROCESSOR = "cortex-m4f"
LOSSES = (0.1, 0.2, 0.4)
DELAYS = (0.1, 0.2, 0.25)
SEEDS = 5
QUICK_S = 1.0
"""Simulated time of a run with --quick [s]."""


@dataclass(frozen=True)
class Setup:
    """A law, with its scenario, vehicle and gains."""

    scenario: Scenario
    vehicle: Vehicle
    gains: Gains
    law: Law
    sensing: Sensing

    def fly(self, stepper: Stepper, seed: int = 0) -> Run:
        """One run."""
        return simulate(
            self.scenario,
            self.vehicle,
            gains=self.gains,
            law=self.law,
            sensing=self.sensing,
            seed=seed,
            stepper=stepper,
        )

    def linked(self, line: SerialLine, faults: LinkFaults) -> LinkedLaw:
        """Return a stepper over a connection."""
        return LinkedLaw(self.law, law_numbers(self.scenario, self.gains, self.vehicle), line, faults)


@dataclass(frozen=True)
class Flight:
    """A run over a connection, and its wall-clock time."""

    sensing: str
    run: Run
    report: LinkReport
    seconds: float


def main(arguments: list[str]) -> int:
    """Run the study, print the results, and return the exit status."""
    unknown = [a for a in arguments if a != "--quick"]
    if unknown:
        print(f"{unknown[0]}: unknown option; the only one is --quick", file=sys.stderr)
        return 2
    try:
        return study(quick="--quick" in arguments)
    except InputError as error:
        print(error, file=sys.stderr)
        return error.exit_status


def study(*, quick: bool) -> int:
    """Simulate and print; return 0 if every statement holds."""
    flights, said = [], []
    for sensing in ("truth",) if quick else ("truth", "sonar"):
        setup = set_up(sensing, quick=quick)
        with on_processor(setup, quick=quick) as line:
            flights.append(flown(setup, line))
            if quick:
                bad = faulty(setup, line, seeds=1)
        # with sonars in float alone: the law takes a minute to compile
        for real in () if quick else REALS if sensing == "truth" else ("float32",):
            with as_process(setup, real) as line:
                flights.append(flown(setup, line))
                if sensing == "truth" and real == "float32":
                    bad = faulty(setup, line, seeds=SEEDS)
        if sensing == "truth":
            own = setup.fly(Rounded(setup.law).step)
            said.append(
                (f"the run with the {PROCESSOR} equals that of the law in Python in float", same(own, flights[0].run))
            )
    print_flights(flights)
    said += [
        ("every reply has the bytes of Python", not any(f.report.differing for f in flights)),
        ("every step has a reply", all(f.report.answered == f.report.steps > 0 for f in flights)),
    ]
    if not quick:
        said.append(("every run arrives", all(f.run.metrics.reached for f in flights)))
    said += print_faulty(bad)
    print("| statement | |\n|---|---|")
    for text, holds in said:
        print(f"| {text} | {'holds' if holds else '**does not hold**'} |")
    return 0 if all(holds for _, holds in said) else 1


def set_up(sensing: Sensing, *, quick: bool) -> Setup:
    """Return the scenario with the law with sonars, or with the law on true positions."""
    scenario = load_scenario(SCENARIO)
    if quick:
        scenario = replace(scenario, time_limit=QUICK_S)
    vehicle = load_vehicle(scenario.vehicle)
    law = build_law(sonar=sensing == "sonar", equipment=scenario.sensors.on(vehicle["radius"]))
    return Setup(scenario, vehicle, load_gains("default"), law, sensing)


@contextmanager
def on_processor(setup: Setup, *, quick: bool) -> Iterator[SerialLine]:
    """Return a connection to the law in float on the emulated processor; `quick` compiles faster."""
    p = law_numbers(setup.scenario, setup.gains, setup.vehicle)
    bundle = build_bundle(closed_form(setup.law, real="float32"), setup.law.gains.unpack(p), real="float32")
    target = emulated_target(PROCESSOR)
    if quick:
        target = replace(target, flags=tuple("-O0" if flag == "-O2" else flag for flag in target.flags))
    with tempfile.TemporaryDirectory() as folder, emulated(bundle, target, Path(folder) / "bundle") as line:
        yield line


@contextmanager
def as_process(setup: Setup, real: Real) -> Iterator[SerialLine]:
    """Return a connection to the law as a process on this machine."""
    p = law_numbers(setup.scenario, setup.gains, setup.vehicle)
    bundle = build_bundle(closed_form(setup.law, real=real), setup.law.gains.unpack(p), real=real)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_bundle(bundle, folder / "bundle")
        sources = [folder / "bundle" / file for file in ("controller.c", "link.c", *bundle.sources)]
        program = compile_program(sources, folder / "controller")
        process = subprocess.Popen([str(program), "0"], stdout=subprocess.PIPE, text=True)
        try:
            assert process.stdout is not None
            with connect(process.stdout.readline().split()[-1]) as line:
                line.name = "process over TCP/IP"
                yield line
        finally:
            process.kill()
            process.communicate()


def flown(setup: Setup, line: SerialLine, faults: LinkFaults | None = None, seed: int = 0) -> Flight:
    """Simulate one run over a connection."""
    stepper = setup.linked(line, faults or LinkFaults())
    began = time.perf_counter()
    run = setup.fly(stepper, seed)
    return Flight(setup.sensing, run, stepper.report(), time.perf_counter() - began)


def faulty(setup: Setup, line: SerialLine, *, seeds: int) -> list[tuple[LinkFaults, list[Flight]]]:
    """Simulate runs over bad connections."""
    wrong = [*(LinkFaults(loss=loss) for loss in LOSSES), *(LinkFaults(delay=delay) for delay in DELAYS)]
    wrong = [LinkFaults(loss=max(LOSSES)), LinkFaults(delay=max(DELAYS))] if seeds == 1 else wrong
    return [
        (faults, [flown(setup, line, replace(faults, seed=seed), seed) for seed in range(seeds)]) for faults in wrong
    ]


def same(mine: Run, other: Run) -> bool:
    """Return whether two runs are equal to the last bit."""
    pairs = [(getattr(mine.record, name), getattr(other.record, name)) for name in ("eta", "nu", "tau", "law_input")]
    pairs += [(mine.record.law_state[1:], other.record.law_state[1:]), (mine.record.status, other.record.status)]
    return all(np.array_equal(a, b) for a, b in pairs)


def print_flights(flights: Sequence[Flight]) -> None:
    """Print one row per run."""
    print(f"## Runs of `{SCENARIO}`, seed 0\n")
    print(
        "| law | controller | numbers | steps | answered | with other bytes | run | least clearance [m] |"
        " numbers of state a step | reply, mean [ms] |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    for f in flights:
        m, r, states = f.run.metrics, f.report, f.run.law.state.size
        print(
            f"| {f.sensing} | {r.name} | {r.real} | {r.steps} | {r.answered} | {r.differing} | {m.stopped_because} at"
            f" {m.time_s:.2f} s | {m.min_clearance_m:.4f} | {states} | {r.round_trip_ms[0]:.2f} |"
        )
    print()


def print_faulty(bad: Sequence[tuple[LinkFaults, Sequence[Flight]]]) -> list[tuple[str, bool]]:
    """Print one row per fault; return the statements about them."""
    print("## Bad connections, law with true positions, a command held for 0.25 s\n")
    print("| connection | runs | arrived | collided | mean time [s] | least clearance [m] | zero thrust [%] |")
    print("|---|---|---|---|---|---|---|")
    for faults, flights in bad:
        what = f"loss {faults.loss:g} each way" if faults.loss else f"replies {faults.delay:g} s late"
        metrics = [f.run.metrics for f in flights]
        seconds, least = np.mean([m.time_s for m in metrics]), min(m.min_clearance_m for m in metrics)
        zero = 100 * sum(f.report.failsafe for f in flights) / sum(f.report.steps for f in flights)
        print(
            f"| {what} | {len(flights)} | {sum(m.reached for m in metrics)} |"
            f" {sum(m.stopped_because == 'collision' for m in metrics)} |"
            f" {seconds:.1f} | {least:.3f} | {zero:.1f} |"
        )
    print()
    everything = [f for _, flights in bad for f in flights]
    return [
        (
            "with a bad connection, too, every reply has the bytes of Python",
            not any(f.report.differing for f in everything),
        ),
        (
            "lost messages are counted where messages are lost, and nowhere else",
            all((sum(f.report.lost) > 0) == (faults.loss > 0) for faults, flights in bad for f in flights),
        ),
    ]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
