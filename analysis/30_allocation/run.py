"""Study 30: allocation of force and yaw moment to thrusters: exactness, cost in the exported C, failed thrusters.

    python analysis/30_allocation/run.py [--quick]

Prints Markdown. Ends with 0 if every limit at the end holds, else with 1; with 2 for a bad option. `--quick` takes
fewer force commands and runs, and counts no instructions. Instructions are counted by Valgrind on this machine, for the
whole step of the exported controller, guard included.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from surctl.export import Records, build_controller  # noqa: E402
from surctl.export.envelope import as_records  # noqa: E402
from surctl.ir.native import runnable  # noqa: E402
from surctl.marine.allocation.program import allocation_block  # noqa: E402
from surctl.marine.control import Law, build_law, load_gains  # noqa: E402
from surctl.marine.export import build_bundle, closed_form, operating_envelope  # noqa: E402
from surctl.marine.simulation import Case, ThrusterFault, law_numbers, load_scenario, simulate, simulate_batch  # noqa: E402
from surctl.marine.vehicle import Actuators, Thruster, Vehicle, attainable, load_vehicle  # noqa: E402
from surctl.priority import Level, Row, build_problem, solve  # noqa: E402
from tests.allocation.enumeration import Enumeration  # noqa: E402

Array = NDArray[np.float64]
Runner = Callable[..., list[Array]]

EXACT, MOST_INSTRUCTIONS = 1e-9, 3_000
SIX, EIGHT = "bluerov2-thrusters", "bluerov2-heavy"
CASES: tuple[tuple[str, tuple[int, ...], float], ...] = (
    (SIX, (), 1.0), ("skewed", (), 1.0), (EIGHT, (), 1.0),
    (SIX, (1,), 0.1), ("skewed", (1,), 0.1), (EIGHT, (1,), 0.1), (EIGHT, (1, 6), 0.1),
)  # fmt: skip
"""Thrusters, those that failed, and the share of the commands that is tried."""


def skewed() -> Actuators:
    """Six thrusters in no special direction, so that every three of them span a facet of the attainable set."""
    rng, thrusters = np.random.default_rng(5), []
    for k in range(6):
        push = rng.normal(size=3)
        push /= np.linalg.norm(push)
        forward, reverse = rng.uniform(10, 40, 2)
        x, y, z = rng.uniform(-0.4, 0.4, 3)
        curve = ((-1.0, -reverse), (0.0, 0.0), (1.0, forward))
        thrusters.append(Thruster(f"T{k}", (x, y, z), tuple(push.tolist()), forward, reverse, curve))
    return Actuators(tuple(thrusters))


def thrusters_of(name: str) -> Actuators:
    """Return the thrusters of a library vehicle, or the skewed ones."""
    if name == "skewed":
        return skewed()
    actuators = load_vehicle(name).actuators
    assert actuators is not None
    return actuators


@cache
def allocator(name: str) -> Runner:
    """Return their allocation, to be run."""
    return runnable(allocation_block(thrusters_of(name)))


def commands(actuators: Actuators, count: int, *, seed: int = 0) -> Array:
    """Force commands (count, 4): normally distributed, from well inside the attainable set to ten times beyond it."""
    rng = np.random.default_rng(seed)
    most = np.abs(attainable(actuators).intervals()).max(axis=1)
    found = rng.normal(size=(count, 4)) * most * rng.choice([0.1, 0.3, 1.0, 3.0, 10.0], (count, 1))
    found[::10, int(rng.integers(4))] = 0.0
    return found


def exactness(
    count: int, cases: tuple[tuple[str, tuple[int, ...], float], ...] = CASES
) -> tuple[list[str], float, float]:
    """Lines, largest error of a thruster force [N], largest violation of a limit or of a curve's inverse."""
    lines = [
        "| thrusters | failed | commands | reached | error of force, N | of total, N | beyond a limit, N | curve, N |",
        "|---|---|---|---|---|---|---|---|",
    ]
    worst, breach = 0.0, 0.0
    for name, failed, share in cases:
        actuators, runner = thrusters_of(name), allocator(name)
        working = np.ones(len(actuators.thrusters))
        working[list(failed)] = 0.0
        reference = Enumeration(actuators, working)
        tries = commands(actuators, max(1, int(share * count)))
        errors = np.zeros(4)
        inside = 0
        for wrench in tries:
            achieved, forces, orders = runner(wrench, working)
            expected = reference.solve(wrench)
            inside += bool(np.abs(achieved - wrench).max() < EXACT)
            over = [max(f - on * t.forward, -on * t.reverse - f) for f, t, on in _each(forces, actuators, working)]
            inverse = [
                abs(t.force(float(c)) - f)
                for c, (f, t, _) in zip(orders, _each(forces, actuators, working), strict=True)
            ]
            errors = np.maximum(
                errors,
                [
                    np.abs(forces - expected).max(),
                    np.abs(achieved - actuators.matrix @ expected).max(),
                    max(0.0, *over),
                    max(inverse),
                ],
            )
        listed = ", ".join(actuators.names[k] for k in failed) or "none"
        lines.append(
            f"| {name} | {listed} | {len(tries)} | {inside / len(tries):.0%} | "
            + " | ".join(f"{e:.1e}" for e in errors)
            + " |"
        )
        worst, breach = max(worst, errors[0], errors[1]), max(breach, errors[2], errors[3])
    return lines, worst, breach


def _each(forces: Array, actuators: Actuators, working: Array) -> list[tuple[float, Thruster, float]]:
    return list(zip(forces.tolist(), actuators.thrusters, working.tolist(), strict=True))


def against_the_lexicographic_solver(count: int) -> tuple[list[str], float]:
    """Lines, and the largest difference [N] from `surctl.priority.solve`, also for swivelling jets."""
    lines, worst = ["| thrusters | commands | largest difference of a force, N |", "|---|---|---|"], 0.0
    for name in (SIX, EIGHT, "sur540-jets"):
        actuators = thrusters_of(name)
        runner, rows = allocator(name), list[Row]()
        for thruster, where in zip(actuators.thrusters, actuators.slices, strict=True):
            for k, (normal, bound) in enumerate(zip(*thruster.sides, strict=True)):
                wide = np.zeros(actuators.matrix.shape[1])
                wide[where] = normal
                rows.append(Row(f"{thruster.name}.{k}", "actuator", wide, -np.inf, float(bound)))
        here = 0.0
        for wrench in commands(actuators, count, seed=1):
            levels = [Level(n, actuators.matrix[list(axes)], wrench[list(axes)]) for n, axes in actuators.levels]
            expected = solve(build_problem(levels, rows), mode="lexicographic", backend="daqp").v
            here = max(here, float(np.abs(runner(wrench, np.ones(len(actuators.thrusters)))[1] - expected).max()))
        worst = max(worst, here)
        lines.append(f"| {name} | {count} | {here:.1e} |")
    return lines, worst


def instructions() -> tuple[list[str], float]:
    """Lines, and the largest number of instructions that the allocation adds to a step of six thrusters."""
    lines = [
        "| vehicle | commands | no allocation, mean / max | with it, mean / max | added to a step, mean / max |",
        "|---|---|---|---|---|",
    ]
    most = 0.0
    for name in (SIX, EIGHT, "sur540-jets"):
        vehicle = load_vehicle(name)
        for what, factor in (("a run of tank-static", 1.0), ("as if 30 times heavier", 30.0)):
            base, allocated = (_counts(vehicle, actuators, factor) for actuators in (None, vehicle.actuators))
            added = allocated - base
            lines.append(
                f"| {name} | {what} | {base.mean():.0f} / {base.max()} | {allocated.mean():.0f} / {allocated.max()} | "
                f"{added.mean():.0f} / {added.max()} |"
            )
            if name == SIX:
                most = max(most, float(added.max()))
    return lines, most


def _counts(vehicle: Vehicle, actuators: Actuators | None, factor: float) -> NDArray[np.int64]:
    """Instructions of each step of an exported controller over the records of one run.

    With a heavier model, the law commands `factor` times as much thrust; its limits are raised as well, so that the
    commands leave the attainable set.
    """
    mission, gains = load_scenario("tank-static"), load_gains("default")
    run = simulate(mission, vehicle, gains=gains, law=build_law(actuators=vehicle.actuators))
    law = build_law(actuators=actuators)
    limits = {name: factor * vehicle[name] for name in ("m11", "m22", "m44", "Fu_max", "Fv_max", "Fw_max", "Fr_max")}
    believed = replace(vehicle, parameters={
        key: replace(p, value=limits.get(key, p.value), range=None) for key, p in vehicle.parameters.items()
    })  # fmt: skip
    numbers = law_numbers(mission, gains, believed)
    record = run.record
    inputs = record.law_input if actuators is not None else record.law_input[:, : law.inputs.size]
    records = Records(record.law_state, inputs, numbers)
    shipped = closed_form(law)
    within = operating_envelope(law, mission, believed, shipped.gains)
    bundle = build_bundle(shipped, law.gains.unpack(numbers), envelope=within)
    with tempfile.TemporaryDirectory() as scratch:
        controller = build_controller(shipped, bundle, Path(scratch, "b"))
        step, out = f"{bundle.name}_step", Path(scratch, "counts")
        load = np.zeros(len(inputs), dtype=bool)
        load[:] = True
        options = (f"--toggle-collect={step}", f"--dump-after={step}", "--combine-dumps=yes")
        command = ["valgrind", "--tool=callgrind", *options, f"--callgrind-out-file={out}", *controller.command]
        stream = controller.stream(as_records(shipped, records), load=load)
        subprocess.run(command, input=stream, capture_output=True, check=True)
        counts = [int(n) for n in re.findall(r"^summary: (\d+)", out.read_text(), flags=re.MULTILINE)]
    return np.array([n for n in counts if n > 0], dtype=np.int64)


def failures(runs: int) -> tuple[list[str], int, int]:
    """Lines, number of runs with a failed thruster, and how many of them arrive without a collision."""
    mission, vehicle, gains = load_scenario("tank-static"), load_vehicle(EIGHT), load_gains("default")
    lines = [
        "| cruise, m/s | failed | runs | arrived | collided | time, s | path error, m | least clearance, m |",
        "|---|---|---|---|---|---|---|---|",
    ]
    total = arrived = 0
    for cruise in (0.2, 0.45):
        scenario = replace(mission, cruise=cruise, cap=max(mission.cap, 1.5 * cruise))
        for name in ("none", *thrusters_of(EIGHT).names):
            case = Case(scenario, vehicle, gains, failed=() if name == "none" else (name,))
            found = simulate_batch(case, seeds=np.arange(runs), threads=1)
            reached, collided = found.column("reached"), found.column("collided")
            lines.append(
                f"| {cruise} | {name} | {runs} | {int(reached.sum())} | {int(collided.sum())} | "
                f"{found.column('time_s').mean():.2f} | {found.column('path_error_m').mean():.4f} | "
                f"{found.column('min_clearance_m').min():.4f} |"
            )
            total += runs if name != "none" else 0
            arrived += int((reached * (1 - collided)).sum()) if name != "none" else 0
    return lines, total, arrived


def one_at_a_time() -> list[str]:
    """A failure in the middle of a run, in Python: thrust that is missing, and what the law makes of it."""
    mission, vehicle, gains = load_scenario("tank-static"), load_vehicle(EIGHT), load_gains("default")
    lines = ["| failure | ended | time, s | path error, m | steps in which a level gives up |", "|---|---|---|---|---|"]
    for faults in ((), (ThrusterFault("T2", 10.0),), (ThrusterFault("T2", 10.0), ThrusterFault("T3", 20.0))):
        run = simulate(mission, vehicle, gains=gains, thruster_faults=faults)
        missed = np.abs(run.telemetry("tau_desired") - run.record.tau).max(axis=1) > 1e-6
        what = ", ".join(f"{fault.thruster} at {fault.start:g} s" for fault in faults) or "none"
        lines.append(
            f"| {what} | {run.metrics.stopped_because} | {run.metrics.time_s:.2f} | {run.metrics.path_error_m:.4f} | "
            f"{int(missed.sum())} of {len(missed)} |"
        )
    return lines


def speed(law: Law | None = None) -> str:
    """Time of an allocation in compiled code, called from Python."""
    del law
    runner = runnable(allocation_block(thrusters_of(EIGHT)))
    tries, working = commands(thrusters_of(EIGHT), 2_000), np.ones(8)
    start = time.process_time()
    for wrench in tries:
        runner(wrench, working)
    return f"{1e6 * (time.process_time() - start) / len(tries):.1f} µs"


def main(words: Sequence[str]) -> int:
    """Print the tables and the limits; return the exit status."""
    if set(words) - {"--quick"}:
        print("the only option is --quick", file=sys.stderr)
        return 2
    quick = "--quick" in words
    exact, error, breach = exactness(200 if quick else 10_000)
    lexicographic, difference = against_the_lexicographic_solver(10 if quick else 300)
    flights, total, arrived = failures(1 if quick else 20)
    held = [
        (f"forces equal the exhaustive search to {EXACT:g} ({error:.1e})", error <= EXACT),
        (f"no limit is exceeded, and commands invert the curves to {EXACT:g} ({breach:.1e})", breach <= EXACT),
        (f"forces equal those of the lexicographic solver to 1e-6 N ({difference:.1e})", difference <= 1e-6),
        (f"with one failed thruster every run arrives without a collision ({arrived} of {total})", arrived == total),
    ]
    parts = ["## Exactness", *exact, "", "Against `surctl.priority.solve` in mode lexicographic:", "", *lexicographic]
    if not quick:
        counted, most = instructions()
        parts += ["", "## Instructions of a step", *counted]
        says = f"six thrusters add at most {MOST_INSTRUCTIONS} instructions to a step ({most:.0f})"
        held.append((says, most <= MOST_INSTRUCTIONS))
        parts += ["", f"One allocation of eight thrusters takes {speed()} from Python."]
    parts += ["", "## Failed thrusters of BlueROV2 Heavy", *flights, "", *one_at_a_time(), "", "## Limits"]
    print("\n".join([*parts, *(f"- {what}: {'holds' if good else '**does not hold**'}" for what, good in held)]))
    return 0 if all(good for _, good in held) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
