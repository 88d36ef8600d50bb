"""The steps that the examples of this study share: run, sweep, tuning, margins, claim, and the comparison with C."""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import casadi as ca
import numpy as np

from surctl.certcheck import check_document
from surctl.control import Gains, build_law, law_ref, law_source, load_gains
from surctl.errors import InputError
from surctl.export import Records, software_in_the_loop
from surctl.lyapunov import Dynamics, State, find_stability
from surctl.simulation import Case, Run, load_scenario, simulate, simulate_batch
from surctl.tuning import Goal, Request, build_cases, conditions, gain_ranges, tune
from surctl.vehicle import load_vehicle
from surctl.verification import law_loop, steady_motion
from surctl.verification.formula import from_casadi

HERE = Path(__file__).parent
VEHICLE, GAINS = load_vehicle("sur540-flooded"), load_gains("default")
SECONDS = 60.0  # limit of the processor time of a claim


def dynamics(
    name: str, states: Sequence[State], x: ca.SX, rates: Sequence[ca.SX], kind: str = "continuous"
) -> Dynamics:
    """Return the dynamics of the states x; `rates` are their successors if `kind` is `discrete`."""
    return Dynamics(name, kind, tuple(states), tuple(from_casadi(x, [s.name for s in states], list(rates))))


def proved(loop: Dynamics, about: str) -> bool:
    """Search and prove a region of attraction, print the verdict; return whether the checker accepts the proof."""
    result = find_stability(loop, degree=2, time_limit=SECONDS)
    if result.verdict != "proved" or result.decision is None:
        print(f"claim, {about}: {result.verdict}, {result.reason}")
        return False
    checked = check_document(dict(result.decision.document))
    share, level = f"{result.volume:.0%} of the box", f"level {result.ratio:.2f} of the least with a counterexample"
    print(f"claim, {about}: proved in {share}, {level}; checker: {checked.reason or 'accepted'}")
    return bool(checked.accepted)


def chain(
    law: str, mission: str, axes: Mapping[str, tuple[float, float]], goals: Sequence[Goal], doc: str | None
) -> bool:
    """Run the law through every step but the claim; return whether it arrives, is stable, and C equals Python.

    Args:
        law: FILE.py:FUNCTION, in this folder.
        mission: scenario file, in this folder.
        axes: two gains of the law with their ranges, for the sweep of 100 by 100 points and the tuning.
        goals: goals of the tuning.
        doc: description of the command line.
    """
    parser = argparse.ArgumentParser(description=doc)
    parser.add_argument("--quick", action="store_true", help="100 points instead of 10,000, and 32 trials")
    quick = parser.parse_args().quick
    reference = law_ref(law, folder=HERE)
    built, gains = build_law(reference), GAINS.with_own(law_source(reference).gains)
    scenario = load_scenario(str(HERE / mission))
    run = simulate(scenario, VEHICLE, gains=gains, law=built)
    print(f"one run: {run.metrics.stopped_because} at {run.metrics.time_s:.1f} s")

    sides = [np.linspace(low, high, 10 if quick else 100) for low, high in axes.values()]
    points = dict(zip(axes, (grid.ravel() for grid in np.meshgrid(*sides)), strict=True))
    case = Case(scenario, VEHICLE, gains, reference)
    simulate_batch(case, {name: values[:1] for name, values in points.items()})  # compiled before the clock runs
    began = time.process_time()
    runs = simulate_batch(case, points)
    spent = time.process_time() - began
    reached, took = runs.column("reached") > 0, runs.column("time_s")
    print(f"sweep: {reached.size:,} runs in {spent:.2f} s of processor time, {reached.sum():,} reached the goal, "
          f"in {took[reached].min():.1f} to {took[reached].max():.1f} s")  # fmt: skip

    tried = conditions(build_cases([scenario], [VEHICLE], gains=gains, law=reference), seeds=[0])
    ranges = gain_ranges(gains, axes)
    tuning = tune(Request(tuple(goals), tried, gains, ranges), trials=32 if quick else 128, rounds=1, runs=0)
    best = tuning.result.gains
    text = ", ".join(f"{name} = {value:.3g}" for name, value in best.items())
    print(f"tuned: {text}, score {tuning.result.score:.3f}, goals {'met' if tuning.result.feasible else 'missed'}")

    gains = gains.with_values(best)
    run = simulate(scenario, VEHICLE, gains=gains, law=built)
    stable = _margins(run, gains)
    record = run.record
    report = software_in_the_loop(built, Records(record.law_state, record.law_input, record.law_parameters))
    most = max(report.tau.absolute, report.state.absolute)
    print(f"C: {report.steps} steps, largest difference to Python {most:.1e}; invalid inputs: {report.fault_cases}, "
          f"{len(report.fault_failures)} failures")  # fmt: skip
    return bool(run.metrics.reached and stable and report.passed and most == 0.0)


def _margins(run: Run, gains: Gains) -> bool:
    """Print the margins about the steady motion of a run; return whether the loop is stable, or has no such motion."""
    try:
        at = steady_motion(run)
    except InputError as error:
        print(f"margins: not judged, {error.problem}")
        return True
    loop = law_loop(run.law, VEHICLE, gains, cruise=run.scenario.cruise, at=at)
    print(*loop.lines(), sep="\n")
    return loop.stable
