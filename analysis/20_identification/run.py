"""Study 20: do the 95 % intervals of a vehicle fitted to a log contain the true values in 95 % of the cases?

    python analysis/20_identification/run.py            # ten minutes on two cores
    python analysis/20_identification/run.py --quick    # a log of 30 s

Prints Markdown; the results do not depend on the number of processes.
The exit status is 0 if every statement holds, and 1 otherwise.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from multiprocessing import get_context

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.marine.vehicle import (
    FITTED,
    LOG_MOTION,
    MotionLog,
    Vehicle,
    build_plant,
    identify,
    load_vehicle,
    plant_parameters,
)

SEED = 20
SURGE = 1000  # seed of the first log of surge alone
PERIOD = 0.1  # s between rows
FINE = 8  # integration steps per row, finer than in the fit
NOISE = (0.005, 0.005, 0.005, 0.01, 0.005, 0.005, 0.005, 0.01)  # m, rad, m/s, rad/s
BAR = 0.93  # of 95 %


@dataclass(frozen=True)
class Trial:
    """A log of random thrust steps of a vehicle drawn from its ranges, and the result of the fit."""

    inside: dict[str, bool]
    told: tuple[str, ...]
    half: dict[str, float]
    seconds: float


def drawn(nominal: Vehicle, rng: np.random.Generator) -> Vehicle:
    """Draw masses and drag uniformly from the vehicle's ranges, or ±25 % without a range."""
    values = {}
    for name in FITTED:
        low, high = nominal.parameters[name].range or (0.75 * nominal[name], 1.25 * nominal[name])
        values[name] = float(rng.uniform(low, high)) if high > low else nominal[name]
    return nominal.with_values(values)


def log_of(vehicle: Vehicle, rng: np.random.Generator, *, rows: int, axes: tuple[int, ...]) -> MotionLog:
    """Return a log of thrust steps held for 0.6 to 3 s on the given axes, with white noise on every column."""
    thrust = np.zeros((rows, 4))
    for axis in axes:
        held = np.repeat(rng.uniform(-1, 1, rows), rng.integers(6, 30, rows))[:rows]
        thrust[:, axis] = held * vehicle.thrust_limit[axis]
    motion = _integrated(vehicle, thrust)
    return MotionLog(PERIOD * np.arange(rows), motion + rng.normal(size=motion.shape) * NOISE, thrust, "log")


def _integrated(vehicle: Vehicle, thrust: NDArray[np.float64]) -> NDArray[np.float64]:
    period, p, x = _period(), plant_parameters(vehicle), np.zeros(12)
    rows = [x[:8]]
    for command in thrust[:-1]:
        x = np.asarray(period(x, command, p)).ravel()
        rows.append(x[:8])
    return np.array(rows)


@cache
def _period() -> ca.Function:
    # the state after a row from the state before it, the command and the parameters
    ode, h = build_plant().ode, PERIOD / FINE
    x, command, p = (ca.SX.sym(name, ode.size1_in(k)) for k, name in ((0, "x"), (1, "command"), (3, "p")))
    k1 = ode(x, command, 0, p)
    k2 = ode(x + h / 2 * k1, command, 0, p)
    k3 = ode(x + h / 2 * k2, command, 0, p)
    k4 = ode(x + h * k3, command, 0, p)
    step = ca.Function("step", [x, command, p], [x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])
    after = start = ca.MX.sym("x", x.numel())
    held, numbers = ca.MX.sym("command", command.numel()), ca.MX.sym("p", p.numel())
    for _ in range(FINE):
        after = step(after, held, numbers)
    return ca.Function("period", [start, held, numbers], [after])


def trial(nominal: Vehicle, seed: int, *, rows: int, axes: tuple[int, ...] = (0, 1, 2, 3)) -> Trial:
    """Draw a vehicle, simulate a log, fit from the nominal vehicle, and compare."""
    rng = np.random.default_rng([SEED, seed])
    true = drawn(nominal, rng)
    log = log_of(true, rng, rows=rows, axes=axes)
    began = time.perf_counter()
    found = identify(log, nominal, name="fitted")
    taken = time.perf_counter() - began
    inside = {k: abs(v - true[k]) <= half for k, (v, half) in found.estimates.items() if k in FITTED}
    return Trial(inside, found.identified, {k: half for k, (_, half) in found.estimates.items()}, taken)


def _job(words: tuple[int, int, tuple[int, ...]]) -> Trial:
    seed, rows, axes = words
    return trial(load_vehicle("sur540-flooded"), seed, rows=rows, axes=axes)


def flights(jobs: list[tuple[int, int, tuple[int, ...]]], workers: int) -> Iterator[Trial]:
    """Return the trials in order; one worker computes in this process."""
    if workers == 1:
        yield from map(_job, jobs)
        return
    with get_context("spawn").Pool(workers) as pool:
        yield from pool.imap(_job, jobs)


def main() -> int:
    """Print the tables; return 1 if a statement does not hold."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one run of 30 s instead of 200 of 60 s")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    given = parser.parse_args()
    quick = given.quick
    runs, rows = (1, 300) if quick else (200, 600)
    nominal = load_vehicle("sur540-flooded")
    alone = range(SURGE, SURGE + (1 if quick else 10))
    jobs = [(k, rows, (0, 1, 2, 3)) for k in range(runs)] + [(k, rows, (0,)) for k in alone]
    flown: list[Trial] = []
    for found in flights(jobs, given.workers):
        flown.append(found)
        if not quick:
            sys.stderr.write(f"  {len(flown)} of {len(jobs)}: {sum(not x for x in found.inside.values())} outside\n")
    trials, surge = flown[:runs], flown[runs:]
    print(f"{runs} logs of {rows * PERIOD:g} s, noise {NOISE[0]:g} m, {NOISE[3]:g} rad, {NOISE[4]:g} m/s; columns:")
    print(f"{', '.join(LOG_MOTION)}\n")
    print("| parameter | nominal | in its 95 % interval | half-interval, median | determined |\n|---|---|---|---|---|")
    for name in FITTED:
        hits = np.mean([t.inside[name] for t in trials])
        half = np.median([t.half[name] for t in trials])
        told = np.mean([name in t.told for t in trials])
        unit = nominal.parameters[name].unit
        print(f"| {name} | {nominal[name]:g} {unit} | {hits:.1%} | {half:.2g} | {told:.0%} |")
    share = float(np.mean([list(t.inside.values()) for t in trials]))
    moved, still = {"m11", "Xuu"}, {"m22", "m33", "m44", "Yvv", "Zww", "Nrr"}
    statements = {
        f"the truth lies in its interval in at least {BAR:.0%} ({share:.1%} of {runs * len(FITTED)})": share >= BAR,
        "every log determines masses and thrust lag": all(
            {"m11", "m22", "m33", "m44", "thrust_lag"} <= set(t.told) for t in trials
        ),
        "a log of surge alone determines surge": all(moved <= set(t.told) for t in surge),
        "and the other parameters are reported as not determined": not any(still & set(t.told) for t in surge),
    }
    print("\n| statement | holds |\n|---|---|")
    for text, holds in statements.items():
        print(f"| {text} | {'holds' if holds else '**does not hold**'} |")
    print(f"\nA fit took {np.median([t.seconds for t in trials]):.2g} s.")
    if quick:
        return 0 if list(statements.values())[1:] == [True] * 3 else 1
    return 0 if all(statements.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
