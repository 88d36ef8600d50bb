"""Study 20, third part: logs of a vehicle that rolls and pitches, with coloured noise.

    python analysis/20_identification/tilting.py            # two minutes on two idle cores
    python analysis/20_identification/tilting.py --quick    # one log

Each log is of another vehicle with the parameters of `sur540-tilting` ±25 %: 40 s at 10 Hz with random steps of thrust,
and noise on every column, half of it coloured. The fit starts at the vehicle of the library; weight, buoyancy and the
point of attack of the thrust are known.

Prints Markdown. The exit status is 0 if every statement holds, and 1 otherwise.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from multiprocessing import get_context

import numpy as np
from conclusion import concluded
from numpy.typing import NDArray
from scipy.signal import lfilter

from surctl.marine.simulation.physics import advance
from surctl.marine.vehicle import (
    LOG_TILT,
    PLANT_DISTURBANCE,
    MotionLog,
    Vehicle,
    identify,
    load_vehicle,
    plant_parameters,
    plant_state,
)
from surctl.marine.vehicle.identification.identify import held_out_windows

SEED = 2021
ROWS, PERIOD, PUSH = 400, 0.1, 0.8
NOISE = np.array([0.005, 0.005, 0.005, 0.01, 0.005, 0.005, 0.005, 0.01, 0.005, 0.005, 0.01, 0.01])
ALL, EACH, WIDE = 0.90, 0.80, 1.3  # bars; with 50 logs, a parameter at 90 % has at least 40 of them with 99 %

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Trial:
    """The fit to one log: estimate minus truth in half-intervals, and held-out RMS errors of roll and pitch."""

    error: dict[str, float]
    half: dict[str, float]
    identified: tuple[str, ...]
    model: dict[str, float]
    hold: dict[str, float]
    seconds: float


def drawn(nominal: Vehicle, rng: np.random.Generator) -> Vehicle:
    """Return a vehicle whose inertia, drag, lag and centre of gravity differ by up to 25 %."""
    free = {k: replace(p, range=None) for k, p in nominal.parameters.items()}
    fixed = ("radius", "weight", "buoyancy", "xb", "yb", "zb", "xt", "yt", "zt", "Fu_max", "Fv_max", "Fw_max", "Fr_max")
    values = {k: p.value * rng.uniform(0.75, 1.25) for k, p in free.items() if k not in fixed}
    return replace(nominal, parameters=free).with_values(values)


def log_of(vehicle: Vehicle, rng: np.random.Generator) -> MotionLog:
    """Return a log of random steps of thrust on all four axes."""
    held = [np.repeat(rng.uniform(-1, 1, ROWS), rng.integers(6, 30, ROWS))[:ROWS] for _ in range(4)]
    thrust = PUSH * vehicle.thrust_limit * np.column_stack(held)
    step, p, still = advance(vehicle.form), plant_parameters(vehicle), PLANT_DISTURBANCE.pack()
    x = plant_state(vehicle.form).pack({"tau": thrust[0]})
    motion = []
    for command in thrust:
        motion.append(np.concatenate([x[:8], x[12:]]))
        for _ in range(4):  # of 25 ms
            x = np.asarray(step(x, command, still, p)).reshape(-1)
    noise = NOISE * np.column_stack([_coloured(rng) for _ in NOISE])
    return MotionLog(PERIOD * np.arange(ROWS), np.array(motion) + noise, thrust, "log")


def _coloured(rng: np.random.Generator) -> Array:
    # half white noise, half noise with a correlation over 0.2 to 0.6 s
    phi = np.exp(-PERIOD / rng.uniform(0.2, 0.6))
    slow = lfilter([np.sqrt(1.0 - phi**2)], [1.0, -phi], rng.normal(size=ROWS + 100))[100:]
    return np.asarray(np.sqrt(0.5) * (slow + rng.normal(size=ROWS)))


def trial(seed: int) -> Trial:
    """Draw a vehicle and a log, fit, and predict the last part by a fit to the rest."""
    rng = np.random.default_rng([SEED, seed])
    nominal = load_vehicle("sur540-tilting")
    true = drawn(nominal, rng)
    log = log_of(true, rng)
    began = time.perf_counter()
    found = identify(log, nominal, name="fitted")
    taken = time.perf_counter() - began
    truth = {k: true[k] if k in true.parameters else 0.0 for k in found.estimates}
    error = {k: (v - truth[k]) / half for k, (v, half) in found.estimates.items()}
    later = next(iter(held_out_windows(log, nominal, [5.0])), None) if seed < 8 else None
    model, hold = ({}, {}) if later is None else (dict(later.model), dict(later.hold))
    half = {k: h for k, (_, h) in found.estimates.items()}
    return Trial(error, half, found.identified, model, hold, taken)


def trials(count: int, workers: int) -> Iterator[Trial]:
    """Return the trials in order; one worker computes in this process."""
    if workers == 1:
        yield from map(trial, range(count))
        return
    with get_context("spawn").Pool(workers) as pool:
        yield from pool.imap(trial, range(count))


def main() -> int:
    """Print the tables; return 1 if a statement does not hold."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one log")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    given = parser.parse_args()
    count = 1 if given.quick else 50
    found: list[Trial] = []
    for one in trials(count, given.workers):
        found.append(one)
        if not given.quick:
            sys.stderr.write(f"  {len(found)} of {count}: {[k for k, z in one.error.items() if abs(z) > 1]}\n")
    names = list(found[0].error)
    print(f"Logs: {count}, each {ROWS * PERIOD:g} s at {1 / PERIOD:g} Hz; coloured noise; roll and pitch measured\n")
    print("| parameter | in its 95 % interval | width over scatter | half-interval, median | identified |")
    print("|---|---|---|---|---|")
    inside = {k: sum(abs(t.error[k]) <= 1 for t in found) for k in names}
    wide = {k: 1.0 / (1.96 * float(np.sqrt(np.mean([t.error[k] ** 2 for t in found])))) for k in names}
    for k in names:
        half, told = np.median([t.half[k] for t in found]), np.mean([k in t.identified for t in found])
        print(f"| {k} | {inside[k]} of {count} | {wide[k]:.2f} | {half:.2g} | {told:.0%} |")
    print("\n| held-out RMS, first 8 logs | fit | last velocity held |\n|---|---|---|")
    predicted = [t for t in found if t.model]
    errors = {
        c: [float(np.sqrt(np.mean([getattr(t, kind)[c] ** 2 for t in predicted]))) for kind in ("model", "hold")]
        for c in LOG_TILT
    }
    for column, (model, hold) in errors.items():
        print(f"| {column} | {model:.3g} | {hold:.3g} |")
    share = sum(inside.values()) / (count * len(names))
    own = ("mpp", "mqq", "Kp", "Mq", "Kpp", "Mqq", "zg")
    told = float(np.mean([k in t.identified for t in found for k in ("mpp", "mqq", "zg")]))
    statements = {
        f"the truth lies in its interval in at least {ALL:.0%} ({share:.1%} of {count * len(names)})": share >= ALL,
        f"of each parameter in at least {EACH:.0%} (least {min(inside.values())} of {count}; of roll and pitch "
        f"{min(inside[k] for k in own)})": min(inside.values()) >= EACH * count,
        f"no interval is more than {WIDE:g} times as wide as the scatter needs ({max(wide.values()):.2f})": max(
            wide.values()
        )
        <= WIDE,
        f"moments of inertia and centre of gravity are identified in at least 95% ({told:.0%})": told >= 0.95,
        "roll and pitch are predicted with at most half the error of the last velocity held": all(
            model <= 0.5 * hold for model, hold in errors.values()
        ),
    }
    return concluded(statements, [t.seconds for t in found], quick=given.quick)


if __name__ == "__main__":
    sys.exit(main())
